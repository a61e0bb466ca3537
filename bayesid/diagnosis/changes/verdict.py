"""What the proof allows to be said."""

from __future__ import annotations

from typing import Literal

import numpy as np

from bayesid.diagnosis.changes.posterior import amplitudes
from bayesid.diagnosis.changes.proof import Proof
from bayesid.diagnosis.changes.scales import DISPERSIONS
from bayesid.diagnosis.changes.selection import Accepted, Selection
from bayesid.diagnosis.settings import Settings
from bayesid.diagnosis.significance import outside, squared_distance

Verdict = Literal["named", "named_in_part", "ambiguous", "unknown", "nothing_missing"]


def proven(selection: Selection, proof: Proof, settings: Settings) -> tuple[Accepted, ...]:
    """Changes that differ from zero and close some of the gap on stretches that took no part, with 95 % confidence.

    None is, where the tolerance alone predicts those stretches better. It may predict them as well: what is improbable, that
    friction doubled from one day to the next, is the evidence's to say.
    """
    if proof.after > proof.tolerance * (1.0 + settings.worse_share):
        return ()
    fitted, out = amplitudes(selection.marginal()), []
    for a, own, low in zip(selection.accepted, selection.directions, proof.shares_low, strict=True):
        values, root = fitted.part(own)[a.change.columns], fitted.part_root(own)[a.change.columns]
        if low > 0.0 and outside(squared_distance(values, root @ root.T), len(values), settings):
            out.append(a)
    return tuple(out)


def verdict(selection: Selection, proof: Proof, settings: Settings) -> Verdict:
    """The verdict.

    Parameters
    ----------
    selection, proof
        Changes that the data demand, and how they do on held-out stretches.
    settings
        The thresholds.

    Notes
    -----
    Without a change there is something unknown where the data demand one that held-out stretches deny, or where, with what
    wanders within its tolerance, they are predicted worse than any dispersion allows.
    """
    named = proven(selection, proof, settings)
    if not named:
        unexplained = proof.tolerance > DISPERSIONS[-1] * proof.floor
        return "unknown" if selection.accepted or unexplained else "nothing_missing"
    if any(a.rivals for a in named):
        return "ambiguous"
    open_ = np.isfinite(proof.closed) and proof.remainder > 1.0 - settings.closed
    return "named_in_part" if open_ or len(named) < len(selection.accepted) else "named"
