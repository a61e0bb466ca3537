"""Look for a mistake: which change of the data would let a robot that can exist explain them, and how much better."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayesid.errors import InputError
from bayesid.recordings.experiment import Experiment
from bayesid.regression.parallel import one_blas_thread
from bayesid.regression.readings import make_channels
from bayesid.validation.mistakes.candidates import Candidate, candidates
from bayesid.validation.mistakes.delay import delayed
from bayesid.validation.mistakes.evidence import EXPLAINED, Explainer, Fit
from bayesid.validation.mistakes.mistake import Mistake
from bayesid.validation.mistakes.samples import low_passed
from bayesid.validation.mistakes.scale import WORSE, implausible_size

#: A mistake is as rare as one in a thousand, and must be a thousand times as probable as none: log(1e6) [nats].
NEEDED = 13.8
#: Candidates whose evidence is this close cannot be told apart: odds of 150 [nats].
_ALIKE = 5.0
#: A channel explained better than this share of its variation gives no cause to doubt its joint.
_DOUBTED = 0.05
_LISTED = 3


def find_mistakes(experiment: Experiment) -> tuple[Mistake, ...]:
    """Mistakes of signs, orders, units and frames that would explain what no robot can do; usually none.

    Gravity, masses, friction and power have signs: a robot that can exist, with friction that brakes, does not explain
    readings of which one has the wrong sign. Every candidate is undone in turn and the best such robot is fitted to a few
    hundred low-passed samples; one is named where the data become far more probable by it. Nothing is guessed where a finding
    about the recording explains its readings (`bayesid.recordings.finding`), nor where they are late against the motion
    (`bayesid.validation.mistakes.delay`).

    Parameters
    ----------
    experiment
        The recordings; those that are fitted are looked at.
    """
    found: list[Mistake] = []
    explained = {channel for finding in experiment.findings for channel in finding.silences}
    with one_blas_thread():
        for channel in ("wrench", "torque"):
            if channel in explained or (channel == "wrench" and experiment.sensor is None):
                continue
            try:
                with np.errstate(over="ignore", invalid="ignore"):
                    late = delayed(experiment, channel)
                    found += [late] if late else _in_channel(experiment, channel)
            except (InputError, np.linalg.LinAlgError, ValueError, RuntimeError):
                # Too short or too uneven to be smoothed, or numbers of a size that no robot has: others say that better.
                continue
    found.sort(key=lambda m: -m.evidence)
    return tuple({(m.name, m.where): m for m in reversed(found)}.values())[::-1]


def _in_channel(experiment: Experiment, channel: str) -> list[Mistake]:
    samples = low_passed(experiment, channel)
    if samples is None:
        return []
    explainer = Explainer(experiment.robot, make_channels(experiment, channel), samples)
    unchanged = explainer.fit()
    worth = explainer.independent_samples(unchanged[0])

    def best_of(fits: Sequence[Fit]) -> tuple[float, Fit]:
        return max(((fit.score(worth), fit) for fit in fits), key=lambda pair: pair[0])

    now, null = best_of(unchanged)
    needed = max(NEEDED, worth * WORSE)
    reach = np.abs(samples.positions).max(axis=0)
    tried = []
    for candidate in _worth_trying(candidates(experiment, channel, reach), explainer, unchanged):
        if explainer.highest_score(candidate.readings, worth) - now < max(NEEDED, needed - _ALIKE):
            continue  # could be neither named nor listed beside what is
        score, fit = best_of(explainer.fit(candidate.readings, candidate.joints, candidate.gravity))
        tried.append((score - now, candidate, fit))
    tried.sort(key=lambda t: -t[0])
    if not tried or tried[0][0] < needed:
        # Of readings that no robot explains at all, not even the size means anything.
        return implausible_size(explainer) if np.median(null.errors) < 0.5 else []
    best, candidate, fit = tried[0]
    alike = [c for evidence, c, _ in tried[1:] if evidence > max(best - _ALIKE, NEEDED)]
    names, units = explainer.channels.names, explainer.channels.units
    return [
        Mistake(
            name=candidate.name, where=candidate.where, text=_text(candidate, alike, null, fit, names, units), channel=channel,
            evidence=float(best), before=tuple(map(float, null.left)), after=tuple(map(float, fit.left)),
            alternatives=tuple((c.name, c.where) for c in alike),
        )
    ]  # fmt: skip


def _worth_trying(every: Sequence[Candidate], explainer: Explainer, fits: Sequence[Fit]) -> list[Candidate]:
    """Leave out what concerns only joints whose readings are explained, by the nominal bodies where there are any."""
    null = fits[-1]
    doubted = (null.errors > _DOUBTED) & (null.left > explainer.floor(explainer.variation))
    if not explainer.torque:
        return [c for c in every if not c.touched or (null.errors > EXPLAINED).any()]
    return [c for c in every if doubted[list(c.touched)].all()]


def _text(
    candidate: Candidate, alike: Sequence[Candidate], null: Fit, fit: Fit, names: Sequence[str], units: Sequence[str]
) -> str:
    """One line: what seems wrong, what else it could be, by how much the fit improves, and the remedy."""
    k = int(np.argmax(null.left / np.maximum(fit.left, 1e-12)))
    others = "; or ".join([*(c.says for c in alike[:_LISTED]), *(["..."] if len(alike) > _LISTED else [])])
    either = f" (or {others})" if others else ""
    return (
        f"{candidate.says[0].upper()}{candidate.says[1:]}{either}: with that undone, what no possible robot explains of "
        f"{names[k]} falls from {null.left[k]:.2g} to {fit.left[k]:.2g} {units[k]} rms; {candidate.remedy}"
    )
