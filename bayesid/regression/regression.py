"""The linear model that estimators take: what its columns mean, its rows, and what is known beside them.

Rows are a stream of blocks that can be read as often as needed (`bayesid.regression.row_cache`), from an experiment
(`bayesid.regression.problem`) or from arrays of one's own.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial

import numpy as np

from bayesid.dynamics.base_parameters import BaseParameters
from bayesid.errors import InputError
from bayesid.regression import arrays
from bayesid.regression.blocks import Block, Instruments, RegressorNoise
from bayesid.regression.row_cache import RowCache
from bayesid.robot.prior import Prior
from bayesid.signals.filters import LowPass


@dataclass(frozen=True)
class PriorKnowledge:
    """What is known of the parameters before any row is read.

    Attributes
    ----------
    nominal_links
        Link parameters of the nominal model, in the order of ``base.parameter_names`` (P,), if there is one.
    inertia_rel_std
        Their prior relative standard deviation, see `bayesid.robot.prior.Prior.warped`; 0: exact, None: not known.
    guessed_links
        Where that model states no masses: about what links of these lengths weigh (P,), see `bayesid.robot.typical`.
    bodies
        Columns of ``base.parameter_names`` that are a body's ten parameters.
    effect_non_negative
        Which effect parameters cannot be negative; empty: none.
    """

    nominal_links: np.ndarray | None = None
    inertia_rel_std: float | None = None
    bodies: tuple[tuple[int, ...], ...] = ()
    effect_non_negative: tuple[bool, ...] = ()
    guessed_links: np.ndarray | None = None

    @property
    def states_masses(self) -> bool:
        """Whether there is a nominal model that says anything of the bodies."""
        return self.nominal_links is not None and self.guessed_links is None


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
        if self.knowledge.nominal_links is None:
            return None
        covariance = Prior.nominal(self.knowledge.nominal_links, 2.0**0.5).covariance
        return np.sqrt(np.einsum("ij,jk,ik->i", self.base.matrix, covariance, self.base.matrix))

    # ---- rows ---------------------------------------------------------------------------------------------------

    def blocks(self) -> Iterator[Block]:
        """Read all blocks, recording by recording, in time order."""
        return self.rows.blocks()

    def pilot(self) -> Sequence[Block]:
        """Enough blocks to learn the noise from: all of an ordinary recording, segments of a long one."""
        return self.rows.pilot()

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
        matrix, target = arrays.checked_pair(matrix, target)
        samples, channels, p = matrix.shape
        beside = arrays.checked_like(instruments, matrix, "instruments", 3)
        errors = arrays.checked_like(regressor_noise, matrix, "regressor_noise", 4)
        known = arrays.checked_noise(noise_std, target.shape)
        if known is not None and known.ndim == 2:
            if low_pass is not None:
                raise InputError("noise_std by sample goes without low_pass, which mixes samples; give one number a channel")
            matrix, target = matrix / known[:, :, None], target / known
            beside = None if beside is None else beside / known[:, :, None]
            errors = None if errors is None else errors / known[:, :, None]
            known = np.ones(channels)
        names = arrays.names_of(parameter_names, p, "p", "parameter_names")
        channel = arrays.names_of(channel_names, channels, "y", "channel_names")
        units = arrays.names_of(parameter_units, p, "1", "parameter_units") if parameter_units else ("1",) * p
        ids = np.zeros(samples, int) if motions is None else np.asarray(motions)
        if len(ids) != samples or (times is not None and len(times) != samples):
            raise InputError(f"times and motions must have one entry for each of the {samples} samples")
        if low_pass is not None and times is None:
            raise InputError("low_pass is given without times; give the times of the samples, too")
        clock = np.arange(samples, dtype=float) if times is None else np.asarray(times, float)
        labels = list(dict.fromkeys(ids.tolist()))
        base = arrays.base_of(matrix, names, units)
        kept = base.independent
        blocks = arrays.blocks_of(np.concatenate([matrix[:, :, kept], target[:, :, None]], axis=2), clock, ids, labels)
        noise = None if errors is None else arrays.GivenErrors(blocks, errors[:, :, :, kept]).law()
        poles = None
        if low_pass is not None:
            poles = low_pass.poles(float(np.median(np.diff(clock[: len(blocks[0].times)]))))
        return cls(
            base, (), (), channel, ("",) * channels, tuple(str(k) for k in labels),
            RowCache(
                partial(arrays.as_given, blocks), samples, channels * (len(base.names) + 1), known_poles=poles, kept=tuple(blocks)
            ),
            PriorKnowledge(bodies=tuple(tuple(b) for b in bodies)),
            instruments=None if beside is None else arrays.GivenInstruments(blocks, beside[:, :, kept], noise).instruments(),
            regressor_noise=noise,
            noise_std=known,
        )  # fmt: skip
