"""Linear algebra for columns of very different sizes: scaled to unit length, and cut where the rows say nothing."""

from __future__ import annotations

import numpy as np

#: Singular values of columns at unit length that count as none, relative to the largest. A URDF's right angles are rounded to
#: 4e-6: columns of a link and its rotor that are alike but for that differ by some 1e-6, by which a fit takes kilotonnes for what
#: its model lacks. What motions show is above 1e-4.
UNSEEN = 1e-5
#: Variances of correlated parameters that count as none, relative to the largest: the root of the machine's precision, for
#: covariances are products of the factor with itself, in which nothing but rounding is left below it.
_NO_VARIANCE = 1e-8
#: Share of a direction that the rows do not show above which a column has a part in it: below is what such rounding makes.
PART = 1e-4
#: What a row may take of a change that the data do not show, as a share of what it takes of the change's parts, of its own
#: length, and of the longest row's: one that is nothing but rounding takes nothing. A URDF's right angles are rounded
#: to 4e-6, and columns that are alike but for those are.
SHARE_OF_CHANGE, SHARE_OF_ROW, SHARE_OF_LONGEST = 1e-4, 1e-9, 1e-12


def column_lengths(matrix: np.ndarray, smallest: float = 1e-14) -> np.ndarray:
    """Lengths of columns (p,) to divide by; see `or_one`."""
    return or_one(np.linalg.norm(matrix, axis=0), smallest)


def or_one(length: np.ndarray, smallest: float = 1e-14) -> np.ndarray:
    """Lengths (p,), one in place of those that are not above this share of the largest: columns that are zero to rounding."""
    return np.where(length > smallest * length.max(initial=0.0), length, 1.0)


def solve(matrix: np.ndarray, target: np.ndarray, tolerance: float = 1e-11) -> np.ndarray:
    """Least-squares solution of (k, p) and (k,) or (k, m); directions that the rows say nothing about stay zero.

    Singular values of the columns at unit length count as zero below this share of the largest.
    """
    length = column_lengths(matrix)
    return (np.linalg.lstsq(matrix / length, target, rcond=tolerance)[0].T / length).T


def pseudo_inverse(matrix: np.ndarray, tolerance: float = 1e-11) -> np.ndarray:
    """Moore-Penrose inverse (p, k), its rank decided by columns at unit length; ``tolerance`` as in `solve`.

    What the rows say nothing about is orthogonal to it in the parameters' own units, not in those of the lengths: so a product of
    it with itself, a covariance, tells what that is, see `unshown`.
    """
    if not matrix.size:
        return np.zeros(matrix.shape[::-1])
    length = column_lengths(matrix)
    u, s, vt = np.linalg.svd(matrix / length, full_matrices=False)
    rank = int(np.count_nonzero(s > tolerance * s[0]))  # singular values come in descending order
    inverse = (vt[:rank].T / s[:rank]) @ u[:, :rank].T / length[:, None]
    if rank < len(length):
        silent = np.linalg.qr(vt[:rank].T, mode="complete")[0][:, rank:]
        silent = np.where(np.abs(silent).max(axis=1, keepdims=True) > PART, silent, 0.0) / length[:, None]
        silent = np.linalg.qr(silent / np.linalg.norm(silent, axis=0))[0]
        inverse -= silent @ (silent.T @ inverse)
    return inverse


def determined_inverse(matrix: np.ndarray, hidden: np.ndarray) -> np.ndarray:
    """Pseudo-inverse of a factor (k, p) in the determined columns, zero in the hidden ones, see `undetermined` (p, k).

    What hidden columns share with the determined ones is fitted all the same, so it is part of the inverse: without those
    columns the others would seem to be known better than they are. The covariance of an estimate takes `pseudo_inverse` itself,
    which keeps what is known of sums of hidden columns.
    """
    return np.where(hidden[:, None], 0.0, pseudo_inverse(matrix, UNSEEN))


def orthonormal_basis(columns: np.ndarray, shortest: float, thinnest: float) -> np.ndarray:
    """An orthonormal basis of columns (rows, at most k), without directions that are not there.

    Columns below a share of the longest, and singular values below a share of the largest, count as none.
    """
    length = np.linalg.norm(columns, axis=0)
    alive = length > shortest * max(float(length.max(initial=0.0)), 1e-300)
    if not alive.any():
        return columns[:, :0]
    u, s, _ = np.linalg.svd(columns[:, alive] / length[alive], full_matrices=False)
    return u[:, s > thinnest * s[0]]


def undetermined(matrix: np.ndarray, tolerance: float = UNSEEN) -> np.ndarray:
    """Columns of a (weighted) factor with a part that the rows do not determine (p,)."""
    length = np.linalg.norm(matrix, axis=0)
    nothing = length <= 1e-13 * length.max(initial=0.0)
    if nothing.all():
        return nothing
    _, s, vt = np.linalg.svd(matrix[:, ~nothing] / length[~nothing])
    out = nothing.copy()
    out[~nothing] = (np.abs(vt[np.count_nonzero(s > tolerance * s[0]) :]) > PART).any(axis=0)  # fewer rows than columns, too
    return out


def unshown(covariance: np.ndarray, hidden: np.ndarray) -> np.ndarray:
    """Changes of parameters that the data do not show, of unit length (p, m): the null space of the hidden ones' covariance.

    That is a pseudo-inverse (p, p): where the data know a sum of two hidden parameters, such as a link's inertia and its
    rotor's, only their difference is in it. Hidden (p,) are those that are not determined, or only in sums with others.
    """
    at = np.flatnonzero(hidden)
    own = covariance[np.ix_(at, at)]
    size = or_one(standard_deviations(own), 0.0)
    values, vectors = np.linalg.eigh(own / np.outer(size, size))
    out = np.zeros((len(covariance), int(np.sum(values <= _NO_VARIANCE))))
    out[at] = vectors[:, values <= _NO_VARIANCE] / size[:, None]
    return out / np.linalg.norm(out, axis=0)


def takes(rows: np.ndarray, changes: np.ndarray) -> np.ndarray:
    """Whether rows (..., p) take any of some changes of unit length (p, m), rounding and rounded right angles apart (...)."""
    taken, among = np.abs(rows @ changes), np.abs(rows) @ np.abs(changes)
    length = np.linalg.norm(rows, axis=-1, keepdims=True)
    least = np.maximum(SHARE_OF_CHANGE * among, np.maximum(SHARE_OF_ROW * length, SHARE_OF_LONGEST * length.max(initial=0.0)))
    return np.any(taken > least, axis=-1)


def condition_number(matrix: np.ndarray) -> float:
    """Condition number with columns of unit length; infinite where a column is zero."""
    length = np.linalg.norm(matrix, axis=0)
    if not len(length):
        return 1.0
    if length.min() <= 1e-13 * length.max():
        return float("inf")
    s = np.linalg.svd(matrix / length, compute_uv=False)
    return float(s[0] / s[-1]) if s[-1] > 0 else float("inf")


def standard_deviations(covariance: np.ndarray, smallest: float = 0.0) -> np.ndarray:
    """Roots of the variances (p,), of ``smallest`` where rounding leaves less."""
    return np.sqrt(np.maximum(np.diag(covariance), smallest))


def correlations(covariance: np.ndarray, smallest: float = 1e-12) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Standard deviations (p,), and the correlations' eigenvalues (m,) and eigenvectors (p, m) above a share of the largest.

    One stands for a standard deviation of none; see `or_one`.
    """
    std = or_one(standard_deviations(covariance))
    values, vectors = np.linalg.eigh(covariance / np.outer(std, std))
    keep = values > smallest * values.max(initial=0.0)
    return std, values[keep], vectors[:, keep]


def root_of(covariance: np.ndarray) -> np.ndarray:
    """L with ``L L'`` the covariance (p, m), its m directions that have a variance."""
    std, values, vectors = correlations(covariance)
    return std[:, None] * vectors * np.sqrt(values)


def at_least(matrix: np.ndarray, other: np.ndarray) -> np.ndarray:
    """The matrix, larger where the other one is: both and the positive part of their difference, in units of their sum."""
    values, vectors = np.linalg.eigh(matrix + other)
    keep = values > 1e-12 * values[-1]
    root = vectors[:, keep] * np.sqrt(values[keep])
    whiten = vectors[:, keep] / np.sqrt(values[keep])
    excess, directions = np.linalg.eigh(whiten.T @ (other - matrix) @ whiten)
    turned = root @ directions
    return matrix + (turned * np.maximum(excess, 0.0)) @ turned.T
