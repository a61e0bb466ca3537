"""What may have changed: each hypothesis a few columns with a prior of their amplitudes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

import numpy as np
from scipy.linalg import block_diag

from bayesid.diagnosis.changes.proposals import ChangeProposal, sizes_of
from bayesid.diagnosis.changes.reference import Reference
from bayesid.diagnosis.changes.scales import FRICTION_SHARE, PAYLOAD_MASS, PAYLOAD_REACHES, SIZES, body_sizes
from bayesid.effects import Effect, JointGainEffect, with_places
from bayesid.effects.bodies import Payload, body_of

#: Where a change is that all joints share.
EVERYWHERE = "every joint"


@dataclass(frozen=True, eq=False)
class SharedAmplitudes:
    """Amplitudes that are in both recordings."""

    columns: np.ndarray  # columns of `LaterRecording.rows` less what the reference's estimate takes of them (k,)
    #: As the reference has them (k,), and a root of their covariance (k, k).
    mean: np.ndarray
    root: np.ndarray
    wander: np.ndarray  # standard deviations from one recording to another with nothing changed (k,)


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A change that competes with others."""

    #: As in the experiment format, or `EVERYWHERE`.
    name: str
    where: str
    effects: tuple[Effect, ...]  # what changed: one effect, or one at every joint
    columns: np.ndarray  # columns of `LaterRecording.rows` (k,)
    sizes: np.ndarray  # typical amplitudes (k,)
    #: What the reference says of the amplitudes of an effect that its model does not have; None: it has them.
    shared: SharedAmplitudes | None = None
    #: How amplitudes become values, of an effect that the reference's model does not have.
    proposal: ChangeProposal | None = None
    known: bool = False  # whether it has it, with other values
    #: The same change with all its parameters and next to no prior: a prior that weighs names pulls values towards zero.
    for_values: Hypothesis | None = None
    far: bool = False  # whether it is a body away from its joint
    together: bool = False  # whether all columns change by one factor, ``sizes`` being what the reference has of them

    @property
    def spec(self) -> str:
        """The effect's name and place, ``name@where``."""
        return f"{self.name}@{self.where}"

    @cached_property
    def root(self) -> np.ndarray:
        """What amplitudes of unit variance make of the columns' (k, m), for a prior of typical size."""
        return self.sizes[:, None] if self.together else np.diag(self.sizes)

    @property
    def unit(self) -> float:
        """The first column's amplitude by which the change's size is told: one, or as much as makes a factor of two."""
        return float(self.sizes[0]) if self.together else 1.0

    @property
    def summary(self) -> str:
        """What it is, a few words."""
        return f"{self.name} as a whole, by one factor" if self.together else self.effects[0].summary

    @property
    def parameters(self) -> tuple[tuple[str, str], ...]:
        """Name and unit of each parameter by which the change is told."""
        if self.together:
            return (("factor", "1"),)
        several = len(self.effects) > 1
        each = [
            (f"{e.where}.{p.name}" if several else p.name, unit)
            for e in self.effects
            for p, unit in zip(e.quantities, e.units, strict=True)
            if not p.lasting
        ]
        if self.proposal is not None:
            each = [each[k] for k in np.flatnonzero(self.proposal.active)]
        return tuple(each[: len(self.columns)])


def beside(change: Hypothesis, effect: Hypothesis) -> Hypothesis:
    """A change where both recordings have another effect as well that the reference's model lacks."""
    one, other = change.shared, effect.shared
    assert other is not None
    if one is None:
        one = SharedAmplitudes(np.zeros(0, int), np.zeros(0), np.zeros((0, 0)), np.zeros(len(change.columns)))
    both = SharedAmplitudes(
        np.concatenate([one.columns, other.columns]), np.concatenate([one.mean, other.mean]),
        np.asarray(block_diag(one.root, np.hstack([other.root, np.diag(other.wander)]))), one.wander,
    )  # fmt: skip
    return replace(change, shared=both)


def hypotheses(reference: Reference) -> tuple[Hypothesis, ...]:
    """Everything that may have changed."""
    return (*_bodies(reference), *_known(reference), *_wholes(reference), *_new(reference))


def gain_columns(reference: Reference) -> np.ndarray:
    """Columns of drive gains that the model does not have: they are never known to better than a few per cent."""
    return np.array([k for p, k in _placed(reference) if isinstance(p.effect, JointGainEffect)], int).ravel()


def warming_columns(reference: Reference, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Columns of friction that falls or rises within a recording (k,), and their standard deviations with nothing changed (k,).

    Friction differs within a recording by the share by which it differs between two, in root mean square over the later
    recording's rows (N, q). All time constants are equally likely.
    """
    model = reference.problem.row_model
    own = model.of_free((e.where, f"{e.name}.{name}") for e in model.effects for name in e.parameters)
    known = {key: model.base.rank + k for k, key in enumerate(own)}
    falls: dict[int, list[int]] = {}  # columns of every time constant, by that of the friction that falls
    for proposal, columns in _placed(reference):
        for column, k in zip(columns, np.flatnonzero(proposal.active), strict=True):
            friction = known.get((proposal.effect.where, proposal.effect.quantities[k].fall_of))
            if friction is not None and rows[:, column].any():
                falls.setdefault(friction, []).append(column)
    sizes = [
        FRICTION_SHARE * abs(reference.solution[k]) * np.linalg.norm(rows[:, k])
        / np.linalg.norm(rows[:, columns], axis=0) / np.sqrt(len(columns))
        for k, columns in falls.items()
    ]  # fmt: skip
    return np.concatenate([np.zeros(0, int), *falls.values()]), np.concatenate([np.zeros(0), *sizes])


def _bodies(reference: Reference) -> Iterator[Hypothesis]:
    """Something attached to a link or taken away: mass and first moments, or all ten parameters."""
    robot, first = reference.robot, len(reference.solution)
    largest = body_sizes(robot, 1.0, 1.0)
    for joint in range(robot.n):
        effect = Payload(f"joint{joint + 1}", joint)
        columns = first + 10 * body_of(robot, joint) + np.arange(10)
        free = Hypothesis(effect.name, effect.where, (effect,), columns, largest)
        for share, count in product(PAYLOAD_REACHES, (4, 10)):
            sizes, far = body_sizes(robot, PAYLOAD_MASS, share), share > min(PAYLOAD_REACHES)
            yield Hypothesis(effect.name, effect.where, (effect,), columns[:count], sizes[:count], for_values=free, far=far)


def _known(reference: Reference) -> Iterator[Hypothesis]:
    """Other values of the model's own effects, one by one; friction of all joints at once wanders."""
    model = reference.problem.row_model
    column = np.cumsum(model.free) - 1 + model.base.rank
    for effect, place in with_places(model.effects):
        changes = np.array([not p.lasting for p in effect.quantities])
        free, sizes = model.free[place][changes], np.abs(effect.typical(reference.robot))[changes]
        if changes.any() and free.all() and sizes.min() > 0.0:
            yield Hypothesis(effect.name, effect.where, (effect,), column[place][changes], sizes, known=True)


def _wholes(reference: Reference) -> Iterator[Hypothesis]:
    """All that the model has of a joint's friction, by one factor: a gear that runs dry, or was greased."""
    model = reference.problem.row_model
    wholes: dict[tuple[str, str], list[tuple[Effect, int, float]]] = {}
    free = model.of_free((e, p) for e in model.effects for p in e.quantities)
    for k, (effect, p) in enumerate(free, model.base.rank):
        value = float(np.clip(reference.solution[k], p.lower, p.upper))
        if effect.part_of and p.linear and not p.lasting and value != 0.0:
            wholes.setdefault((effect.part_of, effect.where), []).append((effect, k, value))
    for (name, where), parts in wholes.items():
        if len(parts) > 1:
            effects, columns, values = zip(*parts, strict=True)
            yield Hypothesis(
                name, where, tuple(dict.fromkeys(effects)), np.array(columns), np.array(values), known=True, together=True
            )  # fmt: skip


def _new(reference: Reference) -> Iterator[Hypothesis]:
    """Effects that the reference's model does not have; drive gains at every joint at once, too."""
    gains: list[Hypothesis] = []
    for proposal, columns in _placed(reference):
        effect = proposal.effect
        sizes = sizes_of(effect, proposal.about, reference.robot)[proposal.active]
        both = _shared(reference, [effect], columns, sizes)
        one = Hypothesis(effect.name, effect.where, (effect,), columns, sizes, both, proposal)
        yield one
        if isinstance(effect, JointGainEffect):
            gains.append(one)
    if len(gains) > 1:
        effects, columns, sizes = _together(gains)
        yield Hypothesis(effects[0].name, EVERYWHERE, effects, columns, sizes, _shared(reference, effects, columns, sizes))


def _shared(reference: Reference, effects: Sequence[Effect], columns: np.ndarray, sizes: np.ndarray) -> SharedAmplitudes:
    mean, root = reference.lacking.amplitudes(columns - _first(reference), max(SIZES) * sizes)
    share = FRICTION_SHARE if all(e.wanders for e in effects) else 0.0
    return SharedAmplitudes(columns + reference.lacking.carried.shape[1], mean, root, share * np.abs(mean))


def _first(reference: Reference) -> int:
    """First column of the proposals."""
    return len(reference.solution) + len(reference.problem.row_model.base.parameter_names)


def _placed(reference: Reference) -> Iterator[tuple[ChangeProposal, np.ndarray]]:
    """Proposals and their columns."""
    start = _first(reference)
    for proposal in reference.proposals:
        count = int(proposal.active.sum())
        yield proposal, np.arange(start, start + count)
        start += count


def _together(members: list[Hypothesis]) -> tuple[tuple[Effect, ...], np.ndarray, np.ndarray]:
    columns, sizes = (np.concatenate([getattr(m, k) for m in members]) for k in ("columns", "sizes"))
    return tuple(m.effects[0] for m in members), columns, sizes
