"""What a model leaves of every motion once its parameters are fitted: the same numbers in every verb.

They are those of `bayesid.identify` with its default estimator: error in the common band, and residual over noise that does not
depend on the model. Whoever compares two models compares these.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from bayesid.errors import InputError
from bayesid.estimators.estimator import Estimate
from bayesid.estimators.nonlinear import default_method, solve
from bayesid.recordings.experiment import Experiment
from bayesid.regression.options import FitOptions
from bayesid.regression.parallel import in_order
from bayesid.regression.problem import Problem, prepare
from bayesid.validation.noise_floor import noise_floor
from bayesid.validation.prediction import Prediction, predict


@dataclass(frozen=True, eq=False)
class MotionErrors:
    """What is left of one motion by the user's model, and by that with the effects named."""

    #: Which, and whether it was fitted.
    motion: str
    fitted: bool
    #: Predictions by the fits of both; ``after`` is None where no effect is named, or the model with it cannot be fitted.
    before: Prediction
    after: Prediction | None = None

    @property
    def last(self) -> Prediction:
        """Prediction by the model as it is handed on."""
        return self.before if self.after is None else self.after

    def to_dict(self) -> dict:
        """An entry of ``errors`` in ``diagnosis.json``."""
        sides = {"before": self.before, "after": self.after}
        known = self.before.noise_known
        return {
            "motion": self.motion, "fitted": self.fitted, "noise_source": self.before.noise_source,
            **{f"relative_{k}": None if p is None else p.relative_error for k, p in sides.items()},
            **{f"times_noise_{k}": p.times_noise if p is not None and known else None for k, p in sides.items()},
            "complete_model": self.last.expected_rms if known else None,
            "channels": {
                name: {
                    "unit": unit, "signal": float(self.before.signal[c]),
                    **{k: None if p is None else float(p.rmse[c]) for k, p in sides.items()},
                }
                for c, (name, unit) in enumerate(zip(self.before.channel_names, self.before.channel_units, strict=True))
            },
        }  # fmt: skip


def predicted_worse(errors: Sequence[MotionErrors]) -> bool:
    """Whether motions that were not fitted are predicted worse with the effects named, in their own size and in the noise's."""
    unseen = [(e.before, e.after) for e in errors if not e.fitted and e.after is not None]
    measures = [("relative_error", True), ("times_noise", all(before.noise_known for before, _ in unseen))]
    sums = [np.sum([(getattr(b, name), getattr(a, name)) for b, a in unseen], axis=0) for name, known in measures if known]
    return bool(unseen) and all(after > before for before, after in sums)


def left_dict(prediction: Prediction) -> dict:
    """An entry of ``left`` in ``check.json`` and ``watch.json``."""
    p = prediction
    return {
        "motion": p.motion, "fitted": p.fitted, "relative_error": p.relative_error,
        "times_noise": p.times_noise if p.noise_known else None, "noise_source": p.noise_source,
    }  # fmt: skip


def left_text(prediction: Prediction) -> str:
    """``1.02 times the noise, 3.67 % of the signal``."""
    noise = f"{prediction.times_noise:.3g} times the noise" if prediction.noise_known else "noise not known"
    return f"{noise}, {100 * prediction.relative_error:.3g} % of the signal"


@dataclass(frozen=True)
class Shift:
    """A base parameter without and with effects in the model, in SI units of its label."""

    label: str
    before: float
    after: float
    sigmas: float  # before less after, in standard deviations of the latter


@dataclass(frozen=True, eq=False)
class BeforeAndAfter:
    """What two models leave of every motion, those that were not fitted first, and what the second does to base parameters.

    ``refused`` says where one cannot be fitted; there are no errors where the first cannot.
    """

    errors: tuple[MotionErrors, ...] = ()
    shifts: tuple[Shift, ...] = ()  # those above three standard deviations, most first
    refused: str = ""


def fit_and_predict(problem: Problem) -> tuple[Estimate, tuple[Prediction, ...]]:
    """A model as `bayesid.identify` fits it, and its predictions of the motions fitted and of those of role ``validation``."""
    problem, estimate = solve(problem, default_method(problem))
    floor = noise_floor(problem)
    motions = [
        m for m in problem.experiment.motions
        if m.name in problem.segments and (m.name in problem.fitted or m.role == "validation")
    ]  # fmt: skip
    return estimate, tuple(in_order(partial(predict, problem, estimate, floor=floor), motions))


def chosen_bandwidth(experiment: Experiment, options: FitOptions) -> float:
    """Bandwidth of the joint motion at which `bayesid.identify` fits a model [Hz]; infinite where it cannot fit it."""
    try:
        problem = prepare(experiment, options)
        problem, _ = solve(problem, default_method(problem))
    except (InputError, np.linalg.LinAlgError):
        return np.inf
    return problem.smoother.bandwidth


def before_and_after(before: Experiment, after: Experiment | None, options: FitOptions) -> BeforeAndAfter:
    """Fit two models of the same recordings; the second may be None.

    ``options`` say which readings and motions; the effects are those of the experiments.
    """
    try:
        estimate, predictions = fit_and_predict(prepare(before, options))
    except InputError as error:  # a diagnosis may compare what leaves no rows to fit
        return BeforeAndAfter(
            refused=f"What the model leaves of the motions is not given, for `identify` cannot fit it: {error}."
        )
    later, shifts, refused = {}, (), ""
    try:
        if after is not None:
            other, predicted = fit_and_predict(prepare(after, options))
            later, shifts = {p.motion: p for p in predicted}, _shifts(estimate, other)
    except (InputError, np.linalg.LinAlgError) as error:
        refused = f"What the model with the effects named leaves is not given, for `identify` cannot fit it: {error}."
    errors = [MotionErrors(p.motion, p.fitted, p, later.get(p.motion)) for p in predictions]
    return BeforeAndAfter(tuple(sorted(errors, key=lambda e: e.fitted)), shifts, refused)


def _shifts(before: Estimate, after: Estimate) -> tuple[Shift, ...]:
    """Base parameters of both models that move by more than three standard deviations of the second, most first."""
    old = dict(zip(before.base.labels, before.values.tolist(), strict=True))
    moved = [
        Shift(label, old[label], value, (old[label] - value) / std)
        for label, value, std in zip(after.base.labels, after.values.tolist(), after.std.tolist(), strict=True)
        if label in old and 0.0 < std < np.inf  # not a number where nothing is known
    ]
    return tuple(sorted((s for s in moved if abs(s.sigmas) > 3.0), key=lambda s: -abs(s.sigmas)))
