"""Proposals: what each effect at each place would explain of what is left, from columns alone.

An effect enters here by columns that are linear in unknown amplitudes: its derivatives at zero, or, where its
equation has a shape, columns for a grid of shapes. What they explain of the residual, once links and effects already
found are projected out, is what the effect could gain at most; the best go on to exact fits, from the values found
here.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from bayesid.diagnosis.contacts import contact_terms
from bayesid.diagnosis.data import DiagnosisData
from bayesid.diagnosis.fit import LINKS, Fit, NuisanceProjector, model_rows, residual_rows, term_rows
from bayesid.diagnosis.ripples import RippleScan
from bayesid.dynamics.channels import torque_channels
from bayesid.dynamics.kinematics import P, link_states
from bayesid.effects import KINDS, Effect, Scene, Term, readings

#: Speeds below which a Stribeck law may fall [rad/s or m/s].
STRIBECK_SPEEDS = np.geomspace(0.01, 0.6, 8)
#: Resonances of the mount [Hz] and their damping.
RESONANCES = np.geomspace(2.5, 60.0, 14)
DAMPING = 0.05
#: Mean square of whitened residuals above which something is left that no effect found explains.
UNEXPLAINED = 1.45
#: Resonances of a flexible joint [Hz], tried where columns leave something unexplained: above its resonance a link moves
#: against its motor, which no derivative at a stiff joint predicts.
JOINT_RESONANCES = np.geomspace(3.0, 30.0, 17)
#: Lengths of a tether that an exact fit starts from [m].
TETHER_LENGTHS = (0.8, 2.0)
#: Effects with a place and a shape to find: two of one kind together can imitate one that settled wrongly, so one is sought.
SINGLE = ("tether", "external_contact")
#: Standard deviations by which an effect stands out.
DETECTED = 5.0


@dataclass(frozen=True, eq=False)
class Proposal:
    """An effect with the values at which an exact fit should start.

    Attributes
    ----------
    term
        The effect and its values.
    gain
        What it explains at most, in units of chi2.
    parameters
        How many amplitudes that took.
    minimum
        Size of its first parameter that would stand out by five standard deviations; None where it has no amplitude.
    others
        Other values to start from.
    """

    term: Term
    gain: float
    parameters: int
    minimum: float | None = None
    others: tuple[Term, ...] = ()

    @property
    def name(self) -> str:
        """``name@where``."""
        return self.term.effect.spec


@dataclass(frozen=True, eq=False)
class _Block:
    """Columns of one effect (with one shape), links projected out, and how amplitudes become values."""

    effect: Effect
    rows: np.ndarray
    values: Callable[[np.ndarray], np.ndarray]


@dataclass(eq=False)
class Library:
    """Every effect that could be there, as columns at the user's model, made once.

    Attributes
    ----------
    projector
        What is projected out.
    base
        The user's model.
    blocks
        Columns by effect and shape.
    """

    projector: NuisanceProjector
    base: Fit
    blocks: list[_Block] = field(default_factory=list)
    ripples: RippleScan | None = None
    _basis: tuple[Fit, np.ndarray] | None = field(default=None, repr=False)

    def propose(self, fit: Fit, *, resonances: bool = False) -> list[Proposal]:
        """Proposals beside the effects of a fit, best gain first; one for each effect and place.

        With ``resonances`` flexible joints that resonate in the motion's band are among them; that takes a while.
        """
        projector, data = self.projector, self.projector.data
        found = orthonormal(
            projector.project_out(projector.with_prior_rows(model_rows(data, data.segments, fit.links, fit.terms)))
        )
        residual = np.concatenate([fit.residual, -projector.prior_residual(fit.coordinates)])
        left = projector.project_out(residual)
        left = left - found @ (found.T @ left)
        present = {t.effect.name for t in fit.terms} & set(SINGLE)
        taken = {e.spec for name in present for e in data.places(name)} | {t.effect.spec for t in fit.terms}
        best: dict[str, Proposal] = {}
        for block in self.blocks:
            name = block.effect.spec
            if name in taken:
                continue
            rows = block.rows - found @ (found.T @ block.rows)
            amplitudes, gain, count = _explained(rows, left)
            if name not in best or gain - _cost(count) > best[name].gain - _cost(best[name].parameters):
                length = float(np.linalg.norm(rows[:, 0]))
                minimum = DETECTED / length if length > 0 else None
                starts = [Term(block.effect, _inside(block.effect, v)) for v in np.atleast_2d(block.values(amplitudes))]
                best[name] = Proposal(starts[0], gain, count, minimum, tuple(starts[1:]))
        soft = self._soft_joints(fit) if resonances else ()
        shaped = [([t], gain) for t, gain in [*self._mounts(fit), *soft, *self._ripples(fit, left, found)]]
        for terms, gain in [*shaped, *contact_terms(projector, fit, left[: projector.length])]:
            name = terms[0].effect.spec
            if name not in taken and (name not in best or gain > best[name].gain):
                minimum = best[name].minimum if name in best else None
                best[name] = Proposal(terms[0], gain, len(terms[0].values), minimum, tuple(terms[1:]))
            elif name in best and terms[0].effect.kind.name == "joint_flexibility":
                # A derivative may promise more than a possible compliance keeps: a resonance is a start of its own.
                best[name] = replace(best[name], others=(*best[name].others, *terms))
        return sorted(best.values(), key=lambda p: -(p.gain - _cost(p.parameters)))

    def dispersion(self, fit: Fit) -> float:
        """Mean square of what the fit and all columns together leave, at least 1.

        What no effect of the library explains, however combined, is noise beyond the one measured, or an unmodelled effect.
        """
        left = self.unexplained(fit)
        return max(float(left @ left) / max(self.projector.rows - self.parameters(fit), 1), 1.0)

    def unexplained(self, fit: Fit) -> np.ndarray:
        """Whitened rows less all that the fit and all columns together explain (rows,)."""
        q, projector = self._everything(fit), self.projector
        left = projector.project_out(np.concatenate([fit.residual, -projector.prior_residual(fit.coordinates)]))
        return (left - q @ (q.T @ left))[: projector.length]

    def parameters(self, fit: Fit) -> int:
        """How many directions that takes."""
        return self._everything(fit).shape[1]

    def _everything(self, fit: Fit) -> np.ndarray:
        """An orthonormal basis of a fit's effects and all columns, links projected out."""
        if self._basis is None or self._basis[0] is not fit:
            projector = self.projector
            model = projector.project_out(
                projector.with_prior_rows(model_rows(projector.data, projector.data.segments, fit.links, fit.terms))
            )
            self._basis = (fit, orthonormal(np.hstack([model, *(b.rows for b in self.blocks)])))
        return self._basis[1]

    def _mounts(self, fit: Fit) -> Iterator[tuple[Term, float]]:
        """Resonances of the mount: no small amplitude, so each is tried as it is."""
        data, projector = self.projector.data, self.projector
        if data.channel == "torque" or data.experiment.sensor is None or data.experiment.sensor.joint is not None:
            return
        effect = data.places("base_compliance")[0]
        prior = -projector.prior_residual(fit.coordinates)
        now = np.sum(projector.project_out(np.concatenate([fit.residual, prior])) ** 2)
        best = (0.0, RESONANCES[0])
        for resonance in RESONANCES:
            term = Term(effect, (resonance, DAMPING))
            rows = residual_rows(data, data.segments, fit.links, fit.offset, (*fit.terms, term))
            gain = float(now - np.sum(projector.project_out(np.concatenate([rows, prior])) ** 2))
            best = max(best, (gain, resonance)) if np.isfinite(gain) else best
        yield Term(effect, (best[1], DAMPING)), best[0]

    def _soft_joints(self, fit: Fit) -> Iterator[tuple[Term, float]]:
        """Flexible joints with their resonance in or near the motion's band, each as it is."""
        if self.dispersion(fit) < UNEXPLAINED:
            return
        data, projector = self.projector.data, self.projector
        prior = -projector.prior_residual(fit.coordinates)
        now = np.sum(projector.project_out(np.concatenate([fit.residual, prior])) ** 2)
        for effect, inertia in zip(data.places("joint_flexibility"), _inertia(data), strict=True):
            if effect.spec in {t.effect.spec for t in fit.terms}:
                continue
            best = (0.0, 0.0)
            for compliance in 1.0 / (inertia * (2.0 * np.pi * JOINT_RESONANCES) ** 2):
                terms = (*fit.terms, Term(effect, (float(compliance),)))
                rows = residual_rows(data, data.segments, fit.links, fit.offset, terms)
                gain = float(now - np.sum(projector.project_out(np.concatenate([rows, prior])) ** 2))
                best = max(best, (gain, compliance)) if np.isfinite(gain) else best
            if best[0] > 0.0:
                yield Term(effect, (float(best[1]),)), best[0]

    def _ripples(self, fit: Fit, left: np.ndarray, found: np.ndarray) -> Iterator[tuple[Term, float]]:
        if self.ripples is None:
            return
        data, projector = self.projector.data, self.projector
        effects = data.places("torque_ripple")
        for joint, periods in self.ripples.best(left[: projector.length]):
            effect = effects[joint]
            rows = term_rows(data, data.segments, fit.links, fit.terms, Term(effect, (1.0, periods, 0.0)))
            rows = projector.project_out(projector.with_prior_rows(rows[:, [0, 2]]))  # sine and cosine
            amplitudes, gain, _ = _explained(rows - found @ (found.T @ rows), left)
            a, b = amplitudes
            yield Term(effect, (np.hypot(a, b), periods, np.arctan2(b, a))), gain


def make_library(projector: NuisanceProjector, base: Fit, found: Fit | None = None) -> Library:
    """Columns of every effect that acts on the case's channels and is not in the user's model.

    Derivatives are taken at the user's model, or beside the effects of ``found``: beside a turned sensor, say, a wrong zero
    of the first joint is more than a turn of the sensor.
    """
    data, at = projector.data, found or base
    library = Library(projector, base, ripples=RippleScan(data) if data.channel != "wrench" else None)
    for effect, values, to_values in _columns_wanted(data):
        beside = tuple(t for t in at.terms if t.effect != effect)
        rows = term_rows(data, data.segments, at.links, beside, Term(effect, tuple(values)))
        library.blocks.append(_Block(effect, projector.project_out(projector.with_prior_rows(rows)), to_values))
    return library


def _columns_wanted(data: DiagnosisData) -> Iterator[tuple[Effect, np.ndarray, Callable]]:
    """Effects with the values at which their derivatives are taken, and what amplitudes of those mean."""
    names = data.channels.names
    for kind in KINDS.values():
        if kind.name in ("base_compliance", "external_contact", "torque_ripple") or not any(kind.acts_on(c) for c in names):
            continue
        if kind.name == "sensor_offset" and data.offset_free:
            continue
        if kind.name in LINKS and (data.experiment.inertia_rel_std is None or kind.name == "payload"):
            continue  # a payload has the same columns; which it is, the fit decides
        if kind.name == "rotor_momentum" and data.channel != "both" and data.experiment.inertia_rel_std is None:
            continue
        zero = np.zeros(len(kind.parameters))
        for effect in data.places(kind.name):
            if kind.name == "tether":
                centre = _mean_place(data, effect.joint or 0)
                yield effect, np.array([1.0, 0, 0, 0, 0, 0, 0, 0]), lambda a, x=centre: _tethers(a, x, TETHER_LENGTHS)
            elif kind.name == "spring":
                yield effect, np.array([1.0, 0.0]), lambda a: np.array([a[0], a[1] / a[0] if a[0] else 0.0])
            elif kind.name == "stribeck_friction":
                for speed in STRIBECK_SPEEDS:
                    yield effect, np.array([1.0, speed]), lambda a, s=speed: np.array([a[0], s])
            else:
                yield effect, zero, lambda a: a


def _tethers(a: np.ndarray, centre: np.ndarray, lengths: Sequence[float]) -> np.ndarray:
    """Tethers of these lengths (lengths, 8) whose mean pull is that of ``k (anchor - x)``, from amplitudes at k = 1, anchor 0.

    A short motion shows the pull, hardly where it comes from; so the anchor is put at a likely distance from the link's
    mean place (3,), with a third of the length slack, and the exact fit moves it.
    """
    pull = a[2:5] - a[0] * centre
    size = max(float(np.linalg.norm(pull)), 1e-12)
    return np.array([[size / (0.7 * x), 0.3 * x, *(centre + pull / size * x), 0.0, 0.0, 0.0] for x in lengths])


def _mean_place(data: DiagnosisData, joint: int) -> np.ndarray:
    """Mean position of a link's frame over the fitted motions, in the base frame (3,)."""
    means = []
    for s in data.segments:
        states = link_states(data.robot, s.scene.positions, s.scene.velocities, s.scene.accelerations)
        means.append(states[:, joint, P : P + 3].mean(axis=0))
    return np.mean(means, axis=0)


def _inertia(data: DiagnosisData) -> np.ndarray:
    """Mean inertia that each joint feels over the first fitted motion (n,) [kg m^2 or kg]."""
    scene, n = data.segments[0].scene, data.robot.n
    poses = np.repeat(scene.positions[:: max(len(scene.positions) // 20, 1)], n, axis=0)
    rates = np.tile(np.eye(n), (len(poses) // n, 1))
    channels = torque_channels(data.robot)
    torque = [
        readings(data.robot, channels, Scene(np.arange(len(poses), dtype=float), poses, 0.0 * poses, a), data.links, ())
        for a in (rates, 0.0 * rates)
    ]
    return np.einsum("knn->n", (torque[0] - torque[1]).reshape(-1, n, n)) / (len(poses) // n)


def _inside(effect: Effect, values: np.ndarray) -> tuple[float, ...]:
    """Values inside what is possible."""
    return tuple(float(v) for v in np.clip(values, effect.kind.lower, effect.kind.upper))


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
    u, s, vt = np.linalg.svd(rows[:, seen] / length[seen], full_matrices=False)
    keep = s > 1e-5 * s[0]
    along = u.T[keep] @ left
    out[seen] = (vt[keep].T @ (along / s[keep])) / length[seen]
    return out, float(along @ along), int(keep.sum())


def orthonormal(rows: np.ndarray) -> np.ndarray:
    """An orthonormal basis of columns (rows, k)."""
    length = np.linalg.norm(rows, axis=0)
    rows = rows[:, length > 0] / length[length > 0]
    if not rows.shape[1]:
        return rows
    u, s, _ = np.linalg.svd(rows, full_matrices=False)
    return u[:, s > 1e-6 * s[0]]
