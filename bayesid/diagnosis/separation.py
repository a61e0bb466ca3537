"""What these motions could show at all, and which effects they cannot tell apart: before the data decide."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayesid.diagnosis.candidates import Library, least_visible
from bayesid.effects import Effect
from bayesid.regression.linalg import orthonormal_basis

#: Nearer to one than this a share is rounding: the two leave the same trace.
_SAME = 1.0 - 1e-8
#: An effect that is seen only from so many times its usual size is not seen; rounding leaves as much.
_ABSURD = 100.0


@dataclass(frozen=True)
class Visible:
    """How small an effect these motions could show."""

    effect: Effect  # which, and where
    parameter: int  # index of the parameter by which its size is told
    usual: float  # a usual size of that parameter; the others have theirs in proportion
    #: Size whose trace, less what the links could explain, is named half of the time; None where no plausible size is.
    seen: float | None
    most_collinear: Effect | None  # the effect elsewhere in the library whose trace is most like it; None without any other
    share: float  # part of the trace's energy that the most_collinear would explain, at its best values
    named: float | None  # size from which what the most_collinear leaves stands out as much; None where no plausible size does


def visible(library: Library, dispersion: float) -> tuple[Visible, ...]:
    """Smallest sizes that could be seen and told from any one other effect, for every effect with an amplitude.

    With the whitened columns of two effects, links projected out, the trace z of the first at its usual values, and an
    orthonormal basis Q of the second, the second explains ``|Q' z|^2 / |z|^2`` of it. The usual size has a length of |z|
    standard deviations, so ``d / |z|`` of it is seen and ``d / (|z| sqrt(1 - share))`` of it told apart, with d of
    `least_visible` beside the ``dispersion``, the mean square that no effect explains.
    """
    robot, settings = library.projector.data.robot, library.projector.data.settings
    if not library.blocks:
        return ()
    traces = np.stack([b.rows @ b.about.to_amplitudes(np.array(b.effect.typical(robot), float)) for b in library.blocks], axis=1)
    lengths = np.linalg.norm(traces, axis=0)
    traces = traces / np.where(lengths > 0, lengths, 1.0)
    bases = [orthonormal_basis(b.rows, 1e-7, 1e-6) for b in library.blocks]
    whole = np.stack([np.sum((q.T @ traces) ** 2, axis=0) for q in bases])  # (explaining, explained)
    specs = [b.effect.spec for b in library.blocks]
    out: dict[str, Visible] = {}
    for k, block in enumerate(library.blocks):
        if specs[k] in out:  # another shape of the same effect
            continue
        usual = np.array(block.effect.typical(robot), float)
        by = int(np.flatnonzero(usual)[0]) if usual.any() else 0
        size = abs(float(usual[by]))
        others = [i for i, s in enumerate(specs) if s != specs[k]]
        nearest = others[int(np.argmax(whole[others, k]))] if others else None
        share = 0.0 if nearest is None else float(np.clip(whole[nearest, k], 0.0, 1.0))
        needed = least_visible(settings, bases[k].shape[1], library.projector.rows, dispersion)
        seen = needed / float(lengths[k]) * size if lengths[k] > 0 and size > 0 else None
        seen = None if seen is None or seen > _ABSURD * size else seen
        named = None if seen is None or share > _SAME else seen / float(np.sqrt(1.0 - share))
        named = None if named is None or named > _ABSURD * size else named
        most_collinear = None if nearest is None else library.blocks[nearest].effect
        out[specs[k]] = Visible(block.effect, by, size, seen, most_collinear, share, named)
    return tuple(out.values())
