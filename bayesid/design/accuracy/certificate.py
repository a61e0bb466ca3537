"""Coverage certificate: how often the intervals of this very experiment and estimator hold the truth.

Twins of the recordings are made with fresh noise and fitted by the whole procedure, bandwidth and noise included, and every
interval is asked whether it holds the truth. Of N twins, exact intervals would hold it in a binomial number; the band is the one
in which all base parameters together lie with a probability of 99 % (Bonferroni).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import beta, binom

from bayesid.arguments import argument, call
from bayesid.design.accuracy.bench import Bench, own_setting, twin
from bayesid.design.accuracy.fits import fit_twin
from bayesid.errors import BayesidError, EstimationError, InputError
from bayesid.estimators.estimator import LEVEL
from bayesid.posterior.checkpoint import load_checkpoint, mark_of, save_checkpoint
from bayesid.regression.parallel import in_order
from bayesid.tasks import map_tasks

#: Probability that exact intervals of all parameters stay within the band.
SIMULTANEOUS = 0.99
#: Fewest twins whose band says anything.
FEWEST = 20
_KEPT_EVERY = 10
_SEEDS = 7_000_003


@dataclass(frozen=True)
class CoverageCertificate:
    """Coverage found on twins."""

    names: tuple[str, ...]  # of the base parameters (r,)
    inside: np.ndarray  # twins whose interval held the truth (r,)
    counted: np.ndarray  # twins that had an interval (r,)
    #: How many were fitted, and how many could not be.
    twins: int
    refused: int
    #: Mean and standard deviation of error over the estimate's own standard deviation (r,).
    mean_z: np.ndarray
    std_z: np.ndarray
    #: Coverage of all parameters together, and its standard error from twin to twin.
    overall: float
    overall_error: float
    #: The estimator, and what the twins were drawn from.
    method: str
    seed: int

    @property
    def coverage(self) -> np.ndarray:
        """Share of intervals that held the truth (r,); nan where there was none."""
        return np.where(self.counted > 0, self.inside / np.maximum(self.counted, 1), np.nan)

    @property
    def band(self) -> tuple[float, float]:
        """Coverage that exact intervals keep to, all parameters at once."""
        tail = (1.0 - SIMULTANEOUS) / len(self.names) / 2.0
        n = max(self.twins, 1)
        return float(binom.ppf(tail, n, LEVEL) / n), float(binom.ppf(1.0 - tail, n, LEVEL) / n)

    @property
    def intervals(self) -> np.ndarray:
        """95 % intervals of each coverage (2, r), of Clopper and Pearson."""
        k, n = self.inside, self.counted
        low = np.where(k > 0, beta.ppf(0.025, np.maximum(k, 1), n - k + 1), 0.0)
        high = np.where(k < n, beta.ppf(0.975, k + 1, np.maximum(n - k, 1)), 1.0)
        return np.array([low, high])

    @property
    def holds(self) -> bool:
        """Whether no parameter's coverage is below the band."""
        known = self.counted > 0
        return bool(np.all(self.coverage[known] >= self.band[0] - 1e-12))

    def to_dict(self) -> dict[str, Any]:
        """The key ``certificate`` of ``estimate.json`` and ``accuracy.json``."""
        low, high = self.intervals
        parameters = [
            {"name": n, "coverage": float(c), "low": float(a), "high": float(b), "mean_z": float(m), "std_z": float(s)}
            for n, c, a, b, m, s in zip(self.names, self.coverage, low, high, self.mean_z, self.std_z, strict=True)
            if np.isfinite(c)
        ]
        return {
            "twins": self.twins, "refused": self.refused, "method": self.method, "seed": self.seed, "level": LEVEL,
            "coverage": float(self.overall), "coverage_std": float(self.overall_error),
            "band": {"low": self.band[0], "high": self.band[1], "probability": SIMULTANEOUS},
            "holds": self.holds, "parameters": parameters,
        }  # fmt: skip


def check_certifiable(bench: Bench, count: int) -> None:
    """Refuse what no certificate can be made of: a method without intervals, or too few twins."""
    if bench.estimate.full_covariance is None or bench.estimate.interval == "none":
        reason = bench.estimate.interval_reason or "none is honest"
        raise InputError(
            f"certificate: method {bench.method.name} prints no intervals ({reason}); choose another {argument('method')}"
        )
    if count < FEWEST:
        raise InputError(f"{argument('certificate', count)}: give at least {FEWEST}; 400 tell coverage to about 1 %")


def certify(
    bench: Bench, count: int, seed: int, tell: Callable[[str], object], kept: Path | None = None, resume: bool = False
) -> CoverageCertificate:
    """Simulate ``count`` twins, fit each, and count which intervals hold the truth.

    ``kept`` is a file that keeps the twins fitted so far, with which ``resume`` goes on; an interruption loses at most the last
    few. An `InputError` as `check_certifiable`, or where the file belongs to another run; an `EstimationError` where hardly any
    twin can be fitted.
    """
    check_certifiable(bench, count)
    setting, mark = own_setting(bench), _mark(bench, seed)
    done: list[np.ndarray] = []
    if kept is not None and resume and (stored := load_checkpoint(kept, mark)) is not None:
        done = list(stored["kept"][:count])

    def fitted(number: int) -> np.ndarray:
        try:
            problem, estimate = fit_twin(bench, setting, twin(bench, setting, _SEEDS * (seed + 1) + number))
        except BayesidError:
            return np.full((3, bench.rank), np.nan)
        truth = problem.row_model.base.matrix @ bench.links.ravel()
        inside = (estimate.low <= truth) & (truth <= estimate.high)
        return np.array([estimate.values - truth, estimate.std, np.where(np.isfinite(estimate.std), inside, np.nan)])

    def keep() -> None:
        if kept is not None and done:
            save_checkpoint(kept, mark, {"kept": np.array(done)})

    try:
        for k, each in enumerate(map_tasks(fitted, range(len(done), count), locally=in_order)):
            done.append(each)
            tell(f"certificate: {len(done)} of {count} twins")
            if k % _KEPT_EVERY == _KEPT_EVERY - 1:
                keep()
    finally:
        keep()
    return _counted(bench, np.array(done), seed)


def _counted(bench: Bench, found: np.ndarray, seed: int) -> CoverageCertificate:
    """The certificate of errors, standard deviations and hits of every twin (twins, 3, r)."""
    usable = np.isfinite(found[:, 0]).all(axis=1)
    fine = found[usable]
    if len(fine) < FEWEST:
        raise EstimationError(
            f"only {len(fine)} of {len(found)} twins could be fitted; check the recordings with {call('check')}"
        )
    error, std, inside = fine[:, 0], fine[:, 1], fine[:, 2]
    known = np.isfinite(inside)
    counted = known.sum(axis=0)
    z = np.where(known, error / np.where(known, std, 1.0), 0.0)
    mean = z.sum(axis=0) / np.maximum(counted, 1)
    spread = np.sqrt(np.where(known, (z - mean) ** 2, 0.0).sum(axis=0) / np.maximum(counted - 1, 1))
    shares = np.where(known, inside, 0.0).sum(axis=1) / np.maximum(known.sum(axis=1), 1)
    return CoverageCertificate(
        bench.problem.row_model.base.names, np.where(known, inside, 0.0).sum(axis=0), counted, len(fine),
        int((~usable).sum()), mean, spread, float(shares.mean()), float(shares.std(ddof=1) / np.sqrt(len(shares))),
        bench.method.name, seed,
    )  # fmt: skip


def _mark(bench: Bench, seed: int) -> str:
    """What a kept file belongs to: the truth, its noise, the motion, how it is fitted, and the seed."""
    truth = (bench.links, bench.truth, bench.noise.innovation, bench.noise.coefficients, bench.position_std)
    positions = (motion.motion.table.positions for motion in bench.motions)
    return mark_of((*truth, *positions), (bench.options, bench.method, bench.resolution, seed))
