"""Inner products of all columns by block of time: fits of any effects to any blocks, and their evidence, without the rows.

About a fit the readings are linear, and with the columns of what is always in the model side by side with those of the effects'
parameters, ``X = [A J]``, every fit is

    step = (X'X / r + P'P)^-1 (X'e / r + P'e_P)

with the residual e, rows P and residual e_P of the prior, and r rows that count as one. An effect that is left out adds its
trace to the residual: what the prediction loses without it, exactly. ``X'X`` is a sum over blocks of time, so a block is left
out by a difference. Courses in time are inverse cosine transforms of whitened amplitudes, which keep all inner products.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import solve_triangular

#: Curvature of directions that nothing determines, in units of a column's own.
_FLAT = 1e-9
#: Share of a column that must be left beside the others to count as a direction of its own.
_SEEN = 1e-7


def schwarz(parameters, rows: float):
    """Log evidence that so many parameters cost: half the logarithm of the number of rows for each [Schwarz1978]_."""
    return 0.5 * parameters * float(np.log(max(rows, 2.0)))


@dataclass(frozen=True, eq=False)
class Grams:
    """Inner products of columns: what is always in the model, effects' parameters, effects' traces, residual."""

    blocks: np.ndarray  # of the data, by block of time (b, p, p)
    prior: np.ndarray  # of the prior's rows (p, p)
    always: int  # number of columns of what is always in
    owners: np.ndarray  # effect of each column of parameters (k,)
    traces: int  # how many effects, the first ones, have a trace; effects that may come in have none
    rows: float  # number of rows of data
    correlation: float = 1.0  # how many rows count as one

    @cached_property
    def whole(self) -> np.ndarray:
        """Over all blocks (p, p)."""
        return np.asarray(self.blocks.sum(axis=0))

    @cached_property
    def _complete(self) -> np.ndarray:
        """Over all blocks, with the prior (p, p)."""
        return self.whole / self.correlation + self.prior

    def _part(self, gram: np.ndarray, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """Some rows (i,) and columns (j,) with the prior (..., i, j), of a sum of blocks, or of several (..., p, p)."""
        at = rows[:, None], columns
        return gram[..., *at] / self.correlation + self.prior[at]

    def _active(self, effects: Sequence[int]) -> np.ndarray:
        """Columns that a fit of these effects has."""
        chosen = np.zeros(self.traces + int(self.owners.max(initial=0)) + 1, bool)
        chosen[list(effects)] = True
        return np.concatenate([np.arange(self.always), self.always + np.flatnonzero(chosen[self.owners])])

    def fitted(self, gram: np.ndarray, effects: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
        """Combination of columns that a fit of these effects leaves (p,), and its amplitudes of all effects' columns (k,).

        Of several sums of blocks (g, p, p) at once: (g, p) and (g, k).
        """
        active = self._active(effects)
        traces = [k for k in range(self.traces) if k not in effects]
        wanted = np.array([*(self.always + len(self.owners) + k for k in traces), gram.shape[-1] - 1])
        left = np.zeros(gram.shape[:-1])
        left[..., wanted] = 1.0
        square, right = self._part(gram, active, active), self._part(gram, active, wanted).sum(axis=-1)
        scale = np.maximum(
            np.sqrt(np.maximum(np.diagonal(square, axis1=-2, axis2=-1), np.diag(self.whole)[active] / self.correlation)), 1e-150
        )
        scaled = square / (scale[..., :, None] * scale[..., None, :]) + _FLAT * np.eye(len(active))
        step = np.linalg.solve(scaled, (right / scale)[..., None])[..., 0] / scale
        left[..., active] -= step
        amplitudes = np.zeros((*gram.shape[:-2], len(self.owners)))
        amplitudes[..., active[self.always :] - self.always] = step[..., self.always :]
        return left, amplitudes

    def cost(self, effects: Sequence[int], gram: np.ndarray | None = None) -> np.ndarray:
        """Twice the negative log density of data and prior at the fit of these effects; of sums of blocks (g, p, p), or all."""
        gram = self.whole if gram is None else gram
        left, _ = self.fitted(gram, effects)
        at = np.flatnonzero(left.reshape(-1, left.shape[-1]).any(axis=0))  # most columns are of effects that are not in the model
        return np.einsum("...i,...ij,...j->...", left[..., at], self._part(gram, at, at), left[..., at])

    def variances(self, gram: np.ndarray) -> np.ndarray:
        """Variances of all effects' parameters (k,), in units of the noise; of several sums of blocks at once (g, k)."""
        count = self.always + len(self.owners)
        square = self._part(gram, np.arange(count), np.arange(count))
        scale = np.sqrt(np.maximum(np.diag(self._complete)[:count], 1e-300))
        square = square / np.outer(scale, scale) + _FLAT * np.eye(count)
        with np.errstate(over="ignore"):  # infinite for a parameter that nothing shows, as a tether's length while it is slack
            return np.diagonal(np.linalg.inv(square), axis1=-2, axis2=-1)[..., self.always :] / scale[self.always :] ** 2

    @cached_property
    def prices(self) -> np.ndarray:
        """Log evidence that each effect's parameters cost."""
        return schwarz(self._parameters, self.rows / self.correlation)

    @cached_property
    def _parameters(self) -> np.ndarray:
        """Number of columns of each effect, up to the last that has any."""
        return np.bincount(self.owners, minlength=self.traces)

    def evidence(self, effects: Sequence[int], others: Sequence[int]) -> np.ndarray:
        """Log evidence that each of other effects would add to a fit of these (len(others),)."""
        left, _ = self.fitted(self.whole, effects)
        gram, active = self._complete, self._active(effects)
        square = gram[np.ix_(active, active)]
        scale = np.maximum(np.sqrt(np.diag(square)), 1e-150)
        half = np.linalg.cholesky(square / np.outer(scale, scale) + _FLAT * np.eye(len(active)))
        columns = slice(self.always, self.always + len(self.owners))
        length = np.maximum(np.sqrt(np.diag(gram)[columns]), 1e-150)
        inside = solve_triangular(half, gram[active, columns] / np.outer(scale, length), lower=True, check_finite=False)
        target = gram[columns] @ left / length
        # Along the directions that the rest leaves free, of all effects with as many columns at once.
        asked, out = np.array(others, int), np.zeros(len(others))
        counts, first = self._parameters[asked], np.searchsorted(self.owners, asked)
        for count in np.unique(counts[counts > 0]):
            alike = np.flatnonzero(counts == count)
            own = first[alike, None] + np.arange(count)
            at = self.always + own
            square = gram[at[:, :, None], at[:, None, :]] / (length[own][:, :, None] * length[own][:, None, :])
            part = inside.T[own]
            values, vectors = np.linalg.eigh(square - part @ part.transpose(0, 2, 1))
            along = np.einsum("eij,ei->ej", vectors, target[own])
            seen = values > _SEEN
            out[alike] = 0.5 * np.sum(np.where(seen, along**2 / np.where(seen, values, 1.0), 0.0), axis=1)
        return out - self.prices[asked]


def squared(part: np.ndarray) -> np.ndarray:
    """Inner products of courses of columns (moments, channels, p), (p, p)."""
    flat = part.reshape(-1, part.shape[2])
    return flat.T @ flat
