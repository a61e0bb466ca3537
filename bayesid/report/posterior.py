"""The report of ``sample``: turns an `ExperimentPosterior` into what its template shows."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from bayesid.posterior.result import Posterior
from bayesid.report.page import render, run_times, svg, versions
from bayesid.report.posterior_figures import marginals, narrowing, ranks
from bayesid.report.prediction_figures import measured_against_predicted, residuals
from bayesid.results.posterior import ExperimentPosterior
from bayesid.results.text import DASH, channel_text, number, percent, with_half
from bayesid.validation.headline import judged, still_predictable
from bayesid.validation.prediction import BAND, Prediction

_SHOWN_MOTIONS = 3
_RANKED = 4
_PRIOR_DRAWS = 4000
_DRIVEN = 0.9


def posterior_report(result: ExperimentPosterior) -> str:
    """The report of ``sample``: an HTML page with all figures inside."""
    problem, model = result.problem, result.model
    shares = [("base parameters", result.base.short_names, result.prior_share)]
    if result.link_draws is not None:
        shares.append(("link parameters", _link_names(result.base.parameter_names), result.link_prior_share))
    shown = sorted(result.validation, key=lambda p: -p.whitened_rms)[:_SHOWN_MOTIONS]
    return render(
        "posterior.html",
        name=problem.experiment.name,
        robot=problem.experiment.robot.name,
        channel=channel_text(problem.channel),
        fitted=problem.fitted,
        warning_list=result.warnings,
        lead=_lead(result),
        card_list=_cards(result),
        marginals=svg(marginals_figure(result), "marginals"),
        has_prior=model.prior is not None,
        parameters=_parameters(result, problem.regression.nominal),
        effects=_effects(result),
        scales=_scales(result),
        student=model.noise == "student",
        narrowing=None if model.prior is None else svg(narrowing(shares, _DRIVEN), "narrowing"),
        physical=model.physical,
        ranks=svg(ranks(*_worst(result)), "ranks"),
        diagnostics=_diagnostics(result),
        validation=[_motion(p, k) for k, p in enumerate(shown)],
        errors=[_error(p, role) for role, ps in (("validation", result.validation), ("fitted", result.fitted)) for p in ps],
        band=number(BAND, 2),
        how=_how(result),
    )


def marginals_figure(result: Posterior, ax: Any = None) -> Figure:
    """Posterior, prior and nominal value of every base parameter."""
    flat = result.base_draws.reshape(-1, result.base.rank)
    prior = result.model.prior_draws(_PRIOR_DRAWS, np.random.default_rng(result.seed))
    pushed = None if prior is None else prior @ result.base.matrix.T
    nominal = result.problem.regression.nominal if isinstance(result, ExperimentPosterior) else None
    return marginals(result.base.short_names, flat, pushed, nominal, ax)


def _link_names(names) -> list[str]:
    bodies = list(dict.fromkeys(n.rpartition(".")[0] for n in names))
    return [f"{bodies.index(n.rpartition('.')[0]) + 1}.{n.rpartition('.')[2]}" for n in names]


def _lead(result: ExperimentPosterior) -> str:
    rank, d = result.base.rank, result.diagnosis
    draws = int(np.prod(result.chains.draws.shape[:2]))
    driven = int(np.sum(result.prior_share > _DRIVEN))
    text = f"{draws} draws of {rank} base parameters" + ("" if result.link_draws is None else " and of the links behind them")
    text += f" from {result.chains.draws.shape[0]} independent chains, which "
    text += "agree. " if d.passed else "do NOT agree: the draws are not to be used as a posterior. "
    if result.link_draws is not None:
        text += (
            f"The data narrowed {rank - driven} of the base parameters; the other {driven} are driven by the prior. "
            if driven else "The data narrowed all of the base parameters. "
        )  # fmt: skip
    if result.model.physical:
        text += "Every draw is a robot of bodies that can exist. "
    if result.validation:
        worst = max(result.validation, key=lambda p: p.whitened_rms)
        text += (
            f"‘{worst.motion}’, which was not fitted, is predicted to {percent(worst.relative_error)} of the signal; "
            f"{judged(worst).text}. {still_predictable(worst)} {percent(worst.coverage)} of the readings lie within their 95 % "
            "predictive intervals."
        )
    return text


def _cards(result: ExperimentPosterior) -> list[dict[str, str]]:
    d = result.diagnosis
    mood = "good" if d.passed else "bad"
    cards = [
        {"value": str(int(np.prod(result.chains.draws.shape[:2]))), "mood": "", "text": f"draws by {result.chains.engine}"},
        {"value": number(float(d.r_hat.max()), 4), "mood": mood, "text": "largest R-hat over independent chains; below 1.01"},
        {"value": number(float(d.ess.min()), 3), "mood": mood, "text": "smallest effective sample size; at least 400"},
    ]
    for p in sorted(result.validation, key=lambda p: -p.whitened_rms)[:1]:
        cards.append(
            {"value": f"{percent(p.relative_error)}", "mood": judged(p).mood, "text": f"error of the signal on ‘{p.motion}’"}
        )
        cards.append({"value": percent(p.coverage), "mood": "", "text": "of its readings inside 95 % predictive intervals"})
    return cards


def _parameters(result: ExperimentPosterior, nominal: np.ndarray | None) -> list[dict[str, Any]]:
    rows = []
    columns = zip(
        result.base.labels, result.base.units, result.values, result.std, result.low, result.high, result.prior_share,
        result.classes, strict=True,
    )  # fmt: skip
    for k, (label, unit, value, std, low, high, share, kind) in enumerate(columns):
        mean, spread = with_half(value, std)
        rows.append(
            {"index": k + 1, "label": label, "unit": unit, "mean": mean, "std": spread, "interval": _ends(low, high),
             "nominal": number(nominal[k]) if nominal is not None else DASH,
             "share": percent(share, 2) if result.link_draws is not None else DASH, "kind": kind}
        )  # fmt: skip
    return rows


def _ends(low: float, high: float) -> str:
    half = 0.5 * (high - low)
    return f"{with_half(low, half)[0]} … {with_half(high, half)[0]}"


def _summary(name: str, unit: str, draws: np.ndarray) -> dict[str, str]:
    value, std = with_half(float(draws.mean()), float(draws.std()))
    return {"name": name, "unit": unit, "mean": value, "std": std, "interval": _ends(*np.quantile(draws, [0.025, 0.975]))}


def _effects(result: ExperimentPosterior) -> list[dict[str, str]]:
    names, units = result.model.effect_names, result.model.effect_units
    return [_summary(n, u, result.effect_draws[..., k]) for k, (n, u) in enumerate(zip(names, units, strict=True))]


def _scales(result: ExperimentPosterior) -> list[dict[str, str]]:
    rows = [_summary(n, "× noise", result.scales[..., k]) for k, n in enumerate(result.model.scale_names)]
    return rows + ([] if result.dof is None else [_summary("degrees of freedom", "", result.dof)])


def _worst(result: ExperimentPosterior) -> tuple[list[str], np.ndarray]:
    """The numbers with the largest R-hat, with their draws."""
    every = np.concatenate([result.chains.draws, result.base_draws], axis=-1)
    names = (*result.model.names, *result.names)
    order = np.argsort(-result.diagnosis.r_hat)[:_RANKED]
    return [names[k] for k in order], every[..., order]


def _diagnostics(result: ExperimentPosterior) -> list[dict[str, Any]]:
    d = result.diagnosis
    order = np.argsort(-d.r_hat)
    return [
        {"name": d.names[k], "r_hat": f"{d.r_hat[k]:.4f}", "bulk": f"{d.ess_bulk[k]:.0f}", "tail": f"{d.ess_tail[k]:.0f}"}
        for k in order
    ]


def _motion(prediction: Prediction, index: int) -> dict[str, Any]:
    return {
        "title": prediction.motion,
        "caption": f"{prediction.motion}: measured (broad, pale) and predicted by the posterior mean (thin, red).",
        "predicted": svg(measured_against_predicted(prediction), f"validation-{index}"),
        "residuals": svg(residuals(prediction), f"residual-{index}"),
    }


def _error(p: Prediction, role: str) -> dict[str, str]:
    return {
        "motion": p.motion, "role": role, "relative": percent(p.relative_error), "white": number(p.times_noise, 3),
        "mood": judged(p).mood, "coverage": percent(p.coverage),
    }  # fmt: skip


def _how(result: ExperimentPosterior) -> list[tuple[str, str]]:
    model, chains, problem = result.model, result.chains, result.problem
    prior = "flat on the base parameters, no bounds on the links"
    if model.prior is not None:
        prior = "about the nominal links"
        prior += f", scaled, shifted and warped by {percent(result.trust, 3)} (one standard deviation)" if result.trust else ""
        prior += "; only bodies that can exist" if model.physical else ""
    engine = {
        "hmc": "exact Hamiltonian trajectories that bounce off the walls, Gibbs steps for the noise",
        "emcee": "emcee, independence moves from the Laplace approximation and differential evolution",
    }[chains.engine]
    noise = {
        "gaussian": "Gaussian, one unknown scale a channel",
        "student": "Student's t, one weight an instant for all channels, unknown scales and degrees of freedom",
    }[model.noise]
    return [
        ("Prior", prior),
        *([] if result.prior_check is None else [("Prior against data", result.prior_check.brief())]),
        ("Noise", f"{noise}; autoregressive in time as learned from residuals, correlated between channels"),
        ("Model complete", "yes" if model.likelihood.complete else "no: intervals count how far stretches scatter"),
        ("Rows", f"{model.likelihood.rows} numbers, {number(1.0 / problem.row_model.step, 3)} rows a second"),
        ("Sampler", f"{engine}; a draw every {chains.thin} of its usual distances; seed {result.seed}"),
        run_times(result.seconds),
        versions("emcee", "arviz", "numpy"),
    ]
