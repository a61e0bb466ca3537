"""Study: every ordered pair of the UR10e's recordings, before and after.

Run ``python -m tests.studies.before_after --write``, with the recordings where ``BAYESID_DATA`` says (default ``../shared``); it
writes ``docs/studies/before-after``.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from pathlib import Path

import bayesid

FOLDER = Path(__file__).parents[2] / "docs" / "studies" / "before-after"
UNLOADED = ("before", "feb05-20s-12h", "feb05-20s-8h", "feb06-20s-10h", "feb06-20s-5h")
LOADED = ("after-load",)
MASS = 2.805  # of the payload [kg], weighed
INTRODUCTION = """# Before and after on a real arm

A UR10e, motor currents times drive gains, recorded on several days, once with a payload of 2.805 kg at its flange: every
ordered pair with an unloaded reference, by `python -m tests.studies.before_after --write`.
[Before and after](../../howto/before-after.md) says how to do it, [the method](../../explanation/method.md) how it works.
The recordings have no
licence, so users fetch them themselves: github.com/shamilmamedov/dynamic_calibration.
"""


def pair(before: str, after: str) -> dict:
    """Figures of one pair."""
    folder = Path(os.environ.get("BAYESID_DATA", "../shared")) / "data" / "ur10e"
    since = time.process_time()
    found = bayesid.diagnose(folder / after, reference=folder / before)
    c = found.comparison
    best = c.scores[0]
    out = {
        "before": before, "after": after, "verdict": found.verdict, "changes": [x.change.spec for x in c.changes],
        "best": best[0].spec, "log_evidence": best[1], "gap": [c.errors.reference**0.5, c.errors.after**0.5],
        "seconds": time.process_time() - since,
    }  # fmt: skip
    for x in c.changes:
        if x.change.spec == "payload@joint6" and x.found.lead is not None:
            v = x.values[0]
            out |= {"mass": v.value, "std": v.std, "lead": x.found.lead[1], "rival": x.found.lead[0].spec, "share": x.share,
                    "share_low": x.share_low}  # fmt: skip
    return out


def study() -> list[dict]:
    """All ordered pairs with an unloaded reference."""
    return [pair(a, b) for a in UNLOADED for b in (*UNLOADED, *LOADED) if a != b]


def page(rows: list[dict]) -> str:
    """The page as Markdown."""
    loaded = [r for r in rows if r["after"] in LOADED]
    others = [r for r in rows if r["after"] not in LOADED]
    named = sum("payload@joint6" in r["changes"] for r in loaded)
    false = sum(bool(r["changes"]) for r in others)
    inside = sum(abs(r["mass"] - MASS) < 1.96 * r["std"] for r in loaded if "mass" in r)
    lead = min(r.get("lead", 0.0) for r in loaded)
    largest = max(r["log_evidence"] for r in others)
    times = [r["seconds"] for r in rows]
    lines = [
        *INTRODUCTION.splitlines(),
        "",
        f"- With the payload: named at joint 6 in {named} of {len(loaded)} pairs; the mass is in its 95 % interval in {inside}.",
        f"  The best rival at another place is at least {lead:.0f} behind in log evidence.",
        f"- Without: something is named in {false} of {len(others)} pairs.",
        f"  The largest log evidence is {largest:.1f}, where 12 is asked for.",
        f"- Processor time: {sum(times) / len(times):.1f} s a pair, at most {max(times):.1f} s.",
        "",
        *_head("reference", "payload [kg]", "± 95 %", "log evidence", "next best", "behind", "share of the gap, at least", "gap"),
    ]
    for r in loaded:
        if "mass" in r:
            cells = [f"{r['mass']:.3f}", f"{1.96 * r['std']:.3f}", f"{r['log_evidence']:.0f}", r["rival"], f"{r['lead']:.0f}"]
            lines.append(_line(r["before"], *cells, f"{100 * r['share_low']:.0f} %", _gap(r)))
        else:
            lines.append(_line(r["before"], f"not named: {r['verdict']}", *[""] * 5, _gap(r)))
    lines += ["", *_head("reference", "recording", "verdict", "best change", "log evidence", "gap")]
    for r in others:
        verdict = r["verdict"].replace("_", " ")
        lines.append(_line(r["before"], r["after"], verdict, r["best"], f"{r['log_evidence']:.1f}", _gap(r)))
    lines += ["", "Gap: root mean square on parts held out in turn, over what the recording's own fit leaves."]
    return "\n".join(lines) + "\n"


def _gap(row: dict) -> str:
    return f"{row['gap'][0]:.2f} to {row['gap'][1]:.2f}"


def _line(*cells: str) -> str:
    return f"| {' | '.join(cells)} |"


def _head(*names: str) -> list[str]:
    return [_line(*names), _line(*["---"] * len(names))]


def main() -> None:
    """Run the study; print the page, or write it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true", help="write docs/studies/before-after")
    write = parser.parse_args().write
    rows = study()
    if write:
        (FOLDER / "README.md").write_text(page(rows), encoding="utf-8")
        (FOLDER / "results.json").write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    else:
        print(page(rows))


if __name__ == "__main__":
    main()
