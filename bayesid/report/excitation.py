"""The reports of ``excite``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, TypeAlias

import numpy as np
from markupsafe import Markup

from bayesid.arguments import argument
from bayesid.drawing import Figures, figures_of
from bayesid.report.charts import WIDTH, Group, Panel, chart, key, key_width, limits, text_width, write
from bayesid.report.check import recording
from bayesid.report.page import bullets, cards, figure, fold, how, lead, note, page, warnings
from bayesid.results import excitation as results
from bayesid.results.excitation import KINDS, TRAJECTORY, DistinguishingMotion, Excitation, LimitUse
from bayesid.results.files import report_of
from bayesid.rounding import DASH, counted, number, percent
from bayesid.section import Html, ShownSection, ShownTable
from bayesid.simulation.trajectories import Trajectory

_PLOTTED = 1000
_Loads: TypeAlias = Mapping[str, tuple[tuple[str, ...], np.ndarray]]
_ROW, _BEST, _OTHER, _OVER = 15.0, "#1d4ed8", "#94a3b8", "#b91c1c"


def motion_plot(trajectory: Trajectory, groups: Sequence[Group]) -> Markup:
    """A motion in time, its curves as `motion_groups` makes them."""
    stride = max(-(-len(trajectory.times) // _PLOTTED), 1)
    return recording(trajectory.times[::stride], [(title, names, values[::stride]) for title, names, values in groups])


def motion_groups(
    t: Trajectory, units: Sequence[str] = ("rad or m", "per s", "per s²"), loads: _Loads | None = None, torque: str = "N m or N"
) -> list[Group]:
    """Joint positions, velocities and accelerations in three units, then names (c,) and values (N, c) of ``loads`` by channel.

    ``torque`` is the unit of joint torques.
    """
    names, loads = [f"q{j + 1}" for j in range(t.positions.shape[1])], loads or {}
    joints = ("positions", t.positions), ("velocities", t.velocities), ("accelerations", t.accelerations)
    groups: list[Group] = [
        (f"joint {title} [{unit}]", names, values) for (title, values), unit in zip(joints, units, strict=True)
    ]
    if "torque" in loads:
        groups.append((f"joint torques of the nominal links [{torque}]", *loads["torque"]))
    if "wrench" in loads:
        channels, values = loads["wrench"]
        groups.append(("forces on the sensor [N]", channels[:3], values[:, :3]))
        groups.append(("moments on the sensor [N m]", channels[3:], values[:, 3:]))
    return groups


def limit_shares(rows: Sequence[tuple[str, str, float]]) -> Markup:
    """How much of every limit, by kind and joint or channel, a motion uses, as bars."""
    names = [f"{kind} {where}" for kind, where, _ in rows]
    left = 14.0 + max(map(text_width, names)) * 0.9
    height = _ROW * len(rows)
    panel = Panel(left, 8.0, WIDTH - 30.0 - left, height, (0.0, max(1.05, *(r for *_, r in rows))), (len(rows) - 0.4, -0.6))
    parts = [panel.frame("", "share of what is allowed", y_axis=False)]
    for k, (_, _, share) in enumerate(rows):
        parts.append(write(left - 6.0, float(panel.down(np.array(k))) + 3.2, names[k], 8.5, "#475569", "end"))
        parts.append(panel.bar(0.0, share, k, 0.55, _OVER if share > 1.0 else _BEST))
    parts.append(panel.stroke(1.0, 0.5 * len(rows) - 0.5, len(rows), "#0f172a"))
    return chart(height + 44.0, parts)


def beside_random(value: float, others: np.ndarray, label: str) -> Markup:
    """The criterion of the motion, larger is better, beside that of random motions within the same limits."""
    names = [counted(len(others), "random motion"), "this motion"]
    places = np.cumsum([0.0, key_width(names[0])])
    panel = Panel(30.0, 24.0, WIDTH - 60.0, 46.0, limits([np.append(others, value)], 0.05), (0.0, 1.0))
    spread = 0.2 + 0.6 * (np.arange(len(others)) * 0.618034 % 1.0)  # so that dots do not hide each other
    parts = [panel.frame("", label, y_axis=False), panel.dots(others, spread, _OTHER), panel.stroke(value, 0.5, 0.9, _BEST)]
    parts += [key(30.0 + x, 10.0, n, c, 4.0) for x, n, c in zip(places, names, (_OTHER, _BEST), strict=True)]
    return chart(104.0, parts)


#: What the numbers of `pair_table` are.
PAIRS = (
    "Noncentrality: what the best fit of the other effect and of everything else leaves of the motion's readings, in squared "
    "standard deviations. Log evidence: of the true effect over the other one once the motion is recorded, old and new "
    "together; a diagnosis rules the other one out from 3 on."
)


@report_of.register
def distinguishing_report(result: DistinguishingMotion) -> str:
    """The report of ``excite --tell``: an HTML page with all figures inside."""
    t = result.telling
    large = [
        (results.chance(t.probability), "probability that the true one alone is left", "good" if t.probability > 0.8 else "bad"),
        (results.chance(t.wrong), "probability that a wrong one is", ""), (results.duration(t), t.label, ""),
        (str(t.tried), "motions compared", ""),
    ]  # fmt: skip
    weights = ", ".join(f"{n} {percent(w, 2)}" for n, w in zip(t.rivals, t.weights, strict=True))
    recorded = f"Recordings that count: {', '.join(result.recordings)}. " if result.recordings else "Nothing is recorded yet. "
    sizes = (
        f"The recordings show these effects; sizes are estimated, and the probabilities of each to be the true one before the "
        f"motion are {weights}." if t.estimated else
        "The recordings do not show each of these effects, so each is taken at its usual size, as often as any other."
    )  # fmt: skip
    plot = motion_plot(t.trajectory, motion_groups(t.trajectory))
    drawn = figure(plot, f"Joint motion as in {TRAJECTORY}: it starts and ends at rest.")
    sections = [
        ShownSection("Every pair", [recorded + sizes, results.pair_table(t), note(PAIRS)]),
        ShownSection("The motion", [drawn], "Motion"),
        ShownSection("Details", [bullets(t.notes), *how(seconds=result.seconds).parts]),
    ]
    kicker = "The motion within limits that best tells effects apart"
    title = f"{result.name}: a motion that tells effects apart"
    return page(result.name, kicker, [lead(result.lead), cards(large)], sections, title)


def _title(use: LimitUse) -> str:
    """What is limited, before whose it is."""
    return KINDS[use.kind] + " of" * (use.kind != "wrench")


def _groups(result: Excitation) -> list[Group]:
    slides = result.prismatic
    units, torque = (("m",), "N") if slides.all() else (("rad", "m"), "N m or N") if slides.any() else (("rad",), "N m")
    each = [" or ".join(u + per for u in units) for per in ("", "/s", "/s²")]
    return motion_groups(result.trajectory, each, result.loads, torque)


@report_of.register
def excitation_report(result: Excitation) -> str:
    """The report of ``excite``: an HTML page with all figures inside."""
    shares = [(_title(u), u.where, u.ratio) for u in result.limits if u.kind != "collision"]
    axis = {"d": "mean logarithm of the eigenvalues of the information, larger is better"}.get(
        result.criterion, "logarithm of the criterion, larger is better"
    )
    blocks = [[f"{b.trajectory.name}.csv", results.block_length(b), b.shows] for b in result.blocks]
    limits_ = [
        [_title(u), u.where, number(u.reached, 4), number(u.limit, 4), u.unit,
         percent(u.ratio) if u.kind != "collision" else DASH, ("yes", "good") if u.kept else ("no", "bad")]
        for u in result.limits
    ]  # fmt: skip
    quantities = [[name, number(std, 3), unit] for name, unit, std in result.quantities]
    parameters = [
        [str(k + 1), label, number(float(std), 3), unit]
        for k, (label, unit, std) in enumerate(zip(result.base.labels, result.base.units, result.std, strict=True))
    ]
    static, deviation = _static_run(result), "expected standard deviation"
    sections = [
        ShownSection("The motion", [
            figure(motion_plot(result.trajectory, _groups(result)),
                   "Joint motion as in trajectory.csv, and what the nominal links take along it."),
            figure(beside_random(result.value, result.random, axis) if len(result.random) else "",
                   "What the motion was optimised for, beside random motions of the same series within the same limits, each "
                   "as large as the limits allow."),
        ], "Motion"),
        *([ShownSection("What else to record", [
            *([ShownTable(["table", "length", "what it shows"], blocks, "k k w")] if blocks else []),
            f"**Static run** (stop-and-go.csv): {static}" if static else "",
        ])] if blocks or static else []),
        ShownSection("How near it comes to its limits", [
            "Positions, speeds and accelerations are bounds for all times; torques, readings of the sensor (with the robot's "
            "weight on it) and distances are the extremes at ten times the recorded rate, with nominal links.",
            figure(limit_shares(shares), "One: as much as is allowed, which is the stated share of the robot's own limit."),
            fold("All limits as numbers",
                 ShownTable(["limit", "of", "reached", "allowed", "unit", "share", "kept"], limits_, "k w n n - n -")),
        ], "Limits"),
        ShownSection("Expected standard deviations", [
            *([ShownTable(["quantity", deviation, "unit"], quantities, "- n -", "narrow")] if quantities else []),
            "Of the base parameters that a fit of this motion would give, for the stated noise and a model that is complete.",
            ShownTable(["", "base parameter", deviation, "unit"], parameters, "- w n u"),
        ], "Expected deviations"),
        *_effects(result),
        _coefficients(result),
        ShownSection("Details", [
            bullets(result.notes),
            *how(*_options(result), seconds=result.seconds).parts,
        ]),
    ]  # fmt: skip
    fine = "The motion keeps all limits and determines every base parameter of these readings."
    opening = [warnings(_warnings(result), fine), lead(_lead(result)), cards(_cards(result))]
    kicker = "An exciting trajectory, planned before anything is recorded"
    return page(result.name, kicker, opening, sections, f"{result.name}: exciting trajectory")


def _warnings(result: Excitation) -> list[str]:
    out = [f"The limit of {_title(u)} {u.where} is not kept." for u in result.limits if not u.kept]
    if result.interrupted:
        out.append("The search was interrupted: this is the best motion that it had found.")
    hidden = result.possible - result.base.rank
    if hidden:
        missing = f"{hidden} of {result.possible} base parameters are not determined"
        out.append(f"{missing}: give more {argument('harmonics')} or a longer {argument('duration')}.")
    return out


def _lead(result: Excitation) -> str:
    t = result.trajectory
    repeats = f", which repeats every {number(result.series.period, 3)} s," if t.period else ""
    text = f"A motion of {number(float(t.times[-1]), 4)} s{repeats} for {result.readings}. {result.criterion_text}."
    return text + " It starts and ends at rest, and keeps all limits." if result.within_limits else text


def _cards(result: Excitation) -> list[tuple[str, str, str]]:
    whole, kept = result.base.rank == result.possible, result.within_limits
    large = [
        (f"{result.base.rank} of {result.possible}", "base parameters determined", "good" if whole else "bad"),
        (number(result.condition_number, 3), "condition number, whitened, columns of unit length", ""),
        ("yes" if kept else "no", "within all limits, at ten times the recorded rate", "good" if kept else "bad"),
    ]
    if len(result.random):
        what = "condition number" if result.criterion == "condition" else "typical standard deviation"
        text = f"smaller {what} than the best of {counted(len(result.random), 'random motion')}"
        large.append((f"{number(result.gain, 2)} ×", text, "good" if result.gain > 1 else "fair"))
    return large


def _effects(result: Excitation) -> list[ShownSection]:
    """Effects that the motion could show; none where that was not asked for."""
    found = result.diagnosability
    if found is None or not found.effects:
        return []
    rows = [
        [e.effect.spec, e.parameter, number(e.usual, 2),
         (number(e.smallest, 2, "never"), "good" if e.smallest <= e.usual else "fair"), e.unit,
         e.rival or DASH, percent(e.share), number(e.named, 2, "never")]
        for e in found.effects
    ]  # fmt: skip
    head = ["effect", "by its", "usual", "smallest seen", "unit", "most like", "share", "told apart from"]
    never = f"Never seen, as links or the model's effects explain them wholly: {', '.join(found.hidden)}." if found.hidden else ""
    return [ShownSection("Effects that it could show", [
        "What the model may lack, with a usual size, and the smallest that would stand out by five standard deviations of the "
        "readings; the effect that explains most of the same trace, and the size from which the two could be told apart. Those "
        "seen worst come first.",
        fold(f"{len(rows)} effects and places", ShownTable(head, rows, "- - n n - - n n", "tight")), note(never),
    ], "Effects")]  # fmt: skip


def _coefficients(result: Excitation) -> ShownSection:
    s = result.series
    rows = [
        [name, number(float(s.centre[j]), 5), *(number(float(x), 4) for x in (*s.sine[:, j], *s.cosine[:, j]))]
        for j, name in enumerate(result.joint_names)
    ]
    head = ["joint", "c", *(f"{letter}{k + 1}" for letter in "sr" for k in range(s.harmonics))]
    period = number(s.period, 4)
    series = f"q(t) = c + Σ s<sub>k</sub> sin(2πkt / {period} s) + r<sub>k</sub> cos(2πkt / {period} s), in radians or metres."
    return ShownSection("Coefficients", [Html(f"<p>{series}</p>"), ShownTable(head, rows, style="tight")])


def _static_run(result: Excitation) -> str | None:
    run = result.static_run
    if run is None:
        return None
    text = (
        f"{len(run.rows)} stops of one period take {results.duration_text(run.seconds)}: at each the robot settles for "
        f"{number(result.options['settle'], 2)} s and is read for {number(result.options['read'], 2)} s. "
    )
    if run.every_sample:
        repeats = " Readings of one period serve every period." if result.trajectory.period else ""
        return text + "There is one at every sample of the motion, so that readings can be subtracted row by row." + repeats
    return text + "They are fewer than the samples: enter their readings as a table of poses at rest."


def _options(result: Excitation) -> list[tuple[str, str]]:
    given = {k: v for k, v in result.options.items() if v is not None}
    return [("Options", ", ".join(f"{k.replace('_', '-')} {_plain(v)}" for k, v in given.items()))]


def _plain(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, (list, tuple)):
        return " ".join(_plain(v) for v in value)
    return f"{value:g}" if isinstance(value, float) else str(value)


@figures_of.register
def _(result: Excitation | DistinguishingMotion) -> Figures:
    from bayesid.report.fit_figures import curves  # the report needs no matplotlib

    planned = result.trajectory if isinstance(result, Excitation) else result.telling.trajectory
    groups = _groups(result) if isinstance(result, Excitation) else motion_groups(planned)
    return {"motion": partial(curves, planned.times, groups)}
