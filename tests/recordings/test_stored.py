"""Tables that stay in their file: what of a row may be missing, beside the same table read whole."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from bayesid.recordings.stored import StoredTable, stored_table
from bayesid.recordings.table import Table
from bayesid.recordings.table_reader import read_table


def both(frame: pd.DataFrame, folder: Path, name: str) -> tuple[Table, StoredTable]:
    """The table of two joints read whole, and the one that stays in its file."""
    pytest.importorskip("pyarrow", reason="the extra 'parquet' is not installed")
    frame.to_csv(folder / name, index=False) if name.endswith("csv") else frame.to_parquet(folder / name)
    kept = stored_table(folder / name, name, 2, True, True)
    assert kept is not None
    return read_table(folder / name, name, 2, True)[0], kept


def recorded() -> pd.DataFrame:
    t = np.arange(1000) / 125.0
    course = np.sin(np.outer(t, [1.0, 2.0, 3.0, 4.0]))
    return pd.DataFrame({"t": t} | dict(zip(("q1", "q2", "tau1", "tau2"), course.T, strict=True)))


@pytest.mark.parametrize("name", ["long.csv", "long.parquet"])
def test_a_gap_is_found_although_a_time_is_missing(name: str, tmp_path: Path) -> None:
    frame = recorded()
    frame.loc[10, "t"] = np.nan
    whole, kept = both(frame.drop(index=range(400, 600)), tmp_path, name)
    assert kept.segments() == whole.segments() and len(kept.segments()) == 2


def test_a_gap_is_found_where_every_row_was_written_by_itself(tmp_path: Path) -> None:
    """A logger that appends to Parquet as samples come makes a row group of each."""
    pytest.importorskip("pyarrow", reason="the extra 'parquet' is not installed")
    recorded()[:90].drop(index=range(40, 60)).to_parquet(tmp_path / "long.parquet", row_group_size=1)
    kept = stored_table(tmp_path / "long.parquet", "long.parquet", 2, True, True)
    assert kept is not None and kept.segments() == [slice(0, 40), slice(40, 70)]


@pytest.mark.parametrize("name", ["long.csv", "long.parquet"])
def test_a_joint_without_any_torque_is_as_in_a_table_read_whole(name: str, tmp_path: Path) -> None:
    whole, kept = both(recorded().assign(tau1=np.nan), tmp_path, name)
    np.testing.assert_array_equal(kept.excerpt().torques, whole.torques)
    assert kept.excerpt().torque_joints == (1,) and "column tau1: no torque in the first 1,000 rows" in kept.notes[-1]
    wrench = {axis: 1.0 for axis in ("fx", "fy", "fz", "mx", "my", "mz")}
    _, kept = both(recorded().assign(tau1=np.nan, tau2=np.nan, **wrench), tmp_path, name)
    assert kept.excerpt().torques is None and len(kept) == 1000
