"""What becomes of diagnoses when each threshold is moved by 30 % either way, on fresh simulated recordings.

    python -m tests.studies.diagnosis_settings --work DIR [--count 20] [--seed 77] [--jobs 1] [--only NAME,...] [--quick]
        [--docs DIR]

Recordings come from the independent plant of case_studies/blind_naming. Every diagnosis is kept in DIR/diagnoses.json as soon as
it is made, and none is made twice: the run can be interrupted and taken up again. A threshold that the diagnosis of a recording
never reads cannot change it; that one is not made again. ``--quick`` takes two recordings and four thresholds, to see that the
script works. Writes docs/studies/diagnosis-settings from what there is.
"""

from __future__ import annotations

import argparse
import concurrent.futures
import json
import multiprocessing
import sys
import warnings
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, ClassVar

sys.path.append(str(Path(__file__).resolve().parents[2] / "case_studies" / "blind_naming"))

from judge import CLAIMS, within

import bayesid
from bayesid.diagnosis.settings import DEFAULT, Settings
from tests.studies.page import STUDIES, write_page

MOVED = 0.3
QUICK = ("accept", "unexplained", "race_share", "mostly_closed")
PAGE = """\
# Thresholds of a diagnosis, moved

Every threshold of `bayesid.diagnosis.settings.Settings`, where its derivation or source stands, moved by 30 % down and up (whole
numbers by one at least, shares at most half-way to one), the others held, on {{ cases }} fresh recordings of the plant of
[blind naming](../../../case_studies/blind_naming/README.md). "Right" counts recordings whose hidden effects are named and
nothing else;
nothing, where nothing is hidden; and `unknown`, where what is hidden is not in the library. "Changed" counts recordings with
another verdict or other names than with the thresholds as they stand, which are right in {{ right }} of {{ cases }}. Made by
`python -m tests.studies.diagnosis_settings`.
{% if partial %}

This is a part of the run: thresholds that are missing have not been moved yet.
{% endif %}

| threshold | value | right at -30 % | changed | right at +30 % | changed |
| --- | ---: | ---: | ---: | ---: | ---: |
{% for row in rows %}
| `{{ row.name }}` | {{ row.value }} | {{ row.down.right }} | {{ row.down.changed }} | {{ row.up.right }} | {{ row.up.changed }} |
{% endfor %}
"""


def moved(name: str, way: int) -> Settings:
    """The thresholds with one of them moved down (-1) or up (1)."""
    value = getattr(DEFAULT, name)
    if isinstance(value, int):
        return replace(DEFAULT, **{name: max(value + way * max(round(MOVED * value), 1), 0)})
    share = 1.0 + way * MOVED
    # Quantiles and shares stay below one.
    return replace(DEFAULT, **{name: min(value * share, 0.5 * (1.0 + value)) if value < 1.0 else value * share})


def is_right(answer: dict[str, Any], said: dict[str, Any]) -> bool:
    """Whether a diagnosis says what is hidden, and nothing else."""
    if answer["kind"] == "none":
        return said["verdict"] == "nothing_missing"
    if answer["kind"] == "unlisted":
        return said["verdict"] == "unknown"
    if said["verdict"] not in CLAIMS:
        return said["verdict"] in answer["acceptable_verdicts"] and answer["kind"] == "single"
    left = list(said["effects"])
    for truth, alternatives in zip(answer["effects"], answer["alternatives"], strict=True):
        hit = next((claim for claim in left if within(truth, alternatives, claim)), None)
        if hit is None:
            return False
        left.remove(hit)
    return not left


class Watched(Settings):
    """Thresholds that note which of them are read."""

    read: ClassVar[set[str]] = set()

    def __getattribute__(self, name: str) -> Any:
        """Any attribute, noted."""
        Watched.read.add(name)
        return super().__getattribute__(name)


def diagnosed(folder: Path, channel: str, name: str | None, way: int) -> dict[str, Any]:
    """Verdict and effects with their rivals; a refusal as verdict ``refused``. With no threshold moved: those read, too."""
    warnings.simplefilter("ignore")
    settings = Watched() if name is None else moved(name, way)
    Watched.read.clear()
    try:
        said = bayesid.diagnose(folder, channel, settings=settings).to_dict()
        effects = [{key: e[key] for key in ("name", "where", "ambiguous_with")} for e in said["effects"]]
        out: dict[str, Any] = {"verdict": said["verdict"], "effects": effects}
    except bayesid.BayesidError as error:
        out = {"verdict": "refused", "effects": [], "error": str(error)}
    return out if name else out | {"read": sorted(Watched.read & {f.name for f in fields(Settings)})}


def answers(work: Path, count: int, seed: int, quick: bool) -> list[dict[str, Any]]:
    """The recordings' answers; they are made unless they are there."""
    from make import make

    folder = work / "recordings"
    if not (folder / "answers").exists():
        make(folder, count, seed, *((("single", "none"), ("viscous_friction",)) if quick else ()))
    return [json.loads(path.read_text(encoding="utf-8")) for path in sorted((folder / "answers").glob("*.json"))]


def written(work: Path, names: list[str], cases: list[dict[str, Any]], docs: Path) -> None:
    """The page, from all thresholds whose diagnoses have been made for all recordings."""
    made = json.loads((work / "diagnoses.json").read_text(encoding="utf-8"))
    plain = {c["case"]: made[f"{c['case']} as it stands"] for c in cases}

    def side(name: str, way: int) -> dict[str, str] | None:
        keys = {c["case"]: f"{c['case']} {name} {way:+d}" for c in cases}
        if not all(key in made for key in keys.values()):
            return None
        right = sum(is_right(c, made[keys[c["case"]]]) for c in cases)

        def named(said):
            return said["verdict"], sorted((e["name"], e["where"]) for e in said["effects"])

        return {"right": str(right), "changed": str(sum(named(made[keys[k]]) != named(plain[k]) for k in plain))}

    rows = [{"name": n, "value": f"{getattr(DEFAULT, n):g}", "down": side(n, -1), "up": side(n, 1)} for n in names]
    rows = [row for row in rows if row["down"] and row["up"]]
    right = sum(is_right(c, plain[c["case"]]) for c in cases)
    partial = len(rows) < len(fields(DEFAULT))
    write_page(PAGE, docs / "README.md", cases=len(cases), right=right, rows=rows, partial=partial)


def main(arguments: list[str] | None = None) -> None:
    """Make what is missing of the diagnoses, and the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--work", type=Path, required=True, help="where recordings and diagnoses are kept")
    parser.add_argument("--count", type=int, default=20)
    parser.add_argument("--seed", type=int, default=77)
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--only", default="", help="thresholds to move, separated by commas; default all")
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--docs", type=Path, default=STUDIES / "diagnosis-settings")
    options = parser.parse_args(arguments)
    names = [f.name for f in fields(DEFAULT)]
    chosen = options.only.split(",") if options.only else list(QUICK) if options.quick else names
    cases = answers(options.work, 2 if options.quick else options.count, options.seed, options.quick)
    store = options.work / "diagnoses.json"
    made = json.loads(store.read_text(encoding="utf-8")) if store.exists() else {}

    def make(wanted: list[tuple[str, dict[str, Any], str | None, int]]) -> None:
        """The diagnoses that have not been made, kept as they come."""
        fresh = multiprocessing.get_context("spawn")
        with concurrent.futures.ProcessPoolExecutor(options.jobs, mp_context=fresh) as pool:
            folder = options.work / "recordings"
            runs = {
                pool.submit(diagnosed, folder / case["case"], case["channel"], name, way): key
                for key, case, name, way in wanted
                if key not in made
            }
            for run in concurrent.futures.as_completed(runs):
                made[runs[run]] = run.result()
                print(f"{runs[run]}: {run.result()['verdict']}", flush=True)
                kept = store.with_suffix(".part")
                kept.write_text(json.dumps(made, indent=1), encoding="utf-8")
                kept.replace(store)

    make([(f"{case['case']} as it stands", case, None, 0) for case in cases])
    again = []
    for name in chosen:
        for case in cases:
            plain = made[f"{case['case']} as it stands"]
            for way in (-1, 1):
                key = f"{case['case']} {name} {way:+d}"
                if name in plain["read"]:
                    again.append((key, case, name, way))
                else:
                    made[key] = plain
    make(again)
    store.write_text(json.dumps(made, indent=1), encoding="utf-8")
    written(options.work, names, cases, options.docs)


if __name__ == "__main__":
    main()
