"""Whitened columns of shapes, and what links and effects found leave of them, in halves of the recordings.

Whitened coefficients of a segment are taken back to as many samples in time as there are coefficients: still white, and now a
half can be an interval of time.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.fft import dct, idct

from bayesid.diagnosis.data import DiagnosisData, active_terms
from bayesid.diagnosis.description.candidates import CandidateTerm
from bayesid.diagnosis.description.shapes import Range, Shape
from bayesid.diagnosis.fit import Fit
from bayesid.diagnosis.projector import UNKNOWN_OFFSET, orthonormal
from bayesid.diagnosis.spectra import SpectralSegment
from bayesid.effects import Model, variables
from bayesid.effects.formula import Formula

#: Columns made at once.
_CHUNK = 400
#: Share of a column's length that links and effects found must leave: less is rounding, or no motion tells.
_LEFT = 0.02


@dataclass(frozen=True, eq=False)
class SegmentPart:
    """Some of a segment's samples."""

    segment: SpectralSegment  # of the recording
    variables: Mapping[str, np.ndarray]  # what formulas may name, on the segment's grid (M,)
    rows: np.ndarray  # which of the segment's K white samples (k,)
    #: Coefficients of shapes that were asked for, by their texts and channel; -1 for those of a sensor, whose weights are one.
    kept: dict[tuple[tuple[str, ...], int], np.ndarray] = field(default_factory=dict, repr=False)

    def values(self, shapes: Sequence[Shape]) -> np.ndarray:
        """The shapes' products on the grid (M, g); of such as have no finite value zero."""
        factors: dict[str, np.ndarray] = {}  # a few hundred, in thousands of products
        out = np.ones((sum(len(s.products) for s in shapes), len(self.segment.trajectory.times)))  # a course lies in one piece
        for course, product in zip(out, (p for s in shapes for p in s.products), strict=True):
            for factor in product:
                if factor.text not in factors:
                    factors[factor.text] = Formula.parse(factor.text)(self.variables, course=not self.segment.still)
                course *= factors[factor.text]
        out[~np.isfinite(out).all(axis=1)] = 0.0
        return out.T

    def columns(self, values: np.ndarray, channel: int) -> np.ndarray:
        """White rows (k c, g) of courses (M, g) in one channel."""
        coefficients = self.segment.spectrum(values[:, None, :], np.array([channel]))
        return self.taken(self.segment.whitener[:, :, channel, None] * coefficients)

    def courses(self, shapes: Sequence[Shape], channel: int) -> list[np.ndarray]:
        """Coefficients (K, g) of shapes in a channel, an array for each of their products."""
        weight = channel if any(channel == c for c, _ in self.segment.torque_channels) else -1
        new = [s for s in {s.texts: s for s in shapes}.values() if (s.texts, weight) not in self.kept]
        for first in range(0, len(new), _CHUNK):
            some = new[first : first + _CHUNK]
            made = self.segment.spectrum(self.values(some)[:, None, :], np.array([channel]))[:, 0]
            ends = np.cumsum([len(s.products) for s in some])
            each = np.split(made, ends[:-1], axis=1)
            self.kept.update({(s.texts, weight): x for s, x in zip(some, each, strict=True)})
        return [np.stack([self.kept[s.texts, weight][:, i] for s in shapes], axis=1) for i in range(len(shapes[0].products))]

    def products(self, one: int, other: int, courses: np.ndarray) -> np.ndarray:
        """``B_c' B_d y`` of two channels' unit columns B and coefficients y (K, g)."""
        w = self.segment.whitener
        if len(self.rows) == len(w):  # a change of basis only
            return np.einsum("kr,kr->k", w[:, :, one], w[:, :, other])[:, None] * courses
        return (w[:, :, one] @ w[:, :, other].T * self._kept_share) @ courses

    @cached_property
    def _kept_share(self) -> np.ndarray:
        """Gram matrix of the basis functions of time, over this part's samples only (K, K)."""
        basis = np.asarray(idct(np.eye(self.segment.shape[0]), axis=0, norm="ortho"))[self.rows]
        return basis.T @ basis

    def along(self, rows: np.ndarray) -> np.ndarray:
        """White coefficients (K, c, ...) whose products with those of a column are the products of rows (k c, ...) with it."""
        course = np.zeros((*self.segment.shape, *rows.shape[1:]))
        course[self.rows] = rows.reshape(len(self.rows), self.segment.shape[1], *rows.shape[1:])
        return np.asarray(dct(course, axis=0, norm="ortho"))

    def taken(self, white: np.ndarray) -> np.ndarray:
        """Rows of the part (k c, ...), of white coefficients (K, c, ...)."""
        course = np.asarray(idct(white, axis=0, norm="ortho"))[self.rows]
        return course.reshape(-1, *white.shape[2:])


@dataclass(frozen=True, eq=False)
class Half:
    """Some of the fitted recordings, with what links and effects found explain in them."""

    segments: tuple[SpectralSegment, ...]  # all fitted recordings
    parts: tuple[SegmentPart, ...]  # of those that are in this half
    #: Orthonormal columns of the links, the offset and the effects found, with their prior beneath (rows + m, b).
    basis: np.ndarray
    residual: np.ndarray  # what they leave of the readings, with the prior beneath (rows + m,)

    @cached_property
    def rows(self) -> int:
        """Number of rows that are data."""
        return sum(len(p.rows) * p.segment.shape[1] for p in self.parts)

    @cached_property
    def count(self) -> int:
        """Number of those whose channels say anything."""
        return sum(len(p.rows) * int(p.segment.alive.sum()) for p in self.parts)

    def columns(self, candidate: CandidateTerm) -> np.ndarray:
        """What is left of a candidate's columns (rows + m, amplitudes): by channel, and in it by product."""
        made = [
            np.hstack([part.columns(values, c) for c in candidate.channels])
            for part, values in ((p, p.values([candidate.shape])) for p in self.parts)
        ]
        return self.project_out(np.vstack(made))

    def project_out(self, columns: np.ndarray) -> np.ndarray:
        """What is left of columns (rows, k) beneath which the prior says nothing (rows + m, k)."""
        out = -(self.basis @ (self.basis[: self.rows].T @ columns))
        out[: self.rows] += columns
        return out

    def project_out_rows(self, stacked: np.ndarray) -> np.ndarray:
        """What is left of columns of all recordings in coefficients, with the prior's rows beneath (all rows + m, k)."""
        edges = np.cumsum([0, *(s.shape[0] * s.shape[1] for s in self.segments)])
        at = {s: slice(a, b) for s, a, b in zip(self.segments, edges[:-1], edges[1:], strict=True)}
        mine = [p.taken(stacked[at[p.segment]].reshape(*p.segment.shape, -1)) for p in self.parts]
        columns = np.vstack([*mine, stacked[edges[-1] :]])
        return columns - self.basis @ (self.basis.T @ columns)

    def explained(self, candidate: CandidateTerm) -> float:
        """What a candidate would explain of the residual's sum of squares."""
        left = self.columns(candidate)
        taken = np.sum((self.basis[: self.rows].T @ left[: self.rows]) ** 2, axis=0)
        return float(_explained((left.T @ left)[None], (left.T @ self.residual)[None], taken[None])[0])

    def by_block(self, left: np.ndarray, length: float) -> np.ndarray:
        """Sums of squares of what is left (rows + m,), by blocks of time [s] (blocks,)."""
        out, at = [], 0
        for part in self.parts:
            s = part.segment
            energy = np.sum(left[at : (at := at + len(part.rows) * s.shape[1])].reshape(len(part.rows), -1) ** 2, axis=1)
            blocks = (part.rows * (s.times[-1] - s.times[0]) / s.shape[0] / length).astype(int)
            out.append(np.bincount(blocks, energy)[np.unique(blocks)])
        return np.concatenate(out)

    def with_columns(self, left: np.ndarray) -> Half:
        """The half with more columns, of which this is left (rows + m, k), among what is explained."""
        q = orthonormal(left)
        return Half(self.segments, self.parts, np.hstack([self.basis, q]), self.residual - q @ (q.T @ self.residual))

    def gains(self, candidates: Sequence[CandidateTerm]) -> np.ndarray:
        """What each candidate would explain of the residual's sum of squares; 0 for what nothing tells apart from links.

        A column of channel c is ``B_c y`` with the coefficients y of its course and B_c the whitener of c, in time, of this half.
        So the Gram matrix of columns c and d needs ``B_c' B_d`` and ``Q' B_c`` only, which are the same for all candidates.
        """
        out = np.zeros(len(candidates))
        groups: dict[tuple[tuple[int, ...], int], list[int]] = {}
        for k, c in enumerate(candidates):
            groups.setdefault((c.channels, len(c.shape.products)), []).append(k)
        for (channels, _), members in groups.items():
            out[members] = self._gains([candidates[k].shape for k in members], channels)
        return out

    def _gains(self, shapes: Sequence[Shape], channels: tuple[int, ...]) -> np.ndarray:
        products = len(shapes[0].products)
        places = [(c, i) for c in channels for i in range(products)]
        gram = np.zeros((len(places), len(places), len(shapes)))
        pull = np.zeros((len(places), len(shapes)))
        explained = np.zeros((len(places), self.basis.shape[1], len(shapes)))
        at = 0
        for part in self.parts:
            mine = slice(at, at := at + len(part.rows) * part.segment.shape[1])
            courses = part.courses(shapes, channels[0])  # one torque, or axes of a sensor, whose weights are the same
            w = part.segment.whitener
            toward, basis = part.along(self.residual[mine]), part.along(self.basis[mine])
            for a, (c, i) in enumerate(places):
                pull[a] += np.einsum("kr,kr->k", w[:, :, c], toward) @ courses[i]
                explained[a] += np.einsum("kr,krb->bk", w[:, :, c], basis) @ courses[i]
                for b, (d, j) in enumerate(places[: a + 1]):
                    gram[a, b] += np.einsum("kg,kg->g", courses[i], part.products(c, d, courses[j]))
        for a in range(len(places)):
            for b in range(a + 1):
                gram[a, b] -= np.einsum("rg,rg->g", explained[a], explained[b])
                gram[b, a] = gram[a, b]
        return _explained(np.moveaxis(gram, 2, 0), pull.T, np.sum(explained**2, axis=1).T)


def _explained(gram: np.ndarray, pull: np.ndarray, taken: np.ndarray) -> np.ndarray:
    """What columns explain (g,).

    From products of what is left of them with each other (g, k, k) and with the residual (g, k), and squared lengths (g, k) of
    what was taken out.
    """
    left = np.einsum("gaa->ga", gram)
    length = np.sqrt(np.maximum(left + taken, 1e-300))
    energy, vectors = np.linalg.eigh(gram / (length[:, :, None] * length[:, None, :]))
    along = np.einsum("gka,gk->ga", vectors, pull / length)
    alive = (energy > _LEFT**2).all(axis=1)
    return np.where(alive, np.sum(along**2 / np.maximum(energy, _LEFT**2), axis=1), 0.0)


def ranges_of(parts: Sequence[SegmentPart]):
    """Where variables go in moving recordings."""
    moving = [p for p in parts if not p.segment.still]
    known: dict[str, Range] = {}

    def of(name: str) -> Range:
        if name not in known:
            x = np.concatenate([p.variables[name] for p in moving])
            known[name] = Range(float(x.min()), float(x.max()), float(x.std()))
        return known[name]

    return of


def parts_of(data: DiagnosisData, segments: Sequence[SpectralSegment], fit: Fit) -> tuple[SegmentPart, ...]:
    """Whole segments with their variables, true readings as a model has them."""
    models = (Model.of(data.robot, data.channels, s.trajectory, fit.links, active_terms(s, fit.terms)) for s in segments)
    return tuple(SegmentPart(s, variables(m.readout), np.arange(s.shape[0])) for s, m in zip(segments, models, strict=True))


def halves(fit: Fit) -> tuple[Half, Half]:
    """The recordings that a model was fitted to in two: motions in turn, or intervals of time of a single one."""
    projector = fit.projector
    data = projector.data
    whole = parts_of(data, data.segments, fit)
    fixed = projector.q[: projector.length] @ projector.r
    rows = np.hstack([fixed, fit.jacobian, fit.residual[:, None]])
    found = rows.shape[1] - fixed.shape[1] - 1
    below = np.zeros((projector.size, rows.shape[1]))
    below[:, : projector.size] = np.eye(projector.size)
    if projector.offset:
        below[-6:] *= UNKNOWN_OFFSET
    below[:, -1] = -projector.prior_residual(fit.coordinates)
    edges = np.cumsum([0, *(s.shape[0] * s.shape[1] for s in data.segments)])
    motions = list(dict.fromkeys(s.motion for s in data.segments if not s.still))
    made = []
    for second in (False, True):
        mine, stacked = [], []
        for part, first, last in zip(whole, edges[:-1], edges[1:], strict=True):
            s = part.segment
            # Courses are those of the whole segment: both halves share what is made of them.
            chosen = SegmentPart(s, part.variables, np.flatnonzero(_in_second(s, motions) == second), part.kept)
            if len(chosen.rows):
                mine.append(chosen)
                stacked.append(chosen.taken(rows[first:last].reshape(*s.shape, -1)))
        all_ = np.vstack([*stacked, below])
        basis = orthonormal(all_[:, : projector.size + found])
        residual = all_[:, -1] - basis @ (basis.T @ all_[:, -1])
        made.append(Half(data.segments, tuple(mine), basis, residual))
    return made[0], made[1]


def _in_second(segment: SpectralSegment, motions: Sequence[str]) -> np.ndarray:
    """Which of a segment's white samples belong to the second half (K,)."""
    count = segment.shape[0]
    if len(motions) > 1:
        return np.full(count, segment.motion in motions[1::2])
    quarter = 4 * np.arange(count) // count
    return (quarter == 1) | (quarter == 2)
