"""Everything that a comparison with a reference found, as plain data."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np

from bayesid.diagnosis.changes.evidence import Amplitudes, Marginal, amplitudes, expected_gain
from bayesid.diagnosis.changes.held_out import HeldOutErrors, held_out_errors
from bayesid.diagnosis.changes.hypotheses import Hypothesis
from bayesid.diagnosis.changes.recording import LaterRecording, chosen_bandwidth, read_recording
from bayesid.diagnosis.changes.reference import Reference, learn_reference
from bayesid.diagnosis.changes.scales import DISPERSIONS, WANDER_FACTORS
from bayesid.diagnosis.changes.selection import Accepted, Scores, Selection, select
from bayesid.diagnosis.fit import outside, squared_distance
from bayesid.diagnosis.settings import DEFAULT, Settings
from bayesid.effects import Term
from bayesid.effects.bodies import Payload, body_of, split_matrix
from bayesid.errors import InputError
from bayesid.estimators.conic.problem import nearest_body
from bayesid.recordings.experiment import Experiment
from bayesid.robot.robot import Robot
from bayesid.rounding import HALF

#: Factor to which the smallest size is sought.
_PRECISION = 1.02


@dataclass(frozen=True)
class HiddenChange:
    """The smallest change of a kind that would have been named."""

    change: Hypothesis  # what it is
    #: Of its first parameter, the others in their typical proportion to it; infinite where these motions never show it.
    value: float


def smallest(selection: Selection, settings: Settings) -> tuple[HiddenChange, ...]:
    """Size that every change that was not found had to have; one for each kind and place.

    That is where it has the log evidence that is asked for, on average over noise.
    """
    marginals = [selection.marginal(factor=f) for f in WANDER_FACTORS]
    best: dict[str, HiddenChange] = {}
    for change in selection.every:
        if change.spec in {a.change.spec for a in selection.accepted} or change.far:  # a smaller mass is seen that far out
            continue
        needed = settings.accept + np.log(len(selection.forms[change.spec]))  # it is one of so many forms
        found = HiddenChange(change, _smallest(marginals, change, needed))
        if change.spec not in best or found.value < best[change.spec].value:
            best[change.spec] = found
    return tuple(best.values())


def _smallest(marginals: Sequence[Marginal], change: Hypothesis, needed: float) -> float:
    evidence = expected_gain(marginals, change, change.sizes * change.unit / change.sizes[0])
    low, high = 1e-6 * change.sizes[0] / change.unit, 1e3 * change.sizes[0] / change.unit
    if evidence(high) < needed:
        return float("inf")
    while high > _PRECISION * low:
        middle = float(np.sqrt(low * high))
        low, high = (low, middle) if evidence(middle) >= needed else (middle, high)
    return high


Verdict = Literal["named", "named_in_part", "ambiguous", "unknown", "nothing_missing"]


def confirmed(selection: Selection, errors: HeldOutErrors, settings: Settings) -> tuple[Accepted, ...]:
    """Changes that differ from zero and close some of the gap on held-out parts, with 95 % confidence.

    None is, where the tolerance alone predicts those parts clearly better. It may predict them as well: what is improbable, that
    friction doubled from one day to the next, is the evidence's to say.
    """
    if settings.nearly_all * errors.after > errors.tolerance:
        return ()
    fitted, out = amplitudes(selection.marginal()), []
    for a, own, low in zip(selection.accepted, selection.directions, errors.shares_low, strict=True):
        values, root = fitted.part(own)[a.change.columns], fitted.part_root(own)[a.change.columns]
        if low > 0.0 and outside(squared_distance(values, root @ root.T), a.change.root.shape[1], settings):
            out.append(a)
    return tuple(out)


def no_such_robot(recording: LaterRecording, errors: HeldOutErrors) -> np.ndarray:
    """Channels of which the recording's own fit leaves more, beside what the reference's leaves, than any dispersion allows (c,).

    What changed there is nothing that another robot with this model would read, such as two cables that were exchanged; unless it
    is friction that wanders within the recording, which its own fit does not have and the tolerance has.
    """
    return (recording.grown * np.minimum(errors.tolerated, 1.0)) ** 2 > DISPERSIONS[-1]


def verdict(selection: Selection, errors: HeldOutErrors, settings: Settings, more: bool) -> Verdict:
    """The verdict on changes that the data demand, from how they do on held-out parts.

    Without a change there is something unknown where the data demand one that held-out parts deny, or where, with what wanders
    within its tolerance, they are predicted worse than any dispersion allows; or where ``more`` is known to have changed,
    see `no_such_robot`.
    """
    named = confirmed(selection, errors, settings)
    if not named:
        unexplained = more or errors.tolerance > DISPERSIONS[-1] * errors.floor
        return "unknown" if selection.accepted or unexplained else "nothing_missing"
    if any(a.rivals for a in named):
        return "ambiguous"
    open_ = more or (np.isfinite(errors.closed) and errors.remainder > 1.0 - settings.nearly_all)
    return "named_in_part" if open_ or len(named) < len(selection.accepted) else "named"


@dataclass(frozen=True, eq=False)
class Value:
    """A parameter of a change."""

    #: Of the parameter, with the effect in front where it is not that of the change.
    name: str
    unit: str
    #: The change since the reference, and its standard deviation; nan where it is a shape that was held.
    value: float
    std: float
    before: float  # what it was in the reference; zero for what was not there


@dataclass(frozen=True, eq=False)
class NamedChange:
    """A change that is named."""

    found: Accepted  # what the data say of it
    values: tuple[Value, ...]  # its parameters
    #: Of the gap between reference and recording that it closes on held-out parts; lower end of its one-sided 95 % interval.
    share: float
    share_low: float
    #: What follows from the parameters of an effect that came, see `bayesid.effects.effect.Effect.derived`; or from one factor.
    derived: tuple[Value, ...] = ()

    @property
    def change(self) -> Hypothesis:
        """The hypothesis that is named."""
        return self.found.change

    @property
    def probability(self) -> float:
        """Against the rivals alone, all equally likely beforehand."""
        return float(1.0 / (1.0 + sum(np.exp(-lack) for _, lack in self.found.rivals)))


@dataclass(frozen=True, eq=False)
class ReferenceComparison:
    """What a comparison with a reference found."""

    #: Before and after.
    reference: Reference
    recording: LaterRecording
    #: Changes that the data demand, and how they do on held-out parts.
    selection: Selection
    errors: HeldOutErrors
    verdict: Verdict  # as in ``diagnosis.json``
    changes: tuple[NamedChange, ...]  # those that are named
    hidden: tuple[HiddenChange, ...]  # how large every other change had to be to be named
    terms: tuple[Term, ...]  # effects of the later recording: the reference's at their new values, then those that came
    settings: Settings = DEFAULT  # thresholds it was decided by
    #: Friction in no named change of which the 95 % interval lies beyond what it usually wanders, the most certain first.
    wandered: tuple[Value, ...] = ()

    @property
    def scores(self) -> Scores:
        """Log evidence of every change on its own, best first."""
        return self.selection.scores

    @property
    def described_by(self) -> str | None:
        """What the remainder goes with, in words; None where nothing stands out."""
        s = self.selection
        denied = [a.change.spec for a in s.accepted if a.change not in {c.change for c in self.changes}]
        if denied:
            return f"{', '.join(denied)}, which held-out parts deny"
        if s.factor > 1.0:
            return f"links and friction of all joints, {s.factor:g} times as far from the reference as is usual"
        return None


def compare_with_reference(
    before: Experiment,
    after: Experiment,
    channel: str | None = None,
    *,
    effects: Sequence[str] | None = None,
    motions: Sequence[str] | None = None,
    seed: int = 0,
    settings: Settings = DEFAULT,
) -> ReferenceComparison:
    """Find what changed between recordings of a robot in its known state and later.

    Channel and effects are by default those of ``before``, and motions of ``after`` those with role ``identification``; the
    seed is that of the bootstrap. An `InputError` where they are not of the same robot, or cannot be fitted.
    """
    learn = partial(learn_reference, before, channel, effects)
    return compare_with_learned(learn, after, motions=motions, seed=seed, settings=settings)


def compare_with_learned(
    learn: Callable[..., Reference],
    after: Experiment,
    *,
    motions: Sequence[str] | None = None,
    seed: int = 0,
    settings: Settings = DEFAULT,
) -> ReferenceComparison:
    """The same as `compare_with_reference`, for a reference that several recordings are compared with.

    ``learn`` gives what the reference says, at its own bandwidth or the one given [Hz]. Both are smoothed to the lower of the
    bandwidths that each of them would choose: where one of them shows no motion, what its regressor holds there is encoder
    noise.
    """
    reference = learn()
    lower = chosen_bandwidth(reference, after, motions)
    if lower < reference.problem.smoother.bandwidth:
        reference = learn(lower)
    recording = read_recording(reference, after, motions)
    try:
        selection = select(reference, recording, settings)
        errors = held_out_errors(selection, recording, settings, seed)
    except np.linalg.LinAlgError:  # weights without bound
        said = "its own fit leaves next to nothing of some readings, so that what a change leaves has no measure; record longer"
        raise InputError(f"experiment {after.name}: {said}") from None
    decided = verdict(selection, errors, settings, bool(no_such_robot(recording, errors).any()))
    named = confirmed(selection, errors, settings)
    free = selection.for_values
    fitted = amplitudes(free.marginal())
    estimates = _estimates(reference.robot, free, fitted)
    each = zip(selection.accepted, free.accepted, estimates, errors.shares, errors.shares_low, strict=True)
    changes = tuple(
        NamedChange(a, _values(reference, b.change, *estimate), share, low, _derived(reference, b.change, *estimate))
        for a, b, estimate, share, low in each
        if a in named
    )
    return ReferenceComparison(
        reference, recording, selection, errors, decided, changes, smallest(selection, settings),
        (*_known_terms(reference, fitted), *_new_terms(changes)), settings, _wandered(reference, fitted, changes),
    )  # fmt: skip


def _wandered(reference: Reference, fitted: Amplitudes, changes: Sequence[NamedChange]) -> tuple[Value, ...]:
    """Friction that differs by more than it usually does, with 95 % confidence, and is in no change that is named.

    Offsets are left out: near zero they have no size of which they could differ by a share.
    """
    model, usual = reference.problem.row_model, reference.wanders(friction=True)
    first, count = model.base.rank, len(reference.solution)
    values, std = fitted.all[:count], np.sqrt(np.sum((fitted.directions[:count] @ fitted.root) ** 2, axis=1))
    far = np.flatnonzero((usual > 0.0) & (np.abs(values) - HALF * std > HALF * usual))
    named = {k for c in changes if c.change.known for k in c.change.columns.tolist()}
    free = model.of_free((e, f"{e.spec}.{n}", u) for e in model.effects for n, u in zip(e.parameters, e.units, strict=True))
    far = sorted((k for k in set(far.tolist()) - named if free[k - first][0].part_of), key=lambda k: std[k] / abs(values[k]))
    return tuple(Value(*free[k - first][1:], float(values[k]), float(std[k]), float(reference.solution[k])) for k in far)


def _estimates(robot: Robot, selection: Selection, fitted: Amplitudes) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Amplitudes (k,) of every change and their covariance (k, k).

    What was attached or taken away is a body that can exist, in its joint's frame: columns are in that of the body it hangs on.
    """
    for a, own in zip(selection.accepted, selection.directions, strict=True):
        mean, root = fitted.part(own)[a.change.columns], fitted.part_root(own)[a.change.columns]
        covariance = root @ root.T
        if isinstance(a.change.effects[0], Payload):
            sign = np.copysign(1.0, mean[0])
            to_joint = split_matrix(robot, body_of(robot, a.change.effects[0].joint))
            mean = to_joint @ (sign * nearest_body(sign * mean, covariance))
            covariance = to_joint @ covariance @ to_joint.T
        yield mean, covariance


def _values(reference: Reference, change: Hypothesis, mean: np.ndarray, covariance: np.ndarray) -> tuple[Value, ...]:
    """Parameters of a change."""
    std = np.sqrt(np.diag(covariance))
    before = reference.solution[change.columns] if change.known else np.zeros(len(mean))
    proposal = change.proposal
    if change.together:  # columns of one amplitude
        factor, std = mean[0] / change.sizes[0], np.sqrt(covariance[0, 0]) / abs(change.sizes[0])
        return (Value("factor", "1", float(factor), float(std), 1.0),)
    if proposal is None:
        each = zip(change.parameters, mean, std, before, strict=True)
        return tuple(Value(n, u, float(v), float(s), float(b)) for (n, u), v, s, b in each)
    amplitude = np.zeros(len(proposal.active))
    spread = np.full(len(proposal.active), np.nan)
    amplitude[proposal.active], spread[proposal.active] = mean, std
    values = np.atleast_2d(proposal.about.to_values(amplitude))[0]
    plain = np.isclose(values, amplitude)  # an amplitude that is the value itself, so that its spread is the value's, too
    spread[~plain] = np.nan
    names, units = change.effects[0].parameters, change.effects[0].units
    return tuple(Value(n, u, float(v), float(s), 0.0) for n, u, v, s in zip(names, units, values, spread, strict=True))


def _derived(reference: Reference, change: Hypothesis, mean: np.ndarray, covariance: np.ndarray) -> tuple[Value, ...]:
    """What follows from the parameters of an effect that came at one place and has no shape, or from one factor."""
    if change.together:
        model = reference.problem.row_model
        named = model.of_free((f"{e.name}.{n}", u) for e in model.effects for n, u in zip(e.parameters, e.units, strict=True))
        own = [named[k - model.base.rank] for k in change.columns]
        each = zip(own, mean, np.sqrt(np.diag(covariance)), reference.solution[change.columns], strict=True)
        return tuple(Value(name, unit, float(v), float(s), float(b)) for (name, unit), v, s, b in each)
    effect, *others = change.effects
    if change.known or change.proposal is not None or others:
        return ()
    found = effect.derived(mean.tolist(), covariance)
    return tuple(Value(name, unit, value, std, 0.0) for name, value, std, unit in found)


def _known_terms(reference: Reference, fitted: Amplitudes) -> tuple[Term, ...]:
    """The model's effects at their values in the later recording."""
    model = reference.problem.row_model
    values = reference.point.values.copy()
    first, count = model.base.rank, len(reference.solution)
    values[model.free] += fitted.all[first:count]
    out, start = [], 0
    for effect in model.effects:
        out.append(Term(effect, tuple(values[start : start + len(effect.parameters)])))
        start += len(effect.parameters)
    return tuple(out)


def _new_terms(changes: Sequence[NamedChange]) -> tuple[Term, ...]:
    """Effects that came, one at every joint where all share a change."""
    out = []
    for c in changes:
        if c.change.known:
            continue
        values = [v.value for v in c.values]
        each = len(c.change.effects[0].parameters)
        for k, effect in enumerate(c.change.effects):
            own = values[k * each : (k + 1) * each]
            out.append(Term(effect, (*own, *[0.0] * (each - len(own)))))
    return tuple(out)
