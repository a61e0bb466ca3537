"""Make every mistake of what-goes-wrong.md on a simulated recording, and write the page from what bayesid then prints.

Run from anywhere. The robot is a UR5 on a force/torque sensor, recorded by Pinocchio (tests/newcomers), 10 % off its URDF.
"""

from __future__ import annotations

import contextlib
import io
import re
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

import bayesid
from bayesid import Experiment, Table
from bayesid.cli import main

sys.path.append(str(Path(__file__).resolve().parents[2]))
from tests.newcomers import files

PAGE = Path(__file__).resolve().parent / "what-goes-wrong.md"
_FRICTION = "--channel torque --effects viscous_friction,coulomb_friction"
_ZEROS = np.array([0, 1, 0, 1, 0, 0])
_HEAD = """# What goes wrong, and what it looks like

Every mistake on this page was made on purpose by `docs/howto/what_goes_wrong.py`, on a simulated UR5 with a sensor under its
base (without it where the mistake is in the torques). What is indented is what bayesid then printed. Run `bayesid check`
first: it needs a second. Then `bayesid identify`, and `bayesid diagnose` where a prediction is off.

How often such mistakes are named on real robots: [mistakes made on purpose](../studies/mistakes/README.md), and
[public logs](../studies/wild/README.md) with mistakes that nobody made on purpose.
"""


@dataclass(frozen=True)
class Row:
    """A mistake.

    Attributes
    ----------
    symptom, cause, remedy
        In the page's words.
    change
        What it does to the recording.
    command
        The verb that shows it, and its options.
    line
        Pattern of the first line to show.
    """

    symptom: str
    cause: str
    remedy: str
    change: Callable[[Experiment], Experiment]
    command: str = "check"
    line: str = "warning"


def tables(experiment: Experiment, change: Callable[[Table], Table]) -> Experiment:
    """The experiment with every table changed."""
    return replace(experiment, motions=tuple(replace(m, table=change(m.table)) for m in experiment.motions))


def wrench(matrix: object) -> Callable[[Experiment], Experiment]:
    """The wrench of every sample multiplied by a matrix, or by factors."""
    m = np.array(matrix, dtype=float)
    return lambda e: tables(e, lambda t: replace(t, wrench=np.asarray(t.wrench) @ (m if m.ndim == 2 else np.diag(m)).T))


def torques(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Experiment], Experiment]:
    """Torques changed, no sensor under the base."""
    return lambda e: tables(replace(e, sensor=None), lambda t: replace(t, wrench=None, torques=change(np.asarray(t.torques))))


def late(e: Experiment) -> Experiment:
    """The wrench four samples late."""
    return tables(
        e, lambda t: Table(t.times[4:], t.positions[4:], wrench=np.asarray(t.wrench)[:-4], torques=np.asarray(t.torques)[4:])
    )


def rotors(e: Experiment) -> Experiment:
    """Torques of drives with rotors."""

    def added(t: Table) -> Table:
        acceleration = np.gradient(np.gradient(t.positions, t.times, axis=0), t.times, axis=0)
        return replace(t, torques=np.asarray(t.torques) + acceleration * [2.0, 2.5, 1.5, 0.4, 0.3, 0.2], wrench=None)

    return tables(replace(e, sensor=None), added)


def simulated(e: Experiment, effects: dict[str, Any], **known: Any) -> Experiment:
    """The URDF's robot with an effect, two motions."""
    roles = enumerate(("identification", "validation"))
    motions = [bayesid.fourier_trajectory(e.robot, role, role, duration=12.0, seed=k) for k, role in roles]
    recorder = bayesid.Recorder(force_std=0.5, torque_std=0.05, resolution=1e-5)
    return replace(bayesid.simulate(replace(e, motions=()), motions, effects=effects, recorder=recorder, seed=1), **known)


def calm(e: Experiment) -> Experiment:
    """Motions of a tenth of the size."""

    def smaller(t: Table) -> Table:
        return replace(t, positions=t.positions[0] + 0.1 * (t.positions - t.positions[0]), torques=None)

    motions = [replace(m, table=smaller(m.table)) for m in e.motions]
    planned = [bayesid.Trajectory(m.name, m.role, m.table.times, m.table.positions, *derivatives(m.table)) for m in motions]
    recorder = bayesid.Recorder(force_std=0.5, torque_std=0.05, resolution=1e-5)
    return bayesid.simulate(replace(e, motions=()), planned, recorder=recorder, seed=1)


def derivatives(t: Table) -> tuple[np.ndarray, np.ndarray]:
    """Velocities and accelerations (N, n)."""
    v = np.gradient(t.positions, t.times, axis=0)
    return v, np.gradient(v, t.times, axis=0)


ROWS = {
    "The recording is refused": [
        Row(
            "Positions of some hundred radians",
            "They are in degrees",
            "`bayesid import --units q=deg`, or radians in the table",
            lambda e: tables(e, lambda t: replace(t, positions=np.rad2deg(t.positions))),
            line="bayesid: ",
        ),
        Row(
            "Times run to thousands of seconds",
            "Times are in milliseconds",
            "`bayesid import --units t=ms`, or seconds in the table",
            lambda e: tables(e, lambda t: replace(t, times=1e3 * t.times)),
            line="bayesid: ",
        ),
        Row(
            "No torque is negative", "The log holds magnitudes", "Log torques with their sign", torques(np.abs), line="bayesid: "
        ),
    ],
    "Signs, orders, units and frames": [
        Row(
            "Masses come out negative",
            "The wrench is that of the robot on the sensor",
            "Change the sign of all six columns",
            wrench(-np.eye(6)),
        ),
        Row("Moments are thousands", "They are in N mm", '`bayesid import --units m="N mm"`', wrench([1, 1, 1, 1e3, 1e3, 1e3])),
        Row(
            "The weight stands in the wrong axis",
            "The sensor sits turned by 90 degrees",
            "Its `rpy` in `[sensor]`",
            wrench(np.kron(np.eye(2), [[0, 1, 0], [-1, 0, 0], [0, 0, 1]])),
        ),
        Row(
            "The arm seems to be pulled upwards",
            "Gravity is stated for a robot on the ceiling",
            "`gravity` in `[robot]`",
            lambda e: replace(e, robot=replace(e.robot, gravity=-e.robot.gravity)),
        ),
        Row(
            "Forces lean to one side",
            "`gravity` is that of a base tilted by 10 degrees, and it stands upright",
            "`gravity` in `[robot]`, in the base's axes",
            lambda e: replace(e, robot=replace(e.robot, gravity=np.array([0.0, 1.70, -9.66]))),
        ),
        Row(
            "One joint does not fit",
            "One torque has the other sign",
            "Change the sign of that column",
            torques(lambda tau: tau * [1, 1, -1, 1, 1, 1]),
        ),
        Row(
            "Hardly any joint fits",
            "Joints 2 and 4 count from the zeros of Denavit and Hartenberg's angles",
            "Add the angle to the columns, or turn the joints' origins in the URDF",
            lambda e: torques(lambda tau: tau)(tables(e, lambda t: replace(t, positions=t.positions + np.pi / 2 * _ZEROS))),
        ),
        Row(
            "Several joints do not fit",
            "Torques stand in alphabetical order of the joints",
            "Order the columns; `bayesid import` joins bags by name",
            torques(lambda tau: tau[:, np.argsort(files.JOINTS)]),
        ),
        Row(
            "Torques are a hundredth of what the arm weighs",
            "They are those of the motors, before the gears",
            "Multiply by the gear ratio",
            torques(lambda tau: 0.01 * tau),
        ),
        Row(
            "Torques have no known unit",
            "They are motor currents",
            "`--units tau=A` with `--scale`, N m per A at each joint",
            torques(lambda tau: tau / [13.6, 13.6, 8.7, 8.7, 20.6, 20.6]),
        ),
    ],
    "The model lacks something": [
        Row(
            "Torques are predicted badly",
            "No friction in the model",
            "`--effects viscous_friction,coulomb_friction`",
            torques(lambda tau: tau),
            "identify",
            "no usable model",
        ),
        Row(
            "Links are heavier than they can be",
            "The drives' rotors are left out",
            "`rotor_inertia` in the model",
            rotors,
            f"identify {_FRICTION}",
            "rotor",
        ),
        Row(
            "Curves look fine, the residual is many times the noise",
            "The wrench is stamped 32 ms late",
            "Shift its times (`--shift wrench=-0.032`), or keep `sensor_delay` in the model",
            late,
            "diagnose",
            "misses",
        ),
        Row(
            "The last link is not what the URDF says",
            "Half a kilogram at the flange; `inertia_rel_std = 0.01` says that the URDF is good",
            "`model.toml` has it; [`bayesid payload`](payload.md) weighs it",
            lambda e: simulated(
                e,
                {"payload@joint6": {"m": 0.5, "mcx": 0.0, "mcy": 0.05, "mcz": 0.02, "Ixx": 0.006, "Iyy": 0.001, "Izz": 0.006}},
                inertia_rel_std=0.01,
            ),
            "diagnose",
            "misses",
        ),
        Row(
            "Something that is not rigid",
            "A cable pulls at the elbow",
            "Fix the cable, or keep `tether` in the model",
            lambda e: simulated(e, {"tether@joint3": None}, inertia_rel_std=0.01),
            "diagnose",
            "misses",
        ),
    ],
    "The data do not show it": [
        Row(
            "Wide intervals",
            "The motion is small and slow",
            "[An exciting trajectory](excite.md); [before recording](identifiability.md)",
            calm,
            "identify",
            "Not excited",
        ),
    ],
}


def printed(row: Row, experiment: Experiment, folder: Path) -> str:
    """The line of the command's output that the page shows.

    Raises
    ------
    RuntimeError
        There is no such line.
    """
    shown = io.StringIO()
    bayesid.write_experiment(row.change(experiment), folder / "my-arm")
    verb, *options = row.command.split()
    with contextlib.chdir(folder), contextlib.redirect_stdout(shown), contextlib.redirect_stderr(shown):
        main([verb, "my-arm", *options, "--out", "out"])
    for line in shown.getvalue().splitlines():
        if re.search(row.line, line):
            return line.strip()
    raise RuntimeError(f"{row.cause}: bayesid {row.command} prints no line with {row.line!r}, but\n{shown.getvalue()}")


def recorded(folder: Path) -> Experiment:
    """The recording without a mistake."""
    urdf, real = files.robot(folder)
    logs = [(role, files.record(real, seed)) for seed, role in ((1, "identification"), (2, "validation"))]
    motions = [bayesid.Motion(role, role, Table(log.t, log.q, wrench=log.wrench, torques=log.tau)) for role, log in logs]
    return Experiment("my-arm", bayesid.load_robot(urdf), tuple(motions), sensor=bayesid.Sensor())


def section(title: str, experiment: Experiment, folder: Path) -> str:
    """A section of the page, every mistake of it made."""
    parts = [f"## {title}\n"]
    for k, row in enumerate(ROWS[title]):
        place = folder / f"{title} {k}"
        place.mkdir()
        said = printed(row, experiment, place)
        parts.append(f"**{row.symptom}.** {row.cause}. `bayesid {row.command.split()[0]}`:\n\n> {said}\n")
        parts.append(f"Remedy: {row.remedy}.\n")
    return "\n".join(parts)


def page() -> str:
    """The page, every mistake made."""
    with tempfile.TemporaryDirectory() as name:
        experiment = recorded(Path(name))
        return "\n".join([_HEAD, *(section(title, experiment, Path(name)) for title in ROWS)])


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
