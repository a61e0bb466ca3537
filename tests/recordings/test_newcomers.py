"""Thirty mistakes that newcomers make: each is told in one line that names file, place, value and remedy."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import bayesid
from bayesid.dynamics.regressors import Kernel
from bayesid.recordings.experiment import load_setup
from bayesid.regression.readings import make_channels
from bayesid.report.check import check_report
from bayesid.signals.smoothing import smooth
from tests.malformed import lines, recording, table, toml, urdf, write_good
from tests.report_pages import read

WRENCH = ("fx", "fy", "fz", "mx", "my", "mz")
Damage = Callable[[Path], None]


def both(change: Callable[[pd.DataFrame], pd.DataFrame]) -> Damage:
    """Change the tables of both motions."""

    def damage(folder: Path) -> None:
        for name in ("identification.csv", "validation.csv"):
            table(change, name)(folder)

    return damage


def all_tables(change: Callable[[pd.DataFrame], pd.DataFrame]) -> Damage:
    """Change every table, the static one too."""

    def damage(folder: Path) -> None:
        both(change)(folder)
        table(change, "static.csv")(folder)

    return damage


def scaled(factor: float, *columns: str) -> Callable[[pd.DataFrame], pd.DataFrame]:
    return lambda frame: frame.assign(**{c: factor * frame[c] for c in columns})


def negated(frame: pd.DataFrame) -> pd.DataFrame:
    """The second encoder counts the other way."""
    return frame.assign(**{c: -frame[c] for c in ("q2", "v2") if c in frame})


def swapped(frame: pd.DataFrame) -> pd.DataFrame:
    """Forces where moments should be."""
    return frame.rename(columns=dict(zip(WRENCH, (*WRENCH[3:], *WRENCH[:3]), strict=True)))


def exchanged(one: str, other: str) -> Callable[[pd.DataFrame], pd.DataFrame]:
    return lambda frame: frame.rename(columns={one: other, other: one})


def write_physical(folder: Path) -> Path:
    """The good folder with the wrench that its robot would have, 20 seconds of it, and a little noise."""
    write_good(folder)
    rng = np.random.default_rng(3)
    experiment = load_setup(folder)
    channels = make_channels(experiment, "wrench")
    for name, seed in (("identification.csv", 0), ("static.csv", 0), ("validation.csv", 1)):
        frame = recording(seed, 20.0)
        motion = smooth(frame["t"].to_numpy(), frame[["q1", "q2"]].to_numpy(), 8.0)
        if name == "static.csv":
            frame = frame.drop(columns=["v1", "v2"])
            motion = motion[0], 0.0 * motion[1], 0.0 * motion[2]
        wrench = Kernel.of(experiment.robot, channels).dynamics(*motion) @ experiment.robot.nominal.ravel()
        frame[list(WRENCH)] = wrench + channels.static_wrench + np.repeat([0.3, 0.03], 3) * rng.normal(size=wrench.shape)
        frame.to_csv(folder / name, index=False)
    return folder


@pytest.fixture(scope="module")
def physical(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """That folder, made once."""
    return write_physical(tmp_path_factory.mktemp("physical") / "arm")


def no_inertias(folder: Path) -> None:
    path = folder / "robot.urdf"
    path.write_text(re.sub(r"<inertial>.*?</inertial>", "", path.read_text(), flags=re.DOTALL))


def with_mark(folder: Path) -> None:
    """A byte order mark does no harm; the mistake is in the key after it."""
    path = folder / "experiment.toml"
    path.write_text("\ufeff" + path.read_text().replace("[robot]", "[Robot]", 1), encoding="utf-8")


#: What was done, how, and what the line must hold: where, what, and what to do.
CASES: list[tuple[str, Damage, tuple[str, ...]]] = [
    # Units.
    ("positions in degrees", both(scaled(180 / np.pi, "q1", "q2")), ("identification.csv", "q1", "degrees", "write radians")),
    ("velocities in degrees", both(scaled(180 / np.pi, "v1", "v2")), ("identification.csv", "v1", "57.3", "write rad/s")),
    ("time in milliseconds", both(scaled(1e3, "t")), ("identification.csv", "t", "milliseconds", "write seconds")),
    ("moments in N mm", all_tables(scaled(1e3, "mx", "my", "mz")), ("moments", "N mm", "write mx, my and mz in N m")),
    ("translation in millimetres", toml("[0.0, 0.0, -0.1]", "[0.0, 0.0, -100.0]"), ("[sensor] translation", "100", "metres")),
    ("locked angle in degrees", toml("wrist = 0.1", "wrist = 90"), ("[robot] locked", "wrist = 90", "degrees")),
    ("gravity as a number", toml("gravity = [0.0, 0.0, -9.81]", "gravity = 9.81"), ("experiment.toml: [robot] gravity", "9.81")),
    ("gravity in g", toml("-9.81", "-1.0"), ("[robot] gravity", "1", "m/s^2")),
    ("gear ratio of an unknown joint", toml("elbow = 100.0", "elbw = 100.0"), ("gear_ratio", "elbw", "elbow")),
    # Signs.
    ("the robot's wrench on the sensor", all_tables(scaled(-1.0, *WRENCH)), ("wrench", "robot on the sensor", "change the sign")),
    ("velocities with the other sign", both(scaled(-1.0, "v1", "v2")), ("column v1", "sign is reversed", "turn it")),
    ("one encoder with the other sign", all_tables(negated), ("elbow (q2)", "opposite sign", "change the sign")),
    ("gravity upwards", toml("-9.81]", "9.81]"), ("gravity", "-z", "write [robot] gravity = [0, 0, -9.81]")),
    # Order.
    ("forces and moments exchanged", all_tables(swapped),
     ("orces and moments seem to be exchanged", "write forces in fx")),
    ("axes x and y exchanged", all_tables(lambda d: exchanged("mx", "my")(exchanged("fx", "fy")(d))),
     ("axes", "y, x, z", "reorder")),
    ("joints in the wrong order", toml('["shoulder", "elbow"]', '["elbow", "shoulder"]'), ("exchanged", "[robot] joints")),
    ("rows in reverse", table(lambda d: d.iloc[::-1]), ("identification.csv", "column t", "goes back", "increase")),
    # Names.
    ("joint misspelt", toml('"elbow"', '"elbov"'), ("experiment.toml", "[robot] joints", "elbov", "elbow")),
    ("column misspelt", table(lambda d: d.rename(columns={"q2": "Q2"})), ("identification.csv", "q2 is missing", "Q2")),
    ("key misspelt", toml("position_resolution", "position_resolutoin"), ("position_resolutoin", "did you mean")),
    ("table misspelt", toml('"validation.csv"', '"valdation.csv"'), ("valdation.csv", "no such file", "experiment.toml")),
    ("section in capitals, after a byte order mark", with_mark, ("experiment.toml", "Robot", "robot")),
    ("role misspelt", toml('role = "validation"', 'role = "test"'), ("experiment.toml", "role", "test", "validation")),
    ("effect misspelt", toml("sensor_offset", "ofset"), ("experiment.toml", "ofset", "sensor_offset")),
    # Gaps and cells.
    ("an empty cell", lines(lambda t: [*t[:9], re.sub(r",[^,]*$", ",", t[9]), *t[10:]]), ("line 10", "without a reading")),
    ("decimal commas", lines(lambda t: [t[0], *(x.replace(".", ",") for x in t[1:])]), ("identification.csv", "line 2", "point")),
    ("semicolons", lines(lambda t: [x.replace(",", ";") for x in t]), ("identification.csv", "semicolons", "commas")),
    ("a second missing", both(lambda d: d.drop(index=range(100, 200))), ("identification.csv", "gap at", "pieces between gaps")),
    # Missing inertias.
    ("no inertias", no_inertias, ("robot.urdf", "no link but the root has a mass")),
    ("an inertia that no body can have", urdf('ixx="0.05"', 'ixx="5.0"'), ("robot.urdf", "no body can have", "link upper")),
]  # fmt: skip


@pytest.mark.parametrize(("damage", "says"), [case[1:] for case in CASES], ids=[case[0] for case in CASES])
def test_each_is_one_line_that_names_the_remedy(damage: Damage, says: tuple[str, ...], physical: Path, tmp_path: Path) -> None:
    folder = shutil.copytree(physical, tmp_path / "arm")
    damage(folder)
    try:
        said = bayesid.check(bayesid.load_experiment(folder)).warnings
    except bayesid.InputError as error:
        said = (str(error),)
    wanted = [line for line in said if all(text in line for text in says)]
    assert wanted, said
    assert "\n" not in wanted[0]
    assert len(wanted[0]) < 500


def test_without_a_mistake_nothing_is_said(physical: Path) -> None:
    found = bayesid.check(bayesid.load_experiment(physical))
    assert found.mistakes == () and found.experiment.warnings == ()
    # The static run takes gravity and the offset with it, and there is none for the validation motion: that is all.
    (left,) = found.warnings
    assert "'validation' has no static run" in left and "left out of the validation" in left


def test_nothing_looks_doubtful_only_where_a_fit_leaves_the_noise(physical: Path) -> None:
    found = bayesid.check(bayesid.load_experiment(physical))
    (fitted,) = (p for p in found.left if p.fitted)

    def shown(whitened: float) -> str:
        alone = replace(found, left=(replace(fitted, whitened_rms=whitened, expected_rms=1.0),), warnings=())
        return read(check_report(alone)).text

    assert "looks doubtful" in shown(1.0)
    assert "looks doubtful" not in shown(30.0) and "30 times the noise" in shown(30.0)


def test_there_are_thirty() -> None:
    assert len(CASES) == 30
