"""Do the data agree with themselves? Motions among each other, wrench and torque, stop-and-go both ways."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bayesid.dynamics.base_parameters import structural_base
from bayesid.errors import InputError
from bayesid.estimators import Estimate, Estimator, fit
from bayesid.estimators.nonlinear import solve
from bayesid.regression.hypothesis_tests import hausman
from bayesid.regression.options import FitOptions
from bayesid.regression.parallel import in_order
from bayesid.regression.problem import Problem, prepare, restrict
from bayesid.regression.readings import make_channels


@dataclass(frozen=True)
class Agreement:
    """Whether two independent estimates of the same numbers agree."""

    #: What was compared.
    first: str
    second: str
    compared: int  # how many independent numbers both determine
    rms: float  # root mean square of their differences in standard deviations; 1 is expected
    probability: float  # of differences at least as large, if both were right
    worst: str  # the number that differs most, with both values

    @property
    def contradiction(self) -> bool:
        """Whether chance cannot explain the difference."""
        return self.probability < 1e-3

    def to_dict(self) -> dict:
        """The comparison as plain data for JSON."""
        return {**self.__dict__, "contradiction": self.contradiction}


def compare_estimates(first: str, one: Estimate, second: str, other: Estimate) -> Agreement | None:
    """Compare two independent estimates of the same base and effect parameters; None without covariance."""
    if one.full_covariance is None or other.full_covariance is None:
        return None
    mine, theirs = (e.base.names + e.effect_names for e in (one, other))
    places = [(mine.index(name), theirs.index(name)) for name in mine if name in theirs]
    places = [(i, j) for i, j in places if not (one.undetermined[i] or other.undetermined[j])]
    if not places:
        return None
    a, b = np.transpose(places)
    covariance = one.full_covariance[np.ix_(a, a)] + other.full_covariance[np.ix_(b, b)]
    labels = [(one.base.labels + one.effect_names)[i] for i in a]
    return _judge(first, second, covariance, labels, one.solution[a], other.solution[b])


def _judge(first, second, covariance, labels, left, right) -> Agreement | None:
    size, difference = np.sqrt(np.diag(covariance)), left - right
    test = hausman(difference, covariance, size, 1e-9)
    if not test.degrees:
        return None
    worst = int(np.argmax(np.abs(difference / size)))
    return Agreement(
        first=first,
        second=second,
        compared=test.degrees,
        rms=float(np.sqrt(test.statistic / test.degrees)),
        probability=test.probability,
        worst=f"{labels[worst]}: {left[worst]:.4g} against {right[worst]:.4g} ({abs(difference[worst] / size[worst]):.1f} sigma)",
    )


#: Estimates from single motions by their names; None where a motion cannot be fitted alone.
Alone = Mapping[str, Estimate | None]


def fits_alone(problem: Problem, method: str | Estimator, motions: Iterable[str]) -> Alone:
    """Fit each of these motions by itself."""
    return {name: _fit_of(problem, method, [name]) for name in motions if problem.segments[name]}


def _fit_of(problem: Problem, method: str | Estimator, motions: Sequence[str]) -> Estimate | None:
    try:
        return fit(restrict(problem, motions).regression, method)
    except (InputError, np.linalg.LinAlgError):
        return None


def motions_apart(problem: Problem, estimate: Estimate, method: str | Estimator, made: Alone | None = None) -> list[Agreement]:
    """Fit every motion by itself and compare it with the estimate from all fitted motions but it.

    Validation motions take part, too; nothing that is estimated depends on what comes out. ``made`` are fits of single motions
    that are there already.
    """
    alone = dict(made or {})

    def compared(name: str) -> Agreement | None:
        rest = [n for n in problem.fitted if n != name]
        if not problem.segments[name] or not rest:
            return None
        one = alone[name] if name in alone else _fit_of(problem, method, [name])
        others = estimate if len(rest) == len(problem.fitted) else _fit_of(problem, method, rest)
        if one is None or others is None:
            return None
        return compare_estimates(f"motion {name}", one, f"motion{'s' * (len(rest) > 1)} {', '.join(rest)}", others)

    return [agreement for agreement in in_order(compared, problem.segments) if agreement is not None]


def wrench_against_torque(problem: Problem, method: str | Estimator) -> Agreement | None:
    """Compare the torque's base parameters with those that the wrench implies.

    The wrench never sees friction, and its base parameters contain the torque's.
    """
    experiment, row_model = problem.experiment, problem.row_model
    names = list(problem.fitted)
    effects = [e.spec for e in row_model.effects]
    wrench, torque = (
        solve(
            prepare(experiment, FitOptions(channel, row_model.filters, names, effects, "joint", problem.smoother.bandwidth)),
            method,
        )[1]
        for channel in ("wrench", "torque")
    )
    if wrench.covariance is None or torque.covariance is None:
        return None
    at_rest = all(r.poses for n in names for r in problem.segments[n])
    full = structural_base(experiment.robot, make_channels(experiment, "torque"), at_rest=at_rest)
    # Rows of K_torque as combinations of K_wrench.
    relation = np.linalg.lstsq(wrench.base.matrix.T, full.matrix.T, rcond=None)[0].T
    inside = np.linalg.norm(relation @ wrench.base.matrix - full.matrix, axis=1) < 1e-4 * np.linalg.norm(full.matrix, axis=1)
    implied = (relation @ wrench.values)[inside]
    covariance = (relation @ wrench.covariance @ relation.T + torque.covariance)[np.ix_(inside, inside)]
    labels = [label for label, ok in zip(torque.base.labels, inside, strict=True) if ok]
    return _judge("wrench", "torque", covariance, labels, implied, torque.values[inside])


def static_both_ways(problem: Problem, method: str | Estimator) -> Estimate | None:
    """The estimate with the stop-and-go run fitted along instead of subtracted, where there is one."""
    if problem.static != "motion":
        return None
    row_model = problem.row_model
    effects = [e.spec for e in row_model.effects if not e.estimated_without_static_run]
    options = FitOptions(problem.channel, row_model.filters, problem.fitted, effects, "joint", problem.smoother.bandwidth)
    return solve(prepare(problem.experiment, options), method)[1]
