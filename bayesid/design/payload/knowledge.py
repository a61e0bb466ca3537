"""Where a payload is known from: a sensor that carries it alone, a nominal model that is trusted, or a recording without it.

**A sensor** in the wrist weighs what is beyond it and nothing else: the base parameters of its wrench are combinations of that
one body's ten parameters, ``b = K p``.

A cable without length may trade weight for its own. It pulls a point p of the payload with ``k (a - x)``. Its share ``k a_z`` is
a constant force along gravity, as weight is: a mass that is larger by d with a first moment larger by ``d p``, and an anchor that
is higher by ``d g / k``, read the same in every pose. Only the cable's length tells them apart, and that by little. The sum of
squares then has a valley, flat and as long as anchors may be high, along which a linearised standard deviation says nothing. So
the mass is held at values m on both sides, all else is fitted, and those of

    chi2(m) - min chi2 <= t^2 f

are what the readings do not contradict [Venzon1988]_: t is half a central interval in standard deviations, f the variance of what
is left, enlarged as Student's quantile for few poses asks (`bayesid.signals.noise.student_factor`). All other parameters follow
the mass along the valley, and scatter about it as they do with the mass known: ``theta = theta(m) + e``, ``V = V_m + s^2 v v'``,
v the valley's direction, s the mass's interval over 2 t.

**A nominal model** with links ``phi_0`` and errors of covariance P. What is attached to link n adds to its parameters:
``b - K phi_0 = K_n p + K (phi - phi_0)``, so that p is known with the covariance ``V + K P K'``.

**A recording without it** makes a prior of everything but the payload (`bayesid.diagnosis.changes`): p is what changed on that
link.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bayesid.arguments import argument
from bayesid.design.payload.body import BodyKnowledge
from bayesid.diagnosis.changes.evidence import amplitudes
from bayesid.diagnosis.changes.findings import ReferenceComparison
from bayesid.diagnosis.changes.hypotheses import Hypothesis
from bayesid.diagnosis.changes.selection import Accepted
from bayesid.dynamics.base_parameters import structural_base
from bayesid.effects.bodies import Payload
from bayesid.effects.families import LoadEffect
from bayesid.errors import InputError
from bayesid.estimators import Estimate
from bayesid.estimators.exact_rows import ExactRows
from bayesid.recordings.experiment import Experiment
from bayesid.regression.problem import Problem, relinearised
from bayesid.robot.prior import Prior, assumed_links, guessed_bodies
from bayesid.robot.robot import Robot, joint_index, load_robot
from bayesid.rounding import HALF
from bayesid.signals.noise import student_factor

#: Ends of the names of URDF links that are a flange, in whose frame controllers want a payload, the most certain first.
FLANGES = ("tool0", "_link8", "flange")
#: Share of the prior's variance that recordings leave where they say nothing.
_LEFT = 0.5


def carrying_joint(robot: Robot, joint: str | None) -> int:
    """Index of the joint whose link carries the payload; default the last of the chain, which must have one end."""
    names = robot.joint_names
    if joint is not None:
        if (at := joint_index(joint, names)) is None:
            raise InputError(f"{argument('joint', joint)}: no such joint; choose one of {', '.join(names)}")
        return at
    ends = [k for k in range(robot.n) if k not in robot.parent]
    if len(ends) != 1:
        listed = ", ".join(names[k] for k in ends)
        raise InputError(
            f"the robot has {len(ends)} ends ({listed}): name the joint whose link carries the payload, {argument('joint')}"
        )
    return ends[0]


def weighed_alone(experiment: Experiment, channel: str) -> int | None:
    """Index of the body that a sensor in the arm carries; None where no sensor does, an `InputError` where it carries several."""
    sensor, robot = experiment.sensor, experiment.robot
    if channel != "wrench" or sensor is None or sensor.joint is None:
        return None
    carried = np.flatnonzero(robot.sensor_bodies)
    if len(carried) > 1:
        moving = ", ".join(robot.joint_names[k] for k in robot.body_joint[carried] if k != robot.sensor_parent)
        raise InputError(
            f"experiment.toml: [sensor] joint '{sensor.joint}' carries {len(carried)} bodies that move against each other: keep "
            f"{moving} still and write them into [robot] locked instead of joints"
        )
    return int(carried[0])


def from_sensor(problem: Problem, estimate: Estimate, body: int) -> BodyKnowledge:
    """What a fit to the wrench of a sensor says of the one body that it carries, in that body's frame."""
    rank, own = estimate.base.rank, estimate.base.matrix[:, 10 * body : 10 * body + 10]
    if (open_problem := with_valley(problem)) is not None:
        return BodyKnowledge.of(own, *along_mass(open_problem, estimate, np.linalg.pinv(own)[0]))
    shown = np.flatnonzero(~estimate.undetermined[:rank])
    return BodyKnowledge.of(own[shown], estimate.values[shown], estimate.stated_covariance()[np.ix_(shown, shown)])


def from_nominal(problem: Problem, estimate: Estimate, body: int, rel_std: float) -> tuple[BodyKnowledge, float | None]:
    """What a fit says of a payload beside nominal links, and the share of the mass's variance that these contribute.

    None where the data do not show the mass. ``rel_std`` is the prior relative standard deviation of the nominal links; 0: they
    are exact.
    """
    base = estimate.base
    shown = ~estimate.undetermined[: base.rank]
    matrix, robot = base.matrix[shown], problem.experiment.robot
    guessed = guessed_bodies(robot) & (rel_std > 0)
    guessed[body] = False  # what this link holds beyond its URDF is the payload
    links = np.where(guessed[:, None], assumed_links(robot), robot.nominal)
    noise = estimate.stated_covariance()[: base.rank, : base.rank][np.ix_(shown, shown)]
    doubt = np.zeros_like(noise) if rel_std == 0 else matrix @ Prior.around(links, rel_std, guessed).covariance @ matrix.T
    own, values = matrix[:, 10 * body : 10 * body + 10], estimate.values[shown] - matrix @ links.ravel()
    known = BodyKnowledge.of(own, values, noise + doubt)
    exact = BodyKnowledge.of(own, values, noise)
    if not known.shown[0]:
        return known, None
    return known, float(1.0 - min(exact.covariance[0, 0] / known.covariance[0, 0], 1.0))


def named_payload(comparison: ReferenceComparison, joint: int) -> tuple[Accepted, Hypothesis, float] | None:
    """The change that is named and is a payload on a joint's link, or that one explains as well: with its form and log evidence.

    None where there is none.
    """
    where = f"joint{joint + 1}"
    changes = [c.found for c in comparison.changes]
    each = [(a, h, a.evidence - lack) for a in changes for h, lack in ((a.change, 0.0), *a.rivals) if _is_payload(h, where)]
    return max(each, key=lambda x: x[0].change is x[1], default=None)


def from_reference(comparison: ReferenceComparison, joint: int, alone: bool = False) -> tuple[BodyKnowledge, float]:
    """What changed on a joint's link since a reference, and the log evidence that something did.

    With what else changed in the model, or ``alone``.

    A payload that explains the recording as well as a change that is named stands in its place, see `named_payload`. Where the
    comparison names no payload there, one is taken into the model all the same: then the interval says how large a payload may be
    that these recordings do not show.
    """
    s = comparison.selection
    where = f"joint{joint + 1}"
    if (found := named_payload(comparison, joint)) is not None:
        instead, form, evidence = found
    else:
        instead = next((a for a in s.accepted if _is_payload(a.change, where)), None)
        form, evidence = (instead.change, instead.evidence) if instead else next(x for x in s.beyond if _is_payload(x[0], where))
    beside = () if alone else tuple(a for a in s.accepted if a is not instead)
    s = replace(s, accepted=(*beside, Accepted(form, 1.0, evidence))).for_values
    whole = s.accepted[-1].change
    own, columns = s.directions[-1], whole.columns
    fitted = amplitudes(s.marginal())
    root, prior = fitted.part_root(own)[columns], whole.sizes
    covariance = root @ root.T
    # Of a parameter of which the recordings leave most of the prior's variance they say nothing: the value is the prior's.
    open_ = np.diag(covariance) > _LEFT * prior**2
    covariance[open_] = covariance[:, open_] = 0.0
    return BodyKnowledge(fitted.part(own)[columns], covariance, np.eye(10)[:, open_]), evidence


def of_any_motion(problem: Problem, body: int) -> BodyKnowledge:
    """What the richest motion of the robot would show of a body to these readings, in its frame: ``hidden`` no motion shows."""
    model = problem.row_model
    base = structural_base(model.robot, model.channels, offset=model.base.absorbed is not None)
    return BodyKnowledge.of(base.matrix[:, 10 * body : 10 * body + 10], np.zeros(base.rank), np.eye(base.rank))


def in_frame(known: BodyKnowledge, experiment: Experiment, body: int, frame: str | None) -> tuple[BodyKnowledge, str]:
    """The same in the frame of a URDF link that is fixed to the body, and that link's name.

    Default is the flange, where the URDF has a link of such a name (`FLANGES`), else the body's own frame; this also where the
    mass is not known, as first moments in any other frame hold the mass, too. An `InputError` where there is no such link, or it
    does not move with the body.
    """
    robot = experiment.robot
    urdf = robot.description
    above = {j.child: j.name for j in urdf.joints.values()}
    joint = int(robot.body_joint[body])
    own = robot.body_names[body]

    def place(link: str) -> tuple[np.ndarray, np.ndarray] | None:
        # A sensor in the joint above a link sits where the link does.
        at = load_robot(robot.description, robot.joint_names, experiment.locked, sensor_joint=above[link])
        return (at.sensor_rotation, at.sensor_translation) if at.sensor_parent == joint else None

    if frame is None:
        flanges = FLANGES if known.shown[0] else ()
        found = [link for end in flanges for link in above if link.endswith(end) and place(link) is not None]
        if not found:
            return known, urdf.joints[own].child
        frame = found[0]
    if frame not in above:
        raise InputError(f"{argument('frame', frame)}: {robot.urdf.name} has no such link; choose one of {', '.join(above)}")
    placed = place(frame)
    if placed is None:
        raise InputError(f"{argument('frame', frame)}: this link does not move with '{own}', which carries the payload")
    in_joint = known.moved(robot.body_rotation[body], robot.body_translation[body])
    rotation, translation = placed
    return in_joint.moved(rotation.T, -rotation.T @ translation), frame


def _is_payload(change: Hypothesis, where: str) -> bool:
    return change.name == Payload.name and change.where == where


#: First step along the mass as a share of it, at least and at most; how each next one grows; most steps each way.
_FIRST, _GROWTH, _STEPS = (1e-4, 0.05), 1.7, 20
#: The search goes on this far above the level: beyond a ridge there may be another valley.
_ABOVE = 30.0
#: A valley is another one where it is lower by this, and how often the search begins again there.
_LOWER, _ROUNDS = 0.1, 3
#: Steps towards where the profile crosses the level, and how near to that is enough, in standard deviations.
_CROSSINGS, _NEAR = 12, 0.02


@dataclass(frozen=True, eq=False)
class ProfilePoint:
    """A point of the profile: the mass, what is least with it held, and where."""

    mass: float
    chi2: float
    at: np.ndarray


@dataclass(eq=False)
class HeldCombination:
    """Sums of squares with a combination of the base parameters held."""

    exact: ExactRows  # of a fit to readings that are not linear in its effects
    slope: np.ndarray  # the combination that is held (p,), of base parameters alone

    def __post_init__(self):
        self.low, self.high = self.exact.bounds
        pivot = int(np.argmax(np.abs(self.slope)))
        self.kept = np.arange(len(self.slope)) != pivot
        # All parameters from those that are kept: theta = basis z + offset m.
        self.basis = np.eye(len(self.slope))[:, self.kept]
        self.basis[pivot] = -self.slope[self.kept] / self.slope[pivot]
        self.offset = np.where(self.kept, 0.0, 1.0 / self.slope[pivot])

    def least(self, mass: float, start: np.ndarray) -> ProfilePoint:
        """The least sum of squares with the mass held, from a start or from where its tangent leads, whichever is lower."""
        along = self._inverse(start) @ self.slope
        ahead = start + along * (mass - self.slope @ start) / (self.slope @ along)
        tried = [np.clip(x, self.low, self.high) for x in (start, ahead)]
        heights = [np.sum(self.exact.rows(self.basis @ x[self.kept] + self.offset * mass)[0] ** 2) for x in tried]
        at, chi2 = self.exact.least(tried[int(np.argmin(heights))], self.kept, self.basis, self.offset * mass)
        return ProfilePoint(float(self.slope @ at), chi2, at)

    def free(self) -> ProfilePoint:
        """The least sum of squares with nothing held, in the valley of the fit."""
        at, _ = self.exact.least(self.exact.start)
        return self.least(max(float(self.slope @ at), 0.0), at)

    def variance(self, at: np.ndarray) -> float:
        """Variance of the mass by white noise, linearised."""
        return float(self.slope @ self._inverse(at) @ self.slope)

    def _inverse(self, at: np.ndarray) -> np.ndarray:
        """Inverse of the normal matrix at a point (p, p)."""
        return _normal_inverse(self.exact.rows(at)[1])

    def covariance(self, at: np.ndarray) -> np.ndarray:
        """Covariance of all parameters beside the mass, by white noise (p, p); those at their bounds are known."""
        inside = ((at > self.low + 1e-6) & (at < self.high - 1e-6))[self.kept]
        basis = self.basis[:, inside]
        return basis @ _normal_inverse(self.exact.rows(at)[1] @ basis) @ basis.T


def _normal_inverse(x: np.ndarray) -> np.ndarray:
    """``(X'X)^+`` (p, p) of columns (n, p) of any units."""
    size = np.maximum(np.linalg.norm(x, axis=0), 1e-300)
    return np.linalg.pinv((x / size).T @ (x / size), rcond=1e-12) / np.outer(size, size)


def with_valley(problem: Problem) -> Problem | None:
    """The problem of poses with a load whose shape is estimated, so that it may trade weight for its own; None without such.

    Shapes that a fit ran away with are estimated in it, too: what the readings leave open is for the profile to say.
    """
    point = problem.row_model.point
    if point is None or not problem.at_rest:
        return None
    free = point.free if point.unsettled is None else point.free | point.unsettled
    if not free.all() or not any(isinstance(e, LoadEffect) and len(e.shape) > 1 for e in problem.row_model.effects):
        return None
    return problem if point.free.all() else relinearised(problem, replace(point, free=free, unsettled=None))


def along_mass(problem: Problem, estimate: Estimate, slope: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Base parameters (r,) and covariance (r, r) by which the mass's interval is where the readings do not contradict it.

    ``slope`` gives the mass from the base parameters (r,), the ``estimate`` the noise.
    """
    rank, any_noise = len(slope), next(iter(estimate.noise.values()))
    std = {block.group: estimate.noise.get(block.group, any_noise).std for block in problem.regression.rows.pilot()}
    exact = ExactRows(problem, std)
    held = HeldCombination(exact, np.concatenate([slope, np.zeros(len(exact.start) - rank)]))
    known = [held.free()]
    for _ in range(_ROUNDS):  # from the lowest point so far, until none is lower
        first = min(known, key=lambda p: p.chi2)
        known = [first, *_outwards(held, first, -1.0), *_outwards(held, first, 1.0)]
        if min(known, key=lambda p: p.chi2).chi2 > first.chi2 - _LOWER:
            break
    known.sort(key=lambda p: p.mass)
    best = min(known, key=lambda p: p.chi2)
    # Noise that was estimated in another valley is another one.
    size = best.chi2 / max(len(held.exact.rows(best.at)[0]) - len(best.at), 1)
    factor = size * max(float(student_factor(noise.degrees)) for noise in estimate.noise.values())
    level = HALF**2 * factor
    within = [k for k, p in enumerate(known) if p.chi2 <= best.chi2 + level]
    low, high = (
        _crossing(held, known[k], known[k + way] if 0 <= k + way < len(known) else None, best.chi2, level)
        for k, way in ((within[0], -1), (within[-1], 1))
    )
    width = max(high.mass - low.mass, 1e-12)
    along = (high.at - low.at)[:rank] / width
    middle = 0.5 * (low.mass + high.mass)
    covariance = factor * held.covariance(best.at)[:rank, :rank] + (0.5 * width / HALF) ** 2 * np.outer(along, along)
    return best.at[:rank] + along * (middle - best.mass), covariance


def _outwards(held: HeldCombination, first: ProfilePoint, way: float) -> list[ProfilePoint]:
    """Points of the profile one way from the first, until the sum of squares is well above the level."""
    known, now, size = [first], first, max(abs(first.mass), 0.01)
    step = float(np.clip(0.5 * np.sqrt(held.variance(first.at)), _FIRST[0] * size, _FIRST[1] * size))
    for _ in range(_STEPS):
        mass = max(now.mass + way * step, 0.0)  # there is no body below
        if way * (mass - now.mass) <= 0.0:
            break
        now = held.least(mass, now.at)
        known.append(now)
        step *= _GROWTH
        if now.chi2 > min(p.chi2 for p in known) + HALF**2 + _ABOVE:
            break
    return known[1:]


def _crossing(held: HeldCombination, inner: ProfilePoint, outer: ProfilePoint | None, least: float, level: float) -> ProfilePoint:
    """Where the profile crosses the level between a point below it and one above; the inner one where there is none above."""
    if outer is None:
        return inner

    def height(p: ProfilePoint) -> float:  # linear in the mass where the profile is a parabola
        return float(np.sqrt(max(p.chi2 - least, 0.0)) - np.sqrt(level))

    below, above = height(inner), height(outer)
    for _ in range(_CROSSINGS):
        share = np.clip(below / (below - above), 0.05, 0.95)
        tried = held.least(inner.mass + float(share) * (outer.mass - inner.mass), inner.at)
        now = height(tried)
        if abs(now) < _NEAR:
            return tried
        if now < 0.0:
            inner, below = tried, now
        else:
            outer, above = tried, now
    return inner
