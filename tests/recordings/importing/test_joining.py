"""Quantities of several rates at common times, against sines whose means and courses are known."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import bayesid
from bayesid.errors import InputError
from bayesid.recordings.importing.clock import RowTimes
from bayesid.recordings.importing.recording import join
from bayesid.recordings.importing.signals import Signal
from tests.recordings.importing.logs import JOINTS, Known, make_known

W = 2.0 * np.pi * 1.3


def signal(quantity: str, rate: float, start: float = 0.0, end: float = 10.0, hole=(0.0, 0.0)) -> Signal:
    """A sine of 1.3 Hz, without the samples of a hole."""
    times = start + np.arange(round((end - start) * rate)) / rate
    times = times[(times < hole[0]) | (times >= hole[1])]
    ours = ("fx", "fy", "fz", "mx", "my", "mz") if quantity == "wrench" else (f"{quantity}1",)
    values = np.repeat(np.sin(W * times)[:, None], len(ours), axis=1)
    clock = RowTimes("header", "stamps", times, None)
    return Signal(quantity, ours, times, values, ours, ("",) * len(ours), (1.0,) * len(ours), f"/{quantity}", clock, len(times))


def test_readings_of_a_faster_topic_are_averaged_about_each_row():
    """The mean of a sine over a step h is the sine times ``sin(w h / 2) / (w h / 2)``: without a delay."""
    times, columns, *_ = join([signal("q", 50.0), signal("wrench", 1000.0, start=-0.1)], "log")
    half = 0.5 * W / 50.0
    inner = slice(1, -1)
    exact = np.sin(W * times) * np.sin(half) / half
    np.testing.assert_allclose(columns["fx"][inner], exact[inner], atol=0.25 * (W * 1e-3) ** 2)
    np.testing.assert_array_equal(times, signal("q", 50.0).times[: len(times)])


def test_positions_of_a_faster_or_shifted_topic_are_interpolated_to_the_readings():
    """The error of a cubic spline is below ``5/384 w^4 h^4`` inside."""
    for rate, start in ((250.0, -0.0013), (100.0, 0.004)):
        times, columns, *_ = join([signal("q", rate, start), signal("wrench", 100.0)], "log")
        inner = slice(20, -20)
        left = np.abs(columns["q1"] - np.sin(W * times))[inner]
        assert left.max() < 5.0 / 384.0 * (W / rate) ** 4 * 1.1
        np.testing.assert_array_equal(columns["fx"], np.sin(W * times))


@pytest.mark.parametrize("quantity", ["q", "qr"])
@pytest.mark.parametrize("hole", [(0.0, 0.0), (3.0, 3.5)])
def test_angles_that_wrap_are_interpolated_as_if_they_did_not(quantity, hole):
    """A joint that turns round and round passes no angle in between where its reading jumps by a turn."""
    fast = signal(quantity, 500.0, hole=hole)
    course = 2.5 * fast.times[:, None] + 0.3 * fast.values
    turning, wrapped = (replace(fast, values=x) for x in (course, (course + np.pi) % (2.0 * np.pi) - np.pi))
    rows = signal("wrench", 100.0, start=0.0007)
    (_, exact, _, plain), (_, columns, _, how) = join([turning, rows], "log"), join([wrapped, rows], "log")
    np.testing.assert_allclose(columns[f"{quantity}1"], exact[f"{quantity}1"], atol=1e-12)
    assert "angles wrap at a full turn; unwrapped and interpolated" in how[0] and "wrap" not in plain[0]


def test_nothing_is_filled_in_across_a_gap_or_beyond_an_end():
    signals = [signal("q", 100.0, hole=(3.0, 3.5)), signal("wrench", 100.0, start=0.0042, end=12.0)]
    times, columns, _, how = join(signals, "log")
    assert not ((times > 3.0) & (times < 3.48)).any() and times[-1] < 10.0
    assert "rows are left out, in which a topic has a gap, has not begun or has ended" in how[-1]
    assert np.isfinite(columns["q1"]).all()
    with pytest.raises(InputError, match="topics do not overlap in time: positions of /q from 0 to 9.99 s"):
        join([signal("q", 100.0), signal("wrench", 100.0, start=20.0, end=30.0)], "log")


def test_velocities_of_few_rows_cost_no_rows():
    """Nothing is fitted to them; the rows that lack them were left out."""
    q, tau, v = signal("q", 100.0), signal("tau", 100.0), signal("v", 100.0, start=7.0)
    times, columns, _, how = join([q, v, tau], "log")
    assert len(times) == len(q.times) and "v1" not in columns
    assert how == ["velocities of /v: none at most rows; not used"]
    assert len(join([q, signal("v", 100.0, start=3.0), tau], "log")[0]) == 700


@pytest.fixture(scope="module")
def known(tmp_path_factory: pytest.TempPathFactory) -> Known:
    return make_known(tmp_path_factory.mktemp("known"))


def test_a_reading_that_is_missing_now_and_then_is_left_out_not_filled_in(known, tmp_path: Path):
    wrench = known.wrench.copy()
    wrench[100:103] = np.nan
    np.savez(tmp_path / "log.npz", t=known.t, q=known.q, tau=known.tau, wrench=wrench)
    imported = bayesid.read_recording(tmp_path / "log.npz", known.urdf, joints=JOINTS, sensor="wrist_ft")
    table = imported.experiment.motions[0].table
    np.testing.assert_array_equal(table.positions, np.delete(known.q, [100, 101, 102], axis=0))
    assert any("3 rows without a reading" in text for text in imported.experiment.warnings)
