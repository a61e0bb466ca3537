"""What is recorded beside an exciting trajectory: scripted blocks with what each shows, and the static run.

Blocks cost two minutes and show what no optimised motion does: the noise alone (parked), gravity and offset alone (poses), what
changes its sign with the velocity (reversed), and what grows with speed (ladder).

For the static run the paper stops at every sampling position of the motion, for the wrench at rest is to be subtracted sample by
sample [Liu1998]_. A motion that repeats needs one period of stops only, whose readings serve every period; and a motion's gravity
wrench is so smooth that fewer stops, fitted along as poses, tell as much. From stop to stop the joints move with a polynomial of
degree five, ``T = max(1.875 |d| / speed, sqrt(5.774 |d| / acceleration))``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayesid.arguments import argument
from bayesid.design.excitation.limits import Limits
from bayesid.design.excitation.plan import Plan
from bayesid.design.excitation.series import FourierSeries
from bayesid.dynamics.base_parameters import structural_base
from bayesid.dynamics.regressors import Kernel
from bayesid.errors import InputError
from bayesid.simulation.trajectories import Trajectory

#: Peak speed and acceleration of the polynomial of degree five from rest to rest, for a way and time of one.
_SPEED, _ACCELERATION = 1.875, 10.0 / np.sqrt(3.0)
#: What there is, and what it shows.
BLOCKS = {
    "parked": "the robot stands still: the noise of every channel, and its colour",
    "poses": "separate poses at rest: gravity and offsets, without anything that needs motion",
    "reversed": "the motion backwards in time: what changes its sign with the velocity, such as friction and delay",
    "ladder": "the motion at a third and two thirds of its speed: what grows with speed, and what does not",
}
PARKED, POSES, LADDER = 25.0, 8, (1 / 3, 2 / 3)
_CANDIDATES = 400


@dataclass(frozen=True, eq=False)
class StopAndGo:
    """Stops of a static run."""

    positions: np.ndarray  # where the robot stops (k, n) [rad or m]
    #: Times at which it arrives, and between which it is read (k,) [s].
    arrive: np.ndarray
    start: np.ndarray
    end: np.ndarray
    rows: np.ndarray  # row of ``trajectory.csv`` that each stop belongs to (k,)
    every_sample: bool  # whether every sample of the motion has its stop, so that readings can be subtracted row by row

    @property
    def seconds(self) -> float:
        """How long the run takes [s]."""
        return float(self.end[-1])

    def __repr__(self) -> str:
        return f"<StopAndGo: {len(self.rows)} stops, {self.seconds / 60:.1f} min>"


def stop_and_go(
    series: FourierSeries, limits: Limits, rate: float, *, stops: int | None = None, settle: float = 0.3, read: float = 0.2
) -> StopAndGo:
    """Schedule of a static run over one period.

    ``rate`` is that of the motion's samples [1/s], ``stops`` how many there are, evenly in time (None: at every sample),
    ``settle`` and ``read`` how long the robot waits before a reading and how long it is read [s].
    """
    samples = int(round(series.period * rate))
    count = samples if stops is None else stops
    rows = np.round(np.linspace(0, samples, count, endpoint=False)).astype(int)
    q = series.at(rows / rate)[0]
    m = limits.moving
    way = np.abs(np.diff(q, axis=0))[:, m]
    moves = np.maximum(_SPEED * way / limits.speed[m], np.sqrt(_ACCELERATION * way / limits.acceleration[m])).max(axis=1)
    arrive = np.concatenate([[0.0], np.cumsum(moves + settle + read)])
    return StopAndGo(q, arrive, arrive + settle, arrive + settle + read, rows, len(rows) == samples)


@dataclass(frozen=True, eq=False)
class ScriptedBlock:
    """A scripted block."""

    #: One of `BLOCKS`, and what it shows.
    kind: str
    shows: str
    trajectory: Trajectory  # its motion; its name is that of its table

    @property
    def seconds(self) -> float:
        """How long it takes [s]; poses: without the way between them."""
        return 0.0 if self.trajectory.kind == "poses" else float(self.trajectory.times[-1])


def scripted_blocks(plan: Plan, kinds: Sequence[str]) -> tuple[tuple[ScriptedBlock, ...], tuple[str, ...]]:
    """Motions of the blocks asked for, ``all`` for all of `BLOCKS`, and notes of what was left out."""
    out, notes = [], []
    for kind in BLOCKS if "all" in kinds else dict.fromkeys(kinds):
        for motion in _MAKERS[kind](plan):
            if _fits(plan, motion):
                out.append(ScriptedBlock(kind, BLOCKS[kind], motion))
            else:
                notes.append(f"Block {motion.name} is left out: at rest or slower, the robot's weight alone breaks a limit.")
    return tuple(out), tuple(notes)


def check_blocks(kinds: Sequence[str]) -> None:
    """Refuse a block that there is not, with an `InputError`."""
    for kind in kinds:
        if kind not in (*BLOCKS, "all"):
            raise InputError(f"{argument('blocks', kind)}: choose some of {', '.join(BLOCKS)}, or all")


def _fits(plan: Plan, motion: Trajectory) -> bool:
    """Whether torques and the sensor's load stay within limits; positions are those of the trajectory, rates no larger."""
    states = motion.positions, motion.velocities, motion.accelerations
    return all(np.abs(load.ratios(states)).max() <= 1.0 for load in plan.task.limits.loads)


def _parked(plan: Plan) -> list[Trajectory]:
    times = np.arange(int(round(PARKED * plan.options.rate)) + 1) / plan.options.rate
    q = np.tile(plan.trajectory.positions[0], (len(times), 1))
    rest = np.zeros_like(q)
    return [Trajectory("parked", "identification", times, q, rest, rest, parked=((0.0, float(times[-1])),))]


def _poses(plan: Plan) -> list[Trajectory]:
    """Poses of the motion that tell most of gravity together: chosen one by one for the largest determinant."""
    robot, channels = plan.experiment.robot, plan.task.information.channels
    candidates = plan.series.at(np.linspace(0.0, plan.series.period, _CANDIDATES, endpoint=False))[0]
    rest = np.zeros_like(candidates)
    still = candidates, rest, rest
    allowed = np.ones(len(candidates), bool)
    for load in plan.task.limits.loads:
        allowed &= np.abs(load.ratios(still)).max(axis=1) <= 1.0
    candidates, rest = candidates[allowed], rest[allowed]
    if not len(candidates):
        return []
    base = structural_base(robot, channels, at_rest=True)
    rows = Kernel.of(robot, channels, base.independent).dynamics(candidates, rest, rest)
    rows = rows / np.maximum(np.sqrt(np.mean(rows**2, axis=(0, 1))), 1e-12)
    information, chosen = 1e-6 * np.eye(base.rank), []
    for _ in range(min(POSES, len(candidates))):
        inner = np.eye(rows.shape[1]) + rows @ np.linalg.solve(information, rows.swapaxes(1, 2))
        gain = np.linalg.slogdet(inner)[1]
        gain[chosen] = -np.inf
        chosen.append(int(np.argmax(gain)))
        information = information + rows[chosen[-1]].T @ rows[chosen[-1]]
    order = sorted(chosen)  # along the motion: the way between them is known to be free
    q, times = candidates[order], np.arange(float(len(order)))
    return [Trajectory("poses", "identification", times, q, rest[: len(order)], rest[: len(order)], kind="poses")]


def _reversed(plan: Plan) -> list[Trajectory]:
    t = plan.trajectory
    q, v, a = t.positions[::-1], -t.velocities[::-1], t.accelerations[::-1]
    return [replace(t, name="reversed", positions=q, velocities=v, accelerations=a, static_positions=None)]


def _ladder(plan: Plan) -> list[Trajectory]:
    out = []
    for share in LADDER:
        times = np.arange(int(round(plan.series.period / share * plan.options.rate)) + 1) / plan.options.rate
        q, v, a = plan.series.at(share * times)
        name = f"speed-{round(100 * share)}"
        out.append(Trajectory(name, "identification", times, q, share * v, share**2 * a))
    return out


_MAKERS = {"parked": _parked, "poses": _poses, "reversed": _reversed, "ladder": _ladder}
