"""How much of the gap effects close in the channels that they act in, where much stays elsewhere.

That other joints do what no model has says nothing against an effect in this one. So effects are judged together with those that
act in the same channels, by the errors of these channels alone on recordings held out in turn.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayesid.diagnosis.choice import LEAST_GAP
from bayesid.diagnosis.held_out import held_out_sums, left_by, scaled
from bayesid.diagnosis.rows import residual_rows
from bayesid.diagnosis.search import Search
from bayesid.diagnosis.white_noise import noise_share

#: An effect acts in a channel if it changes it by more than this share, in mean squares, of what it changes most.
_ACTS = 1e-2


@dataclass(frozen=True)
class ChannelGroup:
    """Effects that act in the same channels.

    Attributes
    ----------
    effects
        ``name@place``.
    channels
        In which they act.
    closed
        Share of the gap in these channels that all effects found close.
    """

    effects: tuple[str, ...]
    channels: tuple[str, ...]
    closed: float


def channel_groups(s: Search) -> tuple[ChannelGroup, ...]:
    """The effects found by the channels that they act in, and what is closed there.

    Parameters
    ----------
    s
        With the effects found as those of its best model.
    """
    users, left = len(s.base.terms), (left_by(s.projector.data, s.base), left_by(s.projector.data, s.best))
    data = scaled(s.projector.data, left[1])
    weight, names = np.sqrt(left[1] / left[0]), np.array(data.channels.names)
    out = []
    for members, mask in _together(_acting(s, weight)):
        if not mask.any():  # it changes nothing
            out.append(ChannelGroup(tuple(s.found[n].term.effect.spec for n in members), (), 0.0))
            continue
        sums = held_out_sums(data, s.projector.root, s.best, [], weight * mask)
        before = float(sums.squares(range(users)).sum())
        after = float(sums.squares(range(len(s.best.terms))).sum())
        rows = sum(float(x.shape[0] * (x.alive & mask).sum()) for x in (*data.segments, *data.unseen))
        gap = max(before - noise_share(s.projector.data, left[0], mask) * rows, LEAST_GAP * before)
        closed = (before - after) / gap if gap > 0.0 else 0.0
        out.append(ChannelGroup(tuple(s.found[n].term.effect.spec for n in members), tuple(map(str, names[mask])), closed))
    return tuple(out)


def _acting(s: Search, weight: np.ndarray) -> np.ndarray:
    """Which channels each effect found acts in (effects, c)."""
    data, best, known = scaled(s.projector.data, left_by(s.projector.data, s.best)), s.best, len(s.base.terms)
    out = []
    now = residual_rows(data, data.segments, best.links, best.offset, best.terms)
    for n in range(known, len(best.terms)):
        rest = tuple(t for k, t in enumerate(best.terms) if k != n)
        change = residual_rows(data, data.segments, best.links, best.offset, rest) - now
        edges = np.cumsum([x.shape[0] * x.shape[1] for x in data.segments])[:-1]
        parts = [part.reshape(x.shape) for part, x in zip(np.split(change, edges), data.segments, strict=True)]
        energy = sum(np.sum((part * weight) ** 2, axis=0) for part in parts)
        out.append(energy > _ACTS * np.max(energy))
    return np.array(out)


def _together(acting: np.ndarray) -> list[tuple[list[int], np.ndarray]]:
    """Effects that share a channel, directly or by way of others, and the channels of each such group (c,)."""
    groups: list[tuple[list[int], np.ndarray]] = []
    for n, mask in enumerate(acting):
        mine, rest = ([n], mask), []
        for members, own in groups:
            if (own & mine[1]).any():
                mine = (members + mine[0], own | mine[1])
            else:
                rest.append((members, own))
        groups = [*rest, mine]
    return groups
