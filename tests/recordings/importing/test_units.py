"""Units that are stated, or stand in names: of joints that turn, slide or are not used, and what fits nothing."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import bayesid
from bayesid.errors import InputError
from tests.example_robots import Joint, Link, urdf_text

T = np.arange(1000) / 125.0
Q = np.column_stack([0.3 * np.sin(1.3 * T), 1.1 * np.sin(0.9 * T)])
TAU = np.column_stack([60.0 + np.sin(T), np.cos(T)])
REST = 0.5  # of a joint that turns and is not used [rad]


@pytest.fixture(scope="module")
def urdf(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A rail with an arm that turns, and a wrist that stands."""
    bodies = [Link(name, 2.0, (0.1, 0.0, 0.0), (0.1, 0.1, 0.1)) for name in ("cart", "arm", "hand")]
    joints = [
        Joint("rail", "base", "cart", axis=(0.0, 0.0, 1.0), kind="prismatic"),
        Joint("turn", "cart", "arm", axis=(0.0, 1.0, 0.0)),
        Joint("wrist", "arm", "hand", axis=(1.0, 0.0, 0.0)),
    ]
    path = tmp_path_factory.mktemp("robot") / "robot.urdf"
    path.write_text(urdf_text("rail", [Link("base"), *bodies], joints), encoding="utf-8")
    return path


def log(folder: Path, names=("rail/pos", "turn/pos", "wrist/pos"), factors=(1.0, 1.0, 1.0)) -> Path:
    """The recording with these names of positions, and numbers that are larger by these factors."""
    values = zip(names, (*Q.T, np.full(len(T), REST)), factors, strict=True)
    frame = pd.DataFrame({"t": T} | {name: column * by for name, column, by in values})
    frame["rail/effort"], frame["turn/effort"] = TAU.T
    frame.to_csv(folder / "log.csv", index=False)
    return folder / "log.csv"


DEGREE = 180.0 / np.pi


def test_a_unit_of_joints_that_turn_is_none_of_one_that_slides(urdf, tmp_path):
    path = log(tmp_path, factors=(1e3, DEGREE, DEGREE))
    options = dict(joints=["rail", "turn"])
    for units, said in (
        ({"q": "deg"}, r"units q1: deg is no unit of rail, which slides; state its own \(units q1=m\)"),
        ({"q": "mm"}, r"units q2: mm is no unit of turn, which turns; state its own \(units q2=rad\)"),
        ({"q": "deg", "q1": "mm", "tau": "N mm"}, r"units tau1: N mm is no unit of rail, .* \(units tau1=N\)"),
    ):
        with pytest.raises(InputError, match=said):
            bayesid.read_recording(path, urdf, units=units, **options)
    (mapping := tmp_path / "mapping.toml").write_text('units.q = "deg"')  # what is stated in a file is mended there
    with pytest.raises(InputError, match=r'mapping.toml: units q1: .* state its own \(q1 = "m" in \[units\]\)'):
        bayesid.read_recording(path, urdf, mapping=mapping, **options)
    imported = bayesid.read_recording(path, urdf, units={"q": "deg", "q1": "mm"}, **options)
    np.testing.assert_allclose(imported.experiment.motions[0].table.positions, Q, rtol=1e-14)
    assert imported.experiment.locked["wrist"] == pytest.approx(REST)


def test_what_is_written_names_the_units_of_both_kinds(urdf, tmp_path):
    imported = bayesid.read_recording(log(tmp_path), urdf, joints=["rail", "turn"], units={"q": "rad"})
    columns = {k: v["unit"] for s in imported.to_dict()["recordings"][0]["signals"] for k, v in s["columns"].items()}
    assert columns == {"q1": "m", "q2": "rad", "tau1": "N", "tau2": "N m"}
    assert "[" not in "".join(line for line in str(imported).splitlines() if " from " in line)


def test_a_factor_of_all_positions_holds_for_a_joint_that_is_not_used(urdf, tmp_path):
    path = log(tmp_path, factors=(2.0, 2.0, 2.0))
    imported = bayesid.read_recording(path, urdf, joints=["rail", "turn"], scale={"q": 0.5})
    assert imported.experiment.locked["wrist"] == pytest.approx(REST)


def test_a_stated_unit_of_angles_does_not_hold_for_a_slide_that_is_not_used(urdf, tmp_path):
    path = log(tmp_path, factors=(1.0, DEGREE, DEGREE))
    imported = bayesid.read_recording(path, urdf, joints=["turn"], units={"q": "deg"})
    assert imported.experiment.locked["rail"] == pytest.approx(np.median(Q[:, 0]))


@pytest.mark.parametrize("unit", ["counts", "V", "deg/s", "Nm"])
def test_a_name_that_states_a_unit_of_something_else_is_not_taken_as_it_stands(unit, urdf, tmp_path):
    path = log(tmp_path, names=("rail/pos", f"turn/pos [{unit}]", "wrist/pos"), factors=(1.0, 2.0, 1.0))
    with pytest.raises(InputError, match=r'column "turn/pos \[.*\]": .* is no unit of positions; .* \(units q2=rad'):
        bayesid.read_recording(path, urdf, joints=["rail", "turn"])
    imported = bayesid.read_recording(path, urdf, joints=["rail", "turn"], scale={"q2": 0.5})
    np.testing.assert_allclose(imported.experiment.motions[0].table.positions, Q, rtol=1e-14)


def test_velocities_of_a_slide_in_millimetres_are_told_as_such(urdf, tmp_path):
    """It was said of them that times were in milliseconds."""
    path = log(tmp_path)
    frame = pd.read_csv(path)
    frame["rail/vel"], frame["turn/vel"] = 390.0 * np.cos(1.3 * T), 0.99 * np.cos(0.9 * T)
    frame.to_csv(path, index=False)
    said = r'column "rail/vel": 1e\+03 times .* millimetres per second, or column "t" like .* \(or say so: units v=mm/s\)'
    with pytest.raises(InputError, match=said):
        bayesid.read_recording(path, urdf, joints=["rail", "turn"])
    units = {"v": "mm/s", "v2": "rad/s"}
    assert bayesid.read_recording(path, urdf, joints=["rail", "turn"], units=units).experiment.warnings == ()


@pytest.mark.parametrize("unit", ["N-m", "Nm", "N*m", "N·m", "N.m"])
def test_the_unit_of_a_moment_is_known_as_sensors_makers_spell_it(unit, urdf, tmp_path):
    frame = pd.read_csv(log(tmp_path))
    frame[[f"Force {axis} (N)" for axis in "XYZ"]] = np.cos(np.outer(T, [1.0, 2.0, 3.0]))
    frame[[f"Torque {axis} ({unit})" for axis in "XYZ"]] = np.sin(np.outer(T, [1.0, 2.0, 3.0]))
    frame.to_csv(tmp_path / "log.csv", index=False)
    imported = bayesid.read_recording(tmp_path / "log.csv", urdf, joints=["rail", "turn"], sensor="base")
    np.testing.assert_allclose(imported.experiment.motions[0].table.wrench[:, 5], np.sin(3.0 * T), atol=1e-15)
