"""Parts of a regression made from arrays of one's own, with what is wrong about them said."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayesid.dynamics.base_parameters import BaseParameters, regroup
from bayesid.errors import InputError
from bayesid.regression.blocks import Block, Instruments, Pair, RegressorNoise


def checked_pair(matrix: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Regressor (samples, channels, parameters) and measurements (samples, channels) as finite arrays, or an `InputError`."""
    matrix, target = np.asarray(matrix, float), np.asarray(target, float)
    if matrix.ndim != 3 or target.shape != matrix.shape[:2]:
        raise InputError(
            f"matrix {matrix.shape} and target {target.shape}: give (samples, channels, parameters) and (samples, channels)"
        )
    for name, array in (("matrix", matrix), ("target", target)):
        _require_finite(name, array)
    return matrix, target


def checked_like(given: np.ndarray | None, matrix: np.ndarray, argument: str, axes: int) -> np.ndarray | None:
    """An optional finite array of so many axes, the last three of which are the matrix's, or an `InputError`."""
    if given is None:
        return None
    array = np.asarray(given, float)
    if array.ndim != axes or array.shape[-3:] != matrix.shape or not array.size:
        wanted = "(samples, channels, parameters)" if axes == 3 else "(draws, samples, channels, parameters)"
        raise InputError(f"{argument} has shape {array.shape} beside a matrix of {matrix.shape}; give {wanted}")
    _require_finite(argument, array)
    return array


def checked_noise(given: Sequence[float] | np.ndarray | None, shape: tuple[int, ...]) -> np.ndarray | None:
    """Known standard deviations (channels,) or (samples, channels) as a finite array above zero, or an `InputError`."""
    if given is None:
        return None
    std = np.asarray(given, float)
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


def names_of(given: Sequence[str] | None, count: int, letter: str, argument: str) -> tuple[str, ...]:
    """Names as given, one for each column, or numbered ones; an `InputError` where there are more or fewer."""
    if given is None:
        return tuple(f"{letter}{k + 1}" for k in range(count))
    if len(given) != count:
        raise InputError(f"{argument} has {len(given)} names for {count} columns")
    return tuple(given)


def base_of(matrix: np.ndarray, names: tuple[str, ...], units: tuple[str, ...]) -> BaseParameters:
    """Base parameters of a regressor, whose columns may depend on each other."""
    flat = matrix.reshape(-1, matrix.shape[2])
    factor = np.zeros((0, flat.shape[1]))
    for start in range(0, len(flat), 1 << 15):
        factor = np.asarray(np.linalg.qr(np.vstack([factor, flat[start : start + (1 << 15)]]), mode="r"))
    return regroup(factor, names, units, tolerance=1e-9)


def blocks_of(rows: np.ndarray, times: np.ndarray, motions: np.ndarray, labels: list) -> list[Block]:
    """A block for each run of rows of the same recording."""
    starts = np.flatnonzero(np.append(True, motions[1:] != motions[:-1]))
    return [
        Block(rows[a:b], times[a:b], labels.index(motions[a].item()), True)
        for a, b in zip(starts, np.append(starts[1:], len(rows)), strict=True)
    ]


@dataclass(frozen=True, eq=False)
class GivenErrors:
    """Draws of the regressor's errors that were given beside its blocks."""

    blocks: list[Block]  # the regression's
    errors: np.ndarray  # (draws, samples, channels, p)

    def perturbed(self, draw: int, sign: float) -> Iterator[Block]:
        """The blocks with the errors of a draw, times the sign, added."""
        first = 0
        for block in self.blocks:
            rows = block.rows.copy()
            rows[:, :, :-1] += sign * self.errors[draw, first : first + len(rows)]
            first += len(rows)
            yield replace(block, rows=rows)

    def simulated(self, draw: int | None) -> Iterable[Block]:
        """The blocks themselves (None), or with the errors of a draw."""
        return self.blocks if draw is None else self.perturbed(draw, 1.0)

    def misread(self, draws: int, solution: np.ndarray) -> list[list[np.ndarray]]:
        """What the errors of each draw add to ``X b``, block by block."""
        ends = np.cumsum([len(block.rows) for block in self.blocks])[:-1]
        return [np.split(drawn @ solution, ends) for drawn in self.errors[:draws]]

    def present(self) -> bool:
        """Whether there are any."""
        return bool(self.errors.any())

    def described(self) -> dict[str, str]:
        """Say where the errors come from, for the document."""
        return {"regressor_noise": "as given"}

    def law(self) -> RegressorNoise:
        """The law that they are drawn from."""
        return RegressorNoise(
            self.perturbed, self.simulated, self.simulated, self.misread, self.present, self.described, len(self.errors)
        )


@dataclass(frozen=True, eq=False)
class GivenInstruments:
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
        """Say where the instruments come from, for the document."""
        return {"instruments": ["as given"]}

    def instruments(self) -> Instruments:
        """Instruments as estimators take them."""
        return Instruments(self.pairs, self.described, None if self.noise is None else self.drawn)


def as_given(blocks: list[Block]) -> list[Block]:
    """Blocks that are there already, as a source of rows."""
    return blocks
