"""The exam: what bayesid makes of every recording that judges it, old beside new, with standard errors and seconds.

Run from the root of the repository, with the recordings where ``BAYESID_DATA`` says (default ``../shared``)::

    python tests/studies/exam.py KEPT [--parts data,practice] [--most N] [--only NAME] [--against OLDER] [--jobs 2]

KEPT is a folder: what was found of a case is kept there, and a case that is there is not run again, so that the exam can be
interrupted. ``--against`` names such a folder of another revision, to stand beside. An older revision is judged by the same
script: check it out elsewhere, put that folder on ``PYTHONPATH``, and run this file.

| part | cases | what is asked |
| --- | --- | --- |
| data | recordings of real robots, as stated and with friction | error on an unseen motion, what is named, what is closed |
| wild | public logs and oddities | the same; what is refused |
| practice | recordings of an independent engine, with answers | is what is hidden named |
| blind | 200 of this repository's own plant, made at the first call | is what is hidden named |
| pairs | a real arm before and after | is the payload named, and nothing else |
| coverage | recordings of an independent engine, with true links | do 95 % intervals hold the truth |

The recordings of ``coverage`` are several noise draws on a few motions. Beside the estimators stands one that knows what made
them, ``known``: positions averaged over the draws, readings as means over a sample's time, and the sensor's noise. How often its
intervals hold the truth is the luck of the draws.

``--most 6`` takes six cases of each part, evenly spaced: about ten minutes on two cores.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

import bayesid
from bayesid import estimators
from bayesid.regression.options import FitOptions
from bayesid.regression.problem import prepare
from bayesid.tasks import cluster, map_tasks

DATA = Path(os.environ.get("BAYESID_DATA", "../shared"))
BLIND = Path(__file__).resolve().parents[2] / "case_studies" / "blind_naming"
FRICTION = ("viscous_friction", "coulomb_friction", "torque_offset")
UNLOADED = ("before", "feb05-20s-12h", "feb05-20s-8h", "feb06-20s-10h", "feb06-20s-5h")
METHODS = ("ols", "wls", "gls", "tls", "iv", "huber", "student", "sdp")
#: Seed and number of the blind set: fresh ones for a change that was developed on these.
BLIND_SEED, BLIND_COUNT = 35, 200

#: A score: its value, standard error (None: of one number) and number of cases.
Score = tuple[float, float | None, int]


@dataclass(frozen=True)
class Case:
    """One question of the exam: a recording and what else the part needs."""

    part: str
    name: str
    folder: Path
    detail: str = ""


def experiments(part: str) -> list[Path]:
    """Experiment folders of a part, by name."""
    return sorted(path.parent for path in (DATA / part).rglob("experiment.toml"))


def cases(part: str, kept: Path) -> list[Case]:
    """The cases of a part; blind ones are made where they are not there yet."""
    root = DATA / part
    if part == "blind":
        root = kept.parent / f"blind-{BLIND_SEED}"
        sys.path.insert(0, str(BLIND))
        from make import SHARES, make

        make(root, BLIND_COUNT, BLIND_SEED, tuple(SHARES), resume=True)
        return [Case(part, path.stem, root / path.stem) for path in sorted((root / "answers").glob("*.json"))]
    if part == "practice":
        return [Case(part, path.stem, root / path.stem) for path in sorted((root / "answers").glob("*.json"))]
    if part == "coverage":
        return [Case(part, folder.name, folder) for folder in sorted(root.glob("run-*"))]
    if part == "pairs":
        arm = DATA / "data" / "ur10e"
        both = [(a, b) for a in UNLOADED for b in (*UNLOADED, "after-load") if a != b]
        return [Case(part, f"{a} against {b}", arm / b, str(arm / a)) for a, b in both if (arm / b).exists()]
    found = []
    for folder in experiments(part):
        name = "/".join(folder.relative_to(root).parts)
        found.append(Case(part, name, folder))
        text = (folder / "experiment.toml").read_text(encoding="utf-8")
        if part == "data" and "[sensor]" not in text and "effects" not in text:
            found.append(Case(part, f"{name}, friction stated", folder, ",".join(FRICTION)))
    return found


def of_recording(case: Case) -> dict[str, Any]:
    """Error on the unseen motions before and after a diagnosis, and what it says."""
    effects = case.detail.split(",") if case.detail else None
    out: dict[str, Any] = {}
    estimate = bayesid.identify(case.folder, effects=effects)
    out["unseen"] = [relative_error(v) for v in estimate.validation]
    out["times_noise"] = [float(v.whitened_rms) for v in estimate.validation]
    out["warnings"] = len(estimate.warnings)
    return out | of_diagnosis(bayesid.diagnose(case.folder, effects=effects).to_dict())


def relative_error(prediction: Any) -> float:
    """Norm of the error of all channels over that of the signal, in the band that predictions are shown in."""
    return float(np.linalg.norm(prediction.measured - prediction.predicted) / np.linalg.norm(prediction.measured))


def of_diagnosis(said: dict[str, Any]) -> dict[str, Any]:
    """Verdict, names and gap of a diagnosis."""
    gap = said["gap"] or {}
    return {
        "verdict": said["verdict"],
        "named": sorted(f"{e['name']}@{e['where']}" for e in said["effects"]),
        "gap": [gap.get(key) for key in ("before", "after", "floor")],
        "closed": gap.get("closed"),
    }


def of_answered(case: Case) -> dict[str, Any]:
    """The diagnosis of a case whose answer is known, in full: it is judged later."""
    answer = json.loads((case.folder.parent / "answers" / f"{case.name}.json").read_text(encoding="utf-8"))
    return {"answer": answer, "said": bayesid.diagnose(case.folder, answer["channel"]).to_dict()}


def of_pair(case: Case) -> dict[str, Any]:
    """What has changed since the reference."""
    said = bayesid.diagnose(case.folder, reference=Path(case.detail)).to_dict()
    masses = [e["parameters"]["m"] for e in said["effects"] if e["name"] == "payload" and e["where"] == "joint6"]
    return of_diagnosis(said) | {"loaded": case.folder.name == "after-load", "mass": masses[0] if masses else None}


def of_coverage(case: Case) -> dict[str, Any]:
    """Error, standard deviation and whether the interval holds the truth, estimator by estimator."""
    truth = json.loads((case.folder.parent / "truth.json").read_text(encoding="utf-8"))["runs"][case.name]["links"]
    links = np.concatenate([truth[key] for key in sorted(truth, key=lambda s: int(s.removeprefix("joint")))])
    table = bayesid.compare(case.folder, list(METHODS), "wrench")
    fits: dict[str, Any] = {entry.name: entry.estimate for entry in table.entries if entry.estimate is not None}
    fits["posterior"] = bayesid.sample(case.folder, channel="wrench", draws=1000, seed=1)
    fits["known"] = with_noise_known(case)
    out = {}
    for name, fit in fits.items():
        value, low, high = (np.asarray(getattr(fit, key)) for key in ("values", "low", "high"))
        true = fit.base.matrix @ links
        out[name] = {"z": ((value - true) / fit.std).tolist(), "held": ((low <= true) & (true <= high)).tolist()}
    return out


def with_noise_known(case: Case) -> Any:
    """Estimate from the readings of one recording, knowing all else: where the robot was, and how noisy the sensor is."""
    runs = json.loads((case.folder.parent / "truth.json").read_text(encoding="utf-8"))["runs"]
    same = [name for name, run in runs.items() if run["trajectory"] == runs[case.name]["trajectory"]]
    drawn = [bayesid.load_experiment(case.folder.parent / name).identification[0].table for name in same]
    own = bayesid.load_experiment(case.folder)
    (motion,) = own.identification
    # A mean over the time h between samples is the value and a 24th of h^2 times its second derivative.
    read = motion.table.wrench.copy()
    read[1:-1] -= np.diff(motion.table.wrench, n=2, axis=0) / 24.0
    table = replace(motion.table, positions=np.mean([t.positions for t in drawn], axis=0), wrench=read)
    problem = prepare(replace(own, motions=(replace(motion, table=table),)), FitOptions(channel="wrench"))
    std = np.repeat([own.sensor.force_std, own.sensor.torque_std], 3)
    return estimators.fit(replace(problem.regression, noise_std=std), "gls")


ASK: dict[str, Callable[[Case], dict[str, Any]]] = {
    "data": of_recording, "wild": of_recording, "practice": of_answered, "blind": of_answered, "pairs": of_pair,
    "coverage": of_coverage,
}  # fmt: skip


def asked(case: Case, kept: Path) -> dict[str, Any]:
    """What is found of a case, from the folder where it is kept or by asking; a refusal is an answer, too."""
    path = kept / case.part / f"{case.name.replace('/', '--')}.json"
    if path.exists():
        return json.loads(path.read_text(encoding="utf-8"))
    warnings.simplefilter("ignore")
    since = time.process_time()
    try:
        found = ASK[case.part](case)
    except bayesid.BayesidError as error:
        found = {"refused": str(error)}
    except Exception as error:  # a fault of one case is an answer, too, and must not cost the others
        found = {"refused": f"FAULT {error!r}"}
    found["seconds"] = time.process_time() - since
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_suffix(".part")
    part.write_text(json.dumps(found), encoding="utf-8")
    part.replace(path)
    return found


def percent(share: float, count: int) -> Score:
    """A share of so many cases, with its standard error: two right ones and two wrong ones added, so that it is never 0."""
    adjusted = (share * count + 2) / (count + 4)
    return 100 * share, 100 * float(np.sqrt(adjusted * (1 - adjusted) / (count + 4))), count


def scores(part: str, found: dict[str, dict[str, Any]]) -> dict[str, Score]:
    """The scores of a part from what was found of its cases."""
    told = {name: f for name, f in found.items() if "refused" not in f}
    out: dict[str, Score] = {}
    if len(told) < len(found):
        out["refused"] = (len(found) - len(told), None, len(found))
    if part in ("data", "wild"):
        for name, f in told.items():
            for error, noise in zip(f["unseen"][:1], f["times_noise"][:1], strict=True):
                out[f"{name}: error on an unseen motion [%]"] = (100 * error, None, 1)
                out[f"{name}: times the noise"] = (noise, None, 1)
            if f["closed"] is not None:
                out[f"{name}: closed by the diagnosis [%]"] = (100 * f["closed"], None, 1)
    elif part in ("practice", "blind") and told:
        sys.path.insert(0, str(BLIND))
        from judge import judge

        said = judge([(f["answer"], {"runtime_s": 0.0, **f["said"]}) for f in told.values()])
        rates = said["rates"] | {"95 % intervals of effects that hold the truth": said["coverage_95"] or (1.0, 0)}
        out |= {f"{key} [%]": percent(*rate) for key, rate in rates.items()}
    elif part == "pairs":
        payloads = ["payload@joint6" in f["named"] for f in told.values() if f["loaded"]]
        silent = [not f["named"] for f in told.values() if not f["loaded"]]
        for words, right in (("payload at joint 6 named [%]", payloads), ("nothing named without one [%]", silent)):
            if right:
                out[words] = percent(float(np.mean(right)), len(right))
    elif part == "coverage" and told:
        # A folder may hold cases of older revisions, which asked for fewer estimators.
        for name in [n for n in next(iter(told.values())) if n != "seconds" and all(n in f for f in told.values())]:
            held = np.array([f[name]["held"] for f in told.values()], float)
            z = np.array([f[name]["z"] for f in told.values()])
            by_run = held.mean(axis=1)
            out[f"{name}: coverage [%]"] = (100 * held.mean(), 100 * by_run.std(ddof=1) / np.sqrt(len(held)), held.size)
            out[f"{name}: largest bias / standard deviation"] = (float(np.abs(z.mean(axis=0)).max()), None, held.size)
            out[f"{name}: largest scatter / standard deviation"] = (float(z.std(axis=0, ddof=1).max()), None, held.size)
    seconds = np.array([f["seconds"] for f in found.values()])
    out["seconds a case, median"] = (float(np.median(seconds)), None, len(seconds))
    out["seconds a case, most"] = (float(seconds.max()), None, len(seconds))
    return out


def line(case: str, found: dict[str, Any]) -> str:
    """One case in words, for the parts that name something."""
    if "refused" in found:
        return f"{case}: refused: {found['refused'][:110]}"
    said = of_diagnosis(found["said"]) if "said" in found else found
    if "verdict" not in said:
        return ""
    hidden = ""
    if "answer" in found:
        answer = found["answer"]
        names = [f"{e['name']}@{e['where']}" for e in [*answer["effects"], *answer["hidden_unlisted"]]]
        hidden = f"  [{', '.join(names) or 'nothing hidden'}]"
    gap = " -> ".join("-" if g is None else f"{g:.3g}" for g in said["gap"][:2])
    return f"{case}: {said['verdict']} {', '.join(said['named']) or '-'} ({gap}){hidden}"


def shown(value: Score | None) -> str:
    """A score as text."""
    if value is None:
        return ""
    return f"{value[0]:.4g}" + ("" if value[1] is None else f" +- {value[1]:.2g} ({value[2]})")


def read(kept: Path, part: str, chosen: list[Case]) -> dict[str, dict[str, Any]]:
    """What is kept of these cases."""
    paths = {case.name: kept / part / f"{case.name.replace('/', '--')}.json" for case in chosen}
    return {name: json.loads(path.read_text(encoding="utf-8")) for name, path in paths.items() if path.exists()}


def main() -> None:
    """Ask, and print a table a part: old beside new."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kept", type=Path)
    parser.add_argument("--parts", default=",".join(ASK))
    parser.add_argument("--most", type=int, help="cases of each part, evenly spaced")
    parser.add_argument("--only", default="", help="cases whose name holds this")
    parser.add_argument("--against", type=Path, help="what another revision made of the same cases")
    parser.add_argument("--jobs", type=int, default=1)
    options = parser.parse_args()
    for part in options.parts.split(","):
        chosen = [case for case in cases(part, options.kept) if options.only in case.name]
        if options.most and options.most < len(chosen):
            chosen = [chosen[k] for k in np.linspace(0, len(chosen) - 1, options.most).round().astype(int)]
        if not chosen:
            print(f"{part}: no recordings in {DATA}")
            continue
        with cluster(options.jobs):
            work = map_tasks(partial(asked, kept=options.kept), chosen)
            found = dict(zip((c.name for c in chosen), tqdm(work, total=len(chosen), desc=part, disable=None), strict=True))
        older = {} if options.against is None else read(options.against, part, chosen)
        print(f"\n{part}: {len(found)} cases")
        for name, f in found.items():
            now, before = line(name, f), line(name, older[name]) if name in older else None
            if now:
                print(f"  {now}" + ("" if before in (None, now) else f"\n    older: {before}"))
        new, old = scores(part, found), scores(part, older) if older else {}
        for key in dict.fromkeys([*new, *old]):
            print(f"  {key:<78} {shown(new.get(key)):>22}" + (f"   older {shown(old.get(key)):>22}" if older else ""), flush=True)


if __name__ == "__main__":
    main()
