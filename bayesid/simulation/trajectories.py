"""True motions for a simulation: new ones within a robot's limits, recorded ones again, or those of a table.

Tables have the columns ``t, q1 ..., v1 ..., a1 ...``, as ``excite`` writes and ``simulate`` takes them.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from scipy.interpolate import make_interp_spline

from bayesid.argument_types import explains_types
from bayesid.errors import BayesidWarning, InputError
from bayesid.recordings.examination import check_positions
from bayesid.recordings.experiment import Experiment, Motion
from bayesid.recordings.motion_checks import check_velocities
from bayesid.recordings.table_reader import open_parquet, read_table
from bayesid.robot.robot import Robot, motion_limits
from bayesid.signals.smoothing import choose_smoother, smooth

_MOST_SAMPLES = 10_000_000
_FEWEST = 8  # a spline of degree seven needs so many samples
_DIGITS = "%.9g"


@explains_types
@dataclass(frozen=True, eq=False)
class Trajectory:
    """A true motion.

    Attributes
    ----------
    name, role, kind, period, parked
        As in `bayesid.recordings.experiment.Motion`.
    times
        (N,) [s].
    positions, velocities, accelerations
        (N, n) [rad or m and per second (squared)].
    static_positions
        Poses at which the robot is read at rest (k, n); those of the motion itself make a stop-and-go run.
    """

    name: str
    role: Literal["identification", "validation"]
    times: np.ndarray
    positions: np.ndarray
    velocities: np.ndarray
    accelerations: np.ndarray
    kind: Literal["trajectory", "poses"] = "trajectory"
    static_positions: np.ndarray | None = None
    period: float | None = None
    parked: tuple[tuple[float, float], ...] = ()

    def __repr__(self) -> str:
        return f"<Trajectory {self.name} ({self.role}): {len(self.times)} samples, {self.positions.shape[1]} joints>"


@explains_types
def fourier_trajectory(
    robot: Robot,
    name: str = "identification",
    role: Literal["identification", "validation"] = "identification",
    *,
    duration: float = 20.0,
    rate: float = 125.0,
    fundamental: float = 0.1,
    harmonics: int = 5,
    share: float = 0.8,
    static: bool = False,
    seed: int = 0,
) -> Trajectory:
    """A random periodic motion, ``sum_k a_k sin(2 pi k f t + p_k)``, about the middle of every joint's range.

    Parameters
    ----------
    robot
        Its position and velocity limits; where there are none, those of a small arm. Nothing looks out for
        collisions.
    name, role
        Of the motion.
    duration, rate
        Length [s] and samples a second.
    fundamental, harmonics
        f [Hz] and how many multiples of it.
    share
        How much of the limits is used at most.
    static
        Whether a stop-and-go run follows.
    seed
        Of amplitudes and phases.

    Raises
    ------
    InputError
        Fewer than 20 samples, or a rate too low for the motion.
    """
    if not (duration > 0 and rate > 0 and 20 <= duration * rate <= _MOST_SAMPLES):
        raise InputError(
            f"duration = {duration:g} s at {rate:g} samples a second: give at least 20 and at most {_MOST_SAMPLES:,} samples"
        )
    if rate < 10 * harmonics * fundamental:
        raise InputError(f"rate = {rate:g}: give at least {10 * harmonics * fundamental:g} samples a second for this motion")
    rng = np.random.default_rng(seed)
    omega = 2 * np.pi * fundamental * np.arange(1, harmonics + 1)
    # Amplitudes falling as 1/k: every harmonic has the same share of the speed.
    amplitude = rng.normal(1.0, 0.4, (harmonics, robot.n)) / np.arange(1, harmonics + 1)[:, None]
    phase = rng.uniform(0, 2 * np.pi, (harmonics, robot.n))

    def series(times: np.ndarray, derivative: int) -> np.ndarray:
        angle = times[:, None, None] * omega[:, None] + phase + derivative * np.pi / 2
        return np.sum(omega[:, None] ** derivative * amplitude * np.sin(angle), axis=1)

    cycle = np.linspace(0, 1 / fundamental, 100 * harmonics)
    path, speed = series(cycle, 0), np.abs(series(cycle, 1)).max(axis=0)
    lower, upper, fastest = motion_limits(robot)
    scale = share * np.minimum((upper - lower) / np.ptp(path, axis=0), fastest / speed)
    middle = 0.5 * (lower + upper) - 0.5 * scale * (path.max(axis=0) + path.min(axis=0))
    times = np.arange(int(round(duration * rate))) / rate
    q = middle + scale * series(times, 0)
    return Trajectory(
        name, role, times, q, scale * series(times, 1), scale * series(times, 2), static_positions=q if static else None,
        period=1 / fundamental if duration >= 2 / fundamental else None,
    )  # fmt: skip


def new_trajectories(
    robot: Robot, duration: float = 20.0, rate: float = 125.0, static: bool = False, seed: int = 0
) -> list[Trajectory]:
    """One motion for identification and another, 1.3 times as fast, for validation."""
    first, second = (int(s.generate_state(1)[0]) for s in np.random.SeedSequence(seed).spawn(2))
    return [
        fourier_trajectory(robot, duration=duration, rate=rate, static=static, seed=first),
        fourier_trajectory(
            robot, "validation", "validation", duration=duration, rate=rate, static=static, fundamental=0.13, seed=second
        ),
    ]


@dataclass(frozen=True, eq=False)
class RecordedMotion:
    """A recorded motion as a function of time: its smoothed positions are taken for the true ones."""

    motion: Motion  # as it was recorded
    #: Times (N,) [s] and encoder positions (N, n) [rad or m] between gaps; none of poses at rest.
    pieces: tuple[tuple[np.ndarray, np.ndarray], ...]
    bandwidth: float  # up to which motion is kept [Hz]

    @classmethod
    def of(cls, motion: Motion, experiment: Experiment) -> RecordedMotion:
        """Smooth a motion of an experiment; InputError where it has no segment of 20 samples without a gap."""
        table = motion.table
        if motion.kind == "poses":
            return cls(motion, (), 0.0)
        pieces = [(table.times[p], table.positions[p]) for p in table.segments() if p.stop - p.start >= 20]
        if not pieces:
            raise InputError(f"{table.source}: no segment of 20 samples without a gap; simulate new motions instead")
        chosen = choose_smoother(pieces, experiment.position_resolution, experiment.position_std)
        return cls(motion, tuple(pieces), chosen.bandwidth)

    def trajectory(self, retimed: Callable[[np.ndarray], np.ndarray] | None = None) -> Trajectory:
        """The true motion at the times of its samples, or at those that these are ``retimed`` to within their piece [s]."""
        motion = self.motion
        if self.pieces:
            at = [times if retimed is None else retimed(times) for times, _ in self.pieces]
            parts = [smooth(*piece, self.bandwidth, at=t) for piece, t in zip(self.pieces, at, strict=True)]
            q, v, a = (np.concatenate(part) for part in zip(*parts, strict=True))
            times = np.concatenate(at)
        else:
            times, q = motion.table.times, motion.table.positions
            v = a = np.zeros_like(q)
        static = None if motion.static is None else q if motion.stop_and_go else motion.static.positions
        return Trajectory(motion.name, motion.role, times, q, v, a, motion.kind, static, motion.period, motion.parked)


def recorded_trajectories(experiment: Experiment) -> list[Trajectory]:
    """The motions of an experiment again: its smoothed positions are taken for the true ones."""
    return [RecordedMotion.of(motion, experiment).trajectory() for motion in experiment.motions]


def make_trajectories(
    setup: Experiment, *, new: bool, duration: float = 20.0, rate: float = 125.0, static: bool | None = None, seed: int = 0
) -> list[Trajectory]:
    """New motions, or an experiment's own, with or without stop-and-go runs (None: as recorded, new ones without).

    Parameters are those of `new_trajectories`.
    """
    if new:
        return new_trajectories(setup.robot, duration, rate, bool(static), seed)
    own = recorded_trajectories(setup)
    if static is not None:  # poses are at rest themselves
        own = [replace(t, static_positions=t.positions if static and t.kind != "poses" else None) for t in own]
    return own


@explains_types
def write_trajectory(trajectory: Trajectory, path: str | Path) -> None:
    """Write a motion as CSV: ``t``, then positions, velocities and accelerations of joint 1 to n."""
    joints = range(1, trajectory.positions.shape[1] + 1)
    names = ["t", *(f"{letter}{j}" for letter in "qva" for j in joints)]
    cells = np.column_stack([trajectory.times, trajectory.positions, trajectory.velocities, trajectory.accelerations])
    import pandas as pd  # it takes long, and few need it

    pd.DataFrame(cells, columns=names).to_csv(path, index=False, float_format=_DIGITS)


@explains_types
def read_trajectory(
    path: str | Path, robot: Robot, role: Literal["identification", "validation"] = "identification"
) -> Trajectory:
    """Read a planned motion; its name is the file's.

    Velocities and accelerations that the table lacks are those of a smooth curve through the positions. Where it says that the
    robot never moves, its rows are poses at rest, or it is parked where they are all the same.

    Parameters
    ----------
    path
        A table with columns ``t, q1 ... qn`` and, optionally, ``v1 ... vn`` and ``a1 ... an``.
    robot
        Whose motion it is.
    role
        Of the motion.

    Raises
    ------
    InputError
        It is no such table, has too few rows, positions far beyond the robot's limits, or velocities in another unit than these.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: no such file; give a table with columns t, q1 ... q{robot.n}")
    table, _ = read_table(path, path.name, robot.n, wrench=False)
    if len(table) < _FEWEST:
        raise InputError(f"{path.name}: {len(table)} rows are no motion; give at least {_FEWEST}")
    rates = [table.velocities, _accelerations(path, robot.n, table.dropped)]
    if any(part is None for part in rates):
        curve = make_interp_spline(table.times, table.positions, k=7)
        rates = [curve(table.times, k + 1) if part is None else part for k, part in enumerate(rates)]
    name = re.sub(r"[^A-Za-z0-9_-]+", "_", path.stem) or "motion"
    times, positions, (v, a) = np.array(table.times), np.array(table.positions), map(np.asarray, rates)
    still = table.velocities is not None and not v.any() and not a.any()
    doubts = check_positions(table, robot)
    if not still:
        doubts += check_velocities(table, robot)
    for warning in doubts:
        warnings.warn(warning, BayesidWarning, stacklevel=2)
    parked = still and not np.ptp(positions, axis=0).any()
    return Trajectory(
        name, role, times, positions, v, a, kind="poses" if still and not parked else "trajectory",
        parked=((float(times[0]), float(times[-1])),) if parked else (),
    )  # fmt: skip


def as_trajectory(given: object, robot: Robot) -> Trajectory:
    """A planned motion, or that of a table; an `InputError` where it is neither, or of other joints than the robot's."""
    if isinstance(given, (str, Path)):
        return read_trajectory(given, robot)
    if not isinstance(given, Trajectory):
        raise InputError(f"a {type(given).__name__} is given among the trajectories; pass tables or bayesid.Trajectory objects")
    if given.positions.shape[1] != robot.n:
        raise InputError(
            f"trajectory '{given.name}': {given.positions.shape[1]} joints but the robot has {robot.n}; "
            "give one column for each joint"
        )
    return given


def planned_trajectories(robot: Robot, paths: Sequence[str | Path], static: bool = False) -> list[Trajectory]:
    """Planned motions of several files: where there are two or more, the last is for validation.

    Tables are as `read_trajectory` takes them, of different names; ``static`` says whether stop-and-go runs follow.
    """
    out = []
    for k, path in enumerate(paths):
        last = k == len(paths) - 1 and k > 0
        found = read_trajectory(path, robot, "validation" if last else "identification")
        if found.name in [other.name for other in out]:
            raise InputError(f"{path}: another motion is named {found.name} as well; name the files apart")
        out.append(replace(found, static_positions=found.positions) if static and found.kind != "poses" else found)
    return out


def _accelerations(path: Path, joints: int, dropped: np.ndarray) -> np.ndarray | None:
    """Columns ``a1 ... an`` (N, n) of a table whose other columns were read; None where they are not all there.

    ``dropped`` are the rows that were left out of the others.
    """
    import pandas as pd

    names = [f"a{j}" for j in range(1, joints + 1)]
    if path.suffix.lower() in (".parquet", ".pq"):
        frame = open_parquet(path, path.name).read().to_pandas(ignore_metadata=True)
    else:
        frame = pd.read_csv(path, skipinitialspace=True, encoding="utf-8-sig").rename(columns=str.strip)
    if not set(names) <= set(frame.columns):
        return None
    try:
        values = np.delete(frame[names].to_numpy(np.float64), dropped, axis=0)
    except ValueError:
        raise InputError(f"{path.name}: columns a1 ... a{joints} hold more than numbers; correct or remove them") from None
    if not np.isfinite(values).all():
        raise InputError(f"{path.name}: columns a1 ... a{joints} have empty cells; fill or remove them")
    return values
