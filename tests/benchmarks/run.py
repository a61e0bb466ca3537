"""python tests/benchmarks/run.py [--quick]: speed and memory of bayesid beside FIGAROH and bare Pinocchio, in one run.

Every measurement is a process of its own, tools take turns, and medians are quoted: machines are noisy. FIGAROH
is run with the interpreter of ``.venv-figaroh`` (``make bench`` makes it). Prints a table and writes
``docs/studies/benchmarks/results.json`` with ``--write``.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))
sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tests.robots import ur5

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent.parent
STUDY = ROOT / "docs" / "studies" / "benchmarks"
FIGAROH = ROOT / ".venv-figaroh" / "bin" / "python"


def call(python: Path | str, script: str, *arguments: str) -> dict:
    """Run a benchmark script; its last line of output is JSON. One thread in linear algebra for all alike."""
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run(
        [str(python), str(HERE / script), *arguments], capture_output=True, text=True, env=environment, check=False
    )
    if done.returncode:
        raise SystemExit(f"{script} failed:\n{done.stderr}")
    lines = done.stdout.strip().splitlines()
    return json.loads(lines[-1]) if lines and lines[-1].startswith("{") else {}


def compare(urdf: Path, folder: Path, samples: int, repeats: int) -> dict:
    """Bayesid, FIGAROH and the bare loop on one table, in turn."""
    table = folder / f"{samples}.npz"
    call(sys.executable, "make_table.py", str(table), "--urdf", str(urdf), "--samples", str(samples))
    result = {}
    for kind in ("wrench", "torque"):
        runs: dict[str, list[dict]] = {"bayesid": [], "figaroh": [], "pinocchio": []}
        for _ in range(repeats):
            runs["bayesid"].append(call(sys.executable, "bayesid_pipeline.py", str(urdf), str(table), "--kind", kind))
            runs["pinocchio"].append(
                call(sys.executable, "pinocchio_loop.py", str(urdf), str(table), "--kind", kind, "--repeats", "1")
            )
            if FIGAROH.exists():
                runs["figaroh"].append(call(FIGAROH, "figaroh_pipeline.py", str(urdf), str(table), "--kind", kind))
        entry: dict = {name: _median(each) for name, each in runs.items() if each}
        for name in ("figaroh", "pinocchio"):
            if runs[name]:
                pairs = [
                    other["us_per_sample"] / own["us_per_sample"] for own, other in zip(runs["bayesid"], runs[name], strict=True)
                ]
                entry[f"{name}_over_bayesid"] = [min(pairs), statistics.median(pairs), max(pairs)]
        if runs["figaroh"]:
            entry["memory_share"] = entry["bayesid"]["peak_mb"] / entry["figaroh"]["peak_mb"]
        result[kind] = entry
        print(f"{kind}, {samples} samples: {json.dumps(entry, indent=1)}", flush=True)
    return result


def _median(runs: list[dict]) -> dict:
    keys = [k for k in ("us_per_sample", "peak_mb") if k in runs[0]]
    return {k: statistics.median(r[k] for r in runs) for k in keys}


def scaling(urdf: Path, folder: Path, sizes: list[int]) -> list[dict]:
    """Time and memory of bayesid over the number of samples."""
    out = []
    for samples in sizes:
        table = folder / f"{samples}.npz"
        if not table.exists():
            call(sys.executable, "make_table.py", str(table), "--urdf", str(urdf), "--samples", str(samples))
        for kind in ("wrench", "torque"):
            run = call(sys.executable, "bayesid_pipeline.py", str(urdf), str(table), "--kind", kind)
            out.append({k: run[k] for k in ("kind", "samples", "us_per_sample", "peak_mb", "total_s")})
            print(out[-1], flush=True)
        table.unlink()
    return out


def page(result: dict) -> str:
    """The results as a page of the documentation."""
    lines = [
        "# Speed and memory",
        "",
        "Raw table to base parameters with standard deviations: UR5, 0.1 Hz Fourier motion, 125 Hz, encoder counts of",
        f"2e-5 rad. Python {result['python']}, {result['cores']} cores, one thread in linear algebra; medians over processes",
        "that took turns. `python tests/benchmarks/run.py --write` (`make bench` without writing) makes this page. FIGAROH 1.0.2",
        "does the same steps (filter, regressor with free-flyer root for the wrench, double QR, least squares, its standard",
        "deviations); the bare loop only fills Pinocchio's regressor for every sample.",
        "",
        "| 100,000 samples | bayesid | FIGAROH | ratio | bare Pinocchio loop | ratio | memory beyond table | of FIGAROH's |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for kind, entry in result["comparison"].items():
        own, loop = entry["bayesid"], entry["pinocchio"]
        peer = entry.get("figaroh")
        lines.append(
            f"| {kind} | {own['us_per_sample']:.2f} us | "
            + (f"{peer['us_per_sample']:.1f} us | {entry['figaroh_over_bayesid'][1]:.1f}" if peer else "- | -")
            + f" | {loop['us_per_sample']:.2f} us | {entry['pinocchio_over_bayesid'][1]:.2f} | {own['peak_mb']:.0f} MB | "
            + (f"{100 * entry['memory_share']:.1f} % |" if peer else "- |")
        )
    lines += ["", "| samples | readings | us a sample | seconds | memory beyond the table |", "|---|---|---|---|---|"]
    for row in result["scaling"]:
        numbers = f"{row['us_per_sample']:.2f} | {row['total_s']:.2f} | {row['peak_mb']:.0f} MB"
        lines.append(f"| {row['samples']:,} | {row['kind']} | {numbers} |")
    return "\n".join([*lines, ""])


def main() -> None:
    """Run all; ``--quick`` leaves out the two largest sizes."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--write", action="store_true", help="write docs/studies/benchmarks/results.json")
    options = parser.parse_args()
    if not FIGAROH.exists():
        print("FIGAROH is not installed (make bench does that); measuring without it")
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        urdf = folder / "ur5.urdf"
        urdf.write_text(ur5(), encoding="utf-8")
        sizes = [10_000, 100_000] + ([] if options.quick else [1_000_000, 10_000_000])
        result = {
            "python": platform.python_version(),
            "cores": os.cpu_count(),
            "comparison": compare(urdf, folder, 100_000, options.repeats),
            "scaling": scaling(urdf, folder, sizes),
        }
    if options.write:
        (STUDY / "results.json").write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
        (STUDY / "README.md").write_text(page(result), encoding="utf-8")


if __name__ == "__main__":
    main()
