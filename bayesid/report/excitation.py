"""The report of ``excite``: turns an `Excitation` into what its template shows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from markupsafe import Markup

from bayesid.arguments import argument
from bayesid.design.tell.choose import Telling
from bayesid.report.charts import WIDTH, Panel, chart, key, key_width, limits, text_width, write
from bayesid.report.check import recording
from bayesid.report.page import render, run_times, versions
from bayesid.results.distinguishing import TRAJECTORY, DistinguishingMotion
from bayesid.results.excitation import Excitation, duration_text
from bayesid.results.telling import chance, duration
from bayesid.results.text import DASH, number, percent

_PLOTTED = 1000
_ROW, _BEST, _OTHER, _OVER = 15.0, "#1d4ed8", "#94a3b8", "#b91c1c"


def motion(times: np.ndarray, panels: Sequence[tuple[str, str, list[str], np.ndarray]]) -> Markup:
    """The motion in time (N,) [s]; panels as `motion_panels` makes them."""
    stride = max(-(-len(times) // _PLOTTED), 1)
    thinned = [(title, unit, names, values[::stride]) for title, unit, names, values in panels]
    return recording(times[::stride], thinned, [], False)


def motion_panels(
    parts: Sequence[tuple[str, str, np.ndarray]], loads: Mapping[str, tuple[tuple[str, ...], np.ndarray]]
) -> list[tuple[str, str, list[str], np.ndarray]]:
    """Title, unit, names and values of each panel: joint positions and rates, joint torques and the sensor's readings.

    Parameters
    ----------
    parts
        Title, unit and values (N, n) of positions, velocities and accelerations.
    loads
        Names and values (N, c), by ``torque`` and ``wrench``.
    """
    names = [f"q{j + 1}" for j in range(parts[0][2].shape[1])]
    panels = [(title, unit, names, values) for title, unit, values in parts]
    if "torque" in loads:
        panels.append(("joint torques of the nominal links", "N m", list(loads["torque"][0]), loads["torque"][1]))
    if "wrench" in loads:
        channels, values = loads["wrench"]
        panels.append(("forces on the sensor", "N", list(channels[:3]), values[:, :3]))
        panels.append(("moments on the sensor", "N m", list(channels[3:]), values[:, 3:]))
    return panels


def limit_shares(rows: Sequence[tuple[str, str, float]]) -> Markup:
    """How much of every limit a motion uses, as bars.

    Parameters
    ----------
    rows
        Kind, joint or channel, and share.
    """
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
    """The criterion of the motion beside that of random motions within the same limits.

    Parameters
    ----------
    value, others
        Larger is better.
    label
        What the axis shows.
    """
    names = [f"{len(others)} random motions", "this motion"]
    places = np.cumsum([0.0, key_width(names[0])])
    panel = Panel(30.0, 24.0, WIDTH - 60.0, 46.0, limits([np.append(others, value)], 0.05), (0.0, 1.0))
    spread = 0.2 + 0.6 * (np.arange(len(others)) * 0.618034 % 1.0)  # so that dots do not hide each other
    parts = [panel.frame("", label, y_axis=False), panel.dots(others, spread, _OTHER), panel.stroke(value, 0.5, 0.9, _BEST)]
    parts += [key(30.0 + x, 10.0, n, c, 4.0) for x, n, c in zip(places, names, (_OTHER, _BEST), strict=True)]
    return chart(104.0, parts)


def pair_rows(telling: Telling) -> list[dict[str, str]]:
    """A row for each rival as the true one and each other."""
    return [
        {"true": p.true, "other": p.other, "noncentrality": number(p.noncentrality, 3), "gain": number(p.gain, 3),
         "std": number(p.std, 2), "probability": chance(p.probability)}
        for p in telling.pairs
    ]  # fmt: skip


def telling_panels(telling: Telling) -> list[tuple[str, str, list[str], np.ndarray]]:
    """Panels of the motion: positions, velocities and accelerations of the joints."""
    t = telling.trajectory
    parts = [("joint positions", "rad or m", t.positions), ("joint velocities", "per s", t.velocities),
             ("joint accelerations", "per s²", t.accelerations)]  # fmt: skip
    return motion_panels(parts, {})


def motion_plot(telling: Telling) -> Markup:
    """The same as a figure of a report."""
    return motion(telling.trajectory.times, telling_panels(telling))


def distinguishing_report(result: DistinguishingMotion) -> str:
    """The report of ``excite --tell``: an HTML page with all figures inside."""
    t = result.telling
    return render(
        "distinguishing.html",
        name=result.name,
        lead=result.lead,
        file=TRAJECTORY,
        card_list=[
            {"value": chance(t.probability), "mood": "good" if t.probability > 0.8 else "bad",
             "text": "probability that the true one alone is left"},
            {"value": chance(t.wrong), "mood": "", "text": "probability that a wrong one is"},
            {"value": duration(t), "mood": "", "text": t.label},
            {"value": str(t.tried), "mood": "", "text": "motions compared"},
        ],
        rivals=[{"name": n, "weight": percent(w, 2)} for n, w in zip(t.rivals, t.weights, strict=True)],
        estimated=t.estimated,
        recordings=", ".join(result.recordings),
        pairs=pair_rows(t),
        motion=motion_plot(t),
        notes=t.notes,
        details=[run_times(result.seconds), versions("numpy", "scipy", "pin")],
    )  # fmt: skip


_TITLES = {
    "position": "position of", "velocity": "speed of", "acceleration": "acceleration of", "torque": "torque of",
    "wrench": "sensor", "collision": "distance of",
}  # fmt: skip


def panels_of(result: Excitation) -> list[tuple[str, str, list[str], np.ndarray]]:
    """Panels of the motion, as `motion_panels` makes them."""
    t = result.trajectory
    units = ("m",) if result.prismatic.all() else ("rad",) if not result.prismatic.any() else ("rad", "m")
    titles = (("joint positions", ""), ("joint velocities", "/s"), ("joint accelerations", "/s²"))
    values = (t.positions, t.velocities, t.accelerations)
    parts = [(title, " or ".join(u + per for u in units), v) for (title, per), v in zip(titles, values, strict=True)]
    return motion_panels(parts, result.loads)


def excitation_report(result: Excitation) -> str:
    """The report of ``excite``: an HTML page with all figures inside."""
    shares = [(_TITLES[u.kind], u.where, u.ratio) for u in result.limits if u.kind != "collision"]
    axis = {"d": "mean logarithm of the eigenvalues of the information, larger is better"}.get(
        result.criterion, "logarithm of the criterion, larger is better"
    )
    return render(
        "excitation.html",
        name=result.name,
        warning_list=_warnings(result),
        lead=_lead(result),
        card_list=_cards(result),
        motion=motion(result.trajectory.times, panels_of(result)),
        shares=limit_shares(shares),
        random=beside_random(result.value, result.random, axis) if len(result.random) else None,
        limits=[
            {"kind": _TITLES[u.kind], "where": u.where, "reached": number(u.reached, 4), "limit": number(u.limit, 4),
             "unit": u.unit, "share": percent(u.ratio) if u.kind != "collision" else DASH, "kept": u.kept}
            for u in result.limits
        ],
        parameters=[
            {"label": label, "unit": unit, "std": number(float(std), 3)}
            for label, unit, std in zip(result.base.labels, result.base.units, result.std, strict=True)
        ],
        effects=_effects(result),
        hidden=", ".join(result.diagnosability.hidden) if result.diagnosability else "",
        quantities=[{"name": name, "unit": unit, "std": number(std, 3)} for name, unit, std in result.quantities],
        joints=[
            {"name": name, "centre": number(float(result.series.centre[j]), 5),
             "sine": [number(float(x), 4) for x in result.series.sine[:, j]],
             "cosine": [number(float(x), 4) for x in result.series.cosine[:, j]]}
            for j, name in enumerate(result.joint_names)
        ],
        period=number(result.series.period, 4),
        harmonics=range(1, result.series.harmonics + 1),
        blocks=[
            {"name": b.trajectory.name, "shows": b.shows,
             "length": f"{len(b.trajectory.times)} poses" if b.trajectory.kind == "poses" else duration_text(b.seconds)}
            for b in result.blocks
        ],
        static_run=_static_run(result),
        notes=result.notes,
        details=[*_options(result), run_times(result.seconds), versions("numpy", "scipy", "pin")],
    )  # fmt: skip


def _warnings(result: Excitation) -> list[str]:
    out = [f"The limit of {_TITLES[u.kind]} {u.where} is not kept." for u in result.limits if not u.kept]
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


def _cards(result: Excitation) -> list[dict[str, Any]]:
    cards = [
        {"value": f"{result.base.rank} of {result.possible}", "mood": "good" if result.base.rank == result.possible else "bad",
         "text": "base parameters determined"},
        {"value": number(result.condition_number, 3), "mood": "", "text": "condition number, whitened, columns of unit length"},
        {"value": "yes" if result.within_limits else "no", "mood": "good" if result.within_limits else "bad",
         "text": "within all limits, at ten times the recorded rate"},
    ]  # fmt: skip
    if len(result.random):
        what = "condition number" if result.criterion == "condition" else "typical standard deviation"
        cards.append({"value": f"{number(result.gain, 2)} ×", "mood": "good" if result.gain > 1 else "fair",
                      "text": f"smaller {what} than the best of {len(result.random)} random motions"})  # fmt: skip
    return cards


def _effects(result: Excitation) -> list[dict[str, str]]:
    if result.diagnosability is None:
        return []
    return [
        {"effect": e.spec, "parameter": e.parameter, "unit": e.unit, "usual": number(e.usual, 2),
         "smallest": number(e.smallest, 2), "rival": e.rival or DASH, "share": percent(e.share),
         "named": number(e.named, 2) if np.isfinite(e.named) else "never", "mood": "good" if e.smallest <= e.usual else "fair"}
        for e in result.diagnosability.effects
    ]  # fmt: skip


def _static_run(result: Excitation) -> str | None:
    run = result.static_run
    if run is None:
        return None
    text = (
        f"{len(run.rows)} stops of one period take {duration_text(run.seconds)}: at each the robot settles for "
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
