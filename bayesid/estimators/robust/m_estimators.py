"""Robust estimators, for recordings with contacts and impacts: Huber's loss and Student's t.

Both are iteratively reweighted least squares and differ in their losses.

All channels of a segment of neighbouring rows share one weight w, which the Mahalanobis length of the segment's residuals
gives, and windows that grow from segments of hardly any weight are rejected in time (`bayesid.estimators.robust.segments`). All
the others enter a weighted least squares in the channels' metric D,

    min_b  sum_t w_t |D (y_t - X_t b)|^2,

repeated until its own residuals give the same weights. With all w = 1 this is `wls`.

Plain least squares is no starting point: a contact biases it, which hides the contact in its residuals. So the fit starts from
least absolute lengths of segments, trims to the better half of the recording [Agullo2008]_, and estimates the noise with its
colour from rows that were not rejected.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from scipy.stats import chi2

from bayesid.argument_types import explains_types
from bayesid.errors import InputError
from bayesid.estimators.covariance import encoder_growth
from bayesid.estimators.estimator import Details, Estimate
from bayesid.estimators.factor import Factor, gram_rows, reduce_rows, whitened
from bayesid.estimators.least_squares import completeness, make_estimate, nominal_start, target_from_nominal
from bayesid.estimators.robust.divergence import Directions, ResidualSizes, informative, reasons
from bayesid.estimators.robust.segments import (
    WHOLE,
    HuberLoss,
    Loss,
    Residuals,
    StudentLoss,
    accepted,
    lengths,
    metrics,
    overdispersion_correction,
    residuals,
    weighted,
    windows,
)  # fmt: skip
from bayesid.estimators.weights import Weights, learn_weights
from bayesid.regression.blocks import Block
from bayesid.regression.linalg import or_one, solve, standard_deviations
from bayesid.regression.regression import Regression
from bayesid.regression.row_cache import Kept, RowCache
from bayesid.signals.noise import NoiseModel

_ABSOLUTE_PASSES, _TRIMMED_PASSES = 20, 12
#: Root of the weight of the other half: next to nothing, but enough to hold directions that it alone shows.
_TRIMMED_WEIGHT = 0.03


def trimmed(blocks: Sequence[Block]) -> tuple[np.ndarray, dict[str, NoiseModel]]:
    """Fit to the half of the segments with the smallest residuals [Agullo2008]_, and the size of the noise without colour.

    Least absolute lengths come first: convex, and a segment's pull does not grow with its length.
    """
    columns = blocks[0].rows.shape[2] - 1
    residual = residuals(blocks, np.zeros(columns))
    half = (len(residual.values) + columns // residual.values.shape[1] + 1) // 2
    rows = np.bincount(residual.segment)
    use = np.ones(len(residual.values))
    values, scale = np.zeros(columns), _spread(residual, centred=True)
    for k in range(_ABSOLUTE_PASSES + _TRIMMED_PASSES):
        last = values
        gram = gram_rows(weighted(blocks, residual, use), lambda b, scale=scale: b.rows / scale[b.group][:, None])
        length = or_one(standard_deviations(gram)[:-1])  # good enough to start from
        values = np.linalg.lstsq(gram[:-1, :-1] / np.outer(length, length), gram[:-1, -1] / length, rcond=1e-12)[0] / length
        residual = residuals(blocks, values)
        scale = _spread(residual)
        z = np.empty(len(residual.values))
        for group, mask in residual.groups().items():
            z[mask] = np.mean((residual.values[mask] / scale[group]) ** 2, axis=1)
        power = np.bincount(residual.segment, z) / rows
        if k < _ABSOLUTE_PASSES:
            use = np.maximum(power, 1e-6)[residual.segment] ** -0.25  # the root of the weight 1 / length
        else:
            order = np.argsort(power)
            kept = np.zeros(len(power), bool)
            kept[order[: int(np.searchsorted(np.cumsum(rows[order]), half)) + 1]] = True
            use = np.where(kept[residual.segment], 1.0, _TRIMMED_WEIGHT)
            if k > _ABSOLUTE_PASSES and np.allclose(values, last, rtol=1e-12, atol=0.0):
                break
    noise = {}
    for group, mask in residual.groups().items():
        kept = residual.values[mask & (use == 1.0)]
        channels = kept.shape[1]
        size = kept.T @ kept / len(kept) if len(kept) >= 3 * channels else np.diag(scale[group] ** 2)
        size = size + np.diag(1e-10 * np.diag(size) + 1e-20 * max(np.diag(size).max(), 1e-200))
        # The better half is too quiet; the median of all segments is that of normal ones.
        white = NoiseModel(np.ones((channels, 1)), size)
        alone = replace(residual, values=residual.values[mask], segment=residual.segment[mask], poses=residual.poses[mask])
        q, n = lengths(alone, metrics(alone, {group: white}), np.ones(len(alone.values), bool))
        ratio = float(np.median(q[n > 0] / chi2.median(n[n > 0])))
        noise[group] = NoiseModel(white.coefficients, max(ratio, 1e-12) * size)
    return values, noise


def _spread(residual: Residuals, centred: bool = False) -> dict[str, np.ndarray]:
    """Robust standard deviation of each group's channels, from the median of absolute residuals."""
    out = {}
    for group, mask in residual.groups().items():
        rows = residual.values[mask]
        size = 1.4826 * np.median(np.abs(rows - np.median(rows, axis=0) if centred else rows), axis=0)
        out[group] = np.maximum(size, 1e-9 * max(size.max(), 1e-100))
    return out


_ROUNDS, _ALTERNATIONS = 6, 10
_PASSES = 60
_TOLERANCE = 1e-5  # standard deviations
#: A window grows from segments of less than this weight that are longer than 95 % of normal ones by this factor.
REJECTED_WEIGHT, REJECTED_LENGTH = 0.5, 2.0
#: Nothing is rejected where less than this share of a group's rows would be left: that is the model's fault.
SMALLEST_ACCEPTED = 0.5
_SMALLEST_SLOPE = 0.1
#: Of the lengths of normal segments, for means over them.
_QUANTILES = (np.arange(200) + 0.5) / 200


@dataclass(frozen=True)
class RobustFit:
    """A converged fit.

    ``plain`` are the rows without the filters' known colour, ``clean`` the same with a pilot of accepted rows; ``residual``
    the residuals, ``accepted_rows`` which rows are not rejected, ``weights`` w of each row; ``q``, ``n``, ``variance``
    lengths, degrees of freedom and scale of the accepted rows of each segment; ``hidden`` the parameters that no rows show,
    whatever their weights; ``note`` why nothing was rejected although much is unusual; ``divergence`` why the fit is not right.
    """

    regression: Regression
    plain: Regression
    clean: Regression
    learned: Weights
    loss: Loss
    residual: Residuals
    accepted_rows: np.ndarray
    weights: np.ndarray
    q: np.ndarray
    n: np.ndarray
    variance: float
    factor: Factor
    hidden: np.ndarray
    solution: np.ndarray
    passes: int
    note: str
    divergence: tuple[str, ...]

    @classmethod
    def of(cls, regression: Regression, loss: Loss) -> RobustFit:
        """Learn the noise from a pilot, reject, iterate."""
        plain = _without_filters(regression)
        values, clean, learned, loss = _learn(plain, loss)
        residual = residuals(plain.rows.blocks(), values)
        metric = metrics(residual, learned.noise)
        loss, accepted_rows, note = _judge(plain.rows.blocks, residual, learned.noise, loss)
        # The rank is that of all rows: weights that leave little of a direction must not hide it.
        whole = _factor(plain.rows.blocks(), learned.noise)
        directions = Directions.of(whole.matrix)
        correction = overdispersion_correction(residual, metric)
        begin = nominal_start(regression, len(values))
        passes = 0
        while True:
            passes += 1
            q, n = lengths(residual, metric, accepted_rows, correction)
            used = n > 0
            variance = loss.variance(q[used], n[used])
            share = np.zeros(len(q))
            share[used] = loss.weights(q[used] / variance, n[used])
            weights = np.where(accepted_rows, share[residual.segment], 0.0)
            factor = _factor(weighted(plain.rows.blocks(), residual, np.sqrt(weights)), learned.noise)
            last, values = values, directions.solve(factor, target_from_nominal(regression, factor)) + begin
            residual = residuals(plain.rows.blocks(), values)
            if passes == _PASSES or np.linalg.norm(factor.matrix @ (values - last)) <= _TOLERANCE:
                break
        factor = Factor(factor.r, int(accepted_rows.sum()) * residual.values.shape[1])
        ordinary = directions.solve(whole, target_from_nominal(regression, whole)) + begin
        every = np.ones(len(accepted_rows), bool)
        fits = []
        for own in (residual, residuals(plain.rows.blocks(), ordinary)):
            q_all, n_all = lengths(own, metric, every, correction)
            fits.append(ResidualSizes.of(own, q_all, n_all, plain.rows.blocks()))
        share, direction = directions.least(factor)
        divergence = reasons(regression, share, direction, float(np.sqrt(variance)), fits[0], fits[1], values, ordinary)
        return cls(
            regression, plain, clean, learned, loss, residual, accepted_rows, weights, q, n, variance, factor,
            whole.undetermined, values, passes, note, divergence,
        )  # fmt: skip

    def covariance(self) -> np.ndarray:
        """Sandwich ``A^-1 B A^-1`` of these weights [Huber1981]_.

        The parameters solve ``sum_t X_t' D^2 s_t = 0`` with ``s_t = w_t r_t``. A is the derivative of that sum by the
        parameters, `_slope` times ``sum_t w_t X_t' D^2 X_t``. B is the sum's covariance, ``sum_tu X_t' D^2 C_tu D^2 X_u``
        over accepted rows, C that of s: with size and colour of weighted noise, which varies less than the noise. Where the model
        lacks something, weights fall where that is, which makes nothing more certain: C is then that of r.
        """
        noise = self.learned.dispersed(self._score_noise() if self.learned.complete else None)
        scale = {g: 1.0 / m.std for g, m in self.learned.noise.items()}
        middle = gram_rows(
            weighted(self.plain.rows.blocks(), self.residual, self.accepted_rows.astype(float)),
            lambda b: noise[b.group].colour_transposed(b.matrix * scale[b.group][:, None] ** 2),
        )
        inverse = self.factor.inverse
        bread = inverse @ inverse.T / self._slope(inverse)
        covariance = bread @ middle @ bread
        if self.regression.rows.known_poles is None:  # what encoder errors make of rows is known as the filters leave it
            growth = np.sqrt(encoder_growth(self.clean, self.learned, scale, inverse))
            covariance *= np.outer(growth, growth)
        return covariance

    def _slope(self, inverse: np.ndarray) -> float:
        """How much slower the equations change with the parameters than with fixed weights, mean over all directions.

        A weight falls as its own residuals grow: segment s adds ``2 w'(q_s) (X_s' D^2 r_s) (r_s' C^-1 X_s)`` to A, q_s in
        its own units. With X in the basis ``inverse``, in which the sum of ``w X' D^2 X`` is 1, the mean of the
        diagonal is 1 plus the mean of these. Residuals as smooth in time as the columns weigh more than white ones.
        """
        used = self.n > 0
        change = np.zeros(len(used))
        residual, metric = self.residual, metrics(self.residual, self.learned.noise)
        numbers = residual.values.shape[1] * np.bincount(residual.segment[self.accepted_rows], minlength=len(used))[used]
        unit = self.n[used] / numbers / self.variance  # of q, in squared Mahalanobis lengths
        change[used] = 2.0 * unit * self.loss.slopes(self.q[used] / self.variance, self.n[used])
        if not change.any():
            return 1.0
        total, sizes = 0.0, np.cumsum((0, *residual.sizes))
        for block, a, b in zip(self.plain.rows.blocks(), sizes[:-1], sizes[1:], strict=True):
            segment, keep = residual.segment[a:b] - residual.segment[a], self.accepted_rows[a:b]
            r = residual.values[a:b] * keep[:, None]
            pulls = np.stack([r / self.learned.noise[block.group].std ** 2, r @ metric[block.group].precision], axis=2)
            own = np.einsum("tcp,tck->tpk", block.matrix, pulls)
            own = np.add.reduceat(own, np.flatnonzero(np.append(True, np.diff(segment) > 0)), axis=0)
            first, last = residual.segment[a], residual.segment[b - 1] + 1
            both = np.sum((own[:, :, 0] @ inverse) * (own[:, :, 1] @ inverse), axis=1)
            total += float(change[first:last] @ both)
        seen = np.linalg.matrix_rank(inverse)
        return max(1.0 + total / max(seen, 1), _SMALLEST_SLOPE)

    def _score_noise(self) -> dict[str, NoiseModel]:
        """Noise of ``w y``, learned from weighted rows as that of y is from rows; of noise that is stated, its share."""
        pilot = self.clean.rows.pilot()
        residual = residuals(pilot, self.solution)
        metric = metrics(residual, self.learned.noise)
        q, n = lengths(residual, metric, np.ones(len(residual.values), bool), overdispersion_correction(residual, metric))
        share = self.loss.weights(q / self.variance, n)[residual.segment]
        if (share == 1.0).all():
            return self.learned.noise
        if self.regression.noise_std is not None:
            typical = float(np.median(self.n[self.n > 0]))
            q = chi2.ppf(_QUANTILES, typical)
            w = self.loss.weights(q / max(self.variance, 1.0), np.full(len(q), typical))
            return {g: m.scaled(float(np.sum(w**2 * q) / np.sum(q))) for g, m in self.learned.noise.items()}
        rows = self.clean.rows.with_pilot(tuple(weighted(pilot, residual, share)))
        return learn_weights(replace(self.clean, rows=rows, noise_std=None)).noise

    def estimate(self, name: str, details: type[RobustDetails], **own: Any) -> Estimate:
        """The estimate, with details that hold what is ``own`` to the estimator."""
        covariance = None if self.divergence else self.covariance()
        made = make_estimate(name, self.clean, self.learned, self.factor, self.solution, covariance)
        if self.divergence:
            made = replace(made, interval="none", interval_reason="the fit diverged")
        said = details(
            **completeness(self.learned),
            **own,
            scale=float(np.sqrt(self.variance)),
            rejected_share=float(1.0 - self.accepted_rows.mean()),
            rejected_windows=windows(self.residual, self.accepted_rows, self.regression.motion_names),
            mean_weight_of_accepted_rows=float(self.weights[self.accepted_rows].mean()),
            rows_per_segment=int(np.median(np.bincount(self.residual.segment))),
            iterations=self.passes,
            diverged=bool(self.divergence),
            divergence=self.divergence,
            warnings=self._warnings(name),
        )
        return replace(made, undetermined=self.hidden, noise=_with_filters(self.regression, made.noise), details=said)

    def _warnings(self, name: str) -> tuple[str, ...]:
        """What the user should know of the fit."""
        if self.divergence:
            return (
                f"{name} diverged: {'; '.join(self.divergence)}. Do not use its numbers: take wls, cut the disturbed part out of "
                "the table, or record more motion of these links outside of it.",
            )
        out = [f"{name} did not reject all unusual rows: {self.note}; compare wls."] if self.note else []
        if self.passes == _PASSES:
            out.append(f"{name} did not settle in {_PASSES} rounds, so it is less sure than its intervals say: compare wls.")
        return tuple(out)


def _without_filters(regression: Regression) -> Regression:
    """The rows with the filters' known recursion undone: a tap that lasts for seconds behind 1 rad/s is short again."""
    poles = regression.rows.known_poles
    if poles is None:
        return regression
    channels = len(regression.channel_names)
    known = np.tile(np.real(np.poly(poles)), (channels, 1))
    models = {
        "trajectory": NoiseModel(known, np.eye(channels), from_zero=True),
        "poses": NoiseModel(np.ones((channels, 1)), np.eye(channels)),
    }

    def undone(read: Callable[[], Iterable[Block]]) -> Iterator[Block]:
        for block, rows in whitened(read(), models):
            yield replace(block, rows=rows, times=block.times[len(block.times) - len(rows) :])

    rows = regression.rows
    blocks = partial(undone, rows.blocks)
    plain = RowCache(Kept(blocks) if rows.fits_in_memory else blocks, rows.count, rows.width, partial(undone, rows.pilot))
    std = regression.noise_std  # of what went into the filters
    if std is not None:
        std = np.sqrt(np.diag(NoiseModel.stated(std, poles).innovation))
    return replace(regression, rows=plain, noise_std=std)


def _with_filters(regression: Regression, noise: dict[str, NoiseModel]) -> dict[str, NoiseModel]:
    """The noise of the rows as they are."""
    if regression.rows.known_poles is None:
        return noise
    known = np.real(np.poly(regression.rows.known_poles))
    return {
        group: NoiseModel(np.array([np.convolve(known, a) for a in m.coefficients]), m.innovation, from_zero=True)
        if group == "trajectory" else m
        for group, m in noise.items()
    }  # fmt: skip


def _learn(plain: Regression, loss: Loss) -> tuple[np.ndarray, Regression, Weights, Loss]:
    """A fit to accepted rows of the pilot, the pilot of these rows, and their noise."""
    pilot = plain.rows.pilot()
    values, noise = trimmed(pilot)
    before, clean, learned = np.zeros(0, bool), plain, None
    for _ in range(_ROUNDS):
        residual = residuals(pilot, values)
        loss, accepted_rows, _ = _judge(lambda: pilot, residual, noise, loss)
        if learned is not None and np.array_equal(accepted_rows, before):
            break
        before = accepted_rows
        clean = plain
        if not accepted_rows.all():
            clean = replace(plain, rows=plain.rows.with_pilot(_pieces(pilot, residual, accepted_rows)))
        learned = learn_weights(clean)
        noise = learned.noise
        factor = _factor(clean.rows.pilot(), noise)
        values = solve(factor.matrix, factor.target)
    assert learned is not None
    return values, clean, learned, loss


def _judge(
    read: Callable[[], Iterable[Block]], residual: Residuals, noise: dict[str, NoiseModel], loss: Loss
) -> tuple[Loss, np.ndarray, str]:
    """The loss with what it learns from all segments, the rows that are not rejected, and why none is where more should be."""
    metric = metrics(residual, noise)
    q, n = lengths(residual, metric, np.ones(len(residual.values), bool), overdispersion_correction(residual, metric))
    variance = 1.0
    for _ in range(_ALTERNATIONS):
        loss = loss.fitted(q / variance, n)
        last, variance = variance, loss.variance(q, n)
        if abs(variance - last) <= 1e-4 * last:
            break
    heavy = loss.weights(q / variance, n) < REJECTED_WEIGHT
    # Lengths in units of the median segment: noise that was estimated from accepted rows alone is too small for the others.
    for mask in residual.groups().values():
        own = np.unique(residual.segment[mask])
        q[own] /= max(float(np.median(q[own] / chi2.median(n[own]))), 1e-300)
    accepted_rows = accepted(residual, q, n, heavy & (q > REJECTED_LENGTH**2 * chi2.ppf(WHOLE, n)))
    if accepted_rows.all():
        return loss, accepted_rows, ""
    every = np.ones(len(accepted_rows), bool)
    if any(accepted_rows[mask].mean() < SMALLEST_ACCEPTED for mask in residual.groups().values()):
        return loss, every, "they are more than half of all rows, so that the model is to blame, not a disturbance"
    kept = informative(read, residual, accepted_rows, noise)
    note = "" if kept.sum() == accepted_rows.sum() else "they are the only ones that show some of the parameters"
    return loss, kept, note


def _pieces(blocks: Sequence[Block], residual: Residuals, accepted_rows: np.ndarray) -> list[Block]:
    """What is left of the blocks, each piece as a recording of its own; poses stay together."""
    out = []
    for block, keep in zip(blocks, residual.split(accepted_rows), strict=True):
        if block.group == "poses":
            out.append(replace(block, rows=block.rows[keep], times=block.times[keep]))
            continue
        edges = np.flatnonzero(np.diff(keep)) + 1
        for a, b in zip([0, *edges], [*edges, len(keep)], strict=True):
            if keep[a] and b - a > 1:
                out.append(replace(block, rows=block.rows[a:b], times=block.times[a:b], start=True))
    return [b for b in out if len(b.rows)]


def _factor(blocks: Iterable[Block], noise: dict[str, NoiseModel]) -> Factor:
    """Factor of rows in units of their channels' noise."""
    scale = {g: 1.0 / m.std for g, m in noise.items()}
    return reduce_rows(blocks, lambda b: b.rows * scale[b.group][:, None])


_FIRST_NU = 4.0


@dataclass(frozen=True, kw_only=True)
class RobustDetails(Details):
    """What both robust estimators say."""

    rule: str  # where the loss's parameter is from
    scale: float  # scale of the residuals, in units of the noise
    rejected_share: float  # share of all rows that were rejected
    #: Times of the first and the last row of each rejected window, by recording [s].
    rejected_windows: dict[str, list[list[float]]]
    #: Of the fit; the number of rows is ``rows_per_stretch`` in ``estimate.json``.
    mean_weight_of_accepted_rows: float
    rows_per_segment: int = field(metadata={"key": "rows_per_stretch"})
    iterations: int
    #: Whether the fit cannot be right, and why.
    diverged: bool
    divergence: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class HuberDetails(RobustDetails):
    """The constant of Huber's loss for one row of all channels, and its efficiency relative to least squares."""

    constant: float
    efficiency_for_normal_noise: float


@dataclass(frozen=True, kw_only=True)
class StudentDetails(RobustDetails):
    """Degrees of freedom of Student's t."""

    nu: float


@explains_types
@dataclass(frozen=True)
class Huber:
    """Huber's loss on segments of rows.

    Attributes
    ----------
    constant
        Mahalanobis length of one row of all channels from which on the loss grows linearly; segments of several rows have
        the length that is as rare. None: 95 % of normal segments keep their whole weight. Infinity: `wls`.
    """

    name: str = "huber"
    constant: float | None = None

    def fit(self, regression: Regression) -> Estimate:
        """Estimate with the sandwich covariance of these weights."""
        channels = len(regression.channel_names)
        if self.constant is not None and not self.constant > 0:
            raise InputError(f"huber constant = {self.constant}: give a positive length; a row of {channels} channels has about "
                             f"{np.sqrt(channels):.2g}")  # fmt: skip
        rare = 1.0 - WHOLE if self.constant is None else float(chi2.sf(self.constant**2, channels))
        loss = HuberLoss(rare)
        fit = RobustFit.of(regression, loss)
        return fit.estimate(
            self.name,
            HuberDetails,
            constant=float(np.sqrt(chi2.isf(rare, channels))),
            rule="95 % of normal segments keep their whole weight" if self.constant is None else "as given",
            efficiency_for_normal_noise=loss.efficiency(float(np.median(fit.n[fit.n > 0]))),
        )


@explains_types
@dataclass(frozen=True)
class Student:
    """Student's t likelihood of segments of rows, with unknown scale.

    Attributes
    ----------
    nu
        Degrees of freedom. None: of largest likelihood, between 1 and 1000. Infinity: `wls`.
    """

    name: str = "student"
    nu: float | None = None

    def fit(self, regression: Regression) -> Estimate:
        """Estimate with the sandwich covariance of these weights."""
        if self.nu is not None and not self.nu > 0:
            raise InputError(f"student nu = {self.nu}: give positive degrees of freedom, or none to have them estimated")
        fit = RobustFit.of(regression, StudentLoss(_FIRST_NU, True) if self.nu is None else StudentLoss(self.nu))
        assert isinstance(fit.loss, StudentLoss)
        rule = "largest likelihood of all segments" if self.nu is None else "as given"
        return fit.estimate(self.name, StudentDetails, nu=fit.loss.nu, rule=rule)
