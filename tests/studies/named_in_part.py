"""What `diagnose` names on real recordings: with the model's friction left out, and with it.

    python -m tests.studies.named_in_part [--only NAME] [--state FILE] [--write]

Recordings are where ``BAYESID_DATA`` says (default ``../shared``). Every diagnosis is kept in the state file as soon as it is
made, and none is made twice. ``--write`` makes docs/studies/named-in-part.

Beside each diagnosis stands what least squares in thirty lines says of the same motions, without friction and with it.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import bayesid
from bayesid.recordings.experiment import Experiment, Motion, load_experiment
from tests.studies.page import STUDIES, table, write_numbers, write_page
from tests.studies.real_robots import DATA, FRICTION, Case, thirty_lines

#: Folder, and what is left out of its model: everything, or nothing.
CASES = (
    ("kuka-lwr4", True), ("ur10", True), ("ur10e/before", True), ("ur10e/feb05-20s-12h", True), ("tx40", True),
    ("tx40 of the joints", True),
    ("ur10e/before", False), ("ur10e/feb05-20s-12h", False), ("ur10e/feb06-20s-10h", False), ("ur10e/feb06-20s-5h", False),
    ("ur10e/after-load", False), ("tx40", False), ("tx40 of the joints", False),
)  # fmt: skip
#: Recordings that are made of another one.
WRIST = "tx40 of the joints"
OF_JOINTS = {WRIST: "tx40"}
#: Joints whose friction is named count by any of these.
KINDS = (
    "coulomb_friction", "viscous_friction", "stribeck_friction", "load_friction", "dahl_friction", "posture_friction",
    "directional_friction", "coupled_friction",
)  # fmt: skip
#: Share of a single motion that least squares fits.
_FITTED = 0.6


def diagnosed(folder: str, bare: bool) -> dict[str, Any]:
    """One diagnosis in numbers."""
    experiment = load_experiment(DATA / OF_JOINTS.get(folder, folder))
    if folder in OF_JOINTS:
        experiment = of_joints(experiment)
    since = time.process_time()
    d = bayesid.diagnose(experiment, effects=[] if bare else None)
    seconds = time.process_time() - since
    said = d.to_dict()
    names = [f"{e['name']}@{e['where']}" for e in said["effects"]]
    rigid, friction = (least_squares(experiment, effects) for effects in ((), FRICTION))
    return {
        "folder": folder, "bare": bare, "verdict": said["verdict"], "names": names, "joints": d.data.robot.n,
        "shares": [e["share"] for e in said["effects"]], "remainder": None if d.part is None else d.part.remainder,
        "where": list(dict.fromkeys(w["channel"] for w in (said["remainder"] or {}).get("where", ()))),
        "described_by": (said["remainder"] or {}).get("described_by"), "seconds": seconds,
        "groups": [] if d.part is None else [(g.channels, g.closed) for g in d.part.groups],
        "coupled": {
            e["where"]: {k: (v["value"], v["std"]) for k, v in e["parameters"].items()}
            for e in said["effects"] if e["name"] == "coupled_friction"
        },
        "least_squares": rigid, "least_squares_with_friction": friction,
    }  # fmt: skip


def of_joints(experiment: Experiment) -> Experiment:
    """TX40's recordings as of its joints: motor 6 turns with joint 5, so joint 6 is behind it and joint 5 takes what it gives.

    Its tables are of the motors. A controller that knows the coupling gives those of the joints; then links need no coupling, but
    what motor 6 loses acts on two joints.
    """

    def turned(motion: Motion) -> Motion:
        q, torques = motion.table.positions.copy(), np.array(motion.table.torques)
        q[:, 5] -= q[:, 4]
        torques[:, 4] += torques[:, 5]
        return replace(motion, table=replace(motion.table, positions=q, torques=torques, velocities=None))

    return replace(experiment, name="tx40-joints", motions=tuple(map(turned, experiment.motions)))


def wrist_errors() -> dict[str, list[float]]:
    """Error of joints 5 and 6 on the unseen motion, over the signal, by `identify` without and with coupled friction."""
    experiment = of_joints(load_experiment(DATA / OF_JOINTS[WRIST]))
    out = {}
    for name, more in (("without", ()), ("with", ("coupled_friction@joint5->joint6",))):
        (unseen,) = bayesid.identify(experiment, "torque", effects=(*experiment.effects, *more)).to_dict()["validation"]
        out[name] = [unseen["nrmse"][joint] for joint in ("tau5", "tau6")]
    return out


def least_squares(experiment: Experiment, effects: tuple[str, ...]) -> float:
    """Error on what was not fitted, over the signal, by thirty lines; of a single motion the last 40 % are not fitted."""
    case = Case("", experiment, effects)
    if case.unseen is None:
        motion = case.fitted
        cut = int(_FITTED * len(motion.table.times))
        parts = (("identification", slice(None, cut)), ("validation", slice(cut, None)))
        motions = tuple(
            replace(motion, name=role, role=role, table=replace(
                motion.table, times=motion.table.times[part], positions=motion.table.positions[part],
                torques=None if motion.table.torques is None else motion.table.torques[part], velocities=None, wrench=None,
            )) for role, part in parts
        )  # fmt: skip
        case = Case("", replace(experiment, motions=motions), effects)
    return thirty_lines(case)


PAGE = """# What is named on real robots

Written by `python -m tests.studies.named_in_part --write`; recordings with their sources stand in
[real robots](../real-robots/README.md). `diagnose` at its defaults, with all effects left out of the model and with those
that the
recording's `experiment.toml` states. [How it decides](../../howto/diagnose.md#real-robots),
[the method](../../explanation/method.md).

{{ cases }}

- **Closed**: share of the gap between the user's model and the noise on recordings held out in turn; every channel counts alike.
  Where friction that is stated is left out and sought anew, the gap is that of the model without it.
- **Friction at**: joints with at least one kind of friction named.
- **Least squares**: the thirty lines of [real robots](../real-robots/README.md), error over signal below 10 Hz on the
motion that was not
  fitted (of a single motion: on its last 40 %), of links alone, and with Coulomb, viscous and constant friction of every joint:
  by other means, how much friction there is to name.
- Processor time is that of the diagnosis, without its report.

## Everything that is named

{{ names }}

## A coupled wrist

In the TX40's wrist motor 6 turns with joint 5. Its tables are of the motors: friction and rotor of motor 6 are then those of
"joint 6", exactly, and what the coupling does to the light links of the wrist is lost in what stays ([with and without
it](../real-robots/README.md#tx40) unseen motions are predicted about alike). *tx40 of the joints* is the same recording as
a controller
gives it that knows the coupling, positions and torques of the joints. There friction joint by joint is wrong, and what motor 6
loses shows in joints 5 and 6.

{{ coupled }}

Published, by least squares with the coupling known [Nguyen2023](../../reference/references.md): viscous 0.616, Coulomb
1.95, rotor
inertia 0.00964. Predictions of the unseen motion's torques by `identify` are off by {{ without }} of the signal in joints 5 and 6
with friction joint by joint, by {{ with_it }} with `coupled_friction@joint5->joint6` in the model, too (published: 135 and 67 %,
26 and 31 %).
"""


def write(rows: list[dict[str, Any]], docs: Path) -> None:
    """The page and its numbers."""
    result = write_numbers({"cases": rows, "wrist": wrist_errors()}, docs / "results.json", 4)
    rows = result["cases"]

    def percent(x):
        return "–" if x is None else f"{100 * x:.1f} %"

    lines, names = [], []
    for r in rows:
        places = [n.partition("@")[2] for n in r["names"] if n.partition("@")[0] in KINDS]
        joints = sorted({one.removeprefix("joint") for place in places for one in place.split("->")})
        closed = None if r["remainder"] is None else 1.0 - r["remainder"]
        lines.append(
            f"| {r['folder']} | {'none' if r['bare'] else 'as stated'} | {r['verdict'].replace('_', ' ')} | {percent(closed)} "
            f"| {', '.join(joints) or '–'} of {r['joints']} | {', '.join(r['where']) or '–'} "
            f"| {percent(r['least_squares'])}, {percent(r['least_squares_with_friction'])} | {r['seconds']:.0f} s |"
        )
        each = [f"`{n}` {percent(s)}" for n, s in zip(r["names"], r["shares"], strict=True)]
        text = ", ".join(each) or "nothing"
        inside = "; ".join(f"{', '.join(channels)} {percent(closed)}" for channels, closed in r["groups"])
        if inside:
            text += f". In the channels that these act in they close: {inside}"
        names.append(f"- {r['folder']}, effects {'none' if r['bare'] else 'as stated'}: {text}."
                     + (f" What stays goes with `{r['described_by']}`." if r["described_by"] else ""))  # fmt: skip
    head = "recording | effects in the model | verdict | closed | friction at joints | most of the rest in | least squares | time"
    found = [(r, where, values) for r in rows for where, values in r["coupled"].items()]
    coupled = table(
        "recording | effects in the model | coupled friction | coupling | viscous [N m s/rad] | Coulomb [N m] | rotor [kg m²]",
        [
            f"| {r['folder']} | {'none' if r['bare'] else 'as stated'} | {where.replace('->', ' and ')} | "
            + " | ".join(f"{v:.3g} ± {1.96 * std:.2g}" for v, std in values.values()) + " |"
            for r, where, values in found
        ],
    )  # fmt: skip
    without, with_it = (" and ".join(map(percent, result["wrist"][k])) for k in ("without", "with"))
    write_page(
        PAGE, docs / "README.md", cases=table(head, lines), names="\n".join(names), coupled=coupled, without=without,
        with_it=with_it,
    )  # fmt: skip


def main() -> None:
    """Run the study, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="")
    parser.add_argument("--state", type=Path, default=Path(tempfile.gettempdir()) / "bayesid-named-in-part.jsonl")
    parser.add_argument("--write", action="store_true")
    given = parser.parse_args()
    rows = [json.loads(line) for line in given.state.read_text(encoding="utf-8").splitlines()] if given.state.exists() else []
    if rows:
        print(f"{len(rows)} diagnoses are taken from {given.state}; remove it to make them anew", flush=True)
    for folder, bare in CASES:
        if given.only not in folder or any(r["folder"] == folder and r["bare"] == bare for r in rows):
            continue
        row = diagnosed(folder, bare)
        print(row, flush=True)
        rows.append(row)
        with given.state.open("a", encoding="utf-8") as file:
            file.write(json.dumps(row, default=float) + "\n")
    if given.write:
        write(sorted(rows, key=lambda r: CASES.index((r["folder"], r["bare"]))), STUDIES / "named-in-part")


if __name__ == "__main__":
    main()
