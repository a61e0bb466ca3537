"""How large a change could hide: the smallest that would have been named."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayesid.diagnosis.changes.evidence import Marginal
from bayesid.diagnosis.changes.hypotheses import Hypothesis
from bayesid.diagnosis.changes.scales import SIZES
from bayesid.diagnosis.changes.selection import Selection
from bayesid.diagnosis.settings import Settings

#: Factor to which the smallest size is sought.
_PRECISION = 1.02


@dataclass(frozen=True)
class HiddenChange:
    """The smallest change of a kind that would have been named.

    Attributes
    ----------
    change
        What it is.
    value
        Of its first parameter, the others in their typical proportion to it; infinite where these motions never show it.
    """

    change: Hypothesis
    value: float


def smallest(selection: Selection, settings: Settings) -> tuple[HiddenChange, ...]:
    """For every change that was not found, how large it had to be; one for each kind and place.

    A change of amplitudes x adds ``1/2 x'Z'V^-1 Z x`` to the density's exponent, less what the size of its prior costs.
    """
    marginal = selection.marginal()
    best: dict[str, HiddenChange] = {}
    for change in selection.every:
        if change.spec in {a.change.spec for a in selection.accepted}:
            continue
        found = HiddenChange(change, _smallest(marginal, change, settings.accept))
        if change.spec not in best or found.value < best[change.spec].value:
            best[change.spec] = found
    return tuple(best.values())


def _smallest(marginal: Marginal, change: Hypothesis, needed: float) -> float:
    gram = marginal.information(change)
    typical = change.sizes / change.sizes[0]
    low, high = 1e-6 * change.sizes[0], 1e3 * change.sizes[0]

    def evidence(value: float) -> float:
        seen = gram @ (value * typical)
        out = []
        for size in SIZES:
            scale = size * change.sizes
            lower = np.linalg.cholesky(np.eye(len(scale)) + gram * np.outer(scale, scale))
            out.append(0.5 * np.sum(np.linalg.solve(lower, scale * seen) ** 2) - np.log(np.diag(lower)).sum())
        return float(np.logaddexp.reduce(out) - np.log(len(SIZES)))

    if evidence(high) < needed:
        return float("inf")
    while high > _PRECISION * low:
        middle = float(np.sqrt(low * high))
        low, high = (low, middle) if evidence(middle) >= needed else (middle, high)
    return high
