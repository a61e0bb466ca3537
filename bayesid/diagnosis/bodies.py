"""Payload or inertia error? Both change one link; a payload's change is a body that could exist."""

from __future__ import annotations

import warnings

import cvxpy as cp
import numpy as np
from scipy.stats import chi2

from bayesid.diagnosis.fit import Fit
from bayesid.effects import Term
from bayesid.robot import inertia
from bayesid.robot.prior import Prior

_DRAWN = 5000
#: A link's length, for the solver's units [m].
_LENGTH = 0.1
#: Weight of the size of what is not shown beside that of what is, squared standard deviations a squared SI unit.
_LITTLE = 1e-6


def as_payload(fitted: Fit, index: int, dispersion: float) -> tuple[Term, float]:
    """A change of a link as an attached body, if a possible body is near enough, and what that adds to its evidence.

    Among all changes of a link as large as itself few are bodies that could be attached: if the one found is, that speaks
    for a payload by one over their share. Any other effect is returned as it is.
    """
    term = fitted.terms[index]
    if (name := term.effect.may_be) is None or not np.isfinite(fitted.score):
        return term, 0.0
    at = [column for column, (owner, _) in enumerate(fitted.free) if owner == index]
    values, covariance = np.array(term.values), dispersion * fitted.covariance[np.ix_(at, at)]
    # What the data do not show, as all inertia of poses at rest, is whatever a possible body needs, and little.
    shown = np.diag(covariance) > 0.0
    size = np.sqrt(np.where(shown, np.diag(covariance), 1.0))
    spread, axes = np.linalg.eigh((covariance / np.outer(size, size))[np.ix_(shown, shown)])
    root = np.zeros((len(spread), 10))
    root[:, shown] = (axes / np.sqrt(np.maximum(spread, max(1e-9 * spread[-1], 1e-300)))).T / size[shown]
    # In units of the change's own size, so that masses and moments of inertia weigh alike in the solver.
    body, pseudo = cp.Variable(10), cp.Variable((4, 4), PSD=True)
    length = np.array([_LENGTH, _LENGTH, _LENGTH, 1.0])
    basis = (inertia.BASIS / np.outer(length, length)).reshape(10, 16) * size[:, None]
    same: list[cp.Constraint] = [cp.vec(pseudo, order="C") == basis.T @ body]
    little = _LITTLE * cp.sum_squares(body[~shown]) if not shown.all() else 0.0
    problem = cp.Problem(cp.Minimize(cp.sum_squares((root * size) @ body - root @ values) + little), same)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a distance of three digits is accurate enough
        try:
            problem.solve(solver=cp.CLARABEL)
        except cp.SolverError:
            return term, 0.0
    if body.value is None:
        return term, 0.0
    distance = np.sum(((root * size) @ body.value - root @ values) ** 2)
    if chi2.sf(distance, len(root)) < 1.0 - fitted.projector.data.settings.interval:
        return term, 0.0
    effect = next(e for e in fitted.projector.data.places(name) if e.where == term.effect.where)
    joint = effect.joint or 0
    return Term(effect, tuple(size * body.value)), _rarity(fitted.projector.data.links[10 * joint : 10 * joint + 10])


def _rarity(link: np.ndarray) -> float:
    """Log of one over the share of changes of a link, as large as itself, that are possible bodies."""
    covariance = Prior.warped(link, 1.0).covariance
    size = np.sqrt(np.diag(covariance))
    root = size[:, None] * np.linalg.cholesky(covariance / np.outer(size, size) + 1e-12 * np.eye(10))
    changes = np.random.default_rng(0).normal(size=(_DRAWN, 10)) @ root.T
    possible = np.linalg.eigvalsh(inertia.pseudo_inertia(changes))[:, 0] >= 0.0
    return float(np.log(_DRAWN / max(np.count_nonzero(possible), 1)))
