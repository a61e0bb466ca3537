"""Readings that are linear in what is known: joint torques for a controller, and the wrench on a sensor.

A controller's torque is ``Y(q, v, a) b + friction and whatever else acts inside the joints``, with b the base parameters of
the joint torques, whatever the sensor was that they were identified with. Where the data determine all that such torques show of
b, its law is that of the identified parameters through ``b = T beta``: a sum of two parameters that no motion tells apart may
stay one. Otherwise b comes from links that can exist, which the prior holds where the data do not, about the estimate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayesid.design.bounds.knowledge import Known
from bayesid.design.bounds.region import Region, region_of_draws, region_of_normal
from bayesid.dynamics.base_parameters import BaseParameters, spanned, structural_base
from bayesid.dynamics.channels import Channels, torque_channels
from bayesid.dynamics.regressors import Kernel
from bayesid.effects import Effect, with_places
from bayesid.effects.families import JointMotion, JointTorqueEffect, differences
from bayesid.robot.robot import Robot

#: Share of a change below which it is rounding, and random states at which it would show.
_OPEN, _STATES = 1e-6, 32


@dataclass(frozen=True, eq=False)
class Drive:
    """An effect inside a joint that was identified, with all its values."""

    effect: JointTorqueEffect  # which, and at which joint
    values: tuple[float, ...]  # of its parameters (k,)
    columns: tuple[int, ...]  # those of ``values`` that were estimated, as indices

    def torque(self, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Torque at a state of its joint (N,) with its values, less what its columns make of them (N,), and columns (N, k)."""
        motion = JointMotion(np.arange(len(q), dtype=float), q, v, a, None, 0.0)
        columns = differences(self.effect, self.values, lambda x: self.effect.torque(motion, x))[:, list(self.columns)]
        return self.effect.torque(motion, self.values) - columns @ np.array(self.values)[list(self.columns)], columns


@dataclass(frozen=True, eq=False)
class ReadingModel:
    """Channels that are linear in parameters with a region."""

    #: What moves and what is read.
    robot: Robot
    channels: Channels
    base: BaseParameters  # base parameters of these channels, the first of the region
    drives: tuple[Drive, ...]  # what acts inside the joints, whose estimated values follow
    region: Region  # of all parameters (k,)
    draws: np.ndarray  # base parameters of links that can exist (n, r), and what goes with them (n, k - r)

    def columns(self, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Constant (N, c) and matrix (N, c, k) at states (N, n): readings are ``constant + matrix @ parameters``."""
        rigid = self.rigid(q, v, a)
        return self._with_drives(q, v, a, rigid)

    def rigid(self, q: np.ndarray, v: np.ndarray, a: np.ndarray, *, gravity: bool = True) -> np.ndarray:
        """Columns of the base parameters alone (N, c, r)."""
        return Kernel.of(self.robot, self.channels, self.base.independent).dynamics(q, v, a, gravity=gravity)

    def control_columns(
        self, q: np.ndarray, v: np.ndarray, reference_v: np.ndarray, reference_a: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Constant and matrix of ``M(q) a_r + C(q, v) v_r + g(q)`` and what acts inside the joints, (N, n) and (N, n, k).

        C is that of the Christoffel symbols, so that ``dM/dt - 2 C`` is skew-symmetric, as passivity-based control needs. Its
        products are quadratic forms h of the velocities, so ``C(q, v) v_r = (h(v + v_r) - h(v - v_r)) / 4``. Inside the joints
        friction is that of v, and what depends on acceleration that of a_r.

        Parameters
        ----------
        q, v
            Joint positions and velocities (N, n).
        reference_v, reference_a
            Reference velocities and accelerations (N, n).
        """
        still = np.zeros_like(q)
        rigid = self.rigid(q, still, reference_a)
        for sign in (1.0, -1.0):
            rigid += 0.25 * sign * self.rigid(q, v + sign * reference_v, still, gravity=False)
        return self._with_drives(q, v, reference_a, rigid)

    def _with_drives(self, q: np.ndarray, v: np.ndarray, a: np.ndarray, rigid: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        parts, constant = [rigid], np.zeros(rigid.shape[:2]) + self.channels.static_wrench
        for drive in self.drives:
            joint = drive.effect.joint or 0
            offset, columns = drive.torque(q[:, joint], v[:, joint], a[:, joint])
            own = np.zeros((len(q), rigid.shape[1], columns.shape[1]))
            own[:, joint] = columns
            constant[:, joint] += offset
            parts.append(own)
        return constant, np.concatenate(parts, axis=2)

    def drive_inertia(self) -> tuple[np.ndarray, np.ndarray]:
        """What is inside the joints adds to the mass matrix: with stated values (n, n), by estimated parameters (n, n, k - r)."""
        n = self.robot.n
        still, unit = np.zeros((n, n)), np.eye(n)
        moved, held = (self._with_drives(still, still, a, np.zeros((n, n, 0))) for a in (unit, still))
        return moved[0] - held[0], np.swapaxes(moved[1] - held[1], 0, 1)


def torque_model(known: Known, seed: int = 0) -> ReadingModel:
    """Joint torques: rigid bodies, and what was identified inside the joints."""
    robot = known.problem.row_model.robot
    channels = torque_channels(robot)
    drives, columns = _drives(known)
    return _model(known, channels, structural_base(robot, channels), drives, columns, seed)


def sensor_model(known: Known, channels: Channels, seed: int = 0) -> ReadingModel:
    """The wrench of rigid bodies on a sensor, weight included and its offset not."""
    base = structural_base(known.problem.row_model.robot, channels)
    return _model(known, channels, base, (), np.zeros(0, int), seed)


def _drives(known: Known) -> tuple[tuple[Drive, ...], np.ndarray]:
    """Effects inside the joints, and which of the estimated effect parameters are theirs."""
    row_model = known.problem.row_model
    out, columns = [], []
    place = np.cumsum(row_model.free) - 1  # of a parameter among those that were estimated
    for effect, own in with_places(row_model.effects):
        if isinstance(effect, JointTorqueEffect) and not (effect.uses_load or effect.remembers):
            free = np.flatnonzero(row_model.free[own])
            out.append(Drive(effect, tuple(known.effect_values[own]), tuple(free.tolist())))
            columns += place[own][free].tolist()
    return tuple(out), np.array(columns, int)


def possible_parameters(known: Known, model: ReadingModel) -> np.ndarray:
    """Parameters of the robot in ``identified.urdf``, with the effects that go with its links (k,)."""
    named: dict[str, float] = {name: value for name, (value, _) in known.dynamics.beside.items()}
    effects = zip(model.region.names[model.base.rank :], model.region.values[model.base.rank :].tolist(), strict=True)
    return np.concatenate([model.base.matrix @ known.urdf, np.array([named.get(name, value) for name, value in effects], float)])


def left_out_effects(known: Known, model: ReadingModel) -> tuple[Effect, ...]:
    """Effects of the identified model on joint torques that bounds of torques do not hold."""
    held = {drive.effect for drive in model.drives}
    names = model.channels.names
    return tuple(e for e in known.problem.row_model.effects if e not in held and any(e.acts_on(c) for c in names))


def _model(
    known: Known, channels: Channels, base: BaseParameters, drives: Sequence[Drive], columns: np.ndarray, seed: int
) -> ReadingModel:
    rank, robot = known.base.rank, known.problem.row_model.robot
    effects = [n for drive in drives for n in np.array(drive.effect.column_names)[list(drive.columns)].tolist()]
    units = [u for drive in drives for u in np.array(drive.effect.units)[list(drive.columns)].tolist()]
    draws = np.concatenate([known.links.links @ base.matrix.T, known.links.effects[:, columns]], axis=1)
    transfer, inside = spanned(base.matrix, known.base.matrix)
    names, labels, units = (*base.names, *effects), (*base.labels, *effects), (*base.units, *units)
    through = np.zeros((base.rank + len(columns), len(known.mean)))
    through[: base.rank, :rank] = transfer
    through[base.rank + np.arange(len(columns)), rank + columns] = 1.0
    left_open = through @ known.open_directions
    undetermined = np.any(np.abs(left_open) > _OPEN * np.linalg.norm(left_open, axis=0), axis=1)
    driven = np.concatenate([known.prior_driven(base), undetermined[base.rank :]])
    if known.draws is not None:
        region = region_of_draws(names, labels, units, draws, driven)
        return ReadingModel(robot, channels, base, tuple(drives), region, draws)
    covariance = through @ known.covariance @ through.T
    region = region_of_normal(names, labels, units, through @ known.mean, covariance, undetermined, seed)
    model = ReadingModel(robot, channels, base, tuple(drives), region, draws)
    if inside.all() and not _shown(model, left_open, seed):
        return model
    centre = np.concatenate([base.matrix @ known.centre, known.mean[rank + columns]])  # the estimate, wherever the draws are
    return replace(model, region=region_of_draws(names, labels, units, draws, driven, centre))


def _shown(model: ReadingModel, changes: np.ndarray, seed: int) -> bool:
    """Whether any motion shows changes of the parameters (k, m)."""
    if not changes.size:
        return False
    q, v, a = np.random.default_rng([seed, 23]).normal(size=(3, _STATES, model.robot.n))
    columns = model.columns(q, v, a)[1]
    seen = np.linalg.norm(columns @ changes, axis=(0, 1))
    return bool(np.any(seen > _OPEN * (np.linalg.norm(columns, axis=(0, 1)) @ np.abs(changes))))


def spread(matrix: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Standard deviations of ``matrix @ parameters`` (N, c)."""
    return np.sqrt(np.maximum(np.sum((matrix @ covariance) * matrix, axis=2), 0.0))
