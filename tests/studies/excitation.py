"""Are exciting trajectories better than random ones and than published optimised ones, within the same limits?

``python -m tests.studies.excitation`` from the repository runs it and writes ``docs/studies/excitation``;
cases that the JSON file holds already are not run again: remove it to begin anew.

*Random*: for each arm `bayesid.excite` once with its defaults (20 s), and the best determinant of 1,000 random motions of the
same series, each scaled as large as the same limits allow. Torques are checked by Pinocchio's own recursion at ten times the
recorded rate. *Published*: recordings of motions that others optimised. Their extreme positions, largest speeds, accelerations
and torques of the nominal links become the limits of ours, of the same length, which the search starts from theirs; then both
are judged by the same functions.

``BAYESID_DATA`` names the folder with ``data/ur10e`` and ``data/kuka-lwr4``; ``--tiago`` one with FIGAROH's
``tiago_position.csv`` and ``tiago_48_schunk.urdf`` (examples/tiago of github.com/thanhndv212/figaroh-plus). What is not there
is left out.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pinocchio as pin

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import bayesid
from bayesid.design.excitation.optimise import random_feasible
from bayesid.design.excitation.options import ExcitationOptions
from bayesid.design.excitation.plan import make_task
from bayesid.dynamics.base_parameters import structural_base
from bayesid.dynamics.channels import torque_channels
from bayesid.dynamics.regressors import Kernel
from bayesid.recordings.experiment import Experiment, Motion, Sensor
from bayesid.recordings.table import Table
from bayesid.robot.robot import Robot, load_robot
from bayesid.simulation.trajectories import recorded_trajectories
from tests.robots import ROBOTS, write
from tests.studies import page

ROOT = Path(__file__).resolve().parents[2]

ARMS = ("puma560", "ur5", "panda")
RANDOM, SEED = 1000, 31_130_000
TIAGO = ("torso_lift_joint", *(f"arm_{k}_joint" for k in range(1, 8)))
#: What is cut off at both ends of a recording, where its smoothed trajectory is loose [s].
LOOSE = 1.0


def against_random(name: str, count: int, seed: int) -> dict[str, Any]:
    """One arm: the determinant beside that of random motions, limits by Pinocchio, and the time it takes."""
    with tempfile.TemporaryDirectory() as folder:
        robot = load_robot(write(Path(folder), ROBOTS[name]()))
        model = pin.buildModelFromUrdf(str(robot.urdf))
    experiment = Experiment(name, robot, (), Sensor(translation=np.array([0.0, 0.0, -0.1])))
    bayesid.excite(experiment, starts=1, randoms=1, seconds=0.1, duration=2.0)  # compiles what is compiled
    since = time.perf_counter()
    result = bayesid.excite(experiment, seed=seed)
    seconds = time.perf_counter() - since
    task, _ = make_task(experiment, ExcitationOptions())
    rng = np.random.default_rng(seed + 1)
    others = [random_feasible(task.coordinates, task.limits, rng, 240) for _ in range(count)]
    values = np.array([np.linalg.slogdet(task.matrix(s))[1] for s in others if s is not None]) / result.base.rank
    data = model.createData()
    q, v, a = result.series.at(np.arange(0.0, result.series.period, 1.0 / 1250.0))
    torque = np.array([pin.rnea(model, data, *state) for state in zip(q, v, a, strict=True)])
    middle, half = 0.5 * (robot.upper + robot.lower), 0.5 * (robot.upper - robot.lower)
    shares = {
        "position": np.abs(q - middle) / half, "speed": np.abs(v) / robot.velocity_limit,
        "acceleration": np.abs(a) / (4.0 * robot.velocity_limit), "torque": np.abs(torque) / robot.effort_limit,
    }  # fmt: skip
    return {
        "arm": name, "joints": robot.n, "rank": result.base.rank, "seconds": seconds, "random": len(values),
        "value": result.value, "best_random": float(values.max()), "median_random": float(np.median(values)),
        "std_ratio": float(np.exp(0.5 * (result.value - values.max()))), "samples": len(q),
        "shares": {kind: float(share.max()) for kind, share in shares.items()},
    }  # fmt: skip


def judged(robot: Robot, motion: tuple[np.ndarray, np.ndarray, np.ndarray]) -> dict[str, float]:
    """Of the joint torques' base regressor: condition numbers and the mean logarithm of eigenvalues of the mean information."""
    channels = torque_channels(robot)
    base = structural_base(robot, channels)
    rows = Kernel.of(robot, channels, base.independent).dynamics(*motion).reshape(-1, base.rank)
    rows = rows / np.sqrt(len(motion[0]))
    return {
        "condition": float(np.linalg.cond(rows)),
        "condition_scaled": float(np.linalg.cond(rows / np.linalg.norm(rows, axis=0))),
        "log_det": float(np.linalg.slogdet(rows.T @ rows)[1] / base.rank),
    }  # fmt: skip


def against_published(label: str, experiment: Experiment, period: float, harmonics: int, seed: int) -> dict[str, Any]:
    """A published motion, and ours of its length within its own extremes."""
    theirs = recorded_trajectories(experiment)[0]
    inner = (theirs.times >= theirs.times[0] + LOOSE) & (theirs.times <= theirs.times[-1] - LOOSE)
    motion = theirs.positions[inner], theirs.velocities[inner], theirs.accelerations[inner]
    robot = experiment.robot
    channels = torque_channels(robot)
    torque = Kernel.of(robot, channels).readings(*motion, robot.nominal)
    bound = replace(
        robot, lower=motion[0].min(axis=0), upper=motion[0].max(axis=0), velocity_limit=np.abs(motion[1]).max(axis=0),
        effort_limit=np.abs(torque).max(axis=0),
    )  # fmt: skip
    periods = max(round((theirs.times[inner][-1] - theirs.times[inner][0]) / period), 1)
    out: dict[str, Any] = {"motion": label, "joints": robot.n, "seconds": float(np.ptp(theirs.times[inner]))}
    out["published"] = judged(robot, motion)
    setup = Experiment(label, bound, (), None)
    for criterion in ("d", "condition"):
        result = bayesid.excite(
            setup, channel="torque", criterion=criterion, duration=periods * period, period=period, harmonics=harmonics,
            share=1.0, torque_share=1.0, acceleration=tuple(np.abs(motion[2]).max(axis=0)), collisions=False, seed=seed,
            starts=1, seconds=40.0, warm_start=replace(theirs, times=theirs.times[inner], positions=motion[0]),
        )  # fmt: skip
        t = result.trajectory
        found = judged(robot, (t.positions, t.velocities, t.accelerations))
        out[criterion] = found | {"within_limits": result.within_limits, "run_time": result.seconds["searching"]}
    gain = out["d"]["log_det"] - out["published"]["log_det"]
    out["std_ratio"] = float(np.exp(0.5 * gain))
    return out


def tiago(folder: Path) -> Experiment:
    """FIGAROH's motion of the arm and torso of a Tiago."""
    robot = load_robot(folder / "tiago_48_schunk.urdf", joints=TIAGO)
    table = pd.read_csv(folder / "tiago_position.csv")
    columns = [next(c for c in table.columns if name in c) for name in TIAGO]
    read = Table(table["t"].to_numpy(), table[columns].to_numpy(), source="tiago_position.csv")
    return Experiment("tiago", robot, (Motion("published", "identification", read),))


def published(data: Path, figaroh: Path | None) -> list[tuple[str, Experiment, float, int]]:
    """What is there: label, recording, period and harmonics of ours."""
    cases = []
    for label, folder in (("UR10e, Fourier series and polynomial [Mamedov2020]", "ur10e/feb05-20s-12h"),
                          ("KUKA LWR4+, FloBaRoID [Bethge2017]", "kuka-lwr4")):  # fmt: skip
        if (data / folder).is_dir():
            made = bayesid.load_experiment(data / folder)
            length = made.motions[0].table.duration - 2 * LOOSE
            cases.append((label, made, length, 10))
    if figaroh is not None:
        cases.append(("Tiago, FIGAROH [Nguyen2023]", tiago(figaroh), 20.0, 10))
    return cases


PAGE = """\
# Exciting trajectories

Is the motion of `bayesid excite` better than random motions, and than motions that others have optimised and published, within
the same limits? `python -m tests.studies.excitation` made this page and [results.json](results.json).
[The method](../../explanation/method.md) has the equations, [the how-to](../../howto/excite.md) the use.

## Beside random motions

Base wrench with fitted offsets, 20 s, two periods, five harmonics, the defaults of the verb. {{ count }} random motions of each
arm belong to the same series, start and end at rest, and are each scaled as large as the same limits allow. *Criterion*: the mean
logarithm of the eigenvalues of the information matrix, in units of typical sizes; *ratio*: how many times larger standard
deviations (their geometric mean) are with the best random motion.

| arm | joints | base parameters | criterion | best random | median random | ratio | time |
| --- | --- | --- | --- | --- | --- | --- | --- |
{% for c in random -%}
| {{ c.arm }} | {{ c.joints }} | {{ c.rank }} | {{ "%.2f" | format(c.value) }} | {{ "%.2f" | format(c.best_random) }} | \
{{ "%.2f" | format(c.median_random) }} | {{ "%.1f" | format(c.std_ratio) }} | {{ "%.0f" | format(c.seconds) }} s |
{% endfor %}

Times on one core of a machine that others used as well.

The largest share of the robot's own limits at ten times the recorded rate. Positions and speeds may use 90 %, accelerations 90 %
of full speed in 0.25 s, torques 70 %. Torques are those of Pinocchio's recursion, not of the code that optimised.

| arm | position | speed | acceleration | torque |
| --- | --- | --- | --- | --- |
{% for c in random -%}
| {{ c.arm }} | {{ pct(c.shares.position) }} % | {{ pct(c.shares.speed) }} % | {{ pct(c.shares.acceleration) }} % | \
{{ pct(c.shares.torque) }} % |
{% endfor %}

## Beside published motions

Joint torques. Each joint's extreme positions, largest speed and acceleration, and largest torque of the nominal links along
the recorded motion are the limits of ours, which has the same length and starts and ends at rest. The search starts from the
published motion and from random ones, and takes up to 40 s for each criterion. *Condition*: of the base regressor in SI
units, which FIGAROH and others minimise; *scaled*: with columns of unit length, which does not depend on units. Both motions
have the same columns. *Ratio*: standard deviations (geometric mean) with the published motion over those with ours
(D-optimal). The determinant counts every direction, a condition number only the extreme ones: no motion is best in all.

| motion | joints | length | condition, theirs | D-optimal | for condition | scaled, theirs | D-optimal | for condition | ratio |
| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |
{% for c in published -%}
| {{ c.motion }} | {{ c.joints }} | {{ "%.0f" | format(c.seconds) }} s | {{ "%.0f" | format(c.published.condition) }} | \
{{ "%.0f" | format(c.d.condition) }} | {{ "%.0f" | format(c.condition.condition) }} | \
{{ "%.1f" | format(c.published.condition_scaled) }} | {{ "%.1f" | format(c.d.condition_scaled) }} | \
{{ "%.1f" | format(c.condition.condition_scaled) }} | {{ "%.2f" | format(c.std_ratio) }} |
{% endfor %}

The published motions were optimised for their authors' own limits, models and criteria, and recorded on real robots, which do not
follow exactly: the extremes of a recording allow more in one joint and less in another than their authors did.
"""


def main(arguments: list[str]) -> None:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=RANDOM, help="random motions for each arm")
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--tiago", type=Path, help="folder with FIGAROH's motion of a Tiago")
    parser.add_argument("--docs", type=Path, default=ROOT / "docs" / "studies" / "excitation", help="where the page is written")
    given = parser.parse_args(arguments)
    given.docs.mkdir(parents=True, exist_ok=True)
    path, setting = given.docs / "results.json", {"seed": given.seed, "count": given.count}
    found = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
    if {key: found.get(key) for key in setting} != setting:
        found = {**setting, "random": [], "published": []}
    data = Path(os.environ.get("BAYESID_DATA", ROOT)) / "data"
    for name in ARMS:
        if name not in [c["arm"] for c in found["random"]]:
            found["random"].append(against_random(name, given.count, given.seed))
            page.write_numbers(found, path, digits=5)
    for case in published(data, given.tiago):
        if case[0] not in [c["motion"] for c in found["published"]]:
            found["published"].append(against_published(*case, given.seed))
            page.write_numbers(found, path, digits=5)
    page.write_page(PAGE, given.docs / "README.md", **page.write_numbers(found, path, digits=5))


if __name__ == "__main__":
    main(sys.argv[1:])
