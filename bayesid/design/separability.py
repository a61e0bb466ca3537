"""How well motions tell two effects apart, in closed form and before any reading.

Whitened rows of a model with both effects beside the links, offsets and the user's effects have a factor R. Where A is there at
its usual values a, and B is fitted in its stead, the best fit leaves the noncentrality

    lambda = |(1 - P) R_A a|^2,     P: projector on all columns of R but A's, and on what a prior knows of the links.

The log evidence between the two is then about N(lambda / 2, lambda) [AtkinsonFedorov1975]_, and A rules B out where it exceeds
the difference from which a diagnosis no longer lists B as a rival (`bayesid.design.tell` does the same for what recordings have
shown so far).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtr

from bayesid.design.expected import rows_of
from bayesid.design.identifiability import PlannedMotions
from bayesid.design.reading_noise import ReadingNoise, SensorSet
from bayesid.diagnosis.settings import Settings
from bayesid.effects import Effect
from bayesid.estimators.factor import reduce_whitened
from bayesid.regression.linalg import pseudo_inverse
from bayesid.regression.readings import make_channels
from bayesid.regression.rows import make_blocks
from bayesid.robot.prior import Prior, states_masses

#: Share of their usual amplitude about which readings are linearised: effects have columns for shapes, and none changes another.
_HARDLY = 1e-3
#: An effect that changes the readings by less than this many standard deviations at its usual size cannot imitate another.
_UNSEEN = 0.1
#: Of the normal distribution, for 95 %.
_QUANTILE = 1.645


@dataclass(frozen=True)
class Separation:
    """One effect as the true one, and another in its stead."""

    #: ``name@where``.
    true: str
    other: str
    seen: float  # noncentrality of the true one at its usual size if the other is not in the model: how well it is seen at all
    noncentrality: float  # what is left of it when the other is fitted in its stead
    probability: float  # that the true one rules the other out
    smallest: float | None  # share of the usual size from which it does so with 95 % probability; None where no size does


def separations(
    plan: PlannedMotions, sensor_set: SensorSet, noise: ReadingNoise, effects: Sequence[Effect], *, bandwidth: float | None = None
) -> tuple[Separation, ...]:
    """Every effect as the true one against every other, as far as both act on the readings; the rest as for `report_of`."""
    names = make_channels(plan.experiment, sensor_set.channel).names
    gone = sensor_set.offset != "fitted"  # no such set shows what a static run removes
    acting = [e for e in effects if any(e.acts_on(n) for n in names) and not (gone and e.removed_by_static_run)]
    if len(acting) < 2:
        return ()
    factor, names = _factor(plan, sensor_set, noise, acting, bandwidth)
    robot, out = plan.experiment.robot, []
    own = {e.spec: [k for k, n in enumerate(names) if n in e.column_names] for e in acting}
    usual = {e.spec: np.array([x * a for x, a in zip(e.typical(robot), _amplitudes(e), strict=True)], float) for e in acting}
    traces = {e.spec: factor[:, own[e.spec]] @ usual[e.spec] for e in acting}
    others = [k for k in range(len(names)) if not any(k in at for at in own.values())]
    for true in traces:
        for other in traces:
            if other == true:
                continue
            imitates = own[other] if np.linalg.norm(traces[other]) > _UNSEEN else []
            seen, left = (_left(factor[:, columns], traces[true]) for columns in (others, [*others, *imitates]))
            needed = Settings().rival
            chance = float(ndtr((0.5 * left - needed) / np.sqrt(max(left, 1e-12))))
            # lambda / 2 - needed = z sqrt(lambda) at the wanted probability; lambda grows with the square of the size.
            enough = _QUANTILE + np.sqrt(_QUANTILE**2 + 2.0 * needed)
            smallest = None if left < 1e-9 * seen or left <= 0.0 else float(enough / np.sqrt(left))
            out.append(Separation(true, other, seen, left, chance, smallest))
    return tuple(out)


def pair_of(plan: PlannedMotions, specs: Sequence[str]) -> tuple[Effect, ...]:
    """Effects to be distinguished, made from their names, as in `bayesid.effects.EffectLibrary.parse_rivals`."""
    e, every = plan.experiment, make_channels(plan.experiment, "both").names
    known = [x.spec for x in e.library.parse(e.effects, e.robot.joint_names, every, e.gear_ratio)]
    return e.library.parse_rivals(specs, known, e.robot.joint_names, every, e.gear_ratio, "both")


def _factor(
    plan: PlannedMotions, sensor_set: SensorSet, noise: ReadingNoise, effects: Sequence[Effect], bandwidth: float | None
) -> tuple[np.ndarray, tuple[str, ...]]:
    """Factor of whitened rows of the model with these effects, a prior of the links under it, and names of its columns."""
    experiment = plan.experiment
    robot, values = experiment.robot, dict(experiment.effect_values)
    for effect in effects:
        usual = zip(effect.parameters, effect.typical(robot), _amplitudes(effect), strict=True)
        values[effect.spec] = {name: float(x) * (_HARDLY if a else 1.0) for name, x, a in usual}
    asked = replace(experiment, effects=(*experiment.effects, *(e.spec for e in effects)), effect_values=values)
    model, segments = rows_of(asked, sensor_set, plan.motions, bandwidth=bandwidth)
    names = (*model.base.names, *model.effect_names)
    if not segments:
        return np.zeros((1, len(names))), names
    rows = reduce_whitened(make_blocks(model, segments), noise.of(sensor_set)).matrix
    if experiment.inertia_rel_std and states_masses(robot):
        k = model.base.matrix
        covariance = k @ Prior.warped(robot.nominal, experiment.inertia_rel_std).covariance @ k.T
        size = np.sqrt(np.diag(covariance))
        known = np.zeros((len(k), rows.shape[1]))
        known[:, : len(k)] = np.linalg.inv(np.linalg.cholesky(covariance / np.outer(size, size))) / size
        rows = np.vstack([rows, known])
    return rows, names


def _left(columns: np.ndarray, trace: np.ndarray) -> float:
    """Squared length of what columns do not explain of a trace."""
    rest = trace - columns @ (pseudo_inverse(columns) @ trace)
    return float(rest @ rest)


def _amplitudes(effect: Effect) -> list[bool]:
    """Which parameters say how large an effect is: those that readings are linear in, or all where there are none."""
    linear = [q.linear for q in effect.quantities]
    return linear if any(linear) else [True] * len(linear)
