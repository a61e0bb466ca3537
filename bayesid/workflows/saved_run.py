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
from bayesid.posterior.convert import load_arviz
from bayesid.recordings.experiment import Experiment
from bayesid.regression.options import FitOptions
from bayesid.regression.problem import Problem, prepare
from bayesid.results.urdf_links import joint_dynamics
from bayesid.robot.prior import Prior
from bayesid.robot.urdf import JointDynamics
from bayesid.signals.filters import LowPass
from bayesid.validation.noise_floor import noise_floor

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
        return _known(experiment, file, document, options, prior_std, count, seed)
    except (KeyError, TypeError, IndexError) as error:
        raise InputError(f"{file}: is not as a run of bayesid writes it ({error}); run it again") from None


def prior_text(noise: str, flat: bool) -> str:
    """What a posterior is called beside estimators' names."""
    return f"{'flat' if flat else 'nominal'} prior, {noise} noise"


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
) -> tuple[Known, tuple[str, ...]]:
    if document["experiment"] != experiment.name:
        other = document["experiment"]
        raise InputError(f"{file}: is of experiment '{other}', not of '{experiment.name}'; name a run of this one")
    problem = _problem(experiment, document, options)
    base, effects = problem.row_model.base, problem.regression.effect_names
    listed = [p["name"] for p in document["base_parameters"]]
    posterior = file.name == POSTERIOR
    names = [*listed, *(p["name"] for p in document["effect_parameters"])] if posterior else document["full_covariance_names"]
    if list(names) != [*base.names, *effects]:
        raise InputError(
            f"{file}: its parameters are not those of this experiment and model; give the {argument('effects')} and "
            f"{argument('static')} of that run, or run it again"
        )
    warned = tuple(document["warnings"])
    if posterior:
        return _posterior(problem, file, document, prior_std, count, seed), warned
    effect_values = {
        f"{e['name']}@{e['where']}.{key}": (entry["value"], entry["std"])
        for e in document["effects"] for key, entry in e["parameters"].items()
    }  # fmt: skip
    classes = [p["class"] for p in document["base_parameters"]]
    dispersion = document["details"].get("dispersion") or 1.0
    covariance = document["full_covariance"]
    undetermined = np.array([*(c == "prior" for c in classes), *(effect_values[n][1] is None for n in effects)], bool)
    values = np.array([p["value"] for p in document["base_parameters"]])
    saved = document["identified_urdf"]
    beside = {name: (entry["value"], entry["unit"]) for name, entry in saved["not_in_urdf"].items()}
    return known_from(
        problem, source="estimate", method=document["method"],
        mean=np.concatenate([values, [effect_values[n][0] for n in effects]]),
        covariance=None if covariance is None else np.array(covariance, float),
        undetermined=undetermined, centre=nearest_links(experiment.robot, base, values, ~undetermined[: base.rank]),
        urdf=np.array(document["link_parameters"], float),
        dynamics=JointDynamics(saved["dynamics"], tuple(saved["negative_friction"]), beside), rel_std=prior_std,
        conflict=bool((document["prior_against_data"] or {}).get("conflict")), dispersion=dispersion, floor=noise_floor(problem),
        count=count, seed=seed,
    ), warned  # fmt: skip


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


def _posterior(problem: Problem, file: Path, document: dict[str, Any], prior_std: float | None, count: int, seed: int) -> Known:
    path = file.parent / "posterior.nc"
    if not path.is_file():
        raise InputError(f"{path}: no such file, and the draws are in it; sample again")
    group = load_arviz().from_netcdf(str(path))["posterior"]
    base = problem.row_model.base

    def drawn(name: str, size: int) -> np.ndarray:
        if not size:  # no effects: no such variable
            return np.zeros((group["base"].values[..., 0].size, 0))
        return np.asarray(group[name].values, float).reshape(-1, size)

    draws = np.concatenate([drawn("base", base.rank), drawn("effect", len(problem.regression.effect_names))], axis=1)
    prior, links, rel_std = None, None, prior_std or document["inertia_rel_std"]
    nominal = problem.regression.knowledge.nominal_links
    if "bodies that can exist only" in document["prior"] and rel_std and nominal is not None:
        links = drawn("link", len(base.parameter_names))
        prior = prior_links(base, Prior.warped(nominal, rel_std), PRIOR_DRAWS, seed)
    nothing, mean = np.zeros(draws.shape[1], bool), draws.mean(axis=0)
    return known_from(
        problem, source="posterior", method=prior_text(document["noise"], document["prior"].startswith("flat")),
        mean=mean, covariance=np.atleast_2d(np.cov(draws.T)), undetermined=nothing, draws=draws, link_draws=links,
        prior_draws=prior, dynamics=joint_dynamics(problem, mean[base.rank :], ~nothing[base.rank :]), rel_std=rel_std,
        dispersion=float(document["dispersion"]), count=count, seed=seed,
    )  # fmt: skip
