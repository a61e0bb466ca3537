"""Run chains until they have converged, with checkpoints and a limit."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import Any, Protocol, TypeVar

import numpy as np

from bayesid.arguments import argument
from bayesid.errors import InputError
from bayesid.posterior.checkpoint import load_checkpoint, save_checkpoint
from bayesid.posterior.diagnostics import Convergence, convergence
from bayesid.posterior.ensemble import Ensemble
from bayesid.posterior.model import PosteriorModel
from bayesid.posterior.reflective_gibbs import ReflectiveGibbs
from bayesid.tasks import map_tasks

ENGINES = ("hmc", "emcee")
_ROUNDS = 10
#: Draws a chain to be asked for at least, and draws in all that convergence is judged by at least.
_FEWEST, _JUDGED = 50, 1600


S = TypeVar("S")


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


class Engine(Protocol[S]):
    """What moves the chains; a state S is a dataclass that holds everything a chain needs to go on."""

    @property
    def name(self) -> str:
        """What results call it."""
        ...

    @property
    def walkers(self) -> int:
        """Points that a chain consists of."""
        ...

    @property
    def thin(self) -> int:
        """Steps from one draw to the next."""
        ...

    def start(self, rng: np.random.Generator) -> S:
        """A first state, warmed up."""
        ...

    def restored(self, saved: Mapping[str, Any]) -> S:
        """The state that was saved as its fields."""
        ...

    def advance(self, state: S, count: int, thin: int) -> np.ndarray:
        """Draws (count, walkers, names), ``thin`` steps apart; the state moves on in place."""
        ...


@dataclass(frozen=True, eq=False)
class Chains:
    """What a run gives."""

    #: (chains, draws, names); of an ensemble walker by walker, so that what correlation is left stands side by side and is
    #: counted.
    draws: np.ndarray
    engine: str  # its name
    thin: int  # steps from one kept draw to the next, beyond the engine's own
    states: list[Any]  # last states of the chains
    #: By at least 1600 draws, of all numbers sampled, and of the base parameters where the links are sampled.
    diagnosis: Convergence


def choose_engine(model: PosteriorModel, engine: str | None = None, moves: str = "laplace") -> Engine[Any]:
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
    engine: Engine[Any],
    *,
    draws: int = 2000,
    chains: int = 4,
    seed: int = 0,
    longest: int = 32,
    checkpoint: Path | None = None,
    resume: bool = False,
    tell: Callable[[str], None] | None = None,
    stop_after: int | None = None,
) -> Chains:
    """Sample until the chains agree.

    Chains start far apart with generators of their own. Where they do not pass the checks, every second draw is
    dropped and they run on at twice the distance, so that memory does not grow. Of few draws nothing can be said: then
    more are made, and those asked for picked evenly.

    Parameters
    ----------
    model, engine
        What is sampled and how.
    draws, chains
        Kept in all, and the number of independent chains they come from.
    seed
        Same seed, same draws; also if the run was interrupted and resumed.
    longest
        Stop when draws would have to be more than so many times the engine's own distance apart.
    checkpoint
        File that the run is saved in after every tenth; None: nowhere.
    resume
        Go on from the checkpoint, if there is one.
    tell
        Called with how far the run is, in words.
    stop_after
        Stop after so many rounds, as an interruption would; for tests.

    Raises
    ------
    InputError
        Numbers out of range, or a checkpoint of another run.
    KeyboardInterrupt
        Also by ``stop_after``; the checkpoint holds what was done.
    """
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
        sequences = np.random.SeedSequence(seed).spawn(chains)
        states = list(map_tasks(partial(_started, engine), sequences))
        kept, thin, rounds = np.empty((chains, 0, engine.walkers, len(model.names))), 1, 0
    else:
        states = [engine.restored(state) for state in saved["states"]]
        kept, thin, rounds = saved["kept"], saved["thin"], saved["rounds"]
    size = max(-(-wanted // _ROUNDS), 1)
    while True:
        while kept.shape[1] < wanted:
            if stop_after is not None and rounds >= stop_after:
                raise KeyboardInterrupt
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
        diagnosis = convergence(*_monitored(model, flat))
        if diagnosis.passed or thin >= longest:
            even = np.linspace(0, each - 1, asked).astype(int)
            return Chains(flat[:, even], engine.name, thin, states, diagnosis)
        kept, thin = kept[:, 1::2], 2 * thin


def _started(engine: Engine[S], sequence: np.random.SeedSequence) -> S:
    return engine.start(np.random.Generator(np.random.PCG64(sequence)))


def _advanced(engine: Engine[S], count: int, thin: int, state: S) -> tuple[S, np.ndarray]:
    """The state that a chain has moved on to, and its draws."""
    draws = engine.advance(state, count, thin)
    return state, draws


def _monitored(model: PosteriorModel, draws: np.ndarray) -> tuple[np.ndarray, tuple[str, ...]]:
    """What must have converged: everything sampled, and the base parameters."""
    if model.prior is None:
        return draws, model.names
    base = draws[..., : model.link_count] @ model.base.matrix.T
    return np.concatenate([draws, base], axis=-1), model.names + model.base.names


def fingerprint(model: PosteriorModel, engine: Engine[Any], draws: int, chains: int, seed: int) -> str:
    """What a checkpoint belongs to: data, model, engine and seed."""
    digest = sha256()
    for array in (model.likelihood.factors, model.likelihood.counts, model.to_columns, model.prior_factor):
        digest.update(np.ascontiguousarray(array).tobytes())
    settings = [model.names, model.noise, str(model.scale_prior), str(model.dof_prior), model.physical, engine.name,
                engine.walkers, getattr(engine, "moves", ""), draws, chains, seed]  # fmt: skip
    digest.update(json.dumps(settings).encode())
    return digest.hexdigest()
