"""What the reference recording says: links, friction and other effects, with the covariance that they are known to.

What the reference's model lacks is in both recordings: it is no change.

Friction near zero speed, say, which a model does not have, is there before and after. So what is asked of an effect is not
whether the later recording shows it but whether it shows another amplitude than the reference. With weighted rows ``X`` of
the reference's model and ``Z`` of the effect, an amplitude a moves its estimate by ``-S a``, ``S = (X'WX)^-1 X'WZ``, and with
``Z_ = Z - X S`` its own estimate and covariance there are

    a = (Z_'WZ_)^-1 Z_'W y,    V = (Z_'WZ_)^-1 Z_' W Sigma W Z_ (Z_'WZ_)^-1

times the reference's dispersion: the same sandwich as that of links and friction.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bayesid.arguments import argument
from bayesid.diagnosis.changes.proposals import ChangeProposal, make_proposals, with_proposals
from bayesid.diagnosis.changes.scales import SIZES, wander
from bayesid.dynamics.base_parameters import nearest_links
from bayesid.effects import Effect, Point, middle_of
from bayesid.effects.bodies import body_of
from bayesid.errors import InputError
from bayesid.estimators.covariance import Middle, covariance_middle
from bayesid.estimators.factor import Factor
from bayesid.estimators.least_squares import weighted_factor
from bayesid.estimators.nonlinear import solve
from bayesid.estimators.weights import learn_weights
from bayesid.recordings.experiment import Experiment
from bayesid.regression.linalg import or_one, pseudo_inverse
from bayesid.regression.options import FitOptions
from bayesid.regression.problem import Problem, absorbed_offset, prepare
from bayesid.regression.rows import make_blocks
from bayesid.robot.prior import Prior, states_masses, typical_links, with_sizes
from bayesid.robot.robot import Robot

#: Share of a column that must be left beside the model's own for its amplitude in the reference to be asked for.
_SEEN = 1e-4
#: Squared effect of a typical amplitude on all rows, in units of their noise, below which it is none; and share of the largest.
_FAINT, _SINGULAR = 1e-4, 1e-9


@dataclass(frozen=True, eq=False)
class LearnedParameters:
    """What weighted rows leave of a prior: independent parameters x with expected values m and standard deviations.

    With ``A = X'WX``, the dispersion k and the prior's covariance D that is ``m + B X'W (y - X m)``, ``B = (A + k D^-1)^-1``. Its
    error is what noise makes, of covariance ``B M B`` with the middle M of the sandwich, less ``k B D^-1 (x - m)``.
    """

    mean: np.ndarray  # of the parameters (p,)
    covariance: np.ndarray  # theirs (p, p)
    bread: np.ndarray  # B (p, p)

    @classmethod
    def of(cls, factor: Factor, middle: Middle, mean: np.ndarray, sizes: np.ndarray) -> LearnedParameters:
        """By the factor of weighted rows, the sandwich's middle, and the prior's mean and standard deviations (p,)."""
        left, s, axes = np.linalg.svd(factor.matrix * sizes)  # in sizes, where the prior is the same along all axes
        k, axes = middle.dispersion, sizes[:, None] * axes.T
        target = factor.target - factor.matrix @ mean
        bread = (axes / (k + s**2)) @ axes.T
        free = axes * (k / (k + s**2))
        noise = k * factor.matrix.T @ factor.matrix if middle.matrix is None else middle.matrix
        return cls(mean + axes @ (s / (k + s**2) * (left.T @ target)), bread @ noise @ bread + free @ free.T, bread)


@dataclass(frozen=True, eq=False)
class ReferenceAmplitudes:
    """What the reference says of effects that its model does not have."""

    carried: np.ndarray  # S, how its estimate moves with each column's amplitude, and what is usual holds it (p, z)
    #: ``Z_'WZ_`` and ``Z_'W Sigma W Z_`` (z, z).
    gram: np.ndarray
    middle: np.ndarray
    target: np.ndarray  # ``Z_'W y`` (z,)

    @classmethod
    def of(
        cls, problem: Problem, point: Point, fit: LearnedParameters, proposals: tuple[ChangeProposal, ...]
    ) -> ReferenceAmplitudes:
        """Ask the reference, by its fit, about proposed effects."""
        weights = learn_weights(problem.regression)
        model = with_proposals(problem.row_model, point, proposals)
        p = len(fit.mean)
        gram, middle = np.zeros((2, model.base.rank + model.extra_columns + 1, model.base.rank + model.extra_columns + 1))
        for block in make_blocks(model, problem.fitted_segments):
            noise = weights.noise[block.group]
            rows = block.rows.copy()
            rows[:, :, -1] -= rows[:, :, :p] @ fit.mean
            white = (rows / noise.std[:, None]).reshape(-1, rows.shape[2])
            coloured = noise.colour_transposed(rows / noise.std[:, None] ** 2).reshape(-1, rows.shape[2])
            gram += white.T @ white
            middle += weights.dispersion * coloured.T @ coloured
        length = or_one(np.sqrt(np.diag(gram)[:p]))
        inverse = pseudo_inverse(gram[:p, :p] / np.outer(length, length), 1e-12) / np.outer(length, length)
        away = np.vstack([-inverse @ gram[:p, p:-1], np.eye(gram.shape[1] - p - 1)])
        inner = away.T @ gram[:-1, :-1] @ away
        faint = np.diag(inner) < _SEEN**2 * np.diag(gram)[p:-1]
        inner[faint] = inner[:, faint] = 0.0
        target = away.T @ gram[:-1, -1]
        return cls(fit.bread @ gram[:p, p:-1], inner, away.T @ middle[:-1, :-1] @ away, np.where(faint, 0.0, target))

    def amplitudes(self, columns: np.ndarray, sizes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Amplitudes of the proposals' columns (k,) in the reference, mean (k,) and a root of their covariance (k, k).

        Where the reference says nothing, ``sizes`` (k,) are their prior standard deviations.
        """
        own, scale = np.ix_(columns, columns), np.outer(sizes, sizes)
        # In sizes, and along axes of which the reference says more than nothing; the others stay as they are beforehand.
        information, axes = np.linalg.eigh(self.gram[own] * scale)
        keep = information > max(_FAINT, _SINGULAR * information.max(initial=0.0))
        inverse = axes[:, keep] / information[keep]
        covariance = inverse.T @ (self.middle[own] * scale) @ inverse
        estimate = inverse.T @ (self.target[columns] * sizes)
        # A prior of unit variance: V (V + 1)^-1 is the posterior covariance, (V + 1)^-1 what stays of the estimate.
        posterior = np.linalg.solve(covariance + np.eye(len(covariance)), covariance)
        values, vectors = np.linalg.eigh(0.5 * (posterior + posterior.T))
        seen = axes[:, keep] @ vectors * np.sqrt(np.clip(values, 0.0, 1.0))
        mean = axes[:, keep] @ (estimate - posterior.T @ estimate)
        return sizes * mean, sizes[:, None] * np.hstack([axes[:, ~keep], seen])


#: What every drive has, friction and a rotor, fitted along whether the model states it or not.
_DRIVES = ("viscous_friction", "coulomb_friction", "torque_offset", "rotor_inertia")


@dataclass(frozen=True)
class Reference:
    """A robot in its known state."""

    problem: Problem  # the fit to the reference recording
    own: frozenset[str] = frozenset()  # names of the effects that the user's model has

    @property
    def robot(self) -> Robot:
        """The robot, with typical bodies where the URDF states no masses."""
        return self.problem.experiment.robot

    @property
    def effects(self) -> tuple[Effect, ...]:
        """The effects of the model, friction and the rotor of every joint included."""
        return self.problem.row_model.effects

    def hands_on(self, effect: Effect) -> bool:
        """Whether a model of the later recording has this effect.

        Of rotors that the user's model does not have, most are told from links in no recording: these hold them as before.
        """
        return effect.name in self.own or not all(p.lasting for p in effect.quantities)

    @property
    def solution(self) -> np.ndarray:
        """Base parameters, then effect parameters (p,), of usual sizes along what the recording hardly shows.

        There, such as of a joint that creeps, a fit by least squares has any values, and predicts any torques of a later motion.
        """
        return self._posterior.mean

    @cached_property
    def left(self) -> np.ndarray:
        """What its fit leaves of each channel (c,), in units of `LaterRecording.scale`."""
        regression = self.problem.regression
        blocks = [block.matrix @ self.solution - block.target for block in regression.rows.blocks()]
        power = np.sum(np.concatenate(blocks) ** 2, axis=0)
        count = sum(len(b) for b in blocks) - len(self.solution) / len(power)
        left = np.sqrt(power / max(count, 1.0))
        return np.maximum(left, 1e-9 * left.max(initial=1e-200))

    @cached_property
    def point(self) -> Point:
        """Links and effects of the reference, where readings of the later recording are linearised."""
        model = self.problem.row_model
        rank = model.base.rank
        links = nearest_links(self.robot, model.base, self.solution[:rank])  # hidden ones as well: their sums are known
        values = model.every_value(self.solution[rank:])
        # A fit that has not settled may have left where an equation holds; one that is linear holds everywhere.
        for k, p in enumerate(p for e in model.effects for p in e.quantities):
            values[k] = values[k] if p.linear else np.clip(values[k], p.lower, p.upper)
        if model.point is not None:
            middle = model.point.middle
        else:
            middle = next((middle_of(s.positions) for ss in self.problem.segments.values() for s in ss if not s.poses), None)
        return Point(links.reshape(-1, 10), self.solution[:rank], values, model.free, absorbed_offset(model.base, links), middle)

    @cached_property
    def proposals(self) -> tuple[ChangeProposal, ...]:
        """Effects that the model does not have."""
        return make_proposals(self.problem, self.point.links.ravel())

    @cached_property
    def lacking(self) -> ReferenceAmplitudes:
        """What the reference says of effects that its model does not have."""
        return ReferenceAmplitudes.of(self.problem, self.point, self._posterior, self.proposals)

    @property
    def covariance(self) -> np.ndarray:
        """Covariance of `solution` (p, p), dispersion included; as vague as bodies and effects are where it says nothing."""
        return self._posterior.covariance

    @cached_property
    def _posterior(self) -> LearnedParameters:
        """What the fit leaves of a prior as wide as changes are: three typical sizes, about nominal links without friction.

        Inertias hold rotors, too, of which a URDF says nothing.
        """
        model, places = self.problem.row_model, self.problem.experiment.library.places
        links = Prior.nominal(with_sizes(self.robot.nominal), max(SIZES))
        spread = links.covariance.copy()
        for rotor in places("rotor_inertia", self.robot.joint_names, model.channels.names):
            body = 10 * body_of(self.robot, rotor.joint)
            for k in (4, 6, 9):  # Ixx, Iyy, Izz
                spread[body + k, body + k] += (max(SIZES) * rotor.typical(self.robot)[0]) ** 2
        sizes = np.sqrt(np.einsum("ij,jk,ik->i", model.base.matrix, spread, model.base.matrix))
        effects = np.array([x for e in model.effects for x in zip(e.starts, e.typical(self.robot), strict=True)]).reshape(-1, 2)
        starts, typical = effects[model.free].T
        regression = self.problem.regression
        weights = learn_weights(regression)
        factor, scale = weighted_factor(regression, weights, "channel")
        middle = covariance_middle(regression, weights, scale, factor)
        mean = np.concatenate([model.base.matrix @ links.mean, starts])
        return LearnedParameters.of(factor, middle, mean, or_one(np.concatenate([sizes, max(SIZES) * np.abs(typical)]), 0.0))

    def wanders(self, friction: bool) -> np.ndarray:
        """Standard deviation of each parameter from one recording to another (p,): of friction, or of drive gains."""
        model, out, start = self.problem.row_model, [], 0
        for effect in model.effects:
            values = self.point.values[start : start + len(effect.parameters)]
            size = wander(effect, values, self.robot)
            out.append(size if effect.wanders == friction else 0.0 * size)
            start += len(values)
        return np.concatenate([np.zeros(model.base.rank), np.concatenate([np.zeros(0), *out])[model.free]])


def with_bodies(experiment: Experiment) -> Experiment:
    """The experiment with typical bodies where its URDF states no masses: scales need some, results do not hang on them."""
    robot = experiment.robot
    return experiment if states_masses(robot) else replace(experiment, robot=replace(robot, nominal=typical_links(robot)))


def learn_reference(
    experiment: Experiment, channel: str | None = None, effects: Sequence[str] | None = None, bandwidth: float | None = None
) -> Reference:
    """Fit links, friction and rotors of the joints and the model's own effects to a robot in its known state.

    ``channel`` and ``bandwidth`` [Hz] are by default chosen as for `bayesid.identify`; ``effects`` replace ``[model] effects``,
    and what every drive has comes along for torques. An `InputError` where it cannot be fitted.
    """
    experiment = with_bodies(experiment)
    own = list(experiment.effects if effects is None else effects)
    problem = prepare(experiment, FitOptions(channel, effects=[*own, *_DRIVES], bandwidth=bandwidth))
    problem, estimate = solve(problem, "wls")
    if estimate.full_covariance is None:
        raise InputError(
            f"{argument('reference', experiment.name)}: nothing says how sure its fit is, for {estimate.interval_reason}"
        )
    return Reference(problem, frozenset(spec.split("@")[0] for spec in own))
