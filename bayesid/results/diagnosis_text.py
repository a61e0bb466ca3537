"""A diagnosis in words: one sentence, a few lines for a terminal, a table for a notebook."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from bayesid.diagnosis.data import Episode
from bayesid.diagnosis.locate import Disagreement
from bayesid.diagnosis.push import Push
from bayesid.diagnosis.remarks import by_kind
from bayesid.diagnosis.rivals import Found
from bayesid.effects import Effect
from bayesid.results.described import described_lines
from bayesid.results.findings import Findings
from bayesid.results.text import DASH, HALF, channel_text, interval, number, percent, with_half
from bayesid.section import Part, ShownTable
from bayesid.validation.own_fit import MotionErrors
from bayesid.validation.prediction import Prediction

#: What stands for a value that the data leave open.
NOT_DETERMINED = "not determined"
#: Disagreements that a terminal shows.
_SHOWN = 4
#: So many effects are spelt out in a sentence, and so many channels of what stays; more are named by kind.
_SPELT_OUT, _CHANNELS_SAID = 3, 3
_COUNTS = {1: "one effect", 2: "two effects", 3: "three effects"}


def verdict_sentence(diagnosis: Findings) -> str:
    """The verdict in plain words."""
    d = diagnosis
    names = [f"{worded(f.term.effect, d)} ({f.term.effect.summary})" for f in d.found]
    if d.verdict == "nothing_missing":
        return "Nothing is missing that these motions could show: the model as it is explains the readings down to their noise."
    if d.verdict == "unknown":
        return "Something is missing, and no effect of the library explains it."
    count = _COUNTS.get(len(names), f"{len(names)} effects")
    if d.verdict == "named_in_part":
        each = [_with_rivals(name, f, d) for name, f in zip(names, d.found, strict=True)]
        spelt = listed(each) if len(names) <= _SPELT_OUT else listed(by_kind(f.term for f in d.found))
        return f"The model misses {count} that held-out recordings confirm, and more that stays unexplained: {spelt}."
    if d.verdict == "ambiguous":
        parts = [_with_rivals(name, f, d) for name, f in zip(names, d.found, strict=True)]
        return f"The model misses {count}, but these motions do not tell every name apart: {'; and '.join(parts)}."
    return f"The model misses {count}: {' and '.join(names)}."


def _with_rivals(name: str, found: Found, diagnosis: Findings) -> str:
    """An effect with those that explain as much."""
    others = [worded(t.effect, diagnosis) for t, _ in found.rivals]
    return f"either {name} or {' or '.join(others)}" if others else name


def part_sentence(diagnosis: Findings) -> str:
    """What effects named in part close of the gap on recordings held out in turn, and what stays."""
    d, part = diagnosis, diagnosis.part
    if part is None:
        return ""
    own = part.search.found
    closes = f"{listed(by_kind(f.term for f in own))} {'closes' if len(own) == 1 else 'close'}"
    if len(own) == len(d.found):  # a push is no part of other recordings
        closes = "it closes" if len(own) == 1 else "they close"
    text = (
        f"With each of {part.stretches} parts of the recordings held out in turn, {closes} {percent(1.0 - part.remainder)} of "
        f"the gap and {percent(part.remainder)} stays"
    )
    if part.courses[-1] == 0.0:
        text += ", the noise, which is not known, included"
    places = [w for w in d.remainder if not w.event]
    channels = listed(list(dict.fromkeys(w.channel for w in places))[:_CHANNELS_SAID])
    joints = listed(list(dict.fromkeys(w.joint for w in places[:_SHOWN] if w.joint)))
    if channels:
        text += f", most of it in {channels}" + (f", and it goes with {joints}" if joints else "")
    return f"{text}."


def validation_sentence(diagnosis: Findings) -> str:
    """What unseen motions, or for want of any the fitted ones, say of it."""
    d, gap = diagnosis, diagnosis.gap
    if gap is None:
        text = "No motion that took no part in the fit was compared." + (
            f" On the fitted ones {left_text(d)}." if d.errors else ""
        )
        return f"{part_sentence(d)} {text}" if d.verdict == "named_in_part" else text
    unseen = f"On {listed([f'‘{m}’' for m in gap.motions])}, which took no part in any fit,"
    text = f"{unseen} {left_text(d)}." if d.errors else ""
    if d.verdict == "named_in_part":
        return f"{part_sentence(d)} {text}".rstrip()
    if d.verdict == "nothing_missing":
        count = sum(not w.event for w in d.where)
        if count:
            places, them = ("one place stands", "it") if count == 1 else (f"{count} places stand", "them")
            text += f" In the fitted motions {places} out of the noise, but no effect of the library explains {them}."
    elif d.verdict == "unknown":
        tried, closed = listed(by_kind(f.term for f in d.search.found)), known_share(gap.closed)
        if tried:
            text += f" The best attempt ({tried}) closes {closed or 'nothing'} of the gap."
    elif gap.difference < d.data.settings.detected**2:
        what = "it" if len(d.found) == 1 else "them"
        text += f" The readings of these motions hardly depend on {what}, so they neither confirm nor deny {what}."
    elif closed := known_share(gap.closed):
        least = known_share(gap.closed_low)
        text += f" That closes {closed} of the gap" + (f", at least {least}." if least else ".")
    here = [f.term for f in d.found if isinstance(f.term, Episode)]
    if here and isinstance(here[0], Push):
        text += f" A push is in ‘{here[0].motion}’ alone; the other motions are explained without it."
    elif here:
        text += f" A contact happens once, here in ‘{here[0].motion}’, so other motions cannot confirm it."
    return text.strip()


def shown_errors(diagnosis: Findings) -> tuple[MotionErrors, ...]:
    """Of the motions that were not fitted, or of all where there are none."""
    return tuple(e for e in diagnosis.errors if not e.fitted) or diagnosis.errors


def left_text(diagnosis: Findings) -> str:
    """What is left of the motions: in units of the noise, or of the signal where no reading tells the noise."""
    errors = shown_errors(diagnosis)
    several = len(errors) > 1

    def each(e: MotionErrors, value: Callable[[Prediction], str]) -> str:
        where = f" on ‘{e.motion}’" if several else ""
        return value(e.before) + where if e.after is None else f"from {value(e.before)} to {value(e.after)}{where}"

    goes = any(e.after is not None for e in errors)
    known = all(e.before.noise_known for e in errors)
    size = _times if known else _share
    sizes = listed([each(e, size) for e in errors])
    if known:
        complete = number(max(e.last.expected_rms for e in errors), 3)
        text = f"the residual goes {sizes} times the noise" if goes else f"{sizes} times the noise is left"
        return f"{text}; a complete model would leave {complete}"
    text = f"the error goes {sizes} of the signal" if goes else f"the error is {sizes} of the signal"
    return f"{text} (the sensor's own noise is not known)"


def _times(p: Prediction) -> str:
    return number(p.whitened_rms, 3)


def _share(p: Prediction) -> str:
    return percent(p.relative_error)


def error_lines(diagnosis: Findings) -> list[str]:
    """Errors without and with the effects named, in times the noise, per cent and units: of the motions `shown_errors` names."""
    return [error_line(e) for e in shown_errors(diagnosis)]


def error_line(e: MotionErrors) -> str:
    """One motion's errors: all channels together, then those that gain most, or of which most is left where nothing is named."""
    before, after = e.before, e.last

    def change(text: Callable[[Prediction], str]) -> str:
        return text(before) if e.after is None else f"{text(before)} -> {text(after)}"

    order = np.argsort(-before.rmse / np.maximum(before.signal if e.after is None else after.rmse, 1e-300))
    worst = [k for k in order if before.rmse[k] > 0.0][:_CHANNELS_SAID]
    units = before.channel_units
    parts = [f"{before.channel_names[k]} {change(lambda p, k=k: number(float(p.rmse[k]), 3))} {units[k]}" for k in worst]
    noise = f"{change(_times)} x noise" if before.noise_known else "noise not known"
    whole = change(_share)
    return f"error of {e.motion}{' (fitted)' if e.fitted else ''}: {noise}, {whole} of the signal; {', '.join(parts)}"


def notes(diagnosis: Findings) -> list[str]:
    """What the reader should know beside the verdict and its validation."""
    said = [r for r in diagnosis.remarks if not r.startswith("Something is missing")]
    return [*said, *event_sentences(diagnosis)]


def steady_sentence(found: Found, diagnosis: Findings) -> str:
    """Between which values the parameters stay, and what evidence is left, whichever part of the recordings is left out."""
    mine = next((x for x in diagnosis.stability if x is not None and x.spec == found.term.effect.spec), None)
    if mine is None:
        return ""
    parts = []
    for key, value, unit, (low, high) in zip(
        found.term.effect.parameters, found.term.values, found.term.effect.units, mine.ranges, strict=True
    ):
        if np.isfinite(low) and np.isfinite(high):
            # As many digits as tell the two ends apart.
            first, last = (with_half(v, max(0.2 * (high - low), 1e-6 * abs(value)))[0] for v in (low, high))
            parts.append(f"{key} between {first} and {last}" + ("" if unit == "1" else f" {unit}"))
        else:
            parts.append(f"{key} not determined")
    least = f"{mine.least:,.0f}".replace(",", " ") if mine.least >= 100 else number(mine.least, 3)
    return f"Whichever of {mine.blocks} parts of the recordings is left out: {'; '.join(parts)}; log evidence at least {least}."


def event_sentences(diagnosis: Findings) -> list[str]:
    """Short events above the compared band, a sentence for each motion that has some."""
    events = [w for w in diagnosis.where if w.event]
    out = []
    for motion in dict.fromkeys(w.motion for w in events):
        mine = sorted((w for w in events if w.motion == motion), key=lambda w: w.start)
        channels = listed(list(dict.fromkeys(w.channel for w in mine)))
        taps, one = sum(w.tap for w in mine), len(mine) == 1
        times = listed([f"{w.peak:.2f}" for w in mine])
        text = f"{'One short event' if one else f'{len(mine)} short events'} in ‘{motion}’ at {times} s, loudest in {channels}, "
        text += f"above the frequencies that models are compared at ({mine[0].band_hz[0]:.3g} Hz and more)"
        text += ", in a motion that took no part in the fit" if mine[0].unseen else ""
        if taps:
            who = "it looks like a tap" if one else f"{'they' if taps == len(mine) else f'{taps} of them'} look like taps"
            text += f"; {who}: a broad band, over within {diagnosis.data.settings.moment:g} s"
        out.append(f"{text}. No motion of the robot explains {'it' if one else 'them'}.")
    return out


def worded(effect: Effect, diagnosis: Findings) -> str:
    """``sensor_gain at mx``, ``tether at joint3 (elbow_joint)``; the place is left out where there is only one."""
    if effect.at in ("sensor", "base", "robot"):
        return effect.name
    if effect.joint is None:
        return f"{effect.name} at {effect.where}"
    own = diagnosis.data.robot.joint_names[effect.joint]
    return f"{effect.name} at {effect.where}" + ("" if own == effect.where else f" ({own})")


def parameter_rows(diagnosis: Findings, index: int) -> list[tuple[str, str, str, str, str]]:
    """Name, value, half the 95 % interval, the interval and the unit of an effect's parameters and of what follows from them.

    Where the data do not determine a value none is shown.
    """
    found = diagnosis.found[index]
    effect = found.term.effect
    rows = []
    values = zip(effect.parameters, found.term.values, found.std, effect.units, strict=True)
    for key, value, std, unit in (*values, *diagnosis.derived(index)):
        half = HALF * float(std)
        known = np.isfinite(half) and half > 0.0
        text, spread = with_half(value, half) if known else (NOT_DETERMINED, DASH)
        rows.append((key, text, spread, interval(value, half) if known else DASH, "" if unit == "1" else unit))
    return rows


def disagreement_line(where: Disagreement) -> str:
    """Channel, motion, time, band and joint of a disagreement."""
    w, (low, high) = where, where.band_hz
    if w.event:
        text = f"{w.channel} in {w.motion}, {w.start:.2f} to {w.end:.2f} s"
        return f"{text}: {number(w.ratio, 3)} x the usual level at {low:.3g} to {high:.3g} Hz, a {w.looks_like}"
    text = f"{w.channel} in {w.motion}{' at rest' if w.still else ''}, {w.start:.1f} to {w.end:.1f} s"
    text += f": {number(w.ratio, 3)} x noise, most at {low:g} to {high:g} Hz"
    return text + (f", goes with {w.joint}" if w.joint else "")


def lines_of(diagnosis: Findings) -> list[str]:
    """A headline, and what the terminal shows below it."""
    d = diagnosis
    fitted = dict.fromkeys(s.motion for s in d.data.segments)
    lines = [
        f"{d.data.experiment.name}: {d.verdict.replace('_', ' ')} ({channel_text(d.data.channel)} of {', '.join(fitted)})",
        verdict_sentence(d),
    ]
    for k, f in enumerate(d.found):
        known = d.part is not None and d.shares(k) is not None
        share = f"; without it {share_range(d, k)} is open again" if known else ""
        for key, value, half, _, unit in parameter_rows(d, k):
            text = value if half == DASH else f"{value} ± {half} {unit}".rstrip()
            lines.append(f"  {f.term.effect.spec}: {key} {text}{share}")
            share = ""
    if d.part is not None:
        lines.append(part_sentence(d))
    if d.gap is None:
        lines.append("No motion that took no part in the fit was compared.")
    elif d.found and d.part is None:
        motions, closed, least = ", ".join(d.gap.motions), known_share(d.gap.closed), known_share(d.gap.closed_low)
        if d.gap.difference < d.data.settings.detected**2:
            lines.append(f"{motions} hardly depends on what is named, and neither confirms nor denies it")
        elif closed:
            lines.append(f"gap on {motions}: {closed} closed" + (f", at least {least}" if least else ""))
    lines += error_lines(d)
    if d.verdict == "unknown" and d.search.found:
        lines.append(f"best attempt: {', '.join(by_kind(f.term for f in d.search.found))}")
    word = "unexplained" if d.verdict == "nothing_missing" else "stays" if d.part is not None else "disagrees"
    places = d.where if d.part is None else d.remainder
    for w in places[:_SHOWN]:
        lines.append(f"{word}: {disagreement_line(w)}")
    if len(places) > _SHOWN:
        lines.append(f"and in {len(places) - _SHOWN} more places")
    if d.description is not None:
        lines += described_lines(d.description, d.data.channels.names)
    lines += [f"note: {r}" for r in notes(d)]
    if d.next_experiment:
        lines.append(f"next: {d.next_experiment}")
    return lines


def share_range(diagnosis: Findings, index: int) -> str:
    """Share of the gap that an effect closes beside all others, and the least it does with 95 % confidence."""
    found = diagnosis.shares(index)
    if found is None:
        return DASH
    return f"{percent(max(found[0], 0.0))} of the gap" + (f" (at least {percent(found[1])})" if found[1] > 0.0 else "")


def share_text(share: float) -> str:
    """A share of a gap as per cent; rounded down near the whole, so that 100 % means all of it."""
    return percent(share) if share < 0.999 else f"{np.floor(min(share, 1.0) * 1e5) / 1e3:.6g} %"


def notebook_parts(diagnosis: Findings) -> list[Part]:
    """What a notebook shows: values as a table."""
    d = diagnosis
    parts: list[Part] = [f"**{verdict_sentence(d)}** {validation_sentence(d)}"]
    parts += [f"{line[0].upper()}{line[1:]}." for line in error_lines(d)]
    if d.found:
        rows = [(f.term.effect.spec, *row) for k, f in enumerate(d.found) for row in parameter_rows(d, k)]
        parts.append(ShownTable(["effect", "parameter", "value", "± 95 %", "interval", "unit"], rows, "k k nb n n ku"))
    parts += [disagreement_line(w) for w in d.where[:_SHOWN]]
    if d.description is not None:
        parts += described_lines(d.description, d.data.channels.names)
    return [*parts, *notes(d), d.next_experiment]


def known_share(share: float) -> str:
    """A share of a gap as per cent; nothing where it is not known or none."""
    return share_text(share) if np.isfinite(share) and share > 0 else ""


def listed(words: list[str]) -> str:
    """Words with commas and an and."""
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}" if words else ""
