"""Which effects a planned motion could show, how small, and which it could not tell apart.

The trace z of an effect is what it changes at its usual size in all readings, in standard deviations, less what links and the
effects of the model explain. It stands out by five standard deviations from ``5 / |z|`` times the usual size on, the minimum
detectable effect (MDE); another effect, with the derivative columns Q of its parameters made orthonormal, explains the share
``c^2 = |Q' z|^2 / |z|^2`` of it. A motion's diagnosability is

    mean log MDE / usual size  +  mean over effects of log 1 / (1 - c^2) / 2

(smaller is better): the mean logarithm of the size from which each effect is seen for itself and not for its nearest rival.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayesid.design.excitation.information import Information
from bayesid.design.excitation.series import FourierSeries
from bayesid.diagnosis.settings import DEFAULT
from bayesid.effects import Effect, MotionSegment, Term
from bayesid.effects.exact import columns, readings
from bayesid.recordings.experiment import Experiment
from bayesid.regression.linalg import orthonormal_basis
from bayesid.robot.prior import assumed_links

#: Samples of a period; parts of a trace that count as nothing; shares up to which two traces count as different.
_SAMPLES, _NOTHING, _SAME = 300, 1e-5, 1.0 - 1e-6
#: Shares of the longest column, and of the largest singular value, that count as none, see `orthonormal_basis`.
_NONE = (1e-9, 1e-8)


@dataclass(frozen=True)
class Detectable:
    """What a motion could show of one effect."""

    #: The effect and its place, ``name@where``; the parameter that gives its size.
    effect: str
    parameter: str
    unit: str
    #: A usual size, and the smallest that stands out.
    usual: float
    smallest: float
    #: The effect that explains most of its trace, and how much of it; None and 0 without any other.
    rival: str | None
    share: float

    @property
    def named(self) -> float:
        """Smallest size that stands out beside the nearest rival; infinite where both leave the same trace."""
        return self.smallest / float(np.sqrt(1.0 - self.share)) if self.share < _SAME else np.inf


@dataclass(frozen=True)
class Diagnosability:
    """What a motion could show beyond the model."""

    effects: tuple[Detectable, ...]  # one entry an effect and place, those that are seen worst first
    hidden: tuple[str, ...]  # effects that links or the model's own effects explain wholly, at any size

    @property
    def value(self) -> float:
        """The mean logarithm of sizes, see the module; those with a rival of the same trace count as seen only."""
        sizes = [(e.named if np.isfinite(e.named) else e.smallest) / e.usual for e in self.effects]
        return float(np.mean(np.log(sizes))) if sizes else 0.0


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
    found: list[tuple[Effect, np.ndarray, np.ndarray]] = []
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
        found.append((effect, rest, orthonormal_basis(own - nuisance @ (nuisance.T @ own), *_NONE)))
    traces = np.array([rest / np.linalg.norm(rest) for _, rest, _ in found]).reshape(len(found), -1)
    shares = np.array([np.sum((basis.T @ traces.T) ** 2, axis=0) for *_, basis in found]).reshape(len(found), len(found))
    np.fill_diagonal(shares, -1.0)
    out = []
    for k, (effect, rest, _) in enumerate(found):
        usual = np.asarray(effect.typical(robot), float)
        by = int(np.flatnonzero(usual)[0])
        nearest = int(np.argmax(shares[:, k]))
        rival, share = (found[nearest][0].spec, float(np.clip(shares[nearest, k], 0.0, 1.0))) if len(found) > 1 else (None, 0.0)
        size = abs(float(usual[by]))
        smallest = DEFAULT.detected / float(np.linalg.norm(rest)) * size
        out.append(Detectable(effect.spec, effect.parameters[by], effect.units[by], size, smallest, rival, share))
    out.sort(key=lambda e: -e.smallest / e.usual)
    return Diagnosability(tuple(out), tuple(hidden))


def _library(experiment: Experiment, information: Information) -> list[Effect]:
    """Every effect that the library has for these readings, at each of its places, but those of the model."""
    library, own = experiment.library, {e.spec for e in information.effects}
    out: list[Effect] = []
    for name, c in library.classes.items():
        if c.once or c.columns_of is not None or (c.removed_by_static_run and not information.sensor_set.gravity):
            continue
        found = library.places(name, experiment.robot.joint_names, information.channels.names, experiment.gear_ratio)
        out += [e for e in found if e.spec not in own and any(e.typical(experiment.robot))]
    return out
