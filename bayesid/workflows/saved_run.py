"""A posterior or an estimate that an earlier run wrote, read back as far as bounds need it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from bayesid.arguments import argument
from bayesid.design.bounds.knowledge import PRIOR_DRAWS, Known, known_from, prior_links
from bayesid.dynamics.base_parameters import nearest_links
from bayesid.errors import InputError
from bayesid.estimators import Estimate
from bayesid.posterior.result import Posterior
from bayesid.recordings.experiment import Experiment
from bayesid.regression.options import FitOptions
from bayesid.regression.problem import Problem, prepare
from bayesid.results.fitted_model import joint_dynamics
from bayesid.results.loaded import LoadedIdentification, LoadedPosterior
from bayesid.robot.prior import Prior
from bayesid.robot.urdf import JointDynamics
from bayesid.signals.filters import LowPass
from bayesid.validation.noise_floor import NoiseFloor, noise_floor

ESTIMATE, POSTERIOR = "estimate.json", "posterior.json"


def known_from_run(
    experiment: Experiment, run: Path, options: FitOptions, prior_std: float | None, count: int, seed: int
) -> tuple[Known, tuple[str, ...]]:
    """What is known after a run, by its folder, ``estimate.json`` or ``posterior.json``, and the warnings it had.

    Effects, static and bandwidth of ``options`` count where the run was given others than the experiment has; the rest is as in
    `bayesid.design.bounds.knowledge.known_from`. An `InputError` where files are missing, are no run's, or belong to another
    experiment or model.
    """
    file = run if run.suffix == ".json" else next((run / n for n in (ESTIMATE, POSTERIOR) if (run / n).is_file()), run / ESTIMATE)
    document = _read(file)
    model = file.parent / "model.toml"
    if options.effects is None and file.name == ESTIMATE and model.is_file():
        experiment = experiment.with_model(model)
    try:
        return _known(experiment, file, document, options, prior_std, count, seed), tuple(document["warnings"])
    except (KeyError, TypeError, IndexError) as error:
        raise InputError(f"{file}: is not as a run of bayesid writes it ({error}); run it again") from None


def _read(file: Path) -> dict[str, Any]:
    if not file.is_file():
        raise InputError(f"{file}: no such file; name a folder that identify or sample wrote")
    try:
        document = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(f"{file}: cannot be read ({error}); run it again") from None
    if not isinstance(document, dict) or "base_parameters" not in document:
        raise InputError(f"{file}: is not as a run of bayesid writes it; name a folder of identify or sample")
    return document


def _known(
    experiment: Experiment,
    file: Path,
    document: dict[str, Any],
    options: FitOptions,
    prior_std: float | None,
    count: int,
    seed: int,
) -> Known:
    if document["experiment"] != experiment.name:
        other = document["experiment"]
        raise InputError(f"{file}: is of experiment '{other}', not of '{experiment.name}'; name a run of this one")
    problem = _problem(experiment, document, options)
    base, effects = problem.row_model.base, problem.regression.effect_names
    names = [p["name"] for p in (*document["base_parameters"], *document["effect_parameters"])]
    if names != [*base.names, *effects]:
        raise InputError(
            f"{file}: its parameters are not those of this experiment and model; give the {argument('effects')} and "
            f"{argument('static')} of that run, or run it again"
        )
    if file.name == POSTERIOR:
        drawn = LoadedPosterior("ExperimentPosterior", document, "", file)
        prior, links, rel_std = None, None, prior_std or document["inertia_rel_std"]
        nominal = problem.regression.knowledge.nominal_links
        if "bodies that can exist only" in document["prior"] and rel_std and nominal is not None:
            if (links := drawn.link_draws) is None:
                raise KeyError("link")
            prior = prior_links(base, Prior.warped(nominal, rel_std), PRIOR_DRAWS, seed)
        return known_of_draws(
            problem, drawn, document["noise"], document["prior"].startswith("flat"), links, prior, None, rel_std,
            float(document["dispersion"]), count, seed,
        )  # fmt: skip
    found = LoadedIdentification("Identification", document, "", file)
    e = found.estimate
    centre = nearest_links(experiment.robot, base, e.values, ~e.undetermined[: base.rank])
    conflict = bool((document["prior_against_data"] or {}).get("conflict"))
    return known_of_estimate(
        problem, e, centre, found.link_parameters, found.dynamics, conflict, noise_floor(problem), prior_std, count, seed
    )


def _problem(experiment: Experiment, document: dict[str, Any], options: FitOptions) -> Problem:
    """The experiment made ready as that run did."""
    filters = document["filter"]
    static = document.get("static", "none")
    return prepare(
        experiment,
        FitOptions(
            document["channel"], None if filters["l"] is None else LowPass(filters["l"], filters["d"]), document["motions"],
            options.effects, "joint" if "joint" in (static, options.static) else "motion",
            options.bandwidth or filters.get("bandwidth_hz"),
        ),
    )  # fmt: skip


def known_of_estimate(
    problem: Problem, e: Estimate, centre: np.ndarray, urdf: np.ndarray, dynamics: JointDynamics, conflict: bool,
    floor: NoiseFloor | None, prior_std: float | None, count: int, seed: int,
) -> Known:  # fmt: skip
    """What is known after an estimate; the rest is as in `bayesid.design.bounds.knowledge.known_from`."""
    return known_from(
        problem, source="estimate", method=e.method, mean=e.solution, covariance=e.full_covariance, undetermined=e.undetermined,
        centre=centre, urdf=urdf, dynamics=dynamics, rel_std=prior_std, conflict=conflict,
        dispersion=e.details.dispersion or 1.0, floor=floor, count=count, seed=seed,
    )  # fmt: skip


def known_of_draws(
    problem: Problem, posterior: Posterior | LoadedPosterior, noise: str, flat: bool, links: np.ndarray | None,
    prior: np.ndarray | None, urdf: np.ndarray | None, rel_std: float | None, dispersion: float, count: int, seed: int,
) -> Known:  # fmt: skip
    """What is known after a posterior, by its prior and noise, draws of links (chains, draws, P) and of their prior (m, P)."""
    draws = np.concatenate([posterior.base_draws, posterior.effect_draws], axis=-1)
    draws = draws.reshape(-1, draws.shape[-1])
    nothing, mean, rank = np.zeros(draws.shape[1], bool), draws.mean(axis=0), problem.row_model.base.rank
    return known_from(
        problem, source="posterior", method=f"{'flat' if flat else 'nominal'} prior, {noise} noise", mean=mean,
        covariance=np.atleast_2d(np.cov(draws.T)), undetermined=nothing, draws=draws, urdf=urdf,
        link_draws=None if links is None else links.reshape(-1, links.shape[-1]), prior_draws=prior,
        dynamics=joint_dynamics(problem, mean[rank:], ~nothing[rank:]), rel_std=rel_std, dispersion=dispersion, count=count,
        seed=seed,
    )  # fmt: skip
