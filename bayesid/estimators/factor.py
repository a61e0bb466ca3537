"""Triangular factors of weighted rows, and the noise that the weights come from.

The rows are reduced once to the factor R of a QR decomposition of [X y]; estimators work on R alone. Weights
are learned on a pilot: all rows of an ordinary recording, evenly spread stretches of a long one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.linalg import LinAlgError
from scipy.linalg import cholesky, solve_triangular

from bayesid.estimators.dispersion import STRETCHES, beyond_chance, dispersion
from bayesid.regression.blocks import Block
from bayesid.regression.hypothesis_tests import hausman
from bayesid.regression.linalg import pseudo_inverse, solve, standard_deviations
from bayesid.regression.parallel import in_order
from bayesid.regression.regression import Regression
from bayesid.signals.noise import NoiseModel, estimate_noise

_PASSES = 3
_PANEL = 1024
#: Two fits contradict each other when their difference is less probable than the first, and the efficient one's
#: residuals have more than the second times the power of the plain one's; either alone happens by chance.
SMALLEST_AGREEMENT = 1e-4
LARGEST_LOSS = 2.0
#: An efficient fit whose stretches scatter more than noise explains, with a smaller probability than this, is not efficient.
SMALLEST_STRETCHES = 1e-4
#: Share of a column's length that the columns before it must leave, for rows to be brought to orthonormal coordinates.
_WELL_DETERMINED = 1e-6


@dataclass(frozen=True)
class Factor:
    """Triangular factor of weighted rows [X y].

    Attributes
    ----------
    r
        (p + 1, p + 1), upper triangular; the last column is the target's.
    rows
        How many scalar rows went in.
    """

    r: np.ndarray
    rows: int

    @property
    def matrix(self) -> np.ndarray:
        """Factor of X (p, p)."""
        return self.r[:-1, :-1]

    @property
    def target(self) -> np.ndarray:
        """Rotated target (p,)."""
        return self.r[:-1, -1]

    @property
    def least_squares(self) -> float:
        """Sum of squares that no parameters can remove."""
        return float(self.r[-1, -1] ** 2)


def stack(r: np.ndarray | None, rows: np.ndarray) -> np.ndarray:
    """Update a triangular factor with further rows (k, p + 1)."""
    if r is not None:
        rows = np.concatenate([r, rows])
    updated = np.asarray(np.linalg.qr(rows, mode="r"))
    missing = rows.shape[1] - len(updated)
    return np.vstack([updated, np.zeros((missing, rows.shape[1]))]) if missing > 0 else updated


def reduce_rows(blocks: Iterable[Block], transform: Callable[[Block], np.ndarray]) -> Factor:
    """Factor of the transformed rows of all blocks; ``transform`` gives (k, channels, p + 1).

    Blocks are independent, so all cores work; LAPACK lets go of Python's lock.
    """

    def reduced(block: Block) -> tuple[np.ndarray, int]:
        new = transform(block)
        flat = new.reshape(-1, new.shape[-1])
        return _stack_all(None, flat), len(flat)

    parts = list(in_order(reduced, blocks))
    r = parts[0][0]
    for other, _ in parts[1:]:
        r = stack(r, other)
    return Factor(r, sum(rows for _, rows in parts))


def gram_rows(blocks: Iterable[Block], transform: Callable[[Block], np.ndarray]) -> np.ndarray:
    """Sum of ``X'X`` of the transformed rows (k, channels, p); where squares are wanted, cheaper than a factor."""

    def gram(block: Block) -> np.ndarray:
        new = transform(block)
        flat = new.reshape(-1, new.shape[-1])
        return flat.T @ flat

    return sum(in_order(gram, blocks), np.zeros(()))


def _stack_all(r: np.ndarray | None, flat: np.ndarray) -> np.ndarray:
    """Update a factor with many rows, a thousand at a time, which stay in the processor's second cache."""
    for a in range(0, len(flat), _PANEL):
        r = stack(r, flat[a : a + _PANEL])
    assert r is not None
    return r


def whitened(blocks: Iterable[Block], noise: dict[str, NoiseModel]) -> Iterator[tuple[Block, np.ndarray]]:
    """Every block with its rows whitened; a recursion runs on over blocks that follow each other."""
    last: Block | None = None
    before = np.zeros((0, 0, 0))
    for block in blocks:
        order = noise[block.group].order
        joined = last is not None and _follows(last, block)
        white = noise[block.group].whiten(block.rows, before if joined else None)
        if not joined and not block.start:
            white = white[order:]  # a block out of the middle: its past is unknown
        short = joined and len(block.rows) < order
        before = (np.concatenate([before, block.rows]) if short else block.rows)[-max(order, 1) :]
        last = block
        yield block, white


def _follows(last: Block, block: Block) -> bool:
    """Whether a block goes on where the last one ended."""
    if block.start or last.motion != block.motion or last.group != block.group or len(last.times) < 2:
        return False
    return bool(block.times[0] - last.times[-1] < 1.5 * (last.times[-1] - last.times[-2]))


@dataclass(frozen=True)
class Weights:
    """What the noise looks like and where that was learned.

    Attributes
    ----------
    noise
        Noise model of each group of rows.
    agreement
        Probability that generalised and channel-weighted least squares differ as much as they do when the
        model is complete (a Hausman test [Hausman1978]_): when it is tiny, something is missing in the model.
    complete
        Whether residuals may be taken for noise alone: ``agreement`` allows it, and the efficient fit scatters between
        stretches of the recording no more than noise explains. Where ``agreement`` does not, the noise is that of the
        channel-weighted residuals, model error included; else that of an efficient fit.
    solution
        Of the channel-weighted fit to the pilot (p,).
    scatter, scatter_degrees
        Dispersion of the channel-weighted fit between stretches of the recording over what ``noise`` allows, and its
        degrees of freedom (`bayesid.estimators.dispersion`).
    """

    noise: dict[str, NoiseModel]
    agreement: float
    complete: bool
    solution: np.ndarray
    scatter: float = 1.0
    scatter_degrees: int = 0

    @property
    def dispersion(self) -> float:
        """Factor of the covariance of a fit weighted by channel: `scatter` where chance does not explain it, else 1."""
        return self.scatter if self.scatter > 1.0 and beyond_chance(self.scatter, self.scatter_degrees) else 1.0


def learn_weights(regression: Regression) -> Weights:
    """Estimate the noise from residuals of a pilot.

    Channel-weighted least squares comes first. Rounds of generalised least squares then follow, so that the
    colour of the noise is not hidden by parameters that followed it. But an efficient fit trusts whatever is
    quiet, so on a model with something missing it goes astray: where the two fits differ by more than the noise
    explains, the residuals of the first one count. A regression's weights are learned once for all estimators.
    """
    return regression.once("weights", lambda: _learned(regression))


def _learned(regression: Regression) -> Weights:
    pilot = pilot_of(regression)
    blocks = pilot.blocks
    known = stated_noise(regression)
    if known is not None:  # and what exceeds it is for `bayesid.estimators.fit` to tell
        return Weights(known, 1.0, True)
    scale = np.ones(blocks[0].rows.shape[1])
    plain = np.zeros(0)
    for _ in range(2):
        factor = pilot.weighted(scale)
        plain = solve(factor.matrix, factor.target)
        residual = [b.target - b.matrix @ plain for b in blocks]
        power = np.sum([np.sum(r**2, axis=0) for r in residual], axis=0) / sum(len(r) for r in residual)
        scale = np.sqrt(np.maximum(power, 1e-20 * max(power.max(), 1e-200)))
    first = noise = noise_of_residuals(regression, blocks, plain)
    efficient = plain
    for _ in range(_PASSES):
        factor = pilot.whitened(noise)
        efficient = solve(factor.matrix, factor.target)
        noise = noise_of_residuals(regression, blocks, efficient, factor)
    agreement = _agreement(pilot, noise, plain, efficient, scale)
    power = [sum(np.sum(((b.target - b.matrix @ x) / scale) ** 2) for b in blocks) for x in (plain, efficient)]
    complete = bool(agreement > SMALLEST_AGREEMENT or power[1] <= LARGEST_LOSS * power[0])
    found, degrees = dispersion(pilot.stretches([white for _, white in whitened(pilot.orthonormal, noise)]), efficient)
    if not complete:
        noise = first
        for _ in range(_PASSES):
            noise = noise_of_residuals(regression, blocks, plain, pilot.whitened(noise))
    complete = complete and not beyond_chance(found, degrees, SMALLEST_STRETCHES)
    grams = pilot.stretches([b.rows / scale[:, None] for b in pilot.orthonormal])
    return Weights(noise, agreement, complete, plain, *dispersion(grams, plain, _middle(pilot, noise, scale)))


def pilot_of(regression: Regression) -> Pilot:
    """The pilot rows of a regression in coordinates of their own, found once."""
    return regression.once("pilot", lambda: Pilot.of(regression.pilot()))


@dataclass(frozen=True)
class Pilot:
    """Rows that are reduced again and again with other weights, in coordinates in which they are orthonormal.

    ``[X y] = Z R`` with the factor R of one QR decomposition. Weights act on Z from the left, so the factor of weighted rows is
    that of weighted Z times R; and Z is so well conditioned that its factor may come from ``Z' W'W Z``, at a fraction of the
    time of an orthogonal decomposition and nothing lost by squaring [Yamamoto2015]_.

    Attributes
    ----------
    blocks
        The rows as they are.
    root
        R (p + 1, p + 1); None where they do not determine all columns well: factors then come from the rows themselves.
    orthonormal
        Blocks of Z, or again the rows.
    """

    blocks: Sequence[Block]
    root: np.ndarray | None
    orthonormal: Sequence[Block]

    @classmethod
    def of(cls, blocks: Sequence[Block]) -> Pilot:
        """Find the coordinates of these rows."""
        root = reduce_rows(blocks, lambda b: b.rows).r
        # The diagonal is what each column adds to those before it.
        if np.any(np.abs(np.diag(root)) <= _WELL_DETERMINED * np.linalg.norm(root, axis=0)):
            return cls(blocks, None, blocks)
        inverse = solve_triangular(root, np.eye(len(root)))
        return cls(blocks, root, [replace(b, rows=_flat(b.rows, inverse)) for b in blocks])

    def weighted(self, scale: np.ndarray) -> Factor:
        """Factor of rows over the scale of every channel (c,)."""
        return self._reduced([b.rows / scale[:, None] for b in self.orthonormal])

    def whitened(self, noise: dict[str, NoiseModel]) -> Factor:
        """Factor of whitened rows."""
        return self._reduced([white for _, white in whitened(self.orthonormal, noise)])

    def stretches(self, parts: Sequence[np.ndarray]) -> list[np.ndarray]:
        """``[X y]'[X y]`` of stretches, equally long, of weighted rows of ``orthonormal`` (k, channels, p + 1)."""
        rows = np.concatenate(parts)
        root = np.eye(rows.shape[2]) if self.root is None else self.root
        flat = [part.reshape(-1, rows.shape[2]) for part in np.array_split(rows, STRETCHES)]
        return [root.T @ (f.T @ f) @ root for f in flat if len(f)] if len(rows) > 2 * STRETCHES else []

    def gram(self, transform: Callable[[Block, np.ndarray], np.ndarray]) -> np.ndarray:
        """Sum of ``X'X`` over all blocks after a transform of their regressors (k, channels, p)."""
        inner = gram_rows(self.orthonormal, lambda b: transform(b, b.matrix))
        return inner if self.root is None else self.root[:-1, :-1].T @ inner @ self.root[:-1, :-1]

    def _reduced(self, parts: list[np.ndarray]) -> Factor:
        flat = [rows.reshape(-1, rows.shape[-1]) for rows in parts]
        count = sum(map(len, flat))
        if self.root is not None:
            try:
                return Factor(cholesky(sum(f.T @ f for f in flat)) @ self.root, count)
            except LinAlgError:  # weights so uneven that some rows count for nothing
                flat = [f @ self.root for f in flat]
        r = None
        for rows in flat:
            r = _stack_all(r, rows)
        assert r is not None
        return Factor(r, count)


def _flat(rows: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """``rows @ matrix`` (k, channels, p) as one product."""
    return (rows.reshape(-1, rows.shape[-1]) @ matrix).reshape(*rows.shape[:-1], matrix.shape[1])


def stated_noise(regression: Regression) -> dict[str, NoiseModel] | None:
    """Noise of each group of rows where it is known beforehand, else None."""
    if regression.noise_std is None:
        return None
    groups = dict.fromkeys(block.group for block in regression.pilot())
    poles = regression.known_poles
    return {g: NoiseModel.stated(regression.noise_std, poles if g == "trajectory" else None) for g in groups}


def noise_of_residuals(
    regression: Regression, blocks: Sequence[Block], values: np.ndarray, efficient: Factor | None = None
) -> dict[str, NoiseModel]:
    """Noise of each group of rows from the residuals of a fit; of an efficient one if its factor is given."""
    known = stated_noise(regression)
    if known is not None:
        return known
    noise = {}
    total = sum(len(b.rows) for b in blocks)
    root = None if efficient is None else pseudo_inverse(efficient.matrix)
    for group in dict.fromkeys(b.group for b in blocks):
        own = [b for b in blocks if b.group == group]
        noise[group] = estimate_noise(
            [b.target - b.matrix @ values for b in own],
            parameters=round(sum(len(b.rows) for b in own) / total * len(values)),
            known_poles=regression.known_poles if group == "trajectory" else None,
            highest_order=0 if group == "poses" else 24,
            spread=None if root is None else [_flat(b.matrix, root) for b in own],
        )
    return noise


def _agreement(pilot: Pilot, noise: dict[str, NoiseModel], plain: np.ndarray, efficient: np.ndarray, scale: np.ndarray) -> float:
    """Probability of a difference between the two fits as large as this one.

    Under a complete model ``d = b_wls - b_gls`` has covariance ``V_wls - V_gls``.
    """
    whole = pilot.whitened(noise).matrix
    bread = pilot.weighted(scale).matrix
    middle = _middle(pilot, noise, scale)
    outer = np.linalg.pinv(bread.T @ bread, rcond=1e-12, hermitian=True)
    covariance = outer @ middle @ outer
    size = standard_deviations(covariance, 1e-300)
    gap = covariance - np.linalg.pinv(whole.T @ whole, rcond=1e-12, hermitian=True)
    # Where the two fits are almost equally sure, the tiny difference is one of estimated weights, not of fits.
    return hausman(plain - efficient, gap, size, 0.05).probability


def _middle(pilot: Pilot, noise: dict[str, NoiseModel], scale: np.ndarray) -> np.ndarray:
    """``X' W Sigma W X`` of rows weighted by channel (p, p)."""
    return pilot.gram(lambda b, x: noise[b.group].colour_transposed(x / scale[:, None] ** 2))


def reduce_whitened(blocks: Iterable[Block], noise: dict[str, NoiseModel]) -> Factor:
    """Factor of whitened rows."""
    r, rows = None, 0
    for _, white in whitened(blocks, noise):
        flat = white.reshape(-1, white.shape[-1])
        rows += len(flat)
        r = _stack_all(r, flat)
    assert r is not None
    return Factor(r, rows)
