"""Whether a model is one or two missing effects, or a combination of surrogates that stand in for an unmodelled one."""

from __future__ import annotations

from collections.abc import Sequence

from bayesid.diagnosis.data import DiagnosisData
from bayesid.diagnosis.fit import Fit
from bayesid.effects import Term

#: A model that explains so much of the residual may leave more than noise: no model of a drive is exact to a hundredth.
EXPLAINED = 0.95
#: More unrelated effects than this at once are taken for surrogates that together imitate an unmodelled one.
LIKELY = 2


def explained(base: Fit, best: Fit) -> float:
    """Share of what stands out of the noise on the fitted motions that a model explains."""
    before, after = (f.chi2 / f.projector.rows - 1.0 for f in (base, best))
    return 1.0 - after / before if before > 0.0 else 0.0


def is_surrogate_combination(data: DiagnosisData, terms: Sequence[Term]) -> bool:
    """Whether more effects are needed than a robot is likely to hide; one kind on most joints counts as one."""
    names = [t.effect.name for t in terms]
    many = max(2, data.robot.n / 2)
    return sum(1 if names.count(n) >= many else names.count(n) for n in set(names)) > LIKELY


__all__ = ["EXPLAINED", "LIKELY", "explained", "is_surrogate_combination"]
