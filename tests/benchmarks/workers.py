"""python tests/benchmarks/workers.py [--runs 60] [--repeats 5]: what two local workers gain over one.

Recordings of a PUMA 560 (20 s at 125 Hz) with fresh noise are fitted, one a task, on Dask clusters of one and of two local
processes, in turns; and in this process alone, one after the other in threads on all cores. Beside them, tasks that only wait,
which show what sharing out costs however busy the machine is. Medians count, of the ratios those of neighbouring runs. What is
measured goes into docs/studies/long-recordings/results.json.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import sys
import tempfile
import time
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from bayesid.estimators import fit
from bayesid.recordings.experiment import Experiment, Motion, Sensor
from bayesid.regression.options import FitOptions
from bayesid.regression.parallel import in_order, one_blas_thread
from bayesid.regression.problem import prepare
from bayesid.robot.robot import load_robot
from bayesid.tasks import cluster, local_cluster, map_tasks
from tests.robots import puma560, write
from tests.simulated import fourier, recording
from tests.studies.page import STUDIES, write_numbers

#: Of a task that only waits [s].
WAIT = 0.15


def arm(folder: Path) -> Experiment:
    """The experiment whose noise is drawn again."""
    robot = load_robot(write(folder, puma560()))
    table = recording(robot, Sensor(), fourier(robot, 1, 20.0), seed=1, resolution=1e-5, offset=0.5)
    return Experiment("arm", robot, (Motion("fitted", "identification", table),), Sensor(), position_resolution=1e-5)


def fitted(experiment: Experiment, seed: int) -> np.ndarray:
    """Base parameters of the recording with the noise of a seed."""
    (motion,) = experiment.motions
    noise = np.random.default_rng(seed).normal(size=(len(motion.table), 6)) * np.repeat([0.3, 0.1], 3)
    table = replace(motion.table, wrench=motion.table.wrench + noise)
    return fit(prepare(replace(experiment, motions=(replace(motion, table=table),)), FitOptions("wrench")).regression).values


def waited(_: int) -> None:
    """A task that leaves the processor alone."""
    time.sleep(WAIT)


def ratio(seconds: dict[str, list[float]]) -> float:
    """How many times as fast two workers are as one."""
    return statistics.median(one / two for one, two in zip(seconds["1"], seconds["2"], strict=True))


def main() -> None:
    """Read the command line and measure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=60)
    parser.add_argument("--repeats", type=int, default=5)
    options = parser.parse_args()
    seconds: dict[str, list[float]] = {"1": [], "2": [], "here": []}
    waits: dict[str, list[float]] = {"1": [], "2": []}
    values = []
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        experiment = arm(Path(folder))
        places: dict[str, str | None] = {str(n): stack.enter_context(local_cluster(n)) for n in (1, 2)} | {"here": None}
        for repeat in range(options.repeats + 1):
            for name, place in places.items():
                with one_blas_thread(), cluster(scheduler=place):  # as every verb does
                    since = time.perf_counter()
                    count = options.runs if repeat else 8  # the first time, libraries are loaded
                    found = list(map_tasks(partial(fitted, experiment), range(count), locally=in_order))
                    if repeat:
                        seconds[name].append(time.perf_counter() - since)
                        values.append(np.array(found))
                    if repeat and place is not None:
                        since = time.perf_counter()
                        list(map_tasks(waited, range(options.runs)))
                        waits[name].append(time.perf_counter() - since)
    apart = max(float(np.abs(v - values[0]).max()) for v in values)
    middle = {name: statistics.median(each) for name, each in seconds.items()}
    result = {
        "runs": options.runs, "cpus": os.cpu_count(), "seconds": middle, "all": seconds, "two_over_one": ratio(seconds),
        "apart": apart,
        "waits": {name: statistics.median(each) for name, each in waits.items()}, "wait": WAIT,
        "two_over_one_waits": ratio(waits),
    }  # fmt: skip
    print(json.dumps(result, indent=1))
    path = STUDIES / "long-recordings" / "results.json"
    numbers = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {"runs": {}}
    write_numbers({**numbers, "workers": result}, path, 12)


if __name__ == "__main__":
    main()
