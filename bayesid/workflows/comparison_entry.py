"""One estimator in a comparison: its fit or its refusal, its links and what it predicts."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from bayesid.dynamics.nearest_links import nearest_links
from bayesid.errors import BayesidError, EstimationError
from bayesid.estimators import Estimate, Estimator, fit
from bayesid.estimators.factor import Weights
from bayesid.regression.problem import Problem
from bayesid.regression.regression import Regression
from bayesid.results.files import strict
from bayesid.robot import inertia
from bayesid.validation.prediction import Prediction, predict


@dataclass(frozen=True)
class Entry:
    """What one estimator made of the data.

    Attributes
    ----------
    name
        The estimator's, made unique.
    description
        What it is, in one line.
    estimate
        None where the estimator refused; ``refusal`` says why.
    refusal
        Empty where there is an estimate.
    seconds
        Time of the fit alone; rows and noise are made once for all.
    links
        Link parameters (P,): the estimator's own, or the nearest to the nominal ones; None without a robot.
    impossible
        Names of the bodies that cannot exist; None without ``links``.
    fitted, validation
        Predictions of the fitted motions and of the others.
    """

    name: str
    description: str
    estimate: Estimate | None
    refusal: str = ""
    seconds: float = 0.0
    links: np.ndarray | None = None
    impossible: tuple[str, ...] | None = None
    fitted: tuple[Prediction, ...] = ()
    validation: tuple[Prediction, ...] = ()

    @property
    def physically_consistent(self) -> bool | None:
        """Whether every link can exist; None where that is not known."""
        return None if self.impossible is None else not self.impossible

    @property
    def proof(self) -> tuple[Prediction, ...]:
        """Predictions of validation motions, or of the fitted ones where there is no other."""
        return self.validation or self.fitted

    def to_dict(self) -> dict[str, Any]:
        """The estimator's part of ``comparison.json``."""
        if self.estimate is None:
            return {"name": self.name, "status": "refused", "reason": self.refusal, "seconds": self.seconds}
        estimate = self.estimate
        own = slice(estimate.base.rank, None)
        document = {k: v for k, v in estimate.to_dict().items() if k not in ("base_map", "link_parameter_names", "rank")}
        effects = [
            {"name": n, "value": float(v), "std": float(s), "unit": u}
            for n, u, v, s in zip(
                estimate.effect_names, estimate.effect_units, estimate.solution[own], estimate.full_std[own], strict=True
            )
        ]
        proof = {
            "link_parameters": None if self.links is None else self.links.tolist(),
            "physically_consistent": self.physically_consistent,
            "impossible_bodies": None if self.impossible is None else list(self.impossible),
            **self.proof_to_dict(),
        }
        known = {k: v for k, v in proof.items() if v is not None}
        return strict({"name": self.name, "status": "fitted", **document, "effects": effects, **known, "seconds": self.seconds})

    def proof_to_dict(self) -> dict[str, Any]:
        """Predictions; empty where there is no motion."""
        if not self.proof:
            return {}
        return {"validation": [p.to_dict() for p in self.validation], "fit": [p.to_dict() for p in self.fitted]}


def attempt(name: str, method: Estimator, regression: Regression) -> Entry:
    """Fit, timed; whatever an estimator raises because of the data becomes a refusal, anything else is a bug."""
    started = time.perf_counter()
    lines = (type(method).__doc__ or "").strip().splitlines()
    description = lines[0] if lines else ""
    try:
        estimate = fit(regression, method)
        if estimate.solution.shape != (len(regression.column_names),) or not np.isfinite(estimate.solution).all():
            raise EstimationError(f"gave no finite solution of {len(regression.column_names)} parameters")
    except (BayesidError, ArithmeticError, np.linalg.LinAlgError) as error:
        refusal = " ".join(str(error).split()) or type(error).__name__
        return Entry(name, description, None, refusal, time.perf_counter() - started)
    return Entry(name, description, estimate, seconds=time.perf_counter() - started)


def prove(entry: Entry, problem: Problem, weights: Weights) -> Entry:
    """Add links and predictions of all motions; residuals are counted in one and the same noise for all."""
    estimate, row_model = entry.estimate, problem.row_model
    if estimate is None:
        return entry
    links = estimate.links
    if links is None:
        kept = ~estimate.undetermined[: row_model.base.rank]
        links = nearest_links(problem.experiment.robot, row_model.base, estimate.values, kept)
    same = replace(estimate, noise=weights.noise)
    predictions = [predict(problem, same, m) for m in problem.experiment.motions if m.name in problem.segments]
    return replace(
        entry,
        links=links,
        impossible=_impossible(links.reshape(-1, 10), problem.experiment.robot.body_names),
        fitted=tuple(p for p in predictions if p.motion in problem.fitted),
        validation=tuple(p for p in predictions if p.motion not in problem.fitted and p.role == "validation"),
    )


def with_own_links(entry: Entry, regression: Regression) -> Entry:
    """Without a robot, links are known only to an estimator that estimates them."""
    if entry.estimate is None or entry.estimate.links is None or not regression.bodies:
        return entry
    links = entry.estimate.links
    names = tuple(regression.base.parameter_names[body[0]].rpartition(".")[0] or f"body {k + 1}"
                  for k, body in enumerate(regression.bodies))  # fmt: skip
    return replace(entry, links=links, impossible=_impossible(links[np.array(regression.bodies)], names))


def _impossible(bodies: np.ndarray, names: Sequence[str]) -> tuple[str, ...]:
    """Bodies (b, 10) that cannot exist; a frame without mass in the URDF, that no motion weighs, is no body."""
    heavy = np.abs(bodies).max(axis=1) > 1e-9
    exists = inertia.is_physically_consistent(bodies)
    return tuple(name for name, ok in zip(names, exists | ~heavy, strict=True) if not ok)
