"""A description of what no effect explains: in words, as a dictionary, and as a file."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import tomli_w

from bayesid.diagnosis.description.choose import Chosen
from bayesid.diagnosis.description.describe import Description
from bayesid.estimators.parameters import with_ends
from bayesid.recordings.complaints import listed
from bayesid.recordings.experiment import Experiment
from bayesid.recordings.schema import dump_model
from bayesid.results.fitted_model import fitted_model
from bayesid.rounding import HALF, percent, with_half
from bayesid.section import powers

#: The file that it is written into beside a diagnosis.
DRAFT = "draft_effect.toml"
#: Names that a sentence lists.
_LISTED = 4


def terms_of(description: Description, names: tuple[str, ...]) -> list[tuple[str, str, str, str, str]]:
    """Reading, formula, amplitude, half its 95 % interval and its unit, one row an amplitude."""
    rows, at, units = [], 0, description.term.effect.units
    for chosen in description.terms:
        candidate = chosen.candidate
        for channel in candidate.channels:
            for text in candidate.shape.texts:
                value, half = with_half(description.term.values[at], HALF * float(description.std[at]))
                rows.append((names[channel], text, value, half, units[at]))
                at += 1
    return rows


def shares(description: Description) -> str:
    """What the draft closes on motions that it was not fitted to, or on the half that nothing was chosen on."""
    gap = description.gap
    if gap is None:
        share = percent(min(description.terms[0].share, 1.0))
        return (
            f"the first term closes {share} of what was left on the half of the recordings that it was not chosen on; no "
            "validation motion was compared"
        )
    closed, low = (percent(min(v, 1.0)) for v in (gap.closed, gap.closed_low))
    return f"{closed} of the gap closed on {', '.join(gap.motions)}, at least {low}"


def not_distinguished(chosen: Chosen) -> list[str]:
    """Effects of the library and other formulas that do as well on the other half."""
    effects = [effect.spec for effect, _ in chosen.library]
    return [*effects, *(" and ".join(c.shape.texts) for c, _ in chosen.alike)]


def described_lines(description: Description, names: tuple[str, ...]) -> list[str]:
    """A few lines for the terminal."""
    d = description
    rows = terms_of(d, names)
    lines = ["described by a draft, not named:"]
    for reading, text, value, half, unit in rows[:_LISTED]:
        lines.append(f"  {reading} + ({value} ± {half}) {text}  [{powers(unit)}]")
    if len(rows) > _LISTED:
        lines.append(f"  and {len(rows) - _LISTED} more, see {DRAFT}")
    lines.append(f"  draft: {shares(d)}")
    if d.start.terms:
        lines.append(f"  beside: {', '.join(t.effect.spec for t in d.start.terms)}")
    for chosen, causes in zip(d.terms, d.causes, strict=True):
        text = chosen.candidate.shape.texts[0]
        lines.append(f"  {text} may be: {'; or '.join(causes)}")
        if others := not_distinguished(chosen):
            lines.append(f"  {text} cannot be told from: {listed(others, _LISTED)}")
    lines.append(f"  use it: {use_line(d)}")
    return lines


def use_line(description: Description) -> str:
    """The command that identifies with the draft."""
    effect = description.term.effect.spec
    return f"bayesid identify ... --model {DRAFT} (beside the report), or --effects-from {DRAFT} and {effect} among --effects"


def description_dict(description: Description, names: tuple[str, ...]) -> dict[str, Any]:
    """The entry ``description`` of ``diagnosis.json``."""
    d = description
    effect = d.term.effect
    return {
        "is": "a description, not a name", "effect": effect.spec, "file": DRAFT,
        "formulas": {k: v for k, v in d.table.items() if k not in ("parameters", "summary")},
        "parameters": {key: with_ends(value, std, unit) for key, value, std, unit in d.term.with_std(d.std)},
        "beside": [t.effect.spec for t in d.start.terms],
        "terms": [
            {
                "formulas": list(c.candidate.shape.texts), "readings": [names[k] for k in c.candidate.channels],
                "log_evidence": c.evidence, "closed_on_the_other_half": c.share, "closed_low": c.share_low,
                "may_be": list(causes), "not_told_from": not_distinguished(c),
            }
            for c, causes in zip(d.terms, d.causes, strict=True)
        ],
        "candidates": d.candidates, "gap": None if d.gap is None else d.gap.to_dict(),
    }  # fmt: skip


def write_draft(description: Description, experiment: Experiment, path: str | Path) -> None:
    """Write the draft as a model.toml: the user's model, what the draft is beside, and its formulas."""
    d = description
    spec = d.term.effect.spec
    effects, values = fitted_model(experiment, [*experiment.effects, *(t.effect.spec for t in d.fit.terms)], d.fit.terms)
    expressions: Mapping[str, dict[str, Any]] = {**experiment.library.expressions, d.term.effect.name: d.table}
    said = [
        f"A description, not a name: a draft of what no effect of the library explains in '{experiment.name}'.",
        *(f"May be: {'; or '.join(causes)}." for causes in d.causes),
        f"Tested: {shares(d)}.",
        f"bayesid identify FOLDER --model {DRAFT}",
        f"bayesid identify FOLDER --effects-from {DRAFT} --effects {','.join(effects)}",
        f"The draft is {spec}; give it a better name when you know what it is.",
    ]
    comments = "".join(f"# {line}\n" for line in said)
    Path(path).write_text(comments + tomli_w.dumps({"model": dump_model(effects, values, expressions)}), encoding="utf-8")
