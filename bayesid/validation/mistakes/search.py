"""Look for a mistake: which change of the data would let a robot that can exist explain them, how much better, and what to do."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from bayesid.errors import InputError
from bayesid.recordings.experiment import Experiment
from bayesid.regression.parallel import one_blas_thread
from bayesid.regression.readings import make_channels
from bayesid.robot.robot import Robot
from bayesid.validation.mistakes.candidates import Candidate, Mistake, candidates, link_placement, signs
from bayesid.validation.mistakes.evidence import (
    AS_RECORDED,
    EXPLAINED,
    NEEDED,
    UNEXPLAINED,
    WORSE,
    Explainer,
    RobotFit,
    independent_samples,
)
from bayesid.validation.mistakes.from_data import (
    by_joint,
    implausible_size,
    orders,
    other_zeros,
    tilted,
    unlike_nominal,
    weight_carried,
)
from bayesid.validation.mistakes.samples import low_passed
from bayesid.validation.mistakes.shifts import delayed, zeros_moved

_LISTED = 3
#: A link that is this far away in one of two poses is told from the other by eye [m].
_VISIBLE = 0.05
#: Candidates whose evidence is this close cannot be told apart: odds of 150 [nats].
ALIKE = 5.0
#: A channel explained better than this share of its variation gives no cause to doubt its joint.
_DOUBTED = 0.05
#: Torques with these undone may still be in another unit.
_SIGNS = ("torque_sign", "torque_signs", "position_signs")


def worded(
    experiment: Experiment, explainer: Explainer, null: RobotFit, alike: Sequence[tuple[Candidate, RobotFit]], evidence: float
) -> Mistake:
    """A mistake in words, by ``evidence`` [nats] over ``null``, the best robot for the data as they are.

    ``alike`` are candidates that explain the data as well, each with its robot; the first is named, the others beside it.
    """
    first, fit = alike[0]
    k = int(np.argmax(null.left / np.maximum(fit.left, explainer.floor)))
    column, unit = explainer.channels.names[k], explainer.channels.units[k]
    before, after = (f"{one.left[k]:.2g}" for one in (null, fit))
    gain = f"what no possible robot explains of {column} falls from {before} to {after} {unit} rms"
    if before == after and fit.family > null.family:  # fewer numbers explain as much
        gain = f"the URDF's bodies, each times a factor, leave {after} {unit} rms of {column}; as recorded, only other bodies do"
    text = f"{first.says[0].upper()}{first.says[1:]}: with that undone, {gain}; {first.remedy}"
    others = [f"{c.says} ({c.remedy})" for c, _ in alike[1 : _LISTED + 1]]
    if others:
        more = f"; or {len(alike) - 1 - _LISTED} more" if len(alike) > _LISTED + 1 else ""
        text += f". As likely: {'; or '.join(others)}{more}. {_decided_by(experiment, explainer, alike)}"
    return Mistake(
        name=first.name, where=first.where, text=text, channel=explainer.channel,
        evidence=float(evidence), before=tuple(map(float, null.left)), after=tuple(map(float, fit.left)),
        alternatives=tuple((c.name, c.where) for c, _ in alike[1:]),
    )  # fmt: skip


def not_explained(explainer: Explainer, null: RobotFit, best: RobotFit) -> Mistake:
    """That no robot explains the data, nor any mistake that is known, although some would let them be more probable."""
    what, left = "joint torques" if explainer.torque else "wrench", null.left
    k = int(np.argmax(left / np.maximum(explainer.variation, explainer.floor)))
    names, units = explainer.channels.names, explainer.channels.units
    text = (
        f"No possible robot explains the {what}: {left[k]:.2g} {units[k]} rms of {names[k]} are left, which varies by "
        f"{explainer.variation[k]:.2g}, and no mistake of sign, order, unit or frame that is known here mends it; look at the "
        "joints' order and zeros, at the sensor's frame, and whether all columns have one clock"
    )
    return Mistake("not_explained", "", text, explainer.channel, 0.0, tuple(map(float, left)), tuple(map(float, best.left)))


def _decided_by(experiment: Experiment, explainer: Explainer, alike: Sequence[tuple[Candidate, RobotFit]]) -> str:
    """What is known to whoever made the recording and tells candidates apart that the data do not."""
    joints = [c.change.joints for c, _ in alike]
    if any(j is not None for j in joints):
        return f"The data cannot tell; {_pose(experiment, next(j for j in joints if j is not None))}"
    centres = [_centre(explainer.robot, fit) for _, fit in alike]
    if not explainer.torque and explainer.robot.sensor_bodies.sum() == 1:
        places = " or ".join(dict.fromkeys(centres))
        if len(set(centres)) > 1:
            return f"The data cannot tell; the load's centre of mass can: it comes out at {places} m in its link's frame"
    if any(c.change.gravity is not None for c, _ in alike):
        return "The data cannot tell; how the base is mounted can"
    return "The data cannot tell; a reading under a known weight can"


def _pose(experiment: Experiment, joints: np.ndarray) -> str:
    """Where the positions as recorded put the robot, and where those of a candidate do, when they are furthest apart."""
    motion, robot = experiment.identification[0], experiment.robot
    rows = slice(None, None, max(len(motion.table) // 200, 1))
    times, positions = motion.table.times[rows], motion.table.positions[rows]
    apart, best = 0.0, None
    for link in range(robot.n):
        here, there = (link_placement(robot, link, q)[1] for q in (positions, positions @ joints.T))
        distance = np.linalg.norm(here - there, axis=1)
        if distance.max() > max(apart, _VISIBLE):
            k = int(distance.argmax())
            apart, best = float(distance[k]), (link, k, here[k], there[k])
    if best is None:
        return "turn a joint by hand: its position must grow about the axis that the URDF gives it"
    link, k, here, there = best
    return (
        f"a look at the robot can: at {times[k]:.3g} s of '{motion.name}' the origin of {robot.joint_names[link]} stands at "
        f"{_vector(here)} m in the base frame if the positions are right, and at {_vector(there)} m if they are not"
    )


def _centre(robot: Robot, fit: RobotFit) -> str:
    body = int(np.argmax(robot.sensor_bodies)) if robot.sensor_bodies.any() else 0
    mass, *moment = fit.parameters[10 * body : 10 * body + 4]
    return _vector(np.array(moment) / mass) if mass > 0.0 else "?"


def _vector(values: np.ndarray) -> str:
    return f"({', '.join(f'{v + 0.0:.2f}' for v in values)})"


@dataclass(frozen=True, eq=False)
class Tried:
    """A candidate, its log evidence against the data as they are [nats], and the best robot with it undone."""

    candidate: Candidate
    evidence: float
    fit: RobotFit


class MistakeSearch:
    """Candidates that were tried on the readings of a channel."""

    def __init__(self, explainer: Explainer) -> None:
        self.explainer = explainer
        unchanged = explainer.fit()
        #: How many independent samples the readings are worth.
        self.worth = independent_samples(unchanged[0].residual, explainer.samples.part)
        self.null = max(unchanged, key=self._score)  # the best robot for the data as they are
        self.needed = max(NEEDED, self.worth * WORSE)  # evidence that a mistake needs [nats]
        stated, n = unchanged[-1], explainer.robot.n
        unexplained = (stated.left > _DOUBTED * explainer.variation) & (stated.left > explainer.floor)
        #: Joints whose readings are not explained by the nominal bodies (n,).
        self.doubted = np.full(n, (stated.left > EXPLAINED * explainer.variation).any())
        if explainer.torque:
            self.doubted[explainer.channels.joint] = unexplained
        self.tried: list[Tried] = []  # the usual mistakes first

    @property
    def best(self) -> Tried | None:
        """The likeliest candidate so far."""
        return max(self.tried, key=lambda t: t.evidence, default=None)

    @property
    def worth_going_on(self) -> bool:
        """Whether any explanation could have the evidence that is needed, and more than what was tried."""
        least = max(self.needed, self.best.evidence if self.best else 0.0)
        return self.explainer.highest_score(None, self.worth) - self._score(self.null) > least

    def try_out(self, every: Iterable[Candidate]) -> None:
        """Fit robots with each candidate undone, but for those that could be neither named nor listed beside what is."""
        now = self._score(self.null)
        known = {(t.candidate.name, t.candidate.where) for t in self.tried}
        new = [c for c in every if self.doubted[list(c.touched)].all() and (c.name, c.where) not in known]
        bounds = [(self.explainer.highest_score(c.change, self.worth) - now + c.odds, c) for c in new]
        fitted: dict[int, Tried] = {}
        best = self.best.evidence if self.best else 0.0
        for k in sorted(range(len(bounds)), key=lambda k: -bounds[k][0]):
            highest, candidate = bounds[k]
            if highest < max(NEEDED, max(self.needed, best) - ALIKE):
                break
            fit = max(self.explainer.fit(candidate.change), key=self._score)
            fitted[k] = Tried(candidate, self._score(fit) - now + candidate.odds, fit)
            best = max(best, fitted[k].evidence)
        self.tried += [fitted[k] for k in sorted(fitted)]

    def _score(self, fit: RobotFit) -> float:
        return fit.score(self.worth)


def find_mistakes(experiment: Experiment) -> tuple[Mistake, ...]:
    """Mistakes of signs, orders, units and frames that would explain what no robot can do; usually none.

    Gravity, masses, friction and power have signs: a robot that can exist, with friction that brakes, does not explain readings
    of which one has the wrong sign. Every candidate is undone in turn and the best such robot is fitted to a few hundred
    low-passed samples; one is named where the data become far more probable by it, and are explained by it. Where they only
    become more probable, ``not_explained`` says so, without a remedy. Nothing is guessed where a finding about the recording
    explains its readings (`bayesid.recordings.complaints`), nor what is less probable than that they are late against the
    motion (`bayesid.validation.mistakes.shifts`).
    """
    found: list[Mistake] = []
    explained = {channel for finding in experiment.findings for channel in finding.silences}
    with one_blas_thread():
        for channel in ("wrench", "torque"):
            if channel in explained or (channel == "wrench" and experiment.sensor is None):
                continue
            try:
                with np.errstate(over="ignore", invalid="ignore"):
                    late, guessed = delayed(experiment, channel), _in_channel(experiment, channel)
                if late is not None:
                    guessed = [m for m in guessed if m.evidence > late.evidence]
                    found += [] if any(np.isfinite(m.evidence) for m in guessed) else [late]
                found += guessed
                found += zeros_moved(experiment) if channel == "wrench" else []
            except (InputError, np.linalg.LinAlgError, ValueError, RuntimeError):
                # Too short or too uneven to be smoothed, or numbers of a size that no robot has: others say that better.
                continue
    found.sort(key=lambda m: -m.evidence)
    return tuple({(m.name, m.where): m for m in reversed(found)}.values())[::-1]


def unlike_urdf(experiment: Experiment) -> str | None:
    """Say that joint torques are of another size than the URDF's masses need, where `find_mistakes` finds none; mostly None."""
    if any("torque" in finding.silences for finding in experiment.findings):
        return None
    try:
        with one_blas_thread():
            explainer = _explainer(experiment, "torque")
            return None if explainer is None else unlike_nominal(explainer)
    except (InputError, np.linalg.LinAlgError, ValueError, RuntimeError):
        return None  # as there


def _in_channel(experiment: Experiment, channel: str) -> list[Mistake]:
    explainer = _explainer(experiment, channel)
    return [] if explainer is None else [*_named(experiment, searched(experiment, explainer)), *weight_carried(explainer)]


def _explainer(experiment: Experiment, channel: str) -> Explainer | None:
    """What fits robots to the readings of a channel; None where there are not enough."""
    samples = low_passed(experiment, channel)
    return None if samples is None else Explainer(experiment.robot, make_channels(experiment, channel), samples)


def _named(experiment: Experiment, search: MistakeSearch) -> list[Mistake]:
    """The likeliest mistake, and another size than that of a robot where signs are all that is wrong beside it."""
    best, explainer = search.best, search.explainer
    if best is None or best.evidence < search.needed:
        # Of readings that no robot explains at all, not even the size means anything.
        explained = np.median(search.null.left / explainer.variation) < 0.5
        return implausible_size(explainer) if explained else []
    alike = [t for t in search.tried if t.evidence > max(best.evidence - ALIKE, NEEDED)]
    # What was made to suit the data is said where nothing else suits them as well.
    alike = [t for t in alike if not t.candidate.change.numbers] or alike
    mended = [explainer.mended(t.candidate.change, search.worth, ALIKE) for t in alike]
    remedies = [t for t, is_mended in zip(alike, mended, strict=True) if is_mended]
    if not remedies:
        unexplained = (search.null.left**2 > UNEXPLAINED * explainer.variation**2).any()
        return [not_explained(explainer, search.null, best.fit)] if unexplained and False in mended else []
    found = worded(experiment, explainer, search.null, [(t.candidate, t.fit) for t in remedies], remedies[0].evidence)
    change = remedies[0].candidate.change
    return [found, *(implausible_size(explainer, change) if found.name in _SIGNS else [])]


def searched(experiment: Experiment, explainer: Explainer) -> MistakeSearch:
    """Every candidate tried that could matter."""
    search = MistakeSearch(explainer)
    search.try_out(candidates(experiment, explainer.channel, explainer.samples))
    if search.worth_going_on:
        search.try_out(_several_signs(search))
    if search.worth_going_on:
        search.try_out(orders(explainer, search.doubted))
    if search.worth_going_on:
        search.try_out(other_zeros(explainer, search.worth, search.needed))
    if search.worth_going_on and explainer.torque:
        search.try_out(by_joint(explainer, search.worth))
    if search.worth_going_on:
        least = search.best.evidence - ALIKE if search.best else 0.0  # zeros of joints may explain as much as a wall
        mounts = [t.candidate.change for t in search.tried if t.candidate.name == "gravity_direction" and t.evidence > least]
        search.try_out(tilted(explainer, [AS_RECORDED, *mounts], search.worth))
    return search


def _several_signs(search: MistakeSearch) -> list[Candidate]:
    """Opposite signs of all joints of which each alone has the evidence of a mistake."""
    names, out = search.explainer.robot.joint_names, []
    measured = [int(j) for j in search.explainer.channels.joint] if search.explainer.torque else []
    for kind in ("torque", "position", "joint"):
        likely = {t.candidate.where for t in search.tried if t.candidate.name == f"{kind}_sign" and t.evidence > NEEDED}
        joints = [j for j in range(len(names)) if likely & {f"q{j + 1}", f"tau{j + 1}"}]
        if 1 < len(joints) < len(names if kind == "position" else measured):
            out.append(signs(names, measured, joints, kind))
    return out
