"""Effects that the model does not have, as columns beside its own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from bayesid.effects import BodyEffect, Effect, Linearisation, MotionSegment, Point, Term, columns
from bayesid.effects.surroundings import surroundings_of
from bayesid.regression.problem import Problem
from bayesid.regression.row_model import RowModel
from bayesid.regression.segment import Segment
from bayesid.robot.robot import Robot


@dataclass(frozen=True, eq=False)
class ChangeProposal:
    """An effect that may have come, with its derivatives at some values as columns."""

    #: The effect, and what amplitudes of its columns mean.
    effect: Effect
    about: Linearisation
    active: np.ndarray  # which of its columns stand for it (k,); the others are of a shape that is held

    @property
    def term(self) -> Term:
        """The effect at the values where derivatives are taken."""
        return Term(self.effect, tuple(self.about.at))


@dataclass(frozen=True, repr=False)
class ProposalRows(RowModel):
    """Rows about a point with further columns, of effects that the model does not have."""

    proposals: tuple[ChangeProposal, ...] = ()  # these effects

    @property
    def extra_columns(self) -> int:
        """Effect parameters that are estimated, and all columns of the proposals."""
        return super().extra_columns + sum(int(p.active.sum()) for p in self.proposals)

    @property
    def beside(self) -> tuple[Term, ...]:
        """The proposals' effects."""
        return tuple(p.term for p in self.proposals)

    def _columns_beside(self, segment: Segment, states: MotionSegment, terms: Sequence[Term]) -> list[np.ndarray]:
        assert self.point is not None
        out = []
        for p in self.proposals:
            own = columns(
                self.robot, self.channels, states, self.point.links, terms, p.effect, tuple(p.about.at), gravity=segment.gravity
            )[:, :, p.active]  # fmt: skip
            out.append(own if segment.offset or not p.effect.removed_by_static_run else np.zeros_like(own))
        return out


def with_proposals(model: RowModel, point: Point, proposals: tuple[ChangeProposal, ...]) -> ProposalRows:
    """A row model about a point, with the columns of proposals."""
    given: dict[str, Any] = {f.name: getattr(model, f.name) for f in fields(RowModel)}
    return ProposalRows(**{**given, "point": point}, proposals=proposals)


def _motions(model: RowModel, segments: Sequence[Segment]) -> list[MotionSegment]:
    """A few hundred samples of every motion, for what effects want to know of it."""
    out = []
    for s in segments:
        state = model.state(s, 0, len(s.times))
        every = slice(None, None, max(len(s.times) // 200, 1))
        out.append(MotionSegment(*(getattr(state, k)[every] for k in ("times", "positions", "velocities", "accelerations"))))
    return out


def make_proposals(problem: Problem, links: np.ndarray) -> tuple[ChangeProposal, ...]:
    """Every effect that may have come, gone or changed and that a model does not have; bodies are combinations of its columns.

    Effects are asked about the problem's motions, at links (10 b,).
    """
    model, experiment = problem.row_model, problem.experiment
    robot = experiment.robot
    motions = _motions(model, problem.fitted_segments)
    around = surroundings_of(
        robot, motions, links, problem.channel, experiment.sensor is not None and experiment.sensor.joint is None,
        static_run=problem.static != "none", links_known=True,
    )  # fmt: skip
    known = {e.spec for e in model.effects}
    out = []
    for effect in experiment.possible_effects(model.channels.names):
        if isinstance(effect, BodyEffect) or effect.once or any(p.lasting for p in effect.quantities):
            continue
        if effect.spec in known or not effect.sought(around):
            continue
        for about in effect.linearisations(around):
            active = sizes_of(effect, about, robot) > 0.0
            if active.any():
                out.append(ChangeProposal(effect, about, active))
    return tuple(out)


def sizes_of(effect: Effect, about: Linearisation, robot: Robot) -> np.ndarray:
    """Typical amplitudes of an effect's columns (k,); zero for those of a shape that is held."""
    return np.abs(about.to_amplitudes(np.asarray(effect.typical(robot), float)))
