"""python tests/benchmarks/workers.py [--twins 100] [--repeats 3]: what two local workers gain over one.

The coverage certificate of a UR5 with two motions of 20 s (`bayesid.accuracy`), on Dask clusters of one and of two local
processes that have done a few twins before, in turns; and in this process alone, whose threads use all cores. The least of the
repeats counts, for other work on the machine only adds. What is measured goes into docs/studies/long-recordings/results.json.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import bayesid
from bayesid.recordings.experiment import Experiment, Motion, Sensor
from bayesid.robot.robot import load_robot
from bayesid.tasks import local_cluster
from tests.robots import ur5, write
from tests.simulated import fourier, recording
from tests.studies.page import STUDIES, write_numbers


def arm(folder: Path) -> Experiment:
    """The experiment whose intervals are certified."""
    robot = load_robot(write(folder, ur5()))
    noise = dict(force_std=0.3, torque_std=0.1, resolution=1e-5, offset=0.5)
    made = [recording(robot, Sensor(), fourier(robot, k, 20.0), seed=k, **noise) for k in (1, 2)]
    motions = Motion("fitted", "identification", made[0]), Motion("unseen", "validation", made[1])
    return Experiment("arm", robot, motions, Sensor(), position_resolution=1e-5)


def main() -> None:
    """Read the command line and measure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--twins", type=int, default=100)
    parser.add_argument("--repeats", type=int, default=3)
    options = parser.parse_args()
    seconds: dict[str, list[float]] = {"here": [], "1": [], "2": []}
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        found = bayesid.identify(arm(Path(folder)), "wrench", progress=None)

        def certified(twins: int, scheduler: str | None) -> float:
            since = time.perf_counter()
            bayesid.accuracy(found, runs=0, certificate=twins, scheduler=scheduler, progress=None)
            return time.perf_counter() - since

        places: dict[str, str | None] = {"here": None}
        for count in (1, 2):
            places[str(count)] = stack.enter_context(local_cluster(count))
        few = {name: min(certified(20, place) for _ in range(2)) for name, place in places.items()}
        for _ in range(options.repeats):
            for name, place in places.items():
                # Without what is done once, in this process: the bench, and effects left out of the model.
                seconds[name].append(certified(20 + options.twins, place) - few[name])
    least = {name: min(each) for name, each in seconds.items()}
    result = {
        "twins": options.twins,
        "cpus": os.cpu_count(),
        "seconds": least,
        "all": seconds,
        "two_over_one": least["1"] / least["2"],
    }
    print(json.dumps(result, indent=1))
    path = STUDIES / "long-recordings" / "results.json"
    numbers = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    write_numbers({**numbers, "workers": result}, path, 12)


if __name__ == "__main__":
    main()
