"""The diagnosis: search, verdict, validation, and what the missing effects had done to the parameters."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from bayesid.diagnosis import text
from bayesid.diagnosis.candidates import UNEXPLAINED
from bayesid.diagnosis.data import SHORTEST, WHITE, DiagnosisData, prepare_data
from bayesid.diagnosis.locate import Disagreement, locate
from bayesid.diagnosis.residual_floor import SOURCES
from bayesid.diagnosis.search import ACCEPT, Found, Search, make_projector, search
from bayesid.diagnosis.stability import Stability, stability
from bayesid.diagnosis.surrogates import EXPLAINED, explained, is_surrogate_combination
from bayesid.diagnosis.validation import Gap, residual_spectra, validate
from bayesid.dynamics.base_parameters import structural_base
from bayesid.effects import Term, starting_point
from bayesid.recordings.experiment import Experiment, load_experiment
from bayesid.regression.problem import default_channel, make_channels

SCHEMA = 1
#: A found effect must not make unseen motions worse by more than this share of their squared residual.
WORSE = 0.02
#: Where the gap before is this many times the floor, it has to shrink; and where it stays this many times the floor, mostly.
ROOM, OPEN, MOSTLY = 1.05, 1.1, 0.7
#: Where so much of the gap on unseen motions is closed, what is left of it there is no sign of something unknown.
CLOSED = 0.9
#: From here on the slope of a drift is lost in its size at the start [s].
LATE = 1e5
#: A floor this many times the noise says that predictions of the unseen motions are vague.
VAGUE = 1.5

Progress = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """What `diagnose` found.

    Attributes
    ----------
    case
        What was compared.
    verdict
        ``named``, ``ambiguous``, ``unknown`` or ``nothing_missing``.
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

    @property
    def terms(self) -> tuple[Term, ...]:
        """Effects of the model after the diagnosis: the user's, as they are beside those named, and those."""
        fitted = self.search.best if self.found else self.search.base
        known = fitted.terms[: len(self.search.base.terms)]
        return (*known, *(f.term for f in self.found))

    @property
    def needed(self) -> float:
        """Log evidence that an effect has to bring to be named."""
        return ACCEPT

    @property
    def noise_level(self) -> float:
        """Mean square of whitened residuals that counts as noise when disagreements are looked for."""
        return max(1.0, min(self.search.dispersion, UNEXPLAINED))

    def __str__(self) -> str:
        """A few lines: the verdict, values, the gap, where it disagrees."""
        return text.summary(self)

    def _repr_html_(self) -> str:
        """The same for notebooks."""
        return text.notebook(self)

    def write(self, folder: str | Path) -> Path:
        """Write ``diagnosis.json``, ``model.toml`` and ``report.html``; returns the report's path."""
        return text.write(self, folder)

    def to_dict(self) -> dict[str, Any]:
        """``diagnosis.json``."""
        each = float(np.log(self.search.projector.rows))
        return {
            "schema": SCHEMA,
            "experiment": self.data.experiment.name,
            "channel": self.data.channel,
            "verdict": self.verdict,
            "effects": [self._effect(f) for f in self.found],
            "where": [d.to_dict() for d in self.where],
            "gap": self._gap(),
            "candidates": [
                {
                    "name": p.term.effect.name, "where": p.term.effect.where,
                    "log_bayes_factor": 0.5 * (p.gain / self.search.dispersion - p.parameters * each),
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

    def _effect(self, found: Found) -> dict[str, Any]:
        effect = found.term.effect
        std = found.std
        parameters = {
            key: {"value": float(value), "std": float(s) if np.isfinite(s) and s > 0 else None, "unit": unit}
            for key, value, s, unit in zip(effect.parameters, found.term.values, std, effect.units, strict=True)
        }
        rivals = [{"name": t.effect.name, "where": t.effect.where} for t, _ in found.rivals]
        odds = np.array([0.0, *(-lack for _, lack in found.rivals)])
        return {
            "name": effect.name, "where": effect.where, "probability": float(1.0 / np.exp(odds).sum()),
            "log_bayes_factor": found.gain, "parameters": parameters, "ambiguous_with": rivals,
            "stability": next((x.to_dict() for x in self.stability if x and x.spec == effect.spec), None),
        }  # fmt: skip


def diagnose(
    experiment: Experiment | str | Path,
    channel: str | None = None,
    *,
    motions: Sequence[str] | None = None,
    effects: Sequence[str] | None = None,
    seed: int = 0,
    progress: Progress = lambda _: None,
) -> Diagnosis:
    """Find where model and data disagree, name the missing effect, add it and show on held-out motions that the gap shrank.

    Parameters
    ----------
    experiment
        Loaded, or its folder.
    channel
        ``wrench``, ``torque`` or ``both``; default as for `bayesid.identify`.
    motions
        Which to fit; default those with role ``identification``.
    effects
        Replaces ``[model] effects``.
    seed
        Of everything random.
    progress
        Called with the name of every stage.

    Raises
    ------
    InputError
        Bad input; the message says what to do.
    """
    import time

    since = time.perf_counter()
    with threadpool_limits(1, user_api="blas"):
        if not isinstance(experiment, Experiment):
            experiment = load_experiment(experiment)
        if effects is not None:
            experiment = replace(experiment, effects=tuple(effects))
        progress("noise of sensors and encoders")
        channel = channel or default_channel(experiment)
        terms, held = known_terms(experiment, channel, effects)
        data = prepare_data(experiment, channel, terms, motions, seed, held)
        found = search(make_projector(data, data.terms), data.terms, seed, progress)
        progress("validation on unseen motions")
        result = _decide(found.projector.data, found, seed)
    return Diagnosis(**{**result.__dict__, "seconds": time.perf_counter() - since})


def known_terms(experiment: Experiment, channel: str, effects: Sequence[str] | None) -> tuple[tuple[Term, ...], frozenset[str]]:
    """The user's effects at their starting values, and which of them (``name@where``) keep those."""
    names = make_channels(experiment, channel).names
    specs = experiment.effects if effects is None else effects
    parsed = experiment.library.parse(specs, experiment.robot.joint_names, names, experiment.gear_ratio)
    values, free = starting_point(parsed, experiment.effect_values, experiment.robot.joint_names)
    terms, held, start = [], set(), 0
    for effect in parsed:
        own = slice(start, start + len(effect.parameters))
        terms.append(Term(effect, tuple(map(float, values[own]))))
        if not free[own].all():
            held.add(effect.spec)
        start = own.stop
    return tuple(terms), frozenset(held)


def _decide(data: DiagnosisData, s: Search, seed: int) -> Diagnosis:
    left = s.best.chi2 / s.projector.rows
    gap = validate(s.projector, s.base, s.best, s.dispersion, seed)
    remarks: list[str] = []
    found, verdict = s.found, "named"
    tried = ", ".join(text.by_kind(f.term for f in found))
    nearly = gap is not None and gap.closed > CLOSED and gap.after <= OPEN * gap.floor and explained(s.base, s.best) > EXPLAINED
    # What is left of a gap on livelier motions than the fitted ones is no unmodelled effect if it is a small share of the gap.
    unseen = 0.0 if gap is None or (found and gap.closed > CLOSED) else (gap.after / gap.floor) ** 2
    # A contact does not come again, and a change of a link is denied by the links' prior: the same motion is predicted as well
    # by many links that are a little off.
    local = all(f.term.effect.once or f.term.effect.changes_link for f in found)
    if max(left if not (found and nearly) else 0.0, unseen) > UNEXPLAINED:
        verdict = "unknown"
        elsewhere = "" if gap is None else f" and {gap.after:.3g} times on the unseen ones"
        remarks.append(
            "Something is missing that no effect of the library explains: residuals stay at "
            f"{np.sqrt(left):.3g} times the noise on the fitted motions{elsewhere}"
            + (f", even with the best fit of {tried}." if tried else ".")
        )
    elif not found:
        verdict = "nothing_missing"
    elif gap is not None and not local and _denied(gap):
        verdict = "unknown"
        remarks.append(f"{tried} fits the fitted motions, but predicts the unseen ones no better: not named.")
    elif is_surrogate_combination(data, [f.term for f in found]) or (s.dropped and not nearly):
        verdict = "unknown"
        together = ", ".join(text.by_kind((*(f.term for f in found), *s.dropped)))
        remarks.append(
            f"Only {together} together explain the residual. So many unrelated effects at once are less likely than one that the "
            "library does not have and that they imitate between them: not named."
        )
    elif any(f.rivals for f in found):
        verdict = "ambiguous"
    if verdict == "unknown":
        found = ()
        # The model handed on is the user's; what a rejected attempt could not determine is no part of its floor.
        gap = gap and replace(gap, floor=gap.bare_floor)
    if data.floor_source != WHITE:  # the usual one needs no word
        remarks.append(SOURCES[data.floor_source])
    if found and s.dropped:
        remarks.append(
            f"{tried} explain {100 * explained(s.base, s.best):.3g} % of what stands out of the noise. What is left would fit "
            f"{', '.join(text.by_kind(s.dropped))}, but is no more than these models may be inexact by: not named."
        )
    parts = {t.effect.name for t in data.terms}
    if idle := [spec for spec in data.experiment.effects if spec.split("@")[0] not in parts]:
        remarks.append(
            f"{', '.join(idle)} of the model cannot be seen in what is compared (--channel {data.channel}), and took no part."
        )
    if (start := max(abs(x.times[0]) for x in data.segments)) > LATE:
        remarks.append(
            f"Times start at {start:.3g} s. A drift counts from time zero, so it is one with an offset here; subtract the start."
        )
    if data.instants:
        remarks.append(
            "Dry friction fits better with readings as values at their times than as means over a sample's time, so they are "
            "taken for that."
        )
    if found and gap is not None and gap.before <= ROOM * gap.floor and all(f.term.effect.changes_link for f in found):
        count = s.projector.root.shape[1]
        far, near = (float(np.sum(f.coordinates[:count] ** 2)) for f in (s.base, s.best))
        remarks.append(
            f"The residual does not show {tried}, for changed links stand in for it on all motions. What speaks for it is the "
            f"links' prior: the squared distance from the nominal links, in prior standard deviations, is {far:.3g} without it "
            f"and {near:.3g} with it, for {count} parameters."
        )
    if gap is not None and gap.floor > VAGUE:
        remarks.append(
            f"On the unseen motions a complete model would be off by {gap.floor:.3g} times the noise, for the fitted motions "
            "leave its parameters that uncertain: they say little."
        )
    if data.skipped:
        remarks.append(
            f"Not compared: {', '.join(data.skipped)}; a validation motion needs the same readings and a segment of "
            f"{SHORTEST:g} s without a gap."
        )
    if found and gap is None:
        remarks.append(
            "No validation motion was compared: the effect is named on the fitted motions alone, and held-out "
            "validation is missing."
        )
    if data.experiment.inertia_rel_std is None:
        remarks.append(
            "The prior relative standard deviation of the nominal inertias is not stated (inertia_rel_std): every rigid "
            "parameter is free, and a payload or a wrong inertia cannot be told from the nominal model being wrong."
        )
    parts = stability(s.projector, s.best, len(s.base.terms), found, s.dispersion)
    remarks += [text.moment_sentence(x) for x in parts if x is not None and x.rests_on is not None]
    white = residual_spectra(data, data.segments, s.base)
    where = locate(data, data.segments, white, max(1.0, min(s.dispersion, UNEXPLAINED)))
    return Diagnosis(
        data,
        verdict,
        s,
        found,
        where,
        gap,
        _shifts(data, s) if found else (),
        tuple(remarks),
        _next(verdict, found),
        stability=parts,
    )


def _denied(gap: Gap) -> bool:
    """Whether the unseen motions deny the effects found: worse, no better where there was room, or most of the gap still open."""
    worse = gap.after**2 > gap.before**2 * (1.0 + WORSE)
    no_better = gap.before > ROOM * gap.floor and gap.closed_low <= 0.0
    still_open = gap.after > OPEN * gap.floor and gap.closed < MOSTLY
    return worse or no_better or still_open


def _shifts(data: DiagnosisData, s: Search) -> tuple[tuple[str, float, float, float], ...]:
    """Base parameters that the effects found had moved by more than three standard deviations."""
    if data.prior is None:
        return ()
    base = structural_base(data.robot, data.channels, gravity=True, offset=data.channel != "torque", at_rest=False)
    inverse = np.linalg.inv(s.projector.r)[: s.projector.root.shape[1]]
    spread = base.matrix @ s.projector.root @ inverse
    std = np.sqrt(s.dispersion * np.sum(spread**2, axis=1))
    before, after = base.matrix @ s.base.links, base.matrix @ s.best.links
    sigmas = (before - after) / np.maximum(std, 1e-300)
    order = np.argsort(-np.abs(sigmas))
    return tuple((base.labels[k], float(before[k]), float(after[k]), float(sigmas[k])) for k in order if abs(sigmas[k]) > 3)


def _next(verdict: str, found: Sequence[Found]) -> str:
    """What to record next, in a sentence."""
    if verdict == "ambiguous":
        pairs = [(f.term.effect.spec, ", ".join(t.effect.spec for t, _ in f.rivals)) for f in found if f.rivals]
        names = "; ".join(f"{a} from {b}" for a, b in pairs)
        return (
            f"To tell {names}: move other joints and repeat the motion at half and at full speed; effects that look alike "
            "on one motion differ in how they grow with speed and change with posture."
        )
    if verdict == "unknown":
        return (
            "Record one joint at a time, slowly and fast, forth and back through the same poses: what stays with position is a "
            "spring, a cable or a calibration; what changes sign with velocity is friction or drag; what grows with acceleration "
            "is inertia or delay."
        )
    if verdict == "nothing_missing":
        return "Nothing is left to settle with these motions; faster motions of all joints would show smaller effects."
    return "Repeat the validation on a new motion with the effect in the model (model.toml), to see the smaller gap hold."


__all__ = ["ACCEPT", "Diagnosis", "diagnose"]
