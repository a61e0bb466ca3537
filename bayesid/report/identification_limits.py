"""What a fit does not show, and why: a section of the report of ``identify``."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from bayesid.dynamics.base_parameters import BaseParameters, notation
from bayesid.report.page import below, bullets
from bayesid.results.identification import Identification
from bayesid.rounding import channel_text
from bayesid.section import Part, ShownSection, ShownTable


def limits_section(result: Identification) -> ShownSection:
    """What these motions, and these readings, do not show."""
    base, problem = result.estimate.base, result.problem
    lost = result.not_shown
    parts: list[Part] = []
    if lost.motions:
        parts.append(below(
            "Hidden by these motions",
            "Other motions of this robot could show these; the recorded ones do not, or not well enough to say more than the "
            "size of the body does. Where the tables give a number, it rests on the nominal one (class prior) or is less "
            "sure than the body is large (class weak): it should not be used by itself. Motions that move these links faster, "
            "or in other poses, would help.",
            *_combinations(lost.motions),
        ))  # fmt: skip
    if lost.effects:
        parts.append(below(
            "Lost to an effect in the model",
            "These motions show these only together with an effect that is estimated along, as inertia about a joint's axis "
            "adds to that of the rotor behind it. What is stated of the effect in [model.values] gives them back.",
            bullets([f"{label}: not told from {', '.join(specs)}" for label, specs in lost.effects.items()]),
        ))  # fmt: skip
    if lost.static_run:
        tells = "A scale, or the nominal model, tells them."
        if lost.fitted_along:
            tells = f"Where the run is fitted along, readings show {', '.join(lost.fitted_along)}."
        parts.append(below(
            "Lost to the static run",
            f"The static run is subtracted, and gravity with it: no motion shows these. {tells}",
            *_combinations(lost.static_run),
        ))  # fmt: skip
    if not parts:
        parts.append("Nothing that these readings can show at all was hidden by the motions.")
    if lost.invisible:
        gravity = " (with the static run subtracted, nor does what only gravity would show)" if problem.static == "motion" else ""
        parts.append(below(
            "Invisible to these readings",
            f"No motion whatever shows these {len(lost.invisible)} parameters in the {channel_text(problem.channel)}: they "
            f"influence no reading{gravity}. Only the nominal model tells them.",
            bullets(_by_body(lost.invisible)),
        ))  # fmt: skip
    if absorbed := _absorbed(base):
        parts.append(below(
            "What the unknown sensor offset costs",
            "Nothing here measures the sensor's offset by itself, so it is estimated along, and what acts on the sensor like a "
            "constant offset cannot be told from it: it is taken up by the offset instead of by the base parameters. A static "
            "run, or a reading of the unloaded sensor, would give it back. An offset that is estimated contains, beside the "
            "true offset:",
            ShownTable(["axis", "contains besides"], absorbed, "- w"),
        ))  # fmt: skip
    return ShownSection("What could not be identified", parts)


def _combinations(labels: Sequence[str]) -> list[Part]:
    """Single parameters in one line, then the sums as a list."""
    return [", ".join(label for label in labels if " " not in label), bullets([x for x in labels if " " in x], sums=True)]


def _by_body(names: Sequence[str]) -> list[str]:
    """``joint1.m, joint1.mcx`` as ``joint1: m, mcx``."""
    bodies: dict[str, list[str]] = {}
    for name in names:
        body, _, kind = name.rpartition(".")
        bodies.setdefault(body, []).append(kind)
    return [f"{body}: {', '.join(kinds)}" if body else ", ".join(kinds) for body, kinds in bodies.items()]


def _absorbed(base: BaseParameters) -> list[list[str]]:
    """What an estimated offset contains besides the true one, axis by axis."""
    if base.absorbed is None:
        return []
    rows, names = [], notation(base.parameter_names)
    for axis, row in zip(("fx", "fy", "fz", "mx", "my", "mz"), base.absorbed, strict=False):
        parts = [f"{'-' if row[k] < 0 else '+'} {abs(row[k]):.4g} {names[k]}" for k in np.flatnonzero(row)]
        if parts:
            rows.append([axis, re.sub(r"^- ", "-", " ".join(parts).removeprefix("+ "))])
    return rows
