"""How often what no effect of the library explains is described by a draft, and whether one is given where nothing is hidden.

    python case_studies/blind_naming/described.py SET [--only-count] [--write]

A SET is what ``make.py --kinds none,unlisted`` wrote. Results go to SET/described; those that are there are not made again. A
case with nothing hidden is asked twice: as a user would, and with the verdict passed over, so that the search has to refrain.
``--write`` puts described.json beside this script and the table into README.md.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

HERE = Path(__file__).parent
BEGIN, END = "<!-- described -->", "<!-- end of described -->"


def one(folder: Path) -> dict[str, Any]:
    """What is hidden in one case and what the diagnosis says of it."""
    from bayesid import diagnose
    from bayesid.diagnosis.description.describe import describe

    answer = json.loads((folder.parent / "answers" / f"{folder.name}.json").read_text())
    result = diagnose(folder, answer["channel"])
    found = result.description
    hidden = [*answer["hidden_unlisted"], *answer["effects"]]
    out: dict[str, Any] = {
        "case": answer["case"], "kind": answer["kind"], "level": answer["level"], "robot": answer["robot"],
        "channel": answer["channel"], "hidden": [f"{e['name']}@{e['where']}" for e in hidden], "verdict": result.verdict,
        "draft": None if found is None else result.to_dict()["description"]["formulas"],
        "seconds": result.seconds,
    }  # fmt: skip
    if not hidden:
        base = result.search.base
        out["draft_whatever_the_verdict"] = describe(base, [base], result.search.library) is not None
    elif found is not None and found.gap is not None and result.gap is not None:
        # The floor of the user's model: that of a draft whose amplitudes are vague is higher.
        lowest = float(min(result.gap.floor, found.gap.floor))
        before, after, floor = result.gap.before**2, found.gap.after**2, lowest**2
        out |= {"closed": float((before - after) / (before - min(floor, after))), "before": float(result.gap.before),
                "after": float(found.gap.after), "floor": lowest}  # fmt: skip
    return out


def table(cases: list[dict[str, Any]]) -> list[str]:
    """Lines of Markdown: one a case, and the two counts."""
    unlisted = [c for c in cases if c["kind"] == "unlisted"]
    clean = [c for c in cases if c["kind"] == "none"]
    half = sum(c.get("closed", 0.0) >= 0.5 for c in unlisted)
    asked = sum(c["draft"] is not None for c in clean)
    forced = sum(c["draft_whatever_the_verdict"] for c in clean)
    typical = 100 * np.median([c["closed"] for c in unlisted if c.get("closed", 0.0) >= 0.5] or [0.0])
    lines = [
        f"- Unlisted effects: {half} of {len(unlisted)} described by a draft that closes at least half of the gap on unseen "
        f"motions (median of what those close: {typical:.0f} %).",
        f"- Nothing hidden: a draft for {asked} of {len(clean)}; with the verdict passed over, for {forced}.",
        "",
        "| hidden | size | arm, channel | verdict | draft | gap on unseen motions | closed |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for c in unlisted:
        draft = "none"
        if c["draft"]:
            reading, text = next(iter(c["draft"].items()))
            more = f" and {len(c['draft']) - 1} more axes" if len(c["draft"]) > 1 else ""
            draft = f"`{reading} + {text}`{more}"
        gap = f"{c['before']:.2f} → {c['after']:.2f} (floor {c['floor']:.2f})" if "closed" in c else ""
        share = f"{100 * c['closed']:.0f} %" if "closed" in c else ""
        row = (", ".join(c["hidden"]), c["level"], f"{c['robot']}, {c['channel']}", c["verdict"], draft, gap, share)
        lines.append(f"| {' | '.join(row)} |")
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("set", type=Path, metavar="SET")
    parser.add_argument("--only-count", action="store_true", help="make no diagnoses, count those that are there")
    parser.add_argument("--write", action="store_true", help="renew described.json and README.md's table")
    options = parser.parse_args()
    kept = options.set / "described"
    kept.mkdir(exist_ok=True)
    for toml in tqdm(sorted(options.set.glob("*/experiment.toml")), unit="case", disable=None):
        target = kept / f"{toml.parent.name}.json"
        if not target.exists() and not options.only_count:
            target.write_text(json.dumps(one(toml.parent), allow_nan=False), encoding="utf-8")
    cases = [json.loads(path.read_text()) for path in sorted(kept.glob("*.json"))]
    lines = table(cases)
    print("\n".join(lines))
    if options.write:
        (HERE / "described.json").write_text(json.dumps(cases, indent=1) + "\n", encoding="utf-8")
        readme = HERE / "README.md"
        before, rest = readme.read_text(encoding="utf-8").split(BEGIN)
        text = before + BEGIN + "\n" + "\n".join(lines) + "\n" + END + rest.split(END)[1]
        readme.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
