"""The noise of the rows, and whether the model is complete enough to take residuals for it.

Both are learned on a pilot: all rows of an ordinary recording, evenly spread parts of a long one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from bayesid.estimators.dispersion import Dispersion, Rows, dispersions, widening
from bayesid.estimators.factor import Factor, Pilot, pilot_of, regressor_times, whitened
from bayesid.estimators.sensor_noise import sensor_noise
from bayesid.regression.blocks import Block, RegressorNoise
from bayesid.regression.hypothesis_tests import hausman
from bayesid.regression.linalg import pseudo_inverse, solve, standard_deviations
from bayesid.regression.regression import Regression
from bayesid.signals.noise import NoiseModel, estimate_noise, memoryless, student_factor

#: Rounds of estimating the noise, at most, and the largest change of a round after which no other is needed, relative to the
#: noise's power and to one.
_PASSES, _SETTLED = 3, 1e-4
#: Draws of encoder errors that ring that their spectrum is averaged over, and the seed of the noise that is added to them.
_DRAWS, _SEED = 16, 36
#: Two fits contradict each other when their difference is less probable than the first, and the efficient one's
#: residuals have more than the second times the power of the plain one's. Either alone happens by chance, for weights are
#: estimated: of 1,350 complete models like those of tests/estimators/test_estimators.py, of 200 rows or more and noise
#: correlated by 0 to 0.9, the first happened in 73, the power at most 1.009 times as large then.
SMALLEST_AGREEMENT = 1e-4
LARGEST_LOSS = 1.02
#: An efficient fit whose parts scatter more than noise explains, with a smaller probability than this, is not efficient.
SMALLEST_PARTS = 1e-4


@dataclass(frozen=True)
class Weights:
    """What the noise looks like and where that was learned."""

    noise: dict[str, NoiseModel]  # noise model of each group of rows
    #: Probability that generalised and channel-weighted least squares differ as much as they do when the model is complete (a
    #: Hausman test [Hausman1978]_): when it is tiny, something is missing in the model.
    agreement: float
    #: Whether residuals may be taken for noise alone: ``agreement`` allows it, and the efficient fit scatters between parts of
    #: the recording no more than noise explains. Where ``agreement`` does not, the noise is that of the channel-weighted
    #: residuals, model error included; else that of an efficient fit.
    complete: bool
    solution: np.ndarray  # of the channel-weighted fit to the pilot (p,)
    #: Dispersion of the channel-weighted fit between parts of the recording over what ``noise`` allows
    #: (`bayesid.estimators.dispersion`).
    scatter: Dispersion = Dispersion()
    efficient: Dispersion = Dispersion()  # that of the efficient fit
    #: That of each channel, by name; none where the model is complete: how much they differ is mostly chance there.
    channels: dict[str, Dispersion] = field(default_factory=dict)
    #: Whether rows are weighted by the noise even if the model lacks something, for it is not learned from residuals alone.
    by_noise: bool = False

    @cached_property
    def factors(self) -> np.ndarray:
        """Factor of each channel's noise variance in the covariance of a fit weighted by channel (c,), or of all (1,)."""
        return widening(self.scatter, list(self.channels.values()))

    @property
    def widened(self) -> bool:
        """Whether parts scatter by more than the noise model says."""
        return bool(np.any(self.factors > 1.0))

    @property
    def dispersion(self) -> float:
        """Mean of `factors`, each with its channel's share of the covariance."""
        sizes = [c.size for c in self.channels.values()] or None
        return float(np.average(self.factors, weights=sizes)) if self.widened else 1.0

    @property
    def dispersion_by_channel(self) -> dict[str, float] | None:
        """`factors` by name; None where they are one."""
        return dict(zip(self.channels, self.factors.tolist(), strict=True)) if self.widened and self.channels else None

    def dispersed(self, noise: dict[str, NoiseModel] | None = None) -> dict[str, NoiseModel]:
        """Noise (default `noise`) as large as the scatter between parts of the recording says, and as few rows leave it open."""
        return {g: m.scaled(self.factors) for g, m in self.unsure(noise).items()}

    def unsure(self, noise: dict[str, NoiseModel] | None = None) -> dict[str, NoiseModel]:
        """Noise (default `noise`) as large as few rows of a group leave it open."""
        noise = self.noise if noise is None else noise
        return {g: m.scaled(student_factor(m.degrees)) for g, m in noise.items()}


def learn_weights(regression: Regression) -> Weights:
    """Estimate the noise from residuals of a pilot.

    Channel-weighted least squares comes first. Rounds of generalised least squares then follow, so that the
    colour of the noise is not hidden by parameters that followed it. But an efficient fit trusts whatever is
    quiet, so on a model with something missing it goes astray: where the two fits differ by more than the noise
    explains, the residuals of the first one count. A regression's weights are learned once for all estimators.
    """
    return regression.rows.derived("weights", lambda: _learned(regression))


def _learned(regression: Regression) -> Weights:
    pilot = pilot_of(regression.rows)
    blocks = pilot.blocks
    scale = np.ones(blocks[0].rows.shape[1])
    plain = np.zeros(0)
    for _ in range(2):
        factor = pilot.weighted(scale)
        plain = solve(factor.matrix, factor.target)
        residual = [b.residual(plain) for b in blocks]
        power = np.sum([np.sum(r**2, axis=0) for r in residual], axis=0) / sum(len(r) for r in residual)
        scale = np.sqrt(np.maximum(power, 1e-20 * max(power.max(), 1e-200)))
    known = stated_noise(regression)
    if known is not None:  # and what exceeds it is for `bayesid.estimators.fit` to tell
        return Weights(known, 1.0, True, plain)
    law = regression.regressor_noise
    if law is not None and law.rung and law.present():
        return _with_rung_errors(regression, law, pilot, plain)
    first = noise = noise_of_residuals(regression, blocks, plain)
    efficient = plain
    for _ in range(_PASSES):
        factor, before = pilot.whitened(noise), noise
        efficient = solve(factor.matrix, factor.target)
        noise = noise_of_residuals(regression, blocks, efficient, factor)
        if _settled(before, noise):
            break
    white = [rows for _, rows in whitened(pilot.orthonormal, noise)]
    middle = _middle(pilot, noise, scale)
    agreement = _agreement(pilot.factor_of(white), pilot.weighted(scale), middle, plain - efficient)
    power = [sum(np.sum((b.residual(x) / scale) ** 2) for b in blocks) for x in (plain, efficient)]
    complete = bool(agreement > SMALLEST_AGREEMENT or power[1] <= LARGEST_LOSS * power[0])
    (found,) = dispersions(Rows(pilot.segments(white)), efficient)
    if not complete:
        noise = first
        for _ in range(_PASSES):
            before, noise = noise, noise_of_residuals(regression, blocks, plain, pilot.whitened(noise))
            if _settled(before, noise):
                break
        middle = _middle(pilot, noise, scale)
    complete = complete and not found.beyond_chance(SMALLEST_PARTS)
    rows = [b.rows / scale[:, None] for b in pilot.orthonormal]
    names = () if complete else regression.channel_names
    channels = [
        Rows(pilot.segments([r[:, c : c + 1] for r in rows]), _channel_middle(pilot, noise, scale, c)) for c in range(len(names))
    ]
    scatter, *parts = dispersions(Rows(pilot.segments(rows), middle), plain, channels)
    return Weights(noise, agreement, complete, plain, scatter, found, dict(zip(names, parts, strict=True)))


def _with_rung_errors(regression: Regression, law: RegressorNoise, pilot: Pilot, plain: np.ndarray) -> Weights:
    """The noise where a model rings with the encoders' errors: those simulated, and beside them what the fit leaves.

    Rows weighted by channel alone would be fitted best without any ringing, for then the errors do not ring either; and residuals
    of such a fit do not show how loud they are. So the spectrum of what the model makes of the errors is known from simulation
    where it is linearised, and only what is left beside them is learned (`bayesid.estimators.sensor_noise`).
    """
    blocks, drawn = list(law.pieces(None)), law.misread(_DRAWS, plain)
    rng = np.random.default_rng(_SEED)
    values, spread = plain, None
    noise: dict[str, NoiseModel] = {}
    for _ in range(_PASSES):
        noise = noise_of_residuals(regression, pilot.blocks, values)
        own = [b for b in pilot.blocks if b.group == "trajectory"]
        errors = [[e for b, e in zip(blocks, draw, strict=True) if b.group == "trajectory"] for draw in drawn]
        beside = sensor_noise(
            [b.residual(values) for b in own], errors, [] if spread is None else [regressor_times(b, spread) for b in own],
            regression.rows.known_poles,
        )  # fmt: skip
        together = [error + beside.drawn(len(error), rng) for draw in errors for error in draw]
        noise["trajectory"] = estimate_noise(together, known_poles=regression.rows.known_poles)
        factor = pilot.whitened(noise)
        values, spread = solve(factor.matrix, factor.target), pseudo_inverse(factor.matrix)
    (found,) = dispersions(Rows(pilot.segments([rows for _, rows in whitened(pilot.orthonormal, noise)])), values)
    return Weights(noise, 1.0, not found.beyond_chance(SMALLEST_PARTS), values, found, found, by_noise=True)


def stated_noise(regression: Regression) -> dict[str, NoiseModel] | None:
    """Noise of each group of rows where it is known beforehand, else None."""
    if regression.noise_std is None:
        return None
    groups = dict.fromkeys(block.group for block in regression.rows.pilot())
    poles = regression.rows.known_poles
    return {g: NoiseModel.stated(regression.noise_std, poles if g == "trajectory" else None) for g in groups}


def _left(blocks: Sequence[Block], parameters: int) -> dict[str, float]:
    """Rows of each group less its share of what so many parameters take from them."""
    rows = {g: sum(len(b.rows) for b in blocks if b.group == g) for g in dict.fromkeys(b.group for b in blocks)}
    taken = parameters / sum(rows.values()) / blocks[0].rows.shape[1]
    return {g: max(n * (1.0 - taken), 1.0) for g, n in rows.items()}


def noise_of_residuals(
    regression: Regression, blocks: Sequence[Block], values: np.ndarray, efficient: Factor | None = None
) -> dict[str, NoiseModel]:
    """Noise of each group of rows from the residuals of a fit; of an efficient one if its factor is given."""
    known = stated_noise(regression)
    if known is not None:
        return known
    noise, left = {}, _left(blocks, len(values))
    root = None if efficient is None else pseudo_inverse(efficient.matrix)
    for group in dict.fromkeys(b.group for b in blocks):
        own = [b for b in blocks if b.group == group]
        taken = (sum(len(b.rows) for b in own) - left[group]) * own[0].rows.shape[1]
        noise[group] = estimate_noise(
            [b.residual(values) for b in own],
            parameters=round(taken),
            known_poles=regression.rows.known_poles if group == "trajectory" else None,
            highest_order=0 if group == "poses" else 24,
            spread=None if root is None else [regressor_times(b, root) for b in own],
        )
        noise[group] = noise[group].with_sure_correlations(left[group])
        if group == "poses":  # of which there are few
            noise[group] = noise[group].with_sure_sizes(left[group], regression.channel_units)
    return noise


def _settled(before: dict[str, NoiseModel], after: dict[str, NoiseModel]) -> bool:
    """Whether a round has changed next to nothing."""
    return all(
        old.order == new.order
        and np.abs(old.coefficients - new.coefficients).max() <= _SETTLED
        and np.abs(old.innovation - new.innovation).max() <= _SETTLED * np.diag(new.innovation).min()
        for old, new in ((before[group], after[group]) for group in after)
    )


def _agreement(efficient: Factor, plain: Factor, middle: np.ndarray, difference: np.ndarray) -> float:
    """Probability of a difference, channel-weighted fit less efficient one (p,), as large as this one.

    Under a complete model ``d = b_wls - b_gls`` has covariance ``V_wls - V_gls``, of what the rows determine: along the rest
    each fit stays where it began. ``middle`` is that of the sandwich around the channel-weighted fit's covariance (p, p).
    """
    shown = ~(plain.undetermined | efficient.undetermined)
    outer, own = (f.inverse @ f.inverse.T for f in (plain, efficient))
    covariance = outer @ middle @ outer
    size = standard_deviations(covariance, 1e-300)[shown]
    gap = (covariance - own)[np.ix_(shown, shown)]
    # Where the two fits are almost equally sure, the tiny difference is one of estimated weights, not of fits.
    return hausman(difference[shown], gap, size, 0.05).probability


def _middle(pilot: Pilot, noise: dict[str, NoiseModel], scale: np.ndarray) -> np.ndarray:
    """``X' W Sigma W X`` of rows weighted by channel (p, p)."""
    return pilot.gram(lambda b, x: noise[b.group].colour_transposed(x / scale[:, None] ** 2), row_by_row=memoryless(noise))


def _channel_middle(pilot: Pilot, noise: dict[str, NoiseModel], scale: np.ndarray, channel: int) -> np.ndarray:
    """`_middle` of one channel's rows alone (p, p)."""
    only, own = slice(channel, channel + 1), {g: m.of_channel(channel) for g, m in noise.items()}
    return pilot.gram(lambda b, x: own[b.group].colour_transposed(x[:, only] / scale[channel] ** 2))
