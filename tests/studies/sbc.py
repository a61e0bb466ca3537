"""Simulation-based calibration: does the posterior hold the truth as often as it says, for every parameter?

Draw a truth from a proper prior, data from the truth, and a posterior from the data: the rank of the truth among
independent posterior draws is uniform if, and only if on average, sampler, density and prior fit together
[Talts2018]_. ``python -m tests.studies.sbc`` from the repository writes ``docs/studies/sbc``; a run that was
stopped goes on where it was.

The truth's bodies are drawn by rejection, so nothing here shares code with the walls of the sampler.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
import tempfile
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from rich.console import Console
from rich.progress import track
from scipy.stats import binom
from threadpoolctl import threadpool_limits

import bayesid
from bayesid.dynamics.base_parameters import BaseParameters, structural_base
from bayesid.dynamics.channels import torque_channels, wrench_channels
from bayesid.dynamics.regressors import Kernel
from bayesid.posterior.likelihood import DofPrior, Likelihood, ScalePrior
from bayesid.posterior.model import PosteriorModel
from bayesid.posterior.run import choose_engine
from bayesid.robot import inertia
from bayesid.robot.prior import Prior
from bayesid.robot.robot import load_robot
from bayesid.signals.noise import NoiseModel
from bayesid.tasks import cluster, map_tasks
from tests import robots

SEED = 20_260_301
RUNS = 500
DRAWS = 199
CHUNK = 10
FOLDER = Path(__file__).parents[2] / "docs" / "studies" / "sbc"
SCALES = ScalePrior(10.0, 10.0)
DOF = DofPrior()
OFFSET = 5.0  # standard deviation of the offsets' prior, in units of the noise
FRICTION = 20.0  # the same of the friction coefficients'
INSTANTS = 60


@dataclass(frozen=True)
class Case:
    """One robot, one kind of reading, one prior.

    Attributes
    ----------
    trust
        Relative standard deviation of the bodies: 0.05 keeps them far from the cone's walls, 0.5 does not.
    thin
        Sweeps from one draw to the next.
    runs
        At most so many.
    """

    title: str
    urdf: Any
    channel: str
    trust: float
    noise: str = "gaussian"
    engine: str = "hmc"
    thin: int = 2
    runs: int = RUNS


CASES = {
    "ur5-inactive": Case("UR5, torques, cone inactive", robots.ur5, "torque", 0.05),
    "ur5-active": Case("UR5, torques, cone active", robots.ur5, "torque", 0.5),
    "panda-inactive": Case("Panda, wrench, cone inactive", robots.panda, "wrench", 0.05),
    "panda-active": Case("Panda, wrench, cone active", robots.panda, "wrench", 0.5),
    "ur5-student": Case("UR5, wrench, cone active, Student's t", robots.ur5, "wrench", 0.5, noise="student", thin=4, runs=200),
    "ur5-emcee": Case("UR5, wrench, emcee, no cone", robots.ur5, "wrench", 0.05, engine="emcee", thin=3, runs=200),
}


@dataclass(frozen=True, eq=False)
class Setup:
    """What does not change from run to run."""

    case: Case
    base: BaseParameters
    rows: np.ndarray  # (instants, channels, p), in units of the noise
    prior: Prior
    effect_names: tuple[str, ...]
    non_negative: np.ndarray
    effect_std: np.ndarray
    move: np.ndarray  # (k, P): torques of a reference move


@cache
def setup(name: str) -> Setup:
    """Robot, motion and prior of a case."""
    case = CASES[name]
    with tempfile.TemporaryDirectory() as folder:
        robot = load_robot(robots.write(Path(folder), case.urdf()))
    rng = np.random.default_rng(sum(map(ord, name)))
    shape = (INSTANTS, robot.n)
    q, v, a = rng.uniform(-2, 2, shape), rng.normal(size=shape), 4 * rng.normal(size=shape)
    torque, wrench = torque_channels(robot), wrench_channels(robot, np.eye(3), np.zeros(3))
    channels = torque if case.channel == "torque" else wrench
    base = structural_base(robot, channels, offset=case.channel == "wrench")
    rigid = Kernel.of(robot, channels).dynamics(q, v, a)[:, :, base.independent]
    std = np.full(len(channels), 0.3) if case.channel == "torque" else np.repeat([1.0, 0.3], 3)
    if case.channel == "torque":
        n = robot.n
        effects = np.zeros((INSTANTS, n, 2 * n))
        for j in range(n):
            effects[:, j, 2 * j], effects[:, j, 2 * j + 1] = v[:, j] * std[j], np.sign(v[:, j]) * std[j]
        names = tuple(f"{kind}{j + 1}" for j in range(n) for kind in ("viscous", "coulomb"))
        size = FRICTION
    else:
        effects = np.broadcast_to(np.diag(std), (INSTANTS, 6, 6))
        names, size = tuple(f"offset {c}" for c in channels.names), OFFSET
    rows = np.concatenate([rigid, effects], axis=2) / std[:, None]
    move = Kernel.of(robot, torque).dynamics(*(rng.normal(size=(3, 20, robot.n)))).reshape(-1, robot.nominal.size)
    return Setup(
        case, base, rows, replace(Prior.nominal(robot.nominal, case.trust), physical=case.engine == "hmc"), names,
        np.full(len(names), case.channel == "torque"), np.full(len(names), size), move,
    )  # fmt: skip


def draw_truth(case: Setup, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Links, effects, scales and degrees of freedom from the prior; bodies by rejection."""
    links = case.prior.mean.copy()
    for body in map(list, case.prior.bodies):
        root = np.linalg.inv(np.linalg.cholesky(case.prior.precision[np.ix_(body, body)])).T
        while True:
            links[body] = case.prior.mean[body] + root @ rng.normal(size=10)
            if not case.prior.physical or np.linalg.eigvalsh(inertia.pseudo_inertia(links[body]))[0] > 0:
                break
    effects = case.effect_std * rng.normal(size=len(case.effect_std))
    effects = np.where(case.non_negative, np.abs(effects), effects)
    scales = np.sqrt(SCALES.rate / rng.gamma(SCALES.shape, size=case.rows.shape[1]))
    return links, effects, scales, float(rng.gamma(DOF.shape) / DOF.rate)


def draw_data(case: Setup, truth, rng: np.random.Generator) -> Likelihood:
    """Readings of the truth, reduced as the sampler wants them."""
    links, effects, scales, dof = truth
    noise = rng.normal(size=case.rows.shape[:2]) * scales
    if case.case.noise == "student":
        noise /= np.sqrt(rng.gamma(0.5 * dof, size=(INSTANTS, 1)) / (0.5 * dof))
    target = case.rows @ np.concatenate([case.base.matrix @ links, effects]) + noise
    white = np.concatenate([case.rows, target[:, :, None]], axis=2)
    p = white.shape[2]
    factors = []
    for c in range(white.shape[1]):
        r = np.linalg.qr(np.concatenate([white[:, c], np.zeros((p, p))]), mode="r")
        factors.append(r)
    channels = white.shape[1]
    names = tuple(f"y{c + 1}" for c in range(channels))
    return Likelihood(
        np.array(factors), np.full(channels, INSTANTS), names, white=(white,) if case.case.noise == "student" else (),
        noise={"trajectory": NoiseModel(np.ones((channels, 1)), np.eye(channels))},
    )  # fmt: skip


def names_of(name: str) -> list[str]:
    """Every ranked quantity."""
    case = setup(name)
    scales = [f"scale y{c + 1}" for c in range(case.rows.shape[1])]
    dof = ["nu"] if case.case.noise == "student" else []
    return [*case.base.parameter_names, *case.effect_names, *scales, *dof, *case.base.labels,
            "total mass", "log-likelihood", "max |tau| of a reference move"]  # fmt: skip


def quantities(case: Setup, model: PosteriorModel, draws: np.ndarray) -> np.ndarray:
    """Of draws as the model names them (n, names): those of `names_of` (n, q)."""
    links = draws[:, : model.link_count]
    derived = [
        links @ case.base.matrix.T,
        links[:, ::10].sum(axis=1)[:, None],
        model.log_likelihood(*model.split(draws))[:, None],
        np.abs(links @ case.move.T).max(axis=1)[:, None],
    ]
    return np.concatenate([draws, *derived], axis=1)


def one(name: str, seed: int, index: int) -> np.ndarray:
    """Ranks of one run (q,): how many of 199 posterior draws are smaller than the truth."""
    case = setup(name)
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(list(CASES).index(name), index)))
    truth = draw_truth(case, rng)
    model = PosteriorModel(
        case.base, case.effect_names, ("",) * len(case.effect_names), case.non_negative, draw_data(case, truth, rng),
        case.prior, case.case.noise, SCALES, DOF, case.effect_std,
    )  # fmt: skip
    engine = choose_engine(model, case.case.engine)
    state = engine.start(rng)
    if engine.walkers == 1:
        draws = engine.advance(state, DRAWS, case.case.thin)[:, 0]
    else:
        # Walkers of one ensemble at two distant steps; which of them, at random.
        both = engine.advance(state, 2, 10 * case.case.thin).reshape(-1, len(model.names))
        draws = rng.permutation(both)[:DRAWS]
    links, effects, scales, dof = truth
    true = np.concatenate([links, effects, scales, [dof] if model.dof_free else []])
    return np.sum(quantities(case, model, draws) < quantities(case, model, true[None]), axis=0)


def _chunk(name: str, seed: int, first: int, last: int) -> np.ndarray:
    with threadpool_limits(1, user_api="blas"):
        return np.array([one(name, seed, k) for k in range(first, last)])


def run(name: str, runs: int, seed: int, folder: Path | None = None, processes: int = 2) -> np.ndarray:
    """Ranks (runs, q), of which finished chunks are kept in a folder."""
    parts: dict[int, np.ndarray] = {}
    for first in range(0, runs, CHUNK):
        path = None if folder is None else folder / f"{name}-{seed}-{first}-{min(first + CHUNK, runs)}.npy"
        if path is not None and path.exists():
            parts[first] = np.load(path)
    todo = [first for first in range(0, runs, CHUNK) if first not in parts]

    def keep(first: int, ranks: np.ndarray) -> None:
        parts[first] = ranks
        if folder is not None:
            draft = folder / f"{name}-{seed}-{first}.part.npy"
            np.save(draft, ranks)
            draft.replace(folder / f"{name}-{seed}-{first}-{min(first + CHUNK, runs)}.npy")

    console = Console(stderr=True)
    show: dict[str, Any] = {"description": name, "total": len(todo), "console": console, "disable": not console.is_terminal}
    with cluster(processes):
        made = map_tasks(lambda first: _chunk(name, seed, first, min(first + CHUNK, runs)), todo)
        for first, part in zip(todo, track(made, **show), strict=True):
            keep(first, part)
    return np.concatenate([parts[k] for k in sorted(parts)])


@cache
def _law(runs: int, sets: int = 100_000, seed: int = 1) -> np.ndarray:
    """Smallest pointwise tail probability of the ECDF of uniform ranks, for many sets of ranks, sorted [Sailynoja2022]_."""
    rng = np.random.default_rng(seed)
    out = []
    for _ in range(sets // 1000):
        counts = rng.multinomial(runs, np.full(DRAWS + 1, 1.0 / (DRAWS + 1)), size=1000)
        out.append(_smallest(np.cumsum(counts, axis=1)[:, :-1], runs))
    return np.sort(np.concatenate(out))


@cache
def _tails(runs: int) -> np.ndarray:
    """Two-sided tail probability of k of ``runs`` ranks up to each value (DRAWS, runs + 1)."""
    z = np.arange(1, DRAWS + 1)[:, None] / (DRAWS + 1)
    k = np.arange(runs + 1)
    return 2.0 * np.minimum(binom.cdf(k, runs, z), binom.sf(k - 1, runs, z))


def _smallest(cumulative: np.ndarray, runs: int) -> np.ndarray:
    return _tails(runs)[np.arange(DRAWS), cumulative].min(axis=1)


def probabilities(ranks: np.ndarray) -> np.ndarray:
    """How probable so uneven ranks (runs, q) are when all is right: below 0.01 they leave the 99 % band (q,)."""
    runs = len(ranks)
    cumulative = np.array([np.cumsum(np.bincount(r, minlength=DRAWS + 1))[:-1] for r in ranks.T])
    law = _law(runs)
    return (np.searchsorted(law, _smallest(cumulative, runs), side="right") + 1) / (len(law) + 1)


def band(runs: int, level: float) -> tuple[np.ndarray, np.ndarray]:
    """Simultaneous band of the ECDF less its mean, at z = 1 ... DRAWS."""
    law = _law(runs)
    gamma = law[max(int((1 - level) * len(law)) - 1, 0)]
    z = np.arange(1, DRAWS + 1) / (DRAWS + 1)
    return binom.ppf(gamma / 2, runs, z) / runs - z, binom.isf(gamma / 2, runs, z) / runs - z


def summarise(name: str, ranks: np.ndarray) -> dict[str, Any]:
    """What the page shows of one case, ready for JSON."""
    p = probabilities(ranks)
    names = names_of(name)
    outside = np.flatnonzero(p < 0.01)
    return {
        "title": CASES[name].title,
        "runs": len(ranks),
        "quantities": len(names),
        "outside": [{"name": names[k], "probability": float(p[k])} for k in outside],
        "smallest_probability": float(p.min()),
        "family_limit": 0.01 / len(names),
        "mean_rank": float(ranks.mean() / DRAWS),
        "ecdf": [np.round(np.cumsum(np.bincount(r, minlength=DRAWS + 1))[:-1:4] / len(ranks), 4).tolist() for r in ranks.T],
        "names": names,
        "probabilities": np.round(p, 6).tolist(),
    }


def draw(study: dict[str, Any]) -> Figure:
    """ECDF of the ranks less the uniform one, all quantities of each case, within the 99 % band."""
    count = len(study["cases"])
    columns = 2
    figure = Figure(figsize=(9.5, 2.6 * -(-count // columns)), layout="constrained")
    axes = figure.subplots(-(-count // columns), columns, sharex=True, sharey=True, squeeze=False)
    for ax, case in zip(axes.ravel(), study["cases"].values(), strict=False):
        low, high = band(case["runs"], 0.99)
        z = np.arange(1, DRAWS + 1) / (DRAWS + 1)
        ax.fill_between(z, low, high, color="0.88", step="mid", lw=0, label="99 % band of one quantity")
        for ecdf, p in zip(case["ecdf"], case["probabilities"], strict=True):
            # Hundreds of curves: smooth edges and transparency would make the file several times as large.
            ax.plot(z[::4], np.array(ecdf) - z[::4], lw=0.6, antialiased=False, color="C3" if p < 0.01 else "C0",
                    zorder=3 if p < 0.01 else 2)  # fmt: skip
        ax.set_title(f"{case['title']}: {case['quantities']} quantities", fontsize=9)
        ax.set_ylim(-0.13, 0.13)
    for ax in axes.ravel()[count:]:
        ax.set_visible(False)
    figure.supxlabel("rank of the truth among posterior draws, relative", fontsize=9)
    figure.supylabel("share of runs below, less expected", fontsize=9)
    return figure


def page(study: dict[str, Any]) -> str:
    """The results as a page of the documentation."""
    lines = [
        "# Calibration of the posterior",
        "",
        "If truths are drawn from the prior, data from the truths and posteriors from the data, the rank of each truth",
        "among independent posterior draws is uniform [Talts2018]. `python -m tests.studies.sbc` made this page, its figure",
        f"and [results.json](results.json), from seed {study['seed']}: {DRAWS} draws a run (so 200 possible",
        f"ranks), {INSTANTS} instants of six or seven channels, unknown scales of the noise with an inverse gamma prior. Ranked",
        "are all link parameters, base parameters, effects and scales, and three test quantities: total mass, log-likelihood and",
        "the largest torque of a reference move.",
        "",
        "![Ranks against the uniform law](sbc.png)",
        "",
        "Each quantity has a simultaneous 99 % band for its whole ECDF [Sailynoja2022]. Of many quantities one in a hundred",
        "leaves its band by chance even when all is right; so the last columns are what counts: the smallest probability of all,",
        "beside what it may be for all bands together to hold with 99 %. Those outside are red in the picture, which shows every",
        "fourth rank only, and so not always the one at which they leave.",
        "",
        "| case | runs | quantities | outside their 99 % band | expected by chance | smallest probability | "
        "limit for all together |",
        "|---|---|---|---|---|---|---|",
    ]
    for case in study["cases"].values():
        lines.append(
            f"| {case['title']} | {case['runs']} | {case['quantities']} | {len(case['outside'])} | "
            f"{0.01 * case['quantities']:.1f} | {case['smallest_probability']:.2g} | {case['family_limit']:.1g} |"
        )
    for case in study["cases"].values():
        if case["outside"]:
            named = ", ".join(f"{o['name']} ({o['probability']:.2g})" for o in case["outside"])
            lines += ["", f"Outside their own band, {case['title']}: {named}."]
    lines += [
        "",
        "Cone inactive: relative standard deviation 0.05 of every mass, so walls are never met. Active: 0.5, and most",
        "trajectories bounce. Torques come with viscous and Coulomb friction, which cannot be negative; wrenches with an offset.",
        "",
    ]
    return "\n".join(lines)


def sources() -> str:
    """Fingerprint of the code that the results depend on."""
    package = Path(bayesid.__file__).parent
    robot = package / "robot"
    files = [*sorted((package / "posterior").glob("*.py")), robot / "prior.py", robot / "inertia.py", Path(__file__)]
    digest = hashlib.sha256()
    for file in files:
        digest.update(file.read_bytes())
    return digest.hexdigest()[:12]


def kept() -> Path:
    """Where finished chunks of this very code are kept."""
    folder = Path(tempfile.gettempdir()) / f"bayesid-sbc-{sources()}"
    folder.mkdir(exist_ok=True)
    return folder


def study(runs: int = RUNS, seed: int = SEED, folder: Path | None = None, processes: int = 2) -> dict[str, Any]:
    """All cases."""
    cases = {name: summarise(name, run(name, min(runs, case.runs), seed, folder, processes)) for name, case in CASES.items()}
    return {"seed": seed, "runs": runs, "cases": cases}


def write(result: dict[str, Any], folder: Path = FOLDER) -> None:
    """Page, figure and JSON."""
    (folder / "results.json").write_text(json.dumps(result, indent=None) + "\n", encoding="utf-8")
    (folder / "README.md").write_text(page(result), encoding="utf-8")
    draw(result).savefig(folder / "sbc.png", dpi=110, facecolor="white", metadata={"Software": None})


def main() -> int:
    """Run and write."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--runs", type=int, default=RUNS)
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--out", type=Path, default=FOLDER)
    options = parser.parse_args()
    result = study(options.runs, options.seed, kept(), options.processes)
    write(result, options.out)
    for case in result["cases"].values():
        print(case["title"], len(case["outside"]), "outside of", case["quantities"], "smallest", case["smallest_probability"])
    return 0


if __name__ == "__main__":
    sys.exit(main())
