"""Mistakes made on purpose on every recording at hand: which of them `check` names.

Run from the root of the repository, with the recordings where ``BAYESID_DATA`` says (default ``../shared``)::

    python -m tests.studies.mistakes [--only NAME] [--docs FOLDER]

Every mistake is made on a copy of the recording in memory, which then goes through the checks of reading and through
`find_mistakes`, as in ``bayesid check``. Named: the mistake is what is said, or among what is said to be as likely.
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from bayesid.dynamics.channels import torque_channels
from bayesid.dynamics.regressors import Kernel
from bayesid.errors import InputError
from bayesid.recordings import examination, motion_checks
from bayesid.recordings.experiment import Experiment, load_experiment
from bayesid.recordings.table import Table
from bayesid.validation.mistakes.candidates import base_axes
from bayesid.validation.mistakes.search import find_mistakes
from tests.studies.page import STUDIES, table, write_numbers, write_page

DATA = Path(os.environ.get("BAYESID_DATA", "../shared"))
#: Simulated recordings beside the real ones: torques of six and seven joints, and base wrenches of two and six.
PRACTICE = ("practice-02", "practice-03", "practice-05", "practice-08", "practice-12")
_GEAR = 100.0
#: Torque over current of the drives of one arm [N m/A].
_MOTORS = (13.6, 13.6, 8.7, 8.7, 20.6, 20.6, 20.6)
#: A joint reversed in position and torque: where no link beyond shows it, a mirrored robot that could exist as well.
MIRRORED = "one joint's axis reversed"


@dataclass(frozen=True)
class Made:
    """A mistake made on purpose.

    Attributes
    ----------
    kind
        What kind, in the words of the page.
    experiment
        The recordings with the mistake.
    named
        Name and place that `check` should say; several where the same data come from each.
    refused
        Or a word that the refusal of the recording should hold.
    """

    kind: str
    experiment: Experiment
    named: tuple[tuple[str, str], ...] = ()
    refused: str = ""


def folders() -> dict[str, Path]:
    """Experiment folders by name: every real robot, then some simulated ones."""
    real = sorted((DATA / "data").rglob("experiment.toml"))
    found = {"/".join(path.parent.relative_to(DATA / "data").parts): path.parent for path in real}
    return found | {name: DATA / "practice" / name for name in PRACTICE}


def changed(experiment: Experiment, change: Callable[[Table], Table]) -> Experiment:
    """The experiment with every table changed."""
    motions = tuple(
        replace(m, table=change(m.table), static=None if m.static is None else change(m.static)) for m in experiment.motions
    )
    return replace(experiment, motions=motions)


def magnitudes(t: Table) -> Table:
    """The table with torques that have lost their signs."""
    return t if t.torques is None else replace(t, torques=np.abs(t.torques))


def times(matrix: np.ndarray, *fields: str) -> Callable[[Table], Table]:
    """Multiply the rows of some arrays of a table by a matrix."""
    return lambda t: replace(t, **{f: getattr(t, f) @ matrix.T for f in fields if getattr(t, f) is not None})


def turned(angles: np.ndarray) -> Callable[[Table], Table]:
    """Positions that count from other zeros (n,) [rad]."""
    fields = ("positions", "commanded")
    return lambda t: replace(t, **{f: getattr(t, f) + angles for f in fields if getattr(t, f) is not None})


def made(experiment: Experiment) -> Iterator[Made]:
    """Every mistake that these recordings allow, each on its own."""
    first = experiment.identification[0].table
    n = experiment.robot.n
    motion = ("positions", "velocities", "commanded")
    wrench = experiment.sensor is not None and first.wrench is not None
    one = np.eye(n)

    def flip(j: int) -> np.ndarray:
        return np.diag(np.where(np.arange(n) == j, -1.0, 1.0))

    def swap(j: int, k: int) -> np.ndarray:
        out = np.eye(n)
        out[[j, k]] = out[[k, j]]
        return out

    yield from _of_gravity(experiment)
    yield from _of_zeros(experiment)
    if first.torques is not None:
        yield from _of_columns(experiment)
        yield Made("all torques negated", changed(experiment, times(-one, "torques")), (("torque_signs", ""),))
        yield Made("torques in N mm", changed(experiment, times(1e3 * one, "torques")), (("torque_units", ""),))
        yield Made("torques of the motors", changed(experiment, times(one / _GEAR, "torques")), (("torque_units", ""),))
        yield Made("magnitudes of torques", changed(experiment, magnitudes), refused="never negative")
        for j in range(n):
            column = f"tau{j + 1}"
            yield Made("one torque negated", changed(experiment, times(flip(j), "torques")), (("torque_sign", column),))
    for j in range(n):
        yield Made("one position negated", changed(experiment, times(flip(j), *motion)), (("position_sign", f"q{j + 1}"),))
        if first.torques is not None:
            both = times(flip(j), *motion, "torques")
            yield Made(MIRRORED, changed(experiment, both), (("joint_sign", f"q{j + 1}"),))
    for j in range(n - 1):
        q = f"q{j + 1},q{j + 2}"
        if first.torques is None:
            yield Made("two joints exchanged", changed(experiment, times(swap(j, j + 1), *motion)), (("position_order", q),))
        else:
            both = times(swap(j, j + 1), *motion, "torques")
            yield Made("two joints exchanged", changed(experiment, both), (("joint_order", q),))
            tau = f"tau{j + 1},tau{j + 2}"
            yield Made("two torques exchanged", changed(experiment, times(swap(j, j + 1), "torques")), (("torque_order", tau),))
    degrees = 180.0 / np.pi * one
    if not experiment.robot.prismatic.any():
        yield Made(
            "degrees for radians", changed(experiment, times(degrees, *motion)), (("position_unit", ""),), refused="degrees"
        )
        yield Made("positions of the motors", changed(experiment, times(_GEAR * one, *motion)), refused="gear")
        if first.velocities is not None:
            yield Made(
                "degrees, velocities in rad/s", changed(experiment, times(degrees, "positions")), (("position_unit", ""),),
                refused="degrees",
            )  # fmt: skip
            yield Made("velocities in degrees", changed(experiment, times(degrees, "velocities")), refused="degrees")
            yield Made("velocities negated", changed(experiment, times(-one, "velocities")), refused="sign")
    true = experiment.robot.gravity / np.linalg.norm(experiment.robot.gravity)
    axis = int(np.argmax(np.abs(true)))
    where = ("+" if true[axis] > 0 else "-") + "xyz"[axis]
    for name, vector in (("on a wall (x)", (9.81, 0, 0)), ("on a wall (y)", (0, 9.81, 0)), ("on the ceiling", -9.81 * true)):
        robot = replace(experiment.robot, gravity=np.array(vector, dtype=float))
        yield Made(f"stated to hang {name}", replace(experiment, robot=robot), (("gravity_direction", where),))
    if wrench and experiment.sensor is not None:
        yield from _of_wrench(experiment)


def _of_columns(experiment: Experiment) -> Iterator[Made]:
    """Torques without their weight, in amperes, of several signs, and columns in other orders."""
    robot, n = experiment.robot, experiment.robot.n
    motion = ("positions", "velocities", "commanded")

    def weight(t: Table) -> np.ndarray:
        still = np.zeros_like(t.positions)
        return Kernel.of(robot, torque_channels(robot)).readings(t.positions, still, still, robot.nominal.ravel())

    def lighter(*joints: int) -> Experiment:
        """With the nominal weight taken out of some torques."""
        chosen = np.isin(np.arange(n), joints)
        return changed(experiment, lambda t: t if t.torques is None else replace(t, torques=t.torques - weight(t) * chosen))

    removed = (("gravity_removed", ""), ("gravity_removed", "nominal"))
    if robot.nominal[:, 0].any() and n > 1:
        yield Made("gravity taken out of all torques", lighter(*range(n)), removed)
        loads = np.abs(weight(experiment.identification[0].table)).max(axis=0)
        for j in np.flatnonzero(loads > 0.05 * loads.max()):
            own = tuple(("gravity_removed", f"tau{j + 1}{which}") for which in ("", " nominal"))
            yield Made("gravity taken out of one torque", lighter(int(j)), own)
    amperes = np.diag(1.0 / np.resize(_MOTORS, n))
    currents = (("torque_units", ""), ("torque_scales", ""))
    yield Made("motor currents for torques", changed(experiment, times(amperes, "torques")), currents)
    if n > 2:
        odd = np.diag(np.where(np.arange(n) % 2 == 1, -1.0, 1.0))
        columns = [f"tau{j + 1}" for j in range(1, n, 2)]
        # Of the wrong ones, those that show.
        shown = [c for k in range(1, len(columns) + 1) for c in itertools.combinations(columns, k)]
        named = tuple(("torque_sign" if len(c) == 1 else "torque_signs", ",".join(c)) for c in shown)
        yield Made("every second torque negated", changed(experiment, times(odd, "torques")), named)
    orders = {"cyclic": np.roll(np.arange(n), 1), "alphabetical": np.argsort(robot.joint_names, kind="stable")}
    for name, held in orders.items():
        # Column k holds joint held[k].
        if n < 3 or (held == np.arange(n)).all():
            continue
        mixed, back = np.eye(n)[held], np.argsort(held)
        moved = [int(k) for j, k in enumerate(back) if j != k]
        moved = sorted(moved) if len(moved) == 2 else moved
        for what, arrays, letter in (
            ("torque", ("torques",), "tau"),
            ("position", motion, "q"),
            ("joint", (*motion, "torques"), "q"),
        ):
            where = ",".join(f"{letter}{k + 1}" for k in moved)
            kind = f"{name} order of {'both' if what == 'joint' else what + 's'}"
            yield Made(kind, changed(experiment, times(mixed, *arrays)), ((f"{what}_order", where),))


def _of_gravity(experiment: Experiment) -> Iterator[Made]:
    """A base at another angle than stated."""
    named = (("base_tilt", ""), ("gravity_direction", "-z"))
    size = float(np.linalg.norm(experiment.robot.gravity))
    vectors = {"stated to hang on a wall (at an angle)": size * np.array([0.6, -0.8, 0.0])}
    for angle in (10.0, 30.0):
        turn = Rotation.from_rotvec(np.radians(angle) * np.array([0.6, 0.8, 0.0])).as_matrix()
        vectors[f"stated to be tilted by {angle:.0f} degrees"] = turn @ experiment.robot.gravity
    for kind, vector in vectors.items():
        yield Made(kind, replace(experiment, robot=replace(experiment.robot, gravity=vector)), named)


def _of_zeros(experiment: Experiment) -> Iterator[Made]:
    """Zeros a quarter turn off, to the side on which the joint's limits are further away: of joint 2, and of joint 4 as well.

    Where joints follow: turned about the last joint's axis, its body is another one.
    """
    positions = np.concatenate([m.table.positions for m in experiment.motions])
    side = -np.sign(positions.max(axis=0) + positions.min(axis=0) + 1e-9)
    for which in ((1,), (1, 3)):
        if which[-1] < experiment.robot.n - 1 and not experiment.robot.prismatic[list(which)].any():
            angles = np.where(np.isin(np.arange(experiment.robot.n), which), 0.5 * np.pi * side, 0.0)
            kind = "zero of one joint a quarter turn off" if len(which) == 1 else "zeros of two joints a quarter turn off"
            named = ("position_zero" if len(which) == 1 else "position_zeros", ",".join(f"q{j + 1}" for j in which))
            yield Made(kind, changed(experiment, turned(angles)), (named,))


def _of_wrench(experiment: Experiment) -> Iterator[Made]:
    assert experiment.sensor is not None
    eye, zero = np.eye(3), np.zeros((3, 3))

    def wrench(matrix: np.ndarray) -> Experiment:
        return changed(experiment, times(matrix, "wrench"))

    def blocks(forces: np.ndarray, moments: np.ndarray) -> np.ndarray:
        return np.block([[forces, zero], [zero, moments]])

    yield Made("wrench of the robot on the sensor", wrench(-np.eye(6)), (("wrench_sign", ""),))
    if experiment.robot.sensor_parent >= 0:

        def in_base(t: Table) -> Table:
            assert experiment.sensor is not None
            turned = base_axes(experiment.robot, experiment.sensor, t.positions)
            both = None if t.wrench is None else np.einsum("nij,nkj->nki", turned, t.wrench.reshape(-1, 2, 3)).reshape(-1, 6)
            return replace(t, wrench=both)

        yield Made("wrench in the axes of the base", changed(experiment, in_base), (("wrench_frame", "base"),))
    yield Made("forces negated", wrench(blocks(-eye, eye)), (("force_sign", ""),))
    yield Made("moments negated", wrench(blocks(eye, -eye)), (("moment_sign", ""),))
    for k, name in enumerate(("fx", "fy", "fz", "mx", "my", "mz")):
        yield Made("one axis negated", wrench(np.diag(np.where(np.arange(6) == k, -1.0, 1.0))), (("axis_sign", name),))
    yield Made("forces and moments exchanged", wrench(np.block([[zero, eye], [eye, zero]])), (("forces_moments", ""),))
    yield Made("moments in N mm", wrench(blocks(eye, 1e3 * eye)), (("moment_unit", "N mm"),))
    yield Made("forces in kgf", wrench(blocks(eye / 9.80665, eye)), (("force_unit", "kgf"),))
    # What undoes each: recorded axes that hold x, y and z.
    turns = {
        "axes x and y exchanged": (eye[[1, 0, 2]], "y, x, z"),
        "axes in another order": (eye[[2, 0, 1]], "y, z, x"),
        "sensor turned by 90 degrees": (np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]), "y, -x, z"),
        "sensor turned over": (np.diag([1.0, -1.0, -1.0]), "x, -y, -z"),
    }
    for kind, (matrix, where) in turns.items():
        yield Made(kind, wrench(blocks(matrix, matrix)), (("sensor_axes", where),))
    rotation = Rotation.from_euler("xyz", experiment.sensor.rpy)
    if np.abs((rotation * rotation).as_rotvec()).max() > 1e-6:
        rpy = rotation.inv().as_euler("xyz")
        sensor = replace(experiment.sensor, rpy=rpy)
        yield Made("rotation transposed", replace(experiment, sensor=sensor), (("sensor_rotation", "transposed"),))
    if np.linalg.norm(experiment.sensor.translation) > 1e-3:
        sensor = replace(experiment.sensor, translation=-experiment.sensor.translation)
        yield Made("translation negated", replace(experiment, sensor=sensor), (("moment_point", "opposite"),))


def said(experiment: Experiment) -> tuple[str, list[tuple[str, str]], str]:
    """What `check` says: the refusal, or names and places of mistakes, and the first line."""
    try:
        for motion in experiment.motions:
            for part in (motion.table, motion.static):
                if part is not None:
                    examination.check_positions(part, experiment.robot)
                    examination.check_channels(part)
            if motion.kind == "trajectory":
                motion_checks.check_trajectory(motion.table, experiment.robot, experiment.position_resolution)
    except InputError as error:
        return str(error), [], str(error)
    found = find_mistakes(experiment)
    names = [pair for m in found for pair in ((m.name, m.where), *m.alternatives)]
    return "", names, found[0].text if found else ""


def tried(experiment: Experiment) -> dict[str, Any]:
    """What is said of the original and of every mistake made on it."""
    start = time.process_time()
    refusal, names, _ = said(experiment)
    out: dict[str, Any] = {
        "original": refusal or [list(pair) for pair in names], "seconds": time.process_time() - start, "made": [],
    }  # fmt: skip
    for one in made(experiment):
        refusal, names, line = said(one.experiment)
        named = bool(set(one.named) & set(names)) or bool(one.refused and one.refused in refusal)
        # The same physics from two lists of candidates is one mistake, said in two ways.
        out["made"].append(
            {"kind": one.kind, "expected": list(map(list, one.named)) or one.refused, "said": line,
             "result": "named" if named else "other" if line else "silent"}
        )  # fmt: skip
    return out


def counted(results: dict[str, Any], mirrored: bool) -> dict[str, int]:
    """How many mistakes were made on real recordings and what became of them; with or without reversed axes."""
    real = [m for k, v in results.items() if not k.startswith("practice") for m in v["made"]]
    every = [m["result"] for m in real if mirrored or m["kind"] != MIRRORED]
    share = round(100.0 * every.count("named") / len(every))
    return {"made": len(every), "share": share, **{r: every.count(r) for r in ("named", "other", "silent")}}


def summary(results: dict[str, Any], real: bool) -> list[str]:
    """A row a kind of mistake."""
    chosen = {k: v for k, v in results.items() if k.startswith("practice") != real}
    kinds = dict.fromkeys(m["kind"] for v in chosen.values() for m in v["made"])
    rows = []
    for kind in kinds:
        every = [m["result"] for v in chosen.values() for m in v["made"] if m["kind"] == kind]
        rows.append(f"| {kind} | {len(every)} | {every.count('named')} | {every.count('other')} | {every.count('silent')} |")
    return rows


def rows(results: dict[str, Any]) -> list[str]:
    """A row a recording."""
    out = []
    for name, v in results.items():
        every = [m["result"] for m in v["made"]]
        original = "nothing" if not v["original"] else str(v["original"])
        share = 100.0 * every.count("named") / len(every)
        out.append(
            f"| {name} | {original} | {len(every)} | {every.count('named')} ({share:.0f} %) | {every.count('other')} | "
            f"{every.count('silent')} | {v['seconds']:.1f} s |"
        )
    return out


TEMPLATE = """# Mistakes made on purpose

What `bayesid check` says when signs, orders, units, zeros and frames are wrong: each mistake is made on every recording at hand,
one at a time, by `python -m tests.studies.mistakes`. How a mistake is found stands in
[method.md](../../explanation/method.md#mistakes).

*Named*: the mistake is what is said, or among what is said to be as likely, or the recording is refused with a line that names
it. *Other*: another mistake is said. *Silent*: nothing is said.

On {{ real }} recordings of real robots {{ plain.made }} mistakes of sign, order, unit, zero and frame are made: {{ plain.named }}
are named ({{ plain.share }} %), {{ plain.other }} are taken for another and {{ plain.silent }} pass in silence. With joints
whose axis is reversed, which may be a mirrored robot, {{ whole.named }} of {{ whole.made }} ({{ whole.share }} %). Of the
recordings as they are, {{ alarms }} real and {{ practice_alarms }} simulated ones raise an alarm.

## By recording

{{ recordings }}

Simulated recordings (`practice`) are small and clean. Seconds: processor time of all of it on the original.

## By kind, real recordings

{{ kinds }}

## By kind, simulated recordings

{{ practice }}

What stays silent is mostly small: a wrist joint that carries little has torques below a hundredth of the shoulder's, and nothing
is concluded from readings that small. A joint whose axis is reversed, in position and torque alike, is a mirrored robot where no
link beyond shows the difference; two wrist joints that are exchanged may be another wrist. And where a recording shows too
little for parts of it to be predicted from the others, as `ur10e/after-load`, no mistake is made out.
"""


def main() -> None:
    """Make every mistake, print what is said, write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", help="recordings whose name holds this; no page is written")
    parser.add_argument("--from-json", action="store_true", help="write the page again from its numbers")
    parser.add_argument("--docs", type=Path, default=STUDIES / "mistakes")
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    results: dict[str, Any] = {}
    if options.from_json:
        results = json.loads((options.docs / "results.json").read_text())
    for name, folder in folders().items() if not options.from_json else ():
        if options.only and options.only not in name:
            continue
        results[name] = tried(load_experiment(folder))
        print(rows({name: results[name]})[0], flush=True)
        for m in results[name]["made"]:
            if m["result"] != "named":
                print(f"    {m['result']}: {m['kind']}, expected {m['expected']}: {m['said'][:150]}", flush=True)
    if options.only:
        return
    write_numbers(results, options.docs / "results.json", 4)
    head = "mistake | made | named | other | silent"
    write_page(
        TEMPLATE, options.docs / "README.md",
        real=sum(not k.startswith("practice") for k in results), plain=counted(results, False), whole=counted(results, True),
        alarms=sum(bool(v["original"]) for k, v in results.items() if not k.startswith("practice")),
        practice_alarms=sum(bool(v["original"]) for k, v in results.items() if k.startswith("practice")),
        recordings=table("recording | said of the original | mistakes made | named | other | silent | time", rows(results)),
        kinds=table(head, summary(results, True)), practice=table(head, summary(results, False)),
    )  # fmt: skip


if __name__ == "__main__":
    main()
