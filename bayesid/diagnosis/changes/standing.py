"""What the reference's model lacks is in both recordings: it is no change.

Friction near zero speed, say, which a model does not have, is there before and after. So what is asked of an effect is not
whether the later recording shows it but whether it shows another amplitude than the reference. With weighted rows ``X`` of
the reference's model and ``Z`` of the effect, an amplitude a moves its estimate by ``-S a``, ``S = (X'WX)^-1 X'WZ``, and with
``Z_ = Z - X S`` its own estimate and covariance there are

    a = (Z_'WZ_)^-1 Z_'W y,    V = (Z_'WZ_)^-1 Z_' W Sigma W Z_ (Z_'WZ_)^-1

times the reference's dispersion: the same sandwich as that of links and friction.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayesid.diagnosis.changes.proposals import Proposal, with_proposals
from bayesid.effects import Point
from bayesid.estimators.weights import learn_weights
from bayesid.regression.linalg import or_one, pseudo_inverse
from bayesid.regression.problem import Problem
from bayesid.regression.rows import make_blocks

#: Share of a column that must be left beside the model's own for its amplitude in the reference to be asked for.
_SEEN = 1e-4
#: Squared effect of a typical amplitude on all rows, in units of their noise, below which it is none; and share of the largest.
_FAINT, _SINGULAR = 1e-4, 1e-9


@dataclass(frozen=True, eq=False)
class Standing:
    """What the reference says of effects that its model does not have.

    Attributes
    ----------
    carried
        S, how its estimate moves with each column's amplitude (p, z).
    gram, middle
        ``Z_'WZ_`` and ``Z_'W Sigma W Z_`` (z, z).
    target
        ``Z_'W y`` (z,).
    """

    carried: np.ndarray
    gram: np.ndarray
    middle: np.ndarray
    target: np.ndarray

    @classmethod
    def of(cls, problem: Problem, point: Point, solution: np.ndarray, proposals: tuple[Proposal, ...]) -> Standing:
        """Ask the reference.

        Parameters
        ----------
        problem, point, solution
            Its fit.
        proposals
            The effects.
        """
        weights = learn_weights(problem.regression)
        model = with_proposals(problem.row_model, point, proposals)
        p = len(solution)
        gram, middle = np.zeros((2, model.base.rank + model.extra_columns + 1, model.base.rank + model.extra_columns + 1))
        for block in make_blocks(model, [s for name in problem.fitted for s in problem.segments[name]]):
            noise = weights.noise[block.group]
            rows = block.rows.copy()
            rows[:, :, -1] -= rows[:, :, :p] @ solution
            white = (rows / noise.std[:, None]).reshape(-1, rows.shape[2])
            coloured = noise.colour_transposed(rows / noise.std[:, None] ** 2).reshape(-1, rows.shape[2])
            gram += white.T @ white
            middle += weights.dispersion * coloured.T @ coloured
        length = or_one(np.sqrt(np.diag(gram)[:p]))
        inverse = pseudo_inverse(gram[:p, :p] / np.outer(length, length), 1e-12) / np.outer(length, length)
        carried = inverse @ gram[:p, p:-1]
        away = np.vstack([-carried, np.eye(carried.shape[1])])
        inner = away.T @ gram[:-1, :-1] @ away
        faint = np.diag(inner) < _SEEN**2 * np.diag(gram)[p:-1]
        inner[faint] = inner[:, faint] = 0.0
        target = away.T @ gram[:-1, -1]
        return cls(carried, inner, away.T @ middle[:-1, :-1] @ away, np.where(faint, 0.0, target))

    def amplitudes(self, columns: np.ndarray, sizes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Amplitudes in the reference, mean (k,) and a root of their covariance (k, k).

        Parameters
        ----------
        columns
            Of the proposals (k,).
        sizes
            Prior standard deviations, where the reference says nothing (k,).
        """
        own, scale = np.ix_(columns, columns), np.outer(sizes, sizes)
        # In sizes, and along axes of which the reference says more than nothing; the others stay as they are beforehand.
        information, axes = np.linalg.eigh(self.gram[own] * scale)
        keep = information > max(_FAINT, _SINGULAR * information.max(initial=0.0))
        inverse = axes[:, keep] / information[keep]
        covariance = inverse.T @ (self.middle[own] * scale) @ inverse
        estimate = inverse.T @ (self.target[columns] * sizes)
        # A prior of unit variance: V (V + 1)^-1 is the posterior covariance, (V + 1)^-1 what stays of the estimate.
        posterior = np.linalg.solve(covariance + np.eye(len(covariance)), covariance)
        values, vectors = np.linalg.eigh(0.5 * (posterior + posterior.T))
        seen = axes[:, keep] @ vectors * np.sqrt(np.clip(values, 0.0, 1.0))
        mean = axes[:, keep] @ (estimate - posterior.T @ estimate)
        return sizes * mean, sizes[:, None] * np.hstack([axes[:, ~keep], seen])
