"""What encoder noise makes of the regressor: its size, rows with fresh noise, and instruments free of it.

The smoothed trajectory of positions ``q + u`` is that of q plus that of u, for the smoother is linear. So the errors of
a regressor are known in law, not column by column but as what the encoders of all joints make of them together: add
fresh noise to the recorded positions and make the rows again. Instruments are rows of another trajectory of the
same motion whose errors are independent of this one's.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from bayesid.arguments import argument
from bayesid.errors import InputError
from bayesid.regression.blocks import Block, Instruments, Pair, RegressorNoise
from bayesid.regression.row_model import RowModel
from bayesid.regression.rows import make_blocks
from bayesid.regression.segment import LongSegment, Segment
from bayesid.signals.smoothing import Smoother, degrees_of_freedom, smooth

#: Neighbouring errors are taken for independent up to this correlation of the residuals.
LARGEST_CORRELATION = 0.3
#: Samples that errors are simulated on where a part of long recordings will do, in so many pieces.
_SAMPLES, _PIECES = 4000, 8
#: Samples smoothed at once where only their scatter about the spline is wanted, of longer recordings than the second number, and
#: how many of those it is measured on, about: for a standard deviation to two parts in a thousand.
_PIECE, _WHOLE, _MEASURED = 8192, 65_536, 131_072
#: Knots that periods must be apart at least: the influence of a sample falls to 0.43**12 = 4e-5.
_APART = 12
_ENTROPY = 1998  # of simulated noise, the same at every call
#: Counts that the ends of a motion are moved by, at most, when it is rounded once more, and the largest share of the motion.
_MOVED, _STRETCHED = 5.0, 0.1


@dataclass(frozen=True)
class EncoderNoise:
    """Errors of single position samples, as the recordings themselves show them."""

    std: np.ndarray  # (n,) [rad or m]
    correlation: np.ndarray  # of neighbouring samples (n,); well above zero where the rounding of a slow motion dominates


def measure(segments: Sequence[Segment | LongSegment], bandwidth: float, most: np.ndarray, least: float = 0.0) -> EncoderNoise:
    """Size of the encoder noise from what the smoother leaves over in segments that are fitted; poses at rest show no noise.

    Standard deviations above ``most`` (n,) are not believed: a bandwidth [Hz] below the motion's would take motion for noise.
    ``least`` is what is stated of them: errors that were filtered with the positions are not seen beside the motion, and are in
    it.
    """
    n, moving = len(most), [r for r in segments if not r.poses]
    power, product, free = np.zeros(n), np.zeros(n), 0
    total = sum(r.count for r in moving)
    size = _PIECE if total > _WHOLE else max(total, 1)
    pieces = [(r, a) for r in moving for a in range(0, r.count, size)]
    for r in (r.part(a, min(a + size, r.count)) for r, a in pieces[:: max(total // _MEASURED, 1)]):
        own = degrees_of_freedom(r.times, bandwidth)
        if own <= 0:
            continue
        residual = r.positions - smooth(r.times, r.positions, bandwidth)[0]
        power += np.sum(residual**2, axis=0)
        product += np.sum(residual[1:] * residual[:-1], axis=0)
        free += own
    std = np.maximum(np.minimum(np.sqrt(power / max(free, 1)), most), least)
    return EncoderNoise(std, product / np.maximum(power, 1e-300))


def errors_of(
    row_model: RowModel, segments: Sequence[Segment | LongSegment], smoother: Smoother
) -> tuple[RegressorNoise, Instruments]:
    """The law of the regressor's errors, and instruments free of them.

    Instruments of a segment are its commanded trajectory, which never saw the encoder; else the mean over all other periods,
    which saw it at other times. Where neither is to be had, one spline goes through the even samples and one through the odd
    ones: the noise of each is independent of the other's as long as it is independent from sample to sample, and each serves as
    the instrument of the other. The smoother's error of positions is the most that is taken for encoder noise.
    """
    e = _Encoders(row_model, segments, smoother)
    law = RegressorNoise(e.perturbed, e.simulated, e.pieces, e.misread, e.present, e.described, rung=row_model.rings)
    return law, Instruments(e.pairs, e.instruments_described, e.drawn_pairs)


@dataclass(frozen=True, eq=False)
class _Encoders:
    """Encoder noise of segments and what it makes of their rows; nothing is measured or smoothed before it is needed.

    Methods without a docstring are what `RegressorNoise` and `Instruments` call.
    """

    #: As `errors_of` takes them.
    row_model: RowModel
    segments: Sequence[Segment | LongSegment]
    smoother: Smoother

    def __reduce__(self):
        """A copy measures and smooths anew."""
        return _Encoders, (self.row_model, self.segments, self.smoother)

    @cached_property
    def kinds(self) -> tuple[str, ...]:
        """What serves as the instrument of each segment."""
        return tuple(_kind(self.row_model, r) for r in self.segments)

    @cached_property
    def noise(self) -> EncoderNoise:
        """The size of the noise."""
        return measure(self.segments, self.row_model.bandwidth, self.smoother.position_std, self.smoother.stated_error)

    @cached_property
    def quiet(self) -> list[Segment]:
        """The segments as they might truly have been."""
        return self._as_smooth(_whole(self.segments))

    @cached_property
    def quiet_pieces(self) -> list[Segment]:
        """The same of evenly spread pieces of long ones."""
        return self._as_smooth(_pieces(self.row_model, self.segments))

    def _as_smooth(self, segments: Sequence[Segment]) -> list[Segment]:
        """Segments as smooth as the data allow."""
        bandwidth = min(self.smoother.automatic or self.row_model.bandwidth, self.row_model.bandwidth)
        return [r if r.poses else replace(r, positions=smooth(r.times, r.positions, bandwidth)[0]) for r in segments]

    def again(self, taken: Sequence[Segment], true: Sequence[Segment], draw: int, sign: float = 1.0) -> list[Segment]:
        """Recordings with fresh noise on top of the positions, as the encoders make it of the true ones."""
        rng = np.random.default_rng(np.random.SeedSequence(entropy=_ENTROPY, spawn_key=(draw,)))
        std, resolution = self.noise.std, self.smoother.resolution
        return [
            replace(r, positions=r.positions + sign * _errors(s.positions, std, resolution, rng))
            for r, s in zip(taken, true, strict=True)
        ]

    def present(self) -> bool:
        return bool((self.noise.std > 0).any())

    def perturbed(self, draw: int, sign: float) -> Iterator[Block]:
        return make_blocks(self.row_model, self.again(_whole(self.segments), self.quiet, draw, sign))

    def simulated(self, draw: int | None) -> Iterator[Block]:
        return make_blocks(self.row_model, self.quiet if draw is None else self.again(self.quiet, self.quiet, draw))

    def pieces(self, draw: int | None) -> Iterator[Block]:
        parts = self.quiet_pieces
        return make_blocks(self.row_model, parts if draw is None else self.again(parts, parts, draw))

    def misread(self, draws: int, solution: np.ndarray) -> list[list[np.ndarray]]:
        parts = self.quiet_pieces
        drawn = [self.again(parts, parts, k) for k in range(draws)]
        rows: list[np.ndarray] = []
        for versions in zip(parts, *drawn, strict=True):

            def said(_: Segment, first: int, last: int, versions: tuple[Segment, ...] = versions) -> np.ndarray:
                """Predictions without errors and of every draw (N, channels, 1 + draws)."""
                return np.stack([self.row_model.modelled(v, first, last, solution) for v in versions], axis=2)

            rows += [b.rows for b in make_blocks(self.row_model, versions[:1], said)]
        return [[r[:, :, k] - r[:, :, 0] for r in rows] for k in range(1, draws + 1)]

    def pairs(self, taken: Sequence[Segment] | None = None) -> Iterator[Pair]:
        """Rows of segments, default the recorded ones, beside those of their instruments."""
        for r, kind in zip(_whole(self.segments) if taken is None else taken, self.kinds, strict=True):
            first, second = _both(self.row_model, r, kind)
            for x, z in zip(make_blocks(self.row_model, [first]), make_blocks(self.row_model, [second]), strict=True):
                yield Pair(x, z, symmetric=kind == "halves")

    def drawn_pairs(self, draw: int) -> Iterator[Pair]:
        """`pairs` of the smooth motion with the noise of a draw."""
        return self.pairs(self.again(self.quiet, self.quiet, draw))

    def described(self) -> dict[str, Any]:
        sizes = {"encoder_std": self.noise.std.tolist(), "encoder_correlation": self.noise.correlation.tolist()}
        # Errors of known counts are simulated with the correlation that they have.
        return sizes | ({} if self.smoother.resolution else self._doubt())

    def instruments_described(self) -> dict[str, Any]:
        sources = [_SOURCES[k] for k in dict.fromkeys(self.kinds)]
        return {"instruments": sources, **(self._doubt() if "halves" in self.kinds else {})}

    def _doubt(self) -> dict[str, Any]:
        worst = float(np.max(self.noise.correlation, initial=0.0))
        said = (
            f"Errors of neighbouring position samples correlate by {worst:.2f} (encoder counts of a slow motion do that); the "
            "correction takes them for independent and is too small: record faster motions, or commanded positions (qr) for iv."
        )
        return {"warnings": [said]} if worst > LARGEST_CORRELATION else {}


def _whole(segments: Sequence[Segment | LongSegment]) -> list[Segment]:
    """Segments that are in memory; an `InputError` where one is read in chunks."""
    out = [r for r in segments if isinstance(r, Segment)]
    for r in segments:
        if isinstance(r, LongSegment):
            raise InputError(
                f"{r.stored.source}: is read in chunks, and {argument('method')} tls and iv need all of it at once; use wls, "
                "gls or a robust one, or cut out what fits in memory"
            )
    return out


def _errors(positions: np.ndarray, std: np.ndarray, resolution: float, rng: np.random.Generator) -> np.ndarray:
    """Errors of encoders that read positions (N, n): white noise, of which counts of a known size are a part.

    Rounding is no white noise where a joint moves by less than a count from sample to sample: most of its error is made where the
    motion turns, and by how the turning points lie to the counts. There, a smoothed motion follows the counts of its recording,
    so that rounding it again tells of that one case. Hence not only the offset of the counts is random, but also, by a few
    counts, how far apart the turning points are.
    """
    white = np.sqrt(np.maximum(std**2 - resolution**2 / 12.0, 0.0)) * rng.normal(size=positions.shape)
    if not resolution:
        return white
    n = positions.shape[1]
    half = np.ptp(positions, axis=0) / 2.0
    most = np.minimum(_MOVED * resolution / np.where(half > 0.0, half, np.inf), _STRETCHED)
    stretched = positions + rng.uniform(-most, most, n) * (positions - positions[0])
    exact = (stretched + white) / resolution + rng.uniform(-0.5, 0.5, n)
    return white + resolution * (np.round(exact) - exact)


def _pieces(row_model: RowModel, segments: Sequence[Segment | LongSegment]) -> Sequence[Segment]:
    """The segments, or evenly spread pieces of long ones."""
    moving = [r for r in segments if not r.poses]
    total = sum(r.count for r in moving)
    if total <= _SAMPLES:
        return [r if isinstance(r, Segment) else r.part(0, r.count) for r in segments]
    out = [r for r in segments if isinstance(r, Segment) and r.poses]
    for r in moving:
        count, needed = max(round(_PIECES * r.count / total), 1), 4 * max(row_model.margin, r.settling)
        length = min(max(_SAMPLES // _PIECES, int(needed * r.count / (r.ends[1] - r.ends[0]))), r.count)
        out += [r.part(a, a + length) for a in np.linspace(0, r.count - length, count).astype(int).tolist()]
    return out


def _both(row_model: RowModel, r: Segment, kind: str) -> tuple[Segment, Segment]:
    """The segments that regressors and instruments are made from."""
    if kind == "commanded":
        assert r.commanded is not None
        return r, replace(r, positions=r.commanded)
    if kind == "period":
        return r, replace(r, positions=_other_periods(row_model, r))
    if kind == "halves":
        return replace(r, positions=_half(row_model, r, 0)), replace(r, positions=_half(row_model, r, 1))
    return r, r


_SOURCES = {
    "commanded": "commanded trajectory (columns qr)",
    "period": "mean of the other periods",
    "halves": "even samples for the odd ones, and the other way round",
    "own": "the poses' own regressors",
}


def _kind(row_model: RowModel, r: Segment | LongSegment) -> str:
    if r.commanded is not None:
        return "commanded"
    if r.poses:
        return "own"
    duration = r.ends[1] - r.ends[0]
    # Other periods' noise must not reach into this one's spline.
    reach = _APART * 0.5 / row_model.bandwidth
    if r.period is not None and duration + 1.5 * duration / r.count >= 2.0 * r.period and r.period > reach:
        return "period"
    return "halves"


def _half(row_model: RowModel, r: Segment, which: int) -> np.ndarray:
    """Spline through every other sample, at all samples; smoothing it again changes nothing, for knots are the same."""
    return smooth(r.times[which::2], np.ascontiguousarray(r.positions[which::2]), row_model.bandwidth, at=r.times)[0]


def _other_periods(row_model: RowModel, r: Segment) -> np.ndarray:
    """Mean of the smoothed positions one, two ... periods before and after, as far as the segment goes."""
    assert r.period is not None
    total, count = np.zeros_like(r.positions), np.zeros(len(r.times))
    slack = 1.5 * (r.times[-1] - r.times[0]) / len(r.times)
    for k in range(1, int((r.times[-1] - r.times[0] + slack) / r.period) + 1):
        for sign in (-1, 1):
            at = r.times + sign * k * r.period
            inside = (at >= r.times[0] - slack) & (at <= r.times[-1] + slack)
            if inside.any():
                total[inside] += smooth(r.times, r.positions, row_model.bandwidth, at=at[inside])[0]
                count[inside] += 1
    return total / np.maximum(count, 1.0)[:, None]
