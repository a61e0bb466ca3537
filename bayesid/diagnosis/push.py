"""A push: a contact whose force takes any course in time, as that of a hand does, in one interval of one motion.

Nothing is assumed of the force, so an interval's readings tell only what a point on a link that is pushed leaves of them: of a
wrench three numbers of six at every moment, the force itself at another point. With residuals r (c,), columns X of links,
offsets and effects, and readings U(p) (c, 3) of a unit force at the point p,

    r_k = X_k b + [k in the interval] U_k(p) F_k + e_k,    U_k(p) = U_k(0) + sum_j p_j V_kj,

the course F is eliminated moment by moment (variable projection [Golub1973]_), and p is found by Gauss-Newton steps beside b.
Moments are the inverse cosine transform of the coefficients that are compared: one every 50 ms of a band of 10 Hz.

What a model lacks goes beyond the sensor's noise, so the variance of e is learnt channel by channel, from all recordings outside
the interval: the motions without the push are what speaks for it. A course has as many numbers as the interval has moments, and
each costs ``log n / 2`` of evidence [Schwarz1978]_. The push must be worth that against the user's model and against the
best attempt of a search, and it must be a better account of its interval than no account, six free numbers at every moment.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from scipy.fft import idct
from scipy.stats import chi2

from bayesid.diagnosis.data import DiagnosisData, Episode, active_terms
from bayesid.diagnosis.fit import Fit
from bayesid.diagnosis.grams import squared
from bayesid.diagnosis.noise import with_noise_of
from bayesid.diagnosis.spectra import SpectralSegment, taper
from bayesid.effects import Effect, ExternalContact, MotionSegment, Term, columns
from bayesid.effects.families import SensorEffect
from bayesid.recordings.experiment import Experiment
from bayesid.recordings.table import Table
from bayesid.regression.readings import make_channels

#: Length of a block of moments that windows are first made of [s], and most blocks of one recording.
_BLOCK, _MOST_BLOCKS = 0.25, 200
#: Ratio of the lengths of windows tried.
_LONGER = 1.3
#: Weight of a moment below which a recording that fades in or out says too little.
_FADED = 0.5
#: Prior standard deviation of the point about its link's origin, by axis [m]: of what no force's direction shows.
_POINT_STD = 0.5
#: Prior precision of what nothing is known of, in units of its column's squared length.
_FLAT = 1e-10
#: Gauss-Newton steps for the point, rounds in which the scales are learnt again.
_STEPS, _ROUNDS = 4, 3


@dataclass(frozen=True)
class Push(Episode):
    """A contact with the course of its force; its values hold the mean force."""

    times: np.ndarray = field(default_factory=lambda: np.zeros(0), compare=False, repr=False)  # moments of the course (m,) [s]
    #: In base axes at each (m, 3), and its standard deviations [N].
    force: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)), compare=False, repr=False)
    force_std: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)), compare=False, repr=False)
    #: Standard deviations of the values (8,).
    std: np.ndarray = field(default_factory=lambda: np.zeros(8), compare=False, repr=False)
    evidence: float = field(default=0.0, compare=False)  # log evidence that it adds

    def differs_from_zero(self, interval: float) -> bool:
        """Whether the mean force does, outside of an interval of such a probability about it.

        A force that turns over within its interval is what play or friction makes where a joint turns, and no push.
        """
        return bool(np.sum((np.array(self.values[2:5]) / self.std[2:5]) ** 2) > chi2.ppf(interval, 3))

    def to_dict(self) -> dict:
        """The entry ``course`` of an effect in ``diagnosis.json``."""
        axes = ("fx", "fy", "fz")
        return {
            "motion": self.motion, "t": self.times.tolist(), "unit": "N",
            **{axis: self.force[:, k].tolist() for k, axis in enumerate(axes)},
            **{f"{axis}_std": self.force_std[:, k].tolist() for k, axis in enumerate(axes)},
        }  # fmt: skip


@dataclass(frozen=True, eq=False)
class _Moments:
    """Residuals of moving recordings as courses in time, with the columns of what may explain them."""

    #: What is compared, and the model.
    data: DiagnosisData
    fit: Fit
    #: The recordings, those that were fitted first, and where the moments of each begin and end (s + 1,).
    segments: tuple[SpectralSegment, ...]
    edges: np.ndarray
    #: (N, c) in the readings' units, and (N, c, p).
    residual: np.ndarray
    columns: np.ndarray
    prior: np.ndarray  # precision of each column's coefficient (p,)

    @property
    def rows(self) -> int:
        """Readings of all moments."""
        return self.residual.size

    def times(self, k: int) -> np.ndarray:
        """Moments of a recording (K,) [s]."""
        s, count = self.segments[k], int(self.edges[k + 1] - self.edges[k])
        return s.times[0] - 0.5 * s.step + (np.arange(count) + 0.5) / count * len(s.times) * s.step

    def share(self, k: int) -> np.ndarray:
        """How far a recording has faded in at its moments (K,)."""
        s = self.segments[k]
        return taper(self.times(k), s.times, s.trajectory.bandwidth, s.settings)

    def outside(self, inside: slice) -> np.ndarray:
        """Which moments are not in a window (N,)."""
        out = np.ones(len(self.residual), bool)
        out[inside] = False
        return out

    def scales(self, inside: slice) -> np.ndarray:
        """Root mean square (c,) of what the fit to all moments outside a window leaves there, each channel counting alike."""
        outside = self.outside(inside)
        scale = _root_mean_square(self.residual[outside])
        for _ in range(_ROUNDS):
            rows = (self.columns[outside] / scale[:, None]).reshape(-1, len(self.prior))
            target = (self.residual[outside] / scale).ravel()
            coefficients, _ = _solved(rows.T @ rows + np.diag(self.prior), rows.T @ target)
            scale = _root_mean_square(self.residual[outside] - self.columns[outside] @ coefficients)
        return scale

    def scaled(self, scale: np.ndarray) -> _Scaled:
        """Everything in units of each channel's scale (c,)."""
        rows = np.concatenate([self.columns, self.residual[:, :, None]], axis=2) / scale[:, None]
        return _Scaled(rows, squared(rows) + np.diag([*self.prior, 0.0]), scale, self.edges)


@dataclass(frozen=True, eq=False)
class _Scaled:
    """Columns and residual with every channel in units of what is left of it outside a window."""

    #: (N, c, p + 1), and their inner products with the prior's (p + 1, p + 1).
    rows: np.ndarray
    total: np.ndarray
    #: (c,), and of the recordings (s + 1,).
    scale: np.ndarray
    edges: np.ndarray

    @property
    def count(self) -> int:
        """Readings of all moments."""
        return self.rows.shape[0] * self.rows.shape[1]

    def first(self, inside: slice) -> int:
        """The first moment of the recording that a window is in."""
        return int(self.edges[np.searchsorted(self.edges, inside.start, side="right") - 1])


@dataclass(frozen=True, eq=False)
class _Window:
    """A push fitted in one window."""

    #: Of the columns (p,), and the point pushed (3,) [m].
    coefficients: np.ndarray
    point: np.ndarray
    #: (m, 3) [N], and its covariance where all else is known (m, 3, 3), in units of the scales.
    force: np.ndarray
    inverse: np.ndarray
    slopes: np.ndarray  # changes of the force with coefficients and point (m, 3, p + 3)
    #: Twice a negative log evidence; the squared checks inside, in units of the scales.
    cost: float
    checks: float
    covariance: np.ndarray  # of coefficients and point (p + 3, p + 3), in units of the scales


def find_push(user: Fit, best: Fit | None = None) -> Push | None:
    """The push that readings of a wrench sensor demand, if there is one and other motions are without it.

    ``best`` is the best attempt at explaining what the user's model leaves without a push, where there is one.
    """
    data = user.projector.data
    moments = _moments(data, user)
    if moments is None or len({s.motion for s in moments.segments}) < 2 or (start := _scanned(moments)) is None:
        return None
    k, inside = start
    places = [p for e in data.places(ExternalContact.name) if e.where != "robot" and (p := _Place.of(moments, k, e)).seen]
    if not places:
        return None
    place = places[0]
    for _ in range(_ROUNDS):
        scaled, before = moments.scaled(moments.scales(inside)), inside
        costs = [_fitted(scaled, x, inside).cost for x in places]
        place = places[int(np.argmin(costs))]
        inside = _refined(moments, k, scaled, place, inside)
        if inside == before:
            break
    scale = moments.scales(inside)
    window = _fitted(moments.scaled(scale), place, inside)
    attempts = [moments] + ([m] if best is not None and (m := _moments(data, best)) is not None else [])
    plain = min(2.0 * len(m.residual) * float(np.log(m.scales(slice(0))).sum()) for m in attempts)
    # -2 log likelihood at the best scales is sum log(scale^2) N + rows, here without what is the same in all three.
    length, channels = inside.stop - inside.start, len(scale)
    volume = 2.0 * len(moments.residual) * float(np.log(scale).sum()) - channels * length
    price, correlated = np.log(moments.rows), _correlated(moments, inside, window)
    evidence = 0.5 * (plain - volume - window.checks) / correlated - (1.5 * length + 2.5) * price / correlated
    anything = 0.5 * (plain - volume) / correlated - (0.5 * channels * length + 1.0) * price / correlated
    if evidence < data.settings.accept or evidence <= anything:
        return None
    push = _described(moments, k, place, inside, float(evidence))
    return push if push.differs_from_zero(data.settings.interval) else None


def measured_push(push: Push, data: DiagnosisData, model: Fit) -> Push:
    """The same push in the same interval beside a model that was fitted to what `without_push` leaves of the recordings."""
    moments = _moments(data, model)
    if moments is None:
        return push
    for k, s in enumerate(moments.segments):
        inside = np.flatnonzero(np.isin(moments.times(k), push.times)) if s.motion == push.motion else np.zeros(0, int)
        if len(inside):
            window = slice(int(moments.edges[k] + inside[0]), int(moments.edges[k] + inside[-1] + 1))
            place = _Place.of(moments, k, push.effect)
            return _described(moments, k, place, window, push.evidence)
    return push


def without_push(data: DiagnosisData, push: Push, seed: int) -> DiagnosisData:
    """The recordings with no weight on the interval of a push, and their noise; the seed is that of the encoders' rounding."""
    start, end = push.values[:2]
    segments = tuple(
        replace(s, left_out=(start, end), covariance=np.zeros(0)) if s.motion == push.motion and not s.still else s
        for s in data.segments
    )
    return with_noise_of(replace(data, segments=segments), data.links, data.terms, seed)


@dataclass(frozen=True, eq=False)
class _Place:
    """Readings of a unit force on a link in one recording."""

    effect: Effect  # which link
    #: Readings of a force in base axes at the link's origin (K, c, 3), and what a metre along each axis of the link adds (K, 3,
    #: c, 3).
    at_origin: np.ndarray
    by_point: np.ndarray

    @classmethod
    def of(cls, moments: _Moments, k: int, effect: Effect) -> _Place:
        """A link in one of the recordings."""
        data, s, times = moments.data, moments.segments[k], moments.times(k)
        beside = active_terms(s, moments.fit.terms)
        always = (s.times[0] - 1.0, s.times[-1] + 1.0, 0.0, 0.0, 0.0)

        def readings(point: np.ndarray) -> np.ndarray:
            slopes = columns(data.robot, data.channels, s.trajectory, data.links, beside, effect, (*always, *point))[:, :, 2:5]
            flat = slopes.reshape(len(slopes), -1)
            at = np.stack([np.interp(times, s.trajectory.times, column) for column in flat.T], axis=1)
            return (at * moments.share(k)[:, None]).reshape(len(times), *slopes.shape[1:])

        origin = readings(np.zeros(3))
        return cls(effect, origin, np.stack([readings(axis) - origin for axis in np.eye(3)], axis=1))

    @property
    def seen(self) -> bool:
        """Whether the readings show such a force at all."""
        return bool(np.any(self.at_origin))


def less_push(experiment: Experiment, push: Push, terms: Sequence[Term] = ()) -> Experiment:
    """The experiment with readings of a wrench sensor, of which some effects are known, as they were without the push."""
    channels, read = make_channels(experiment, "wrench"), [t for t in terms if isinstance(t.effect, SensorEffect)]

    def less(table: Table) -> Table:
        times, still = table.times, np.zeros_like(table.positions)
        force = np.stack([np.interp(times, push.times, axis, 0.0, 0.0) for axis in push.force.T], axis=1)
        trajectory = MotionSegment(times, table.positions, still, still, False, np.inf)
        always = (times[0] - 1.0, times[-1] + 1.0, 0.0, 0.0, 0.0, *push.values[5:])
        unit = columns(experiment.robot, channels, trajectory, experiment.robot.nominal, read, push.effect, always)[:, :, 2:5]
        return table if table.wrench is None else replace(table, wrench=table.wrench - (unit @ force[:, :, None])[:, :, 0])

    motions = tuple(replace(m, table=less(m.table)) if m.name == push.motion else m for m in experiment.motions)
    return replace(experiment, motions=motions)


def _moments(data: DiagnosisData, fit: Fit) -> _Moments | None:
    """Residuals of a model in all moving recordings, fitted and unseen; None without any fitted one."""
    segments = tuple(s for s in (*data.segments, *data.unseen) if not (s.still or s.apart))
    if not any(s in data.segments for s in segments):
        return None
    root, names = fit.projector.root, list(dict.fromkeys(s.motion for s in segments))
    channels = len(data.channels)
    residuals, parts = [], []
    for s in segments:

        def courses(coefficients: np.ndarray, s: SpectralSegment = s) -> np.ndarray:
            """Moments of coefficients, in the readings' units."""
            return np.asarray(idct(coefficients, axis=0, norm="ortho")) * np.sqrt(len(coefficients) / len(s.times))

        residuals.append(courses(s.measured_readings - s.spectrum(data.predict(s, data.links, fit.terms))))
        offsets = np.zeros((len(residuals[-1]), channels, channels * len(names)))
        axes, at = np.arange(channels), channels * names.index(s.motion)
        offsets[:, axes, at + axes] = courses(s.measured_ones)
        mine = [courses(s.spectrum(data.link_columns(s, fit.terms))) @ root, offsets]
        for t in fit.terms:
            slopes = np.zeros((len(s.trajectory.times), channels, 0 if data.fixed(t) else len(t.values)))
            if active_terms(s, [t]) and not data.fixed(t):
                beside = tuple(x for x in active_terms(s, fit.terms) if x is not t)
                slopes = columns(data.robot, data.channels, s.trajectory, data.links, beside, t.effect, t.values)
            mine.append(courses(s.spectrum(slopes)))
        parts.append(np.concatenate(mine, axis=2))
    made = np.concatenate(parts)
    length = np.linalg.norm(made.reshape(-1, made.shape[2]), axis=0)
    prior = _FLAT * np.where(length > 0.0, length, 1.0) ** 2
    prior[: root.shape[1]] = 1.0
    edges = np.cumsum([0, *(len(r) for r in residuals)])
    return _Moments(data, fit, segments, edges, np.concatenate(residuals), made, prior)


def _scanned(moments: _Moments) -> tuple[int, slice] | None:
    """The fitted recording and window without which the rest of all recordings fits best for what the window costs.

    None where no window is worth as much as a push there costs if it leaves nothing.
    """
    scaled, best, possible = moments.scaled(moments.scales(slice(0))), None, False
    rows, total, channels = scaled.rows, scaled.total, moments.residual.shape[1]
    for k, s in enumerate(moments.segments):
        if s not in moments.data.segments:
            continue
        times, clear = moments.times(k), np.flatnonzero(moments.share(k) >= _FADED)
        step = times[1] - times[0]
        size = max(round(max(_BLOCK, (times[-1] - times[0]) / _MOST_BLOCKS) / step), 1)
        edges = np.arange(moments.edges[k] + clear[0], moments.edges[k] + clear[-1] + 1, size)
        blocks = [squared(rows[a:b]) for a, b in pairwise(edges)]
        summed = np.cumsum([np.zeros_like(total), *blocks], axis=0)
        longest = int(moments.data.settings.most * len(times) / size)
        for n in sorted({round(min(2 * _LONGER**x, longest)) for x in range(40) if longest >= 2}):
            at = np.arange(1, len(edges) - 1 - n, max(n // 16, 1))
            if not len(at):
                continue
            left = np.array([_left(total - (summed[a + n] - summed[a])) for a in at])
            outside = channels * (len(moments.residual) - n * size)
            gain = moments.rows * np.log(_left(total) / moments.rows * outside / left) + channels * n * size
            cost = channels * n * size * np.log(moments.rows) - gain
            possible |= bool(gain.max() > 3.0 * n * size * np.log(moments.rows))
            a = at[int(np.argmin(cost))]
            if best is None or cost.min() < best[0]:
                best = float(cost.min()), k, slice(int(edges[a]), int(edges[a + n]))
    return best[1:] if best is not None and possible else None


def _refined(moments: _Moments, k: int, scaled: _Scaled, place: _Place, inside: slice) -> slice:
    """The window with its ends moved to where it costs least, by a second and less at a time."""
    clear = moments.edges[k] + np.flatnonzero(moments.share(k) >= _FADED)
    first, last = int(clear[0]) + 1, int(clear[-1])
    longest = moments.data.settings.most * (moments.edges[k + 1] - moments.edges[k])
    best, move = _fitted(scaled, place, inside).cost, 16
    while move:
        moved = False
        for a, b in ((-move, 0), (move, 0), (0, -move), (0, move)):
            trial = slice(inside.start + a, inside.stop + b)
            length = trial.stop - trial.start
            if trial.start < first or trial.stop > last or not _STEPS < length <= longest:
                continue
            cost = _fitted(scaled, place, trial).cost
            if cost < best:
                best, inside, moved = cost, trial, True
        move = move if moved else move // 2
    return inside


def _fitted(scaled: _Scaled, place: _Place, inside: slice) -> _Window:
    """A push on a link in one window."""
    p = len(scaled.total) - 1
    near = scaled.rows[inside]
    far = scaled.total - squared(near)
    window = _stepped(scaled, place, inside, near, far, np.zeros(3), _solved(far[:p, :p], far[:p, p])[0])
    for _ in range(_STEPS):
        window = _stepped(scaled, place, inside, near, far, np.clip(window.point, -1.0, 1.0), window.coefficients)
    return window


def _stepped(
    scaled: _Scaled, place: _Place, inside: slice, near: np.ndarray, far: np.ndarray, point: np.ndarray, coefficients: np.ndarray
) -> _Window:
    """A Gauss-Newton step from a point and other coefficients, with the inner products outside the window (p + 1, p + 1)."""
    p, first = len(coefficients), scaled.first(inside)
    mine = slice(inside.start - first, inside.stop - first)
    arms = place.by_point[mine] / scaled.scale[:, None]
    unit = place.at_origin[mine] / scaled.scale[:, None] + np.einsum("j,kjcf->kcf", point, arms)
    inverse = np.linalg.inv(unit.transpose(0, 2, 1) @ unit + 1e-12 * np.eye(3))
    solve = inverse @ unit.transpose(0, 2, 1)  # (m, 3, c)
    force = np.einsum("kfc,kc->kf", solve, near[:, :, p] - near[:, :, :p] @ coefficients)
    moved = np.einsum("kjcf,kf->kcj", arms, force)
    # Columns, those of the point among them, and the target with the point's share put back, less what a force there explains.
    rows = np.concatenate([near[:, :, :p], moved, near[:, :, p:] + (moved @ point)[:, :, None]], axis=2)
    slopes = solve @ rows
    rows = rows - unit @ slopes
    square = squared(rows)
    others, own = [*range(p), -1], range(p, p + 3)
    square[np.ix_(others, others)] += far
    square[own, own] += _POINT_STD**-2.0
    solution, covariance = _solved(square[:-1, :-1], square[:-1, -1])
    checks = float(np.sum((rows[:, :, -1] - rows[:, :, :-1] @ solution) ** 2))
    cost = float(square[-1, -1] - square[:-1, -1] @ solution) + 3.0 * len(near) * np.log(scaled.count)
    return _Window(solution[:p], solution[p:], force, inverse, -slopes[:, :, :-1], cost, checks, covariance)


def _described(moments: _Moments, k: int, place: _Place, inside: slice, evidence: float) -> Push:
    """The push in a window with its course and standard deviations."""
    window, p = _fitted(moments.scaled(moments.scales(inside)), place, inside), len(moments.prior)
    correlated = _correlated(moments, inside, window)
    times = moments.times(k)[inside.start - int(moments.edges[k]) : inside.stop - int(moments.edges[k])]
    step, count = float(times[1] - times[0]), len(times)
    covariance = correlated * window.covariance
    scatter = np.einsum("kfi,ij,kgj->kfg", window.slopes, covariance, window.slopes)
    force_std = np.sqrt(np.diagonal(scatter + window.inverse, axis1=1, axis2=2))
    slope = window.slopes.mean(axis=0)
    mean_cov = slope @ covariance @ slope.T + correlated * window.inverse.sum(axis=0) / count**2
    std = [step, step, *np.sqrt(np.diag(mean_cov)), *np.sqrt(np.diag(covariance)[p:])]
    ends = (float(times[0] - 0.5 * step), float(times[-1] + 0.5 * step))
    values = (*ends, *window.force.mean(axis=0), *window.point)
    return Push(place.effect, values, moments.segments[k].motion, times, window.force, force_std, np.array(std), evidence)


def _correlated(moments: _Moments, inside: slice, window: _Window) -> float:
    """How many neighbouring moments count as one: one and twice the correlations outside a window, up to the first below zero."""
    left = moments.residual - moments.columns @ window.coefficients
    left[inside] = 0.0
    left /= _root_mean_square(left)
    parts = [left[a:b] for a, b in pairwise(moments.edges)]
    most = min(len(part) for part in parts) // 4
    power, total = float(np.sum(left**2)), 1.0
    for lag in range(1, most):
        share = sum(float(np.sum(part[lag:] * part[:-lag])) for part in parts) / power
        if share <= 0.0:
            break
        total += 2.0 * share
    return total


def _left(gram: np.ndarray) -> float:
    """Squared residual that all columns but the last leave of that, from their inner products."""
    return float(gram[-1, -1] - gram[:-1, -1] @ _solved(gram[:-1, :-1], gram[:-1, -1])[0])


def _solved(gram: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Solution (p,) of normal equations, and the inverse of their matrix (p, p)."""
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    inverse = np.linalg.inv(gram / np.outer(scale, scale) + _FLAT * np.eye(len(scale))) / np.outer(scale, scale)
    return inverse @ target, inverse


def _root_mean_square(rows: np.ndarray) -> np.ndarray:
    """Root mean square of each channel's residuals (c,), above zero."""
    return np.maximum(np.sqrt(np.mean(rows**2, axis=0)), 1e-12)
