"""Whether a model is one or two missing effects, or a combination of surrogates that stand in for an unmodelled one."""

from __future__ import annotations

from collections.abc import Sequence

from bayesid.diagnosis.data import DiagnosisData
from bayesid.diagnosis.fit import Fit
from bayesid.effects import Term


def explained(base: Fit, best: Fit) -> float:
    """Share of what stands out of the noise on the fitted motions that a model explains."""
    before, after = (f.chi2 / f.projector.rows - 1.0 for f in (base, best))
    return 1.0 - after / before if before > 0.0 else 0.0


def unrelated(data: DiagnosisData, terms: Sequence[Term]) -> int:
    """How many unrelated effects there are; one kind in half of the joints, two at least, counts once."""
    names = [t.effect.name for t in terms]
    many = max(2, data.robot.n / 2)
    return sum(1 if names.count(n) >= many else names.count(n) for n in set(names))


def is_surrogate_combination(data: DiagnosisData, terms: Sequence[Term]) -> bool:
    """Whether more effects are needed than a robot is likely to hide."""
    return unrelated(data, terms) > data.settings.likely_effects
