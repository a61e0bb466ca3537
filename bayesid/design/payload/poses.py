"""How many more poses, and which, bring mass and centre of mass of a payload to a stated accuracy.

With Sigma the covariance of all that was estimated and rows X of a pose in units of the sensor's noise, that after it is

    (Sigma^-1 + X' X)^-1 = Sigma - Sigma X' (1 + X Sigma X')^-1 X Sigma.

Poses are added one by one, each the one that makes the sum of the variances of mass and centre of mass, in units of the squares
of what is wanted of them, smallest [Fedorov1972]_. The more poses, the better the noise is known, too, which few leave open
(`bayesid.signals.noise.student_factor`).

Poses to choose from are within the joints' limits, and keep the robot's bodies apart where its URDF says what shape they have.
The tool, its cable and the surroundings, which it does not hold, are not looked at.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayesid.arguments import argument
from bayesid.design.excitation.collision import clearance
from bayesid.design.payload.body import BodyKnowledge
from bayesid.errors import InputError
from bayesid.estimators import Estimate
from bayesid.regression.problem import Problem
from bayesid.regression.segment import Segment
from bayesid.robot.robot import motion_limits
from bayesid.signals.noise import student_factor

#: Poses to choose from, and the most that are proposed.
_CANDIDATES, _MOST = 200, 100
#: Least distance of the robot's bodies [m], and how many positions are tried for each one that keeps it.
_APART, _TRIED = 0.02, 10
#: Variance of what is not determined yet, relative to the largest that is.
_OPEN = 1e6


@dataclass(frozen=True, eq=False)
class NextPoses:
    """Poses to record next."""

    positions: np.ndarray  # joint positions (k, n) [rad or m]; none where the accuracy is reached
    #: Half widths of the 95 % intervals that were asked for: mass [kg], centre of mass along any axis [m].
    wanted: tuple[float, float]
    expected: tuple[float, float]  # those expected once these poses are recorded, too
    reached: bool  # whether these poses suffice
    apart: bool  # whether the robot's own bodies were kept apart; not where its URDF has no shapes of bodies that could meet


def next_poses(problem: Problem, estimate: Estimate, body: int, wanted: tuple[float, float], seed: int = 0) -> NextPoses:
    """Choose poses within the joints' limits in which the robot does not touch itself, for a sensor that carries one body.

    An `InputError` where what is ``wanted`` (see `NextPoses`) is no accuracy, or hardly any position keeps the robot's bodies
    apart.
    """
    if len(wanted) != 2 or not all(np.isfinite(w) and w > 0.0 for w in wanted):
        raise InputError(
            f"{argument('target', list(wanted))}: give two numbers above 0, half intervals of the mass [kg] and the centre [m]"
        )
    robot, model, rank = problem.experiment.robot, problem.row_model, estimate.base.rank
    lower, upper, _ = motion_limits(robot)
    # A full turn each way at most: what is beyond is the same pose again.
    lower, upper = np.maximum(lower, -np.pi), np.minimum(upper, np.pi)
    rng, q = np.random.default_rng(seed), np.zeros((0, robot.n))
    bodies, _ = clearance(robot, problem.experiment.locked, _APART, seed=seed)
    for _ in range(_TRIED):
        more = rng.uniform(lower, upper, (_CANDIDATES, robot.n))
        if bodies is not None:
            more = more[(bodies.distances(more) >= bodies.margins).all(axis=1)]
        q = np.concatenate([q, more])[:_CANDIDATES]
        if len(q) == _CANDIDATES:
            break
    if not len(q):
        raise InputError(
            f"{argument('target', list(wanted))}: no pose within the joints' limits keeps the robot's bodies {1e3 * _APART:.0f} "
            "mm apart; is the collision geometry of the URDF right?"
        )
    read = np.zeros((len(q), len(model.channels.names)))
    rows = model.samples(Segment(np.arange(float(len(q))), q, read, read[0], 0, poses=True), 0, len(q))[:, :, :-1]
    noise = estimate.noise.get("poses") or next(iter(estimate.noise.values()))
    rows = rows / noise.std[:, None]
    covariance = _open(estimate)
    own = estimate.base.matrix[:, 10 * body : 10 * body + 10]
    slopes = _slopes(own, estimate.values, wanted)
    taken: list[int] = []

    def expected() -> tuple[float, float]:
        surer = float(student_factor(noise.degrees + len(taken)) / student_factor(noise.degrees))
        known = BodyKnowledge.of(own, estimate.values, surer * covariance[:rank, :rank])
        centre = max(0.5 * (c.high - c.low) if c.shown else np.inf for c in known.centre)
        return (0.5 * (known.mass.high - known.mass.low) if known.mass.shown else np.inf), centre

    while not _reached(now := expected(), wanted) and len(taken) < _MOST:
        along = covariance @ rows.transpose(0, 2, 1)  # (C, p, 6)
        seen = along[:, :rank].transpose(0, 2, 1) @ slopes.T  # (C, 6, 4)
        inner = np.eye(rows.shape[1]) + rows @ along
        gain = np.sum(seen * np.linalg.solve(inner, seen), axis=(1, 2))
        gain[taken] = -1.0
        best = int(np.argmax(gain))
        covariance = covariance - along[best] @ np.linalg.solve(inner[best], along[best].T)
        taken.append(best)
    return NextPoses(q[taken], wanted, now, _reached(now, wanted), bodies is not None)


def _reached(now: tuple[float, float], wanted: tuple[float, float]) -> bool:
    return now[0] <= wanted[0] and now[1] <= wanted[1]


def _open(estimate: Estimate) -> np.ndarray:
    """Covariance of all that was estimated, wide where the data say nothing (p, p)."""
    covariance = np.array(estimate.stated_covariance())
    size = np.sqrt(np.diag(covariance)[~estimate.undetermined].max(initial=1.0))
    covariance[estimate.undetermined] = covariance[:, estimate.undetermined] = 0.0
    covariance[np.diag_indices(len(covariance))] += np.where(estimate.undetermined, _OPEN * size**2, 0.0)
    return covariance


def _slopes(own: np.ndarray, values: np.ndarray, wanted: tuple[float, float]) -> np.ndarray:
    """Derivatives of mass and centre of mass, in what is wanted of them, with respect to the base parameters (4, r)."""
    back = np.linalg.pinv(own)  # (10, r)
    body = back @ values
    mass = max(float(body[0]), 1e-3)
    centre = (back[1:4] - np.outer(body[1:4] / mass, back[0])) / mass
    return np.vstack([back[0] / wanted[0], centre / wanted[1]])
