"""Warnings that the verbs share: what the predictions of unfitted motions say about a result."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from bayesid.arguments import call
from bayesid.estimators import Estimate
from bayesid.recordings.experiment import Experiment
from bayesid.regression.problem import Problem
from bayesid.validation.headline import judged
from bayesid.validation.prediction import BAND, Prediction

_CERTAIN = 3.0  # standard deviations below zero


def repeated_motion(prediction: Prediction) -> str:
    """That a motion repeats a fitted one, and so proves little."""
    own, other = prediction.motion, prediction.repeats
    return f"Motion '{own}' repeats the fitted motion '{other}': its error says little about others; validate on another."


def unpredicted(prediction: Prediction) -> list[str]:
    """That a motion is not predicted as well as a complete model would."""
    judgement = judged(prediction)
    if judgement.mood == "good":
        return []
    return [
        f"Motion '{prediction.motion}' is predicted with an error of {100 * prediction.relative_error:.3g} % of the signal below "
        f"{BAND:.2g} Hz: {judgement.text}. `{call('diagnose')}` looks for what is missing."
    ]


def told_first(experiment: Experiment, told: Iterable[str]) -> tuple[str, ...]:
    """What is certain about the recordings, then what a verb has to say, then what is doubtful about the recordings."""
    certain = [finding.text for finding in experiment.findings]
    return tuple([*certain, *told, *(text for text in experiment.warnings if text not in certain)])


def incomplete(dispersion: float | None, channels: Mapping[str, float] | None = None) -> str:
    """That the model lacks something, in which channels most, and what intervals do about it."""
    factor = (dispersion or 1.0) ** 0.5
    known = channels or {}
    most = sorted(known, key=lambda c: -known[c])[:2] if len(known) > 2 else []
    where = f", most in {' and '.join(most)}" if most else ""
    wider = f" ({factor:.2g} times as wide as noise alone makes them{where})" if factor > 1.0 else ""
    return (
        "Something is missing in the model: the fit scatters more between stretches of the recording, or between weightings, "
        f"than noise explains. Intervals count the scatter{wider}; for motions unlike the fitted ones they do not hold. "
        f"`{call('diagnose')}` looks for the missing effect."
    )


def mistaken(problem: Problem, estimate: Estimate, validation: Sequence[Prediction]) -> list[str]:
    """Which mistake in the data would explain a bad fit, and that masses or friction have a sign that nothing has.

    The search for mistakes takes a part of a second; it is made where a sign is wrong, where a held-out motion is not predicted
    well, and where the URDF has no masses to compare with.
    """
    base, rank = estimate.base, estimate.base.rank
    negative = estimate.solution < -_CERTAIN * estimate.full_std
    alone = [
        name.endswith(".m") and np.count_nonzero(np.abs(row) > 1e-9) == 1
        for name, row in zip(base.names, base.matrix, strict=True)
    ]
    never = np.array([*alone, *problem.regression.knowledge.effect_non_negative], dtype=bool) & negative
    names = [*base.names, *estimate.effect_names]
    units = [*base.units, *estimate.effect_units]
    shown = [f"{names[k]} = {estimate.solution[k]:.3g} +- {estimate.full_std[k]:.2g} {units[k]}" for k in np.flatnonzero(never)]
    masses = problem.experiment.robot.nominal[:, 0]
    if not shown and masses.any() and all(judged(p).mood == "good" for p in validation):
        return []
    from bayesid.validation.mistakes.search import find_mistakes

    out = [found.text for found in find_mistakes(problem.experiment)]
    if shown:
        kind = "Mass" if never[:rank].any() else "Friction"
        out.append(
            f"{kind} that cannot be negative is: {listed(shown, 4)}. Check signs, joint order and units of the readings"
            f"{'; the line above says which' if out else ''}, or whether the motions show it at all."
        )
    return out


def not_settled(problem: Problem, estimate: Estimate) -> list[str]:
    """Which effects ended at values that are not plausible, or where they are not linearised.

    What readings are not linear in is estimated in steps that stay within what is plausible. An estimate that points far out of
    it still has run away along what these motions do not tell from other parameters, so those are not to be relied on, either.
    So has one whose standard deviation is wider than all that is plausible.
    """
    point = problem.row_model.point
    if point is None:
        return []
    values, stds = point.values.copy(), np.full(len(point.values), np.inf)
    values[point.free], stds[point.free] = estimate.solution[estimate.base.rank :], estimate.full_std[estimate.base.rank :]
    out, first = [], 0
    for effect in problem.row_model.effects:
        part = slice(first, first := first + len(effect.parameters))
        if not effect.shape or not point.free[part].any():
            continue
        away = np.abs(values[part] - point.values[part])
        low, high = np.array(effect.lower), np.array(effect.upper)
        known = np.isfinite(stds[part])
        outside = np.maximum(low - values[part], values[part] - high) > _CERTAIN * np.where(known, stds[part], 0.0)
        lost = known & ((away > stds[part]) | (stds[part] > high - low))
        if not (outside | lost).any():
            continue
        shown = [f"{key} = {v:.3g} {unit}" for key, v, unit in zip(effect.parameters, values[part], effect.units, strict=True)]
        out.append(
            f"{effect.spec} did not settle: {listed(shown, 3)}. These motions do not tell it from other parameters, which "
            "are then not to be relied on, either. State what is known of it in [model.values], leave it out, or add motions "
            "that show it."
        )
    return out


def listed(names: Iterable[str], shown: int) -> str:
    """The first of some names, and how many more there are."""
    every = list(names)
    return ", ".join(every[:shown]) + (f" and {len(every) - shown} more" if len(every) > shown else "")
