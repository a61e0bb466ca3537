"""Where a payload is known from: a sensor that carries it alone, a nominal model that is trusted, or a recording without it.

**A sensor** in the wrist weighs what is beyond it and nothing else: the base parameters of its wrench are combinations of that
one body's ten parameters, ``b = K p``.

Of a few poses the noise of each channel is known from few numbers. Intervals are Student's then, and as the channels share what
they weigh by estimated weights, the covariance is larger by ``1 + 4 (1 - 1/k) / nu`` with k = 3 channels of nu degrees of
freedom each [Meier1953]_.

**A nominal model** with links ``phi_0`` and errors of covariance P. What is attached to link n adds to its parameters:
``b - K phi_0 = K_n p + K (phi - phi_0)``, so that p is known with the covariance ``V + K P K'``.

**A recording without it** makes a prior of everything but the payload (`bayesid.diagnosis.changes`): p is what changed on that
link.
"""

from __future__ import annotations

from dataclasses import replace
from math import inf

import numpy as np

from bayesid.arguments import argument
from bayesid.design.payload.body import BodyKnowledge, half_interval
from bayesid.design.payload.likelihood import along_mass, has_valley
from bayesid.diagnosis.changes.evidence import amplitudes
from bayesid.diagnosis.changes.findings import ReferenceComparison
from bayesid.diagnosis.changes.hypotheses import Hypothesis
from bayesid.diagnosis.changes.selection import Accepted
from bayesid.dynamics.base_parameters import structural_base
from bayesid.effects.bodies import Payload
from bayesid.errors import InputError
from bayesid.estimators import Estimate
from bayesid.recordings.experiment import Experiment
from bayesid.regression.problem import Problem
from bayesid.robot.prior import Prior
from bayesid.robot.robot import Robot, load_robot

#: Ends of the names of URDF links that are a flange, in whose frame controllers want a payload, the most certain first.
FLANGES = ("tool0", "_link8", "flange")
#: Share of the prior's variance that recordings leave where they say nothing.
_LEFT = 0.5
#: What estimated weights of three channels add to the variance, times the degrees of freedom of each.
_WEIGHTS = 4.0 * (1.0 - 1.0 / 3.0)


def carrying_joint(robot: Robot, joint: str | None) -> int:
    """Index of the joint whose link carries the payload; default the last of the chain, which must have one end."""
    names = robot.joint_names
    if joint is not None:
        numbered = [f"joint{k + 1}" for k in range(robot.n)]
        if joint not in (*names, *numbered):
            raise InputError(f"{argument('joint', joint)}: no such joint; choose one of {', '.join(names)}")
        return names.index(joint) if joint in names else numbered.index(joint)
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
        moving = ", ".join(robot.joint_names[robot.body_joint[k]] for k in carried[1:])
        raise InputError(
            f"experiment.toml: [sensor] joint '{sensor.joint}' carries {len(carried)} bodies that move against each other: keep "
            f"{moving} still and write them into [robot] locked instead of joints"
        )
    return int(carried[0])


def from_sensor(problem: Problem, estimate: Estimate, body: int) -> BodyKnowledge:
    """What a fit to the wrench of a sensor says of the one body that it carries, in that body's frame."""
    base = estimate.base
    shown = ~estimate.undetermined[: base.rank]
    matrix = base.matrix[:, 10 * body : 10 * body + 10][shown]
    assert estimate.covariance is not None
    freedom = degrees_of_freedom(problem, estimate)
    weights = 1.0 + _WEIGHTS / freedom
    if has_valley(problem):
        own = base.matrix[:, 10 * body : 10 * body + 10]
        values, covariance = along_mass(problem, estimate, np.linalg.pinv(own)[0], half_interval(freedom), weights)
        return BodyKnowledge.of(own, values, covariance, freedom)
    return BodyKnowledge.of(matrix, estimate.values[shown], weights * estimate.covariance[np.ix_(shown, shown)], freedom)


def from_nominal(problem: Problem, estimate: Estimate, body: int, rel_std: float) -> tuple[BodyKnowledge, float]:
    """What a fit says of a payload beside nominal links, and the share of the mass's variance that these contribute.

    ``rel_std`` is the prior relative standard deviation of the nominal links; 0: they are exact.
    """
    base = estimate.base
    shown = ~estimate.undetermined[: base.rank]
    matrix, nominal = base.matrix[shown], problem.experiment.robot.nominal
    assert estimate.covariance is not None
    noise = estimate.covariance[np.ix_(shown, shown)]
    doubt = np.zeros_like(noise) if rel_std == 0 else matrix @ Prior.warped(nominal, rel_std).covariance @ matrix.T
    own, values = matrix[:, 10 * body : 10 * body + 10], estimate.values[shown] - matrix @ nominal.ravel()
    known = BodyKnowledge.of(own, values, noise + doubt)
    exact = BodyKnowledge.of(own, values, noise)
    return known, float(1.0 - min(exact.covariance[0, 0] / known.covariance[0, 0], 1.0))


def named_payload(comparison: ReferenceComparison, joint: int) -> tuple[Accepted, Hypothesis, float] | None:
    """The change that is named and is a payload on a joint's link, or that one explains as well: with its form and log evidence.

    None where there is none.
    """
    where = f"joint{joint + 1}"
    changes = [c.found for c in comparison.changes]
    each = [(a, h, a.evidence - lack) for a in changes for h, lack in ((a.change, 0.0), *a.rivals) if _is_payload(h, where)]
    return max(each, key=lambda x: x[0].change is x[1], default=None)


def from_reference(comparison: ReferenceComparison, joint: int) -> tuple[BodyKnowledge, float]:
    """What changed on a joint's link since a reference, and the log evidence that something did.

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
    s = replace(s, accepted=(*(a for a in s.accepted if a is not instead), Accepted(form, 1.0, evidence))).for_values
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


def degrees_of_freedom(problem: Problem, estimate: Estimate) -> float:
    """Degrees of freedom of a channel's noise, where a few poses are all that it is known from."""
    fitted = [s for name in problem.fitted for s in problem.segments[name]]
    if not all(s.poses for s in fitted):
        return inf
    channels = len(problem.row_model.channels.names)
    return max((estimate.rows - len(estimate.solution)) / channels, 1.0)
