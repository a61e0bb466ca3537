"""python bayesid_pipeline.py URDF NPZ --kind wrench|torque: raw table to base parameters with standard deviations.

Prints one JSON line: seconds a stage, microseconds a sample, peak memory beyond the loaded table.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from bayesid.estimators import fit
from bayesid.recordings.experiment import Experiment, Motion, Sensor
from bayesid.recordings.table import Table
from bayesid.regression.options import FitOptions
from bayesid.regression.problem import prepare
from bayesid.robot.robot import load_robot


def memory(field: str) -> float:
    """``VmRSS`` (now) or ``VmHWM`` (peak) of this process [MB]; the kernel tells them in KiB."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith(field + ":"):
            return int(line.split()[1]) / 1000 * 1.024
    raise RuntimeError(f"this system does not tell {field}")


def main() -> None:
    """Run once to warm up (compiled kernels are loaded from their cache), then measure."""
    parser = argparse.ArgumentParser()
    parser.add_argument("urdf", type=Path)
    parser.add_argument("table", type=Path)
    parser.add_argument("--kind", choices=["wrench", "torque"], default="wrench")
    options = parser.parse_args()
    robot = load_robot(options.urdf)
    with np.load(options.table) as data:
        times, q, w, tau = (data[k] for k in ("t", "q", "w", "tau"))
    wrench, torques = (w, None) if options.kind == "wrench" else (None, tau)
    with threadpool_limits(1, user_api="blas"):
        _run(robot, times[:2000], q[:2000], wrench, torques, options.kind)
        Path("/proc/self/clear_refs").write_text("5")  # forget the peak of loading and warming up
        before = memory("VmRSS")
        seconds, estimate = _run(robot, times, q, wrench, torques, options.kind)
        peak = memory("VmHWM")
    total = sum(seconds.values())
    result = {
        "tool": "bayesid",
        "kind": options.kind,
        "samples": len(times),
        "seconds": seconds,
        "total_s": total,
        "us_per_sample": 1e6 * total / len(times),
        "peak_mb": peak - before,
        "base_parameters": estimate.base.rank,
        "worst_relative_std": float(np.nanmax(estimate.std / np.abs(estimate.values))),
    }
    print(json.dumps(result))


def _run(robot, times, q, wrench, torques, kind):
    n = len(times)
    table = Table(
        times=times, positions=q, wrench=None if wrench is None else wrench[:n], torques=None if torques is None else torques[:n]
    )
    sensor = Sensor() if kind == "wrench" else None
    experiment = Experiment("bench", robot, (Motion("a", "identification", table),), sensor, position_resolution=2e-5)
    start = time.perf_counter()
    problem = prepare(experiment, FitOptions(kind))
    prepared = time.perf_counter()
    problem.regression.rows.pilot()
    rows = time.perf_counter()
    estimate = fit(problem.regression)
    done = time.perf_counter()
    return {"prepare": prepared - start, "rows": rows - prepared, "fit": done - rows}, estimate


if __name__ == "__main__":
    main()
