"""The motion that best tells rivals apart: the best of many within limits, then improved step by step.

Motions that are tried are periodic paths run through in different ways, each within the robot's limits, at rest at both ends. A
path is a Fourier series p(s) in a parameter s, and a pace says how s goes with time: at once, in steps of speed, forth and back,
with stops. So ``v = p' s'`` and ``a = p'' s'^2 + p' s''`` are exact, and speeds stay within the path's while ``|s'| <= 1``.

The closed form is checked by rivals that are fitted exactly to the recordings and to what one of them predicts of a planned
motion. It takes readings for linear in what is not known. A tether, say, whose ends and stiffness are free is not: on the new
motion another one may do that is far from the one that explained the old. So the readings that rival i predicts of the motion are
made, without noise, and rival j is fitted to old and new recordings together, from its estimate and from where a search for it
would start. By how much more chi2 than so far it then lacks is ``lambda'`` in place of ``lambda_ij``: the predictions are as far
apart as ``sqrt(lambda' / lambda_ij)`` of what the closed form says. Where it lacks less than so far, its fit so far was poor,
and its evidence counts for more.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayesid.design.excitation.limits import Limits
from bayesid.design.excitation.options import ExcitationOptions
from bayesid.design.excitation.plan import make_task
from bayesid.design.excitation.series import FourierSeries
from bayesid.design.tell.rivals import (
    Case,
    Contest,
    PredictedRows,
    Rival,
    columns,
    from_effects,
    from_search,
    parse_effects,
    predicted,
    supposed,
    unknown,
)
from bayesid.diagnosis.candidates import make_library
from bayesid.diagnosis.data import DiagnosisData, OneValue
from bayesid.diagnosis.encoders import pooled, with_noise
from bayesid.diagnosis.fit import Fit, advance, begin, fit
from bayesid.diagnosis.prepare import even_grid
from bayesid.diagnosis.projector import NuisanceProjector, make_projector
from bayesid.diagnosis.search import Search
from bayesid.diagnosis.spectra import SpectralSegment
from bayesid.effects import Effect, MotionSegment
from bayesid.simulation.trajectories import Trajectory

#: Points in time at which limits are checked, a second, and what is kept free for the times between.
_CHECKED, _GUARD = 50.0, 0.98
#: Factors on the speed of a motion that takes too much and on the size of one that comes too near, and how often they are tried.
_SLOWER, _SMALLER, _TRIALS = 0.8, 0.7, 8


@dataclass(frozen=True)
class Pace:
    """How the path's parameter goes with time: speeds from given times on, each reached within a ramp."""

    starts: tuple[float, ...]  # times at which a ramp to the next speed begins (k,) [s]
    speeds: tuple[float, ...]  # speeds reached (k,), the last zero; before the first, zero
    ramp: float  # time that a change of speed takes [s]
    label: str  # what it is called

    def at(self, times: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The parameter and its first two derivatives (N,) each; the third is continuous, too.

        A change of speed is ``6 x^5 - 15 x^4 + 10 x^3`` of the share x of its ramp.
        """
        steps = np.diff(np.concatenate([[0.0], self.speeds]))
        late = (times[:, None] - np.array(self.starts)) / self.ramp
        x = np.clip(late, 0.0, 1.0)
        s = self.ramp * (x**6 - 3.0 * x**5 + 2.5 * x**4 + np.maximum(late - 1.0, 0.0)) @ steps
        return s, (6.0 * x**5 - 15.0 * x**4 + 10.0 * x**3) @ steps, (30.0 * x**4 - 60.0 * x**3 + 30.0 * x**2) @ steps / self.ramp


def paces(duration: float) -> tuple[Pace, ...]:
    """Ways to run through a path in a time [s]."""
    ramp = min(1.0, duration / 12.0)
    end, third, half = duration - ramp, duration / 3.0, 0.5 * duration - 0.5 * ramp
    stops = np.arange(0.0, end - 2.0 * ramp, 4.0 * ramp)
    pulses = tuple(float(x) for t in stops for x in (t, t + 2.0 * ramp))
    return (
        Pace((0.0, end), (1.0, 0.0), ramp, "at one speed"),
        Pace((0.0, third, 2.0 * third, end), (0.25, 0.5, 1.0, 0.0), ramp, "at a quarter, half and full speed"),
        Pace((0.0, half, end), (1.0, -1.0, 0.0), ramp, "forth and back"),
        Pace(pulses, (1.0, 0.0) * len(stops), ramp, "with stops"),
    )


@dataclass(frozen=True, eq=False)
class Planned:
    """A motion that could be made."""

    path: FourierSeries  # in the pace's parameter
    pace: Pace  # how it is run through
    duration: float  # [s]

    @property
    def moves(self) -> np.ndarray:
        """Which joints move (n,)."""
        return np.any([self.path.sine, self.path.cosine], axis=(0, 1))

    @property
    def label(self) -> str:
        """What the motion is, in words."""
        who = "all joints" if self.moves.all() else ", ".join(f"joint {j + 1}" for j in np.flatnonzero(self.moves))
        return f"{who} {self.pace.label}"

    def at(self, times: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Positions, velocities and accelerations (N, n) each."""
        s, rate, change = (x[:, None] for x in self.pace.at(times))
        positions, first, second = self.path.at(s[:, 0])
        return positions, first * rate, second * rate**2 + first * change

    def trajectory(self, name: str, rate: float) -> Trajectory:
        """Sample the motion, so many times a second."""
        times = np.arange(int(round(self.duration * rate)) + 1) / rate
        return Trajectory(name, "identification", times, *self.at(times))


def within_limits(motion: Planned, limits: Limits, share: float = 1.0) -> Planned | None:
    """The motion made to keep the limits: smaller, slower, elsewhere; None where that does not help.

    ``share`` is that of the speed limits which is used.
    """
    times = np.linspace(0.0, motion.duration, int(_CHECKED * motion.duration) + 1)
    for _ in range(_TRIALS):
        path, (q, v, _) = motion.path, motion.at(times)
        q = q - path.centre
        span, peak = np.ptp(q, axis=0), np.abs(v).max(axis=0)
        room = np.minimum(
            _GUARD * 2.0 * limits.reach / np.maximum(span, 1e-9), _GUARD * share * limits.speed / np.maximum(peak, 1e-9)
        )
        scale = np.minimum(room, 1.0)
        least, most = limits.lower - scale * q.min(axis=0), limits.upper - scale * q.max(axis=0)
        edge = 0.5 * (1.0 - _GUARD) * np.minimum(scale * span, most - least)
        path = replace(path.scaled(scale), centre=np.clip(path.centre, least + edge, most - edge))
        motion = replace(motion, path=path)
        _, _, *forced = limits.ratios(motion.at(times))
        near = forced.pop() if limits.clearance is not None else np.zeros(1)
        if max(float(np.abs(r).max(initial=0.0)) for r in forced) > _GUARD:
            motion = replace(motion, path=replace(path, period=path.period / _SLOWER))
        elif float(near.max(initial=0.0)) > 1.0:
            motion = replace(motion, path=path.scaled(_SMALLER))
        else:
            return motion
    return None


def pool(limits: Limits, duration: float, count: int, seed: int) -> Iterator[Planned]:
    """About ``count`` motions of ``duration`` [s] within limits: random series of different speed and size, and single joints."""
    rng = np.random.default_rng(seed)
    n, range_ = len(limits.lower), 2.0 * limits.reach
    moving = np.isin(np.arange(n), limits.moving)
    ways = paces(duration)
    for k in range(count):
        harmonics = 5
        amplitudes = rng.normal(1.0, 0.4, (harmonics, n)) / np.arange(1, harmonics + 1)[:, None] * range_
        amplitudes = amplitudes * rng.uniform(0.1, 0.5, n) * moving
        if k % 4 == 3:  # one motion in four is of one joint alone
            amplitudes = amplitudes * (np.arange(n) == limits.moving[(k // 4) % len(limits.moving)])
        pace = ways[0] if k % 4 < 2 else ways[1 + (k // 4) % (len(ways) - 1)]
        frequency = float(np.exp(rng.uniform(np.log(1.0 / duration), np.log(0.5))))
        centre = np.where(moving, rng.uniform(limits.lower, limits.upper), limits.middle)
        phases = rng.uniform(0, 2 * np.pi, (harmonics, n))
        path = FourierSeries(1.0 / frequency, centre, amplitudes * np.cos(phases), amplitudes * np.sin(phases))
        motion = Planned(path, pace, duration)
        share = 1.0 if k % 2 == 0 else float(rng.uniform(0.2, 1.0))
        if (fitted := within_limits(motion, limits, share)) is not None:
            yield fitted


def prolonged(motion: Planned) -> Planned:
    """The same path at the same pace for twice as long."""
    duration = 2.0 * motion.duration
    pace = next(p for p in paces(duration) if p.label == motion.pace.label)
    return replace(motion, pace=pace, duration=duration)


def varied(motion: Planned, limits: Limits, size: float, rng: np.random.Generator) -> Planned | None:
    """A motion near another within limits, or None; ``size`` is the relative change of amplitudes and frequency."""
    path, shape = motion.path, motion.path.sine.shape
    larger = np.exp(size * rng.normal(size=shape)) * np.exp(size * rng.normal(size=shape[1]))
    # A sin(x + phase): of the complex amplitude, sine and cosine are the real and the imaginary part.
    terms = (path.sine + 1j * path.cosine) * larger * np.exp(1j * size * rng.normal(size=shape))
    centre = path.centre + 0.6 * size * limits.reach * rng.normal(size=shape[1]) * motion.moves
    period = path.period / float(np.exp(0.5 * size * rng.normal()))
    return within_limits(replace(motion, path=FourierSeries(period, centre, terms.real, terms.imag)), limits)


#: What a planned motion is called.
NAME = "next"
#: Rivals less probable than this are not tried as the true one.
_PROBABLE = 0.05
#: Steps of each start, how many starts go on, and steps of those.
_RACE, _KEPT, _STEPS = 3, 2, 9


@dataclass(frozen=True, eq=False)
class SeenInstruments:
    """Instruments as the recordings show them."""

    data: DiagnosisData  # the recordings
    like: SpectralSegment  # a moving segment of them: rates, bandwidth and noise are taken from it
    noise: np.ndarray  # covariance of a sample by frequency, sensors' and what the encoders' errors do to predictions (K, c, c)

    @classmethod
    def of(cls, fitted: Fit) -> SeenInstruments:
        """The instruments of the recordings that a model was fitted to."""
        data = fitted.projector.data
        like = max((s for s in data.segments if not s.still), key=lambda s: len(s.times))
        # The share that grows with the readings themselves is made anew for another motion.
        signal = like.spectrum(data.predict(like, fitted.links, fitted.terms)) ** 2
        power = pooled(signal[:, :, None], data.settings.neighbours // 2)[:, :, 0]
        noise = like.covariance.copy()
        at = np.arange(noise.shape[1])
        noise[:, at, at] = np.maximum(noise[:, at, at] - data.settings.accuracy**2 * power, 0.01 * noise[:, at, at])
        weight = like.weight(like.times)
        share = weight.T @ weight / len(weight)
        return cls(data, like, noise / np.where(share > 0, share, 1.0))

    @property
    def rate(self) -> float:
        """Samples a second, as recorded so far."""
        return 1.0 / self.like.step

    def segment(self, motion: Planned, fitted: Fit) -> SpectralSegment:
        """A motion as it would be recorded, without readings; with the noise that a model makes of it."""
        data, like, old = self.data, self.like, self.like.trajectory
        times = np.arange(int(round(motion.duration / like.step)) + 1) * like.step
        per_second = (len(old.times) - 1) / (old.times[-1] - old.times[0])
        grid = times if like.instant else even_grid(times, per_second)
        trajectory = MotionSegment(grid, *motion.at(grid), False, old.bandwidth, old.middle_positions, old.clear, old.cell)
        empty = np.zeros((len(times), len(data.channels)))
        bare = SpectralSegment(
            NAME, "identification", times, motion.at(times)[0], empty, trajectory, False, like.torque_channels, np.zeros(0),
            like.instant, like.settings,
        )  # fmt: skip
        nearest = np.abs(bare.frequencies[:, None] - like.frequencies).argmin(axis=1)
        none, rng = np.zeros(data.robot.n), np.random.default_rng(0)  # encoders' errors are in the noise already
        return with_noise(
            bare, lambda s: data.predict(s, fitted.links, fitted.terms), lambda s, _: s, self.noise[nearest], none, none, rng
        )


def contest(case: Case, bench: SeenInstruments, motion: Planned) -> Contest:
    """What a motion would do to the evidence between the rivals of a case."""
    return contest_on(case, [bench.segment(motion, case.rivals[0].fit)])


def contest_on(case: Case, segments: Sequence[SpectralSegment]) -> Contest:
    """What segments with known noise, whatever they read, do to the evidence between the rivals of a case."""
    first = case.rivals[0].fit
    data = first.projector.data
    scale = 1.0 / np.sqrt(case.rivals[0].dispersion)
    derivatives, predicted = [], []
    for rival in case.rivals:
        f = rival.fit
        derivatives.append(scale * columns(f, segments))
        with np.errstate(all="ignore"):
            exact = [s.spectrum(data.predict(s, f.links, f.terms)) + s.measured_ones * f.offset for s in segments]
        predicted.append(scale * np.concatenate([s.whiten(e).ravel() for s, e in zip(segments, exact, strict=True)]))
    rows = PredictedRows.of(derivatives, predicted, sum(s.count for s in segments))
    size = (len(case.rivals),) * 2
    return Contest(case.rivals, rows, data.settings.rival, np.ones(size), np.zeros(size))


def checked(contest: Contest, case: Case, bench: SeenInstruments, motion: Planned) -> Contest:
    """A contest, the closed form for the motion, with the distances between predictions that exact fits leave."""
    first = case.rivals[0].fit
    data, segment = first.projector.data, bench.segment(motion, first)
    projector = make_projector(replace(data, segments=(*data.segments, segment)), first.terms)
    shares, lost = contest.shares.copy(), contest.lost.copy()
    for i in np.flatnonzero(case.weights >= _PROBABLE):
        true = case.rivals[i]
        read = predicted(data, segment, true.fit.links, true.fit.offset, true.fit.terms)
        there = replace(projector, data=replace(data, segments=(*data.segments, read)))
        for j, other in enumerate(case.rivals):
            if i != j:
                more = (_imitated(there, true, other) - other.fit.chi2) / other.dispersion
                shares[i, j] = np.sqrt(np.clip(more / max(contest.noncentrality[i, j], 1e-12), 0.0, 1.0))
                lost[i, j] = 0.5 * max(-more, 0.0)
    return replace(contest, shares=shares, lost=lost)


def _imitated(projector: NuisanceProjector, true: Rival, other: Rival) -> float:
    """The smallest chi2 that a rival reaches where another one is true."""
    effects = {t.effect for t in true.fit.terms}
    apart = [t for t in other.fit.terms if t.effect not in effects]
    races = [advance(begin(projector, other.fit.terms, other.fit), _RACE)]
    if len(apart) == 1 and apart[0].effect.shape and not isinstance(apart[0], OneValue):
        held = tuple(t for t in other.fit.terms if t.effect in effects)
        without = fit(projector, held, other.fit, _RACE)
        library = make_library(projector, without, effects=[apart[0].effect])
        starts = [start for p in library.propose(without) for start in (p.term, *p.others)]
        races += [advance(begin(projector, (*held, start), without), _RACE) for start in starts]
    best = sorted((r for r in races if np.isfinite(r.chi2)), key=lambda r: r.chi2)[:_KEPT]
    return min((advance(r, _STEPS).chi2 for r in best), default=np.inf)


#: Below this probability no motion is said to decide.
HOPELESS = 0.05
#: Motions tried at random, improvements of the best, and motions checked by exact fits: for a diagnosis, which waits for them,
#: and for a design.
QUICK, THOROUGH = (24, 12, 1), (80, 60, 3)
#: Lengths of motions [s] that are proposed: that of the longest recording, within these.
_SHORTEST, _LONGEST = 16.0, 20.0
#: From this merit on every pair is told apart but for one time in a million, and nothing is left to improve.
_CERTAIN = -1e-6
#: A motion that decides with this probability by exact fits is taken, and no other one checked.
_ENOUGH = 0.95
#: Change of the first improvement, of the last, in relative size.
_FIRST, _LAST = 0.4, 0.05


@dataclass(frozen=True)
class RivalPair:
    """How likely a motion tells one rival from another."""

    #: Their names; the first is the true one.
    true: str
    other: str
    noncentrality: float  # what the best fit of the other leaves of the motion, in squared standard deviations
    #: Log evidence of the true one over the other afterwards: expected, and its standard deviation.
    log_bayes_factor: float
    log_bayes_factor_std: float
    probability: float  # that the other is ruled out


@dataclass(frozen=True, eq=False)
class Telling:
    """A motion to tell rivals apart."""

    rivals: tuple[str, ...]  # their names, the most probable first
    weights: tuple[float, ...]  # probability of each to be true before the motion; equal where the recordings show none of them
    #: Whether the recordings show the rivals, so that their sizes are estimates; otherwise usual sizes are supposed.
    estimated: bool
    trajectory: Trajectory  # the motion
    label: str  # what it is, in words
    probability: float  # that the true one alone is left after it
    wrong: float  # that a wrong one is
    pairs: tuple[RivalPair, ...]  # each rival as the true one against each other
    tried: int  # how many motions were looked at
    notes: tuple[str, ...]  # what was assumed of the limits

    @property
    def hopeless(self) -> tuple[RivalPair, ...]:
        """Pairs that not even this motion tells apart."""
        return tuple(p for p in self.pairs if p.probability < HOPELESS)


def tell_search(
    search: Search, *, effort: tuple[int, int, int] = QUICK, options: ExcitationOptions | None = None, seed: int = 0
) -> Telling | None:
    """The motion that settles an ambiguous diagnosis.

    None where nothing is ambiguous, no motion is within the limits, or all recordings are poses, which say nothing of the noise
    of a motion. ``effort`` is motions tried at random, improvements of the best, and motions checked by exact fits at most.
    ``options`` are limits, joints and length of the motion, as for `excite`; default those of `excite`, and as long as the
    longest recording, at least 16 s and at most 20 s, or twice that where it would not decide.
    """
    case = from_search(search)
    if case is None or all(segment.still for segment in case.rivals[0].fit.projector.data.segments):
        return None
    return tell((case,), effort=effort, options=options, seed=seed)


def tell_effects(
    data: DiagnosisData,
    specs: Sequence[str],
    *,
    recorded: bool = True,
    effort: tuple[int, int, int] = THOROUGH,
    options: ExcitationOptions | None = None,
    seed: int = 0,
) -> Telling | None:
    """The motion that best tells effects apart, given by ``name@where``, or ``name`` where there is one place.

    Unless the recordings so far count as ``recorded``, only their noise does; the rest is as in `tell_search`. An `InputError`
    as of `bayesid.design.tell.rivals.parse_effects`.
    """
    effects = parse_effects(data, specs)
    if not recorded:
        return tell(unrecorded(data, effects), effort=(*effort[:2], 0), options=options, seed=seed)
    return tell(from_effects(data, effects), effort=effort, options=options, seed=seed)


def unrecorded(data: DiagnosisData, effects: Sequence[Effect]) -> list[Case]:
    """A case for each effect at its usual size, of which no recording tells anything yet."""
    return [replace(c, rivals=tuple(map(unknown, c.rivals))) for c in supposed(data, effects)]


def tell(
    cases: Sequence[Case], *, effort: tuple[int, int, int], options: ExcitationOptions | None = None, seed: int = 0
) -> Telling | None:
    """The motion with the largest `Contest.merit`: of a pool, then of ever smaller changes of the best.

    Exact fits check it (`bayesid.design.tell.choose`). Where it then does not decide nearly surely, the same motion for twice as
    long is checked, unless a length was asked for, and the next best of the pool are. Cases count alike; the rest is as in
    `tell_search`.
    """
    benches = [SeenInstruments.of(case.rivals[0].fit) for case in cases]
    recorded = float(benches[0].like.times[-1] - benches[0].like.times[0])
    asked = options or ExcitationOptions(duration=float(np.clip(recorded, _SHORTEST, _LONGEST)))
    task, notes = make_task(benches[0].data.experiment, asked, seed)
    limits = task.limits

    def contests(motion: Planned) -> list[Contest]:
        return [contest(case, bench, motion) for case, bench in zip(cases, benches, strict=True)]

    def merit(motion: Planned) -> float:
        return float(sum(c.merit(case.weights) for c, case in zip(contests(motion), cases, strict=True)))

    tried, improvements, most = effort
    scored = sorted(((merit(m), m) for m in pool(limits, asked.duration, tried, seed)), key=lambda x: -x[0])
    if not scored:
        return None
    count, best = improved(scored[0], merit, limits, improvements, seed)

    def telling(motion: Planned, found: Sequence[Contest]) -> Telling:
        weights = np.mean([case.weights for case in cases], axis=0)
        right, wrong = np.mean([c.decided(case.weights, seed) for c, case in zip(found, cases, strict=True)], axis=0)
        return Telling(
            tuple(r.name for r in cases[0].rivals), tuple(map(float, weights)), len(cases) == 1,
            motion.trajectory(NAME, benches[0].rate), motion.label, float(right), float(wrong), _pairs(cases, found, seed),
            len(scored) + count, notes,
        )  # fmt: skip

    chosen = telling(best[1], contests(best[1]))
    motions = [motion for _, motion in [best, *scored][:most]]
    if options is None and most and (longer := within_limits(prolonged(best[1]), limits)) is not None:
        motions.insert(1, longer)
    for k, motion in enumerate(motions):
        exact = [checked(c, case, b, motion) for c, case, b in zip(contests(motion), cases, benches, strict=True)]
        found = telling(motion, exact)
        chosen = found if k == 0 or found.probability > chosen.probability else chosen
        if chosen.probability > _ENOUGH:
            break
    return chosen


def improved(
    start: tuple[float, Planned], merit: Callable[[Planned], float], limits: Limits, steps: int, seed: int
) -> tuple[int, tuple[float, Planned]]:
    """A motion changed at random again and again, by less and less; each change that is for the better stays.

    Returns how many were looked at, and the merit and the motion in the end.
    """
    rng = np.random.default_rng([seed, 1])
    best, count = start, 0
    for size in np.geomspace(_FIRST, _LAST, steps):
        if best[0] > _CERTAIN:
            break
        changed = varied(best[1], limits, float(size), rng)
        if changed is None:
            continue
        count += 1
        value = merit(changed)
        if value > best[0]:
            best = (value, changed)
    return count, best


def _pairs(cases: Sequence[Case], contests: Sequence[Contest], seed: int) -> tuple[RivalPair, ...]:
    """Each rival that may be true against each other."""
    out = []
    for c, case in zip(contests, cases, strict=True):
        mean, std = c.moments
        for i in map(int, np.flatnonzero(case.weights > 0)):
            chances = c.chances(i, seed)
            for j in range(len(c.rivals)):
                if i != j:
                    figures = (float(x) for x in (c.noncentrality[i, j], mean[i, j], std[i, j], chances[j]))
                    out.append(RivalPair(c.rivals[i].name, c.rivals[j].name, *figures))
    return tuple(out)
