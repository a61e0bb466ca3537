"""Standard deviations expected before any reading against Monte-Carlo, on two arms.

``python -m tests.studies.expected`` from the repository runs it and writes ``docs/studies/expected``. Robots and motions
are those of `coverage_case`, the plant is Pinocchio's inverse dynamics of their URDFs.
"""

from __future__ import annotations

import sys
import tempfile
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import chi2
from threadpoolctl import threadpool_limits

from bayesid import estimators
from bayesid.design.expected import expect
from bayesid.design.reading_noise import SENSOR_SETS, SensorSet, white_noise
from bayesid.recordings.experiment import Experiment, Sensor
from bayesid.regression.options import FitOptions
from bayesid.regression.problem import prepare, relinearised
from bayesid.regression.row_cache import MotionRows
from bayesid.robot.robot import load_robot
from bayesid.simulation.trajectories import Trajectory
from bayesid.tasks import cluster, map_tasks
from tests.design.plant import readings, recorded
from tests.studies.coverage_case import ARMS, setup
from tests.studies.interval_coverage import NAMES
from tests.studies.page import STUDIES, parsed, table, write_numbers, write_page

SEED, COUNT = 13, 1500
GIVEN = {"force": 0.5, "moment": 0.1}
STD = np.array([0.5] * 3 + [0.1] * 3)
#: Agreement asked of every parameter, and the probability with which chance alone keeps all within its own band.
AGREED, SIMULTANEOUS = 0.05, 0.99
_CHUNK = 50


def planned(name: str, folder: str | Path) -> tuple[Experiment, Trajectory, SensorSet]:
    """An arm from a file of its own, its motion, and the sensor set that suits it."""
    arm, case = ARMS[name], setup(name)
    path = Path(folder) / "robot.urdf"
    path.write_text(arm.urdf(), encoding="utf-8")
    robot = load_robot(path, arm.joints, arm.locked)
    times = np.arange(2500) / 125.0
    motion = Trajectory("fourier", "identification", times, *case.trajectory(times))
    return Experiment(name, robot, (), Sensor()), motion, SENSOR_SETS["wrench-static" if arm.static else "wrench-offset"]


def monte_carlo(name: str, folder: str | Path, draws: int, seed: int = SEED) -> tuple[np.ndarray, np.ndarray]:
    """Errors of identified base parameters (draws, r) over what was expected of them before; and stated over expected."""
    bare, motion, sensor_set = planned(name, folder)
    robot, locked = bare.robot, ARMS[name].locked
    expected = expect(bare, sensor_set, white_noise(robot, given=GIVEN), [motion])
    assert expected.row_model is not None
    options = FitOptions(bandwidth=expected.row_model.bandwidth)
    still = 0.0 * motion.velocities
    exact = readings(robot, locked, motion.positions, motion.velocities, motion.accelerations)[:, :6]
    rest = readings(robot, locked, motion.positions, still, still)[:, :6] if sensor_set.offset == "static run" else None
    rng = np.random.default_rng(seed)
    problem = prepare(recorded(bare, motion, exact, rest), options)
    (segment,) = problem.segments[motion.name]
    errors, stated = [], []
    for _ in range(draws):  # the same as new recordings of the motion, made ready once
        noise = STD * rng.normal(size=exact.shape) - (0.0 if rest is None else STD * rng.normal(size=rest.shape))
        own = {motion.name: [replace(segment, readings=exact + noise)]}
        read = replace(problem, segments=own, rows=MotionRows(problem.row_model, own))
        # Positions are exact here: no errors of theirs need be simulated.
        estimate = estimators.fit(replace(relinearised(read, None).regression, regressor_noise=None))
        errors.append(estimate.values - expected.base.matrix @ robot.nominal.ravel())
        stated.append(estimate.std)
    std = expected.std[: expected.base.rank]
    return np.array(errors) / std, np.array(stated) / std


def _part(name: str, seed: int, part: int) -> tuple[np.ndarray, np.ndarray]:
    with tempfile.TemporaryDirectory() as folder, threadpool_limits(1):
        return monte_carlo(name, folder, _CHUNK, int(np.random.SeedSequence(seed, spawn_key=(part,)).generate_state(1)[0]))


def study(count: int = COUNT, seed: int = SEED, processes: int = 2) -> dict[str, Any]:
    """Run everything."""
    out = {}
    for name in ARMS:
        with cluster(processes):
            parts = list(map_tasks(partial(_part, name, seed), range(-(-count // _CHUNK))))
        errors, stated = (np.concatenate(column) for column in zip(*parts, strict=True))
        draws, parameters = errors.shape
        ratio = np.sqrt(np.mean(errors**2, axis=0))
        tail = (1.0 - SIMULTANEOUS) / parameters / 2.0
        band = [float(np.sqrt(chi2.ppf(p, draws) / draws)) for p in (tail, 1.0 - tail)]
        out[name] = {
            "draws": draws, "parameters": parameters, "all": float(np.sqrt(np.mean(errors**2))),
            "lowest": float(ratio.min()), "highest": float(ratio.max()), "band": band,
            "within": int(np.sum(np.abs(ratio - 1.0) <= AGREED)), "stated": float(np.median(stated)), "ratios": ratio,
        }  # fmt: skip
    return {"seed": seed, "arms": out}


PAGE = """\
# Expected standard deviations

What `identifiability` expects of base parameters before any reading, beside what estimates then scatter by. Robots and motions
(20 s, 125 Hz) are those of [coverage](../coverage/README.md); readings come from Pinocchio's inverse dynamics of the URDF
with 0.5 N and
0.1 N m of white noise; each is fitted by the default method. `python -m tests.studies.expected` made this page and
[results.json](results.json) from seed {{ seed }}; the slow tests repeat a part of it.

{{ rows }}

Scatter is the root mean square error of a parameter over all recordings, and in the first column of all parameters together. By
chance alone: where the ratios of all parameters stay with a probability of 99 % if the expectation is exact. Stated: the median
of the standard deviations that the fits themselves give, from noise learned of their residuals.
"""


def write(result: dict[str, Any], folder: Path = STUDIES / "expected") -> None:
    """Write the page and its numbers."""
    folder.mkdir(parents=True, exist_ok=True)
    rounded = write_numbers(result, folder / "results.json", digits=4)
    head = "arm | base parameters | recordings | scatter / expected | of each | by chance alone | within 5 % | stated / expected"
    rows = [
        f"| {NAMES[name]} | {a['parameters']} | {a['draws']} | {a['all']:.3f} | {a['lowest']:.3f} to {a['highest']:.3f} | "
        f"{a['band'][0]:.3f} to {a['band'][1]:.3f} | {a['within']} | {a['stated']:.3f} |"
        for name, a in rounded["arms"].items()
    ]
    write_page(PAGE, folder / "README.md", rows=table(head, rows), seed=rounded["seed"])


def main(arguments: list[str]) -> None:
    """Run from the command line."""
    given = parsed(arguments, __doc__, docs="expected", count=COUNT, of="arm", seed=SEED)
    write(study(given.count, given.seed, given.processes), given.docs)


if __name__ == "__main__":
    main(sys.argv[1:])
