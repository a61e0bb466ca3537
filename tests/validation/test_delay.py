"""Two clocks: a constant delay is found with its size and uncertainty, and nowhere where there is none."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import bayesid
from bayesid.recordings.experiment import Experiment, Motion, Sensor, load_experiment
from bayesid.recordings.table import Table
from bayesid.validation.mistakes import shifts
from bayesid.validation.mistakes.shifts import Profile, delay_profile, delayed
from tests.malformed import DATA, FOLDERS
from tests.simulated import experiment, fourier, puma2, recording

WILD = DATA / "wild"


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> Experiment:
    robot = puma2(tmp_path_factory.mktemp("delay"))
    sensor = Sensor(translation=np.array([0.0, 0.0, -0.1]))
    noise = dict(force_std=2.0, torque_std=0.5, resolution=1e-4)
    motions = [
        Motion(name, role, recording(robot, sensor, fourier(robot, seed, duration=20.0), seed=seed, **noise))
        for name, role, seed in (("identification", "identification", 1), ("validation", "validation", 2))
    ]
    return experiment(robot, motions, sensor)


def later(table: Table, delay: float, field: str) -> Table:
    """The recording whose readings come later by a time: each row holds what was true before."""
    read = getattr(table, field)
    moved = np.stack([np.interp(table.times - delay, table.times, column) for column in read.T], axis=1)
    return replace(table, **{field: moved})


def shifted(given: Experiment, delay: float, field: str) -> Experiment:
    motions = tuple(replace(m, table=later(m.table, delay, field), examined=False) for m in given.motions)
    return replace(given, motions=motions, warnings=(), findings=())


@pytest.mark.parametrize(("channel", "field"), [("torque", "torques"), ("wrench", "wrench")])
@pytest.mark.parametrize("delay", [-0.2, -0.045, 0.03, 0.071, 0.35])
def test_a_delay_is_found_with_its_sign_and_size(channel: str, field: str, delay: float, arm: Experiment) -> None:
    given = shifted(arm, delay, field)
    found = delayed(given, channel)
    assert found is not None and found.name == f"{channel}_delay"
    told = re.search(r"([\d.]+) \+- ([\d.]+) ms late .* by -([\d.]+) s and interpolate", found.text)
    assert told is not None
    size, std, back = map(float, told.groups())
    assert abs(size - 1e3 * abs(delay)) < max(5.0 * std, 1.0) and abs(1e3 * back - size) < 1.0
    assert found.text.startswith("The positions (q) are" if delay < 0.0 else ("The joint torques", "The wrench"))
    assert max(found.after) < max(found.before)


def test_a_delay_that_leaves_most_is_told_with_what_was_tried(arm: Experiment, monkeypatch: pytest.MonkeyPatch) -> None:
    """Clocks 3 s apart were told to be 0.316 +- 0.036 s apart: that left 1.4 of 2.4 N, and nothing said how far was looked."""
    given = shifted(arm, 0.2, "wrench")
    clear = delay_profile(given, "wrench")
    assert clear is not None
    none = clear.left[:, [len(clear.delays) // 2]]
    for left, told in ((clear.left, False), (0.55 * none + 0.45 * clear.left, True)):
        monkeypatch.setattr(shifts, "delay_profile", lambda *_, left=left: replace(clear, left=left))
        found = delayed(given, "wrench")
        assert found is not None
        assert found.text.endswith("delays of at most 0.5 s are tried: clocks may be further apart") == told


def profile(*delays: float, worth: float = 100.0) -> Profile:
    """Of channels that are late by different times: a parabola each, which is twice the noise 0.1 s away."""
    tried = 0.01 * np.arange(-50, 51)
    power = np.array([1.0 + ((tried - delay) / 0.1) ** 2 for delay in delays])
    left = np.sqrt(power)
    likelihood = -np.log(left).sum(axis=0)
    parts = np.repeat(power[:, None] / power[:, [np.argmax(likelihood)]][:, None] / 8, 8, axis=1)
    return Profile(tried, left, likelihood - likelihood[50], worth, parts)


def test_the_interval_of_a_delay_counts_how_far_channels_disagree() -> None:
    one = profile(0.02, 0.02, 0.02, 0.02).best()
    assert one is not None and one[0] == pytest.approx(0.02, abs=1e-3)
    assert one[1] == pytest.approx(0.1 / np.sqrt(100 * 4), rel=0.1)  # by the curvature of four channels alone
    several = np.array([0.0, 0.01, 0.03, 0.04])
    scattered = profile(*several).best()
    assert scattered is not None and scattered[0] == pytest.approx(0.02, abs=2e-3)
    # Alike channels: the standard error of the mean of their own delays.
    assert scattered[1] == pytest.approx(several.std(ddof=1) / 2.0, rel=0.3)


def test_a_second_delay_that_is_as_likely_widens_the_interval() -> None:
    tried = profile(0.1)
    gained = np.maximum(tried.gained, profile(0.3).gained + tried.gained.max() - profile(0.3).gained.max() - 1e-4)
    two = replace(tried, gained=gained).best()
    assert two is not None and two[0] == pytest.approx(0.1, abs=1e-3)
    assert two[1] == pytest.approx(0.2 / np.sqrt(2.0), rel=0.1)  # half of the odds are 0.2 s away


def test_torques_of_which_one_alone_is_late_give_no_delay_of_all(arm: Experiment) -> None:
    """Both as late as each other are; one of two is not."""

    def one_late(table: Table) -> Table:
        moved = later(table, 0.06, "torques").torques
        assert moved is not None and table.torques is not None
        return replace(table, torques=np.column_stack([table.torques[:, 0], moved[:, 1]]))

    motions = tuple(replace(m, table=one_late(m.table), examined=False) for m in arm.motions)
    assert delayed(shifted(arm, 0.06, "torques"), "torque") is not None
    assert delayed(replace(arm, motions=motions, warnings=(), findings=()), "torque") is None


@pytest.mark.parametrize("channel", ["torque", "wrench"])
def test_readings_in_time_are_not_late_whatever_else_is_wrong(channel: str, arm: Experiment) -> None:
    """Signs, units, and gravity that is taken out are no delay."""
    field = "torques" if channel == "torque" else "wrench"
    for factor in (1.0, -1.0, 1e-3):
        motions = tuple(replace(m, table=replace(m.table, **{field: factor * getattr(m.table, field)})) for m in arm.motions)
        assert delayed(replace(arm, motions=motions), channel) is None


def test_check_says_it_and_guesses_nothing_from_the_same_readings(arm: Experiment) -> None:
    found = bayesid.check(shifted(arm, 0.07, "wrench")).mistakes
    assert [m.name for m in found] == ["wrench_delay"]


def test_poses_and_short_recordings_say_nothing(arm: Experiment) -> None:
    short = [
        replace(m, table=Table(m.table.times[:100], m.table.positions[:100], torques=m.table.torques[:100])) for m in arm.motions
    ]
    assert delay_profile(replace(arm, motions=tuple(short)), "torque") is None
    poses = tuple(replace(m, kind="poses") for m in arm.motions)
    assert delay_profile(replace(arm, motions=poses), "torque") is None


@pytest.mark.skipif(not FOLDERS, reason=f"no experiment folders under {DATA}; set BAYESID_DATA")
@pytest.mark.parametrize("path", FOLDERS, ids=lambda path: path.name)
def test_no_recording_is_late(path: Path) -> None:
    given = load_experiment(path)
    for channel in ("torque", *(("wrench",) if given.sensor is not None else ())):
        assert delayed(given, channel) is None


def undone(late: Experiment, control: Experiment) -> None:
    """What is found of torques 70 ms late brings back, undone, what the control predicts."""
    found = delayed(late, "torque")
    assert found is not None and delayed(control, "torque") is None
    size = float(found.text.split(" ms late")[0].split(" +- ")[0].rsplit(" ", 1)[1]) / 1e3
    assert size == pytest.approx(0.07, abs=0.01)
    effects = ["viscous_friction", "coulomb_friction", "torque_offset"]
    errors = [
        bayesid.identify(e, "torque", effects=effects).validation[0].relative_error
        for e in (control, late, shifted(late, -size, "torques"))
    ]
    assert errors[2] < 1.1 * errors[0] < errors[1]


def test_undoing_it_brings_back_what_the_control_predicts(arm: Experiment) -> None:
    undone(shifted(arm, 0.07, "torques"), arm)


@pytest.mark.slow
@pytest.mark.skipif(not WILD.is_dir(), reason=f"no recordings under {WILD}; set BAYESID_DATA")
def test_undoing_it_brings_back_what_the_control_of_a_real_arm_predicts() -> None:
    late, control = (load_experiment(WILD / "09-log-oddities" / name) for name in ("tau-late-70ms", "control"))
    undone(late, control)
