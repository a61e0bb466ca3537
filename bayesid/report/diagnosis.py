"""The report of ``diagnose``."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from markupsafe import Markup
from matplotlib.figure import Figure

from bayesid.diagnosis.data import WHITE, Episode
from bayesid.diagnosis.locate import BANDS, Disagreement, by_band, by_window, places_looked_at
from bayesid.diagnosis.noise import pose_noise
from bayesid.diagnosis.push import Push
from bayesid.diagnosis.remarks import by_kind
from bayesid.diagnosis.residual_floor import SOURCES
from bayesid.diagnosis.rivals import Found
from bayesid.diagnosis.separation import Visible, visible
from bayesid.diagnosis.spectra import Segment, sensor_noise
from bayesid.diagnosis.validation import residual_spectra
from bayesid.effects import Effect
from bayesid.report.described import described_section
from bayesid.report.diagnosis_figures import before_and_after, evidence, push_course, residual_maps, signals, waterfall
from bayesid.report.excitation import PAIRS, motion_plot
from bayesid.report.identification import mood_of
from bayesid.report.page import note, render, svg, versions
from bayesid.results.diagnosis_text import (
    known_share,
    notes,
    parameter_rows,
    part_sentence,
    share_range,
    shown_errors,
    steady_sentence,
    validation_sentence,
    verdict_sentence,
    worded,
)
from bayesid.results.findings import Findings
from bayesid.results.section import as_html
from bayesid.results.telling import pair_table
from bayesid.results.text import DASH, chance, channel_text, number, percent
from bayesid.validation.own_fit import MotionErrors
from bayesid.validation.prediction import Prediction

#: Recordings in the picture of residuals, and channels in the picture of signals.
_PANELS, _CHANNELS = 4, 3
#: Signals are shown below one of these frequencies, the one at which the disagreement stands out most [Hz].
_CUTS = (1.0, 3.0, 10.0)


@dataclass(frozen=True, eq=False)
class ResidualPanel:
    """Residuals of one recording in units of the noise, before and after.

    Attributes
    ----------
    title, unseen
        Which recording, and whether it took part in no fit.
    pieces
        For each gap-free segment: edges of the windows (w + 1,) [s], root mean squares before and after (w, c, 2), and
        whether they are significant (w, c, 2).
    bands
        Root mean squares by band (b, c, 2).
    """

    title: str
    unseen: bool
    pieces: tuple[tuple[np.ndarray, np.ndarray, np.ndarray], ...]
    bands: np.ndarray


@dataclass(frozen=True, eq=False)
class SignalView:
    """What was measured in one channel, and measured less predicted before and after.

    Attributes
    ----------
    channel, unit, motion
        What is shown.
    times, measured, values
        (N,) [s], (N,) and (N, 2).
    noise
        Standard deviation that sensor and encoders leave in the same band.
    below
        Highest frequency shown [Hz].
    """

    channel: str
    unit: str
    motion: str
    times: np.ndarray
    measured: np.ndarray
    values: np.ndarray
    noise: float
    below: float


@dataclass(frozen=True, eq=False)
class Noise:
    """Where the noise floor of a channel comes from.

    Attributes
    ----------
    channel, unit
        What is shown.
    sample
        Standard deviation of the sensor's noise in one sample.
    sensor, encoders
        What of it, and of the encoders' noise in the prediction, falls into the band that is compared.
    """

    channel: str
    unit: str
    sample: float
    sensor: float
    encoders: float


@dataclass(frozen=True, eq=False)
class Views:
    """All that the report shows beside the diagnosis itself.

    Attributes
    ----------
    panels, signals, noise, visible
        What each picture shows, see their classes.
    bands
        Their limits [Hz].
    changed
        Whether a model other than the user's was fitted, so that there is an "after".
    """

    panels: tuple[ResidualPanel, ...]
    signals: tuple[SignalView, ...]
    noise: tuple[Noise, ...]
    visible: tuple[Visible, ...]
    bands: tuple[tuple[float, float], ...]
    changed: bool


def diagnosis_views(diagnosis: Findings) -> Views:
    """Evaluate both models on all recordings."""
    data, s = diagnosis.data, diagnosis.search
    sides = []
    for segments in (data.segments, data.unseen):
        sides.append([residual_spectra(data, segments, fit) for fit in (s.base, s.best)] if segments else [[], []])
    pairs = [
        (segment, np.stack([before, after], axis=-1), unseen)
        for segments, (b, a), unseen in zip((data.segments, data.unseen), sides, (False, True), strict=True)
        for segment, before, after in zip(segments, b, a, strict=True)
    ]  # fmt: skip
    judged = [p for p in pairs if p[2]] or pairs
    return Views(
        panels=_panels(pairs, diagnosis.noise_level),
        signals=_signals(diagnosis, judged),
        noise=_noise(diagnosis),
        visible=() if s.library is None else visible(s.library),
        bands=BANDS,
        changed=s.best is not s.base and len(s.best.terms) > len(s.base.terms),
    )


def _panels(pairs: list[tuple[Segment, np.ndarray, bool]], level: float) -> tuple[ResidualPanel, ...]:
    """Moving recordings first, fitted ones before unseen ones; then the runs at rest."""
    looked = {unseen: places_looked_at([s for s, _, u in pairs if u == unseen]) for unseen in (False, True)}
    groups: dict[tuple[str, bool], list[tuple[Segment, np.ndarray, bool]]] = {}
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
            edges = s.times[np.minimum(sides[0][0], len(s.times) - 1)]
            ratio = np.stack([np.sqrt(energy / freedom) for _, energy, freedom, _ in sides], axis=-1)
            pieces.append((edges, ratio, np.stack(marks, axis=-1)))
        counts = np.array([len(w) for _, w, _ in group], float)
        squares = np.stack([np.stack([by_band(s, w[..., k]) for k in (0, 1)], axis=-1) ** 2 for s, w, _ in group])
        bands = np.sqrt(np.average(squares, axis=0, weights=counts))
        title = f"{motion}, the run at rest" if still else motion
        out.append(ResidualPanel(title, group[0][2], tuple(pieces), bands))
    return tuple(out)


def _signals(diagnosis: Findings, judged: list[tuple[Segment, np.ndarray, bool]]) -> tuple[SignalView, ...]:
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
        out.append(SignalView(channels.names[c], channels.units[c], s.motion, s.times, course[:, 0], course[:, 1:], noise, below))
    return tuple(out)


def _noise(diagnosis: Findings) -> tuple[Noise, ...]:
    data = diagnosis.data
    moving = [s for s in (*data.segments, *data.unseen) if not s.still or s.apart]
    sample = pose_noise(data) if moving[0].apart else sensor_noise(moving)
    count = sum(len(s.times) for s in moving)
    band = np.sum([len(s.frequencies) * np.mean(s.weight(s.times) ** 2, axis=0) for s in moving], axis=0) / count
    total = np.sum([np.einsum("kcc->c", s.covariance) for s in moving], axis=0) / count
    sensor = sample**2 * band
    return tuple(
        Noise(name, unit, float(sample[c]), float(np.sqrt(sensor[c])), float(np.sqrt(max(total[c] - sensor[c], 0.0))))
        for c, (name, unit) in enumerate(zip(data.channels.names, data.channels.units, strict=True))
    )


#: Bars in the picture of the evidence, lines in the table of parameters that moved.
_BARS, _SHIFTS = 14, 12
#: Two traces that share more than this part of their energy look alike until the effect is large.
_ALIKE = 0.99
_VERDICTS = {
    "named": ("named", "good"),
    "named_in_part": ("named in part", "fair"),
    "ambiguous": ("ambiguous", "fair"),
    "unknown": ("unknown", "bad"),
    "nothing_missing": ("nothing missing", "good"),
}


def diagnosis_report(diagnosis: Findings) -> str:
    """The report of ``diagnose``: HTML with all figures inside."""
    views = diagnosis_views(diagnosis)
    text = _sentences(diagnosis)
    d, data = diagnosis, diagnosis.data
    channels = data.channels.names
    fitted = list(dict.fromkeys(s.motion for s in data.segments))
    changed = views.changed
    proposals = _proposals(d)
    shown = [p for p in proposals if p["evidence"] > 0][:_BARS]
    seen = _seen(views)
    curves = [(f"{s.channel} [{s.unit}] below {s.below:g} Hz", s.times, s.measured, s.values, s.noise) for s in views.signals]
    return render(
        "diagnosis.html",
        name=data.experiment.name,
        channel=channel_text(data.channel),
        fitted=fitted,
        unseen=[] if d.gap is None else d.gap.motions,
        verdict=d.verdict,
        verdict_text=_VERDICTS[d.verdict],
        text=text,
        known=[t.effect.spec for t in d.search.base.terms],
        card_list=_cards(d, text),
        remarks=text["notes"],
        changed=changed,
        maps=svg(_maps(channels, views), "maps"),
        still=any("at rest" in p.title for p in views.panels),
        torque=data.channel != "wrench",
        where=[_place(w) for w in d.where],
        evidence=svg(
            evidence([p["spec"] for p in shown], np.array([p["evidence"] for p in shown]), [p["kind"] for p in shown], d.needed),
            "evidence",
        ) if shown else "",
        proposals=[_line(p) for p in proposals],
        found=[_rivals(f) for f in d.found],
        stays=[_place(w) for w in d.remainder],
        part=_part(d),
        runner_up=_runner_up(proposals) if len(d.found) == 1 else None,
        needed=f"{d.needed:g}",
        shifts=[_shift(s) for s in d.shifts[:_SHIFTS]],
        more_shifts=max(len(d.shifts) - _SHIFTS, 0),
        exact=data.prior is None,
        bars=svg(_bars(d), "bars") if d.errors else "",
        noise_known=all(e.before.noise_known for e in d.errors),
        signals=svg(signals(curves, changed), "signals"),
        errors=[_errors(e) for e in d.errors],
        error_channels=[{"name": n, "unit": u} for n, u in zip(channels, data.channels.units, strict=True)],
        signal_motion=views.signals[0].motion,
        seen=seen,
        every=[_visible(v) for v in views.visible],
        look_alikes=_look_alikes(views),
        noise=[
            {"channel": n.channel, "unit": n.unit, "sample": number(n.sample, 3), "sensor": number(n.sensor, 3),
             "encoders": number(n.encoders, 3), "whole": number(float(np.hypot(n.sensor, n.encoders)), 3)}
            for n in views.noise
        ],
        white=text["floor_is_white"],
        floor_text=text["floor"],
        dispersion=number(float(np.sqrt(d.search.dispersion)), 3),
        overdispersed=d.search.dispersion > 1.05,
        described=None if d.description is None else described_section(data, d.description),
        next_experiment=d.next_experiment,
        next_motion="" if d.telling is None else motion_plot(d.telling),
        pairs="" if d.telling is None else Markup(as_html([pair_table(d.telling), note(PAIRS)])),
        how=_how(d),
    )  # fmt: skip


def _sentences(d: Findings) -> dict[str, Any]:
    """What the report says in sentences, by part."""
    return {
        "verdict": verdict_sentence(d),
        "validation": validation_sentence(d),
        "effects": [
            {"name": worded(f.term.effect, d), "spec": f.term.effect.spec, "summary": f.term.effect.summary,
             "motion": f.term.motion if isinstance(f.term, Episode) else "", "rows": parameter_rows(d, k),
             "steady": steady_sentence(f, d), "share": "" if d.part is None or d.shares(k) is None else share_range(d, k),
             "course": _course(f)}
            for k, f in enumerate(d.found)
        ],
        "notes": notes(d),
        "tried": by_kind(f.term for f in d.search.found),
        "closed": "" if d.gap is None else known_share(d.gap.closed),
        "floor": SOURCES[d.data.floor_source],
        "floor_is_white": d.data.floor_source == WHITE,
        "closed_low": "" if d.gap is None else known_share(d.gap.closed_low),
    }  # fmt: skip


def _course(found: Found) -> str:
    """The course of a push's force."""
    term = found.term
    return svg(push_course(term.times, term.force, term.force_std), "course") if isinstance(term, Push) else ""


def _part(d: Findings) -> dict[str, Any] | None:
    """What effects named in part close on held-out recordings, and what stays."""
    if d.part is None:
        return None
    *courses, floor = d.part.courses
    closed = zip(d.part.search.found, courses[1:], strict=True)
    steps = [("the model as it was", courses[0]), *((f.term.effect.spec, c) for f, c in closed)]
    name = "noise" if floor else "noise, not known"
    return {"text": part_sentence(d), "waterfall": waterfall(steps, floor, name), "stays": percent(d.part.remainder)}


def _maps(channels: Sequence[str], views: Views):
    panels = [
        (f"{p.title}, {'not fitted' if p.unseen else 'fitted'}", p.pieces, p.bands) for p in views.panels
    ]  # fmt: skip
    return residual_maps(channels, panels, [f"{low:g}–{high:g}" for low, high in views.bands], views.changed)


def _cards(d: Findings, text: dict[str, Any]) -> list[dict[str, str]]:
    words, mood = _VERDICTS[d.verdict]
    cards = [{"value": words, "mood": mood, "text": "the verdict"}]
    if d.errors:
        e = max(shown_errors(d), key=lambda e: e.before.whitened_rms)
        known = e.before.noise_known
        unit, sides = "noise" if known else "of the signal", [(e.before, "by the model as it was")]
        if e.after is not None:
            sides.append((e.after, "with the effects named added" if d.part else "with the missing effect added"))
        for p, what in sides:
            value = f"{number(p.whitened_rms, 3)} ×" if known else percent(p.relative_error)
            mood = mood_of(p.whitened_rms / p.expected_rms) if known else ""
            cards.append({"value": value, "mood": mood, "text": f"{unit} is left {what}, on {e.motion}"})
        if known and d.part is None:
            text_ = "is what a complete model would leave"
            cards.append({"value": f"{number(e.last.expected_rms, 3)} ×", "mood": "", "text": text_})
    if d.part is not None:
        text_ = "of the gap on recordings held out in turn stays unexplained"
        return [*cards, {"value": percent(d.part.remainder), "mood": "", "text": text_}]
    if d.found and text["closed"]:
        least = f", at least {text['closed_low']} with 95 % confidence" if text["closed_low"] else ""
        cards.append({"value": text["closed"], "mood": "", "text": f"of the gap to the floor is closed{least}"})
    return cards


def _place(w: Disagreement) -> dict[str, str]:
    low, high = w.band_hz
    digits = 2 if w.event else 1
    return {
        "channel": w.channel, "motion": w.motion + (", at rest" if w.still else ""),
        "time": f"{w.start:.{digits}f} – {w.end:.{digits}f} s",
        "ratio": number(w.ratio, 3), "band": f"{low:.3g} – {high:.3g} Hz",
        "joint": w.joint or w.looks_like or DASH, "chance": chance(w.p_value),
    }  # fmt: skip


def channels_figure(diagnosis: Findings, ax: Any = None) -> Figure:
    """What is left of each channel, before and after: in units of the noise, or where that is not known in per cent."""
    return _bars(diagnosis, ax)


def _bars(d: Findings, ax: Any = None) -> Figure:
    """Root mean squares over the motions that were not fitted, or over all where there are none."""
    errors = shown_errors(d)
    known, changed = all(e.before.noise_known for e in errors), any(e.after is not None for e in errors)

    def sizes(side: Callable[[MotionErrors], Prediction]) -> np.ndarray:
        each = [side(e).whitened_rms_by_channel if known else 100.0 * side(e).nrmse for e in errors]
        return np.sqrt(np.mean(np.square(each), axis=0))

    ratios = np.stack([sizes(lambda e: e.before), sizes(lambda e: e.last)], axis=1)
    complete = max(e.last.expected_rms for e in errors) if known and d.part is None else None
    return before_and_after(errors[0].before.channel_names, ratios, complete, changed, "× noise" if known else "% of signal", ax)


def _errors(e: MotionErrors) -> dict[str, Any]:
    """Errors of a motion in units and per cent, before and after."""
    sides = [("error", e.before)] if e.after is None else [("before", e.before), ("after", e.after)]
    return {
        "motion": e.motion, "fitted": e.fitted,
        "lines": [
            {"name": name, "noise": number(p.whitened_rms, 3) if p.noise_known else DASH, "all": percent(p.relative_error),
             "cells": [f"{number(float(v), 3)} ({percent(float(share), 2)})" if share > 0 else number(float(v), 3)
                       for v, share in zip(p.rmse, p.nrmse, strict=True)]}
            for name, p in sides
        ],
    }  # fmt: skip


def _proposals(d: Findings) -> list[dict[str, Any]]:
    """All effects tried on their own, with what they would explain."""
    s = d.search
    excess = max(s.base.chi2 - s.projector.rows, 1.0)
    taken = {_columns_of(f.term.effect) for f in d.found}
    rivals = {_columns_of(t.effect) for f in d.found for t, _ in f.rivals}
    out = []
    for p in s.proposals:
        name = _columns_of(p.term.effect)
        kind = "named" if name in taken else "rival" if name in rivals else "other"
        out.append({"spec": p.term.effect.spec, "evidence": d.evidence(p), "kind": kind,
                    "share": min(p.gain / excess, 1.0), "summary": p.term.effect.summary})  # fmt: skip
    return sorted(out, key=lambda p: -p["evidence"])


def _columns_of(effect: Effect) -> str:
    """An attached body and a wrong inertia have the same columns; only an exact fit tells them apart."""
    return f"{effect.columns_of or effect.name}@{effect.where}"


def _line(p: dict[str, Any]) -> dict[str, str]:
    return {**p, "evidence": _large(p["evidence"]), "share": percent(p["share"], 2)}


def _rivals(found: Found) -> dict[str, Any]:
    return {
        "spec": found.term.effect.spec,
        "gain": _large(found.gain),
        "rivals": [{"spec": t.effect.spec, "lack": number(lack, 2), "summary": t.effect.summary} for t, lack in found.rivals],
    }


def _runner_up(proposals: list[dict[str, Any]]) -> dict[str, str] | None:
    """The best effect on its own that is neither named nor a rival, and how far it is behind."""
    if not proposals or proposals[0]["kind"] != "named":
        return None
    other = next((p for p in proposals if p["kind"] == "other"), None)
    return other and {"spec": other["spec"], "lack": _large(proposals[0]["evidence"] - other["evidence"])}


def _large(value: float) -> str:
    return f"{value:,.0f}".replace(",", " ").replace("-", "−") if abs(value) >= 100 else number(value, 3)


def _shift(shift: tuple[str, float, float, float]) -> dict[str, str]:
    label, before, after, sigmas = shift
    return {"label": label, "before": number(before), "after": number(after), "sigmas": number(sigmas, 3)}


def _visible(v: Visible) -> dict[str, Any]:
    return {
        "spec": v.effect.spec, "parameter": v.effect.parameters[v.parameter], "unit": _unit(v),
        "seen": "never" if v.seen is None else number(v.seen, 2),
        "most_collinear": DASH if v.most_collinear is None else v.most_collinear.spec, "share": _near_one(v.share),
        "named": "never" if v.named is None else number(v.named, 2),
    }  # fmt: skip


def _unit(v: Visible) -> str:
    unit = v.effect.units[v.parameter]
    return "" if unit == "1" else unit


def _seen(views: Views) -> list[dict[str, str]]:
    """One line for each kind of effect: the smallest sizes, over all its places."""
    groups: dict[tuple[str, str], list[Visible]] = {}
    for v in views.visible:
        groups.setdefault((v.effect.name, _unit(v)), []).append(v)
    rows = []
    for (name, unit), members in groups.items():
        best, worst = (pick(members, key=lambda v: np.inf if v.seen is None else v.seen) for pick in (min, max))
        ends = [v.named for v in members if v.named is not None]
        sizes = [v.usual for v in members]
        rows.append({
            "name": name, "summary": best.effect.summary, "parameter": best.effect.parameters[best.parameter], "unit": unit,
            "best": _at(best.seen, best, members), "worst": _at(worst.seen, worst, members) if len(members) > 1 else "",
            "named": "never" if not ends else _span(min(ends), max(ends)) + ("" if len(ends) == len(members) else ", or never"),
            "usual": _span(min(sizes), max(sizes)),
        })  # fmt: skip
    return rows


def _at(size: float | None, v: Visible, members: Sequence[Visible]) -> str:
    return ("never" if size is None else number(size, 2)) + (f" ({v.effect.where})" if len(members) > 1 else "")


def _span(low: float, high: float) -> str:
    one, other = number(low, 2), number(high, 2)
    return one if one == other else f"{one} … {other}"


def _look_alikes(views: Views) -> list[dict[str, str]]:
    """Pairs of effects that look alike, most alike first."""
    pairs: dict[frozenset[str], tuple[Effect, Effect, Visible]] = {}
    for v in sorted(views.visible, key=lambda v: -v.share):
        if v.most_collinear is not None and v.seen is not None and v.share > _ALIKE:
            pairs.setdefault(frozenset((v.effect.spec, v.most_collinear.spec)), (v.effect, v.most_collinear, v))
    return [{"one": one.spec, "other": other.spec, "share": _near_one(v.share)} for one, other, v in list(pairs.values())[:8]]


def _near_one(share: float) -> str:
    return f"{np.floor(1e6 * share) / 1e4:.6g} %" if share > 0.99 else percent(share, 2)


def _how(d: Findings) -> list[tuple[str, str]]:
    data, s = d.data, d.search
    rel_std = data.experiment.inertia_rel_std
    if rel_std is None:
        links = "every rigid parameter is free: inertia_rel_std is not stated, so a wrong inertia is no candidate"
    elif rel_std == 0:
        links = "nominal links are taken as exact (inertia_rel_std = 0)"
    else:
        links = f"nominal links count as known to {percent(rel_std, 3)} of every mass (inertia_rel_std), and are fitted along"
    highest = max(x.frequencies[-1] for x in data.segments)
    return [
        ("Model as it was", ", ".join(t.effect.spec for t in s.base.terms) or "rigid bodies only"),
        ("Links", links),
        ("Compared", f"{s.projector.rows} numbers: readings as amplitudes by frequency, up to {highest:.3g} Hz"),
        ("Tried", f"{len(s.proposals)} effects and places, the best of them by exact fits, alone and together"),
        ("Weighted residual of the search", f"{number(float(np.sqrt(s.base.chi2 / s.projector.rows)), 3)} before, "
         f"{number(float(np.sqrt(s.best.chi2 / s.projector.rows)), 3)} after: channels and frequencies weighted by noise"),
        ("Run time", f"{number(d.seconds, 3)} s"),
        versions("numpy", "scipy", "pin"),
    ]  # fmt: skip
