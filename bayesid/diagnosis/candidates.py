"""Proposals: what each effect at each place would explain of what is left, from columns alone.

An effect enters here by columns that are linear in unknown amplitudes: its derivatives at zero, or, where its
equation has a shape, columns for a grid of shapes. What they explain of the residual, once links and effects already
found are projected out, is what the effect could gain at most; the best go on to exact fits, from the values found
here.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.special import chndtrinc

from bayesid.diagnosis.contacts import contact_terms
from bayesid.diagnosis.data import DiagnosisData, OneValue, residual_rows, term_rows
from bayesid.diagnosis.fit import Fit
from bayesid.diagnosis.grams import schwarz
from bayesid.diagnosis.projector import NuisanceProjector, Span, orthonormal
from bayesid.diagnosis.settings import Settings
from bayesid.diagnosis.spectra import SpectralSegment
from bayesid.effects import Effect, ExternalContact, Linearisation, Surroundings, Term
from bayesid.effects.surroundings import surroundings_of


class RippleScan:
    """Spectra of sines and cosines of the joints' positions, made once.

    The effects, one a joint, share `Effect.harmonics` and stand in the order of the joints whose torques are compared.
    """

    def __init__(self, data: DiagnosisData, effects: Sequence[Effect]):
        self.data, self.effects = data, tuple(effects)
        self.orders = np.array(effects[0].harmonics)
        channel_of = {joint: channel for channel, joint in data.segments[0].torque_channels}
        self.at = [(channel_of[e.joint], e.joint) for e in self.effects if e.joint is not None]
        self.spectra = [s.trajectory.basis.get(self._key(s), lambda s=s: self._waves(s)) for s in data.segments]

    def _key(self, segment: SpectralSegment) -> tuple:
        """What the coefficients of one segment depend on, whatever its noise."""
        joints, times = tuple(joint for _, joint in self.at), segment.times
        return "waves", tuple(self.orders), joints, len(segment.frequencies), len(times), times[0], times[-1], segment.settings

    def _waves(self, segment: SpectralSegment) -> np.ndarray:
        """Coefficients of the sines and cosines (K, joints, orders, 2)."""
        angle = segment.trajectory.positions[:, [j for _, j in self.at], None] * self.orders
        parts = [segment.course(np.cos(angle)), segment.course(np.sin(angle))]
        return np.stack(parts, axis=-1).astype(np.float32)

    @classmethod
    def of(cls, data: DiagnosisData, effects: Sequence[Effect]) -> tuple[RippleScan, ...]:
        """One scan for each class of effects."""
        kinds = dict.fromkeys(type(e) for e in effects)
        return tuple(cls(data, [e for e in effects if type(e) is kind]) for kind in kinds)

    def best(self, left: np.ndarray) -> Iterator[tuple[Effect, float]]:
        """Every effect with the number of periods whose sine and cosine explain most of a residual (rows,)."""
        score, gram = np.zeros(1), np.zeros(1)
        at = 0
        for s, spectrum in zip(self.data.segments, self.spectra, strict=True):
            count = s.shape[0] * s.shape[1]
            mine, at = left[at : at + count].reshape(s.shape), at + count
            pulled = np.einsum("kdc,kd->kc", s.whitener, mine)
            power = np.einsum("kdc,kdc->kc", s.whitener, s.whitener)
            own = [c for c, _ in self.at]
            score = score + np.einsum("kjpa,kj->jpa", spectrum, pulled[:, own], optimize=True)
            gram = gram + np.einsum("kjpa,kjpb,kj->jpab", spectrum, spectrum, power[:, own], optimize=True)
        # Of a joint that stands still, sine and cosine are two constants and tell no more than one: a share of their size keeps
        # the other, which is rounding, from counting.
        size = 1.0 + np.trace(gram, axis1=2, axis2=3)
        gram = gram + 1e-9 * size[..., None, None] * np.eye(2)
        gain = np.einsum("jpa,jpa->jp", score, np.linalg.solve(gram, score[..., None])[..., 0])
        for row, effect in enumerate(self.effects):
            yield effect, float(self.orders[int(np.argmax(gain[row]))])


#: Derivatives are exact to this share of the readings: 1e-16 over a step of 1e-4, and a hundred times that for a joint's play.
_DERIVATIVES = 1e-10
#: By effects: values that are tried (m), and what each changes of whitened rows, links projected out (rows, m).
_Trials = dict[Effect, tuple[tuple[tuple[float, ...], ...], np.ndarray]]


@dataclass(frozen=True, eq=False)
class Proposal:
    """An effect with the values at which an exact fit should start."""

    term: Term  # the effect and its values
    gain: float  # what it explains at most, in units of chi2
    parameters: int  # how many amplitudes that took
    #: By how many standard deviations of the noise a unit of each parameter alone changes the readings, beside all else; nan of a
    #: shape. Empty where the effect has no amplitude.
    lengths: tuple[float, ...] = ()
    others: tuple[Term, ...] = ()  # other values to start from
    #: Whether the gain is that of values tried as they are, a lower bound of what a fit gains; columns give an upper bound.
    tried: bool = False

    @property
    def name(self) -> str:
        """The effect's name and place, ``name@where``."""
        return self.term.effect.spec


@dataclass(frozen=True, eq=False)
class _Block:
    """Columns of one effect (with one shape), links projected out, and how amplitudes become values."""

    effect: Effect
    rows: np.ndarray
    about: Linearisation


@dataclass(frozen=True, eq=False)
class Library:
    """Every effect that could be there, as columns at the user's model, made once."""

    projector: NuisanceProjector  # what is projected out
    base: Fit  # the user's model
    around: Surroundings  # what effects may want to know of the recordings
    effects: tuple[Effect, ...]  # those effects, each at its place
    columns: np.ndarray  # of all of them side by side, links projected out (rows + size, k)
    blocks: tuple[_Block, ...] = ()  # the same by effect and shape
    ripples: tuple[RippleScan, ...] = ()  # sines and cosines of joint positions, for effects that are one

    def propose(self, fit: Fit) -> list[Proposal]:
        """Proposals beside the effects of a fit, best gain first; one for each effect and place."""
        projector = self.projector
        found = orthonormal(projector.columns(fit.jacobian))
        left = projector.project_out(np.concatenate([fit.residual, -projector.prior_residual(fit.coordinates)]))
        left = left - found @ (found.T @ left)
        taken, best = self._taken(fit), {}
        beside = _split(self.columns - found @ (found.T @ self.columns), [b.rows for b in self.blocks])
        for block, rows in zip(self.blocks, beside, strict=True):
            name = block.effect.spec
            if name in taken:
                continue
            amplitudes, gain, count = _explained(rows, left)
            counted = rows
            if first := self._before[block.effect]:
                others = Span.of(np.hstack([beside[k] for k in first]))
                counted = others.project_out(rows)
                _, gain, count = _explained(counted, others.project_out(left))
            if name not in best or gain - _cost(count) > best[name].gain - _cost(best[name].parameters):
                starts = [Term(block.effect, _inside(block.effect, v)) for v in np.atleast_2d(block.about.to_values(amplitudes))]
                best[name] = Proposal(starts[0], gain, count, _lengths(block, counted), tuple(starts[1:]))
        shaped = [([t], gain) for t, gain in self._ripples(fit, left, found)]
        contacts = contact_terms(projector, fit, left[: projector.length]) if ExternalContact in map(type, self.effects) else ()
        for terms, gain in [*shaped, *contacts]:
            if (name := terms[0].effect.spec) not in taken:
                best[name] = _better(best.get(name), terms, gain)
        for term, gain in self._tried(fit, taken, self._changes):
            own = best.get(name := term.effect.spec)
            better = _better(own, [term], gain)
            best[name] = better if better is own else replace(better, tried=True)
        return sorted(best.values(), key=_promise)

    @cached_property
    def _before(self) -> dict[Effect, list[int]]:
        """Blocks, by effect, whose effects leave it what it is counted for."""
        return {e: [k for k, b in enumerate(self.blocks) if e.comes_after(b.effect)] for e in {b.effect for b in self.blocks}}

    def with_last_resorts(self, proposals: Sequence[Proposal], fit: Fit) -> list[Proposal]:
        """Proposals beside a fit with effects whose values are tried as a last resort among them, best gain first.

        Such as flexible joints that resonate in the motion's band, of which a derivative says nothing; it takes a while.
        """
        best = {p.name: p for p in proposals}
        for term, gain in self._tried(fit, self._taken(fit), self._last_changes):
            own = best.get(name := term.effect.spec)
            if own is None or gain > own.gain:
                best[name] = _better(own, [term], gain)
            else:  # a derivative may promise more than a possible compliance keeps: a resonance is a start of its own
                best[name] = replace(own, others=(*own.others, term))
        return sorted(best.values(), key=_promise)

    def _taken(self, fit: Fit) -> set[str]:
        """Effects that are no proposals beside those of a fit."""
        present = {t.effect.name for t in fit.terms if t.effect.single}
        taken = {e.spec for name in present for e in self.projector.data.places(name)} | {t.effect.spec for t in fit.terms}
        for found in (t.effect for t in fit.terms[len(self.base.terms) :]):
            taken |= {e.spec for e in self.effects if e.excludes(found)}
        return taken

    def with_one_value(self, fit: Fit, least: float, wider: Sequence[Fit]) -> list[OneValue]:
        """Effects of several values with only one of them, where its column beside a fit explains so much of chi2 at least.

        And of those that are the last in ``wider`` fits, the value there that differs most from zero: a sensor turned by 20
        degrees is no column. Of a link that is another than the nominal one no single number changes.
        """
        fitted = {f.terms[-1].effect: f for f in wider}
        projector, best = self.projector, dict[str, tuple[float, OneValue]]()
        found, taken = orthonormal(projector.columns(fit.jacobian)), self._taken(fit)
        left = projector.project_out(np.concatenate([fit.residual, -projector.prior_residual(fit.coordinates)]))
        for block in self.blocks:
            effect = block.effect
            if block.rows.shape[1] < 2 or effect.changes_link or effect.may_be_another or effect.spec in taken:
                continue
            rows = block.rows - found @ (found.T @ block.rows)
            square = np.sum(rows**2, axis=0)
            amplitudes = rows.T @ left / np.where(square > 0.0, square, np.inf)
            tried = [(gain, k, amplitudes[k]) for k, gain in enumerate(amplitudes**2 * square)]
            if (own := fitted.get(effect)) is not None:
                values, std = np.array(own.terms[-1].values), own.std(len(own.terms) - 1, 1.0)
                k = int(np.argmax(np.abs(values) / std))
                tried = [(least, k, block.about.to_amplitudes(values)[k])]
            for gain, k, amplitude in tried:
                values = np.atleast_2d(block.about.to_values(np.where(np.arange(len(square)) == k, amplitude, 0.0)))[0]
                alone = np.count_nonzero(values) == 1 and values[k] != 0.0
                if alone and gain >= max(least, best.get(effect.spec, (0.0, None))[0]):
                    best[effect.spec] = gain, OneValue(effect, _inside(effect, values), k)
        return [term for _, term in best.values()]

    def dispersion(self, fit: Fit) -> float:
        """Mean square of what the fit and all columns together leave, at least 1.

        What no effect of the library explains, however combined, is noise beyond the one measured, or an unmodelled effect.
        """
        left, parameters = self.unexplained(fit)
        return max(float(left @ left) / max(self.projector.rows - parameters, 1), 1.0)

    def unexplained(self, fit: Fit) -> tuple[np.ndarray, int]:
        """Whitened rows less all that the fit and all columns together explain (rows,), and how many directions that takes."""
        projector = self.projector
        model = projector.columns(fit.jacobian)
        left = projector.project_out(np.concatenate([fit.residual, -projector.prior_residual(fit.coordinates)]))
        both = self._span.with_more(model, self._rounding)
        return both.project_out(left)[: projector.length], both.rank

    @cached_property
    def _span(self) -> Span:
        """What all columns together explain."""
        return Span.of(self.columns, rounding=self._rounding)

    @cached_property
    def _rounding(self) -> float:
        """How exact a derivative is, in whitened rows."""
        segments = self.projector.data.segments
        return _DERIVATIVES * float(np.sqrt(sum(np.sum(s.whiten(s.measured_readings) ** 2) for s in segments)))

    def _tried(self, fit: Fit, taken: set[str], changes_of: _Trials) -> Iterator[tuple[Term, float]]:
        """Effects with the best of the values that are tried exactly: no small amplitude stands for them."""
        projector = self.projector
        prior = -projector.prior_residual(fit.coordinates)
        left = projector.project_out(np.concatenate([fit.residual, prior]))
        now = np.sum(left**2)
        for effect, (trials, changes) in changes_of.items():
            if effect.spec in taken:
                continue
            # Beside other effects a change is about what it is beside the user's: the best is then tried exactly.
            with np.errstate(all="ignore"):  # a trial that diverges is none
                gains = -2.0 * left @ changes - np.sum(changes**2, axis=0)
            best = int(np.argmax(np.where(np.isfinite(gains), gains, -np.inf)))
            gain = self._gained(fit, Term(effect, trials[best]), prior, now) if gains[best] > 0.0 else 0.0
            if gain > 0.0:
                yield Term(effect, trials[best]), gain
            elif not effect.last_resort:
                yield Term(effect, trials[0]), 0.0

    def _gained(self, fit: Fit, term: Term, prior: np.ndarray, now: float) -> float:
        """What a term gains exactly, links and offset refitted, all else held."""
        data = self.projector.data
        rows = residual_rows(data, data.segments, fit.links, fit.offset, (*fit.terms, term))
        with np.errstate(all="ignore"):  # as above
            return float(now - np.sum(self.projector.project_out(np.concatenate([rows, prior])) ** 2))

    @cached_property
    def _changes(self) -> _Trials:
        return self._changes_by([e for e in self.effects if not e.last_resort])

    @cached_property
    def _last_changes(self) -> _Trials:
        return self._changes_by([e for e in self.effects if e.last_resort])

    def _changes_by(self, effects: Sequence[Effect]) -> _Trials:
        """Values, by effect, that are tried exactly, and what these change of the rows beside the user's model."""
        data, projector, base, out = self.projector.data, self.projector, self.base, {}
        nothing = np.zeros(projector.size)
        for effect in effects:
            trials = tuple(tuple(map(float, v)) for v in effect.trials(self.around)) if effect.sought(self.around) else ()
            if trials:
                moved = [
                    residual_rows(data, data.segments, base.links, base.offset, (*base.terms, Term(effect, v))) for v in trials
                ]
                with np.errstate(all="ignore"):  # as above
                    changes = [projector.project_out(np.concatenate([rows - base.residual, nothing])) for rows in moved]
                out[effect] = trials, np.stack(changes, axis=1)
        return out

    def _ripples(self, fit: Fit, left: np.ndarray, found: np.ndarray) -> Iterator[tuple[Term, float]]:
        data, projector = self.projector.data, self.projector
        for effect, order in (each for scan in self.ripples for each in scan.best(left[: projector.length])):
            rows = term_rows(data, data.segments, fit.links, fit.terms, Term(effect, effect.from_harmonic(order, 1.0, 0.0)))
            rows = projector.columns(rows[:, [0, -1]])  # sine and cosine
            amplitudes, gain, _ = _explained(rows - found @ (found.T @ rows), left)
            yield Term(effect, effect.from_harmonic(order, *map(float, amplitudes))), gain


def make_library(
    projector: NuisanceProjector, base: Fit, found: Fit | None = None, effects: Sequence[Effect] | None = None
) -> Library:
    """Columns of every effect that acts on the channels compared and is not in the user's model.

    Derivatives are taken at the user's model, or beside the effects of ``found``: beside a turned sensor, say, a wrong zero
    of the first joint is more than a turn of the sensor. Of ``effects`` alone, where they are given.
    """
    data, at = projector.data, found or base
    around = surroundings(data)
    effects = data.experiment.possible_effects(data.channels.names) if effects is None else tuple(effects)
    found_, rows = [], []
    for effect in effects:
        for about in effect.linearisations(around) if effect.sought(around) else ():
            beside = tuple(t for t in at.terms if t.effect != effect)
            own = term_rows(data, data.segments, at.links, beside, Term(effect, tuple(about.at)), again=True)
            if np.isfinite(own).all():  # a formula of the user's need not mean something everywhere
                found_.append((effect, about))
                rows.append(own)
    # All at once: the factor of links and offset is read twice, not twice for each of them.
    whole = projector.columns(np.hstack([np.zeros((projector.length, 0)), *rows]))
    blocks = [_Block(effect, own, about) for (effect, about), own in zip(found_, _split(whole, rows), strict=True)]
    ripples = RippleScan.of(data, [e for e in effects if e.harmonics])
    return Library(projector, base, around, effects, whole, tuple(blocks), ripples)


def _split(whole: np.ndarray, parts: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Columns (rows, k) as they stand, in parts as wide as others."""
    return np.split(whole, np.cumsum([part.shape[1] for part in parts])[:-1], axis=1) if parts else []


def column_terms(data: DiagnosisData) -> list[tuple[Term, Linearisation]]:
    """Every effect that may be sought beside the user's, where its columns are taken, and how amplitudes become values."""
    around, users = surroundings(data), {t.effect.spec for t in data.terms}
    return [
        (Term(effect, tuple(map(float, about.at))), about)
        for effect in data.experiment.possible_effects(data.channels.names)
        if effect.spec not in users and effect.sought(around)
        for about in effect.linearisations(around)
    ]


def surroundings(data: DiagnosisData) -> Surroundings:
    """What effects may want to know of the recordings."""
    sensor = data.experiment.sensor
    return surroundings_of(
        data.robot, [s.trajectory for s in data.segments], data.links, data.channel, sensor is not None and sensor.joint is None,
        static_run=data.offset_free, links_known=data.experiment.inertia_rel_std is not None,
    )  # fmt: skip


def _inside(effect: Effect, values: np.ndarray) -> tuple[float, ...]:
    """Values inside what is possible."""
    return tuple(float(v) for v in np.clip(values, effect.lower, effect.upper))


def _better(own: Proposal | None, terms: Sequence[Term], gain: float) -> Proposal:
    """A proposal, or another start of its effect if that gains more."""
    if own is not None and gain <= own.gain:
        return own
    return Proposal(terms[0], gain, len(terms[0].values), own.lengths if own else (), tuple(terms[1:]))


def least_visible(settings: Settings, parameters: int, rows: int, dispersion: float) -> float:
    """How far an effect of so many parameters has to change the readings to be named, in standard deviations of the noise.

    That is where it is named half of the time: its gain in chi2, in units of the dispersion, is noncentral chi-squared with as
    many degrees of freedom, and the median of that is what an effect has to bring and its parameters cost.
    """
    needed = 2.0 * (settings.accept + schwarz(parameters, rows) / dispersion)
    return float(np.sqrt(dispersion * chndtrinc(needed, parameters, 0.5)))


def _lengths(block: _Block, rows: np.ndarray) -> tuple[float, ...]:
    """Length of what a unit of each parameter alone changes, by the effect's columns (rows, k); nan of those that are a shape."""
    linear, about = np.array([p.linear for p in block.effect.quantities]), block.about
    units = np.eye(len(linear))[:, linear | ~linear.any()]
    amplitudes = [about.to_amplitudes(about.at + unit) - about.to_amplitudes(about.at) for unit in units.T]
    out = np.full(len(linear), np.nan)
    out[units.any(axis=1)] = np.linalg.norm(rows @ np.transpose(amplitudes), axis=0)
    return tuple(map(float, out))


def _promise(proposal: Proposal) -> float:
    """The order of proposals: what they gain less what that costs, best first."""
    return -(proposal.gain - _cost(proposal.parameters))


def _cost(parameters: int) -> float:
    """What that many parameters gain by chance and more; only for the order of proposals."""
    return 8.0 * parameters


def _explained(rows: np.ndarray, left: np.ndarray) -> tuple[np.ndarray, float, int]:
    """Amplitudes of columns, what they explain of the residual, and how many of them count."""
    length = np.linalg.norm(rows, axis=0)
    out = np.zeros(rows.shape[1])
    seen = length > 1e-7 * max(length.max(initial=0.0), 1e-300)
    if not seen.any():
        return out, 0.0, 1
    span = Span.of(rows[:, seen] / length[seen], least=1e-5)
    along = span.along(left)
    out[seen] = span.root @ along / length[seen]
    return out, float(along @ along), span.rank
