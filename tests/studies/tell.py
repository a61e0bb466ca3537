"""Study: ambiguous diagnoses, the motion that each asks for, and whether that settles them as often as predicted.

``python -m tests.studies.tell --cases 50`` goes on where it stopped (``--state`` keeps a line a case, ``--seconds`` bounds the
processor time of one run); ``--write`` writes ``docs/studies/tell`` from what is there.

A case hides one effect in recordings of slow, short motions. Its size is changed until the diagnosis is ambiguous. Then the true
robot makes two more motions, one at a time: the one that the diagnosis asks for, and for the reliability of lower predictions a
worse one. All recordings together are diagnosed again. Settled means: one name is left, the true one.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

import bayesid
from bayesid.design.excitation.options import ExcitationOptions
from bayesid.design.excitation.plan import make_task
from bayesid.design.tell.choose import HOPELESS, NAME, SeenInstruments, checked, contest, pool
from bayesid.design.tell.rivals import from_search
from bayesid.diagnosis.verdict import evidence_of, verdict
from bayesid.errors import InputError
from bayesid.recordings.experiment import Experiment, Sensor
from bayesid.robot.robot import Robot, load_robot
from bayesid.simulation.simulation import Simulation, default_values, simulate
from bayesid.simulation.trajectories import Trajectory, fourier_trajectory
from bayesid.workflows.demo import PAPER_LOCKED, puma_two_joint_urdf
from tests.example_robots import puma560_urdf
from tests.studies.page import BLUE, GREY, STUDIES, STYLE, table, write_numbers, write_page

#: Seed of the cases that judge; development used others.
SEED = 20_270_301
WRENCH = (
    "base_tilt", "sensor_rotation", "sensor_delay", "sensor_translation", "sensor_gain", "sensor_crosstalk", "sensor_drift",
    "tether", "fluid_drag", "base_compliance", "spring", "external_contact", "encoder_offset", "payload", "inertia_error",
)  # fmt: skip
TORQUE = (
    "viscous_friction", "coulomb_friction", "stribeck_friction", "load_friction", "spring", "torque_gain", "torque_offset",
    "torque_ripple", "rotor_inertia", "tether", "fluid_drag", "base_tilt", "encoder_offset", "payload",
)  # fmt: skip
#: Parameters that say where or when, not how much: they are not scaled with the size.
PLACES = (
    "rest_length",
    "anchor",
    "point",
    "time",
    "start",
    "duration",
    "periods",
    "order",
    "phase",
    "damping",
    "velocity",
    "rest",
)
#: Verdicts that leave names alone.
NAMED = ("named", "named_in_part")
ATTEMPTS = 7
CASES = 50
BINS = np.array([0.0, 0.2, 0.4, 0.6, 0.8, 0.95, 1.0001])


@dataclass(frozen=True)
class Setup:
    """A robot and what of it is read."""

    joints: int
    channel: str


SETUPS = (Setup(2, "wrench"), Setup(3, "wrench"), Setup(2, "torque"))


def robot_of(setup: Setup, folder: Path) -> Robot:
    """The paper's two-joint arm, or the first three joints of a PUMA 560."""
    two = setup.joints == 2
    path = folder / f"robot{setup.joints}.urdf"
    path.write_text(puma_two_joint_urdf() if two else puma560_urdf(), encoding="utf-8")
    locked = PAPER_LOCKED if two else {f"joint{k}": 0.0 for k in (4, 5, 6)}
    return load_robot(path, [f"joint{k + 1}" for k in range(setup.joints)], locked)


def recorded(setup: Setup, robot: Robot, spec: str, size: float, seed: int, more: Sequence[Trajectory] = ()) -> Simulation:
    """What is recorded of slow, short motions with an effect of this share of its usual size; and of more motions."""
    rng = np.random.default_rng(seed)
    slow: dict[str, Any] = {
        "duration": 8.0,
        "fundamental": 0.125,
        "harmonics": 2,
        "rate": 100.0,
        "share": float(rng.uniform(0.1, 0.25)),
    }
    motions = [
        fourier_trajectory(robot, seed=seed, **slow),
        fourier_trajectory(robot, "validation", "validation", seed=seed + 1, **slow),
    ]
    sensor = Sensor() if setup.channel == "wrench" else None
    arm = Experiment("arm", robot, (), sensor, inertia_rel_std=0.05, position_resolution=1e-4)
    names = ("fx", "fy", "fz", "mx", "my", "mz", *(f"tau{k + 1}" for k in range(robot.n)))
    (effect,) = arm.library.parse([spec], robot.joint_names, names)
    values = {
        key: value if any(key.startswith(p) for p in PLACES) else value * size
        for key, value in default_values(effect, robot).items()
    }
    if effect.name == "base_compliance":  # a softer mount resonates lower
        values["resonance"] = default_values(effect, robot)["resonance"] / max(size, 0.1)
    # New motions come last, so that the old ones are recorded with the same noise.
    return simulate(arm, [*motions, *more], effects={effect.spec: values}, perturb=0.05, seed=seed)


def places(setup: Setup, robot: Robot) -> list[str]:
    """Every effect that may be hidden, at every place."""
    arm = Experiment("arm", robot, ())
    names = ("fx", "fy", "fz", "mx", "my", "mz") if setup.channel == "wrench" else tuple(f"tau{k + 1}" for k in range(robot.n))
    kinds = WRENCH if setup.channel == "wrench" else TORQUE
    return [e.spec for kind in kinds if kind in arm.library.classes for e in arm.library.places(kind, robot.joint_names, names)]


def one(index: int, seed: int) -> dict[str, Any]:
    """A case, from its number: the diagnosis, the motion, and what came of it; without ``after`` where none was ambiguous."""
    rng = np.random.default_rng([seed, index])
    setup = SETUPS[index % len(SETUPS)]
    out: dict[str, Any] = {"index": index, "robot": f"{setup.joints} joints, {setup.channel}"}
    with tempfile.TemporaryDirectory() as folder:
        robot = robot_of(setup, Path(folder))
        kinds: dict[str, list[str]] = {}
        for spec in places(setup, robot):
            kinds.setdefault(spec.partition("@")[0], []).append(spec)
        spec = str(rng.choice(kinds[str(rng.choice(list(kinds)))]))
        out["truth"] = spec
        size, low, high = float(np.exp(rng.uniform(np.log(0.02), np.log(0.3)))), 0.0, np.inf
        for _ in range(ATTEMPTS):
            number = int(rng.integers(2**31))
            try:
                simulation = recorded(setup, robot, spec, size, number)
                diagnosis = bayesid.diagnose(simulation)
            except InputError:
                break
            if diagnosis.verdict == "ambiguous":
                return out | after(setup, robot, spec, size, number, diagnosis, rng)
            if diagnosis.verdict == "nothing_missing":
                low, size = size, 3.0 * size if np.isinf(high) else float(np.sqrt(size * high))
            else:
                high, size = size, size / 3.0 if low == 0.0 else float(np.sqrt(low * size))
    return out


def after(
    setup: Setup, robot: Robot, spec: str, size: float, number: int, diagnosis: Any, rng: np.random.Generator
) -> dict[str, Any]:
    """What the proposed motion and a worse one lead to."""
    case, told = from_search(diagnosis.search), diagnosis.telling
    assert case is not None
    out = {
        "size": size,
        "rivals": list(told.rivals), "weights": list(told.weights), "motion": told.label,
        "hopeless": any(p.probability < HOPELESS for p in told.pairs if spec in (p.true, p.other)),
        "proposed": again(setup, robot, spec, size, number, told.trajectory) | {"predicted": told.probability},
    }  # fmt: skip
    bench, target = SeenInstruments.of(case.rivals[0].fit), float(rng.uniform(0.05, 0.95))
    length = float(rng.choice([2.5, 4.0, 8.0]))
    limits = make_task(diagnosis.data.experiment, ExcitationOptions())[0].limits
    worse = [(contest(case, bench, m).decided(case.weights)[0], m) for m in pool(limits, length, 16, int(rng.integers(2**31)))]
    motion = min(worse, key=lambda x: abs(x[0] - target))[1]
    predicted = checked(contest(case, bench, motion), case, bench, motion).decided(case.weights)[0]
    out["worse"] = again(setup, robot, spec, size, number, motion.trajectory(NAME, bench.rate)) | {"predicted": predicted}
    return out


def again(setup: Setup, robot: Robot, spec: str, size: float, number: int, motion: Trajectory) -> dict[str, Any]:
    """The diagnosis of the old recordings with a new one."""
    both = recorded(setup, robot, spec, size, number, [motion])
    found = bayesid.diagnose(replace(both, motions=both.motions))
    names = [f.term.effect.spec for f in found.found]
    left = [t.effect.spec for f in found.found for t, _ in f.rivals]
    reason = verdict(evidence_of(found.search, found.gap), found.data.settings)[1] if found.verdict == "unknown" else ""
    settled = found.verdict in NAMED and names == [spec]
    return {"verdict": found.verdict, "reason": reason, "found": names, "left": left, "settled": settled}


def run(state: Path, cases: int, seconds: float, seed: int) -> list[dict[str, Any]]:
    """Cases until so many were ambiguous, or so much processor time has passed; with those of earlier runs."""
    rows = [json.loads(line) for line in state.read_text(encoding="utf-8").splitlines()] if state.exists() else []
    index, since = len(rows), time.process_time()
    while sum("proposed" in r for r in rows) < cases and time.process_time() - since < seconds:
        row = one(index, seed)
        rows.append(row)
        with state.open("a", encoding="utf-8") as file:
            file.write(json.dumps(row, default=float) + "\n")
        print(index, row["truth"], row.get("proposed"), row.get("worse"), flush=True)
        index += 1
    return rows


def summarise(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """What the page shows."""
    ambiguous = [r for r in rows if "proposed" in r]
    among = [r for r in ambiguous if any(r["truth"] in names.split(", ") for names in r["rivals"])]
    other = [r for r in ambiguous if r not in among]
    bins, brier = reliability(among)
    settled = sum(r["proposed"]["settled"] for r in ambiguous)
    return {
        "seed": SEED, "tried": len(rows), "ambiguous": len(ambiguous), "among": len(among),
        "settled": settled, "interval": wilson(settled, len(ambiguous)),
        "settled_among": sum(r["proposed"]["settled"] for r in among),
        "settled_other": sum(r["proposed"]["settled"] for r in other),
        "wrong": sum(r["proposed"]["verdict"] in NAMED and not r["proposed"]["settled"] for r in ambiguous),
        "unknown": sum(r["proposed"]["verdict"] in ("unknown", "nothing_missing") for r in ambiguous),
        "expected": sum(r["proposed"]["predicted"] for r in among),
        "hopeless": sum(r["hopeless"] for r in ambiguous),
        "odds": sum(dict(zip(r["rivals"], r["weights"], strict=True)).get(r["truth"], 0.0) for r in among) / len(among),
        "odds_due": sum(float(np.sum(np.square(r["weights"]))) for r in among) / len(among),
        "brier": brier, "brier_all": reliability(ambiguous)[1], "bins": bins, "cases": ambiguous,
    }  # fmt: skip


def reliability(cases: list[dict[str, Any]]) -> tuple[list[dict[str, Any]], float]:
    """Predicted probabilities and shares settled in bins, and the mean squared error of the probability."""
    trials = [(r[key]["predicted"], r[key]["settled"]) for r in cases for key in ("proposed", "worse")]
    predicted, settled = (np.array(x, float) for x in zip(*trials, strict=True))
    bins = []
    for low, high in zip(BINS[:-1], BINS[1:], strict=True):
        here = (predicted >= low) & (predicted < high)
        if here.any():
            n, k = int(here.sum()), int(settled[here].sum())
            bins.append({"predicted": predicted[here].mean(), "settled": k, "count": n, "interval": wilson(k, n)})
    return bins, float(np.mean((predicted - settled) ** 2))


def wilson(successes: int, count: int) -> list[float]:
    """95 % interval of a share (Wilson 1927)."""
    z, p = 1.96, successes / count
    middle, half = p + z**2 / (2 * count), z * np.sqrt(p * (1 - p) / count + z**2 / (4 * count**2))
    return [float((middle - half) / (1 + z**2 / count)), float((middle + half) / (1 + z**2 / count))]


PAGE = """# The motion that settles an ambiguous diagnosis

Written by `python -m tests.studies.tell --write`. Simulated recordings of slow, short motions (8 s, a tenth to a quarter of the
speed limits) of a PUMA's first two or three joints, base wrench or joint torques, links 5 % off, one effect hidden whose size was
changed until `diagnose` said `ambiguous`. Then the true robot made the motion of `next_motion.csv`, and all recordings together
were diagnosed again. [How to diagnose](../../howto/diagnose.md) says how it is used,
[the method](../../explanation/method.md) how it works.

- Ambiguous diagnoses: {{ r.ambiguous }}, of {{ r.tried }} hidden effects tried{{ partial }}.
  The true effect was among the names in {{ r.among }}.
- **Settled by one motion: {{ r.settled }} of {{ r.ambiguous }}**: the true name alone was left (95 % interval of that share:
  {{ "%.0f" | format(100 * r.interval[0]) }} to {{ "%.0f" | format(100 * r.interval[1]) }} %).
  Where it was among the names: {{ r.settled_among }} of {{ r.among }}; predicted were {{ "%.1f" | format(r.expected) }}.
  Where it was not: {{ r.settled_other }} of {{ r.ambiguous - r.among }}.
- A wrong name alone was left in {{ r.wrong }}; nothing was named in {{ r.unknown }}; in the others several names stayed.
- No motion was predicted to tell the true effect from some rival in {{ r.hopeless }}.

## Is the predicted probability right?

With the proposed motions, of which most are predicted to decide, and as many worse ones, both checked by exact fits. The
probability is that of a verdict if one of the names is true; so, where the true effect is among the names:

{{ bins }}

Brier score {{ "%.3f" | format(r.brier) }} (0 is perfect, 0.25 a coin); over all cases, also those whose true effect
was not among the names, {{ "%.3f" | format(r.brier_all) }}.

A probability weights each name with its odds before the motion: the true name had {{ "%.2f" | format(r.odds) }} on average,
where right odds would have given it {{ "%.2f" | format(r.odds_due) }}.

![Share settled against predicted probability](tell.svg)

## Every case

{{ cases }}
"""


def write(rows: list[dict[str, Any]], docs: Path) -> None:
    """The page, its numbers and its figure."""
    result = write_numbers(summarise(rows), docs / "results.json", 4)
    bins = table(
        "predicted, mean | motions | settled | share | 95 % interval",
        [
            f"| {b['predicted']:.2f} | {b['count']} | {b['settled']} | {b['settled'] / b['count']:.2f} "
            f"| {b['interval'][0]:.2f} to {b['interval'][1]:.2f} |"
            for b in result["bins"]
        ],
    )
    cases = table(
        "robot | hidden | names | motion | predicted | afterwards",
        [
            f"| {c['robot']} | {c['truth']} | {'; '.join(c['rivals'])} | {c['motion']} | {c['proposed']['predicted']:.2f} "
            f"| {afterwards(c['proposed'])} |"
            for c in result["cases"]
        ],
    )
    partial = "" if result["ambiguous"] >= CASES else f" (a part of the {CASES} that are asked for; `--cases {CASES}` goes on)"
    write_page(PAGE, docs / "README.md", r=result, bins=bins, cases=cases, partial=partial)
    figure(result, docs / "tell.svg")


def afterwards(case: dict[str, Any]) -> str:
    """The verdict with the new motion, in words."""
    reason = f" ({case['reason']})" if case["reason"] else ""
    names = "; ".join([", ".join(case["found"]), *case["left"]]) if case["found"] else "nothing"
    return f"{case['verdict'].replace('_', ' ')}{reason}: {names}"


def figure(result: dict[str, Any], path: Path) -> None:
    """Reliability diagram."""
    import matplotlib.pyplot as plt

    with plt.style.context(STYLE), plt.rc_context({"svg.hashsalt": "tell"}):
        fig, ax = plt.subplots(figsize=(4.2, 3.6), layout="constrained")
        ax.plot([0, 1], [0, 1], color=GREY, lw=1, ls="--")
        for b in result["bins"]:
            share = b["settled"] / b["count"]
            low, high = b["interval"]
            ax.errorbar(b["predicted"], share, [[max(share - low, 0)], [max(high - share, 0)]], fmt="o", color=BLUE, capsize=3)
            ax.annotate(f" {b['count']}", (b["predicted"], share), color=GREY, va="top")
        ax.set(xlim=(-0.03, 1.03), ylim=(-0.03, 1.03), xlabel="predicted probability", ylabel="share settled")
        fig.savefig(path, metadata={"Date": None})
        plt.close(fig)


def main() -> None:
    """Run the study, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=CASES, help="ambiguous diagnoses")
    parser.add_argument("--seconds", type=float, default=np.inf, help="processor time of this run")
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--state", type=Path, default=Path(tempfile.gettempdir()) / "bayesid-tell.jsonl")
    parser.add_argument("--write", action="store_true", help="write docs/studies/tell")
    given = parser.parse_args()
    rows = run(given.state, given.cases, given.seconds, given.seed)
    if given.write:
        write(rows, STUDIES / "tell")
    else:
        print(json.dumps({k: v for k, v in summarise(rows).items() if k != "cases"}, indent=1, default=float))


if __name__ == "__main__":
    main()
