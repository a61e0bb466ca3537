"""What ``diagnose`` found, as numbers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from bayesid.design.tell.choose import Telling
from bayesid.diagnosis.candidates import Proposal
from bayesid.diagnosis.data import DiagnosisData
from bayesid.diagnosis.description.describe import Description
from bayesid.diagnosis.in_part import InPart
from bayesid.diagnosis.locate import Disagreement
from bayesid.diagnosis.push import Push
from bayesid.diagnosis.search import Found, Search
from bayesid.diagnosis.stability import Stability
from bayesid.diagnosis.validation import Gap
from bayesid.effects import Term
from bayesid.effects.effect import Derived
from bayesid.estimators.parameters import with_ends
from bayesid.recordings.schema import EffectParameters
from bayesid.results.described import description_dict, terms_of
from bayesid.results.fitted_model import fitted_model
from bayesid.results.telling import NEXT_MOTION, telling_dict
from bayesid.validation.own_fit import MotionErrors

SCHEMA = 1


@dataclass(frozen=True, eq=False)
class Findings:
    """What `diagnose` found, as plain data.

    Attributes
    ----------
    data
        What was compared.
    verdict
        ``named``, ``named_in_part``, ``ambiguous``, ``unknown`` or ``nothing_missing``.
    search
        The models fitted.
    found
        The effects named, none for the last two verdicts.
    where
        Where the user's model and the data disagree.
    gap
        On the validation motions; None without any.
    shifts
        Base parameters that the missing effects had moved: label, value before, after, and by how many standard
        deviations.
    remarks
        What the reader should know.
    next_experiment
        What would settle what is open.
    seconds
        Run time.
    stability
        Each effect named without each part of the recordings; None where that says nothing.
    telling
        The motion that settles an ambiguous verdict; None for any other.
    description
        A draft of what no effect explains; None where all is explained, or no motion that it was not chosen on confirms one.
    part
        What held-out recordings say of effects named in part; None for any other verdict.
    remainder
        Where the model with the effects named in part and the data disagree.
    errors
        What `bayesid.identify` leaves of every motion without and with the effects named; those that were not fitted first.
    """

    data: DiagnosisData
    verdict: str
    search: Search
    found: tuple[Found, ...]
    where: tuple[Disagreement, ...]
    gap: Gap | None
    shifts: tuple[tuple[str, float, float, float], ...]
    remarks: tuple[str, ...]
    next_experiment: str
    seconds: float = 0.0
    stability: tuple[Stability | None, ...] = ()
    telling: Telling | None = None
    description: Description | None = None
    part: InPart | None = None
    remainder: tuple[Disagreement, ...] = ()
    errors: tuple[MotionErrors, ...] = ()

    @property
    def terms(self) -> tuple[Term, ...]:
        """Effects of the model after the diagnosis: the user's, as they are beside those named, and those."""
        fitted = self.search.best if self.found else self.search.base
        known = fitted.terms[: len(self.search.base.terms)]
        return (*known, *(f.term for f in self.found))

    def derived(self, index: int) -> tuple[Derived, ...]:
        """What follows from the values of an effect, see `bayesid.effects.effect.Effect.derived`."""
        found, best = self.found[index], self.search.best
        at = [column for column, (owner, _) in enumerate(best.free) if owner == len(self.search.base.terms) + index]
        if len(at) != len(found.std):  # only of a fit of all its parameters is their covariance known
            return ()
        covariance = best.covariance[np.ix_(at, at)]
        scale = found.std / np.sqrt(np.maximum(np.diag(covariance), 1e-300))  # a dispersion, and infinite where undetermined
        with np.errstate(invalid="ignore"):
            return found.term.effect.derived(found.term.values, covariance * np.outer(scale, scale))

    @property
    def needed(self) -> float:
        """Log evidence that an effect has to bring to be named."""
        return self.data.settings.accept

    @property
    def noise_level(self) -> float:
        """Mean square of whitened residuals that counts as noise when disagreements are looked for."""
        return max(1.0, min(self.search.dispersion, self.data.settings.unexplained))

    @property
    def model(self) -> tuple[tuple[str, ...], EffectParameters]:
        """The experiment's model with the named effects added, see `bayesid.results.fitted_model`."""
        experiment = self.data.experiment
        return fitted_model(experiment, [*experiment.effects, *(f.term.effect.spec for f in self.found)], self.terms)

    def evidence(self, proposal: Proposal) -> float:
        """Log evidence that an effect alone would add to the user's model."""
        each = float(np.log(self.search.projector.rows))
        return 0.5 * (proposal.gain / self.search.dispersion - proposal.parameters * each)

    def to_dict(self) -> dict[str, Any]:
        """What ``diagnosis.json`` holds."""
        return {
            "schema": SCHEMA,
            "experiment": self.data.experiment.name,
            "channel": self.data.channel,
            "verdict": self.verdict,
            "effects": [self._effect(f, k) for k, f in enumerate(self.found)],
            "remainder": self._remainder(),
            "where": [d.to_dict() for d in self.where],
            "gap": self._gap(),
            "errors": [e.to_dict() for e in self.errors],
            "description": None if self.description is None else description_dict(self.description, self.data.channels.names),
            "candidates": [
                {
                    "name": p.term.effect.name, "where": p.term.effect.where,
                    "log_bayes_factor": self.evidence(p),
                    "minimum_detectable": p.minimum,
                }
                for p in self.search.proposals
            ],
            "identification": {
                "rows": self.search.projector.rows,
                "before": float(np.sqrt(self.search.base.chi2 / self.search.projector.rows)),
                "after": float(np.sqrt(self.search.best.chi2 / self.search.projector.rows)),
                "unexplained": float(np.sqrt(self.search.dispersion)),
            },
            "base_parameter_shifts": [
                dict(zip(("label", "before", "after", "sigmas"), shift, strict=True)) for shift in self.shifts
            ],
            "remarks": list(self.remarks),
            "next_experiment": self.next_experiment,
            "next_motion": None if self.telling is None else telling_dict(self.telling, NEXT_MOTION),
            "runtime_s": self.seconds,
        }  # fmt: skip

    def _gap(self) -> dict[str, Any] | None:
        """The gap of the model as it is handed on: an attempt that was not accepted closes nothing."""
        if self.gap is None:
            return None
        out = {**self.gap.to_dict(), "floor_known": self.data.floor_known, "floor_source": self.data.floor_source}
        if self.verdict == "unknown":
            out |= {"best_attempt_after": out["after"], "after": out["before"], "closed": 0.0, "closed_low": 0.0}
        return out

    def shares(self, index: int) -> tuple[float, float] | None:
        """Share of the held-out gap that an effect closes and its lower end; None where that was not measured for it alone."""
        if isinstance(self.found[index].term, Push):  # it is in no other motion
            return None
        if self.part is not None:
            return self.part.shares[index].share, self.part.shares[index].share_low
        alone = len(self.found) == 1 and self.gap is not None and np.isfinite(self.gap.closed)
        return (self.gap.closed, self.gap.closed_low) if self.gap is not None and alone else None

    def _remainder(self) -> dict[str, Any] | None:
        """What stays beside effects named in part."""
        if self.part is None:
            return None
        rows = [] if self.description is None else terms_of(self.description, self.data.channels.names)
        described_by = "; ".join(f"{reading} ~ {formula}" for reading, formula, *_ in rows) or None
        return {
            "share": self.part.remainder, "where": [d.to_dict() for d in self.remainder], "described_by": described_by,
            "closed_in": [
                {"channels": list(g.channels), "effects": list(g.effects), "share": g.closed} for g in self.part.groups
            ],
            "stretches": self.part.stretches, "correlated_rows": self.part.correlation,
        }  # fmt: skip

    def _effect(self, found: Found, index: int) -> dict[str, Any]:
        effect = found.term.effect
        std = found.std
        parameters = {
            key: with_ends(value, s, unit)
            for key, value, s, unit in zip(effect.parameters, found.term.values, std, effect.units, strict=True)
        }
        derived = {key: with_ends(value, s, unit) for key, value, s, unit in self.derived(index)}
        rivals = [{"name": t.effect.name, "where": t.effect.where} for t, _ in found.rivals]
        share = self.shares(index)
        odds = np.array([0.0, *(-lack for _, lack in found.rivals)])
        probability = (1.0 - self.data.settings.outside_library) / np.exp(odds).sum()
        return {
            "name": effect.name, "where": effect.where, "probability": float(probability),
            "log_bayes_factor": found.gain, "share": None if share is None else share[0],
            "share_low": None if share is None else share[1], "parameters": parameters, "derived": derived,
            "ambiguous_with": rivals,
            "stability": next((x.to_dict() for x in self.stability if x and x.spec == effect.spec), None),
            "course": found.term.to_dict() if isinstance(found.term, Push) else None,
        }  # fmt: skip
