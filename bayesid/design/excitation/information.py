"""The information of a planned motion about the base parameters, and its derivatives along the motion.

With the regressor X of the base parameters and the columns O of what is estimated beside (sensor offset, effects of the model),
rows divided by the standard deviation of a sample, N recorded samples carry

    A = N / n  (X - O B)' (X - O B),   B = (O' O + e)^-1 O' X

about the base parameters alone (n planned samples stand for the N; e is a vague prior of the effects). By the envelope theorem,
``dA = dX' (X - O B) + its transpose - ...``: a function of A with gradient G has the gradient ``2 (X - O B) G`` with respect to X
and ``-2 (X - O B) G B'`` with respect to O, which `bayesid.dynamics.regressor_gradient` carries on to the joint motion.

A motion is judged by functions of A, scaled: ``L' A L + 1`` is the information in units of the parameters' typical size, one
unit of which is added for what is known beforehand ([Chaloner1995]_); no choice of units changes it. Functions of its
eigenvalues l_i:

    d          sum log l_i / r                  the volume of the uncertainty ellipsoid (to be maximised)
    a          sum 1 / l_i / r                  the mean variance
    e          max 1 / l_i                      the variance of the worst direction
    condition  sqrt(max l_i / min l_i)          how uneven the directions are, here in SI units and with all channels alike
    quantity   trace(C' A^-1 C)                 the variance of chosen quantities ``C' beta``

Largest and smallest eigenvalues are replaced by means of their powers, ``(sum l_i^p)^(1/p)``, which have a gradient where two
meet ([Kiefer1974]_). What is minimised is a logarithm throughout. Quantities are linear functions of the base parameters:

    joint2.mcx          the base parameter that this link parameter stands for
    payload@joint6      the mass of a body attached to the link of that joint, all other links known
    torque@FILE.csv     the joint torques along another motion, root mean square

A torque ``Y phi`` that the readings determine at all is ``Y_kept beta`` with the columns of the kept parameters, for the others'
share is in the base parameters; a body on a known link is judged by the columns of that link alone.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from bayesid.arguments import argument
from bayesid.design.excitation.series import FourierSeries
from bayesid.design.reading_noise import ReadingNoise, SensorSet
from bayesid.dynamics.base_parameters import BaseParameters, structural_base
from bayesid.dynamics.channels import Channels, torque_channels
from bayesid.dynamics.regressor_gradient import regressor_gradient
from bayesid.dynamics.regressors import Kernel
from bayesid.effects import Effect, MotionSegment
from bayesid.effects.bodies import body_of
from bayesid.effects.families import JointTorqueEffect
from bayesid.effects.flexible import MotionArrays
from bayesid.effects.sizes import reach
from bayesid.errors import InputError, require_one_of
from bayesid.recordings.experiment import Experiment
from bayesid.regression.readings import make_channels
from bayesid.robot.prior import assumed_links
from bayesid.robot.robot import Robot, joint_index
from bayesid.simulation.trajectories import read_trajectory

CRITERIA = {
    "d": "D-optimal: smallest volume of the uncertainty ellipsoid",
    "a": "A-optimal: smallest mean variance",
    "e": "E-optimal: smallest variance of the worst direction",
    "condition": "smallest condition number",
    "quantity": "smallest variance of chosen quantities",
}
_POWER = 8.0

Value = tuple[float, np.ndarray]
#: Prior standard deviation of an effect's parameter, as a multiple of its typical size: hardly any knowledge.
_VAGUE = 100.0
#: Least mass and length of a body as shares of the robot's, for the typical size of its parameters.
_LEAST_MASS, _LEAST_LENGTH = 0.01, 0.05
_STEP = 1e-5


def _power(values: np.ndarray, p: float) -> tuple[float, np.ndarray]:
    """``log(mean l^p) / |p|``, scaled so that powers neither overflow nor vanish."""
    top = values.max() if p > 0 else values.min()
    ratio = (values / top) ** p
    value = (np.log(np.mean(ratio)) + p * np.log(top)) / abs(p)
    return float(value), np.sign(p) * ratio / values / ratio.sum()


def _condition(values: np.ndarray) -> tuple[float, np.ndarray]:
    (high, up), (low, down) = _power(values, _POWER), _power(values, -_POWER)
    return 0.5 * (high + low), 0.5 * (up + down)


#: Value and slopes, by eigenvalues.
_OF_EIGENVALUES: dict[str, Callable[[np.ndarray], tuple[float, np.ndarray]]] = {
    "d": lambda values: (-float(np.mean(np.log(values))), -1.0 / (values * len(values))),
    "a": lambda values: _power(values, -1.0),
    "e": lambda values: _power(values, -_POWER),
    "condition": _condition,
}


@dataclass(frozen=True, eq=False)
class Criterion:
    """A function of the information matrix that is to be as small as possible."""

    name: str = "d"  # one of `CRITERIA`
    #: C: linear functions of the scaled base parameters whose variance counts (r, m); for ``quantity`` only.
    quantities: np.ndarray | None = None

    def __post_init__(self) -> None:
        """Check the name, and that ``quantity`` has quantities; else an `InputError`."""
        require_one_of(self.name, CRITERIA, argument("criterion", self.name))
        if (self.quantities is None) == (self.name == "quantity"):
            raise InputError(
                f"{argument('criterion', 'quantity')} goes with {argument('quantities')}: name the quantities, or choose "
                "another criterion"
            )

    def __call__(self, information: np.ndarray) -> Value:
        """Value and gradient (r, r), both of the scaled information matrix (r, r)."""
        values, vectors = np.linalg.eigh(information)
        values = np.maximum(values, 1e-12 * max(values[-1], 1e-300))
        if self.quantities is not None:
            inside = vectors.T @ self.quantities
            solved = inside / values[:, None]
            variance = float(np.sum(inside * solved))
            solved = vectors @ solved
            return float(np.log(variance)), -(solved @ solved.T) / variance
        value, slope = _OF_EIGENVALUES[self.name](values)
        return value, (vectors * slope) @ vectors.T


@dataclass(frozen=True, eq=False)
class Information:
    """What is measured and estimated: from a motion to its information matrix."""

    #: What moves and what is measured.
    robot: Robot
    channels: Channels
    sensor_set: SensorSet
    base: BaseParameters  # base parameters of these readings
    scale: np.ndarray  # L (r, r): base parameters are L times numbers of about size one
    std: np.ndarray  # standard deviation of one sample of each channel (c,)
    effects: tuple[Effect, ...]  # what is estimated beside, as far as its columns follow from the joint motion alone
    left_out: tuple[str, ...]  # the model's effects that this is not so for
    kernel: Kernel  # the regressor's

    @classmethod
    def of(
        cls, experiment: Experiment, sensor_set: SensorSet, noise: ReadingNoise, held: np.ndarray | None = None
    ) -> Information:
        """Information of readings of an experiment's robot, sensor and model; its motions do not count.

        Of the noise the colour does not count. Where a static run is subtracted (equation 21 of [Liu1998]_), offset and weight
        are gone. ``held`` says where joints stand that do not move (n,) [rad or m], nan for those that do; default: all move.
        An `InputError` where there is no sensor for the wrench, or an effect of the model does not exist.
        """
        robot, channels = experiment.robot, make_channels(experiment, sensor_set.channel)
        offset, specs = sensor_set.offset == "fitted", list(experiment.effects)
        if offset and not any(s.partition("@")[0] == "sensor_offset" for s in specs):
            specs.append("sensor_offset")
        parsed = experiment.library.parse(specs, robot.joint_names, channels.names, experiment.gear_ratio)
        effects = tuple(e for e in parsed if e.from_motion_alone and (offset or not e.removed_by_static_run))
        left_out = tuple(e.spec for e in parsed if not e.from_motion_alone)
        base = structural_base(robot, channels, gravity=sensor_set.gravity, offset=offset, held=held)
        spread = base.matrix * typical_sizes(robot) * (experiment.inertia_rel_std or 1.0)
        scale = np.linalg.cholesky(spread @ spread.T)
        std = noise.of(sensor_set)["trajectory"].std
        kernel = Kernel.of(robot, channels, base.independent)
        return cls(robot, channels, sensor_set, base, scale, std, effects, left_out, kernel)

    def matrix(self, motion: MotionArrays, samples: float, step: float) -> np.ndarray:
        """Scaled information A (r, r) of a period's even states (n, joints), ``step`` [s] apart, recorded in so many samples.

        What is known beforehand is in it.
        """
        rest = self._rest(motion, step)[0]
        return samples / len(motion[0]) * rest.T @ rest + np.eye(rest.shape[1])

    def judged(self, motion: MotionArrays, samples: float, step: float, criterion: Criterion) -> tuple[float, MotionArrays]:
        """Value of a criterion and its derivatives with respect to positions, velocities and accelerations (n, joints)."""
        rest, explained, others = self._rest(motion, step)
        weight = samples / len(motion[0])
        value, gradient = criterion(weight * rest.T @ rest + np.eye(rest.shape[1]))
        inner = 2.0 * weight * rest @ gradient
        shape = (len(motion[0]), len(self.std), -1)
        weights = (inner @ self.scale.T).reshape(shape) / self.std[None, :, None]
        q, v, a = regressor_gradient(self.kernel, *motion, weights, gravity=self.sensor_set.gravity)
        if others.size:
            beside = -(inner @ explained.T).reshape(shape)
            for total, part in zip((q, v, a), self._effects_gradient(motion, step, beside), strict=True):
                total += part
        return value, (q, v, a)

    def explaining(self, series: FourierSeries, step: float, samples: int) -> np.ndarray:
        """Columns of the base parameters and of the effects of the model, in standard deviations (samples c, r + o)."""
        motion = series.at(step * np.arange(samples))
        x = self.kernel.dynamics(*motion, gravity=self.sensor_set.gravity) / self.std[None, :, None]
        others = self._effect_columns(motion, step)
        return np.concatenate([x, others], axis=2).reshape(samples * len(self.std), -1)

    def _rest(self, motion: MotionArrays, step: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Scaled columns X - O B (n c, r), B (o, r) and the columns O (n c, o)."""
        regressor = self.kernel.dynamics(*motion, gravity=self.sensor_set.gravity)
        regressor /= self.std[None, :, None]
        x = regressor.reshape(-1, regressor.shape[2]) @ self.scale
        others = self._effect_columns(motion, step).reshape(len(x), -1)
        if not others.size:
            return x, np.zeros((0, x.shape[1])), others
        explained = np.linalg.solve(others.T @ others + np.eye(others.shape[1]) / _VAGUE**2, others.T @ x)
        return x - others @ explained, explained, others

    def _effect_columns(self, motion: MotionArrays, step: float) -> np.ndarray:
        """Columns of the effects at their typical sizes, in standard deviations (n, c, o)."""
        times = step * np.arange(len(motion[0]))
        segment = MotionSegment(times, *motion, middle=motion[0].mean(axis=0), cell=step)
        parts = [np.zeros((len(times), len(self.std), 0))]
        for effect in self.effects:
            columns = effect.motion_columns(segment, self.channels.names)
            if not self.sensor_set.gravity:
                columns = columns - effect.motion_columns(segment.at_rest, self.channels.names)
            parts.append(columns * np.array(effect.typical(self.robot), float))
        return np.concatenate(parts, axis=2) / self.std[None, :, None]

    def _effects_gradient(self, motion: MotionArrays, step: float, weights: np.ndarray) -> list[np.ndarray]:
        """Derivatives of ``sum(weights * O)``: the columns of a sample depend on that sample's motion alone."""
        out = [np.zeros_like(part) for part in motion]
        joints = list(range(motion[0].shape[1]))
        place = np.array([e.joint if isinstance(e, JointTorqueEffect) else -1 for e in self.effects for _ in e.parameters])
        own, moving = place >= 0, np.array([not e.absorbs_weight for e in self.effects for _ in e.parameters])
        for k in range(3):
            if own.any():  # columns of one joint's motion each: all joints are moved at once
                rate = np.sum(weights * self._differences(motion, step, k, joints), axis=1)
                for j in joints:
                    out[k][:, j] += rate[:, place == j].sum(axis=1)
            if (moving & ~own).any():
                for j in joints:
                    rate = np.sum(weights * self._differences(motion, step, k, [j]), axis=1)
                    out[k][:, j] += rate[:, moving & ~own].sum(axis=1)
        return out

    def _differences(self, motion: MotionArrays, step: float, part: int, joints: list[int]) -> np.ndarray:
        """Central differences of O along some joints' positions (part 0), velocities (1) or accelerations (2), (n, c, o)."""
        both = []
        for sign in (1.0, -1.0):
            there = [x.copy() for x in motion]
            there[part][:, joints] += sign * _STEP
            both.append(self._effect_columns((there[0], there[1], there[2]), step))
        return (both[0] - both[1]) / (2 * _STEP)


def typical_sizes(robot: Robot) -> np.ndarray:
    """About how large each link parameter is (10 b,): mass, mass times length, mass times length squared of each body."""
    links = assumed_links(robot)
    mass = np.maximum(links[:, 0], _LEAST_MASS * links[:, 0].sum())
    turning = np.maximum(links[:, 4] + links[:, 6] + links[:, 9], 0.0)
    length = np.maximum(np.sqrt(0.5 * turning / mass), _LEAST_LENGTH * reach(robot))
    power = np.array([0, 1, 1, 1, 2, 2, 2, 2, 2, 2])
    return (mass[:, None] * length[:, None] ** power).ravel()


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
    whole = Kernel.of(robot, channels).dynamics(*states).reshape(-1, 10 * len(robot.body_names))
    functions = whole[:, base.independent]
    if np.abs(whole - functions @ base.matrix).max() > _OUTSIDE * np.abs(whole).max():
        reading = information.sensor_set.title
        raise InputError(
            f"{argument('quantities', text)}: {reading} do not determine these torques; take {argument('channel', 'torque')} or "
            "both"
        )
    # The factor of F'F has the same sum of variances as the many rows F.
    factor = np.linalg.qr(functions, mode="r") / np.sqrt(len(functions))
    return JudgedQuantity(text, " or ".join(dict.fromkeys(channels.units)), information, factor.T)


def _payload(text: str, where: str, experiment: Experiment, information: Information) -> JudgedQuantity:
    robot = experiment.robot
    joint = joint_index(where, robot.joint_names)
    if joint is None:
        raise InputError(f"{argument('quantities', text)}: no such joint; write one of {', '.join(robot.joint_names)}")
    own = 10 * body_of(robot, joint) + np.arange(10)
    sensor_set, channels = information.sensor_set, information.channels
    offset = sensor_set.offset == "fitted"
    base = structural_base(robot, channels, gravity=sensor_set.gravity, offset=offset, columns=own)
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
