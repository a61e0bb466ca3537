"""python tests/benchmarks/identify.py [--repeats N] [--write]: the whole of `bayesid.identify` beside FIGAROH's, in one run.

A UR5 with 100,000 samples to fit and another motion of 20,000 samples to validate, encoder counts, constant offsets of the
readings estimated along, default method: base parameters and their deviations, noise, prediction of the validation motion,
consistency of the motions, nearest links; what the prediction of the fitted motion takes, which is made when it is asked for, is
told apart. FIGAROH fits the same 100,000 samples and does nothing of the rest. Every run is a process of its own, the tools take
turns, medians are quoted. ``--write`` renews docs/studies/identify-speed.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent))
sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import bayesid
from bayesid.recordings.experiment import Experiment, Motion, Sensor
from bayesid.recordings.table import Table
from bayesid.robot.robot import load_robot
from tests.studies.page import STUDIES, write_numbers, write_page

FITTED, VALIDATED = 100_000, 20_000
PAGE = """\
# The whole of `identify`

A UR5, 100,000 samples at 125 Hz to fit and 20,000 of another motion to validate, encoder counts of 2e-5 rad, offsets estimated
along, default method. In microseconds a fitted sample, on {{ cpus }} cores, medians over processes that take turns; made by
`python tests/benchmarks/identify.py --write`. FIGAROH 1.0.2 fits the same 100,000 samples (filter, regressor, double QR,
least squares, deviations); the prediction of the validation motion, consistency of the motions, noise and nearest links are
bayesid's alone. "Fitted" is what the prediction of the fitted motion takes on top; `identify` makes it when it is asked for, as
by `print`, `write` and the command line.

| readings |{% for stage in stages %} {{ stage }} |{% endfor %} total | FIGAROH | ratio (least to most) | fitted | ratio with it |
|---|{% for stage in stages %}---|{% endfor %}---|---|---|---|---|
{% for row in rows %}
| {{ row.kind }} |{% for x in row.stages %} {{ x }} |{% endfor %} {{ row.total }} |{% for x in row.others %} {{ x }} |{% endfor %}

{% endfor %}

How much of that is the regressor and the reduction alone: [benchmarks](../benchmarks/README.md). Stages overlap on several
cores, so they
are shares of the time that passes, not of work.
"""
#: Of the encoders [rad], as in `make_table`.
RESOLUTION = 2e-5


def load(urdf: Path, tables: tuple[Path, Path], kind: str, share: float = 1.0) -> Experiment:
    """The experiment of two tables, or of the first part of each."""
    robot = load_robot(urdf)
    motions = []
    for name, role, path in zip(("fitted", "unseen"), ("identification", "validation"), tables, strict=True):
        with np.load(path) as data:
            n = round(share * len(data["t"]))
            readings = {"wrench": data["w"][:n]} if kind == "wrench" else {"torques": data["tau"][:n]}
            motions.append(Motion(name, role, Table(times=data["t"][:n], positions=data["q"][:n], **readings)))
    if kind == "wrench":  # the sensor's offset is estimated wherever no static run removes it
        return Experiment("bench", robot, tuple(motions), Sensor(), position_resolution=RESOLUTION)
    return Experiment("bench", robot, tuple(motions), effects=("torque_offset",), position_resolution=RESOLUTION)


def once(urdf: Path, tables: tuple[Path, Path], kind: str) -> dict:
    """One run in this process, after a small one that loads the compiled kernels."""
    bayesid.identify(load(urdf, tables, kind, 0.1), kind)
    experiment = load(urdf, tables, kind)
    since, used = time.perf_counter(), time.process_time()
    result = bayesid.identify(experiment, kind)
    total, used = time.perf_counter() - since, time.process_time() - used
    since = time.perf_counter()
    (fitted,) = result.fitted
    return {
        "fitted_us_per_sample": 1e6 * (time.perf_counter() - since) / FITTED, "error": fitted.relative_error_raw,
        "seconds": total, "processor_seconds": used, "us_per_sample": 1e6 * total / FITTED, "stages": result.seconds,
        "residual": result.estimate.residual_rms, "unseen": [p.whitened_rms for p in result.validation],
    }  # fmt: skip


def compare(urdf: Path, folder: Path, repeats: int) -> dict:
    """Medians of both tools and of their ratio, by kind of readings."""
    from run import FIGAROH, call

    tables = folder / "fitted.npz", folder / "unseen.npz"
    for path, samples, seed in zip(tables, (FITTED, VALIDATED), (0, 1), strict=True):
        call(sys.executable, "make_table.py", str(path), "--urdf", str(urdf), "--samples", str(samples), "--seed", str(seed))
    out = {}
    for kind in ("wrench", "torque"):
        own, other = [], []
        for _ in range(repeats):
            own.append(call(sys.executable, "identify.py", "--one", str(urdf), *map(str, tables), "--kind", kind))
            if FIGAROH.exists():
                other.append(call(FIGAROH, "figaroh_pipeline.py", str(urdf), str(tables[0]), "--kind", kind))
        out[kind] = {
            "us_per_sample": statistics.median(r["us_per_sample"] for r in own),
            "fitted_us_per_sample": statistics.median(r["fitted_us_per_sample"] for r in own),
            "stages": {s: statistics.median(1e6 * r["stages"][s] / FITTED for r in own) for s in own[0]["stages"]},
        }
        if other:
            ratios = [b["us_per_sample"] / a["us_per_sample"] for a, b in zip(own, other, strict=True)]
            out[kind]["figaroh_us_per_sample"] = statistics.median(r["us_per_sample"] for r in other)
            out[kind]["figaroh_over_bayesid"] = [min(ratios), statistics.median(ratios), max(ratios)]
            both = [
                b["us_per_sample"] / (a["us_per_sample"] + a["fitted_us_per_sample"]) for a, b in zip(own, other, strict=True)
            ]
            out[kind]["figaroh_over_bayesid_with_fitted"] = statistics.median(both)
        print(f"{kind}: {json.dumps(out[kind], indent=1)}", flush=True)
    return out


def rows_of(result: dict) -> list[dict]:
    """The results as rows of the page."""
    rows = []
    for kind, entry in result.items():
        others = ["-", "-", f"{entry['fitted_us_per_sample']:.2f}", "-"]
        if "figaroh_over_bayesid" in entry:
            others[0] = f"{entry['figaroh_us_per_sample']:.1f}"
            others[1] = "{1:.1f} ({0:.1f} to {2:.1f})".format(*entry["figaroh_over_bayesid"])
            others[3] = f"{entry['figaroh_over_bayesid_with_fitted']:.1f}"
        stages = [f"{value:.2f}" for value in entry["stages"].values()]
        rows.append({"kind": kind, "stages": stages, "total": f"{entry['us_per_sample']:.2f}", "others": others})
    return rows


def main() -> None:
    """Compare, or with ``--one`` run once on given files."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--one", type=Path, nargs=3, metavar=("URDF", "FITTED", "UNSEEN"))
    parser.add_argument("--kind", choices=["wrench", "torque"], default="wrench")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--write", action="store_true")
    options = parser.parse_args()
    if options.one:
        urdf, fitted, unseen = options.one
        print(json.dumps(once(urdf, (fitted, unseen), options.kind)))
        return
    from tests.robots import ur5

    with tempfile.TemporaryDirectory() as temporary:
        urdf = Path(temporary) / "ur5.urdf"
        urdf.write_text(ur5(), encoding="utf-8")
        result = compare(urdf, Path(temporary), options.repeats)
    if options.write:
        result = write_numbers(result, STUDIES / "identify-speed" / "results.json", 4)
        stages = list(result["wrench"]["stages"])
        write_page(PAGE, STUDIES / "identify-speed" / "README.md", cpus=os.cpu_count(), stages=stages, rows=rows_of(result))


if __name__ == "__main__":
    main()
