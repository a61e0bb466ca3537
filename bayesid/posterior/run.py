"""Run chains until they have converged, with checkpoints and a limit.

Whether they have is told by R-hat over independent chains and effective sample sizes [Vehtari2021]_, from ArviZ.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from bayesid.argument_types import explains_types
from bayesid.arguments import argument
from bayesid.errors import EstimationError, InputError
from bayesid.posterior.checkpoint import load_checkpoint, mark_of, save_checkpoint
from bayesid.posterior.convert import load_arviz
from bayesid.posterior.ensemble import Ensemble
from bayesid.posterior.model import PosteriorModel
from bayesid.posterior.reflective_gibbs import ReflectiveGibbs
from bayesid.tasks import map_tasks

ENGINES = ("hmc", "emcee")
_ROUNDS = 10
#: Draws a chain to be asked for at least, and draws in all that convergence is judged by at least.
_FEWEST, _JUDGED = 50, 1600

#: Rank-normalised split R-hat must be below, effective sample sizes of the bulk and the tails above.
LARGEST_R_HAT = 1.01
SMALLEST_ESS = 400.0
#: What moves the chains: from a state, which holds everything that a chain needs to go on.
Engine = ReflectiveGibbs | Ensemble


@explains_types
@dataclass(frozen=True)
class Sampler:
    """How draws are made, for `bayesid.sample`.

    Attributes
    ----------
    engine
        ``hmc`` (exact trajectories between walls, Gibbs for the noise) or ``emcee``; None: the one that suits.
    moves
        Of emcee: ``laplace``; ``de`` and ``stretch`` alone in few dimensions only.
    chains
        Independent chains that the draws come from.
    longest
        How many times longer to run while chains have not converged, before giving up.
    checkpoint, resume
        File that keeps an unfinished run, and whether to go on from it.
    """

    engine: str | None = None
    moves: str = "laplace"
    chains: int = 4
    longest: int = 32
    checkpoint: str | Path | None = None
    resume: bool = False


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
    draws: int = 0  # by how many of all chains together: more than are kept, where few were asked for

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


@dataclass(frozen=True, eq=False)
class Chains:
    """What a run gives."""

    #: (chains, draws, names); of an ensemble walker by walker, so that what correlation is left stands side by side and is
    #: counted.
    draws: np.ndarray
    engine: str  # its name
    thin: int  # steps from one kept draw to the next, beyond the engine's own
    #: By at least 1600 draws, of all numbers sampled, and of the base parameters where the links are sampled.
    diagnosis: Convergence


def choose_engine(model: PosteriorModel, engine: str | None = None, moves: str = "laplace") -> Engine:
    """The engine of a name; default: exact trajectories where there are walls or Student's weights, else emcee.

    An `InputError` where no engine has this name, or it cannot sample this posterior.
    """
    if engine is None:
        engine = "hmc" if model.bodies or model.noise == "student" or len(model.bounded) else "emcee"
    if engine == "hmc":
        return ReflectiveGibbs(model)
    if engine == "emcee":
        return Ensemble(model, moves)
    raise InputError(f"{argument('engine', engine)}: choose one of {', '.join(ENGINES)}")


def run(
    model: PosteriorModel,
    engine: Engine,
    *,
    draws: int = 2000,
    chains: int = 4,
    seed: int = 0,
    longest: int = 32,
    checkpoint: Path | None = None,
    resume: bool = False,
    tell: Callable[[str], None] | None = None,
) -> Chains:
    """Sample until the chains agree.

    Chains start far apart with generators of their own. Where they do not pass the checks, every second draw is
    dropped and they run on at twice the distance, so that memory does not grow. Of few draws nothing can be said: then
    more are made, and those asked for picked evenly.

    ``draws`` are kept in all; the same seed gives the same ones, also if the run was interrupted and resumed. The run stops when
    they would have to be more than ``longest`` times the engine's own distance apart. It is saved in the checkpoint after every
    tenth and goes on from there to ``resume``; ``tell`` is called with how far it is, in words. An `InputError` where numbers
    are out of range, or a checkpoint is of another run.
    """
    for name, number in (("chains", chains), ("draws", draws), ("longest", longest)):
        if not isinstance(number, (int, np.integer)):
            raise InputError(f"{argument(name, number)}: give a whole number")
    if chains < 2:
        raise InputError(f"{argument('chains', chains)}: at least 2 are needed to see whether they agree")
    if draws < _FEWEST * chains:
        raise InputError(f"{argument('draws', draws)}: give at least {_FEWEST * chains}, {_FEWEST} for each of {chains} chains")
    if longest < 1:
        raise InputError(f"{argument('longest', longest)}: give at least 1")
    asked = -(-draws // chains)
    each = max(asked, -(-_JUDGED // chains))
    wanted = max(-(-each // engine.walkers), 2)
    mark = fingerprint(model, engine, draws, chains, seed)
    saved = load_checkpoint(checkpoint, mark) if resume and checkpoint is not None else None
    if saved is None:
        states = list(map_tasks(engine.start, map(np.random.default_rng, np.random.SeedSequence(seed).spawn(chains))))
        kept, thin, rounds = np.empty((chains, 0, engine.walkers, len(model.names))), 1, 0
    else:
        states = [engine.state_type(**state) for state in saved["states"]]
        kept, thin, rounds = saved["kept"], saved["thin"], saved["rounds"]
    size = max(-(-wanted // _ROUNDS), 1)
    while True:
        while kept.shape[1] < wanted:
            count = min(size, wanted - kept.shape[1])
            advanced = list(map_tasks(partial(_advanced, engine, count, thin), states))
            states = [state for state, _ in advanced]
            kept = np.concatenate([kept, np.stack([new for _, new in advanced])], axis=1)
            rounds += 1
            if tell is not None:
                apart = f", draws {thin} times farther apart" if thin > 1 else ""
                tell(f"sampling{apart}: {100 * kept.shape[1] // wanted} %")
            if checkpoint is not None:
                fields = [vars(state) for state in states]
                save_checkpoint(checkpoint, mark, {"states": fields, "kept": kept, "thin": thin, "rounds": rounds})
        flat = np.swapaxes(kept, 1, 2).reshape(chains, -1, kept.shape[-1])[:, :each]
        # What must have converged: everything sampled, and the base parameters.
        base = np.zeros((*flat.shape[:2], 0)) if model.prior is None else flat[..., : model.link_count] @ model.base.matrix.T
        names = model.names if model.prior is None else model.names + model.base.names
        diagnosis = convergence(np.concatenate([flat, base], axis=-1), names)
        if diagnosis.passed or thin >= longest:
            even = np.linspace(0, each - 1, asked).astype(int)
            return Chains(flat[:, even], engine.name, thin, diagnosis)
        kept, thin = kept[:, 1::2], 2 * thin


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
    return Convergence(names, *out, draws=draws.shape[0] * draws.shape[1])


def _advanced(engine: Engine, count: int, thin: int, state: Any) -> tuple[Any, np.ndarray]:
    """The state that a chain has moved on to, and its draws."""
    draws = engine.advance(state, count, thin)
    return state, draws


def fingerprint(model: PosteriorModel, engine: Engine, draws: int, chains: int, seed: int) -> str:
    """What a checkpoint belongs to: data, model, engine and seed."""
    settings = (model.names, model.noise, model.scale_prior, model.dof_prior, model.physical, engine.name, engine.walkers,
                getattr(engine, "moves", ""), draws, chains, seed)  # fmt: skip
    return mark_of((model.likelihood.factors, model.likelihood.counts, model.to_columns, model.prior_factor), settings)
