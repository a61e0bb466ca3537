"""What ``identifiability`` found."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any

from bayesid.arguments import ByName
from bayesid.design.advice import Advice, brief
from bayesid.design.identifiability import LETTERS, WORDS, EffectExpectation, LinkExpectation, SetReport, by_body
from bayesid.design.separability import Separation
from bayesid.drawing import figures_of
from bayesid.posterior.result import PRIOR_DRIVEN
from bayesid.recordings.complaints import listed
from bayesid.results.excitation import chance
from bayesid.results.files import SCHEMA, ShownResult, strict
from bayesid.rounding import DASH, number, percent, unit_text
from bayesid.section import Cell, Part, ShownSection, ShownTable, powers

if TYPE_CHECKING:
    from matplotlib.figure import Figure


#: Names of parameters that are written out; more are counted.
_NAMED = 12
#: Larger shares of a usual size are no size that an effect has.
_HUGE = 1e3


@dataclass(frozen=True, eq=False, repr=False)
class Identifiability(ByName, ShownResult):
    """What motions can and cannot determine, for each sensor set.

    Attributes
    ----------
    name
        Of the experiment, robot or regression.
    source
        ``recorded``, ``planned``, or ``regression`` for rows of one's own.
    motions
        Their names and what they last [s]; 0 for poses.
    still
        Names of joints that stand still in all of them.
    sensor_sets
        One report each, in the order of `bayesid.design.reading_noise.SENSOR_SETS`.
    main
        The one whose readings an estimate would use by default.
    advice
        What would make a difference, most important first.
    separations
        How well effects are distinguished, by the name of the sensor set; empty where nobody asked.
    warnings
        What the user should know, most important first.
    seconds
        Run time by stage.
    """

    verb, report = "identifiability", "identifiability"
    name: str
    source: str
    motions: Mapping[str, float]
    still: tuple[str, ...]
    sensor_sets: tuple[SetReport, ...]
    main: SetReport
    advice: tuple[Advice, ...] = ()
    separations: Mapping[str, tuple[Separation, ...]] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    seconds: dict[str, float] = field(default_factory=dict)

    def __repr__(self) -> str:
        return f"<Identifiability of {self.name}: rank {self.main.rank} from {self.main.sensor_set.title}>"

    def _parts(self) -> list[Part]:
        main = self.main
        classes = []
        for kind, count in counts(main):
            names = listed((p.name for p in main.parameters if p.kind == kind), _NAMED)
            classes.append(f"{count} {WORDS[kind]}: {names}")
        if len(self.sensor_sets) > 1:
            classes += side_by_side(self)
        expected = [spread(main), *(f"effect {name}: {text}" for name, text in effect_lines(main))]
        parts: list[Part] = [
            f"{self.name}: what {motions_text(self)} can determine", answer(self), sets_table(self),
            "* these readings would be used",
            ShownSection(f"Link parameters, by {main.sensor_set.title}", classes), ShownSection("Expected errors", expected),
            ShownSection("What would make a difference", [f"- {a.text}" for a in self.advice]),
        ]  # fmt: skip
        if self.separations:
            explained = "each at its usual size; told from: share of that size that is enough"
            parts.append(ShownSection("Telling effects apart", [explained, pair_table(self)]))
        return [*parts, *(f"warning: {w}" for w in self.warnings)]

    def __getitem__(self, name: str) -> SetReport:
        """The report of a sensor set, ``torque`` for example."""
        return {r.sensor_set.name: r for r in self.sensor_sets}[name]

    def plot_classes(self, *, ax: Any = None) -> Figure:
        """Draw every link parameter's class, a panel (and one of the axes given) for each sensor set."""
        return figures_of(self)["classes"](ax=ax)

    def plot_expected(self, *, ax: Any = None) -> Figure:
        """Draw the expected standard deviation of every combination over its size, for the readings that would be used."""
        return figures_of(self)["expected"](ax=ax)

    def to_dict(self) -> dict[str, Any]:
        """What ``identifiability.json`` holds."""
        return strict({
            "schema": SCHEMA, "experiment": self.name, "source": self.source,
            "motions": [{"name": n, "duration": d} for n, d in self.motions.items()],
            "still_joints": list(self.still), "default_sensor_set": self.main.sensor_set.name, "classes": WORDS,
            "sensor_sets": [_set(r) for r in self.sensor_sets], "advice": [asdict(a) for a in self.advice],
            "tell": [
                {"sensor_set": name, "pairs": [asdict(pair) for pair in pairs]} for name, pairs in self.separations.items()
            ],
            "warnings": list(self.warnings), "runtime_s": self.seconds,
        })  # fmt: skip


def own_std(link: LinkExpectation, report: SetReport) -> float | None:
    """Expected standard deviation of a parameter that is identified alone, or of the combination it is most of; None without."""
    return report.base_parameters[link.combinations[0]].std if link.combinations else None


def _set(report: SetReport) -> dict[str, Any]:
    return {
        "name": report.sensor_set.name, "title": report.sensor_set.title, "recorded": report.recorded,
        "noise": report.noise, "noise_std": report.noise_std, "rank": report.rank,
        "rank_of_any_motion": report.rank_of_any_motion, "better_than_size": report.well_known,
        "condition_number": report.condition_number,
        "parameters": [_link(link, report) for link in report.parameters], "parameters_by_class": dict(counts(report)),
        "base_parameters": [
            {"name": b.name, "label": b.label, "unit": b.unit, "class": b.kind, "expected_std": b.std, "size": b.size,
             "relative_std": None if not b.size else b.std / b.size, "prior_share": b.prior_share,
             "prior_driven": None if b.prior_share is None else b.prior_share > PRIOR_DRIVEN}
            for b in report.base_parameters
        ],
        "not_excited": list(report.unexcited),
        "effects": [{"name": e.name, "unit": e.unit, "expected_std": e.std} for e in report.effects],
        "covariance": report.shown.covariance,
    }  # fmt: skip


def _link(link: LinkExpectation, report: SetReport) -> dict[str, Any]:
    inside = [report.base_parameters[k] for k in link.combinations]
    return {
        "name": link.name, "class": link.kind, "text": WORDS[link.kind],
        "combination": inside[0].label if inside else None, "combinations": [b.name for b in inside],
        "expected_std": own_std(link, report), "class_of_any_motion": link.of_any_motion,
        "shown_by_moving": list(link.joints), "shown_by_sensor_sets": list(link.sensor_sets),
    }  # fmt: skip


def motions_text(result: Identifiability) -> str:
    """The motions, those of a regression by their numbers, and what they last."""
    return ", ".join(
        (f"motion {n}" if n.isdigit() else n) + (f" ({number(d, 3)} s)" if d else "") for n, d in result.motions.items()
    )


def answer(result: Identifiability) -> str:
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
        what = "value" if result.source == "regression" else "body"
        text += f" For {weak} of them the expected error is larger than the {what} itself."
    return text


def counts(report: SetReport) -> list[tuple[str, int]]:
    """How many link parameters are in each class, in the order of what they tell."""
    found = Counter(p.kind for p in report.parameters)
    return [(kind, found[kind]) for kind in WORDS if found[kind]]


def sets_table(result: Identifiability, *, counted: bool = False) -> ShownTable:
    """A row for each sensor set; ``counted``: with how many parameters are in each class."""
    rows: list[list[Cell]] = []
    for r in result.sensor_sets:
        found, own = dict(counts(r)), r is result.main
        most = DASH if r.rank_of_any_motion is None else str(r.rank_of_any_motion)
        known = DASH if all(b.size is None for b in r.base_parameters) else str(r.well_known)
        kinds = [(str(found.get(k, 0)), "" if k in found else "dim") for k in WORDS] if counted else []
        title = r.sensor_set.title + " *" * own, "sure" * own
        rows.append([title, str(r.rank), most, known, number(r.condition_number, 3), *kinds, sources(r)])
    names = [k.replace("_", " ") for k in WORDS] if counted else []
    head = ["readings", "rank", "of any motion", "better than size", "condition", *names, "noise from"]
    return ShownTable(head, rows, f"- nb n n n{' n' * len(names)} -", "tight")


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
        f"Expected standard deviations, relative to {measure(report)}: {share(relative[0][0])} to {share(relative[-1][0])}, "
        f"{share(middle)} in the middle; the largest is that of {brief(relative[-1][1])}."
    )


def measure(report: SetReport) -> str:
    """What sizes are: rows of one's own may be of no body, and have values alone."""
    return "the values" if report.sensor_set.channel == "rows" else "the size of a body"


def share(ratio: float) -> str:
    """A share as per cent, or how many times."""
    return percent(ratio, 2) if ratio < 9.95 else f"{float(f'{ratio:.2g}'):,.0f} times"


def effect_lines(report: SetReport) -> list[tuple[str, str]]:
    """Expected standard deviations of the effects' parameters: all places of one unit in a line, and what is not determined."""
    groups: dict[tuple[str, str], list[EffectExpectation]] = {}
    for e in report.effects:
        spec, _, parameter = e.name.rpartition(".")
        weight = report.expected.base.effect_labels([e.name])[0].removeprefix(e.name)
        groups.setdefault((f"{spec.partition('@')[0]}.{parameter}{weight}", e.unit), []).append(e)
    lines = []
    for (name, unit), members in groups.items():
        stds = sorted(e.std for e in members if e.std is not None)
        hidden = [e.name.rpartition(".")[0].partition("@")[2] for e in members if e.std is None]
        ends = " to ".join(number(s, 3) for s in (stds if len(stds) < 2 else (stds[0], stds[-1])))
        said = f"standard deviation {ends} {powers(unit_text(unit))}".rstrip() if stds else ""
        lost = f"not determined beside the links at {', '.join(hidden)}" if hidden else ""
        lines.append((name, "; ".join(part for part in (said, lost) if part)))
    return lines


def pair_table(result: Identifiability) -> ShownTable:
    """How well effects are distinguished: a row for each sensor set, true effect and other one; squared standard deviations."""
    rows = []
    for report in result.sensor_sets:
        pairs = result.separations.get(report.sensor_set.name, ())
        for p in pairs:
            least = DASH if p.smallest is None or p.smallest > _HUGE else share(p.smallest)
            names = [report.sensor_set.title, p.true, p.other]
            rows.append([*names, number(p.seen, 3), number(p.noncentrality, 3), chance(p.probability), least])
        if not pairs:
            rows.append([report.sensor_set.title, "not both seen", "", DASH, DASH, DASH, DASH])
    head = ["readings", "true", "other", "seen alone", "left", "probability", "told from"]
    return ShownTable(head, rows, "- - - n n n n", "tight")


def side_by_side(result: Identifiability) -> list[Part]:
    """A letter for every link parameter: bodies downwards, sensor sets across."""
    bodies, across = by_body([p.name for p in result.main.parameters])
    used = {p.kind for r in result.sensor_sets for p in r.parameters}
    key = ", ".join(f"{LETTERS[k]} {WORDS[k]}" for k in WORDS if k in used)
    rows = []
    for k, body in enumerate(bodies):
        part = slice(k * len(across), (k + 1) * len(across))
        rows.append([body, *("".join(LETTERS[p.kind] for p in r.parameters[part]) for r in result.sensor_sets)])
    table = ShownTable(["", *(r.sensor_set.name for r in result.sensor_sets)], rows)
    return [f"Side by side ({' '.join(across)}): {key}", table]
