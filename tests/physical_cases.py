"""Random estimation problems over bodies that can exist, for tests and benchmarks of the conic solver."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bayesid.estimators.conic.bounds import Bounds
from bayesid.estimators.conic.links import LinkData, LinkPrior, conic, link_prior
from bayesid.estimators.conic.physical import evidence_of
from bayesid.estimators.conic.problem import Conic
from bayesid.regression.linalg import undetermined
from bayesid.regression.options import FitOptions
from bayesid.regression.problem import Problem, prepare
from bayesid.robot import inertia
from bayesid.robot.robot import Robot, load_robot
from tests.robots import ROBOTS, write
from tests.simulated import Motion, experiment, fourier, recording


@dataclass(frozen=True)
class Arm:
    """A robot's joint torques on a rich motion."""

    robot: Robot
    problem: Problem
    matrix: np.ndarray  # (rows, base parameters), one N m of white noise
    factor: np.ndarray  # its triangular factor


def arm(folder: Path, name: str = "panda", seed: int = 0) -> Arm:
    robot = load_robot(write(folder, ROBOTS[name]()))
    table = recording(robot, None, fourier(robot, seed, duration=20.0), torque_std=0.1, seed=seed)
    problem = prepare(experiment(robot, [Motion("a", "identification", table)]), FitOptions("torque"))
    rows = np.concatenate([b.matrix.reshape(-1, b.matrix.shape[2]) for b in problem.regression.rows.blocks()])
    return Arm(robot, problem, rows, np.linalg.qr(rows, mode="r"))


def flat_bodies(robot: Robot, rng: np.random.Generator, flat: int) -> np.ndarray:
    """Bodies like the nominal ones, ``flat`` of them without extent in one to three directions (b, 10)."""
    out = robot.nominal.copy()
    for k, body in enumerate(out):
        root = np.linalg.cholesky(inertia.pseudo_inertia(body) + 1e-12 * np.eye(4))
        change = rng.normal(0.0, 0.2, (4, 4)) + np.eye(4)
        if k in rng.permutation(len(out))[:flat]:
            change[:, rng.permutation(3)[: rng.integers(1, 4)]] = 0.0
        out[k] = inertia.from_pseudo_inertia(root @ change @ change.T @ root.T)
    return out


def random_case(
    arm: Arm,
    rng: np.random.Generator,
    bounded: bool | None = None,
    std: float | None = None,
    rel_std: float | None = None,
    metric: str = "warped",
) -> tuple[LinkData, LinkPrior, Conic]:
    """Truth of bodies with and without extent, noise from tiny to huge, trust from tight to next to none."""
    robot, regression = arm.robot, arm.problem.regression
    truth = flat_bodies(robot, rng, int(rng.integers(0, len(robot.nominal) + 1))).ravel()
    std = 10.0 ** rng.uniform(-3, 1.5) if std is None else std
    factor = arm.factor / std
    target = factor @ (regression.base.matrix @ truth) + rng.normal(size=len(factor))
    data = LinkData.of(regression, factor, target, None)
    evidence = evidence_of(factor, target, undetermined(factor), regression.base.rank)
    strength = 10.0 ** rng.uniform(-1.5, 2) if rel_std is None else rel_std
    trust = link_prior(regression, data, evidence, None, metric, strength)
    limits = Bounds()
    if rng.random() < 0.5 if bounded is None else bounded:
        bodies = truth.reshape(-1, 10)
        com = bodies[:, 1:4] / bodies[:, :1]
        total, some = bodies[:, 0].sum(), [robot.body_names[k] for k in rng.permutation(len(bodies))[:3]]
        at = {name: robot.body_names.index(name) for name in some}
        limits = Bounds(
            total_mass=(0.98 * total, 1.02 * total),
            mass={some[0]: (0.9 * bodies[at[some[0]], 0], 1.1 * bodies[at[some[0]], 0])},
            com={some[1]: (com[at[some[1]]] - 0.03, com[at[some[1]]] + 0.03)},
            ellipsoid={some[2]: (com[at[some[2]]], np.full(3, 0.6))},
            box={name: (com[at[name]] - 0.5, com[at[name]] + 0.5) for name in some},
        )
    return data, trust, conic(data, trust, limits.linear(data.names, data.bodies, data.matrix.shape[1]))


__all__ = ["Arm", "arm", "flat_bodies", "random_case"]


def possible_draw(prior, rng):
    """Links from a prior, body by body until one can exist."""
    links = prior.mean.copy()
    for body in map(list, prior.bodies):
        root = np.linalg.cholesky(np.linalg.inv(prior.precision[np.ix_(body, body)]))
        links[body] = prior.mean[body] + root @ rng.normal(size=10)
        while np.linalg.eigvalsh(inertia.pseudo_inertia(links[body]))[0] <= 0:
            links[body] = prior.mean[body] + root @ rng.normal(size=10)
    return links
