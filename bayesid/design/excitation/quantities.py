"""Quantities whose expected standard deviation a motion is judged by, as linear functions of the base parameters.

    joint2.mcx          the base parameter that this link parameter stands for
    payload@joint6      the mass of a body attached to the link of that joint, all other links known
    torque@FILE.csv     the joint torques along another motion, root mean square

A torque ``Y phi`` that the readings determine at all is ``Y_kept beta`` with the columns of the kept parameters, for the others'
share is in the base parameters; a body on a known link is judged by the columns of that link alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from bayesid.arguments import argument
from bayesid.design.excitation.information import Criterion, Information, typical_sizes
from bayesid.dynamics.base_parameters import regroup
from bayesid.dynamics.channels import torque_channels
from bayesid.dynamics.regressors import Kernel, dynamics_regressor
from bayesid.errors import InputError
from bayesid.recordings.experiment import Experiment
from bayesid.simulation.trajectories import read_trajectory

#: What of a torque may lie outside the base parameters of the readings: rounding of a URDF's angles.
_OUTSIDE = 1e-4
_STATES = 200


@dataclass(frozen=True, eq=False)
class JudgedQuantity:
    """A quantity that a motion is judged by."""

    #: As asked for, and of its standard deviation.
    name: str
    unit: str
    information: Information  # what is estimated: the links' base parameters, or one body's
    functions: np.ndarray  # c: the variance is ``trace(C' cov(beta) C)`` (r, m)

    @property
    def scaled(self) -> np.ndarray:
        """The same functions of the scaled base parameters (r, m)."""
        return self.information.scale.T @ self.functions

    def std(self, matrix: np.ndarray) -> float:
        """Its expected standard deviation, from a scaled information matrix (r, r)."""
        return float(np.sqrt(np.sum(self.scaled * np.linalg.solve(matrix, self.scaled))))


def parse_quantity(text: str, experiment: Experiment, information: Information) -> JudgedQuantity:
    """The quantity that a text names; an `InputError` where it names none, or one that the readings do not determine."""
    kind, at, where = text.partition("@")
    if kind == "torque" and at:
        return _torque(text, where, experiment, information)
    if kind == "payload" and at:
        return _payload(text, where, experiment, information)
    base = information.base
    kept = [base.parameter_names[k] for k in base.independent.tolist()]
    if text not in kept:
        shown = ", ".join(kept[:6])
        raise InputError(
            f"{argument('quantities', text)}: write payload@JOINT, torque@FILE.csv, or a parameter that leads a base parameter: "
            f"{shown}, ..."
        )
    functions = np.zeros((base.rank, 1))
    functions[kept.index(text)] = 1.0
    return JudgedQuantity(text, base.units[kept.index(text)], information, functions)


def criterion_of(name: str, quantities: Sequence[JudgedQuantity], information: Information) -> tuple[Criterion, Information]:
    """What is to be made small, and the information that it is a function of; an `InputError` where they do not go together."""
    if name == "condition":  # of the base regressor as it is: with columns of unit length, hardly moving joints would look well
        alike = {"scale": np.eye(information.base.rank), "std": np.ones(len(information.channels))}
        return Criterion(name), replace(information, **alike)
    if name != "quantity" or not quantities:
        return Criterion(name), information
    first = quantities[0].information
    if any(q.information is not first for q in quantities):
        raise InputError(
            f"{argument('criterion', 'quantity')}: a payload is judged with the links known; name it alone, or take "
            f"{argument('criterion', 'd')}"
        )
    # Each in units of what is known beforehand, so that several units add up.
    return Criterion(name, np.hstack([q.scaled / np.linalg.norm(q.scaled) for q in quantities])), first


def _torque(text: str, file: str, experiment: Experiment, information: Information) -> JudgedQuantity:
    robot, base = experiment.robot, information.base
    motion = read_trajectory(Path(file), robot)
    channels = torque_channels(robot)
    stride = max(len(motion.times) // _STATES, 1)
    states = (x[::stride] for x in (motion.positions, motion.velocities, motion.accelerations))
    whole = dynamics_regressor(robot, channels, *states).reshape(-1, 10 * len(robot.body_names))
    functions = whole[:, base.independent]
    if np.abs(whole - functions @ base.matrix).max() > _OUTSIDE * np.abs(whole).max():
        reading = information.sensor_set.title
        raise InputError(
            f"{argument('quantities', text)}: {reading} do not determine these torques; take {argument('channel', 'torque')} or "
            "both"
        )
    # The factor of F'F has the same sum of variances as the many rows F.
    factor = np.linalg.qr(functions, mode="r") / np.sqrt(len(functions))
    return JudgedQuantity(text, "N m", information, factor.T)


def _payload(text: str, where: str, experiment: Experiment, information: Information) -> JudgedQuantity:
    robot = experiment.robot
    names = {name: k for k, name in enumerate(robot.joint_names)} | {f"joint{k + 1}": k for k in range(robot.n)}
    if where not in names:
        raise InputError(f"{argument('quantities', text)}: no such joint; write one of {', '.join(robot.joint_names)}")
    own = np.arange(10 * names[where], 10 * names[where] + 10)
    sensor_set, channels = information.sensor_set, information.channels
    offset = sensor_set.offset == "fitted"
    rng = np.random.default_rng(0)
    q, v, a = rng.normal(0.0, [[[1.0]], [[1.0]], [[4.0]]], (3, 60, robot.n))
    rows = dynamics_regressor(robot, channels, q, v, a, own, gravity=sensor_set.gravity)
    constant = np.zeros((60, len(channels), 6 if offset else 0))
    for c, name in enumerate(channels.names):
        if offset and not name.startswith("tau"):
            constant[:, c, c] = 1.0
    flat = 60 * len(channels)
    labels = [robot.parameter_names[k] for k in own.tolist()]
    units = [robot.parameter_units[k] for k in own.tolist()]
    base = regroup(rows.reshape(flat, 10), labels, units, constant.reshape(flat, constant.shape[2]))
    # The mass is a function of the base parameters where a unit of it is in the span of their rows.
    mass = np.eye(10)[0]
    functions = np.linalg.lstsq(base.matrix.T, mass, rcond=None)[0]
    if np.linalg.norm(base.matrix.T @ functions - mass) > _OUTSIDE:
        raise InputError(
            f"{argument('quantities', text)}: {sensor_set.title} do not determine a mass there; name a joint farther out"
        )
    spread = base.matrix * typical_sizes(robot)[own]
    kernel = Kernel.of(robot, channels, own[base.independent])
    own_information = replace(information, base=base, scale=np.linalg.cholesky(spread @ spread.T), kernel=kernel)
    return JudgedQuantity(text, "kg", own_information, functions[:, None])
