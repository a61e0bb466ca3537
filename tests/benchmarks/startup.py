"""python tests/benchmarks/startup.py [--repeats N] [--write]: what a user waits for before the work begins.

``--help``, ``--version``, ``import bayesid`` and the whole of ``check`` on an arm's recordings, each a process of its own in its
own interpreter, taking turns with the imports of the libraries that the work is done with and of FIGAROH. Medians of wall time.
``--write`` renews docs/studies/startup.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import bayesid
from bayesid.robot.robot import load_robot

sys.path.insert(0, str(Path(__file__).resolve().parent))
sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from run import FIGAROH

from tests.example_robots import puma560_urdf
from tests.studies.page import STUDIES, write_numbers, write_page

PAGE = """\
# How long starting takes

Seconds until the process has ended, medians of {{ repeats }} (least to most), processes that take turns, on {{ cpus }} cores;
made by `python tests/benchmarks/startup.py --write`. `check` reads three recordings of the example PUMA 560, 52 s in all, and
writes its report.

| what | seconds |
|---|---|
{% for name, (low, middle, high) in seconds.items() %}
| {{ name }} | {{ "%.2f" | format(middle) }} ({{ "%.2f" | format(low) }} to {{ "%.2f" | format(high) }}) |
{% endfor %}

Most of `check` is the import of the libraries that it works with, and their first call of a compiled function, which is in the
table, too: that much is the same whatever bayesid does with them.
"""
#: What `check` needs of others: imports, and one compiled function loaded from numba's cache.
LIBRARIES = "import click, jinja2, numba, numpy, pinocchio, pydantic, rich.progress, scipy.linalg, scipy.optimize"
KERNEL = "import numpy as np; from bayesid.signals.smoothing import smooth; t = np.arange(500) / 100; smooth(t, t[:, None], 5.0)"


def folders(place: Path) -> dict[str, Path]:
    """One recording of the wrench and one of the torques."""
    (place / "puma560.urdf").write_text(puma560_urdf(), encoding="utf-8")
    robot = load_robot(place / "puma560.urdf")
    motions = [
        bayesid.fourier_trajectory(robot, name, role, duration=duration, seed=seed)
        for seed, (name, role, duration) in enumerate(
            [("first", "identification", 20.0), ("second", "identification", 20.0), ("unseen", "validation", 12.0)]
        )
    ]
    recorder = bayesid.Recorder(force_std=0.2, torque_std=0.02, resolution=2e-5)
    whole = bayesid.simulate(robot, motions, recorder=recorder, perturb=0.02, seed=1)
    out = {}
    for kind, sensor, unread in (("wrench", whole.sensor, "torques"), ("torques", None, "wrench")):
        kept = tuple(replace(m, table=replace(m.table, **{unread: None})) for m in whole.motions)
        bayesid.write_experiment(replace(whole, motions=kept, sensor=sensor), place / kind)
        out[kind] = place / kind
    return out


def seconds(commands: dict[str, list[str]], repeats: int) -> dict[str, list[float]]:
    """Least, median and most of the wall time of every command [s]; the first turn, which fills caches, does not count."""
    taken: dict[str, list[float]] = {name: [] for name in commands}
    # A user's Python keeps what it compiled.
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
    for turn in range(repeats + 1):
        for name, command in commands.items():
            since = time.perf_counter()
            subprocess.run(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, env=environment, check=True)
            if turn:
                taken[name].append(time.perf_counter() - since)
    return {name: [min(each), statistics.median(each), max(each)] for name, each in taken.items()}


def main() -> None:
    """Time everything, print it, and with ``--write`` renew the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=9)
    parser.add_argument("--write", action="store_true")
    options = parser.parse_args()
    program = str(Path(sys.executable).with_name("bayesid"))
    with tempfile.TemporaryDirectory() as temporary:
        commands = {
            "an empty Python": [sys.executable, "-c", ""],
            "`import bayesid`": [sys.executable, "-c", "import bayesid"],
            "`bayesid --version`": [program, "--version"],
            "`bayesid --help`": [program, "--help"],
        }
        for kind, folder in folders(Path(temporary)).items():
            commands[f"`bayesid check`, {kind}"] = [program, "check", str(folder), "--out", str(Path(temporary) / "out")]
        commands["of that, libraries"] = [sys.executable, "-c", LIBRARIES]
        commands["and a compiled function"] = [sys.executable, "-c", f"{LIBRARIES}; {KERNEL}"]
        if FIGAROH.exists():
            commands["FIGAROH's import alone"] = [str(FIGAROH), "-c", "import figaroh.identification.identification_tools"]
        found = seconds(commands, options.repeats)
    for name, (low, middle, high) in found.items():
        print(f"{name:28s} {middle:.3f} s ({low:.3f} to {high:.3f})")
    if options.write:
        found = write_numbers(found, STUDIES / "startup" / "results.json", 3)
        write_page(PAGE, STUDIES / "startup" / "README.md", seconds=found, cpus=os.cpu_count(), repeats=options.repeats)


if __name__ == "__main__":
    main()
