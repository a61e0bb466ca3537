"""Planned motions as tables: columns ``t, q1 ..., v1 ..., a1 ...``, as ``excite`` writes and ``simulate`` takes them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
import pandas as pd
from scipy.interpolate import make_interp_spline

from bayesid.errors import InputError
from bayesid.recordings.table_reader import read_table
from bayesid.robot.robot import Robot
from bayesid.simulation.trajectories import Trajectory

_FEWEST = 8  # a spline of degree seven needs so many samples
_DIGITS = "%.9g"


def write_trajectory(trajectory: Trajectory, path: str | Path) -> None:
    """Write a motion as CSV: ``t``, then positions, velocities and accelerations of joint 1 to n."""
    joints = range(1, trajectory.positions.shape[1] + 1)
    names = ["t", *(f"{letter}{j}" for letter in "qva" for j in joints)]
    cells = np.column_stack([trajectory.times, trajectory.positions, trajectory.velocities, trajectory.accelerations])
    pd.DataFrame(cells, columns=names).to_csv(path, index=False, float_format=_DIGITS)


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
        It is no such table, or has too few rows.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: no such file; give a table with columns t, q1 ... q{robot.n}")
    table, _ = read_table(path, path.name, robot.n, wrench=False)
    if len(table) < _FEWEST:
        raise InputError(f"{path.name}: {len(table)} rows are no motion; give at least {_FEWEST}")
    rates = [table.velocities, _accelerations(path, robot.n)]
    if any(part is None for part in rates):
        curve = make_interp_spline(table.times, table.positions, k=7)
        rates = [curve(table.times, k + 1) if part is None else part for k, part in enumerate(rates)]
    name = re.sub(r"[^A-Za-z0-9_-]+", "_", path.stem) or "motion"
    times, positions, (v, a) = np.array(table.times), np.array(table.positions), map(np.asarray, rates)
    still = table.velocities is not None and not v.any() and not a.any()
    parked = still and not np.ptp(positions, axis=0).any()
    return Trajectory(
        name, role, times, positions, v, a, kind="poses" if still and not parked else "trajectory",
        parked=((float(times[0]), float(times[-1])),) if parked else (),
    )  # fmt: skip


def planned_trajectories(robot: Robot, paths: Sequence[str | Path], static: bool = False) -> list[Trajectory]:
    """Planned motions of several files: where there are two or more, the last is for validation.

    Parameters
    ----------
    robot
        Whose motions they are.
    paths
        Tables as `read_trajectory` takes them.
    static
        Whether stop-and-go runs follow.

    Raises
    ------
    InputError
        One is no such table, or two have the same name.
    """
    out = []
    for k, path in enumerate(paths):
        last = k == len(paths) - 1 and k > 0
        found = read_trajectory(path, robot, "validation" if last else "identification")
        if found.name in [other.name for other in out]:
            raise InputError(f"{path}: another motion is named {found.name} as well; name the files apart")
        out.append(replace(found, static_positions=found.positions) if static else found)
    return out


def _accelerations(path: Path, joints: int) -> np.ndarray | None:
    """Columns ``a1 ... an`` (N, n) of a table whose other columns were read; None where they are not all there."""
    if path.suffix.lower() != ".csv":
        return None
    names = [f"a{j}" for j in range(1, joints + 1)]
    head = pd.read_csv(path, nrows=0, skipinitialspace=True, encoding="utf-8-sig")
    head.columns = [str(c).strip() for c in head.columns]
    if not set(names) <= set(head.columns):
        return None
    places = [list(head.columns).index(name) for name in names]
    frame = pd.read_csv(path, usecols=places, skipinitialspace=True, encoding="utf-8-sig")
    frame.columns = [str(c).strip() for c in frame.columns]
    try:
        values = frame[names].to_numpy(np.float64)
    except ValueError:
        raise InputError(f"{path.name}: columns a1 ... a{joints} hold more than numbers; correct or remove them") from None
    if not np.isfinite(values).all():
        raise InputError(f"{path.name}: columns a1 ... a{joints} have empty cells; fill or remove them")
    return values
