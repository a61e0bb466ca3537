"""What `diagnose` names on real recordings: with the model's friction left out, and with it.

    python -m tests.studies.named_in_part [--only NAME] [--state FILE] [--write]

Recordings are where ``BAYESID_DATA`` says (default ``../shared``). Every diagnosis is kept in the state file as soon as it is
made, and none is made twice. ``--write`` makes docs/named-in-part.md and .json.

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

import bayesid
from bayesid.recordings.experiment import Experiment, load_experiment
from tests.studies.page import DOCS, table, write_numbers, write_page
from tests.studies.real_robots import DATA, FRICTION, Case, thirty_lines

#: Folder, and what is left out of its model: everything, or nothing.
CASES = (
    ("kuka-lwr4", True), ("ur10", True), ("ur10e/before", True), ("ur10e/feb05-20s-12h", True), ("tx40", True),
    ("ur10e/before", False), ("ur10e/feb05-20s-12h", False), ("ur10e/after-load", False), ("tx40", False),
)  # fmt: skip
#: Joints whose friction is named count by any of these.
KINDS = (
    "coulomb_friction", "viscous_friction", "stribeck_friction", "load_friction", "dahl_friction", "posture_friction",
    "directional_friction",
)  # fmt: skip
#: Share of a single motion that least squares fits.
_FITTED = 0.6


def diagnosed(folder: str, bare: bool) -> dict[str, Any]:
    """One diagnosis in numbers."""
    since = time.process_time()
    d = bayesid.diagnose(DATA / folder, effects=[] if bare else None)
    seconds = time.process_time() - since
    said = d.to_dict()
    names = [f"{e['name']}@{e['where']}" for e in said["effects"]]
    experiment = load_experiment(DATA / folder)
    rigid, friction = (least_squares(experiment, effects) for effects in ((), FRICTION))
    return {
        "folder": folder, "bare": bare, "verdict": said["verdict"], "names": names, "joints": d.data.robot.n,
        "shares": [e["share"] for e in said["effects"]], "remainder": None if d.part is None else d.part.remainder,
        "where": list(dict.fromkeys(w["channel"] for w in (said["remainder"] or {}).get("where", ()))),
        "described_by": (said["remainder"] or {}).get("described_by"), "seconds": seconds,
        "least_squares": rigid, "least_squares_with_friction": friction,
    }  # fmt: skip


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
[real robots](real-robots.md). `diagnose` at its defaults, with all effects left out of the model and with those that the
recording's `experiment.toml` states. [How it decides](howto-diagnose.md#real-robots), [the method](method.md).

{{ cases }}

- **Closed**: share of the gap between the user's model and the noise on recordings held out in turn; every channel counts alike.
- **Friction at**: joints with at least one kind of friction named.
- **Least squares**: the thirty lines of [real robots](real-robots.md), error over signal below 10 Hz on the motion that was not
  fitted (of a single motion: on its last 40 %), of links alone, and with Coulomb, viscous and constant friction of every joint:
  by other means, how much friction there is to name.
- Processor time is that of the diagnosis, without its report.

## Everything that is named

{{ names }}
"""


def write(rows: list[dict[str, Any]], docs: Path) -> None:
    """The page and its numbers."""
    rows = write_numbers({"cases": rows}, docs / "named-in-part.json", 4)["cases"]
    percent = lambda x: "–" if x is None else f"{100 * x:.1f} %"  # noqa: E731
    lines, names = [], []
    for r in rows:
        joints = sorted({n.partition("@")[2].removeprefix("joint") for n in r["names"] if n.partition("@")[0] in KINDS})
        closed = None if r["remainder"] is None else 1.0 - r["remainder"]
        lines.append(
            f"| {r['folder']} | {'none' if r['bare'] else 'as stated'} | {r['verdict'].replace('_', ' ')} | {percent(closed)} "
            f"| {', '.join(joints) or '–'} of {r['joints']} | {', '.join(r['where']) or '–'} "
            f"| {percent(r['least_squares'])}, {percent(r['least_squares_with_friction'])} | {r['seconds']:.0f} s |"
        )
        each = [f"`{n}` {percent(s)}" for n, s in zip(r["names"], r["shares"], strict=True)]
        text = ", ".join(each) or "nothing"
        names.append(f"- {r['folder']}, effects {'none' if r['bare'] else 'as stated'}: {text}."
                     + (f" What stays goes with `{r['described_by']}`." if r["described_by"] else ""))  # fmt: skip
    head = "recording | effects in the model | verdict | closed | friction at joints | most of the rest in | least squares | time"
    write_page(PAGE, docs / "named-in-part.md", cases=table(head, lines), names="\n".join(names))


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
        write(sorted(rows, key=lambda r: CASES.index((r["folder"], r["bare"]))), DOCS)


if __name__ == "__main__":
    main()
