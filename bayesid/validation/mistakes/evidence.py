"""How well a robot that could exist explains readings, with and without a mistake undone.

Readings are explained as they were recorded: what a mistake makes of the readings that a robot would give is compared with the
columns of the table, and its residual is counted there. A change that only mixes columns, or shrinks them, explains nothing.

What can exist are bodies of positive mass within their links' reach, and friction that only brakes. A body's ten parameters are a
sum, with factors that are not negative, of a few generators: a mass at each corner of a box around the link, and spread along
thirteen directions. The sum holds every body whose centre of mass is in that box and whose spread about it the directions can
make up (a little more and a little less than the physically consistent ones, [Wensing2018]_): masses, rotational inertias and
centres of mass have their signs, which is all that is asked here, and least squares with such factors takes milliseconds.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import block_diag, cho_solve, cholesky, solve_triangular
from scipy.optimize import nnls

from bayesid.dynamics.channels import Channels
from bayesid.dynamics.regressors import Kernel
from bayesid.robot import inertia
from bayesid.robot.robot import Robot
from bayesid.validation.mistakes.samples import Samples

#: How far a body reaches beyond its joints, as a share of its length: counterweights and drives stand over.
_OVERHANG = 0.5
#: Length of a link where the URDF tells none [m].
_USUAL_LENGTH = 0.2
#: How far the centre of mass of what is carried may be from where the last joint's link begins [m]: no URDF tells.
TOOL_REACH = 0.4
_MASS_BY_LENGTH = 12.0  # [kg/m]
#: How many times as heavy as usual no body is, in whatever unit torques are.
_HEAVIEST = 1e4
#: Speed, as a share of the usual one, within which Coulomb friction turns over.
_TURNS_OVER = 0.05
_DIRECTIONS = np.array([d for d in itertools.product((-1, 0, 1), repeat=3) if d > (0, 0, 0)], dtype=float)


def typical_length(robot: Robot) -> float:
    """The middle length of a robot's links [m]."""
    lengths = np.linalg.norm(np.diff(robot.rods, axis=1)[:, 0], axis=1) if len(robot.rods) else np.zeros(0)
    lengths = lengths[lengths > 1e-3]
    return float(np.median(lengths)) if len(lengths) else _USUAL_LENGTH


def body_generators(robot: Robot) -> np.ndarray:
    """Generators of all bodies' parameters (10 b, 21 b)."""
    usual, count = typical_length(robot), len(robot.body_names)
    columns = []
    for k in range(count):
        ends = np.vstack([np.zeros((1, 3)), robot.rods[robot.rod_joint == robot.body_joint[k]].reshape(-1, 3)])
        low, high = ends.min(axis=0), ends.max(axis=0)
        size = max(float(np.max(high - low)), usual)
        over = _OVERHANG * size if robot.body_joint[k] in robot.parent else max(_OVERHANG * size, TOOL_REACH)
        corners = itertools.product(*zip(low - over, high + over, strict=True))
        for corner in corners:
            columns.append(np.zeros(10 * count))
            columns[-1][10 * k : 10 * k + 4] = 1.0, *corner
        for d in _DIRECTIONS:
            # Mass spread along d has the second moment d d', and so the inertia |d|^2 - d d'.
            spread = size**2 * (np.eye(3) - np.outer(d, d) / (d @ d))
            columns.append(np.zeros(10 * count))
            columns[-1][10 * k + 4 : 10 * k + 10] = spread[inertia.ROW, inertia.COLUMN]
    return np.array(columns).T


def usual_bodies(robot: Robot) -> np.ndarray:
    """Ten parameters of bodies as heavy as links of these lengths usually are (b, 10): a quick guess, good to a factor of twenty.

    A rod from joint to joint of 12 kg a metre: arms, legs and tools from 0.1 to 300 kg are within a factor of twenty of it.
    """
    usual, out = typical_length(robot), []
    for k in range(len(robot.body_names)):
        ends = robot.rods[robot.rod_joint == robot.body_joint[k]].reshape(-1, 3)
        end = ends[np.argmax(np.linalg.norm(ends, axis=1))] if len(ends) else np.zeros(3)
        length = max(float(np.linalg.norm(end)), 0.5 * usual)
        mass = _MASS_BY_LENGTH * length
        out.append(inertia.from_mass_com_inertia(mass, 0.5 * end, mass * length**2 / 30.0 * np.eye(3)))
    return np.array(out)


def columns_beside(channels: Channels, velocities: np.ndarray, accelerations: np.ndarray, motion: np.ndarray) -> np.ndarray:
    """What readings hold beside the bodies, at samples (N, n) of recordings (N,): columns (N, c, k) with factors from zero.

    Viscous and Coulomb friction, rotor inertia, and an offset of either sign of every joint torque: no drive is pushed by its
    friction. Of a wrench, an offset of either sign of every channel in every recording.
    """
    count, n = velocities.shape
    if not channels.names[0].startswith("tau"):
        both = np.hstack([np.eye(len(channels)), -np.eye(len(channels))])
        mine = motion[:, None] == np.unique(motion)
        return (mine[:, None, :, None] * both[None, :, None, :]).reshape(count, len(channels), -1)
    out = np.zeros((count, n, 5 * n))
    for j in range(n):
        usual = np.sqrt(np.mean(velocities[:, j] ** 2))
        turn = np.tanh(velocities[:, j] / (_TURNS_OVER * usual)) if usual > 0.0 else 0.0
        out[:, j, 5 * j] = velocities[:, j]
        out[:, j, 5 * j + 1] = turn
        out[:, j, 5 * j + 2] = accelerations[:, j]
        out[:, j, 5 * j + 3], out[:, j, 5 * j + 4] = 1.0, -1.0
    return out[:, channels.joint]


#: A channel explained to this share of its variation is explained; a better fit is no evidence for anything.
EXPLAINED = 0.02
#: Least share of its variation to which bodies and what is beside them explain a channel where they are fitted freely.
FITTED = 0.005
#: Nor is any reading trusted beyond this share of the largest of its kind: sensors and drives of one robot are alike, and where
#: a wrist's torques are this small beside the shoulder's, friction and crosstalk are as large.
TRUSTED = 0.01
#: Ridge of the generators' scaled normal equations, which are many more than the data show, and of those of a few whole bodies,
#: whose sizes it must not shrink where a small motion hardly tells their weight from friction and offsets.
_RIDGE, _HARDLY_ANY = 1e-5, 1e-10
#: By how much one explanation must be worse than another, however many samples there are: a residual a third larger, of one
#: channel or of all together [nats a sample].
WORSE = float(np.log(4.0 / 3.0))
#: Readings of which more of the power is left are not explained.
UNEXPLAINED = 0.25
#: A mistake is as rare as one in a thousand, and must be a thousand times as probable as none: log(1e6) [nats].
NEEDED = 13.8
_ROUNDS = 2  # of weighting channels by what they leave


@dataclass(frozen=True, eq=False)
class Change:
    """What would make the recorded data right."""

    #: Matrix that the readings are multiplied by, (c, c), or one a sample, (N, c, c); None: as they are.
    readings: np.ndarray | None = None
    joints: np.ndarray | None = None  # matrix that positions and their rates are multiplied by (n, n); None: as they are
    zeros: np.ndarray | None = None  # added to the positions then (n,) [rad or m]; None: nothing
    gravity: np.ndarray | None = None  # in place of the stated one (3,) [m/s^2]; None: the stated one
    weightless: tuple[int, ...] = ()  # channels whose readings lack the weight, because something has taken out all of it
    #: Channels that lack the weight of the nominal bodies, because something has taken out what the URDF says it is.
    weight_added: tuple[int, ...] = ()
    numbers: int = 0  # how many of its numbers were chosen to suit the data


AS_RECORDED = Change()


@dataclass(frozen=True, eq=False)
class RobotFit:
    """The best robot that could exist."""

    family: int  # of any bodies (0), or of the nominal ones times a factor each (1)
    parameters: np.ndarray  # those of all bodies, ten each, then friction and offsets (p,)
    residual: np.ndarray  # what is left of the readings as recorded (N, c) [unit of the column]
    left: np.ndarray  # its rms (c,)
    log_likelihood: float  # of one sample, with the noise of every column profiled out
    count: int  # how many numbers the data as they are needed for the same bodies, and those of the change

    def score(self, worth: float, floor: np.ndarray | None = None) -> float:
        """Log evidence (Bayesian information criterion) of so many independent samples; other floors may be given [nats]."""
        return _score(self.log_likelihood if floor is None else _log_likelihood(self.left, floor), self.count, worth)


class Explainer:
    """Fits robots that could exist to the readings of some channels, with changes of the data."""

    def __init__(self, robot: Robot, channels: Channels, samples: Samples) -> None:
        self.robot, self.channels, self.samples = robot, channels, samples
        self.torque = channels.names[0].startswith("tau")
        self.channel = "torque" if self.torque else "wrench"
        others = np.eye(5 * robot.n if self.torque else 2 * len(np.unique(samples.motion)) * len(channels))
        families = [body_generators(robot)]
        self.has_masses = robot.nominal[:, 0].sum() > 0.0
        if self.has_masses:  # each nominal body times a factor: far fewer numbers, where the URDF is good
            families.append(np.asarray(block_diag(*robot.nominal[:, :, None])))
        self._families = [np.asarray(block_diag(bodies, others)) for bodies in families]
        #: Ridge of a sample for the factors of any bodies, which are masses, and none for what is beside them: thousands of
        #: tons explain nothing by a joint's angle that was rounded in the URDF (1.5708).
        heaviest = _HEAVIEST * _MASS_BY_LENGTH * typical_length(robot)
        self._light = np.repeat([heaviest**-2.0, 0.0], [families[0].shape[1], len(others)])
        variation = np.sqrt(np.mean((samples.readings - samples.readings.mean(axis=0)) ** 2, axis=0))
        if not self.torque:  # forces share a scale and moments another, so that a turned frame changes neither
            variation = np.repeat(np.sqrt(np.mean(variation.reshape(2, 3) ** 2, axis=1)), 3)
        #: Variation of each column, rms (c,).
        self.variation = np.maximum(variation, 1e-9)
        units = np.array(channels.units)
        largest = np.array([self.variation[units == unit].max() for unit in units])
        #: Residuals that are no evidence (c,).
        self.floor = np.maximum(EXPLAINED * self.variation, TRUSTED * largest)
        self._counts: list[int] = []
        self._designs: dict[tuple[bytes, ...], Design] = {}

    def fit(self, change: Change = AS_RECORDED) -> list[RobotFit]:
        """The best robots that could exist for changed data: any bodies, then the nominal ones times a factor each.

        Where the nominal bodies' weight is added there are only the latter: with a weight added, readings of no body become those
        of some body.
        """
        columns, squares = self._as_recorded(change)
        target = self._target(change)
        fits = []
        for k in self._possible(change):
            parameters, count = self._solved(k, columns, target, squares)
            residual = target - columns @ parameters
            if k == len(self._counts):
                self._counts.append(count)
            left = rms(residual)
            count = self._counts[k] + change.numbers
            fits.append(RobotFit(k, parameters, residual, left, _log_likelihood(left, self.floor), count))
        return fits

    def _possible(self, change: Change) -> range:
        return range(1 if change.weight_added else 0, len(self._families))

    def _solved(self, k: int, columns: np.ndarray, target: np.ndarray, squares: np.ndarray) -> tuple[np.ndarray, int]:
        """Parameters of the best robot of a family for readings (N, c), and how many of its factors are not zero."""
        expand, products = self._families[k], np.einsum("ncm,nc->cm", columns, target, optimize=True)
        left, factors = self.variation, np.zeros(expand.shape[1])
        for _ in range(_ROUNDS):
            weights = np.maximum(left, self.floor) ** -2
            whole = np.tensordot(weights, squares, 1)
            ridge, light = (_RIDGE, len(target) * self._light) if k == 0 else (_HARDLY_ANY, 0.0)
            factors = _non_negative(expand.T @ whole @ expand, expand.T @ (weights @ products), ridge, light)
            left = rms(target - columns @ (expand @ factors))
        return expand @ factors, int(np.count_nonzero(factors))

    def left_out(self, change: Change = AS_RECORDED) -> dict[int, np.ndarray]:
        """What is left of each column in parts of the motions that took no part in the fit, by family of robots (c,).

        Each quarter of every motion is predicted by robots that are fitted to the others.
        """
        columns, target = self._as_recorded(change)[0], self._target(change)
        residuals = {k: np.empty_like(target) for k in self._possible(change)}
        for quarter in range(4):
            out = self.samples.quarter == quarter
            kept, read = columns[~out], target[~out]
            squares = _squares(kept)
            for k, residual in residuals.items():
                residual[out] = target[out] - columns[out] @ self._solved(k, kept, read, squares)[0]
        return {k: rms(residual) for k, residual in residuals.items()}

    @cached_property
    def unmended(self) -> dict[int, np.ndarray]:
        """`left_out` of the data as recorded."""
        return self.left_out()

    def mended(self, change: Change, worth: float, needed: float) -> bool | None:
        """Whether data with a mistake undone are explained; None where they are no more probable than as recorded.

        In parts that were not fitted a family of robots makes them more probable than any makes the data as recorded, by
        ``needed`` [nats] for ``worth`` independent samples. From what this family leaves of the data as recorded to what it
        leaves then it is half of the way, in nats, to the least that could be left. Columns count by what undoing the mistake
        changes in them: of what the robot lets be read beside what is left, or of what is left. And of the columns of each kind
        that it changes, a quarter of the power is left at most.
        """
        known = max(_log_likelihood(e, self.floor) for e in self.unmended.values())
        left = {k: e for k, e in self.left_out(change).items() if worth * (_log_likelihood(e, self.floor) - known) > needed}
        return any(self._mends(change, fit, left[fit.family]) for fit in self.fit(change) if fit.family in left) if left else None

    def _mends(self, change: Change, fit: RobotFit, left: np.ndarray) -> bool:
        here, there = np.maximum(left, self.floor), np.maximum(self.unmended[fit.family], self.floor)
        least = np.minimum(self._least(change), self._least(AS_RECORDED)) if self.torque else self.floor
        gained, way = np.log(there / here), np.log(there / np.minimum(np.maximum(least, self.floor), there))
        made = self._as_recorded(change)[0] - self._design(AS_RECORDED).columns
        moved = (made @ fit.parameters - self._target(change) + self.samples.readings).std(axis=0)
        weights = np.maximum(np.log(np.maximum(moved, here) / here), np.abs(gained))
        units, changed = np.array(self.channels.units), np.maximum(moved, np.abs(there - here)) > here
        kinds = [changed & (units == unit) for unit in set(units)]
        explained = all(np.sum(here[kind] ** 2) <= UNEXPLAINED * np.sum(self.variation[kind] ** 2) for kind in kinds)
        return explained and bool(weights @ gained > 0.5 * weights @ way)

    def highest_score(self, change: Change | None, worth: float) -> float:
        """What `RobotFit.score` of changed data, whatever is changed without a ``change``, cannot exceed [nats].

        Every column is then explained to its floor, by the fewest numbers; one that holds one joint's torque, not better than
        by numbers of its own, of any sign (`alone`). ``worth`` is how many independent samples the data are worth.
        """
        left, count = self.floor, min(self._counts, default=0)
        if change is not None:
            count += change.numbers
            if self.torque or change.readings is None:
                left = self._least(change)
        return _score(_log_likelihood(left, self.floor), count, worth)

    def _least(self, change: Change) -> np.ndarray:
        """What each column leaves by itself, as the reading that it holds (c,): no robot leaves less."""
        columns = np.arange(len(self.channels))
        holds = columns if change.readings is None else np.abs(change.readings).argmax(axis=0)
        return self.alone(change)[columns, holds]

    def alone(self, change: Change) -> np.ndarray:
        """What each column leaves that is explained by itself as the reading of each channel (c, c) [unit of the column].

        The numbers of the explanation are a column's own, of any sign, so no robot leaves less. Columns are as recorded, whatever
        else the change does to them.
        """
        design = self._design(change)
        return design.left_alone(self._target(change)) if change.weight_added else design.alone

    def alone_by_nominal(self, change: Change) -> np.ndarray:
        """The same by nominal bodies (usual ones where the URDF has no masses), of any size and sign in each column (c, c)."""
        bodies, columns = self.bodies, self._design(change).columns
        rigid, beside = columns[:, :, : bodies.size] @ bodies.ravel(), columns[:, :, bodies.size :]
        out = np.empty((columns.shape[1],) * 2)
        for j in range(len(out)):
            basis = np.column_stack([rigid[:, j], beside[:, j, np.any(beside[:, j] != 0.0, axis=0)]])
            vectors, sizes, _ = np.linalg.svd(basis / np.maximum(np.linalg.norm(basis, axis=0), 1e-300), full_matrices=False)
            vectors = vectors[:, sizes > 1e-9 * sizes[0]]
            out[:, j] = rms(self.samples.readings - vectors @ (vectors.T @ self.samples.readings))
        return out

    @cached_property
    def bodies(self) -> np.ndarray:
        """The nominal bodies, or usual ones where the URDF has no masses (b, 10)."""
        return self.robot.nominal if self.has_masses else usual_bodies(self.robot)

    def rigid(self, bodies: np.ndarray) -> np.ndarray:
        """What bodies of these parameters (10 b,) or (b, 10) let the channels read, without friction and offsets (N, c)."""
        return self._design(AS_RECORDED).columns[:, :, : bodies.size] @ bodies.ravel()

    def beside(self, channel: int) -> np.ndarray:
        """Columns of the friction, or the offsets, of one channel (N, k)."""
        columns = self._design(AS_RECORDED).columns[:, channel, self.robot.nominal.size :]
        return columns[:, np.any(columns != 0.0, axis=0)]

    def size_beside(self, bodies: np.ndarray, change: Change = AS_RECORDED) -> float | None:
        """How many times the readings are those of given bodies (b, 10) with any friction; None where those say nothing."""
        factors = self._sized(bodies, None, change)[0]
        return float(factors[0]) if factors[0] > 0.0 else None

    def gained_by_size(self, bodies: np.ndarray, factor: float, change: Change = AS_RECORDED) -> float:
        """Log likelihood of a sample that bodies of any size gain over this many times the given ones, friction beside both."""
        left = [self._sized(bodies, fixed, change)[1] for fixed in (None, factor)]
        return _log_likelihood(left[0], self.floor) - _log_likelihood(left[1], self.floor)

    def _sized(self, bodies: np.ndarray, fixed: float | None, change: Change) -> tuple[np.ndarray, np.ndarray]:
        """Factors of the bodies (fixed, or None) and of everything beside them, and what they leave of each channel (c,)."""
        columns, squares = self._as_recorded(change)
        count = bodies.size
        expand = np.zeros((columns.shape[2], 1 + columns.shape[2] - count))
        expand[:count, 0] = bodies.ravel()
        expand[count:, 1:] = np.eye(columns.shape[2] - count)
        weights, target = self.floor**-2, self._target(change)
        if fixed is not None:
            target = target - columns @ (fixed * expand[:, 0])
        products = weights @ np.einsum("ncm,nc->cm", columns, target, optimize=True)
        free = expand if fixed is None else expand[:, 1:]
        factors = _non_negative(free.T @ np.tensordot(weights, squares, 1) @ free, free.T @ products, _HARDLY_ANY)
        return (factors if fixed is None else np.append(fixed, factors)), rms(target - columns @ (free @ factors))

    def _target(self, change: Change) -> np.ndarray:
        """Readings as recorded, with the weight that they lack (N, c)."""
        if not change.weight_added:
            return self.samples.readings
        rows, target = list(change.weight_added), self.samples.readings.copy()
        target[:, rows] += self.nominal_weight[:, rows]
        return target

    @cached_property
    def nominal_weight(self) -> np.ndarray:
        """What the weight of the nominal bodies lets the channels read (N, c)."""
        still = np.zeros_like(self.samples.positions)
        kernel = Kernel.of(self.robot, self.channels)
        return kernel.dynamics(self.samples.positions, still, still) @ self.robot.nominal.ravel()

    def _as_recorded(self, change: Change) -> tuple[np.ndarray, np.ndarray]:
        """Columns of all parameters in the columns of the table (N, c, p), and their products by column (c, p, p)."""
        design = self._design(change)
        if change.readings is None:
            return design.columns, design.squares
        made = np.linalg.inv(change.readings)
        if made.ndim == 2 and (np.count_nonzero(made, axis=1) == 1).all():  # each column holds one reading
            holds = np.abs(made).argmax(axis=1)
            times = made[np.arange(len(made)), holds]
            return times[:, None] * design.columns[:, holds], times[:, None, None] ** 2 * design.squares[holds]
        columns = made @ design.columns
        return columns, _squares(columns)

    def _design(self, change: Change) -> Design:
        """Design of the right readings."""
        parts = (change.joints, change.zeros, change.gravity, np.array(change.weightless))
        key = tuple(b"" if a is None else np.asarray(a, dtype=float).tobytes() for a in parts)
        if key in self._designs:
            return self._designs[key]
        s, robot = self.samples, self.robot
        motion = (s.positions, s.velocities, s.accelerations)
        if change.joints is not None:
            motion = tuple(m @ change.joints.T for m in motion)
        if change.zeros is not None:
            motion = (motion[0] + change.zeros, *motion[1:])
        if change.gravity is not None:
            robot = replace(robot, gravity=np.asarray(change.gravity, dtype=float))
        kernel = Kernel.of(robot, self.channels)
        rigid = kernel.dynamics(*motion)
        if change.weightless:
            rows = list(change.weightless)
            rigid[:, rows] = kernel.dynamics(*motion, gravity=False)[:, rows]
        beside = columns_beside(self.channels, motion[1], motion[2], s.motion)
        self._designs[key] = Design(np.concatenate([rigid, beside], axis=2), s.readings)
        return self._designs[key]


def independent_samples(residual: np.ndarray, part: np.ndarray) -> float:
    """How many independent samples residuals (N, c) of gap-free parts (N,) are worth: model error is correlated in time."""
    counts = []
    for column in (residual - residual.mean(axis=0)).T:
        power, time = max(float(column @ column), 1e-300), 1.0
        for lag in range(1, len(column)):
            same = part[lag:] == part[:-lag]
            rho = float(column[lag:][same] @ column[:-lag][same]) / power
            if rho <= 0.0:
                break
            time += 2.0 * rho
        counts.append(len(column) / time)
    return float(np.median(counts))


@dataclass(frozen=True, eq=False)
class Design:
    """Columns of all parameters, and what follows from them."""

    columns: np.ndarray  # readings of each parameter of one (N, c, p)
    readings: np.ndarray  # as recorded (N, c)

    @cached_property
    def squares(self) -> np.ndarray:
        """Products of columns by channel (c, p, p)."""
        return _squares(self.columns)

    @cached_property
    def alone(self) -> np.ndarray:
        """What each column of the table leaves, by itself, as the reading of each channel (c, c)."""
        return self.left_alone(self.readings)

    def left_alone(self, readings: np.ndarray) -> np.ndarray:
        """Least-squares residual of each column of readings (N, c) by the columns of each channel, rms (column, channel)."""
        columns, squares = self.columns, self.squares
        out, power = np.empty((readings.shape[1], columns.shape[1])), np.mean(readings**2, axis=0)
        for j in range(columns.shape[1]):
            size = np.sqrt(np.diag(squares[j]))
            seen = size > 1e-9 * size.max()
            scaled = squares[j][np.ix_(seen, seen)] / np.outer(size[seen], size[seen])
            root = cholesky(scaled + _HARDLY_ANY * np.eye(len(scaled)))
            products = (columns[:, j, seen] / size[seen]).T @ readings
            explained = np.sum(products * cho_solve((root, False), products), axis=0) / len(readings)
            out[:, j] = np.sqrt(np.maximum(power - explained, 0.0))
        return out


def rms(residual: np.ndarray) -> np.ndarray:
    """Root mean square of each column of residuals (N, ...)."""
    return np.sqrt(np.mean(residual**2, axis=0))


def _squares(columns: np.ndarray) -> np.ndarray:
    return np.array([columns[:, c].T @ columns[:, c] for c in range(columns.shape[1])])


def _non_negative(squares: np.ndarray, products: np.ndarray, ridge: float, own: np.ndarray | float = 0.0) -> np.ndarray:
    """Least squares with factors that are not negative, from its normal equations.

    ``ridge`` is that of the equations scaled to a diagonal of ones, ``own`` that of each factor as it is.
    """
    size = np.sqrt(np.maximum(np.diag(squares), 0.0))  # rounding of what no reading shows is of either sign
    seen = size > 1e-9 * size.max()
    out = np.zeros(len(size))
    if not seen.any():  # SciPy's solver ends the whole process on an empty matrix
        return out
    scaled = squares[np.ix_(seen, seen)] / np.outer(size[seen], size[seen])
    root = cholesky(scaled + np.diag(ridge + np.broadcast_to(own, len(size))[seen] / size[seen] ** 2))
    out[seen] = nnls(root, solve_triangular(root, products[seen] / size[seen], trans=1))[0] / size[seen]
    return out


def _log_likelihood(left: np.ndarray, floor: np.ndarray) -> float:
    """Log likelihood of one sample, by what is left of each column (c,), and what is no evidence (c,)."""
    return -float(np.log(np.maximum(left, floor)).sum())


def _score(log_likelihood: float, count: int, worth: float) -> float:
    """Score by the Bayesian information criterion [nats]."""
    return worth * log_likelihood - 0.5 * count * float(np.log(max(worth, 2.0)))
