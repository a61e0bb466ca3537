"""What a FIGAROH user runs to get base parameters with standard deviations, stage by stage, timed.

Run it with the interpreter of an environment that holds FIGAROH; it needs nothing of bayesid::

    .venv-figaroh/bin/python tests/benchmarks/figaroh_pipeline.py robot.urdf table.npz --kind wrench

It prints one JSON line. Every step calls FIGAROH 1.0.2 in the order of its own ``BaseIdentification.solve``
without decimation:

kinematics
    ``BaseIdentification.process_data``: median filter, zero-phase Butterworth low-pass, two ``np.gradient``.
    The first and last second are then cut off: the filters' ends are wrong by several rad/s^2.
regressor
    ``tools.regressor.RegressorBuilder.build_basic_regressor``. The wrench needs a free-flyer root: the
    external-wrench mode takes rows 0 to 5 of the joint-torque regressor, joint torques for a fixed root.
zero_columns
    ``tools.regressor.get_index_eliminate`` and ``build_regressor_reduced``.
double_qr
    ``tools.qrdecomposition.QRDecomposer.double_decomposition``; it also solves for the base parameters.
least_squares
    The estimate of the double QR, as FIGAROH takes it, and its residual; with ``--solver lstsq`` the separate
    ``tools.solver.LinearSolver`` (which adds a singular value decomposition for its condition number).
deviations
    ``identification.identification_tools.relative_stdev``.
"""

import argparse
import importlib.metadata
import json
import logging
import os
import resource
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

try:
    # ruff: isort: off
    from figaroh.identification.base_identification import (
        BaseIdentification,
    )
    from figaroh.identification.identification_tools import (
        get_standard_parameters,
        relative_stdev,
    )
    from figaroh.tools.qrdecomposition import QRDecomposer
    from figaroh.tools.regressor import (
        RegressorBuilder,
        RegressorConfig,
        build_regressor_reduced,
        get_index_eliminate,
    )
    from figaroh.tools.robot import create_robot
    from figaroh.tools.solver import LinearSolver
    # ruff: isort: on
except ModuleNotFoundError as error:
    sys.exit(
        f"figaroh_pipeline: no module {error.name} for {sys.executable}: "
        "install figaroh==1.0.2 into its own environment and run this file with that interpreter"
    )

Floats = NDArray[np.float64]
AXES = ["Fx", "Fy", "Fz", "Mx", "My", "Mz"]
# Those of FIGAROH's solve().
ZERO_COLUMN_TOLERANCE = 1e-3
RANK_TOLERANCE = 1e-6
# What is cut off at both ends after filtering [s].
TRIM = 1.0


class TableIdentification(BaseIdentification):
    """FIGAROH's identification of a table in memory instead of files.

    Parameters
    ----------
    robot
        FIGAROH's robot.
    times : ndarray, shape (N,)
        Times [s].
    positions : ndarray, shape (N, n)
        Joint positions [rad].
    effort : ndarray, shape (N, 6) or (N, n)
        Base wrench [N, N m] or joint torques [N m].
    cutoff : float
        Cut-off of the low-pass filter of the positions [Hz].
    """

    def __init__(self, robot, times: Floats, positions: Floats, effort: Floats, cutoff: float):
        self._table = {
            "timestamps": times,
            "positions": positions,
            "velocities": None,
            "accelerations": None,
            "torques": effort,
        }
        self._cutoff = cutoff
        super().__init__(robot, config_file="")

    def load_param(self, config_file: str, setting_type: str = "identification") -> None:
        """Set what FIGAROH would read from its configuration file."""
        n = self._table["positions"].shape[1]
        interval = float(np.median(np.diff(self._table["timestamps"])))
        self.identif_config = {
            # The joints come last, behind the free-flyer if there is one.
            "act_idxq": list(range(self.model.nq - n, self.model.nq)),
            "act_idxv": list(range(self.model.nv - n, self.model.nv)),
            "filter_config": {
                "differentiation_method": "gradient",
                "filter_params": {
                    "nbutter": 4,
                    "f_butter": self._cutoff,
                    "med_fil": 5,
                    "f_sample": 1.0 / interval,
                },
            },
        }

    def load_trajectory_data(self, data_source: str | None = None) -> dict[str, Floats | None]:
        """Return the table."""
        return self._table


class Stopwatch:
    """Wall-clock seconds of named stages."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time the body under a name."""
        start = time.perf_counter()
        yield
        self.seconds[name] = time.perf_counter() - start


def memory(field: str) -> float:
    """Return ``VmRSS`` (now) or ``VmHWM`` (peak) of this process [MB].

    ``ru_maxrss`` is only the fallback where there is no ``/proc``: on Linux a started process inherits the
    peak of the one that started it, so that a large benchmark driver would hide this one's own.
    """
    status = Path("/proc/self/status")
    if status.exists():
        for line in status.read_text().splitlines():
            if line.startswith(field + ":"):
                return int(line.split()[1]) / 1024
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (1024**2 if sys.platform == "darwin" else 1024)


def run(urdf: Path, table: Path, kind: str, cutoff: float, solver: str) -> dict[str, object]:
    """Run the stages on one table.

    Parameters
    ----------
    urdf : Path
        The robot.
    table : Path
        ``.npz`` with ``t`` (N,) [s], ``q`` (N, n) [rad] and ``w`` (N, 6) [N, N m] or ``tau`` (N, n) [N m].
    kind : {"wrench", "torque"}
        What is fitted.
    cutoff : float
        Cut-off of the low-pass filter of the positions [Hz].
    solver : {"qr", "lstsq"}
        The estimate of the double QR, or a separate least-squares solution.

    Returns
    -------
    dict
        Seconds per stage, microseconds a sample, memory [MB] and what was found.
    """
    wrench = kind == "wrench"
    # Meshes are looked up beside the URDF.
    robot = create_robot(str(urdf), package_dirs=str(urdf.parent), isFext=wrench)
    with np.load(table) as arrays:
        times, positions, effort = arrays["t"], arrays["q"], arrays["w" if wrench else "tau"]
    before = memory("VmRSS")
    watch = Stopwatch()

    with watch.stage("kinematics"):
        task = TableIdentification(robot, times, positions, effort, cutoff)
        task.process_data()
        ends = round(TRIM / float(np.median(np.diff(times))))
        inner = slice(ends, len(times) - ends)
        motion = {name: task.processed_data[name][inner] for name in ("positions", "velocities", "accelerations")}
    with watch.stage("regressor"):
        builder = RegressorBuilder(
            robot,
            RegressorConfig(
                is_joint_torques=not wrench,
                is_external_wrench=wrench,
                force_torque=AXES if wrench else None,
            ),
        )
        full = builder.build_basic_regressor(
            motion["positions"], motion["velocities"], motion["accelerations"], task.identif_config
        )
    with watch.stage("zero_columns"):
        standard = get_standard_parameters(robot.model, task.identif_config)
        dropped, names = get_index_eliminate(full, standard, tol_e=ZERO_COLUMN_TOLERANCE)
        reduced = build_regressor_reduced(full, dropped)
        # solve() keeps this one; without it the peak below is the lowest that the double QR allows.
        del full
    with watch.stage("double_qr"):
        # The regressor's rows are ordered axis by axis, each with all samples.
        measured = effort[inner].T.flatten()
        base, _, _, estimate, nominal = QRDecomposer(tolerance=RANK_TOLERANCE).double_decomposition(
            measured, reduced, names, standard
        )
    with watch.stage("least_squares"):
        if solver == "lstsq":
            estimate = LinearSolver(method="lstsq").solve(base, measured)
        residual = measured - base @ estimate
    with watch.stage("deviations"):
        relative = relative_stdev(base, estimate, measured)
    # Its formula: relative_stdev gives these in per cent, rounded to two digits.
    variance = residual @ residual / (len(measured) - len(estimate))
    z = (estimate - nominal) / np.sqrt(variance * np.diag(np.linalg.inv(base.T @ base)))
    peak = memory("VmHWM")

    total = sum(watch.seconds.values())
    samples = len(times)
    return {
        "tool": "figaroh " + importlib.metadata.version("figaroh"),
        "pinocchio": importlib.metadata.version("pin"),
        "numpy": np.__version__,
        "threads": os.environ.get("OMP_NUM_THREADS", f"all of {os.cpu_count()}"),
        "kind": kind,
        "solver": solver,
        "samples": samples,
        "seconds": watch.seconds,
        "total": total,
        "us_per_sample": total / samples * 1e6,
        "us_per_sample_stages": {name: value / samples * 1e6 for name, value in watch.seconds.items()},
        "peak_mb": peak - before,
        "columns": reduced.shape[1],
        "base_parameters": len(estimate),
        "median_relative_deviation_percent": float(np.median(relative)),
        "residual_rms": float(np.sqrt(np.mean(residual**2))),
        # Where the URDF is the truth: errors in standard deviations, intervals that hold it, and the error of the noise-free
        # prediction.
        "z_rms": float(np.sqrt(np.mean(z**2))),
        "inside": float(np.mean(np.abs(z) < 1.96)),
        "difference_from_urdf_rms": float(np.sqrt(np.mean((base @ (estimate - nominal)) ** 2))),
    }


def main() -> None:
    """Read the command line, run, print one JSON line."""
    parser = argparse.ArgumentParser(description="Time FIGAROH's base-parameter pipeline on a table.")
    parser.add_argument("urdf", type=Path)
    parser.add_argument("table", type=Path, help=".npz with t, q and w or tau")
    parser.add_argument("--kind", choices=["wrench", "torque"], default="wrench")
    parser.add_argument("--cutoff", type=float, default=5.0, help="of the low-pass filter [Hz]")
    parser.add_argument("--solver", choices=["qr", "lstsq"], default="qr")
    options = parser.parse_args()
    logging.disable(logging.INFO)
    print(json.dumps(run(options.urdf, options.table, options.kind, options.cutoff, options.solver)))


if __name__ == "__main__":
    main()
