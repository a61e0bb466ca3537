"""The report of ``excite``: turns an `Excitation` into what its template shows."""

from __future__ import annotations

from typing import Any

import numpy as np

from bayesid.arguments import argument
from bayesid.report.excitation_figures import beside_random, limit_shares, motion, motion_panels
from bayesid.report.page import render, run_times, versions
from bayesid.results.excitation import Excitation, duration_text
from bayesid.results.text import DASH, number, percent

_TITLES = {
    "position": "position of", "velocity": "speed of", "acceleration": "acceleration of", "torque": "torque of",
    "wrench": "sensor", "collision": "distance of",
}  # fmt: skip


def panels_of(result: Excitation) -> list[tuple[str, str, list[str], np.ndarray]]:
    """Panels of the motion, as `bayesid.report.excitation_figures.motion_panels`."""
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
