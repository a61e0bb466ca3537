"""The linear model that estimators take: what its columns mean, its rows, and what is known beside them.

Rows are a stream of blocks that can be read as often as needed (`bayesid.regression.row_cache`), from an experiment
(`bayesid.regression.problem`) or from arrays of one's own.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial

import numpy as np

from bayesid.argument_types import explains_types
from bayesid.arguments import unmasked
from bayesid.dynamics.base_parameters import BaseParameters, regroup
from bayesid.errors import InputError
from bayesid.regression.blocks import Block, Instruments, Pair, RegressorNoise
from bayesid.regression.row_cache import RowCache
from bayesid.robot import inertia
from bayesid.robot.prior import Prior, natural_sizes
from bayesid.signals.filters import LowPass


@dataclass(frozen=True)
class PriorKnowledge:
    """What is known of the parameters before any row is read."""

    #: Of the nominal model, if there is one, in the order of ``base.parameter_names`` (P,).
    nominal_links: np.ndarray | None = None
    #: Their prior relative standard deviation, see `bayesid.robot.prior.Prior.around`; 0: exact, None: not known.
    inertia_rel_std: float | None = None
    bodies: tuple[tuple[int, ...], ...] = ()  # columns of ``base.parameter_names`` that are a body's ten parameters
    effect_non_negative: tuple[bool, ...] = ()  # which effect parameters cannot be negative; empty: none
    #: Those links, with a guess of bodies whose mass that model does not state (P,); None: it states all.
    assumed_links: np.ndarray | None = None
    guessed: tuple[bool, ...] = ()  # which bodies are guessed, see `bayesid.robot.prior.guessed_bodies`; empty: none

    @property
    def states_masses(self) -> bool:
        """Whether there is a nominal model that says anything of the bodies."""
        return self.nominal_links is not None and not (self.guessed and all(self.guessed))

    @property
    def links(self) -> np.ndarray | None:
        """What the links are near to before any row is read (P,)."""
        return self.nominal_links if self.assumed_links is None else self.assumed_links

    def prior(self, rel_std: float) -> Prior:
        """The prior of the links with this relative standard deviation; there must be nominal ones."""
        assert self.links is not None
        return Prior.around(self.links, rel_std, np.array(self.guessed, bool))


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
    rows
        Reads the blocks, and keeps what is read while it fits in memory.
    knowledge
        What is known of the parameters beforehand.
    instruments, regressor_noise
        What `iv` and `tls` need to know, if anything is known of it.
    noise_std
        Standard deviation of the noise of each channel's rows (c,), where it is known; None: learned from residuals.
    """

    base: BaseParameters
    effect_names: tuple[str, ...]
    effect_units: tuple[str, ...]
    channel_names: tuple[str, ...]
    channel_units: tuple[str, ...]
    motion_names: tuple[str, ...]
    rows: RowCache
    knowledge: PriorKnowledge = field(default_factory=PriorKnowledge)
    instruments: Instruments | None = None
    regressor_noise: RegressorNoise | None = None
    noise_std: np.ndarray | None = None

    def __repr__(self) -> str:
        return (
            f"<Regression: {self.base.rank} base and {len(self.effect_names)} effect parameters, {len(self.channel_names)} "
            f"channels, {self.rows.count} rows>"
        )

    @property
    def column_names(self) -> tuple[str, ...]:
        """Base parameters, then effect parameters."""
        return self.base.names + self.effect_names

    @property
    def nominal(self) -> np.ndarray | None:
        """Base parameters of the nominal model (r,), if there is one; zero where a sum leaves nothing but rounding."""
        links = self.knowledge.nominal_links
        if links is None:
            return None
        nominal = self.base.matrix @ links
        return np.where(np.abs(nominal) > 1e-12 * (np.abs(self.base.matrix) @ np.abs(links)), nominal, 0.0)

    @cached_property
    def nominal_scale(self) -> np.ndarray | None:
        """How uncertain ``nominal`` is when every body's mass distribution is so by its own size (r,)."""
        links = self.knowledge.nominal_links
        return None if links is None else natural_sizes(links, self.base.matrix)

    @classmethod
    @explains_types
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
        noise_std: Sequence[float] | np.ndarray | None = None,
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
        noise_std
            Known standard deviation of the target's noise, by channel (channels,) or by sample and channel (samples,
            channels); white, or with ``low_pass`` of the colour that it gives. Weights and covariances come from it instead of
            from residuals, in every estimator and in `bayesid.sample`, and model error is not counted. By sample and channel,
            both sides are divided by it: all estimators, ``ols`` too, then weigh samples by it, and residuals are in its units.

        Raises
        ------
        InputError
            Shapes do not fit, values are not finite, or times are missing.
        """
        matrix, target = _checked_pair(matrix, target)
        samples, channels, p = matrix.shape
        beside = _checked_like(instruments, matrix, "instruments", 3)
        errors = _checked_like(regressor_noise, matrix, "regressor_noise", 4)
        known = _checked_noise(noise_std, target.shape)
        if known is not None and known.ndim == 2:
            if low_pass is not None:
                raise InputError("noise_std by sample goes without low_pass, which mixes samples; give one number a channel")
            matrix, target = matrix / known[:, :, None], target / known
            beside = None if beside is None else beside / known[:, :, None]
            errors = None if errors is None else errors / known[:, :, None]
            known = np.ones(channels)
        names = _names_of(parameter_names, p, "p", "parameter_names")
        channel = _names_of(channel_names, channels, "y", "channel_names")
        units = _names_of(parameter_units, p, "1", "parameter_units") if parameter_units else ("1",) * p
        ids = np.zeros(samples, int) if motions is None else np.asarray(motions)
        if ids.shape != (samples,) or (times is not None and len(times) != samples):
            raise InputError(f"times and motions must have one entry for each of the {samples} samples")
        if low_pass is not None and not isinstance(low_pass, LowPass):
            raise InputError(f"low_pass is a {type(low_pass).__name__}; give bayesid.LowPass(l=..., d=...) [rad/s]")
        if low_pass is not None and times is None:
            raise InputError("low_pass is given without times; give the times of the samples, too")
        clock = np.arange(samples, dtype=float) if times is None else np.asarray(unmasked(times), float)
        _require_finite("times", clock)
        if ids.dtype.kind == "f":
            _require_finite("motions", ids)
        place = {label: k for k, label in enumerate(dict.fromkeys(ids.tolist()))}
        recording = np.array([place[label] for label in ids.tolist()])
        if times is not None and (known is None or low_pass is not None):
            _require_order(clock, recording)
        base = _base_of(matrix, names, units)
        if not base.rank:
            raise InputError("matrix is zero, so these rows show no parameter; give rows of a motion that does")
        kept = base.independent
        blocks = _blocks_of(np.concatenate([matrix[:, :, kept], target[:, :, None]], axis=2), clock, recording)
        noise = None if errors is None else _GivenErrors(blocks, errors[:, :, :, kept]).law()
        poles = None
        if low_pass is not None:
            steps = np.concatenate([np.diff(block.times) for block in blocks])
            if not len(steps) or not np.median(steps) > 0.0:
                raise InputError("times do not increase from sample to sample, which low_pass needs; sort each recording by time")
            poles = low_pass.poles(float(np.median(steps)))
        return cls(
            base, (), (), channel, ("",) * channels, tuple(map(str, place)),
            RowCache(partial(iter, tuple(blocks)), samples, channels * (len(base.names) + 1), known_poles=poles),
            PriorKnowledge(bodies=checked_bodies(bodies, p)),
            instruments=None if beside is None else _GivenInstruments(blocks, beside[:, :, kept], noise).instruments(),
            regressor_noise=noise,
            noise_std=known,
        )  # fmt: skip


def _checked_pair(matrix: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Regressor (samples, channels, parameters) and measurements (samples, channels) as finite arrays, or an `InputError`."""
    matrix, target = (np.asarray(unmasked(array), float) for array in (matrix, target))
    if matrix.ndim != 3 or target.shape != matrix.shape[:2]:
        raise InputError(
            f"matrix {matrix.shape} and target {target.shape}: give (samples, channels, parameters) and (samples, channels)"
        )
    if not matrix.size:
        raise InputError(f"matrix {matrix.shape} is empty: give at least one sample, channel and parameter")
    for name, array in (("matrix", matrix), ("target", target)):
        _require_finite(name, array)
    return matrix, target


def _checked_like(given: np.ndarray | None, matrix: np.ndarray, argument: str, axes: int) -> np.ndarray | None:
    """An optional finite array of so many axes, the last three of which are the matrix's, or an `InputError`."""
    if given is None:
        return None
    array = np.asarray(unmasked(given), float)
    if array.ndim != axes or array.shape[-3:] != matrix.shape or not array.size:
        wanted = "(samples, channels, parameters)" if axes == 3 else "(draws, samples, channels, parameters)"
        raise InputError(f"{argument} has shape {array.shape} beside a matrix of {matrix.shape}; give {wanted}")
    _require_finite(argument, array)
    return array


def _checked_noise(given: Sequence[float] | np.ndarray | None, shape: tuple[int, ...]) -> np.ndarray | None:
    """Known standard deviations (channels,) or (samples, channels) as a finite array above zero, or an `InputError`."""
    if given is None:
        return None
    std = np.asarray(unmasked(given), float)
    if std.shape not in (shape, shape[1:]):
        raise InputError(f"noise_std has shape {std.shape}; give one a channel {shape[1:]} or a sample and channel {shape}")
    if not (np.isfinite(std) & (std > 0)).all():
        where = [int(i) for i in np.argwhere(~(np.isfinite(std) & (std > 0)))[0]]
        raise InputError(f"noise_std{where} is no standard deviation; give numbers above zero, in the channels' units")
    return std


def _require_finite(name: str, array: np.ndarray) -> None:
    if not np.isfinite(array).all():
        where = [int(i) for i in np.argwhere(~np.isfinite(array))[0]]
        raise InputError(f"{name}{where} is not finite; remove that sample or fill it from neighbours")


def _require_order(times: np.ndarray, motions: np.ndarray) -> None:
    """Refuse times (N,) that go back within a recording, told by ``motions`` (N,): out of order, samples show no correlation."""
    order = np.argsort(motions, kind="stable")
    if (np.diff(motions[order]) == 0).any() and not np.ptp(times):
        raise InputError(f"times are all {times[0]:g}, which is no order; give each sample its time")
    back = np.flatnonzero((np.diff(times[order]) < 0.0) & (np.diff(motions[order]) == 0))
    if len(back):
        before, here = order[back[0]], order[back[0] + 1]
        raise InputError(
            f"times[{here}] = {times[here]:g} comes after {times[before]:g} in the same recording; sort each recording by "
            "time, and say with motions which recording each sample is from"
        )


def _names_of(given: Sequence[str] | None, count: int, letter: str, argument: str) -> tuple[str, ...]:
    """Names as given, one for each column, or numbered ones; an `InputError` where there are more or fewer."""
    if given is None:
        return tuple(f"{letter}{k + 1}" for k in range(count))
    if len(given) != count:
        raise InputError(f"{argument} has {len(given)} names for {count} columns")
    given = tuple(map(str, given))
    again = [name for k, name in enumerate(given) if name in given[:k]]
    if again and argument != "parameter_units":
        raise InputError(f"{argument}: {again[0]!r} is there twice; give each its own name")
    return given


def checked_bodies(bodies: Sequence[Sequence[int]], count: int) -> tuple[tuple[int, ...], ...]:
    """Ten of so many columns a body, none of them twice; an `InputError` where they are others."""
    used: set[int] = set()
    for k, body in enumerate(bodies):
        if len(body) != 10 or not all(isinstance(c, (int, np.integer)) and 0 <= c < count for c in body):
            raise InputError(f"bodies[{k}] = {list(body)}: give ten columns in the order {', '.join(inertia.PARAMETERS)}")
        if len(used | {*body}) < len(used) + 10:
            raise InputError(f"bodies[{k}] = {list(body)}: a column is there twice; each is one parameter of one body")
        used |= {*body}
    return tuple(tuple(int(c) for c in body) for body in bodies)


def _base_of(matrix: np.ndarray, names: tuple[str, ...], units: tuple[str, ...]) -> BaseParameters:
    """Base parameters of a regressor, whose columns may depend on each other."""
    flat = matrix.reshape(-1, matrix.shape[2])
    factor = np.zeros((0, flat.shape[1]))
    for start in range(0, len(flat), 1 << 15):
        factor = np.asarray(np.linalg.qr(np.vstack([factor, flat[start : start + (1 << 15)]]), mode="r"))
    return regroup(factor, names, units, tolerance=1e-9)


def _blocks_of(rows: np.ndarray, times: np.ndarray, motions: np.ndarray) -> list[Block]:
    """A block for each run of rows of the same recording; ``motions`` are their numbers (N,)."""
    starts = np.flatnonzero(np.append(True, motions[1:] != motions[:-1]))
    return [
        Block(rows[a:b], times[a:b], int(motions[a]), True) for a, b in zip(starts, np.append(starts[1:], len(rows)), strict=True)
    ]


@dataclass(frozen=True, eq=False)
class _GivenErrors:
    """Draws of the regressor's errors that were given beside its blocks; methods are what `RegressorNoise` calls."""

    blocks: list[Block]  # the regression's
    errors: np.ndarray  # (draws, samples, channels, p)

    def perturbed(self, draw: int, sign: float) -> Iterator[Block]:
        first = 0
        for block in self.blocks:
            rows = block.rows.copy()
            rows[:, :, :-1] += sign * self.errors[draw, first : first + len(rows)]
            first += len(rows)
            yield replace(block, rows=rows)

    def simulated(self, draw: int | None) -> Iterable[Block]:
        return self.blocks if draw is None else self.perturbed(draw, 1.0)

    def misread(self, draws: int, solution: np.ndarray) -> list[list[np.ndarray]]:
        ends = np.cumsum([len(block.rows) for block in self.blocks])[:-1]
        return [np.split(drawn @ solution, ends) for drawn in self.errors[:draws]]

    def present(self) -> bool:
        return bool(self.errors.any())

    def described(self) -> dict[str, str]:
        return {"regressor_noise": "as given"}

    def law(self) -> RegressorNoise:
        """The law that they are drawn from."""
        return RegressorNoise(
            self.perturbed, self.simulated, self.simulated, self.misread, self.present, self.described, len(self.errors)
        )


@dataclass(frozen=True, eq=False)
class _GivenInstruments:
    """Instruments (samples, channels, p) that were given for the rows of blocks, and the law of the regressor's errors."""

    blocks: list[Block]
    beside: np.ndarray
    noise: RegressorNoise | None

    def pairs(self, regressors: Iterable[Block] | None = None) -> Iterator[Pair]:
        """Blocks, default the regression's, beside their instruments."""
        first = 0
        for block in self.blocks if regressors is None else regressors:
            rows = np.concatenate([self.beside[first : first + len(block.rows)], block.rows[:, :, -1:]], axis=2)
            yield Pair(block, replace(block, rows=rows))
            first += len(block.rows)

    def drawn(self, draw: int) -> Iterator[Pair]:
        """`pairs` with the errors of a draw."""
        assert self.noise is not None
        return self.pairs(self.noise.perturbed(draw, 1.0))

    def described(self) -> dict[str, list[str]]:
        return {"instruments": ["as given"]}

    def instruments(self) -> Instruments:
        """Instruments as estimators take them."""
        return Instruments(self.pairs, self.described, None if self.noise is None else self.drawn)
