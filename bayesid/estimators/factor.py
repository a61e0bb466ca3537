"""Triangular factors of weighted rows, and the noise that the weights come from.

The rows are reduced once to the factor R of a QR decomposition of [X y]; estimators work on R alone. Weights
are learned on a pilot: all rows of an ordinary recording, evenly spread stretches of a long one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from bayesid.regression.blocks import Block
from bayesid.regression.parallel import in_order
from bayesid.regression.regression import Regression
from bayesid.signals.noise import NoiseModel, estimate_noise

_PASSES = 3
_PANEL = 4096
#: Two fits contradict each other when their difference is less probable than the first, and the efficient one's
#: residuals have more than the second times the power of the plain one's; either alone happens by chance.
SMALLEST_AGREEMENT = 1e-4
LARGEST_LOSS = 2.0


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
    """Update a factor with many rows, a few thousand at a time, which stay in the processor's cache."""
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
        before = np.concatenate([before, block.rows])[-max(order, 1) :] if joined else block.rows[-max(order, 1) :]
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
        Whether ``agreement`` allows to take residuals for noise alone; the colour is then that of an
        efficient fit. Otherwise it is that of the channel-weighted residuals, model error included.
    """

    noise: dict[str, NoiseModel]
    agreement: float
    complete: bool


def learn_weights(regression: Regression) -> Weights:
    """Estimate the noise from residuals of a pilot.

    Channel-weighted least squares comes first. Rounds of generalised least squares then follow, so that the
    colour of the noise is not hidden by parameters that followed it. But an efficient fit trusts whatever is
    quiet, so on a model with something missing it goes astray: where the two fits differ by more than the noise
    explains, the residuals of the first one count. A regression's weights are learned once for all estimators.
    """
    return regression.once("weights", lambda: _learned(regression))


def _learned(regression: Regression) -> Weights:
    blocks = regression.pilot()
    channels = blocks[0].rows.shape[1]
    scale = np.ones(channels)
    plain = np.zeros(0)
    for _ in range(2):
        factor = reduce_rows(blocks, lambda b, s=scale: b.rows / s[:, None])
        plain = solve(factor.matrix, factor.target)
        residual = [b.target - b.matrix @ plain for b in blocks]
        power = sum(np.sum(r**2, axis=0) for r in residual) / sum(len(r) for r in residual)
        scale = np.sqrt(np.maximum(power, 1e-20 * max(power.max(), 1e-200)))
    first = noise = noise_of_residuals(regression, blocks, plain)
    efficient = plain
    for _ in range(_PASSES):
        factor = reduce_whitened(blocks, noise)
        efficient = solve(factor.matrix, factor.target)
        noise = noise_of_residuals(regression, blocks, efficient, factor)
    agreement = _hausman(blocks, noise, plain, efficient, scale)
    power = [sum(np.sum(((b.target - b.matrix @ x) / scale) ** 2) for b in blocks) for x in (plain, efficient)]
    complete = bool(agreement > SMALLEST_AGREEMENT or power[1] <= LARGEST_LOSS * power[0])
    if not complete:
        noise = first
        for _ in range(_PASSES):
            noise = noise_of_residuals(regression, blocks, plain, reduce_whitened(blocks, noise))
    return Weights(noise, agreement, complete)


def noise_of_residuals(
    regression: Regression, blocks: Sequence[Block], values: np.ndarray, efficient: Factor | None = None
) -> dict[str, NoiseModel]:
    """Noise of each group of rows from the residuals of a fit; of an efficient one if its factor is given."""
    noise = {}
    total = sum(len(b.rows) for b in blocks)
    for group in dict.fromkeys(b.group for b in blocks):
        own = [b for b in blocks if b.group == group]
        noise[group] = estimate_noise(
            [b.target - b.matrix @ values for b in own],
            parameters=round(sum(len(b.rows) for b in own) / total * len(values)),
            known_poles=regression.known_poles if group == "trajectory" else None,
            highest_order=0 if group == "poses" else 24,
            spread=None if efficient is None else [b.matrix @ root_covariance(efficient.matrix) for b in own],
        )
    return noise


def root_covariance(matrix: np.ndarray) -> np.ndarray:
    """L with ``L L' = (R'R)^+`` for a factor R (p, p); directions that the rows say nothing about have none."""
    length = np.linalg.norm(matrix, axis=0)
    length = np.where(length > 1e-14 * length.max(initial=0.0), length, 1.0)
    return np.linalg.pinv(matrix / length, rcond=1e-11) / length[:, None]


def _hausman(blocks, noise, plain, efficient, scale) -> float:
    """Probability of a difference between the two fits as large as this one.

    Under a complete model ``d = b_wls - b_gls`` has covariance ``V_wls - V_gls``.
    """
    whole = reduce_whitened(blocks, noise).matrix
    bread = reduce_rows(blocks, lambda b: b.rows / scale[:, None]).matrix
    middle = gram_rows(blocks, lambda b: noise[b.group].colour_transposed(b.matrix / scale[:, None] ** 2))
    outer = np.linalg.pinv(bread.T @ bread, rcond=1e-12, hermitian=True)
    covariance = outer @ middle @ outer
    size = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    gap = covariance - np.linalg.pinv(whole.T @ whole, rcond=1e-12, hermitian=True)
    values, vectors = np.linalg.eigh(gap / np.outer(size, size))
    # Where the two fits are almost equally sure, the tiny difference is one of estimated weights, not of fits.
    keep = values > 0.05
    if not keep.any():
        return 1.0
    z = vectors.T[keep] @ ((plain - efficient) / size) / np.sqrt(values[keep])
    return float(chi2.sf(z @ z, keep.sum()))


def reduce_whitened(blocks: Iterable[Block], noise: dict[str, NoiseModel]) -> Factor:
    """Factor of whitened rows."""
    r, rows = None, 0
    for _, white in whitened(blocks, noise):
        flat = white.reshape(-1, white.shape[-1])
        rows += len(flat)
        r = _stack_all(r, flat)
    assert r is not None
    return Factor(r, rows)


def solve(matrix: np.ndarray, target: np.ndarray, tolerance: float = 1e-11) -> np.ndarray:
    """Least-squares solution; directions that the rows say nothing about stay zero.

    Columns are scaled to unit length first, except those that are zero.
    """
    length = np.linalg.norm(matrix, axis=0)
    length = np.where(length > 1e-14 * length.max(initial=0.0), length, 1.0)
    return np.linalg.lstsq(matrix / length, target, rcond=tolerance)[0] / length
