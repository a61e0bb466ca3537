"""Links and offset, which are in every model and enter linearly: projected out once.

With ``[A; I] = Q R`` of their whitened columns A over their prior, a column z of an effect keeps ``z - Q Q' z``, the part that no
change of the links explains.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayesid.diagnosis.data import DiagnosisData, residual_rows
from bayesid.diagnosis.spectra import SpectralSegment
from bayesid.effects import Term
from bayesid.effects.families import comes_on_top

#: One over the prior standard deviation of an offset, of which nothing is known [1/N, 1/(N m)].
UNKNOWN_OFFSET = 1e-6


@dataclass(frozen=True, eq=False)
class NuisanceProjector:
    """Whitened columns of the links and the offset over their prior, reduced once."""

    data: DiagnosisData  # what is fitted
    root: np.ndarray  # ``links = nominal + root @ u`` with u ~ N(0, 1) (10 b, m)
    offset: bool  # whether a constant offset is among the columns, behind the links'
    #: Factors of ``[A; I]`` (rows + m + 6, m + 6).
    q: np.ndarray
    r: np.ndarray
    rows: int  # number of rows that are data: those of channels that say anything
    volume: float  # log determinant of the noise of all rows
    rigid: bool  # whether the links' columns are those of rigid bodies, at whatever links

    @property
    def size(self) -> int:
        """Number of columns projected out."""
        return self.r.shape[1]

    @property
    def finite(self) -> bool:
        """Whether the columns are: those of links on a mount that diverges are not."""
        return bool(np.isfinite(self.r).all())

    @property
    def length(self) -> int:
        """Number of rows above the prior's, those of channels that say nothing among them."""
        return len(self.q) - self.size

    def residual(self, u: np.ndarray, terms: Sequence[Term]) -> np.ndarray:
        """Whitened rows of what was measured less what links and offset at coordinates u (size,) and effects make (rows,)."""
        data = self.data
        if self.rigid and all(comes_on_top(t.effect) for t in terms):
            # Links and offset change the readings by their columns, and what the nominal ones make is kept with the motion.
            nominal = residual_rows(data, data.segments, data.links, np.zeros(len(data.channels)), terms)
            return nominal - self.q[: self.length] @ (self.r @ u)
        return residual_rows(data, data.segments, *self.split(u), terms)

    def split(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Links (10 b,) and offset (c,) of coordinates u (size,)."""
        m = self.root.shape[1]
        offset = u[m:] if self.offset else np.zeros(len(self.data.channels))
        return self.data.links + self.root @ u[:m], offset

    def project_out(self, stacked: np.ndarray) -> np.ndarray:
        """What links and offset cannot explain of rows of data with those of their prior beneath (rows + size, ...)."""
        return stacked - self.q @ (self.q.T @ stacked)

    def prior_residual(self, u: np.ndarray) -> np.ndarray:
        """Rows of the prior at coordinates u (size,)."""
        out = u.copy()
        if self.offset:
            out[-6:] *= UNKNOWN_OFFSET
        return out

    def columns(self, rows: np.ndarray) -> np.ndarray:
        """What links and offset cannot explain of columns (rows, k) of which the prior says nothing (rows + size, k)."""
        out = self.q @ (self.q[: self.length].T @ rows)
        np.negative(out, out=out)
        out[: self.length] += rows
        return out


def make_projector(data: DiagnosisData, terms: Sequence[Term]) -> NuisanceProjector:
    """Reduce the columns that are in every model, at the given effects."""
    root = np.zeros((len(data.links), 0))
    if data.prior is not None:
        size = np.sqrt(np.diag(data.prior.covariance))
        root = size[:, None] * np.linalg.cholesky(data.prior.covariance / np.outer(size, size) + 1e-12 * np.eye(len(size)))
    offset = data.offset_free and data.channel == "wrench"
    parts = []
    for s in data.segments:
        mine = []
        if data.prior is not None:
            spectrum = s.whiten(s.spectrum(data.link_columns(s, terms)))
            mine.append(spectrum.reshape(-1, spectrum.shape[2]) @ root)
        if offset:
            mine.append(offset_columns(s))
        parts.append(np.hstack(mine) if mine else np.zeros((s.shape[0] * s.shape[1], 0)))
    whitened = np.vstack(parts)
    prior = np.eye(whitened.shape[1])
    if offset:
        prior[-6:] *= UNKNOWN_OFFSET
    q, r = np.linalg.qr(np.vstack([whitened, prior]))
    volume = sum(float(np.linalg.slogdet(s.covariance)[1].sum()) for s in data.segments)
    rigid = all(comes_on_top(t.effect) for t in terms)
    return NuisanceProjector(data, root, offset, q, r, sum(s.count for s in data.segments), volume, rigid)


def offset_columns(segment: SpectralSegment) -> np.ndarray:
    """Whitened columns of a constant in every channel (rows, c)."""
    channels = segment.readings.shape[1]
    ones = np.broadcast_to(np.eye(channels), (len(segment.readings), channels, channels))
    return segment.whiten(segment.measured(ones)).reshape(-1, channels)


#: Singular values below this share of the largest are directions that are not there.
_LEAST = 1e-6


@dataclass(frozen=True, eq=False)
class Span:
    """The space that columns span, from their triangular factor: no basis as large as they are is made to project on them."""

    columns: np.ndarray  # (rows, k)
    root: np.ndarray  # ``columns @ root`` is an orthonormal basis (k, rank)
    more: Span | None = None  # another space, orthogonal to this one, or None

    @classmethod
    def of(cls, columns: np.ndarray, least: float = _LEAST, rounding: float = 0.0) -> Span:
        """The span of columns (rows, k), each in its own unit, but for singular values below a share ``least`` of the largest.

        Directions no longer than ``rounding``, the absolute error of every column in its unit, are left out.
        """
        length = np.linalg.norm(columns, axis=0)
        there = np.flatnonzero(length > 0.0)
        length = np.maximum(length, rounding / least)
        root = np.zeros((columns.shape[1], 0))
        if len(there):
            _, s, vt = np.linalg.svd(np.linalg.qr(columns[:, there] / length[there], mode="r"))
            keep = s > least * max(s[0], float(rounding > 0.0))
            root = np.zeros((columns.shape[1], int(keep.sum())))
            root[there] = (vt[: len(s)][keep] / s[keep, None]).T / length[there, None]
        return cls(columns, root)

    @property
    def rank(self) -> int:
        """Number of dimensions."""
        return self.root.shape[1] + (self.more.rank if self.more else 0)

    def along(self, values: np.ndarray) -> np.ndarray:
        """Components of values (rows,) in the basis of the columns alone (rank,)."""
        return self.root.T @ (self.columns.T @ values)

    def project_out(self, values: np.ndarray) -> np.ndarray:
        """What the columns cannot explain of values (rows, ...)."""
        left = values - self.columns @ (self.root @ self.along(values))
        return self.more.project_out(left) if self.more else left

    def with_more(self, columns: np.ndarray, rounding: float = 0.0) -> Span:
        """The space with further columns (rows, k) in it; ``rounding`` as for `of`."""
        length = np.linalg.norm(columns, axis=0)
        units = columns[:, length > 0.0] / np.maximum(length[length > 0.0], rounding / _LEAST)
        left = self.project_out(self.project_out(units))
        # Of what is explained already only rounding is left.
        new = np.linalg.norm(left, axis=0) > _LEAST
        return Span(self.columns, self.root, Span.of(left[:, new]))


def orthonormal(columns: np.ndarray) -> np.ndarray:
    """An orthonormal basis of columns (rows, k)."""
    span = Span.of(columns)
    return span.columns @ span.root
