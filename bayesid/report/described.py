"""The report's section on a description: rows, sentences, and the numbers behind its picture."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from bayesid.diagnosis.data import DiagnosisData
from bayesid.diagnosis.description.columns import SegmentPart, parts_of
from bayesid.diagnosis.description.describe import Description
from bayesid.report.figures import MEASURED, PREDICTED, add_legend, make_grid, styled
from bayesid.report.page import svg
from bayesid.results.described import not_distinguished, shares, terms_of, use_line
from bayesid.results.text import percent

#: Points drawn of a recording.
_POINTS = 3000


@styled
def described(panels: Sequence[tuple[str, str, np.ndarray, np.ndarray, np.ndarray]]) -> Figure:
    """One panel a term.

    Parameters
    ----------
    panels
        Title, name of the variable, its values (N,), what was measured less all the rest (N,), and what the term says (N,).
    """
    figure, axes = make_grid(1, len(panels), 2.4, left=0.75, top=0.5, gap=0.6)
    for ax, (title, variable, x, measured, said) in zip(axes[0], panels, strict=True):
        thin = max(len(x) // _POINTS, 1)
        ax.plot(x[::thin], measured[::thin], lw=1.8, color=MEASURED, rasterized=True, label="measured less all the rest")
        ax.plot(x[::thin], said[::thin], lw=0.9, color=PREDICTED, rasterized=True, label="the term")
        ax.set_title(title)
        ax.set_xlabel(variable)
    add_legend(axes, *axes[0, 0].get_legend_handles_labels())
    return figure


#: Other formulas that a line lists.
_LISTED = 8


def described_section(data: DiagnosisData, description: Description) -> dict[str, Any]:
    """What the template shows."""
    d, names = description, data.channels.names
    terms = [
        {
            "formula": ", ".join(c.candidate.shape.texts),
            "share": percent(min(c.share, 1.0)), "low": percent(min(c.share_low, 1.0)),
            "causes": list(causes), "others": (others := not_distinguished(c))[:_LISTED], "more": max(len(others) - _LISTED, 0),
        }
        for c, causes in zip(d.terms, d.causes, strict=True)
    ]  # fmt: skip
    return {
        "rows": terms_of(d, names), "terms": terms, "beside": [t.effect.spec for t in d.start.terms], "shares": shares(d),
        "unseen": d.gap is not None, "use": use_line(d), "candidates": d.candidates,
        "picture": svg(_picture(data, d), "described"),
    }  # fmt: skip


def _picture(data: DiagnosisData, d: Description):
    """Each term in the reading in which it does most, on one motion: unseen, or for want of any a fitted one."""
    moving = [s for s in (data.unseen or data.segments) if not s.still]
    longest = max(moving, key=lambda s: len(s.times))
    (part,) = parts_of(data, [longest], d.fit)
    left = longest.samples(longest.measured_readings - longest.spectrum(data.predict(longest, d.fit.links, d.fit.terms)))
    panels, at = [], 0
    for chosen in d.terms:
        candidate = chosen.candidate
        values = np.array(d.term.values[at : (at := at + candidate.size)]).reshape(len(candidate.channels), -1)
        said = _said(part, part.values([candidate.shape]) @ values.T, candidate.channels)
        scale = np.sqrt(np.mean((longest.covariance[:, candidate.channels, candidate.channels]), axis=0))
        k = int(np.argmax(said.std(axis=0) / scale))
        channel = candidate.channels[k]
        rest = left[:, channel] - left[:, channel].mean()
        variable = next((v for v in candidate.shape.variables if not v.startswith("dir")), candidate.shape.variables[0])
        x = np.interp(longest.times, longest.scene.times, part.variables[variable])
        title = f"{data.channels.names[channel]} [{data.channels.units[channel]}] in {longest.motion}"
        panels.append((title, variable, x, rest + said[:, k], said[:, k]))
    return described(panels)


def _said(part: SegmentPart, courses: np.ndarray, channels: tuple[int, ...]) -> np.ndarray:
    """Courses (M, k) of some channels as readings, band-limited and faded at both ends as these are compared (N, k)."""
    segment = part.segment
    made = [segment.spectrum(courses[:, k, None], np.array([c]))[:, 0] for k, c in enumerate(channels)]
    return segment.samples(np.stack(made, axis=1))
