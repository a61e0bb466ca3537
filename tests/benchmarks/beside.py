"""python tests/benchmarks/beside.py [--write]: bayesid, FIGAROH and thirty lines of least squares on the same recordings.

The base wrench of a UR5 whose truth is known, made by Pinocchio (make_table.py). FIGAROH runs with the interpreter of
``.venv-figaroh`` (``make bench`` makes it). ``--write`` renews docs/studies/other-tools.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from scipy.linalg import qr
from scipy.signal import butter, filtfilt

sys.path.insert(0, str(Path(__file__).resolve().parent))
sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import bayesid
from tests.benchmarks.make_table import make_table, one_period
from tests.benchmarks.run import FIGAROH, call
from tests.robots import ur5
from tests.studies.page import STUDIES, fill, table, write_numbers

SAMPLES, RECORDINGS, LATE, COARSE, FINE, FILTER = 2500, 10, 2, 1e-3, 2e-5, 10.0
CASES = ("complete", "filtered", "coarse", "late")
TOOLS = {"bayesid": "bayesid", "figaroh": "FIGAROH 1.0.2", "plain": "thirty lines"}
STUDY = STUDIES / "other-tools"


def recorded(urdf: Path, case: str, seed: int) -> dict[str, np.ndarray]:
    """One recording of a case: t, q, w."""
    found = make_table(urdf, SAMPLES, seed)
    if case == "coarse":
        found["q"] = np.round(found["q"] / COARSE) * COARSE
    if case == "filtered":
        b, a = butter(2, FILTER / (125.0 / 2))
        found["w"] = filtfilt(b, a, found["w"], axis=0)
    if case == "late":
        found = {key: (x[:-LATE] if key in ("w", "tau") else x[LATE:]) for key, x in found.items()}
    return found


def plain(urdf: Path, data: dict[str, np.ndarray]) -> dict[str, float]:
    """What everybody writes: low-pass, differences, Pinocchio's regressor, QR, least squares, white-noise deviations."""
    start = time.perf_counter()
    model = pin.buildModelFromUrdf(str(urdf), pin.JointModelFreeFlyer())
    other = model.createData()
    b, a = butter(4, 5.0 / (125.0 / 2))
    q = filtfilt(b, a, data["q"], axis=0)
    v = np.gradient(q, data["t"], axis=0)
    acc = np.gradient(v, data["t"], axis=0)
    pose, still, inner = pin.neutral(model)[:7], np.zeros(6), range(125, len(q) - 125)
    rows = [
        pin.computeJointTorqueRegressor(model, other, np.r_[pose, q[k]], np.r_[still, v[k]], np.r_[still, acc[k]])[:6].copy()
        for k in inner
    ]
    matrix, target = np.concatenate(rows), data["w"][inner].ravel()
    _, r, order = qr(matrix, mode="economic", pivoting=True)
    rank = int((np.abs(np.diag(r)) > 1e-6 * abs(r[0, 0])).sum())
    kept, rest = order[:rank], order[rank:]
    combine = np.linalg.solve(r[:rank, :rank], r[:rank, rank:])
    base = matrix[:, kept]
    estimate = np.linalg.lstsq(base, target, rcond=None)[0]
    residual = target - base @ estimate
    std = np.sqrt(residual @ residual / (len(target) - rank) * np.diag(np.linalg.inv(base.T @ base)))
    seconds = time.perf_counter() - start
    links = np.concatenate([inertia.toDynamicParameters() for inertia in list(model.inertias)[1:]])
    truth = links[kept] + combine @ links[rest]
    return {**_judged(estimate, std, truth), "seconds": seconds, "error": _rms(base @ (estimate - truth))}


def ours(urdf: Path, data: dict[str, np.ndarray], case: str, seed: int) -> dict[str, float]:
    """``bayesid.identify`` at its defaults, and whether ``diagnose`` names what is missing and nothing else."""
    motion = bayesid.Motion("first", "identification", bayesid.Table(data["t"], data["q"], wrench=data["w"]))
    robot = bayesid.load_robot(urdf)
    counts = COARSE if case == "coarse" else FINE
    arm = bayesid.Experiment("ur5", robot, (motion,), bayesid.Sensor(), position_resolution=counts)
    start = time.perf_counter()
    result = bayesid.identify(arm, progress=None)
    seconds = time.perf_counter() - start
    truth = result.base.matrix @ robot.nominal.ravel()
    r = len(truth)
    found = [f.term.effect.spec for f in bayesid.diagnose(arm, progress=None).found]
    named = float(found == (["sensor_delay@sensor"] if case == "late" else []))
    judged = _judged(result.values[:r], result.std[:r], truth)
    return {**judged, "seconds": seconds, "error": _rms(_predicted(urdf, result, seed)), "named": named}


def _predicted(urdf: Path, result: bayesid.Identification, seed: int) -> np.ndarray:
    """Predicted less true wrench, without noise, along the fitted motion (N, 6)."""
    model = pin.buildModelFromUrdf(str(urdf), pin.JointModelFreeFlyer())
    data, pose, still = model.createData(), pin.neutral(model)[:7], np.zeros(6)
    q, v, acc = one_period(pin.buildModelFromUrdf(str(urdf)), np.random.default_rng(seed))
    pairs = zip(q, v, acc, strict=True)
    true = [pin.rnea(model, data, np.r_[pose, x], np.r_[still, y], np.r_[still, z])[:6].copy() for x, y, z in pairs]
    return result.predict(q, v, acc).values - np.array(true)


def figaroh(urdf: Path, path: Path) -> dict[str, float]:
    """FIGAROH's estimate of the table, as figaroh_pipeline.py makes it."""
    run = call(FIGAROH, "figaroh_pipeline.py", str(urdf), str(path))
    return {
        "z": run["z_rms"], "inside": run["inside"], "parameters": run["base_parameters"], "seconds": run["total"],
        "error": run["difference_from_urdf_rms"],
    }  # fmt: skip


def _judged(estimate: np.ndarray, std: np.ndarray, truth: np.ndarray) -> dict[str, float]:
    z = (estimate - truth) / std
    return {"z": _rms(z), "inside": float(np.mean(np.abs(z) < 1.96)), "parameters": float(len(z))}


def _rms(x: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(x))))


def packages(name: str, python: Path | str = sys.executable) -> int:
    """How many packages an installation brings along: what it needs, and what that needs."""
    code = (
        "import re, sys\nfrom importlib.metadata import requires, PackageNotFoundError\n"
        "from packaging.requirements import Requirement\nseen, ask = set(), [sys.argv[1]]\n"
        "while ask:\n    name = re.sub('[-_.]+', '-', ask.pop()).lower()\n    if name in seen: continue\n"
        "    try: needed = requires(name) or []\n    except PackageNotFoundError: continue\n    seen.add(name)\n"
        "    parts = map(Requirement, needed)\n"
        "    ask += [p.name for p in parts if p.marker is None or p.marker.evaluate({'extra': ''})]\nprint(len(seen) - 1)"
    )
    done = subprocess.run([str(python), "-c", code, name], capture_output=True, text=True, check=True)
    return int(done.stdout)


def _summary(runs: list[dict[str, float]]) -> dict[str, float]:
    """Means over recordings; of seconds the median."""
    return {key: float((np.median if key == "seconds" else np.mean)([run[key] for run in runs])) for key in runs[0]}


def page(result: dict[str, Any]) -> None:
    """Write the numbers, and fill them into the page."""
    rounded = write_numbers(result, STUDY / "results.json", 4)
    parts = {"ours": str(rounded["needs"]["bayesid"]), "figaroh": str(rounded["needs"]["figaroh"])}
    for case, tools in rounded["cases"].items():
        rows = []
        for name, m in tools.items():
            named = f"{m['named'] * RECORDINGS:.0f} of {RECORDINGS}" if "named" in m else "–"
            numbers = f"{m['error']:.3f} | {m['z']:.2f} | {100 * m['inside']:.0f} % | {named} | {m['seconds']:.2f} s"
            rows.append(f"| {TOOLS[name]} | {m['parameters']:.0f} | {numbers} |")
        parts[case] = table("tool | base parameters | error [N, N m] | z | inside | diagnosis | time", rows)
    path = STUDY / "README.md"
    path.write_text(fill(path.read_text(encoding="utf-8"), parts), encoding="utf-8")


def main() -> None:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", action="store_true", help="write docs/studies/other-tools")
    parser.add_argument("--recordings", type=int, default=RECORDINGS)
    options = parser.parse_args()
    cases: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as name:
        urdf, path = Path(name) / "robot.urdf", Path(name) / "table.npz"
        urdf.write_text(ur5(), encoding="utf-8")
        ours(urdf, recorded(urdf, "complete", 0), "complete", 0)  # compiled kernels are loaded from their cache
        for case in CASES:
            runs: dict[str, list[dict[str, float]]] = {tool: [] for tool in TOOLS}
            for seed in range(options.recordings):
                data = recorded(urdf, case, seed)
                np.savez(path, **data)
                runs["bayesid"].append(ours(urdf, data, case, seed))
                runs["plain"].append(plain(urdf, data))
                if FIGAROH.exists():
                    runs["figaroh"].append(figaroh(urdf, path))
            cases[case] = {tool: _summary(each) for tool, each in runs.items() if each}
            print(case, json.dumps(cases[case], indent=1), flush=True)
    needs = {"bayesid": packages("bayesid"), "figaroh": packages("figaroh", FIGAROH) if FIGAROH.exists() else None}
    if options.write:
        page({"cases": cases, "needs": needs})


if __name__ == "__main__":
    main()
