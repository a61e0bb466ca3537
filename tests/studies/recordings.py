"""What bayesid makes of every recording at hand: one table of estimates and diagnoses, before and after a change.

Run from the root of the repository, with the recordings where ``BAYESID_DATA`` says (default ``../shared``)::

    python -m tests.studies.recordings --out after.json [--against before.json] [--only NAME] [--skip-diagnosis]

Prints a row a recording: base parameters, error on unseen motions, residual over the noise, total mass, verdict of the
diagnosis, gap and processor time; with ``--against``, where a figure differs from an earlier run.
"""

from __future__ import annotations

import argparse
import json
import os
import time
import warnings
from pathlib import Path
from typing import Any

import bayesid

DATA = Path(os.environ.get("BAYESID_DATA", "../shared"))
#: Figures closer than this, relatively, are the same.
SAME = 1e-6


def folders() -> dict[str, Path]:
    """Experiment folders by name: real robots first, then simulated ones."""
    found = sorted((DATA / "data").rglob("experiment.toml")) + sorted((DATA / "practice").rglob("experiment.toml"))
    return {"/".join(path.parent.relative_to(DATA).parts[1:]): path.parent for path in found}


def figures(folder: Path, diagnosis: bool, seed: int = 0) -> dict[str, Any]:
    """Figures of one recording: default estimate, total mass, `gls` and `sdp` beside it, and the diagnosis."""
    out: dict[str, Any] = {}
    experiment = bayesid.load_experiment(folder)
    for method in (bayesid.DEFAULT_METHOD, "gls", "sdp"):
        since = time.process_time()
        try:
            result = bayesid.identify(experiment, method=method)
        except bayesid.BayesidError as error:
            out[method] = {"error": str(error)}
            continue
        shown = result.to_dict()
        out[method] = {
            "rank": result.base.rank,
            "values": [float(x) for x in result.values],
            "unseen": {v["motion"]: {k: v[k] for k in ("nrmse", "whitened_rms")} for v in shown["validation"]},
            "fit": {v["motion"]: v["whitened_rms"] for v in shown["fit"]},
            "mass": float(sum(shown["link_parameters"][::10])),
            "physical": shown["physically_consistent"],
            "seconds": time.process_time() - since,
        }
    if diagnosis:
        since = time.process_time()
        try:
            shown = bayesid.diagnose(experiment, seed=seed).to_dict()
        except bayesid.BayesidError as error:
            out["diagnosis"] = {"error": str(error)}
            return out
        out["diagnosis"] = {
            "verdict": shown["verdict"],
            "effects": [(e["name"], e["where"], e["parameters"]) for e in shown["effects"]],
            "gap": None if shown["gap"] is None else {k: shown["gap"][k] for k in ("before", "after", "floor")},
            "seconds": time.process_time() - since,
        }
    return out


def row(name: str, found: dict[str, Any]) -> str:
    """One line of the table."""
    parts = [f"{name:<22}"]
    for method in (bayesid.DEFAULT_METHOD, "gls", "sdp"):
        f = found[method]
        if "error" in f:
            parts.append(f"{method}: {f['error'][:40]}")
            continue
        worst = max((u["whitened_rms"] for u in f["unseen"].values()), default=float("nan"))
        parts.append(f"{method} r={f['rank']} {f['mass']:.3g} kg unseen {worst:.3g} x noise")
    if "diagnosis" in found:
        d = {"verdict": "refused", "effects": [], "gap": None, "seconds": 0.0} | found["diagnosis"]
        named = ", ".join(f"{name}@{where}" for name, where, _ in d["effects"]) or "-"
        gap = "" if d["gap"] is None else f" {d['gap']['before']:.3g} -> {d['gap']['after']:.3g} / {d['gap']['floor']:.3g}"
        parts.append(f"{d['verdict']}: {named}{gap} ({d['seconds']:.3g} s)")
    return " | ".join(parts)


def differences(before: Any, after: Any, at: str = "") -> list[str]:
    """Where two sets of figures differ, run times apart."""
    if isinstance(before, dict) and isinstance(after, dict):
        keys = [k for k in {**before, **after} if k != "seconds"]
        return [line for k in keys for line in differences(before.get(k), after.get(k), f"{at}.{k}")]
    if isinstance(before, list) and isinstance(after, list) and len(before) == len(after):
        return [line for k, (b, a) in enumerate(zip(before, after, strict=True)) for line in differences(b, a, f"{at}[{k}]")]
    if isinstance(before, float) and isinstance(after, float):
        return [] if abs(before - after) <= SAME * max(abs(before), abs(after), 1e-9) else [f"{at}: {before:.6g} -> {after:.6g}"]
    return [] if before == after else [f"{at}: {before} -> {after}"]


def main() -> None:
    """Run every recording, print the table, write the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--against", type=Path)
    parser.add_argument("--only")
    parser.add_argument("--skip-diagnosis", action="store_true")
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    before = json.loads(options.against.read_text()) if options.against else {}
    found: dict[str, Any] = {}
    for name, folder in folders().items():
        if options.only and options.only not in name:
            continue
        found[name] = json.loads(json.dumps(figures(folder, not options.skip_diagnosis)))
        print(row(name, found[name]), flush=True)
        for line in differences(before[name], found[name]) if name in before else []:
            print(f"    {line}", flush=True)
        options.out.write_text(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
