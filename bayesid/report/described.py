"""The report's section on a description."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from bayesid.diagnosis.data import DiagnosisData
from bayesid.diagnosis.description.columns import SegmentPart, parts_of
from bayesid.diagnosis.description.describe import Description
from bayesid.report.figures import MEASURED, PREDICTED, add_legend, make_grid, styled
from bayesid.report.page import bullets, figure, note, svg
from bayesid.results.described import not_distinguished, shares, terms_of, use_line
from bayesid.results.text import percent
from bayesid.section import ShownSection, ShownTable

#: Points drawn of a recording.
_POINTS = 3000


@styled
def described_figure(panels: Sequence[tuple[str, str, np.ndarray, np.ndarray, np.ndarray]]) -> Figure:
    """Draw each term in a panel of its own.

    A panel is its title, name of the variable, its values (N,), what was measured less all the rest (N,), and what the term
    says (N,).
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


def described_section(data: DiagnosisData, description: Description) -> ShownSection:
    """What goes with what no effect explains, by formulas."""
    d = description
    rows = [[reading, value, half, text, unit] for reading, text, value, half, unit in terms_of(d, data.channels.names)]
    these = "these go" if len(d.terms) > 1 else "this one goes"
    beside = f", beside {', '.join(t.effect.spec for t in d.start.terms)}" if d.start.terms else ""
    terms = []
    for c, causes in zip(d.terms, d.causes, strict=True):
        others = not_distinguished(c)
        more = f" and {len(others) - _LISTED} more" if len(others) > _LISTED else ""
        rivals = f"{', '.join(f'`{o}`' for o in others[:_LISTED])}{more}: these do as well there." if others else ""
        share, low = percent(min(c.share, 1.0)), percent(min(c.share_low, 1.0))
        terms.append(
            f"`{', '.join(c.candidate.shape.texts)}` closes {share} of what was left on the other half (at least {low}). "
            f"**It may be** {'; or '.join(causes)}. **It cannot be told from** {rivals or 'nothing else that was tried.'}"
        )
    unseen = ", on a motion that was not fitted." if d.gap is not None else "."
    return ShownSection("Described, not named", [
        f"Of {d.candidates} short formulas of positions, speeds, loads and time {these} with what no effect of the library "
        f"explains{beside}. Chosen on one half of the recordings, tested on the other, then fitted to all. The draft: "
        f"{shares(d)}.",
        ShownTable(["reading", "amplitude", "± (95 %)", "times", "unit of the amplitude"], rows, "kb nb n - u", "narrow"),
        bullets(terms),
        figure(svg(_picture(data, d), "described"),
               "What was measured less all the rest of the model, and what the term says, over the term's own "
               f"variable{unseen}"),
        note(f"A description is no name: another cause can leave the same trace. `{use_line(d)}`"),
    ], "Described")  # fmt: skip


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
    return described_figure(panels)


def _said(part: SegmentPart, courses: np.ndarray, channels: tuple[int, ...]) -> np.ndarray:
    """Courses (M, k) of some channels as readings, band-limited and faded at both ends as these are compared (N, k)."""
    segment = part.segment
    made = [segment.spectrum(courses[:, k, None], np.array([c]))[:, 0] for k, c in enumerate(channels)]
    return segment.samples(np.stack(made, axis=1))
