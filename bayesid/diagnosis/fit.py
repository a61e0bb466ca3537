"""Exact fits of the links and any effects, and how much the data prefer one set of effects to another.

Links, with their prior, and the offset that a static run removes are in every model and enter
linearly, so they are projected out once: with ``[A; I] = Q R`` of their whitened columns A over their prior, a column z
of an effect keeps ``z - Q Q' z``, the part that no change of the links explains. What is left are a handful of
parameters, found by Gauss-Newton steps on the exact readings.

Models are compared by ``score = -chi2 / 2 - log det S / 2 - k / 2 log n`` over n rows: the evidence under a prior with the
information of one row for each of the k parameters [Schwarz1978]_. The noise S matters where a model makes more of it than
another does: a flexible joint differentiates the encoders' errors twice more.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayesid.diagnosis.data import DiagnosisData, active_terms
from bayesid.diagnosis.spectra import Segment
from bayesid.effects import Term, columns
from bayesid.robot.prior import Prior

_STEPS = 15
#: Damping of the first step, in units of a column's squared length, and how often a step is damped more.
_DAMPING, _TRIALS = 1e-3, 6
#: Neighbouring frequencies whose residuals may depend on each other.
_TOGETHER = 10
#: A fit has settled when a step changes chi2 by less.
_SETTLED = 0.02
#: Sizes that a change of a link is tried with, over its own.
WIDTHS = np.array([0.02, 0.05, 0.1, 0.2, 0.5, 1.0])
#: Share of a column's length that must be left once the links are projected out.
ALIVE = 1e-5
#: Prior standard deviations of an offset, of which nothing is known, are one over this [N, N m].
UNKNOWN_OFFSET = 1e-6
#: A column in sigmas per SI unit this small is rounding: a million newtons or radians would not be seen.
_ROUNDING = 1e-6


@dataclass(frozen=True, eq=False)
class NuisanceProjector:
    """Whitened columns of the links and the offset over their prior, reduced once.

    Attributes
    ----------
    case
        What is fitted.
    root
        ``links = nominal + root @ u`` with u ~ N(0, 1) (10 b, m).
    offset
        Whether a constant offset is among the columns, behind the links'.
    q, r
        Factors of ``[A; I]`` (rows + m + 6, m + 6).
    rows
        Number of rows that are data: those of channels that say anything.
    volume
        Log determinant of the noise of all rows.
    """

    data: DiagnosisData
    root: np.ndarray
    offset: bool
    q: np.ndarray
    r: np.ndarray
    rows: int
    volume: float

    @property
    def size(self) -> int:
        """Number of columns projected out."""
        return self.r.shape[1]

    @property
    def length(self) -> int:
        """Number of rows above the prior's, those of channels that say nothing among them."""
        return len(self.q) - self.size

    def project_out(self, stacked: np.ndarray) -> np.ndarray:
        """What links and offset cannot explain of rows of data with those of their prior beneath (rows + size, ...)."""
        return stacked - self.q @ (self.q.T @ stacked)

    def prior_residual(self, u: np.ndarray) -> np.ndarray:
        """Rows of the prior at coordinates u (size,)."""
        out = u.copy()
        if self.offset:
            out[-6:] *= UNKNOWN_OFFSET
        return out

    def with_prior_rows(self, rows: np.ndarray) -> np.ndarray:
        """Rows of data with zeros for the prior (rows + size, ...)."""
        return np.concatenate([rows, np.zeros((self.size, *rows.shape[1:]))])


@dataclass(frozen=True, eq=False)
class Fit:
    """A model fitted to the identification motions.

    Attributes
    ----------
    projector
        What it was fitted with.
    terms
        Effects with their values.
    links
        (10 b,).
    offset
        Constant offset (c,), zero where none is fitted.
    chi2
        Sum of squares of whitened rows and of the links against their prior.
    parameters
        How many of the effects' parameters the data determine.
    score
        See the module.
    covariance
        Of the effects' free parameters in the order of ``terms`` (k, k), the links' uncertainty included.
    free
        (term, parameter) of each of them.
    coordinates
        The links and the offset in the coordinates of `NuisanceProjector` (size,).
    residual
        Whitened rows (rows,).
    """

    projector: NuisanceProjector
    terms: tuple[Term, ...]
    links: np.ndarray
    offset: np.ndarray
    chi2: float
    parameters: int
    score: float
    covariance: np.ndarray
    free: tuple[tuple[int, int], ...]
    coordinates: np.ndarray
    residual: np.ndarray


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
    return NuisanceProjector(data, root, offset, q, r, sum(s.count for s in data.segments), volume)


def offset_columns(segment: Segment) -> np.ndarray:
    """Whitened columns of a constant in every channel (rows, c)."""
    channels = segment.readings.shape[1]
    ones = np.broadcast_to(np.eye(channels), (len(segment.readings), channels, channels))
    return segment.whiten(segment.measured(ones)).reshape(-1, channels)


def residual_rows(data: DiagnosisData, segments: Sequence[Segment], links: np.ndarray, offset: np.ndarray, terms: Sequence[Term]):
    """Whitened rows of what was measured less what is predicted (rows,)."""
    out = []
    for s in segments:
        measured = s.measured(s.readings - offset)
        with np.errstate(all="ignore"):  # a very compliant mount diverges; its fit is then refused
            out.append(s.whiten(measured - s.spectrum(data.predict(s, links, terms))).ravel())
    return np.concatenate(out)


def term_rows(
    data: DiagnosisData, segments: Sequence[Segment], links: np.ndarray, terms: Sequence[Term], term: Term
) -> np.ndarray:
    """Whitened derivatives of the readings with respect to a term's parameters beside other terms (rows, k)."""
    parts = []
    for s in segments:
        if active_terms(s, [term]):
            with np.errstate(all="ignore"):  # as above
                found = columns(data.robot, data.channels, s.scene, links, active_terms(s, terms), term.effect, term.values)
            parts.append(s.white(found))
        else:
            parts.append(np.zeros((s.shape[0] * s.shape[1], len(term.values))))
    return np.vstack(parts)


def model_rows(data: DiagnosisData, segments: Sequence[Segment], links: np.ndarray, terms: Sequence[Term]) -> np.ndarray:
    """Whitened derivatives with respect to all free parameters of a model's effects (rows, k)."""
    parts = [np.zeros((sum(s.shape[0] * s.shape[1] for s in segments), 0))]
    parts += [
        term_rows(data, segments, links, tuple(x for x in terms if x is not t), t) for t in terms if not data.fixed(t)
    ]  # fmt: skip
    return np.hstack(parts)


def fit(projector: NuisanceProjector, terms: Sequence[Term], start: Fit | None = None, steps: int = _STEPS) -> Fit:
    """Fit links, offset and the effects' free parameters.

    Parameters
    ----------
    projector
        The columns that are always in.
    terms
        Effects with starting values.
    start
        A fit whose links and offset to start from.
    steps
        At most this many Gauss-Newton steps.
    """
    data, terms = projector.data, tuple(terms)
    u = np.zeros(projector.size) if start is None else start.coordinates.copy()
    free = tuple((i, k) for i, t in enumerate(terms) if not data.fixed(t) for k in range(len(t.values)))
    rows = _rows(projector, u, terms)
    prior = projector.prior_residual(u)
    chi2 = float(rows @ rows + prior @ prior)
    damping = _DAMPING
    for _ in range(steps):
        links, _ = _split(projector, u)
        jacobian = model_rows(data, data.segments, links, terms)
        if not np.isfinite(jacobian).all():
            break
        stacked = np.concatenate([rows, -prior])
        kept = projector.project_out(projector.with_prior_rows(jacobian))
        length = np.linalg.norm(kept, axis=0)
        scale = np.where(_alive(length, jacobian), length, np.inf)
        values, vectors = _eigen(kept / scale)
        pull = vectors.T @ ((kept / scale).T @ projector.project_out(stacked))
        accepted = None
        for _ in range(_TRIALS):
            # Levenberg and Marquardt: where a direction says nothing yet (a point without a force), hold it back.
            change = (vectors / (values + damping)) @ pull / scale if len(free) else np.zeros(0)
            trial = _moved(terms, free, change)
            taken = np.array([trial[i].values[k] - terms[i].values[k] for i, k in free])
            du = (
                np.linalg.solve(projector.r, projector.q.T @ (stacked - projector.with_prior_rows(jacobian @ taken)))
                if projector.size
                else u
            )
            new_rows, new_prior = _rows(projector, u + du, trial), projector.prior_residual(u + du)
            new_chi2 = float(new_rows @ new_rows + new_prior @ new_prior)
            if chi2 - new_chi2 > -_SETTLED:
                accepted = (u + du, new_rows, new_prior, new_chi2, trial)
                break
            damping = max(10.0 * damping, 1e-4)
        if accepted is None:
            break
        gain = chi2 - accepted[3]
        u, rows, prior, chi2, terms = accepted
        damping = 0.1 * damping if damping > 1e-7 else 0.0
        if gain < _SETTLED:
            break
    links, offset = _split(projector, u)
    jacobian = model_rows(data, data.segments, links, terms)
    possible = bool(np.isfinite(chi2) and np.isfinite(jacobian).all())
    if not possible:  # diverged: refused
        jacobian, rows, chi2 = np.zeros(jacobian.shape), np.zeros(len(rows)), np.inf
    kept = projector.project_out(projector.with_prior_rows(jacobian))
    length = np.linalg.norm(kept, axis=0)
    safe = np.where(_alive(length, jacobian), length, np.inf)
    values, vectors = _eigen(kept / safe)
    covariance = (vectors / values) @ vectors.T / np.outer(safe, safe)
    covariance = _widened(projector, covariance, kept, rows)
    score = -0.5 * chi2 - 0.5 * projector.volume - _price(projector, terms, free, kept) if possible else -np.inf
    return Fit(projector, terms, links, offset, chi2, len(values), score, covariance, free, u, rows)


def _widened(projector: NuisanceProjector, covariance: np.ndarray, kept: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """The covariance, no smaller than what the residuals' own scatter makes of it.

    The sandwich ``C (sum_g s_g s_g' + P'P) C`` with the scores s_g of groups of neighbouring frequencies and the prior's
    rows P holds also where the noise is louder in some band than was thought [White1980]_. Where its standard deviation is
    larger, it replaces the model's, with the model's correlations.
    """
    if not covariance.size:
        return covariance
    scores, at = [], 0
    for s in projector.data.segments:
        size = s.shape[0] * s.shape[1]
        product = kept[at : at + size] * rows[at : at + size, None]
        edges = np.arange(0, size, _TOGETHER * s.shape[1])
        scores.append(np.add.reduceat(product, edges, axis=0))
        at += size
    groups = np.vstack(scores)
    prior = kept[projector.length :]
    middle = groups.T @ groups * len(groups) / max(len(groups) - kept.shape[1], 1) + prior.T @ prior
    sandwich = np.diag(covariance @ middle @ covariance)
    own = np.diag(covariance)
    factor = np.sqrt(np.maximum(sandwich / np.where(own > 0, own, np.inf), 1.0))
    return covariance * np.outer(factor, factor)


def _price(projector: NuisanceProjector, terms: Sequence[Term], free: Sequence[tuple[int, int]], kept: np.ndarray) -> float:
    """What the free parameters cost: ``k / 2 log n``; for a changed link what its prior takes away from the evidence.

    The change is ``w R y`` with y ~ N(0, 1), R R' a prior as wide as the link itself and the width w that suits the estimate
    best. In the eigenvectors of ``R' Z' Z R``, eigenvalues l and Z the columns, estimates x = R y of least squares cost

        sum of [l y^2 / (1 + w^2 l) + log(1 + w^2 l)] / 2,  and the logarithm of the number of widths tried.
    """
    total = 0.0
    for i, t in enumerate(terms):
        mine = kept[:, [column for column, (term, _) in enumerate(free) if term == i]]
        if t.effect.changes_link and mine.shape[1]:
            joint = t.effect.joint or 0
            body = projector.data.links[10 * joint : 10 * joint + 10]
            prior = Prior.warped(body, 1.0).covariance
            size = np.sqrt(np.diag(prior))
            root = size[:, None] * np.linalg.cholesky(prior / np.outer(size, size) + 1e-12 * np.eye(10))
            energy, vectors = np.linalg.eigh(root.T @ (mine.T @ mine) @ root)
            y, energy = vectors.T @ np.linalg.solve(root, np.array(t.values)), np.maximum(energy, 0.0)
            spread = 1.0 + WIDTHS[:, None] ** 2 * energy
            total += 0.5 * float(np.min(np.sum(energy * y**2 / spread + np.log(spread), axis=1))) + np.log(len(WIDTHS))
        elif mine.shape[1]:
            length = np.linalg.norm(mine, axis=0)
            total += 0.5 * len(_eigen(mine / np.where(length > 0, length, 1.0))[0]) * np.log(projector.rows)
    return total


def _alive(length: np.ndarray, jacobian: np.ndarray) -> np.ndarray:
    """Whether what is left of columns can say anything: a share of them, and more than rounding (k,)."""
    return (length > ALIVE * np.linalg.norm(jacobian, axis=0)) & (length > _ROUNDING)


def _eigen(columns_: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Eigenvalues and vectors of the Gram matrix of scaled columns, without directions that are not there."""
    values, vectors = np.linalg.eigh(columns_.T @ columns_) if columns_.shape[1] else (np.zeros(0), np.zeros((0, 0)))
    keep = values > 1e-9
    return values[keep], vectors[:, keep]


def _split(projector: NuisanceProjector, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    m = projector.root.shape[1]
    offset = u[m:] if projector.offset else np.zeros(len(projector.data.channels))
    return projector.data.links + projector.root @ u[:m], offset


def _rows(projector: NuisanceProjector, u: np.ndarray, terms: Sequence[Term]) -> np.ndarray:
    links, offset = _split(projector, u)
    return residual_rows(projector.data, projector.data.segments, links, offset, terms)


def _moved(terms: tuple[Term, ...], free: Sequence[tuple[int, int]], change: np.ndarray) -> tuple[Term, ...]:
    """The terms with their free parameters changed, inside what is possible."""
    values = [np.array(t.values, float) for t in terms]
    for (i, k), d in zip(free, change, strict=True):
        kind = terms[i].effect.kind
        values[i][k] = np.clip(values[i][k] + d, kind.lower[k], kind.upper[k])
    return tuple(replace(t, values=tuple(v)) for t, v in zip(terms, values, strict=True))
