"""How small an effect motions could show, and which other effect is most like it: before the data decide.

The trace z of an effect is what it changes at its usual size in all readings, in standard deviations, less what links and the
effects of the model explain. Where an effect is seen once its trace has a length d, that is from ``d / |z|`` times the usual size
on, the minimum detectable effect (MDE). Another effect, with an orthonormal basis Q of its columns, explains the share
``c^2 = |Q' z|^2 / |z|^2`` of the trace; beside it, ``d / (|z| sqrt(1 - c^2))`` times the usual size is needed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from bayesid.diagnosis.candidates import Library, least_visible
from bayesid.effects import Effect
from bayesid.regression.linalg import or_one, orthonormal_basis
from bayesid.robot.robot import Robot

#: Nearer to one than this a share is rounding: the two leave the same trace.
_SAME = 1.0 - 1e-8
#: An effect that is seen only from so many times its usual size is not seen; rounding leaves as much.
IMPLAUSIBLE = 100.0


@dataclass(frozen=True)
class DetectableEffect:
    """How small an effect motions could show, alone and beside the effect that is most like it."""

    effect: Effect  # which, and where
    parameter: str  # the parameter by which its size is told; the others have theirs in proportion to usual ones
    unit: str
    usual: float  # a usual size
    smallest: float  # size from which it is seen; infinite where no plausible size is
    rival: str | None  # ``name@where`` of the other effect that explains most of its trace; None without any other
    share: float  # part of the trace's energy that the rival explains, at its best values
    named: float  # size from which what the rival leaves is seen; infinite where no plausible size is


def detectable_effects(
    robot: Robot, traced: Sequence[tuple[Effect, np.ndarray, np.ndarray]], needed: Callable[[int], float]
) -> tuple[DetectableEffect, ...]:
    """What can be seen of every effect, from its trace (N,) and an orthonormal basis (N, k) of its columns.

    An effect of several shapes stands there once for each, and its first one counts. ``needed`` is the length of a trace that is
    seen [standard deviations], by the number k.
    """
    if not traced:
        return ()
    traces = np.stack([trace for _, trace, _ in traced], axis=1)
    lengths = np.linalg.norm(traces, axis=0)
    directions = traces / or_one(lengths, 0.0)
    shares = np.array([np.sum((basis.T @ directions) ** 2, axis=0) for *_, basis in traced])  # (explaining, explained)
    specs = np.array([effect.spec for effect, *_ in traced])
    shares[specs[:, None] == specs] = -1.0  # no effect is its own rival
    out: dict[str, DetectableEffect] = {}
    for k, (effect, _, basis) in enumerate(traced):
        usual = np.array(effect.typical(robot), float)
        by, nearest = int(np.argmax(usual != 0.0)), int(np.argmax(shares[:, k]))
        size, share = abs(float(usual[by])), float(np.clip(shares[nearest, k], 0.0, 1.0))
        seen = needed(basis.shape[1]) / float(lengths[k]) if lengths[k] * size > 0.0 else np.inf
        apart = seen / float(np.sqrt(1.0 - share)) if share <= _SAME else np.inf
        smallest, named = (size * multiple if multiple < IMPLAUSIBLE else np.inf for multiple in (seen, apart))
        rival = str(specs[nearest]) if specs[nearest] != effect.spec else None
        found = DetectableEffect(effect, effect.parameters[by], effect.units[by], size, smallest, rival, share, named)
        out.setdefault(effect.spec, found)
    return tuple(out.values())


def visible(library: Library, dispersion: float) -> tuple[DetectableEffect, ...]:
    """Sizes from which effects with an amplitude would be named half of the time, alone and beside their nearest rivals.

    The ``dispersion`` is the mean square of whitened residuals that no effect explains.
    """
    projector, data = library.projector, library.projector.data
    traced = [
        (b.effect, b.rows @ b.about.to_amplitudes(np.array(b.effect.typical(data.robot), float)),
         orthonormal_basis(b.rows, 1e-7, 1e-6)) for b in library.blocks
    ]  # fmt: skip
    return detectable_effects(data.robot, traced, lambda k: least_visible(data.settings, k, projector.rows, dispersion))
