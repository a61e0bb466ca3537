"""What is said of a mistake: what seems wrong, by how much the fit improves, what to do, and what could tell it from another."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayesid.recordings.experiment import Experiment
from bayesid.robot.robot import Robot
from bayesid.validation.mistakes.candidates import Candidate, link_placement
from bayesid.validation.mistakes.evidence import Explainer, Fit
from bayesid.validation.mistakes.mistake import Mistake

_LISTED = 3
#: A link that is this far away in one of two poses is told from the other by eye [m].
_VISIBLE = 0.05


def told(
    experiment: Experiment, explainer: Explainer, null: Fit, alike: Sequence[tuple[Candidate, Fit]], evidence: float
) -> Mistake:
    """A mistake in words.

    Parameters
    ----------
    experiment
        The recordings.
    explainer
        Readings that it shows in.
    null
        The best robot for the data as they are.
    alike
        Candidates that explain the data as well, each with its robot; the first is named, the others told beside it.
    evidence
        Of the first [nats].
    """
    first, fit = alike[0]
    text = f"{_sentence(first.says)}: with that undone, {_falls(explainer, null, fit)}; {first.remedy}"
    others = [f"{c.says} ({c.remedy})" for c, _ in alike[1 : _LISTED + 1]]
    if others:
        more = f"; or {len(alike) - 1 - _LISTED} more" if len(alike) > _LISTED + 1 else ""
        text += f". As likely: {'; or '.join(others)}{more}. {_decided_by(experiment, explainer, alike)}"
    return Mistake(
        name=first.name, where=first.where, text=text, channel="torque" if explainer.torque else "wrench",
        evidence=float(evidence), before=tuple(map(float, null.left)), after=tuple(map(float, fit.left)),
        alternatives=tuple((c.name, c.where) for c, _ in alike[1:]),
    )  # fmt: skip


def not_explained(explainer: Explainer, null: Fit, best: Fit) -> Mistake:
    """That no robot explains the data, nor any mistake that is known, although some would let them be more probable."""
    what, left = "joint torques" if explainer.torque else "wrench", null.left
    k = int(np.argmax(left / np.maximum(explainer.variation, explainer.floor)))
    names, units = explainer.channels.names, explainer.channels.units
    text = (
        f"No possible robot explains the {what}: {left[k]:.2g} {units[k]} rms of {names[k]} are left, which varies by "
        f"{explainer.variation[k]:.2g}, and no mistake of sign, order, unit or frame that is known here mends it; look at the "
        "joints' order and zeros, at the sensor's frame, and whether all columns have one clock"
    )
    channel = "torque" if explainer.torque else "wrench"
    return Mistake("not_explained", "", text, channel, 0.0, tuple(map(float, left)), tuple(map(float, best.left)))


def _falls(explainer: Explainer, null: Fit, fit: Fit) -> str:
    k = int(np.argmax(null.left / np.maximum(fit.left, explainer.floor)))
    names, units = explainer.channels.names, explainer.channels.units
    return f"what no possible robot explains of {names[k]} falls from {null.left[k]:.2g} to {fit.left[k]:.2g} {units[k]} rms"


def _decided_by(experiment: Experiment, explainer: Explainer, alike: Sequence[tuple[Candidate, Fit]]) -> str:
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


def _centre(robot: Robot, fit: Fit) -> str:
    body = int(np.argmax(robot.sensor_bodies)) if robot.sensor_bodies.any() else 0
    mass, *moment = fit.parameters[10 * body : 10 * body + 4]
    return _vector(np.array(moment) / mass) if mass > 0.0 else "?"


def _vector(values: np.ndarray) -> str:
    return f"({', '.join(f'{v + 0.0:.2f}' for v in values)})"


def _sentence(words: str) -> str:
    return words[0].upper() + words[1:]
