"""Validation on held-out parts: how much of the gap between reference and later recording each change closes.

Every part is predicted from what the others say: from the reference alone; from the reference with one change after the other
and nothing else; and with links, friction and gains fitted within their tolerance beside. What the recording's own fit of the
same model leaves is the floor, and what the tolerance alone would do stands beside.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayesid.diagnosis.changes.evidence import amplitudes
from bayesid.diagnosis.changes.recording import LaterRecording
from bayesid.diagnosis.changes.selection import Selection
from bayesid.diagnosis.gap import lower_end, share_of_gap
from bayesid.diagnosis.locate import LISTED
from bayesid.diagnosis.settings import Settings
from bayesid.estimators.dispersion import PARTS

#: From so many motions on each is left out as a whole; fewer are cut into parts.
_ENOUGH_MOTIONS = 4


@dataclass(frozen=True)
class Place:
    """A channel and a time in which the reference's prediction is off."""

    #: Indices.
    channel: int
    motion: int
    #: When [s].
    start: float
    end: float
    #: Root mean square of the residual there, of the reference and with all changes and tolerances.
    before: float
    after: float


@dataclass(frozen=True)
class HeldOutErrors:
    """Mean squares of residuals on parts held out in turn; one is what the recording's own fit leaves."""

    reference: float  # of the reference as it is
    changes: tuple[float, ...]  # with one change more each, and nothing else (m,)
    after: float  # with all changes, and all else fitted within its tolerance
    tolerance: float  # without any change, all else fitted within its tolerance
    floor: float  # what the recording's own fit of the same model leaves; no more than the least of the others
    #: Share of the gap from ``reference`` to ``floor`` that each change closes (m,), and the lower ends of their one-sided 95 %
    #: intervals, by bootstrap over blocks of time; nan where there is no gap.
    shares: tuple[float, ...]
    shares_low: tuple[float, ...]
    #: Share that is closed in all, tolerance included.
    closed: float
    closed_low: float
    by_channel: np.ndarray  # root mean square by channel: reference, with the changes, after, floor (c, 4)
    tolerated: np.ndarray  # root mean square by channel without any change, all else fitted within its tolerance (c,)
    places: tuple[Place, ...]  # channels and blocks of time where the reference's prediction is furthest off
    segments: int  # how many were left out in turn

    @property
    def remainder(self) -> float:
        """Share of the gap that stays."""
        return max(1.0 - self.closed, 0.0) if np.isfinite(self.closed) else 0.0


def held_out_errors(selection: Selection, recording: LaterRecording, settings: Settings, seed: int) -> HeldOutErrors:
    """Leave parts of the later recording out in turn; the seed is that of the bootstrap."""
    squares = _residuals(selection, recording) ** 2
    blocks = _blocks(recording, settings)
    sums = np.array([squares[part].sum(axis=0) for part in blocks])
    means = squares.mean(axis=0)
    floor = float(means.min())
    shares, low = _shares(means), lower_end(sums, _shares, settings, seed)
    if means[0] <= floor:
        shares, low = np.full((2, len(shares)), np.nan)
    last = -4  # the reference with all changes and nothing else
    channels = np.sqrt([squares[recording.channel == c].mean(axis=0) for c in range(len(recording.scale))])
    return HeldOutErrors(
        reference=float(means[0]), changes=tuple(means[1:-3].tolist()), after=float(means[-3]), tolerance=float(means[-2]),
        floor=floor, shares=tuple(shares[1:].tolist()), shares_low=tuple(low[1:].tolist()), closed=float(shares[0]),
        closed_low=float(low[0]),
        by_channel=channels[:, [0, last, -3, -1]], tolerated=channels[:, -2],
        places=_places(recording, squares, blocks, settings),
        segments=int(_groups(recording).max()) + 1,
    )  # fmt: skip


def _residuals(selection: Selection, recording: LaterRecording) -> np.ndarray:
    """Residuals of held-out rows (N, m + 4): reference, with each change more, after, tolerance alone, the own fit."""
    groups = _groups(recording)
    rows, left = recording.rows, recording.left
    parts = [groups == g for g in range(groups.max() + 1)]
    grams = [rows[part].T @ rows[part] / recording.correlation for part in parts]
    targets = [rows[part].T @ left[part] / recording.correlation for part in parts]
    with_changes, without = selection.marginal(), selection.marginal(())
    out = np.empty((len(left), len(selection.accepted) + 4))
    out[:, 0], out[:, -1] = left, recording.own
    for g, part in enumerate(parts):
        gram, target = (np.sum([x[k] for k in range(len(parts)) if k != g], axis=0) for x in (grams, targets))
        fitted = amplitudes(with_changes, gram, target)
        alone = amplitudes(without, gram, target)
        for k, own in enumerate(selection.directions):
            out[part, k + 1] = out[part, k] - rows[part] @ fitted.part(own)
        out[part, -3] = left[part] - rows[part] @ fitted.all
        out[part, -2] = left[part] - rows[part] @ alone.all
    return out


def _shares(means: np.ndarray) -> np.ndarray:
    """Shares of the gap closed in all, and by each change (..., 1 + m); from mean squares as `_residuals` orders them."""
    floor = means.min(axis=-1, keepdims=True)
    closed = np.concatenate([means[..., :1] - means[..., -3:-2], means[..., :-4] - means[..., 1:-3]], axis=-1)
    return share_of_gap(closed, means[..., :1], floor)


def _groups(recording: LaterRecording) -> np.ndarray:
    """Which rows are left out together (N,)."""
    motions = list(dict.fromkeys(recording.motions.tolist()))
    if len(motions) >= _ENOUGH_MOTIONS:
        return np.searchsorted(np.sort(motions), recording.motions)
    return np.arange(len(recording.left)) * PARTS // len(recording.left)


def _blocks(recording: LaterRecording, settings: Settings) -> list[np.ndarray]:
    """Rows of every block of time."""
    out = []
    for motion in dict.fromkeys(recording.motions.tolist()):
        mine = np.flatnonzero(recording.motions == motion)
        times = recording.times[mine]
        count = max(int((times[-1] - times[0]) / settings.window), 1)
        out += np.array_split(mine, min(count, len(mine)))
    return out


def _places(recording: LaterRecording, squares: np.ndarray, blocks: list[np.ndarray], settings: Settings) -> tuple[Place, ...]:
    """The worst blocks and channels, worst first."""
    found = []
    for part in blocks:
        for c in range(len(recording.scale)):
            mine = part[recording.channel[part] == c]
            before, after = np.sqrt(squares[mine][:, [0, -3]].mean(axis=0)) if len(mine) else (0.0, 0.0)
            if before**2 > settings.unexplained:
                start, end = recording.times[mine[[0, -1]]]
                found.append(Place(c, int(recording.motions[mine[0]]), float(start), float(end), float(before), float(after)))
    return tuple(sorted(found, key=lambda p: -p.before)[:LISTED])
