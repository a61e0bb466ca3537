"""Where the link is behind gear teeth with play: q_motor = q_link + lean(torque(q_link)).

The torque that decides on which side the teeth lie is that of the link's slow motion: as the teeth cross the play, the motor
makes a step that is faster than anything that positions are smoothed to, and what is left of it would turn the torque's sign
again.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from bayesid.effects.families import PlayEffect
from bayesid.effects.flexible import Basis, Motion
from bayesid.effects.segment import MotionSegment

if TYPE_CHECKING:  # sparse matrices take long to import, and few experiments have play
    from scipy.sparse.linalg import SuperLU

#: Turns at most, and the step, relative to how far joints lean, that ends them.
_TURNS, _SETTLED = 6, 1e-7
#: Share of the bandwidth that joint positions are smoothed to below which motion is slow.
SLOW = 1.0 / 3.0


def leaning_motion(
    motor: Motion,
    torque: Callable[[Motion, np.ndarray], np.ndarray],
    play: Sequence[tuple[PlayEffect, Sequence[float]]],
    bases: tuple[Projection, Projection] | None,
) -> Motion:
    """Link-side positions, velocities and accelerations, (N, n) each.

    Parameters
    ----------
    motor
        Motor-side positions, velocities and accelerations, (N, n) each.
    torque
        Torques (N, k) that a link motion takes of some joints (k,).
    play
        What the joints have of it, effects with their values.
    bases
        `projections`: on functions of time that positions were smoothed to, for so are the steps to be taken out of them, and
        on slow ones; None: every sample is a pose at rest.
    """
    which = np.unique([effect.joint or 0 for effect, _ in play])
    behind = np.zeros_like(motor[0])
    for turn in range(_TURNS):
        link = motor[0] - behind, *motor[1:]
        taken, new = torque(link if bases is None else bases[1].of(link[0]), which), np.zeros_like(behind)
        for effect, values in play:
            joint = effect.joint or 0
            new[:, joint] += effect.lean(taken[:, np.searchsorted(which, joint)], values)
        step = (new - behind) * (1.0 if turn < _TURNS // 2 else 0.5)  # what turns to and fro settles between
        behind += step
        if np.abs(step).max() <= _SETTLED * np.abs(behind).max():
            break
    if bases is None:
        return motor[0] - behind, motor[1], motor[2]
    q, v, a = (x - y for x, y in zip(motor, bases[0].of(behind), strict=True))
    return q, v, a


@dataclass(frozen=True, eq=False)
class Projection:
    """Least squares over functions of time, factored once.

    Attributes
    ----------
    basis
        `bayesid.effects.flexible.splines`.
    factor
        Of their inner products.
    """

    basis: Basis
    factor: SuperLU

    def of(self, values: np.ndarray) -> Motion:
        """Values (N, n) in least squares over the functions, and their first two derivatives."""
        found = self.factor.solve(self.basis[0].T @ values)
        q, v, a = (part @ found for part in self.basis)
        return q, v, a


def projections(segment: MotionSegment, splines: Callable[[float], Basis]) -> tuple[Projection, Projection]:
    """On functions up to the bandwidth that positions were smoothed to, and on slow ones; made once for a segment."""

    def made(cutoff: float) -> Projection:
        return segment.basis.get(("projection", cutoff), lambda: _factored(splines(cutoff)))

    return made(segment.bandwidth), made(SLOW * segment.bandwidth)


def _factored(basis: Basis) -> Projection:
    from scipy import sparse
    from scipy.sparse.linalg import splu

    gram = basis[0].T @ basis[0]
    whisper = 1e-12 * gram.diagonal().max() * sparse.eye_array(gram.shape[0])  # outermost functions hardly reach into the data
    return Projection(basis, splu((gram + whisper).tocsc()))
