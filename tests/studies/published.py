"""python -m tests.studies.published [--before REVISION] [--after REVISION] [--write]: published figures, old beside new.

Collects the figures of every stored study (JSON in docs/ and case_studies/) at two revisions of the repository; without
``--after`` those of the working tree. ``--write`` makes docs/studies/figures from it, and nothing is run again: who renews a
study runs its own script first.
"""

from __future__ import annotations

import argparse
import json
import math
import subprocess
import sys
from collections.abc import Iterator
from fnmatch import fnmatchcase
from typing import Any

from tests.studies.page import STUDIES, write_page

ROOT = STUDIES.parents[1]
#: The last revision before the packages of docs/explanation/architecture.md.
BEFORE = "679f174"
#: Which figures of a file are published, as paths of keys with wildcards; of a file that is not here, all single numbers.
SHOWN = {
    "docs/studies/accuracy/results.json": ("arms/*/formula/*", "arms/*/coverage", "arms/*/lowest", "arms/*/highest"),
    "docs/studies/band-coverage/results.json": ("cases/*/inside/*", "cases/*/width/*"),
    "docs/studies/benchmarks/results.json": (
        "comparison/*/*/us_per_sample",
        "comparison/*/*_over_bayesid",
        "comparison/*/memory_share",
    ),
    "docs/studies/controller-bounds/results.json": ("cases/*/held/*", "cases/*/tracking/*/kept"),
    "docs/studies/coverage/results.json": ("arms/*/fits/*/coverage", "arms/*/fits/*/rms_over_sensor_bound"),
    "docs/studies/diagnosis-speed/results.json": ("median_s", "largest_s"),
    "docs/studies/encoder-coverage/results.json": ("cases/*/fits/*/mean", "cases/*/fits/*/lowest", "cases/*/fits/*/error"),
    "docs/studies/hand-on-tool/results.json": (
        "named",
        "timed",
        "start/*",
        "end/*",
        "force/*",
        "point/*",
        "force_inside",
        "point_inside",
    ),
    "docs/studies/encoder-noise/results.json": (
        "cases/*/fits/*/bias",
        "cases/*/fits/*/rms_error",
        "cases/*/fits/*/coverage/mean",
    ),
    "docs/studies/excitation/results.json": ("random/*/seconds", "random/*/std_ratio", "published/*/std_ratio"),
    "docs/studies/expected/results.json": ("arms/*/all", "arms/*/lowest", "arms/*/highest"),
    "docs/studies/identified-urdf/results.json": ("real/*/growth", "simulated/*/growth"),
    "docs/studies/named-in-part/results.json": ("cases/*/remainder", "cases/*/seconds"),
    "docs/studies/outliers/results.json": ("arms/*/fits/*/error", "arms/*/fits/*/coverage"),
    "docs/studies/payload-coverage/results.json": ("groups/*/coverage_mean", "faults/*/told", "named_without", "told"),
    "docs/studies/payload-real/results.json": (
        "wrist/inside",
        "wrist/plain",
        "wrist/gain",
        "loaded/*/mass",
        "loaded/*/low",
        "loaded/*/high",
    ),
    "docs/studies/physical/results.json": ("cases/*/methods/*/coverage/mean", "cases/*/methods/*/coverage/lowest"),
    "docs/studies/physical/speed.json": ("milliseconds/*", "times_faster*"),
    "docs/studies/posterior-speed/results.json": ("*/bayesid/rate", "*/bayesid_over_*", "whole/*/seconds"),
    "docs/studies/real-robots/results.json": ("*/thirty_lines", "*/methods/*/unseen", "*/methods/*/halves"),
    "docs/studies/startup/results.json": ("*",),
    "docs/studies/tell/results.json": ("ambiguous", "settled", "among", "settled_among"),
    "docs/studies/sbc/results.json": ("cases/*/smallest_probability", "cases/*/mean_rank"),
    "docs/studies/unmodelled/results.json": ("fits/*/untouched", "fits/*/touched", "fits/*/z"),
    "case_studies/blind_naming/results.json": ("rates/*", "coverage_95", "gap_after_within_*", "seconds/*"),
    "case_studies/diagnosis/results.json": ("hose/gap/after", "robot/*/*/gap/after", "wrist/*/*/gap/after"),
    "case_studies/kuka_lwr4/results.json": ("*/rows/*/fit", "*/rows/*/error"),
    "case_studies/liu1998/results.json": ("verification/nrmse/*", "recipes/*/rms_sigmas", "recipes/*/covered"),
    "case_studies/real_payload/results.json": (
        "unloaded/error",
        "changed/gap/*",
        "changed/payload/mass",
        "changed/payload/share_low",
        "series/recordings/*/evidence",
        "series/recordings/*/payload/mass",
        "used/error/*",
        "used/apart/*",
    ),  # fmt: skip
    "case_studies/seven_joint_arm/results.json": ("plan/sensor_sets/*/rank",),
    "case_studies/printed_estimate/results.json": ("cases/*/lower", "cases/*/upper", "by_hand"),
}
#: Shares of counted cases, [share, cases]: their standard error is known.
SHARES = ("rates/*", "coverage_95", "gap_after_within_*")

PAGE = """\
# Published figures, old beside new

Every number that the documentation takes from a stored study, at revision {{ before }} (the last before the
packages of [architecture.md](../../explanation/architecture.md)) and {{ after }}.
`python -m tests.studies.published --write` makes this page and runs no study. A list
of numbers is told by its mean, *se* is the standard error of a difference of shares.

| file | figures | changed | |
|---|---|---|---|
{% for file in files %}
| [{{ file.path }}](../../../{{ file.path }}) | {{ file.figures }} | {{ file.changed | length }} | {{ file.state }} |
{% endfor %}
{% for file in files if file.changed %}

## {{ file.path }}

| figure | old | new | difference |
|---|---|---|---|
{% for row in file.changed %}
| {{ row.name }} | {{ row.old }} | {{ row.new }} | {{ row.difference }} |
{% endfor %}
{% endfor %}
"""


def leaves(data: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[str, Any]]:
    """Every number, or list of numbers, with the keys that lead to it."""
    if isinstance(data, dict):
        for key, value in data.items():
            yield from leaves(value, (*path, str(key)))
    elif isinstance(data, list) and not all(_is_number(x) for x in data):
        for k, value in enumerate(data):
            yield from leaves(value, (*path, str(k)))
    elif _is_number(data) or (isinstance(data, list) and data):
        yield "/".join(path), data


def published(path: str, data: Any) -> dict[str, tuple[float, float | None]]:
    """Figures of a file: name -> value and, of a share, its standard error."""
    patterns = SHOWN.get(path, ("*",))
    out: dict[str, tuple[float, float | None]] = {}
    for name, value in leaves(data):
        keys = name.split("/")
        fits = any(len(keys) == p.count("/") + 1 and all(map(fnmatchcase, keys, p.split("/"))) for p in patterns)
        if path in SHOWN and not fits or path not in SHOWN and isinstance(value, list):
            continue
        if any(fnmatchcase(name, p) for p in SHARES) and isinstance(value, list) and len(value) == 2:
            share, cases = value
            out[name] = share, math.sqrt(max(share * (1 - share), 0.25 / cases) / cases)
        else:
            out[name] = (sum(value) / len(value) if isinstance(value, list) else float(value)), None
    return out


def compared(old: dict, new: dict) -> list[dict[str, str]]:
    """A row for each figure that is not the same in both."""
    rows = []
    for name in dict.fromkeys([*old, *new]):
        (a, a_error), (b, b_error) = old.get(name, (None, None)), new.get(name, (None, None))
        if a == b:
            continue
        difference = "" if a is None or b is None else f"{b - a:+.3g}"
        if difference and a_error is not None and b_error is not None:
            difference += f" ({(b - a) / math.hypot(a_error, b_error):+.1f} se)"
        elif difference and a:
            difference += f" ({100 * (b - a) / abs(a):+.1f} %)"
        shown = [("–" if x is None else f"{x:.4g}") for x in (a, b)]
        rows.append({"name": name.replace("|", "\\|"), "old": shown[0], "new": shown[1], "difference": difference})
    return rows


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _git(*arguments: str) -> str | None:
    done = subprocess.run(["git", "-C", str(ROOT), *arguments], capture_output=True, text=True, check=False)
    return done.stdout if done.returncode == 0 else None


def _at(revision: str, path: str) -> str | None:
    """The file at a revision, also at one where all studies stood in docs/, ``docs/sbc.json``."""
    before = (
        path.removesuffix("/results.json").replace("docs/studies/physical/", "docs/physical-").replace("docs/studies/", "docs/")
    )
    return _git("show", f"{revision}:{path}") or _git("show", f"{revision}:{before.removesuffix('.json')}.json")


def stored() -> list[str]:
    """Stored results of the working tree."""
    files = [*STUDIES.glob("*/*.json"), *(ROOT / "case_studies").glob("*/results.json")]
    return sorted(file.relative_to(ROOT).as_posix() for file in files)


def table(before: str, after: str | None) -> list[dict[str, Any]]:
    """What the page shows of each file."""
    out = []
    for path in stored():
        old = _at(before, path)
        new = _at(after, path) if after else (ROOT / path).read_text(encoding="utf-8")
        figures = [published(path, json.loads(text)) if text else {} for text in (old, new)]
        state = "new" if old is None else "the same to the last digit" if old == new else "renewed"
        out.append({"path": path, "figures": len(figures[1]), "changed": compared(*figures), "state": state})
    return out


def main(arguments: list[str]) -> None:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--before", default=BEFORE)
    parser.add_argument("--after", default=None)
    parser.add_argument("--write", action="store_true", help="make docs/studies/figures")
    given = parser.parse_args(arguments)
    if _git("cat-file", "-e", f"{given.before}^{{commit}}") is None:
        raise SystemExit(f"revision {given.before} is not in this clone; name another by --before")
    files = table(given.before, given.after)
    if given.write:
        write_page(PAGE, STUDIES / "figures" / "README.md", files=files, before=given.before, after=given.after or "now")
    for file in files:
        print(f"{file['path']}: {file['figures']} figures, {len(file['changed'])} changed, {file['state']}")
        for row in file["changed"]:
            print(f"  {row['name']}: {row['old']} | {row['new']} | {row['difference']}")


if __name__ == "__main__":
    main(sys.argv[1:])
