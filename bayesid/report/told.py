"""The report of ``excite --tell``: turns a `DistinguishingMotion` into what its template shows."""

from __future__ import annotations

import numpy as np
from markupsafe import Markup

from bayesid.design.tell.choose import Telling
from bayesid.report.excitation_figures import motion, motion_panels
from bayesid.report.page import render, run_times, versions
from bayesid.results.telling import chance, duration
from bayesid.results.text import number, percent
from bayesid.results.told import TRAJECTORY, DistinguishingMotion


def pair_rows(telling: Telling) -> list[dict[str, str]]:
    """A row for each rival as the true one and each other."""
    return [
        {"true": p.true, "other": p.other, "noncentrality": number(p.noncentrality, 3), "gain": number(p.gain, 3),
         "std": number(p.std, 2), "probability": chance(p.probability)}
        for p in telling.pairs
    ]  # fmt: skip


def panels_of(telling: Telling) -> list[tuple[str, str, list[str], np.ndarray]]:
    """Panels of the motion: positions, velocities and accelerations of the joints."""
    t = telling.trajectory
    parts = [("joint positions", "rad or m", t.positions), ("joint velocities", "per s", t.velocities),
             ("joint accelerations", "per s²", t.accelerations)]  # fmt: skip
    return motion_panels(parts, {})


def motion_plot(telling: Telling) -> Markup:
    """The same as a figure of a report."""
    return motion(telling.trajectory.times, panels_of(telling))


def told_report(result: DistinguishingMotion) -> str:
    """The report of ``excite --tell``: an HTML page with all figures inside."""
    t = result.telling
    return render(
        "told.html",
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
