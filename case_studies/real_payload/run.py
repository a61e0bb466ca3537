"""A real arm, a real payload: what nobody told the model about.

    python case_studies/real_payload/run.py [--data DIR] [--work DIR] [--out DIR]

``--data`` is a clone of github.com/shamilmamedov/dynamic_calibration, or `data/ur10e` with folders made from it (default: below
$BAYESID_DATA). Experiment folders are made in ``--work`` and kept there. Writes results.json, the figures and README.md with its
commands, tables and numbers filled in; it takes two or three minutes of processor time.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
from arm import AFTER, BEFORE, OTHER_DAY, SERIES, is_clone, prepare
from present import draw, fill, plain, tables
from scipy.signal import butter, sosfiltfilt

import bayesid

HERE = Path(__file__).parent
DATA = Path(os.environ.get("BAYESID_DATA", HERE.parents[2] / "shared")) / "data" / "ur10e"
#: Torques are compared below this frequency [Hz].
BAND = 10.0
SAMPLES = 100.0
#: How many samples a second figures show.
SHOWN = 10


class Shell:
    """Runs ``bayesid`` in a folder; keeps what is printed, and the processor time."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.printed, self.seconds = folder, {}, {}

    def __call__(self, name: str, command: str) -> None:
        """Run a command and keep what it prints under a name."""
        print(f"$ bayesid {command}", flush=True)
        path = os.pathsep.join([str(HERE.parents[1]), os.environ.get("PYTHONPATH", "")])
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        done = subprocess.run(
            [sys.executable, "-m", "bayesid", *command.split()], cwd=self.folder, env={**os.environ, "PYTHONPATH": path},
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        if done.returncode:
            raise RuntimeError(f"bayesid {command}: {done.stderr}")
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        self.printed[name] = f"$ bayesid {command}\n{done.stdout}"
        self.seconds[name] = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime

    def read(self, file: str) -> dict[str, Any]:
        """A JSON file that a command wrote."""
        return json.loads((self.folder / file).read_text(encoding="utf-8"))


def relative(error: np.ndarray, signal: np.ndarray) -> float:
    """Norm of the error over the norm of the signal, all joints together."""
    return float(np.sqrt(np.sum(error**2) / np.sum(signal**2)))


def unloaded(shell: Shell) -> dict[str, Any]:
    """What the unloaded recording says of the arm, and how well it predicts another day's motion."""
    shell("identify", "identify arm --out identified")
    estimate = shell.read("identified/estimate.json")
    (judged,) = bayesid.identify(shell.folder / "arm").validation
    friction: dict[str, dict[str, Any]] = {}
    for effect in estimate["effects"]:
        (value,) = effect["parameters"].values()
        friction.setdefault(effect["where"], {})[effect["name"]] = [value["value"], value["low"], value["high"]]
    return {
        "friction": friction, "base_parameters": len(estimate["base_parameters"]),
        "error": relative(judged.predicted - judged.measured, judged.measured),
    }  # fmt: skip


def payload(change: dict[str, Any]) -> dict[str, Any]:
    """Mass and centre of a payload of ``diagnosis.json`` or ``watch.json``, half 95 % intervals, and what stands beside it.

    Mass and first moment are taken for independent in the interval of the centre, which is too wide rather than too narrow.
    """
    values = {name: (v["value"], v["std"]) for name, v in change["parameters"].items()}
    mass, std = values["m"]
    moments, spreads = np.array([values[f"mc{axis}"] for axis in "xyz"]).T
    centre = moments / mass
    return {
        "mass": mass, "half": 1.96 * std, "centre": centre,
        "centre_half": 1.96 * np.hypot(spreads / mass, centre * std / mass), "evidence": change["log_bayes_factor"],
        "rival": change["next_best"], "share": change["share"], "share_low": change["share_low"],
    }  # fmt: skip


def simulated(folder: Path, effects: dict[str, dict[str, float]]) -> np.ndarray:
    """Torques of a folder's recording as its URDF and these effects make them [N m] (k, 6)."""
    torques = bayesid.simulate(folder, effects=effects).motions[0].table.torques
    if torques is None:
        raise RuntimeError(f"{folder} has no torques")
    return torques


def model_values(shell: Shell) -> dict[str, dict[str, float]]:
    """Effects of the ``model.toml`` that the comparison wrote."""
    values = tomllib.loads((shell.folder / "changed" / "model.toml").read_text(encoding="utf-8"))["model"]["values"]
    return {spec: {k: v for k, v in given.items() if k != "fixed"} for spec, given in values.items()}


def curves(shell: Shell) -> dict[str, Any]:
    """What the unloaded arm leaves of the loaded recording's torques, and what stays without the payload's torques [N m].

    The payload's torques are the difference of two simulations, in which links and noise are the same.
    """
    (judged,) = bayesid.identify(shell.folder / "surprise").validation
    folder = shell.folder / AFTER.name
    payloads = {spec: values for spec, values in model_values(shell).items() if spec.startswith("payload")}
    made = simulated(folder, payloads) - simulated(folder, {})
    times = bayesid.load_experiment(folder).motions[0].table.times
    before = judged.measured - judged.predicted
    after = before - np.column_stack([np.interp(judged.times, times, column) for column in made.T])
    every = round(SAMPLES / SHOWN)
    shaped = {"before": before, "after": after}
    return {
        "times": judged.times[::every], **{name: v[::every].T for name, v in shaped.items()},
        "rms": {name: np.sqrt(np.mean(v**2, axis=0)) for name, v in shaped.items()},
        "error": {name: relative(v, judged.measured) for name, v in shaped.items()},
    }  # fmt: skip


def changed(shell: Shell) -> dict[str, Any]:
    """The payload: without a reference, and with one."""
    shell("alone", f"diagnose {AFTER.name} --out alone")
    shell("changed", f"diagnose {AFTER.name} --reference {BEFORE.name} --out changed")
    alone, found = shell.read("alone/diagnosis.json"), shell.read("changed/diagnosis.json")
    named = [e for e in found["effects"] if e["name"] == "payload"]
    return {
        "alone": {"verdict": alone["verdict"], "effects": [f"{e['name']}@{e['where']}" for e in alone["effects"]]},
        "verdict": found["verdict"], "effects": [f"{e['name']}@{e['where']}" for e in found["effects"]],
        "payload": payload(named[0]) if named else None, "gap": found["gap"], "curves": curves(shell),
        "scores": [[f"{c['name']}@{c['where']}", c["log_bayes_factor"]] for c in found["candidates"][:8]],
    }  # fmt: skip


def series(shell: Shell, names: list[str]) -> dict[str, Any]:
    """Other days, one by one and all together."""
    shell("unchanged", f"diagnose {OTHER_DAY.name} --reference {BEFORE.name} --out unchanged")
    shell("watch", f"watch {BEFORE.name} {' '.join(names)} --out watched")
    quiet, watched = shell.read("unchanged/diagnosis.json"), shell.read("watched/watch.json")
    loaded = {r.name: r.loaded for r in SERIES}
    rows = []
    for w in watched["recordings"]:
        mine = [payload(e) for e in w["effects"] if e["name"] == "payload"]
        rows.append({
            "name": w["name"], "loaded": loaded[w["name"]], "verdict": w["verdict"], "gap": w["gap"], "left": w["gap_left"],
            "evidence": w["largest_log_evidence"], "effects": [f"{e['name']}@{e['where']}" for e in w["effects"]],
            "payload": mine[0] if mine else None,
        })  # fmt: skip
    hide = {f"{c['name']}@{c['where']}": c["minimum_detectable"] for c in quiet["candidates"] if c["name"] == "payload"}
    return {"needed": watched["log_evidence_needed"], "recordings": rows, "hide": hide}


def apart_from(one: dict[str, Any], other: dict[str, Any]) -> float:
    """Root mean square difference of two estimates' base parameters, in standard deviations of the difference."""
    pairs = list(zip(one["base_parameters"], other["base_parameters"], strict=True))
    if any(a["name"] != b["name"] for a, b in pairs):
        raise RuntimeError("the two estimates have other base parameters")
    return float(np.sqrt(np.mean([(a["value"] - b["value"]) ** 2 / (a["std"] ** 2 + b["std"] ** 2) for a, b in pairs])))


def used(shell: Shell, names: list[str]) -> dict[str, Any]:
    """The payload in other verbs: simulated torques beside recorded ones, and the loaded arm as the next reference."""
    again = next((r.name for r in SERIES if r.loaded and r.name in names and r != AFTER), None)
    recorded = again or AFTER.name
    folder = shell.folder / "tool"
    shutil.copytree(shell.folder / recorded, folder, dirs_exist_ok=True)
    shutil.copy(shell.folder / "identified" / "identified.urdf", folder / "robot.urdf")
    shell("identify_tool", "identify after --model changed/model.toml --out with-payload")
    shell("simulate", "simulate tool --model changed/model.toml --out simulated")
    reference, loaded = shell.read("identified/estimate.json"), bayesid.identify(shell.folder / AFTER.name).to_dict()
    apart = {"without": apart_from(reference, loaded), "with": apart_from(reference, shell.read("with-payload/estimate.json"))}
    bare = {spec: values for spec, values in model_values(shell).items() if "payload" not in spec}
    low = butter(2, BAND / (SAMPLES / 2.0), output="sos")
    tables = {"measured": recorded, "with": "simulated"}
    torques = {k: np.loadtxt(shell.folder / v / "motion.csv", delimiter=",", skiprows=1)[:, 7:] for k, v in tables.items()}
    filtered = {k: sosfiltfilt(low, v, axis=0) for k, v in {**torques, "without": simulated(folder, bare)}.items()}
    out: dict[str, Any] = {
        "error": {k: relative(filtered[k] - filtered["measured"], filtered["measured"]) for k in ("with", "without")},
        "apart": apart, "recording": recorded,
    }  # fmt: skip
    if again is not None:
        shell("again", f"diagnose {again} --reference {AFTER.name} --out again")
        found = shell.read("again/diagnosis.json")
        out["again"] = {"name": again, "verdict": found["verdict"], "gap": found["gap"]}
    return out


def study(work: Path, names: list[str]) -> dict[str, Any]:
    """All steps, in a folder with an experiment folder for each of these recordings."""
    shell = Shell(work)
    results = {
        "unloaded": unloaded(shell), "changed": changed(shell), "series": series(shell, names),
        "used": used(shell, names),
    }  # fmt: skip
    return {**results, "printed": shell.printed, "seconds": shell.seconds}


def main() -> None:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=DATA, help="the clone, or ready folders")
    parser.add_argument("--work", type=Path, help="where experiment folders are made and kept (default: a temporary folder)")
    parser.add_argument("--out", type=Path, default=HERE, help="folder for results.json, the figures and the filled README.md")
    options = parser.parse_args()
    if not options.data.is_dir():
        print(f"skipped: {options.data} not found; clone github.com/shamilmamedov/dynamic_calibration, name its folder by --data")
        return
    with tempfile.TemporaryDirectory() as folder:
        work = options.work or Path(folder)
        try:
            names = [r.name for r in prepare(options.data, work)]
        except FileNotFoundError as error:
            parser.error(f"--data {error}")
        results = plain({"clone": is_clone(options.data), **study(work, names)}, 5)
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "results.json").write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")
    draw(results, options.out)
    page = (HERE / "README.md").read_text(encoding="utf-8")
    (options.out / "README.md").write_text(fill(page, tables(results)), encoding="utf-8")


if __name__ == "__main__":
    main()
