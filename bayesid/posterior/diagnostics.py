"""Whether chains have converged: R-hat over independent chains and effective sample sizes [Vehtari2021]_, from ArviZ."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from bayesid.errors import EstimationError
from bayesid.posterior.convert import load_arviz

#: Rank-normalised split R-hat must be below, effective sample sizes of the bulk and the tails above.
LARGEST_R_HAT = 1.01
SMALLEST_ESS = 400.0


class ConvergenceError(EstimationError):
    """The chains did not converge; ``partial`` holds the posterior as far as it came."""

    partial: Any = None


@dataclass(frozen=True, eq=False)
class Convergence:
    """Diagnostics of every sampled number."""

    names: tuple[str, ...]  # (d,)
    #: (d,).
    r_hat: np.ndarray
    ess_bulk: np.ndarray
    ess_tail: np.ndarray

    @property
    def passed(self) -> bool:
        """Whether every number meets the limits."""
        worst = self.r_hat.max(initial=1.0), self.ess.min(initial=np.inf)
        return bool(worst[0] < LARGEST_R_HAT and worst[1] >= SMALLEST_ESS)

    @property
    def ess(self) -> np.ndarray:
        """The smaller of both effective sizes (d,)."""
        return np.minimum(self.ess_bulk, self.ess_tail)

    def complaint(self) -> str:
        """What failed worst, in a line."""
        worst, fewest = int(np.argmax(self.r_hat)), int(np.argmin(self.ess))
        return (
            f"largest R-hat {self.r_hat[worst]:.4g} ({self.names[worst]}, should be below {LARGEST_R_HAT}), smallest "
            f"effective sample size {self.ess[fewest]:.3g} ({self.names[fewest]}, should be at least {SMALLEST_ESS:.0f})"
        )


def convergence(draws: np.ndarray, names: tuple[str, ...]) -> Convergence:
    """Diagnose chains of draws (chains, draws, d)."""
    az = load_arviz()
    moving = np.ptp(draws, axis=(0, 1)) > 0
    out = np.ones((3, len(names)))
    out[1:] = draws.shape[0] * draws.shape[1]
    for k in np.flatnonzero(moving).tolist():
        one = np.ascontiguousarray(draws[:, :, k])
        tail = az.ess(one, method="tail", prob=(0.05, 0.95))
        out[:, k] = az.rhat(one, method="rank"), az.ess(one, method="bulk"), tail
    return Convergence(names, *out)
