"""A diagnosis in words: one sentence, a few lines for a terminal, a table for a notebook; and its files."""

from __future__ import annotations

from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from bayesid.diagnosis.case import Episode
from bayesid.diagnosis.locate import Disagreement
from bayesid.diagnosis.views import views
from bayesid.effects import Effect
from bayesid.output import strict, write_results
from bayesid.report import diagnosis_report
from bayesid.report.identification import channel_text
from bayesid.report.page import DASH, interval, number, percent, with_half
from bayesid.schema import EffectParameters, write_model

if TYPE_CHECKING:
    from bayesid.diagnosis.diagnose import Diagnosis
    from bayesid.diagnosis.search import Found

#: Half the width of a 95 % interval in standard deviations.
HALF = 1.96
#: Disagreements that a terminal shows.
_SHOWN = 4
_COUNTS = {1: "one effect", 2: "two effects", 3: "three effects"}


def verdict_sentence(diagnosis: Diagnosis) -> str:
    """The verdict in plain words."""
    d = diagnosis
    names = [f"{worded(f.term.effect, d)} ({f.term.effect.kind.summary})" for f in d.found]
    if d.verdict == "nothing_missing":
        return "Nothing is missing that these motions could show: the model as it is explains the readings down to their noise."
    if d.verdict == "unknown":
        return "Something is missing, and no effect of the library explains it."
    count = _COUNTS.get(len(names), f"{len(names)} effects")
    if d.verdict == "ambiguous":
        parts = []
        for name, f in zip(names, d.found, strict=True):
            twins = [worded(t.effect, d) for t, _ in f.rivals]
            parts.append(f"either {name} or {' or '.join(twins)}" if twins else name)
        return f"The model misses {count}, but these motions do not tell every name apart: {'; and '.join(parts)}."
    return f"The model misses {count}: {' and '.join(names)}."


def proof_sentence(diagnosis: Diagnosis) -> str:
    """What unseen motions, or for want of any the fitted ones, say of it."""
    d, gap = diagnosis, diagnosis.gap
    s = d.search
    if gap is None:
        before, after = (number(float(np.sqrt(f.chi2 / s.rigid.rows)), 3) for f in (s.base, s.best))
        text = f"There is no motion that took no part in the fit. On the fitted ones the residual is {before} times the noise"
        return f"{text}." if d.verdict == "nothing_missing" or not s.found else f"{text} before and {after} times after."
    motions = _listed([f"‘{m}’" for m in gap.motions])
    before, after, floor = (number(v, 3) for v in (gap.before, gap.after, gap.floor))
    unseen = f"On {motions}, which took no part in any fit,"
    if d.verdict == "nothing_missing":
        text = f"{unseen} {before} times the noise is left; {floor} is what a complete model would leave."
        if d.where:
            count = len(d.where)
            places, them = ("one place stands", "it") if count == 1 else (f"{count} places stand", "them")
            text += f" In the fitted motions {places} out of the noise, but no effect of the library explains {them}."
        return text
    if d.verdict == "unknown":
        tried = _listed([f.term.effect.spec for f in s.found])
        fitted = number(float(np.sqrt(s.best.chi2 / s.rigid.rows)), 3)
        end = f"a complete model would leave {floor}. On the fitted motions {fitted} times the noise stays."
        if not tried:
            return f"{unseen} {before} times the noise is left; {end}"
        return f"{unseen} the best attempt ({tried}) gets from {before} to {after} times the noise; {end}"
    text = f"{unseen} the residual goes from {before} to {after} times the noise; a complete model would leave {floor}."
    here = [f.term.motion for f in d.found if isinstance(f.term, Episode)]
    if here:
        text += f" A contact happens once, here in ‘{here[0]}’, so other motions cannot prove it."
    return text


def notes(diagnosis: Diagnosis) -> list[str]:
    """What the reader should know beside the verdict and its proof."""
    return [r for r in diagnosis.remarks if not r.startswith("Something is missing")]


def worded(effect: Effect, diagnosis: Diagnosis) -> str:
    """``sensor_gain at mx``, ``tether at joint3 (elbow_joint)``; the place is left out where there is only one."""
    if effect.kind.at in ("sensor", "base", "robot"):
        return effect.name
    if effect.joint is None:
        return f"{effect.name} at {effect.where}"
    own = diagnosis.case.robot.joint_names[effect.joint]
    return f"{effect.name} at {effect.where}" + ("" if own == effect.where else f" ({own})")


def parameter_rows(found: Found) -> list[tuple[str, str, str, str, str]]:
    """Name, value, half the 95 % interval, the interval and the unit of each parameter of an effect."""
    effect = found.term.effect
    rows = []
    for key, value, std, unit in zip(effect.kind.parameters, found.term.values, found.std, effect.units, strict=True):
        half = HALF * float(std)
        text, spread = with_half(value, half)
        rows.append((key, text, spread, interval(value, half), "" if unit == "1" else unit))
    return rows


def disagreement_line(where: Disagreement) -> str:
    """Channel, motion, time, band and joint of a disagreement."""
    w = where.to_dict()
    low, high = w["band_hz"]
    text = f"{w['channel']} in {w['motion']}{' at rest' if w['at_rest'] else ''}, {w['start']:.1f} to {w['end']:.1f} s"
    text += f": {number(w['times_noise'], 3)} x noise, most at {low:g} to {high:g} Hz"
    return text + (f", goes with {w['joint']}" if w["joint"] else "")


def summary(diagnosis: Diagnosis) -> str:
    """A few lines for the terminal."""
    d = diagnosis
    fitted = dict.fromkeys(s.motion for s in d.case.stretches)
    lines = [
        f"{d.case.experiment.name}: {d.verdict.replace('_', ' ')} ({channel_text(d.case.channel)} of {', '.join(fitted)})",
        f"  {verdict_sentence(d)}",
    ]
    for f in d.found:
        for key, value, half, _, unit in parameter_rows(f):
            lines.append(f"    {f.term.effect.spec}: {key} {value}{'' if half == DASH else f' ± {half}'} {unit}".rstrip())
    if d.gap is None:
        lines.append(f"  {proof_sentence(d)}")
    else:
        before, after, floor = (number(v, 3) for v in (d.gap.before, d.gap.after, d.gap.floor))
        text = f"  gap on {', '.join(d.gap.motions)}: {before} -> {after} x noise (floor {floor})"
        closed, least = _known_share(d.gap.closed), _known_share(d.gap.closed_low)
        if d.found and closed:
            text += f", {closed} closed" + (f", at least {least}" if least else "")
        lines.append(text)
    if d.verdict == "unknown" and d.search.found:
        lines.append(f"  best attempt: {', '.join(f.term.effect.spec for f in d.search.found)}")
    word = "unexplained" if d.verdict == "nothing_missing" else "disagrees"
    for w in d.where[:_SHOWN]:
        lines.append(f"  {word}: {disagreement_line(w)}")
    if len(d.where) > _SHOWN:
        lines.append(f"  and in {len(d.where) - _SHOWN} more places")
    lines += [f"  note: {r}" for r in notes(d)]
    if d.next_experiment:
        lines.append(f"  next: {d.next_experiment}")
    return "\n".join(lines)


def share_text(share: float) -> str:
    """A share of a gap as per cent; rounded down near the whole, so that 100 % means all of it."""
    return percent(share) if share < 0.999 else f"{np.floor(min(share, 1.0) * 1e5) / 1e3:.6g} %"


def notebook(diagnosis: Diagnosis) -> str:
    """The same as HTML for a notebook."""
    d = diagnosis
    out = [f"<p><b>{escape(verdict_sentence(d))}</b> {escape(proof_sentence(d))}</p>"]
    if d.found:
        rows = [(f.term.effect.spec, *row) for f in d.found for row in parameter_rows(f)]
        head = "".join(f"<th>{h}</th>" for h in ("effect", "parameter", "value", "± 95 %", "interval", "unit"))
        body = "".join("<tr>" + "".join(f"<td>{escape(c)}</td>" for c in row) + "</tr>" for row in rows)
        out.append(f"<table><tr>{head}</tr>{body}</table>")
    if d.where:
        out.append("<ul>" + "".join(f"<li>{escape(disagreement_line(w))}</li>" for w in d.where[:_SHOWN]) + "</ul>")
    out += [f"<p>{escape(r)}</p>" for r in (*notes(d), d.next_experiment) if r]
    return "".join(out)


def model(diagnosis: Diagnosis) -> tuple[tuple[str, ...], EffectParameters]:
    """The experiment's model with the named effects added, as `bayesid.schema.write_model` takes it.

    Effects that act on other channels stay as they are; all others get the values fitted here as starting values.
    """
    experiment, terms = diagnosis.case.experiment, diagnosis.terms
    effects = [*experiment.effects, *(f.term.effect.spec for f in diagnosis.found)]
    values: EffectParameters = {spec: dict(given) for spec, given in experiment.effect_values.items()}
    for term in terms:
        spec = term.effect.spec
        given = {k: float(v) for k, v in zip(term.effect.kind.parameters, term.values, strict=True)}
        fixed = values.get(spec, values.get(term.effect.name, {})).get("fixed", False)
        values[spec] = {**given, "fixed": True} if fixed else dict(given)
    return tuple(dict.fromkeys(effects)), values


def write(diagnosis: Diagnosis, folder: str | Path) -> Path:
    """Write ``diagnosis.json``, ``model.toml`` and ``report.html``; returns the report's path."""
    effects, values = model(diagnosis)
    page = diagnosis_report(diagnosis, views(diagnosis), page_text(diagnosis))
    documents = {"diagnosis.json": strict(diagnosis.to_dict())}
    return write_results(folder, documents, {"model.toml": lambda path: write_model(effects, values, path)}, page)


def page_text(diagnosis: Diagnosis) -> dict:
    """What the report says in sentences, by part."""
    d = diagnosis
    return {
        "verdict": verdict_sentence(d),
        "proof": proof_sentence(d),
        "effects": [
            {"name": worded(f.term.effect, d), "spec": f.term.effect.spec, "summary": f.term.effect.kind.summary,
             "motion": f.term.motion if isinstance(f.term, Episode) else "", "rows": parameter_rows(f)}
            for f in d.found
        ],
        "notes": notes(d),
        "tried": [f.term.effect.spec for f in d.search.found],
        "closed": "" if d.gap is None else _known_share(d.gap.closed),
        "closed_low": "" if d.gap is None else _known_share(d.gap.closed_low),
    }  # fmt: skip


def _known_share(share: float) -> str:
    return share_text(share) if np.isfinite(share) and share > 0 else ""


def _listed(words: list[str]) -> str:
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}" if words else ""
