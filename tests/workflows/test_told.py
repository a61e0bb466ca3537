"""What is wrong with recordings, or with the robot's file, is told by every verb, not by `check` alone."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import bayesid
from bayesid.cli import main
from bayesid.workflows.demo import puma_two_joint_urdf
from bayesid.workflows.warnings import incomplete
from tests.simulated import Motion, Sensor, experiment, fourier, puma2, recording


@pytest.fixture(scope="module")
def in_kilograms(shared):
    """A wrist's poses with forces in kgf, of which a rigid body of a tenth of the mass explains all but the moments' size."""
    whole = bayesid.load_experiment(shared("data/kuka-med-wrist"))
    motions = []
    for motion in whole.motions:
        wrench = motion.table.wrench.copy()
        wrench[:, :3] /= 9.81
        motions.append(replace(motion, table=replace(motion.table, wrench=wrench), examined=False))
    return replace(whole, motions=tuple(motions))


@pytest.mark.parametrize("verb", ["payload", "calibrate", "diagnose"])
def test_another_unit_of_the_forces_is_told_before_what_is_found(verb, in_kilograms):
    found = getattr(bayesid, verb)(in_kilograms)
    first = (found.remarks if verb == "diagnose" else found.warnings)[0]
    assert "The forces seem to be in kgf" in first and first in str(found)


def test_doubts_about_the_robot_are_told_where_motions_are_made_of_it(tmp_path, capsys):
    """Nothing else says that what is simulated, or planned, is another robot than was meant."""
    text = puma_two_joint_urdf()
    (tmp_path / "robot.urdf").write_text(text.replace('<mass value="13.0" />', '<mass value="0.0" />'), encoding="utf-8")
    assert (tmp_path / "robot.urdf").read_text(encoding="utf-8") != text
    (tmp_path / "experiment.toml").write_text(
        'format = 1\nname = "arm"\n[robot]\nurdf = "robot.urdf"\njoints = ["joint1", "joint2"]\n'
        '[[motion]]\nname = "a"\nrole = "identification"\ntable = "a.csv"\n',
        encoding="utf-8",
    )
    new = ["--new", "--duration", "3", "--out", str(tmp_path / "out")]
    assert main(["simulate", str(tmp_path), *new]) == 0
    assert "mass 0 but an inertia: link link1" in capsys.readouterr().out
    planned = bayesid.excite(tmp_path, duration=2.0, period=2.0, starts=1, randoms=2, seconds=0.1)
    assert any("mass 0 but an inertia: link link1" in note for note in planned.notes)


@pytest.mark.parametrize(("dispersion", "words"), [(1.02, "hardly wider than noise"), (4.0, "2 times as wide as noise")])
def test_intervals_that_are_hardly_wider_are_not_1_time_as_wide(dispersion: float, words: str) -> None:
    assert f"({words} alone makes them, most in tau2 and tau3)" in incomplete(dispersion, {"tau1": 1.0, "tau2": 1.3, "tau3": 1.2})


def test_what_a_model_lacks_is_told_of_the_fitted_motion_where_no_other_tells(tmp_path: Path) -> None:
    """An offset that creeps to another value: check and identify printed 4 times the noise, and said nothing of it."""
    robot, sensor = puma2(tmp_path), Sensor(translation=np.array([0.0, 0.0, -0.1]))
    table = recording(robot, sensor, fourier(robot, 1), seed=1, force_std=0.2, torque_std=0.02)
    assert table.wrench is not None
    creep = np.outer(1.0 - np.exp(-table.times / 8.0), [2.0, -1.5, 3.0, 0.1, -0.1, 0.05])
    whole, crept = (
        experiment(robot, [Motion("run", "identification", replace(table, wrench=w))], sensor)
        for w in (table.wrench, table.wrench + creep)
    )
    for verb in (bayesid.check, bayesid.identify):
        assert not any("missing in the model" in w for w in verb(whole).warnings)
        assert any("missing in the model" in w for w in verb(crept).warnings)
