"""The linear model as a stream of rows, from an experiment or from arrays of one's own.

A regression can be read block by block as often as needed. Nothing of the size samples x parameters is ever
held: rows are kept only while they fit in `CACHE_BYTES`; otherwise every reading makes them anew.
"""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import chain, islice
from typing import Any

import numpy as np

from bayesid.dynamics.base_parameters import BaseParameters, regroup
from bayesid.errors import InputError
from bayesid.robot.prior import Prior
from bayesid.signals.filters import LowPass

#: Rows are kept in memory up to this many bytes, and made anew at every reading beyond.
CACHE_BYTES = 64 * 2**20
#: About as many rows as the noise is learned from, in this many segments spread over a long recording.
PILOT_ROWS = 2048
PILOT_SEGMENTS = 8


@dataclass(frozen=True)
class Block:
    """Consecutive rows of one recording.

    Attributes
    ----------
    rows
        Regressor columns and, last, the target (k, channels, p + 1).
    times
        (k,) [s].
    motion
        Index of the recording.
    start
        Whether the recording (or a segment after a gap) starts with the first row.
    group
        Rows with the same noise: ``trajectory`` or ``poses``.
    """

    rows: np.ndarray
    times: np.ndarray
    motion: int
    start: bool
    group: str = "trajectory"

    @property
    def matrix(self) -> np.ndarray:
        """Regressor (k, channels, p)."""
        return self.rows[:, :, :-1]

    @property
    def target(self) -> np.ndarray:
        """Measured (k, channels)."""
        return self.rows[:, :, -1]


@dataclass(frozen=True)
class Pair:
    """The same rows of two trajectories: regressors, and instruments for them.

    Attributes
    ----------
    regressors, instruments
        Blocks with the same rows and the same target.
    symmetric
        Whether each also serves as the instrument of the other.
    """

    regressors: Block
    instruments: Block
    symmetric: bool = False


@dataclass(frozen=True)
class Instruments:
    """Rows whose errors are independent of the regressor's.

    Attributes
    ----------
    pairs
        Makes them, all recordings one after the other.
    describe
        What they are, for the estimate's details.
    drawn
        From the number of a draw: the same with further errors of the regressor's law, if that is known.
    """

    pairs: Callable[[], Iterable[Pair]]
    describe: Callable[[], dict[str, Any]]
    drawn: Callable[[int], Iterable[Pair]] | None = None


@dataclass(frozen=True)
class RegressorNoise:
    """The law of the regressor's errors, as draws from it.

    Attributes
    ----------
    perturbed
        From the number of a draw and a sign: all blocks with that error more, times the sign.
    rehearsed
        Blocks of a motion near the recorded one: without errors (None), or with those of a draw.
    present
        Whether there is any.
    describe
        How large it is, for the estimate's details.
    draws
        How many there are; None: any number.
    """

    perturbed: Callable[[int, float], Iterable[Block]]
    rehearsed: Callable[[int | None], Iterable[Block]]
    present: Callable[[], bool]
    describe: Callable[[], dict[str, Any]]
    draws: int | None = None


@dataclass(frozen=True)
class Regression:
    """``target = matrix @ [base parameters; effect parameters] + noise`` as a stream of blocks.

    Attributes
    ----------
    base
        Base parameters: the first ``base.rank`` columns.
    effect_names, effect_units
        The remaining columns.
    channel_names, channel_units
        What is measured.
    motion_names
        Recordings, in the order of ``Block.motion``.
    source
        Makes the blocks; called anew for every reading unless they were kept.
    row_count
        Number of rows in all blocks.
    pilot_source
        Makes blocks of a few segments alone, where there are many more rows than `PILOT_ROWS`.
    known_poles
        Poles of the low-pass filters that the rows went through from the zero state, at the rows' spacing.
    effect_non_negative
        Which effect parameters cannot be negative; empty: none.
    nominal_links
        Link parameters of the nominal model, in the order of ``base.parameter_names`` (P,), if there is one.
    inertia_rel_std
        How far they are trusted, see `bayesid.robot.prior.Prior.nominal`; 0: exact, None: not known.
    bodies
        Columns of ``base.parameter_names`` that are a body's ten parameters.
    instruments, regressor_noise
        What `iv` and `tls` need to know, if anything is known of it.
    """

    base: BaseParameters
    effect_names: tuple[str, ...]
    effect_units: tuple[str, ...]
    channel_names: tuple[str, ...]
    channel_units: tuple[str, ...]
    motion_names: tuple[str, ...]
    source: Callable[[], Iterable[Block]]
    row_count: int = 0
    pilot_source: Callable[[], Iterable[Block]] | None = None
    known_poles: np.ndarray | None = None
    effect_non_negative: tuple[bool, ...] = ()
    nominal_links: np.ndarray | None = None
    inertia_rel_std: float | None = None
    bodies: tuple[tuple[int, ...], ...] = ()
    instruments: Instruments | None = None
    regressor_noise: RegressorNoise | None = None
    _kept: list[Block] = field(default_factory=list, repr=False, compare=False)
    _pilot: list[Block] = field(default_factory=list, repr=False, compare=False)
    _shared: dict[str, Any] = field(default_factory=dict, init=False, repr=False, compare=False)

    @property
    def column_names(self) -> tuple[str, ...]:
        """Base parameters, then effect parameters."""
        return self.base.names + self.effect_names

    @property
    def nominal(self) -> np.ndarray | None:
        """Base parameters of the nominal model (r,), if there is one."""
        return None if self.nominal_links is None else self.base.matrix @ self.nominal_links

    @cached_property
    def nominal_scale(self) -> np.ndarray | None:
        """How uncertain ``nominal`` is when every body's mass distribution is so by its own size (r,)."""
        if self.nominal_links is None:
            return None
        covariance = Prior.nominal(self.nominal_links, 2.0**0.5).covariance
        return np.sqrt(np.einsum("ij,jk,ik->i", self.base.matrix, covariance, self.base.matrix))

    @property
    def fits_in_memory(self) -> bool:
        """Whether the blocks are kept after the first reading."""
        return 8 * self.row_count * len(self.channel_names) * (len(self.column_names) + 1) <= CACHE_BYTES

    def blocks(self) -> Iterator[Block]:
        """Read all blocks, recording by recording, in time order."""
        if self._kept:
            yield from self._kept
            return
        made = []
        for block in self.source():
            if self.fits_in_memory:
                made.append(block)
            yield block
        self._kept.extend(made)

    def pilot(self) -> list[Block]:
        """Enough blocks to learn the noise from: all of an ordinary recording, segments of a long one."""
        if not self._pilot:
            if self.row_count <= 2 * PILOT_ROWS:
                self._pilot.extend(self.blocks())
            elif self.fits_in_memory or self.pilot_source is None:
                self._pilot.extend(_spread(self.blocks(), self.row_count))
            else:
                self._pilot.extend(self.pilot_source())
        return self._pilot

    def once(self, name: str, make: Callable[[], Any]) -> Any:
        """What ``make`` gives, made at the first call only: estimators share what depends on the rows alone."""
        if name not in self._shared:
            self._shared[name] = make()
        return self._shared[name]

    @classmethod
    def from_arrays(
        cls,
        matrix: np.ndarray,
        target: np.ndarray,
        *,
        parameter_names: Sequence[str] | None = None,
        parameter_units: Sequence[str] | None = None,
        channel_names: Sequence[str] | None = None,
        times: np.ndarray | None = None,
        motions: Sequence | np.ndarray | None = None,
        low_pass: LowPass | None = None,
        bodies: Sequence[Sequence[int]] = (),
        instruments: np.ndarray | None = None,
        regressor_noise: np.ndarray | None = None,
    ) -> Regression:
        """A regression from a filtered regressor and offset-free measurements of one's own.

        Parameters
        ----------
        matrix
            (samples, channels, parameters).
        target
            (samples, channels).
        parameter_names, parameter_units, channel_names
            Default ``p1 ...``, ``1``, ``y1 ...``.
        times
            (samples,) [s]; needed with ``low_pass``.
        motions
            Which recording each sample is from; default one.
        low_pass
            The filter that both sides went through, from the zero state at each recording's first sample.
            None: the colour of the noise is estimated.
        bodies
            Which columns are a body's ten parameters.
        instruments
            For ``iv``: the regressor of another trajectory of the same motion, filtered alike, whose errors are independent
            of this one's (samples, channels, parameters).
        regressor_noise
            For ``tls``: simulated errors of the matrix, (draws, samples, channels, parameters): what your own way from
            positions to the matrix makes of positions with fresh encoder noise on top, less the matrix. Ten draws do.

        Raises
        ------
        InputError
            Shapes do not fit, values are not finite, or times are missing.
        """
        matrix, target = np.asarray(matrix, float), np.asarray(target, float)
        if matrix.ndim != 3 or target.shape != matrix.shape[:2]:
            raise InputError(
                f"matrix {matrix.shape} and target {target.shape}: give (samples, channels, parameters) and (samples, channels)"
            )
        for name, array in (("matrix", matrix), ("target", target)):
            if not np.isfinite(array).all():
                where = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
                raise InputError(f"{name}{list(where)} is not finite; remove that sample or fill it from neighbours")
        samples, channels, p = matrix.shape
        beside = _beside(instruments, matrix, "instruments", matrix.shape)
        errors = _beside(regressor_noise, matrix, "regressor_noise", (-1, *matrix.shape))
        names = _named(parameter_names, p, "p", "parameter_names")
        channel = _named(channel_names, channels, "y", "channel_names")
        units = _named(parameter_units, p, "1", "parameter_units") if parameter_units else ("1",) * p
        ids = np.zeros(samples, int) if motions is None else np.asarray(motions)
        if len(ids) != samples or (times is not None and len(times) != samples):
            raise InputError(f"times and motions must have one entry for each of the {samples} samples")
        if low_pass is not None and times is None:
            raise InputError("low_pass is given without times; give the times of the samples, too")
        clock = np.arange(samples, dtype=float) if times is None else np.asarray(times, float)
        starts = np.flatnonzero(np.append(True, ids[1:] != ids[:-1]))
        labels = list(dict.fromkeys(ids.tolist()))
        base = _array_base(matrix, names, units)
        rows = np.concatenate([matrix[:, :, base.independent], target[:, :, None]], axis=2)
        blocks = [
            Block(rows[a:b], clock[a:b], labels.index(ids[a].item()), True)
            for a, b in zip(starts, np.append(starts[1:], samples), strict=True)
        ]
        noise = None if errors is None else _array_noise(blocks, errors[:, :, :, base.independent])
        poles = None
        if low_pass is not None:
            poles = low_pass.poles(float(np.median(np.diff(clock[: len(blocks[0].times)]))))
        return cls(
            base, (), (), channel, ("",) * channels, tuple(str(k) for k in labels), lambda: blocks,
            row_count=samples, known_poles=poles, bodies=tuple(tuple(b) for b in bodies), _kept=blocks,
            instruments=None if beside is None else _array_instruments(blocks, beside[:, :, base.independent], noise),
            regressor_noise=noise,
        )  # fmt: skip


def _beside(given: np.ndarray | None, matrix: np.ndarray, argument: str, shape: tuple[int, ...]) -> np.ndarray | None:
    """An optional array whose last axes are the matrix's."""
    if given is None:
        return None
    array = np.asarray(given, float)
    if array.ndim != len(shape) or array.shape[-3:] != matrix.shape or not array.size:
        wanted = "(samples, channels, parameters)" if len(shape) == 3 else "(draws, samples, channels, parameters)"
        raise InputError(f"{argument} has shape {array.shape} beside a matrix of {matrix.shape}; give {wanted}")
    if not np.isfinite(array).all():
        where = [int(i) for i in np.argwhere(~np.isfinite(array))[0]]
        raise InputError(f"{argument}{where} is not finite; remove that sample or fill it from neighbours")
    return array


def _array_instruments(blocks: list[Block], beside: np.ndarray, noise: RegressorNoise | None) -> Instruments:
    def pairs(regressors: Iterable[Block] = blocks) -> Iterator[Pair]:
        first = 0
        for block in regressors:
            rows = np.concatenate([beside[first : first + len(block.rows)], block.rows[:, :, -1:]], axis=2)
            yield Pair(block, replace(block, rows=rows))
            first += len(block.rows)

    drawn = None if noise is None else lambda draw: pairs(noise.perturbed(draw, 1.0))
    return Instruments(pairs, lambda: {"instruments": ["as given"]}, drawn)


def _array_noise(blocks: list[Block], errors: np.ndarray) -> RegressorNoise:
    def perturbed(draw: int, sign: float) -> Iterator[Block]:
        first = 0
        for block in blocks:
            rows = block.rows.copy()
            rows[:, :, :-1] += sign * errors[draw, first : first + len(rows)]
            first += len(rows)
            yield replace(block, rows=rows)

    def rehearsed(draw: int | None) -> Iterable[Block]:
        return blocks if draw is None else perturbed(draw, 1.0)

    return RegressorNoise(perturbed, rehearsed, lambda: bool(errors.any()), lambda: {"regressor_noise": "as given"}, len(errors))


def _named(given, count, letter, argument) -> tuple[str, ...]:
    if given is None:
        return tuple(f"{letter}{k + 1}" for k in range(count))
    if len(given) != count:
        raise InputError(f"{argument} has {len(given)} names for {count} columns")
    return tuple(given)


def _array_base(matrix: np.ndarray, names, units) -> BaseParameters:
    flat = matrix.reshape(-1, matrix.shape[2])
    factor = np.zeros((0, flat.shape[1]))
    for start in range(0, len(flat), 1 << 15):
        factor = np.asarray(np.linalg.qr(np.vstack([factor, flat[start : start + (1 << 15)]]), mode="r"))
    return regroup(factor, names, units, tolerance=1e-9)


def _spread(blocks: Iterable[Block], rows: int) -> Iterator[Block]:
    """Evenly spread segments of blocks that are in memory anyway."""
    length, spacing = PILOT_ROWS // PILOT_SEGMENTS, rows / PILOT_SEGMENTS
    seen, due = 0, 0.0
    for block in blocks:
        count = 0
        while due < seen + len(block.rows):
            count, due = count + 1, due + spacing
        seen += len(block.rows)
        if count:
            keep = slice(0, count * length)
            yield replace(block, rows=block.rows[keep], times=block.times[keep])


def in_order(work: Callable, jobs: Iterable) -> Iterator:
    """Results in order from a few threads, with only a few results waiting at any time; a single job needs none."""
    threads = min(os.cpu_count() or 1, 8)
    jobs = iter(jobs)
    few = list(islice(jobs, 2))
    if len(few) < 2:
        yield from map(work, few)
        return
    jobs = chain(few, jobs)
    with ThreadPoolExecutor(threads) as pool:
        waiting: deque = deque()
        for job in jobs:
            waiting.append(pool.submit(work, job))
            if len(waiting) > threads:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
