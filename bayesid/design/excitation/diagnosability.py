"""Which effects a planned motion could show, how small, and which it could not tell apart.

An effect is seen where it stands out by five standard deviations of the readings. With the minimum detectable effects (MDE) and
the shares c^2 of their nearest rivals, see `bayesid.diagnosis.detectability`, a motion's diagnosability is

    mean log MDE / usual size  +  mean over effects of log 1 / (1 - c^2) / 2

(smaller is better): the mean logarithm of the size from which each effect is seen for itself and not for its nearest rival. Both
the size and what the rival makes of it count as a hundred at most: beyond that they are rounding.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayesid.design.excitation.information import Information
from bayesid.design.excitation.series import FourierSeries
from bayesid.diagnosis.detectability import IMPLAUSIBLE, DetectableEffect, detectable_effects
from bayesid.diagnosis.settings import DEFAULT
from bayesid.effects import Effect, MotionSegment, Term
from bayesid.effects.exact import columns, readings
from bayesid.recordings.experiment import Experiment
from bayesid.regression.linalg import orthonormal_basis
from bayesid.robot.prior import assumed_links

#: Samples of a period; parts of a trace that count as nothing.
_SAMPLES, _NOTHING = 300, 1e-5
#: Shares of the longest column, and of the largest singular value, that count as none, see `orthonormal_basis`.
_NONE = (1e-9, 1e-8)


@dataclass(frozen=True)
class Diagnosability:
    """What a motion could show beyond the model."""

    effects: tuple[DetectableEffect, ...]  # one entry an effect and place, those that are seen worst first
    hidden: tuple[str, ...]  # effects that links or the model's own effects explain wholly, at any size

    @property
    def value(self) -> float:
        """The mean logarithm of sizes, see the module."""
        if not self.effects:
            return 0.0
        seen = np.array([e.smallest / e.usual for e in self.effects])
        left = np.array([1.0 - e.share for e in self.effects])
        return float(np.mean(np.log(np.minimum(seen, IMPLAUSIBLE)) - np.log(np.maximum(left, IMPLAUSIBLE**-2.0)) / 2.0))


def diagnosability(experiment: Experiment, information: Information, series: FourierSeries, recorded: float) -> Diagnosability:
    """What a motion of so many recorded samples could show of every effect of the library that acts on these readings."""
    robot, channels = experiment.robot, information.channels
    links = assumed_links(robot)
    gravity = information.sensor_set.gravity
    step = series.period / _SAMPLES
    times = step * np.arange(_SAMPLES)
    segment = MotionSegment(times, *series.at(times), cell=step)
    weight = np.sqrt(recorded / _SAMPLES) / information.std
    nothing = readings(robot, channels, segment, links, gravity=gravity)
    nuisance = orthonormal_basis(information.explaining(series, step, _SAMPLES), *_NONE)
    traced: list[tuple[Effect, np.ndarray, np.ndarray]] = []
    hidden = []
    for effect in _library(experiment, information):
        usual = tuple(float(v) for v in effect.typical(robot))
        with np.errstate(all="ignore"):  # what diverges is left out
            whole = readings(robot, channels, segment, links, (Term(effect, usual),), gravity=gravity) - nothing
            parts = columns(robot, channels, segment, links, (), effect, usual, gravity=gravity)
        if not np.isfinite(whole).all() or not np.isfinite(parts).all() or not whole.any():
            continue
        trace = (whole * weight).ravel()
        rest = trace - nuisance @ (nuisance.T @ trace)
        if np.linalg.norm(rest) < _NOTHING * np.linalg.norm(trace):
            hidden.append(effect.spec)
            continue
        own = (parts * weight[:, None]).reshape(len(trace), -1)
        traced.append((effect, rest, orthonormal_basis(own - nuisance @ (nuisance.T @ own), *_NONE)))
    effects = detectable_effects(robot, traced, lambda _: DEFAULT.detected)
    return Diagnosability(tuple(sorted(effects, key=lambda e: -e.smallest / e.usual)), tuple(hidden))


def _library(experiment: Experiment, information: Information) -> list[Effect]:
    """Every effect that the library has for these readings, at each of its places, but those of the model."""
    own, gravity = {e.spec for e in information.effects}, information.sensor_set.gravity
    return [
        e for e in experiment.possible_effects(information.channels.names)
        if not e.once and e.columns_of is None and (gravity or not e.removed_by_static_run)
        and e.spec not in own and any(e.typical(experiment.robot))
    ]  # fmt: skip
