"""Identifiability in words: a table of sensor sets, the classes of the readings that would be used, and what to do."""

from __future__ import annotations

from collections import Counter
from html import escape

from bayesid.design.advice import brief
from bayesid.design.findings import Findings
from bayesid.design.identifiability import EffectExpectation, SetReport
from bayesid.design.visibility import LETTERS, WEAK, WORDS, by_body
from bayesid.results.telling import chance
from bayesid.results.text import DASH, html_table, number, percent, text_table

#: Names of parameters that are written out; more are counted.
_NAMED = 12
#: Larger shares of a usual size are no size that an effect has.
_HUGE = 1e3
_HEAD = ["readings", "rank", "of any motion", "better than size", "condition", "noise from"]


def lead(result: Findings) -> str:
    """What was asked, and the answer for the readings that would be used, in two sentences."""
    main, total = result.main, len(result.main.parameters)
    who = {
        "recorded": f"By {main.sensor_set.title}, these recordings {'' if main.recorded else 'would '}determine",
        "planned": f"By {main.sensor_set.title}, this plan determines", "regression": "These rows determine",
    }[result.source]  # fmt: skip
    alone = sum(p.kind == "alone" for p in main.parameters)
    text = f"{who} {main.rank} combinations of {total} link parameters, {alone} of these parameters alone."
    most = main.rank_of_any_motion
    if most is not None:
        text += f" No motion could show more than {most}."
    weak = main.rank - main.well_known
    if weak:
        text += f" For {weak} of them the expected error is larger than the body itself."
    return text


def counts(report: SetReport) -> list[tuple[str, int]]:
    """How many link parameters are in each class, in the order of what they tell."""
    found = Counter(p.kind for p in report.parameters)
    return [(kind, found[kind]) for kind in WORDS if found[kind]]


def table(result: Findings) -> list[list[str]]:
    """A row for each sensor set."""
    return [
        [
            r.sensor_set.title + (" *" if r is result.main else ""),
            str(r.rank),
            DASH if r.rank_of_any_motion is None else str(r.rank_of_any_motion),
            DASH if all(b.size is None for b in r.base_parameters) else str(r.well_known),
            number(r.condition_number, 3),
            sources(r),
        ]
        for r in result.sensor_sets
    ]  # fmt: skip


def sources(report: SetReport) -> str:
    """Where the noise comes from, and whether there are such readings."""
    text = ", ".join(dict.fromkeys(report.noise.values()))
    return text if report.recorded else f"{text}; not recorded"


def spread(report: SetReport) -> str:
    """The range of expected standard deviations relative to size, and the largest."""
    relative = [(b.std / b.size, b.label) for b in report.base_parameters if b.size]
    if not relative:
        return ""
    relative.sort()
    middle = relative[len(relative) // 2][0]
    return (
        f"Expected standard deviations, relative to the size of a body: {share(relative[0][0])} to {share(relative[-1][0])}, "
        f"{share(middle)} in the middle; the largest is that of {brief(relative[-1][1])}."
    )


def share(ratio: float) -> str:
    """A share as per cent, or how many times."""
    return percent(ratio, 2) if ratio < 9.95 else f"{float(f'{ratio:.2g}'):,.0f} times"


def effect_lines(report: SetReport) -> list[tuple[str, str]]:
    """Expected standard deviations of the effects' parameters: all places of one in a line, and what is not determined."""
    groups: dict[str, list[EffectExpectation]] = {}
    for e in report.effects:
        spec, _, parameter = e.name.rpartition(".")
        groups.setdefault(f"{spec.partition('@')[0]}.{parameter}", []).append(e)
    lines = []
    for name, members in groups.items():
        stds = sorted(e.std for e in members if e.std is not None)
        hidden = [e.name.rpartition(".")[0].partition("@")[2] for e in members if e.std is None]
        unit = "" if members[0].unit == "1" else f" {members[0].unit}"
        said = "" if not stds else f"± {number(stds[0], 3)}" + (f" to {number(stds[-1], 3)}" if len(stds) > 1 else "") + unit
        lost = f"not determined beside the links at {', '.join(hidden)}" if hidden else ""
        lines.append((name, "; ".join(part for part in (said, lost) if part)))
    return lines


TOLD_HEAD = ["readings", "true", "other", "seen alone", "left", "probability", "told from"]


def told(result: Findings) -> list[list[str]]:
    """How well effects are told apart: a row for each sensor set, true effect and other one; squared standard deviations."""
    rows = []
    for report in result.sensor_sets:
        pairs = result.separations.get(report.sensor_set.name, ())
        for p in pairs:
            least = DASH if p.smallest is None or p.smallest > _HUGE else share(p.smallest)
            names = [report.sensor_set.title, p.true, p.other]
            rows.append([*names, number(p.seen, 3), number(p.noncentrality, 3), chance(p.probability), least])
        if not pairs:
            rows.append([report.sensor_set.title, "not both seen", "", DASH, DASH, DASH, DASH])
    return rows


def side_by_side(result: Findings) -> list[str]:
    """A letter for every link parameter: bodies downwards, sensor sets across."""
    bodies, across = by_body([p.name for p in result.main.parameters])
    used = {p.kind for r in result.sensor_sets for p in r.parameters}
    key = ", ".join(f"{LETTERS[k]} {WORDS[k]}" for k in WORDS if k in used)
    rows = []
    for k, body in enumerate(bodies):
        part = slice(k * len(across), (k + 1) * len(across))
        rows.append([body, *("".join(LETTERS[p.kind] for p in r.parameters[part]) for r in result.sensor_sets)])
    head = ["", *(r.sensor_set.name for r in result.sensor_sets)]
    return [f"Side by side ({' '.join(across)}): {key}", *(f"  {line}" for line in text_table(head, rows)), ""]


def as_text(result: Findings) -> str:
    """A few dozen lines for a terminal."""
    main = result.main
    motions = ", ".join(n + (f" ({number(d, 3)} s)" if d else "") for n, d in result.motions.items())
    lines = [f"{result.name}: what {motions} can determine", lead(result), ""]
    lines += [f"  {line}" for line in text_table(_HEAD, table(result))]
    lines += ["  * these readings would be used", "", f"Link parameters, by {main.sensor_set.title}:"]
    for kind, count in counts(main):
        names = [p.name for p in main.parameters if p.kind == kind]
        shown = ", ".join(names[:_NAMED]) + (f" and {count - _NAMED} more" if count > _NAMED else "")
        lines.append(f"  {count} {WORDS[kind]}: {shown}")
    lines += ["", *side_by_side(result)] if len(result.sensor_sets) > 1 else [""]
    said = spread(main)
    lines += [said] if said else []
    lines += [f"  effect {name}: {text}" for name, text in effect_lines(main)]
    lines += ["What would make a difference:"] if result.advice else []
    lines += [f"  - {a.text}" for a in result.advice]
    if result.separations:
        lines.append("Telling effects apart, each at its usual size; told from: share of that size that is enough:")
        lines += [f"  {line}" for line in text_table(TOLD_HEAD, told(result))]
    lines += [f"  warning: {w}" for w in result.warnings]
    return "\n".join(lines)


def as_html(result: Findings) -> str:
    """Tables for a notebook: sensor sets, then the class of every link parameter for each of them."""
    head = ["parameter", *(r.sensor_set.title for r in result.sensor_sets)]
    rows = [
        [p.name, *(r.parameters[k].kind.replace("_", " ") for r in result.sensor_sets)]
        for k, p in enumerate(result.main.parameters)
    ]
    weak = "".join(f"<li>{escape(b.label)}</li>" for b in result.main.base_parameters if b.kind == WEAK)
    return (
        f"<p><b>{escape(result.name)}</b>: {escape(lead(result))}</p>"
        + html_table(_HEAD, table(result))
        + f"<ul>{''.join(f'<li>{escape(a.text)}</li>' for a in result.advice)}</ul>"
        + (f"<p>Known too little:</p><ul>{weak}</ul>" if weak else "")
        + f"<details><summary>Every link parameter</summary>{html_table(head, rows)}</details>"
    )
