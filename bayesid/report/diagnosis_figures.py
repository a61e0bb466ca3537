"""Figures of `diagnose`, and what they show: residuals by channel, time and frequency, signals, and parts of the noise floor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.colors import LinearSegmentedColormap, LogNorm
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from bayesid.diagnosis.data import DiagnosisData
from bayesid.diagnosis.description.columns import SegmentPart, parts_of
from bayesid.diagnosis.description.describe import Description
from bayesid.diagnosis.detectability import DetectableEffect, visible
from bayesid.diagnosis.locate import BANDS, by_band, by_window, places_looked_at
from bayesid.diagnosis.noise import pose_noise
from bayesid.diagnosis.push import Push
from bayesid.diagnosis.spectra import SpectralSegment
from bayesid.diagnosis.validation import residual_spectra
from bayesid.report.figures import GREY, MEASURED, NOISE, PREDICTED, add_legend, list_rows, make_grid, plain_log, styled
from bayesid.results.diagnosis import Diagnosis, shown_errors
from bayesid.signals.white_noise import quiet_noise
from bayesid.validation.prediction import Prediction

#: Colours: what is left, what is closed, what is neither.
LEFT, CLOSED, OTHER, _GRID = "#c2410c", "#0f766e", "#94a3b8", "#e2e8f0"
#: Points drawn of a term.
_OF_A_TERM = 3000
#: Recordings in the picture of residuals, and channels in the picture of signals.
_PANELS, _CHANNELS = 4, 3
#: Signals are shown below one of these frequencies, the one at which the disagreement stands out most [Hz].
_CUTS = (1.0, 3.0, 10.0)
BEFORE, AFTER = PREDICTED, "#1d4ed8"
#: What is noise is white; what is many times as large is dark.
_HEAT = LinearSegmentedColormap.from_list("heat", ["#ffffff", "#fde8d0", "#f6a55b", "#d4452a", "#7a1022", "#2a0612"])
_TOP = 10.0  # the darkest colour means at least so many times the noise
_POINTS = 1500


@styled
def waterfall(steps: Sequence[tuple[str, float]], floor: float, floor_name: str = "own fit (floor)") -> Figure:
    """A gap between a model or a reference and recordings, and what each step takes of it.

    Steps are names and mean squares, first before any step, last with everything; ``floor`` is the mean square that stays in
    any case: of the recording's own fit, or of the noise.
    """
    names = [steps[0][0], *(f"+ {name}" for name, _ in steps[1:]), floor_name]
    ends = np.array([*(value for _, value in steps), floor])
    starts = np.array([0.0, *ends[:-2], 0.0])  # each step from the last one, what was before and the floor from nothing
    figure, axes = make_grid(1, 1, 0.24 * len(names), left=0.3 + 0.066 * max(map(len, names)), right=0.9, top=0.2)
    panel, y = axes[0, 0], np.arange(len(names))
    panel.barh(y, np.minimum(starts, ends), height=0.6, color=_GRID)
    colours = [LEFT, *np.where(ends[1:-1] < starts[1:-1], CLOSED, LEFT), OTHER]
    panel.barh(y, np.abs(ends - starts), left=np.minimum(starts, ends), height=0.6, color=colours)
    for k, (start, end) in enumerate(zip(starts, ends, strict=True)):
        text = f"{np.sqrt(end):.2f}{' left' if 0 < k < len(steps) else ''}"
        panel.annotate(text, (max(start, end), k), (5, 0), textcoords="offset points", va="center")
    list_rows(panel, names)
    panel.xaxis.set_visible(False)
    panel.spines[:].set_visible(False)
    return figure


@styled
def residual_maps(views: Views, channels: Sequence[str], poses: bool) -> Figure:
    """Residuals in units of the noise: channel by time, before and after, and channel by frequency; of ``poses`` one by one."""
    panels, changed, count = views.panels, views.changed, len(channels)
    sides = 2 if changed else 1
    widths = [2.0] * sides + ([] if poses else [0.55 * sides + 0.25])
    # Below panels there are numbers and the title of the next one, below the last one bands.
    figure, axes = make_grid(len(panels), len(widths), 0.17 * count + 0.35, left=0.65, right=1.15, gap=0.5, top=0.35,
                             space=0.52, bottom=0.85, width_ratios=widths)  # fmt: skip
    top = max([_TOP, *(float(np.nanmax(ratio)) for p in panels for _, ratio, _ in p.pieces)])
    scale = LogNorm(1.0, top)
    middle, rows = np.arange(count), np.arange(count + 1) - 0.5
    mesh = None
    for line, panel in zip(axes, panels, strict=True):
        title = f"{panel.title}, {'not fitted' if panel.unseen else 'fitted'}"
        for k, ax in enumerate(line[:sides]):
            for edges, ratio, marked in panel.pieces:
                mesh = ax.pcolormesh(edges, rows, np.maximum(ratio[..., k], 1.0).T, cmap=_HEAT, norm=scale, lw=0, rasterized=True)
                at, channel = np.nonzero(marked[..., k])
                ax.plot(0.5 * (edges[at] + edges[at + 1]), middle[channel], ".", ms=2.2, color="#0f172a", mew=0)
            ax.set_title(f"{title}: {('before', 'after')[k]}" if changed else title)
            ax.xaxis.set_major_locator(MaxNLocator(8))
        if not poses:
            _by_frequency(line[-1], panel.bands, line[0] is axes[-1, 0], changed, scale)
        for ax in line:
            ax.set_yticks(middle, list(channels) if ax is line[0] else [])
            ax.set_ylim(count - 0.5, -0.5)
            ax.tick_params(axis="y", length=0)
            ax.grid(visible=False)
            ax.hlines(rows[1:-1], *ax.get_xlim(), color="#e2e8f0", lw=0.6)
    for ax in axes[-1, :sides]:
        ax.set_xlabel("pose" if poses else "time [s]")
    if not poses:
        axes[-1, -1].set_xlabel("frequency [Hz]")
    if mesh is not None:
        width, height = figure.get_size_inches()
        bar = figure.add_axes((1.0 - 0.95 / width, 0.5 - 0.6 / height, 0.13 / width, 1.2 / height))
        figure.colorbar(mesh, cax=bar)
        plain_log(bar.yaxis)
        bar.grid(visible=False)
        bar.set_title("× noise", fontsize=8.5, fontweight="normal", pad=7)
    return figure


def _by_frequency(ax: Any, banded: np.ndarray, lowest: bool, changed: bool, scale: LogNorm) -> None:
    """Residuals by band (b, c, 2), before and after beside each other; the ``lowest`` panel names the bands."""
    stacked = banded[..., 0]
    if changed:
        stacked = np.concatenate([stacked, np.full((1, stacked.shape[1]), np.nan), banded[..., 1]])
    columns, rows = (np.arange(n + 1) - 0.5 for n in stacked.shape)
    ax.pcolormesh(columns, rows, np.maximum(stacked, 1.0).T, cmap=_HEAT, norm=scale, lw=0, rasterized=True)
    bands = [f"{low:g}–{high:g}" if lowest else "" for low, high in BANDS]
    names = [*bands, "", *bands] if changed else bands
    ax.set_xticks(np.arange(len(names)), names, rotation=90, fontsize=7.5)
    ax.tick_params(axis="x", length=0)
    titles = {"left": "before", "right": "after"} if changed else {"center": "by frequency"}
    for side, text in titles.items():
        ax.set_title(text, loc=side)


@styled
def evidence(names: Sequence[str], values: np.ndarray, kinds: Sequence[str], needed: float, ax: Any = None) -> Figure:
    """How much each effect alone, best first, would add to the model's log evidence; kinds: ``named``, ``rival``, ``other``."""
    count = len(names)
    figure, axes = make_grid(1, 1, 0.21 * count + 0.15, left=0.35 + 0.066 * max(map(len, names)), right=0.8, top=0.4,
                             ax=ax)  # fmt: skip
    ax = axes[0, 0]
    colours = {"named": AFTER, "rival": "#d97706", "other": "#cbd5e1"}
    labels = {"named": "in the model now", "rival": "cannot be told from it"}
    labels["other"] = "not needed" if "named" in kinds else "tried"
    y = np.arange(count)
    low = min(1.0, 0.3 * needed)
    for kind in ("named", "rival", "other"):
        at = np.array([k == kind for k in kinds])
        if at.any():
            wide = np.maximum(values[at], low) - low
            ax.barh(y[at], wide, left=low, height=0.68, color=colours[kind], lw=0, label=labels[kind])
    ax.set_xscale("log")
    ax.set_xlim(low, 3.0 * max(values.max(), needed))
    ax.axvline(needed, color=NOISE, lw=1.3, label="least that counts")
    for k, v in zip(y, values, strict=True):
        text, place = f"{v:,.0f}".replace(",", " "), (max(v, low), k)
        ax.annotate(text, place, (4, 0), textcoords="offset points", va="center", fontsize=8, color=GREY)
    list_rows(ax, names)
    ax.set_xlabel("log evidence gained by this effect alone, beside the model as it was")
    plain_log(ax.xaxis)
    add_legend(axes)
    return figure


@styled
def channels_figure(diagnosis: Diagnosis, ax: Any = None) -> Figure:
    """What is left of each channel, before and after: in units of the noise, or where that is not known in per cent."""
    errors = shown_errors(diagnosis)
    known, changed = all(e.before.noise_known for e in errors), any(e.after is not None for e in errors)

    def sizes(predictions: Sequence[Prediction]) -> np.ndarray:
        each = [p.whitened_rms_by_channel if known else 100.0 * p.nrmse for p in predictions]
        return np.sqrt(np.mean(np.square(each), axis=0))

    ratios = np.stack([sizes([e.before for e in errors]), sizes([e.last for e in errors])], axis=1)
    channels = errors[0].before.channel_names
    figure, axes = make_grid(1, 1, 1.25, left=0.65, top=0.4, ax=ax)
    ax = axes[0, 0]
    x, width = np.arange(len(channels)), 0.36
    low = 0.5 * max(min(float(ratios.min()), 1.0), 1e-6)
    bars = [(0, "before", BEFORE), (1, "after", AFTER)] if changed else [(0, "the model as it is", BEFORE)]
    for k, label, colour in bars:
        at = x + (k - 0.5) * width if changed else x
        ax.bar(at, ratios[:, k] - low, bottom=low, width=0.94 * width, color=colour, lw=0, label=label)
        for a, v in zip(at, ratios[:, k], strict=True):
            # On white, for small bars end where the line is.
            ax.annotate(f"{v:.3g}", (a, v), (0, 2.5), textcoords="offset points", ha="center", fontsize=7.5, color=GREY,
                        bbox={"fc": "white", "ec": "none", "pad": 0.6}, zorder=5)  # fmt: skip
    if known and diagnosis.part is None:
        ax.axhline(max(e.last.expected_rms for e in errors), color=NOISE, lw=1.4, label="a complete model")
    ax.set_yscale("log")
    ax.set_ylim(low, 1.8 * max(float(ratios.max()), 1.5))
    ax.set_ylabel("× noise" if known else "% of signal")
    ax.set_xticks(x, list(channels))
    ax.tick_params(axis="x", length=0)
    ax.grid(axis="x", visible=False)
    plain_log(ax.yaxis)
    add_legend(axes)
    return figure


@styled
def signals(views: Views, poses: bool) -> Figure:
    """Measured beside predicted before and after, and what is left of each, in the channel's unit over the band of the noise."""
    figure, axes = make_grid(len(views.signals), 2, 1.15, left=0.65, top=0.5, sharex=True)
    models = [(0, BEFORE, "before"), (1, AFTER, "after")] if views.changed else [(0, BEFORE, "predicted")]
    for (whole, left), s in zip(axes, views.signals, strict=True):
        thin = slice(None, None, max(len(s.times) // _POINTS, 1))
        whole.plot(s.times[thin], s.measured[thin], color="#94a3b8", lw=2.4, label="measured")
        left.axhspan(-1.96 * s.noise, 1.96 * s.noise, color=NOISE, alpha=0.18, lw=0, label="95 % of the noise")
        for k, colour, label in models:
            whole.plot(s.times[thin], (s.measured - s.values[:, k])[thin], color=colour, lw=0.9, label=label)
            left.plot(s.times[thin], s.values[thin, k], color=colour, lw=0.9)
        left.axhline(0.0, color="#334155", lw=0.6)
        reach = max(float(np.abs(s.values[:, : len(models)]).max()), 3.0 * s.noise) * 1.08
        left.set_ylim(-reach, reach)
        whole.set_title(f"{s.channel} [{s.unit}]" + ("" if poses else f" below {s.below:g} Hz"))
        left.set_title("measured less predicted")
        for ax in (whole, left):
            ax.yaxis.set_major_locator(MaxNLocator(4))
            ax.margins(x=0.01)
    for ax in axes[-1]:
        ax.set_xlabel("pose" if poses else "time [s]")
    add_legend(axes, *axes[0])
    return figure


@styled
def push_course(push: Push) -> Figure:
    """The force of a push over time, in base axes with its 95 % band."""
    figure, axes = make_grid(1, 1, 1.5, left=0.65)
    ax, low, high = axes[0, 0], push.force - 1.96 * push.force_std, push.force + 1.96 * push.force_std
    for k, (axis, colour) in enumerate(zip(("fx", "fy", "fz"), (BEFORE, NOISE, AFTER), strict=True)):
        ax.fill_between(push.times, low[:, k], high[:, k], color=colour, alpha=0.18, lw=0)
        ax.plot(push.times, push.force[:, k], color=colour, lw=1.2, label=axis)
    ax.axhline(0.0, color="#334155", lw=0.6)
    ax.set_title("force in base axes [N]")
    ax.set_xlabel("time [s]")
    ax.margins(x=0.01)
    add_legend(axes)
    return figure


@styled
def described_figure(data: DiagnosisData, d: Description) -> Figure:
    """Each term in the reading in which it does most, on one motion: unseen, or for want of any a fitted one."""
    moving = [s for s in (data.unseen or data.segments) if not s.still]
    longest = max(moving, key=lambda s: len(s.times))
    (part,) = parts_of(data, [longest], d.fit)
    left = longest.samples(longest.measured_readings - longest.spectrum(data.predict(longest, d.fit.links, d.fit.terms)))
    figure, axes = make_grid(1, len(d.terms), 2.4, left=0.75, top=0.5, gap=0.6)
    at, thin = 0, max(len(longest.times) // _OF_A_TERM, 1)
    for ax, chosen in zip(axes[0], d.terms, strict=True):
        candidate = chosen.candidate
        values = np.array(d.term.values[at : (at := at + candidate.size)]).reshape(len(candidate.channels), -1)
        said = _said(part, part.values([candidate.shape]) @ values.T, candidate.channels)
        scale = np.sqrt(np.mean((longest.covariance[:, candidate.channels, candidate.channels]), axis=0))
        k = int(np.argmax(said.std(axis=0) / scale))
        channel = candidate.channels[k]
        rest = left[:, channel] - left[:, channel].mean()
        variable = next((v for v in candidate.shape.variables if not v.startswith("dir")), candidate.shape.variables[0])
        x = np.interp(longest.times, longest.trajectory.times, part.variables[variable])[::thin]
        ax.plot(x, (rest + said[:, k])[::thin], lw=1.8, color=MEASURED, rasterized=True, label="measured less all the rest")
        ax.plot(x, said[::thin, k], lw=0.9, color=PREDICTED, rasterized=True, label="the term")
        ax.set_title(f"{data.channels.names[channel]} [{data.channels.units[channel]}] in {longest.motion}")
        ax.set_xlabel(variable)
    add_legend(axes)
    return figure


def _said(part: SegmentPart, courses: np.ndarray, channels: tuple[int, ...]) -> np.ndarray:
    """Courses (M, k) of some channels as readings, band-limited and faded at both ends as these are compared (N, k)."""
    segment = part.segment
    made = [segment.spectrum(courses[:, k, None], np.array([c]))[:, 0] for k, c in enumerate(channels)]
    return segment.samples(np.stack(made, axis=1))


@dataclass(frozen=True, eq=False)
class ResidualPanel:
    """Residuals of one recording in units of the noise, before and after."""

    #: Which recording, and whether it took part in no fit.
    title: str
    unseen: bool
    #: For each gap-free segment: edges of the windows (w + 1,) [s], root mean squares before and after (w, c, 2), and whether
    #: they are significant (w, c, 2).
    pieces: tuple[tuple[np.ndarray, np.ndarray, np.ndarray], ...]
    bands: np.ndarray  # root mean squares by band (b, c, 2)


@dataclass(frozen=True, eq=False)
class SignalView:
    """What was measured in one channel, and measured less predicted before and after."""

    #: What is shown.
    channel: str
    unit: str
    motion: str
    #: (N,) [s], (N,) and (N, 2).
    times: np.ndarray
    measured: np.ndarray
    values: np.ndarray
    noise: float  # standard deviation that sensor and encoders leave in the same band
    below: float  # highest frequency shown [Hz]


@dataclass(frozen=True, eq=False)
class Views:
    """All that the report shows beside the diagnosis itself."""

    #: What each picture shows, see their classes.
    panels: tuple[ResidualPanel, ...]
    signals: tuple[SignalView, ...]
    visible: tuple[DetectableEffect, ...]
    changed: bool  # whether a model other than the user's was fitted, so that there is an "after"


def diagnosis_views(diagnosis: Diagnosis) -> Views:
    """Evaluate both models on all recordings."""
    data, s = diagnosis.data, diagnosis.search
    pairs = [
        (segment, np.stack(both, axis=-1), unseen)
        for segments, unseen in ((data.segments, False), (data.unseen, True)) if segments
        for segment, *both in zip(segments, *(residual_spectra(data, segments, fit) for fit in (s.base, s.best)), strict=True)
    ]  # fmt: skip
    judged = [p for p in pairs if p[2]] or pairs
    return Views(
        panels=_panels(pairs, s.noise_level),
        signals=_signals(diagnosis, judged),
        visible=() if s.library is None else visible(s.library, s.dispersion),
        changed=s.best is not s.base and len(s.best.terms) > len(s.base.terms),
    )


def _panels(pairs: list[tuple[SpectralSegment, np.ndarray, bool]], level: float) -> tuple[ResidualPanel, ...]:
    """Moving recordings first, fitted ones before unseen ones; then the runs at rest."""
    looked = {unseen: places_looked_at([s for s, _, u in pairs if u == unseen]) for unseen in (False, True)}
    groups: dict[tuple[str, bool], list[tuple[SpectralSegment, np.ndarray, bool]]] = {}
    for pair in pairs:
        groups.setdefault((pair[0].motion, pair[0].still), []).append(pair)
    order = sorted(groups, key=lambda k: (k[1], groups[k][0][2]))
    moving = [k for k in order if not k[1]]
    fitted, unseen = ([k for k in moving if groups[k][0][2] == u] for u in (False, True))
    room = max(_PANELS - 1 - min(len(unseen), 2), 1)
    chosen = [*fitted[:room], *unseen[:2]]
    chosen += [k for k in order if k not in chosen and not groups[k][0][2]][: _PANELS - len(chosen)]
    out = []
    for motion, still in chosen:
        group = groups[motion, still]
        pieces = []
        for s, w, u in group:
            sides = [by_window(s, w[..., k], 1.0, looked[u]) for k in (0, 1)]
            marks = [by_window(s, w[..., k], level, looked[u])[3] < s.settings.level for k in (0, 1)]
            at = sides[0][0]
            edges = at + 0.5 if s.apart else s.times[np.minimum(at, len(s.times) - 1)]  # poses are counted from one
            ratio = np.stack([np.sqrt(energy / freedom) for _, energy, freedom, _ in sides], axis=-1)
            pieces.append((edges, ratio, np.stack(marks, axis=-1)))
        counts = np.array([len(w) for _, w, _ in group], float)
        squares = np.stack([np.stack([by_band(s, w[..., k]) for k in (0, 1)], axis=-1) ** 2 for s, w, _ in group])
        bands = np.sqrt(np.average(squares, axis=0, weights=counts))
        title = f"{motion}, the run at rest" if still and not group[0][0].apart else motion
        out.append(ResidualPanel(title, group[0][2], tuple(pieces), bands))
    return tuple(out)


def _signals(diagnosis: Diagnosis, judged: list[tuple[SpectralSegment, np.ndarray, bool]]) -> tuple[SignalView, ...]:
    """The channels that disagreed most, on the recording on which they did."""
    channels = diagnosis.data.channels
    moving = [p for p in judged if not p[0].still] or judged
    energy = np.sum([np.sum(w[..., 0] ** 2, axis=0) for _, w, _ in judged], axis=0)
    worst = np.argsort(-energy)[:_CHANNELS]
    # One recording for all of them: the one with the largest residual.
    s, w, _ = max(moving, key=lambda p: float(np.mean(p[1][..., 0] ** 2)))
    root = np.linalg.cholesky(s.covariance)
    left = np.matmul(root, w)  # the residual's coefficients in the channels' units (K, c, 2)
    out = []
    for c in np.sort(worst):
        variance = s.covariance[:, c, c]
        cuts = [f for f in _CUTS if f <= s.frequencies[-1] * 1.05] or [float(s.frequencies[-1])]
        inside = {f: s.frequencies <= f for f in cuts}
        below = max(cuts, key=lambda f: float(np.sum(left[inside[f], c, 0] ** 2) / np.sum(variance[inside[f]])))
        kept = np.where(inside[below][:, None], np.column_stack([s.measured_readings[:, c], left[:, c]]), 0.0)
        course = s.samples(kept)
        noise = float(np.sqrt(np.sum(variance[inside[below]]) / len(s.times)))
        out.append(
            SignalView(
                channels.names[c], channels.units[c], s.motion, s.times + s.apart, course[:, 0], course[:, 1:], noise, below
            )
        )
    return tuple(out)


def noise_parts(data: DiagnosisData) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Where the noise floor of each channel comes from, as standard deviations (c,).

    Of the measurement noise in one sample, and of what of it, and of the encoders' noise in the prediction, falls into the band
    that is compared.
    """
    moving = [s for s in (*data.segments, *data.unseen) if not s.still or s.apart]
    sample = pose_noise(data) if moving[0].apart else quiet_noise([s.readings for s in moving])
    count = sum(len(s.times) for s in moving)
    band = np.sum([len(s.frequencies) * np.mean(s.weight(s.times) ** 2, axis=0) for s in moving], axis=0) / count
    total = np.sum([np.einsum("kcc->c", s.covariance) for s in moving], axis=0) / count
    sensor = sample**2 * band
    return sample, np.sqrt(sensor), np.sqrt(np.maximum(total - sensor, 0.0))
