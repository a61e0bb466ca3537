"""Time bare Pinocchio regressor loops over a table: the floor under every tool that calls it once a sample.

``python tests/benchmarks/pinocchio_loop.py robot.urdf table.npz`` prints one JSON line a kind: ``torque`` is
``computeJointTorqueRegressor`` with a fixed base, ``wrench`` the same with a free-flyer root, of which rows 0
to 5 are the base wrench. Nothing is stored, filtered or solved.
"""

# Pinocchio's names come from its compiled module.
import argparse
import json
import statistics
import time
from pathlib import Path

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def time_loop(urdf: Path, times: Floats, positions: Floats, *, wrench: bool) -> float:
    """Return the seconds of one pass over all samples.

    Parameters
    ----------
    urdf : Path
        The robot.
    times : ndarray, shape (N,)
        Times [s].
    positions : ndarray, shape (N, n)
        Joint positions [rad].
    wrench : bool
        Whether the root is a free-flyer and only rows 0 to 5 are kept.
    """
    if wrench:
        model = pin.buildModelFromUrdf(str(urdf), pin.JointModelFreeFlyer())
    else:
        model = pin.buildModelFromUrdf(str(urdf))
    data = model.createData()
    # Derivatives, and the constant pose of the root, cost nothing here: only the loop is timed.
    rates = np.gradient(positions, times, axis=0)
    root = len(times), model.nv - positions.shape[1]
    pose = pin.neutral(model)[: model.nq - positions.shape[1]]
    q = np.hstack([np.tile(pose, (len(times), 1)), positions])
    v = np.hstack([np.zeros(root), rates])
    a = np.hstack([np.zeros(root), np.gradient(rates, times, axis=0)])
    rows = slice(6) if wrench else slice(None)
    compute = pin.computeJointTorqueRegressor
    start = time.perf_counter()
    for q_now, v_now, a_now in zip(q, v, a, strict=True):
        compute(model, data, q_now, v_now, a_now)[rows]
    return time.perf_counter() - start


def main() -> None:
    """Read the command line, time, print one JSON line a kind."""
    parser = argparse.ArgumentParser(description="Time bare Pinocchio regressor loops on a table.")
    parser.add_argument("urdf", type=Path)
    parser.add_argument("table", type=Path, help=".npz with t and q")
    parser.add_argument("--kind", choices=["wrench", "torque", "both"], default="both")
    parser.add_argument("--repeats", type=int, default=3)
    options = parser.parse_args()
    with np.load(options.table) as arrays:
        times, positions = arrays["t"], arrays["q"]
    for kind in ["wrench", "torque"] if options.kind == "both" else [options.kind]:
        seconds = [time_loop(options.urdf, times, positions, wrench=kind == "wrench") for _ in range(options.repeats)]
        report = {
            "tool": "pinocchio " + pin.__version__,
            "kind": kind,
            "samples": len(times),
            "us_per_sample": statistics.median(seconds) / len(times) * 1e6,
            "us_per_sample_best": min(seconds) / len(times) * 1e6,
            "seconds": seconds,
        }
        print(json.dumps(report))


if __name__ == "__main__":
    main()
