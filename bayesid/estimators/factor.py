"""Triangular factors of weighted rows: the rows are reduced once to R of a QR decomposition of [X y]; estimators work on R."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, reduce

import numpy as np
from numpy.linalg import LinAlgError
from scipy.linalg import cholesky, solve_triangular

from bayesid.estimators.dispersion import PARTS
from bayesid.regression.blocks import PANEL, Block
from bayesid.regression.linalg import UNSEEN, or_one, pseudo_inverse, undetermined
from bayesid.regression.parallel import in_order
from bayesid.regression.row_cache import RowCache
from bayesid.signals.noise import NoiseModel

#: Share of a column's length that the columns before it must leave, for rows to be brought to orthonormal coordinates.
_WELL_DETERMINED = 1e-6


@dataclass(frozen=True)
class Factor:
    """Triangular factor of weighted rows [X y]."""

    r: np.ndarray  # (p + 1, p + 1), upper triangular; the last column is the target's
    rows: int  # how many scalar rows went in

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

    @cached_property
    def inverse(self) -> np.ndarray:
        """Pseudo-inverse of the factor of X (p, p): times its transpose, the covariance where rows have unit covariance."""
        return pseudo_inverse(self.matrix, UNSEEN)

    @cached_property
    def undetermined(self) -> np.ndarray:
        """Columns with a part that the rows do not determine (p,)."""
        return undetermined(self.matrix)


def stack(r: np.ndarray | None, rows: np.ndarray) -> np.ndarray:
    """Update a triangular factor with further rows (k, p + 1)."""
    if r is not None:
        rows = np.concatenate([r, rows])
    updated = np.asarray(np.linalg.qr(rows, mode="r"))
    missing = rows.shape[1] - len(updated)
    return np.vstack([updated, np.zeros((missing, rows.shape[1]))]) if missing > 0 else updated


def factor_rows(parts: Iterable[np.ndarray]) -> Factor:
    """Factor of rows (k, channels, p + 1), a thousand at a time, which stay in the processor's second cache."""
    r, count = None, 0
    for rows in parts:
        flat = rows.reshape(-1, rows.shape[-1])
        count += len(flat)
        for a in range(0, len(flat), PANEL):
            r = stack(r, flat[a : a + PANEL])
    assert r is not None
    return Factor(r, count)


def reduce_rows(blocks: Iterable[Block], transform: Callable[[Block], np.ndarray]) -> Factor:
    """Factor of the transformed rows of all blocks; ``transform`` gives (k, channels, p + 1).

    Blocks are independent, so all cores work; LAPACK lets go of Python's lock.
    """
    return reduce(stacked, in_order(factor_of(transform), blocks))


def factor_of(transform: Callable[[Block], np.ndarray]) -> Callable[[Block], Factor]:
    """Factor of one block's transformed rows, for `reduce_rows`."""
    return lambda block: factor_rows([transform(block)])


def stacked(first: Factor, second: Factor) -> Factor:
    """Factor of the rows of both."""
    return Factor(stack(first.r, second.r), first.rows + second.rows)


def gram_rows(blocks: Iterable[Block], transform: Callable[[Block], np.ndarray], *, row_by_row: bool = False) -> np.ndarray:
    """Sum of ``X'X`` of the transformed rows (k, channels, p); where squares are wanted, cheaper than a factor.

    Where ``transform`` treats each row alone (``row_by_row``), a few are transformed at a time.
    """
    return sum(in_order(gram_of(transform, row_by_row=row_by_row), blocks), np.zeros(()))


def gram_of(transform: Callable[[Block], np.ndarray], *, row_by_row: bool = False) -> Callable[[Block], np.ndarray]:
    """``X'X`` of one block's transformed rows, for `gram_rows`."""

    def gram(block: Block) -> np.ndarray:
        total = np.zeros(())
        for part in block.panels() if row_by_row else [block]:
            new = transform(part)
            flat = new.reshape(-1, new.shape[-1])
            total = total + flat.T @ flat
        return total

    return gram


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
class Pilot:
    """Rows that are reduced again and again with other weights, in coordinates in which they are orthonormal.

    ``[X y] = Z R`` with the Cholesky factor R of ``[X y]'[X y]``. Weights act on Z from the left, so the factor of weighted rows
    is that of weighted Z times R; and Z is so well conditioned that its factor may come from ``Z' W'W Z``, at a fraction of the
    time of an orthogonal decomposition and nothing lost by squaring: this second factor makes up for what the first square lost
    [Yamamoto2015]_.
    """

    blocks: Sequence[Block]  # the rows as they are
    #: R (p + 1, p + 1); None where they do not determine all columns well: factors then come from the rows themselves.
    root: np.ndarray | None
    orthonormal: Sequence[Block]  # blocks of Z, or again the rows

    @classmethod
    def of(cls, blocks: Sequence[Block]) -> Pilot:
        """Find the coordinates of these rows."""
        gram = gram_rows(blocks, lambda b: b.rows, row_by_row=True)
        length = or_one(np.sqrt(np.diag(gram)))
        try:
            root = cholesky(gram / np.outer(length, length)) * length
        except LinAlgError:
            return cls(blocks, None, blocks)
        # The diagonal is what each column adds to those before it.
        if np.any(np.diag(root) <= _WELL_DETERMINED * np.linalg.norm(root, axis=0)):
            return cls(blocks, None, blocks)
        inverse = solve_triangular(root, np.eye(len(root)))
        return cls(blocks, root, [replace(b, rows=on_columns(b.rows, inverse)) for b in blocks])

    def weighted(self, scale: np.ndarray) -> Factor:
        """Factor of rows over the scale of every channel (c,)."""
        if self.root is not None:
            try:
                r = cholesky(np.tensordot(scale**-2.0, self._channel_grams, 1)) @ self.root
                return Factor(r, sum(len(b.rows) for b in self.blocks) * len(scale))
            except LinAlgError:  # scales so uneven that some rows count for nothing
                pass
        return self.factor_of([b.rows / scale[:, None] for b in self.orthonormal])

    @cached_property
    def _channel_grams(self) -> np.ndarray:
        """``Z'Z`` of each channel's rows (c, p + 1, p + 1)."""
        channels = range(self.orthonormal[0].rows.shape[1])
        return np.array([sum(b.rows[:, c].T @ b.rows[:, c] for b in self.orthonormal) for c in channels])

    def whitened(self, noise: dict[str, NoiseModel]) -> Factor:
        """Factor of whitened rows."""
        return self.factor_of([white for _, white in whitened(self.orthonormal, noise)])

    def segments(self, parts: Sequence[np.ndarray]) -> list[np.ndarray]:
        """``[X y]'[X y]`` of equally long segments of weighted rows of ``orthonormal`` (k, channels, p + 1)."""
        count, p = sum(map(len, parts)), parts[0].shape[2]
        if count <= 2 * PARTS:
            return []
        root = np.eye(p) if self.root is None else self.root
        grams, edges, first = np.zeros((PARTS, p, p)), np.linspace(0, count, PARTS + 1).astype(int), 0
        for part in parts:
            for gram, a, b in zip(grams, edges[:-1] - first, edges[1:] - first, strict=True):
                flat = part[max(a, 0) : max(b, 0)].reshape(-1, p)
                gram += flat.T @ flat
            first += len(part)
        return list(root.T @ grams @ root)

    def gram(self, transform: Callable[[Block, np.ndarray], np.ndarray], *, row_by_row: bool = False) -> np.ndarray:
        """Sum of ``X'X`` over all blocks after a transform of their regressors (k, channels, p); as `gram_rows`."""
        inner = gram_rows(self.orthonormal, lambda b: transform(b, b.matrix), row_by_row=row_by_row)
        return inner if self.root is None else self.root[:-1, :-1].T @ inner @ self.root[:-1, :-1]

    def factor_of(self, parts: Sequence[np.ndarray]) -> Factor:
        """Factor of weighted rows of ``orthonormal`` (k, channels, p + 1)."""
        if self.root is None:
            return factor_rows(parts)
        flat = [rows.reshape(-1, rows.shape[-1]) for rows in parts]
        try:
            return Factor(cholesky(sum(f.T @ f for f in flat)) @ self.root, sum(map(len, flat)))
        except LinAlgError:  # weights so uneven that some rows count for nothing
            return factor_rows(f @ self.root for f in flat)


def pilot_of(rows: RowCache) -> Pilot:
    """The pilot of some rows in coordinates of their own, found once."""
    return rows.derived("pilot", lambda: Pilot.of(rows.pilot()))


def regressor_times(block: Block, matrix: np.ndarray) -> np.ndarray:
    """``block.matrix @ matrix`` (k, channels, any) of a matrix (p, any)."""
    return on_columns(block.rows, np.vstack([matrix, np.zeros((1, matrix.shape[1]))]))  # the target times zero: nothing is copied


def on_columns(rows: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """``rows @ matrix`` (k, channels, p) as one product."""
    return (rows.reshape(-1, rows.shape[-1]) @ matrix).reshape(*rows.shape[:-1], matrix.shape[1])


def reduce_whitened(blocks: Iterable[Block], noise: dict[str, NoiseModel]) -> Factor:
    """Factor of whitened rows."""
    return factor_rows(white for _, white in whitened(blocks, noise))


#: Smallest share of the longest column that each adds to those before it, for squares of all rows to lose at most six digits.
_NEARLY_ORTHONORMAL = 1e-3


def reduce_scaled(rows: RowCache, scale: Mapping[str, np.ndarray]) -> Factor:
    """Factor of all rows, each channel (c,) of a group multiplied by ``scale``."""
    return rows.total(factor_of(lambda block: block.rows * scale[block.group][:, None]), stacked)


def reduce_in_coordinates(rows: RowCache, scale: Mapping[str, np.ndarray]) -> Factor:
    """The same factor as `reduce_scaled` finds, in half its time, where the pilot has coordinates [Yamamoto2015]_.

    All rows are nearly orthonormal in these; they are read twice where they turn out to be far from it.
    """
    root = pilot_of(rows).root
    if root is not None:
        inverse = solve_triangular(root, np.eye(len(root)))
        if rows.parts:  # which are read for all weights at once
            found = _channels(inverse, rows)
            gram = np.sum([np.tensordot(scale[group] ** 2, each.gram, 1) for group, each in found.items()], axis=0)
            total = _Gram(gram, sum(each.rows for each in found.values()))
        else:
            squares = gram_of(lambda b: on_columns(b.rows * scale[b.group][:, None], inverse), row_by_row=True)
            total = rows.total(lambda block: _Gram(squares(block), block.target.size), _Gram.plus)
        try:
            r = cholesky(total.gram)
        except LinAlgError:  # columns that the pilot shows and the weights hide
            return reduce_scaled(rows, scale)
        if np.all(np.diag(r) > _NEARLY_ORTHONORMAL * np.linalg.norm(r, axis=0).max()):
            return Factor(r @ root, total.rows)
    return reduce_scaled(rows, scale)


@dataclass(frozen=True)
class _Gram:
    """``Z'Z`` of some rows (..., p + 1, p + 1), and how many."""

    gram: np.ndarray
    rows: int

    def plus(self, other: _Gram) -> _Gram:
        return _Gram(self.gram + other.gram, self.rows + other.rows)


def _channels(inverse: np.ndarray, rows: RowCache) -> dict[str, _Gram]:
    """Gram matrices of each channel's rows (c, p + 1, p + 1), by group: rows that are not kept are read once for all of them.

    ``inverse`` brings rows to a pilot's coordinates (p + 1, p + 1).
    """

    def grams(block: Block) -> dict[str, _Gram]:
        total = np.zeros((block.rows.shape[1], *inverse.shape))
        for panel in block.panels():
            z = on_columns(panel.rows, inverse)
            for channel, gram in enumerate(total):
                gram += z[:, channel].T @ z[:, channel]
        return {block.group: _Gram(total, block.target.size)}

    return rows.derived("channels", lambda: rows.total(grams, _together))


def _together(first: dict[str, _Gram], second: dict[str, _Gram]) -> dict[str, _Gram]:
    out = dict(first)
    for group, gram in second.items():
        out[group] = out[group].plus(gram) if group in out else gram
    return out


def channel_grams(rows: RowCache) -> np.ndarray:
    """Gram matrix of each channel's regressor and target over all rows (c, p + 1, p + 1), made once."""

    def made() -> np.ndarray:
        root = pilot_of(rows).root
        if root is not None and rows.parts:
            grams = _channels(solve_triangular(root, np.eye(len(root))), rows)
            return root.T @ np.sum([each.gram for each in grams.values()], axis=0) @ root
        return rows.total(lambda block: np.einsum("tcp,tcq->cpq", block.rows, block.rows, optimize=True), np.add)

    return rows.derived("channel_grams", made)
