"""python tests/benchmarks/long_recording.py FOLDER [--samples N,N] [--modes chunks,memory,workers]: `identify` in chunks.

A UR5 at 125 Hz with encoder counts and noise, in a Parquet file that is made chunk by chunk (times and positions of eight bytes,
readings of four); it is made once, and stays in FOLDER. `bayesid.identify` with the default method and a validation motion of
20,000 samples runs on it in a process of its own: in chunks, in memory, or in chunks on local workers. Told are the seconds from
the folder to the result, and the largest memory of any process. What is measured is added to the numbers in
docs/studies/long-recordings, and ``--page`` makes its page of them.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent))
sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from make_table import FORCE_STD, RESOLUTION, SAMPLE_RATE, TORQUE_STD, clean_period

from tests.robots import ur5, write
from tests.studies.page import STUDIES, table, write_numbers, write_page

_ROWS = 250_000
_WORKERS = 2
FOLDER = STUDIES / "long-recordings"
TOML = """\
format = 1
name = "long"

[robot]
urdf = "robot.urdf"
joints = ["shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint", "wrist_3_joint"]
position_resolution = {resolution}

[sensor]

[[motion]]
name = "long"
role = "identification"
table = "long.parquet"
chunked = {chunked}

[[motion]]
name = "unseen"
role = "validation"
table = "unseen.parquet"
"""


def make(folder: Path, samples: int) -> None:
    """An experiment of so many samples, of which a few are in memory at a time."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    folder.mkdir(parents=True)
    urdf = write(folder, ur5())
    names = ["t", *(f"q{k}" for k in range(1, 7)), "fx", "fy", "fz", "mx", "my", "mz"]
    schema = pa.schema(list(zip(names, [pa.float64()] * 7 + [pa.float32()] * 6, strict=True)))
    std = np.repeat([FORCE_STD, TORQUE_STD], 3)
    for name, count, seed in (("unseen", 20_000, 1), ("long", samples, 0)):
        rng = np.random.default_rng(seed)
        q, effort = clean_period(urdf, rng)
        with pq.ParquetWriter(folder / f"{name}.parquet", schema) as file:
            for first in range(0, count, _ROWS):
                rows = np.arange(first, min(first + _ROWS, count))
                wrench = effort[rows % len(q), :6] + rng.standard_normal((len(rows), 6)) * std
                columns = [rows / SAMPLE_RATE, *q[rows % len(q)].T, *wrench.astype(np.float32).T]
                file.write_table(pa.table(columns, schema=schema))


def once(folder: Path, mode: str) -> dict:
    """One run in this process, and on its workers."""
    import bayesid
    from bayesid.tasks import cluster

    bayesid.identify  # noqa: B018 - what is imported late is not counted
    (folder / "experiment.toml").write_text(TOML.format(resolution=RESOLUTION, chunked=str(mode != "memory").lower()))
    since = time.perf_counter()
    with cluster(_WORKERS if mode == "workers" else None):
        started = time.perf_counter() - since
        result = bayesid.identify(folder, "wrench", progress=None)
    seconds = time.perf_counter() - since
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return {
        "seconds": seconds, "processor_seconds": sum(u.ru_utime + u.ru_stime for u in used), "workers_started": started,
        "peak_mib": max(u.ru_maxrss for u in used) / 1024, "stages": result.seconds,
        "values": result.estimate.values.tolist(), "std": result.estimate.std.tolist(),
        "unseen": result.validation[0].whitened_rms,
    }  # fmt: skip


PAGE = """\
# Recordings in chunks, and workers

A UR5 at 125 Hz, encoder counts of 2e-5 rad, wrench under the base, all of `identify` with its default method and a
validation motion of 20,000 samples. The recording is a Parquet file (times and positions of eight bytes, readings of four;
4.6 GB of 1e8 samples), made chunk by chunk; `chunked` is `true`, or `false` for "in memory". Seconds from the folder to the
result, of a process of its own on {{ cpus }} cores; the processor's seconds, all processes
together and with their start, stand beside them. Memory is the largest of any process, libraries included. `python
tests/benchmarks/long_recording.py` and `python tests/benchmarks/workers.py` measured it; [how to](../../howto/large.md).

{{ table }}

The difference is the largest between parameters found in chunks and in another way, in standard deviations.
The row of 1e8 samples was measured on a busy machine, the others on one that was idle.

**Two workers:** {{ workers.runs }} tasks that only wait {{ workers.wait }} s each took {{ w_one }} s on a Dask cluster of one
local process and {{ w_two }} s on two, {{ w_ratio }} times as fast: what sharing out costs. As many recordings of a PUMA 560
(20 s at 125 Hz) with fresh noise, fitted one a task, took {{ one }} s on one and {{ two }} s on two, {{ ratio }} times as fast,
and {{ here }} s in one process without Dask, in threads on all {{ cpus }} cores. Medians of {{ repeats }} in turns; parameters
differ by {{ apart }} at most.
"""


def page(found: dict) -> None:
    """The study's page."""
    rows = []
    for samples, modes in sorted(found["runs"].items(), key=lambda item: int(item[0])):
        cells = []
        for mode in ("chunks", "memory", "workers"):
            run = modes.get(mode)
            told = None if run is None else (f"{run[k]:,.3g}" for k in ("seconds", "processor_seconds"))
            cells += ["", "", ""] if told is None else [*told, f"{run['peak_mib']:,.0f}"]
        gap = max((run["apart"] for mode, run in modes.items() if mode != "chunks"), default=None)
        rows.append(f"| {int(samples):,} | " + " | ".join(cells) + (" | |" if gap is None else f" | {gap:.1g} |"))
    head = (
        "samples | in chunks [s] | processor [s] | MiB | in memory [s] | processor [s] | MiB | two workers [s] | "
        "processor [s] | MiB | difference"
    )
    w = found["workers"]
    least = {name: f"{seconds:.3g}" for name, seconds in w["seconds"].items()}
    write_page(
        PAGE, FOLDER / "README.md", table=table(head, rows), cpus=w["cpus"], workers=w, one=least["1"], two=least["2"],
        here=least["here"], ratio=f"{w['two_over_one']:.2f}", repeats=len(w["all"]["1"]),
        w_one=f"{w['waits']['1']:.3g}", w_two=f"{w['waits']['2']:.3g}",
        w_ratio=f"{w['two_over_one_waits']:.2f}", apart=f"{w['apart']:.1g}",
    )  # fmt: skip


def main() -> None:
    """Read the command line, make what is missing, and measure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--samples", default="100000")
    parser.add_argument("--modes", default="chunks,memory")
    parser.add_argument("--once", help=argparse.SUPPRESS)
    parser.add_argument("--page", action="store_true")
    options = parser.parse_args()
    if options.once:
        print(json.dumps(once(options.folder, options.once)))
        return
    FOLDER.mkdir(exist_ok=True)
    numbers = FOLDER / "results.json"
    found = json.loads(numbers.read_text(encoding="utf-8")) if numbers.exists() else {"runs": {}}
    for samples in [int(part) for part in options.samples.split(",") if part]:
        folder = options.folder / str(samples)
        if not folder.exists():
            make(folder, samples)
        entry = found["runs"].setdefault(str(samples), {})
        for mode in options.modes.split(","):
            done = subprocess.run(
                [sys.executable, __file__, str(folder), "--once", mode], capture_output=True, text=True, check=False,
                env={**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
            )  # fmt: skip
            if done.returncode:
                raise SystemExit(f"{mode}, {samples} samples:\n{done.stderr}")
            entry[mode] = run = json.loads(done.stdout.splitlines()[-1])
            first = entry.get("chunks", run)
            run["apart"] = float(np.max(np.abs(np.subtract(run["values"], first["values"])) / np.array(first["std"])))
            print(samples, mode, {k: v for k, v in run.items() if k not in ("values", "std")}, flush=True)
        write_numbers(found, numbers, 12)
    if options.page:
        page(found)


if __name__ == "__main__":
    main()
