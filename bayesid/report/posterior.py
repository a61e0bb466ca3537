"""The report of ``sample``."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from bayesid.drawing import Figures, figures_of
from bayesid.posterior.result import PRIOR_DRIVEN, Posterior
from bayesid.report.charts import CYCLE
from bayesid.report.figures import CLASSES, GREY, NOISE, add_legend, make_grid, picked, styled
from bayesid.report.fit_figures import measured_against_predicted, residuals
from bayesid.report.page import below, cards, figure, fold, how, lead, page, svg, warnings
from bayesid.results.files import report_of
from bayesid.results.loaded import LoadedPosterior
from bayesid.results.posterior import ExperimentPosterior
from bayesid.rounding import DASH, channel_text, ends, number, percent, with_half
from bayesid.section import Html, Part, ShownSection, ShownTable, tag
from bayesid.validation.prediction import BAND, judged, still_predictable

_COLUMNS = 6
_BINS = 36
_RANKS = 20


@styled
def marginals(
    names: Sequence[str], draws: np.ndarray, prior: np.ndarray | None, nominal: np.ndarray | None, ax: Any = None
) -> Figure:
    """Marginal posterior of every base parameter, draws (n, r), beside its prior's (m, r), None where it is flat."""
    columns = _COLUMNS if ax is None else 1
    figure, axes = make_grid(-(-len(names) // columns), columns, 1.0, left=0.2, gap=0.22, used=len(names), ax=ax)
    if ax is None:
        figure.subplots_adjust(hspace=0.6)
    for k, ax in enumerate(axes.ravel()[: len(names)]):
        x = draws[:, k]
        low, high = np.quantile(x, [0.001, 0.999])
        reach = 0.6 * max(high - low, 1e-12 * max(abs(high), 1.0))
        middle = 0.5 * (low + high)
        if nominal is not None and abs(nominal[k] - middle) < 3.0 * reach:
            reach = max(reach, 1.15 * abs(nominal[k] - middle))
        edges = np.linspace(middle - reach, middle + reach, _BINS + 1)
        height, _ = np.histogram(x, edges, density=True)
        ax.stairs(height, edges, fill=True, color=CYCLE[0], alpha=0.75, label="posterior")
        if prior is not None:
            # A smooth curve of the prior on its own scale: it is often much wider than the picture.
            wide, where = np.histogram(prior[:, k], 40, density=True)
            centre = 0.5 * (where[1:] + where[:-1])
            grid = np.linspace(edges[0], edges[-1], 60)
            ax.plot(grid, np.interp(grid, centre, wide, left=0.0, right=0.0), color=CLASSES["weak"], lw=1.4, label="prior")
        if nominal is not None and edges[0] <= nominal[k] <= edges[-1]:
            ax.axvline(nominal[k], color=GREY, lw=1.0, ls="--", label="nominal")
        ax.set_title(f"{names[k]}  ({k + 1})", fontsize=8)
        ax.set_yticks([])
        ax.set(xlim=(edges[0], edges[-1]), ylim=(0.0, 1.12 * height.max()))
        ax.xaxis.set_major_locator(MaxNLocator(3))
        ax.tick_params(labelsize=7, pad=1)
        ax.spines["left"].set_visible(False)
    add_legend(axes, *axes.flat)
    return figure


@styled
def predictive(
    names: Sequence[str],
    replicated: np.ndarray,
    measured: np.ndarray,
    channels: Sequence[str] | str | None = None,
    ax: Any = None,
) -> Figure:
    """Measured rows (k, c), over the central 95 % of those that the posterior predicts (chains, draws, k, c), noise included."""
    chosen = picked(tuple(names), channels)
    columns = 2 if len(chosen) > 1 and ax is None else 1
    figure, axes = make_grid(-(-len(chosen) // columns), columns, 1.15, sharex=True, used=len(chosen), ax=ax)
    low, high = np.quantile(replicated, [0.025, 0.975], axis=(0, 1))
    x = np.arange(len(measured))
    for k, panel in zip(chosen, axes.ravel(), strict=False):
        panel.fill_between(x, low[:, k], high[:, k], color=CYCLE[0], alpha=0.35, lw=0.0, label="95 % of predicted readings")
        panel.plot(x, measured[:, k], ".", ms=2.5, color="#334155", label="measured")
        panel.set_title(names[k])
        panel.yaxis.set_major_locator(MaxNLocator(4))
    for panel in axes[-1]:
        panel.set_xlabel("row, evenly picked")
    add_legend(axes)
    return figure


@styled
def narrowing(result: ExperimentPosterior) -> Figure:
    """Posterior over prior standard deviation: what the data narrowed, and what they did not."""
    groups = [("base parameters", result.base.short_names, result.prior_share)]
    if result.link_draws is not None:
        parts = [name.rpartition(".") for name in result.base.parameter_names]
        bodies = list(dict.fromkeys(body for body, _, _ in parts))
        numbered = [f"{bodies.index(body) + 1}.{kind}" for body, _, kind in parts]
        groups.append(("link parameters", numbered, result.link_prior_share))
    figure, axes = make_grid(len(groups), 1, 1.7, left=0.6)
    figure.subplots_adjust(hspace=0.85)
    for ax, (title, names, share) in zip(axes[:, 0], groups, strict=True):
        at = np.arange(len(share))
        colours = [CLASSES["weak"] if s > PRIOR_DRIVEN else CYCLE[0] for s in share]
        ax.bar(at, np.minimum(share, 1.1), width=0.75, color=colours, lw=0)
        ax.axhline(PRIOR_DRIVEN, color=CLASSES["weak"], lw=0.9, ls="--")
        ax.axhline(1.0, color=GREY, lw=0.8)
        ax.set(xlim=(-0.7, len(share) - 0.3), ylim=(0.0, 1.12), title=title, ylabel="posterior / prior std")
        ax.set_xticks(at, names, rotation=90, fontsize=6 if len(share) > 45 else 7)
        ax.grid(axis="x", visible=False)
        ax.tick_params(axis="x", length=0)
    return figure


@styled
def ranks(result: ExperimentPosterior) -> Figure:
    """Ranks of each chain's draws among all of the numbers with the largest R-hat: alike and level where the chains agree."""
    draws = np.concatenate([result.chains.draws, result.base_draws], axis=-1)
    names, worst = (*result.model.names, *result.names), np.argsort(-result.diagnosis.r_hat)[:_RANKED].tolist()
    chains, count, _ = draws.shape
    figure, axes = make_grid(1, len(worst), 1.5, left=0.35, gap=0.3)
    for k, ax in zip(worst, axes[0], strict=True):
        order = np.argsort(np.argsort(draws[:, :, k].ravel())).reshape(chains, count)
        edges = np.linspace(0, chains * count, _RANKS + 1)
        level = count / _RANKS
        spread = 1.96 * np.sqrt(level * (1 - 1 / _RANKS))
        ax.axhspan(level - spread, level + spread, color=NOISE, alpha=0.12, lw=0, label="95 % of bars, chains alike")
        for c in range(chains):
            ax.stairs(np.histogram(order[c], edges)[0], edges, color=CYCLE[c % len(CYCLE)], lw=1.2, label=f"chain {c + 1}")
        ax.set_title(names[k] if len(names[k]) < 34 else names[k][:31] + "...", fontsize=8)
        ax.set(ylim=(0, 2.0 * level), xlim=(0, chains * count), xlabel="rank", yticks=[])
        ax.xaxis.set_major_locator(MaxNLocator(3))
    add_legend(axes)
    return figure


_SHOWN_MOTIONS = 3
_RANKED = 4
_PRIOR_DRAWS = 4000


@report_of.register
def posterior_report(result: ExperimentPosterior) -> str:
    """The report of ``sample``: an HTML page with all figures inside."""
    problem, model, d = result.problem, result.model, result.diagnosis
    chains = [[d.names[k], f"{d.r_hat[k]:.4f}", f"{d.ess_bulk[k]:.0f}", f"{d.ess_tail[k]:.0f}"] for k in np.argsort(-d.r_hat)]
    prior = ", its prior (orange)" if model.prior is not None else ""
    sections = [
        ShownSection("What the data and the prior say together", [
            "Base parameters are the combinations of masses, first moments (mass times centre of mass) and inertias that these "
            "readings show. In a label, m2 is the mass of body 2, m2 r2x its first moment along x and I2xy an inertia about "
            "the origin of its joint's frame.",
            figure(svg(marginals_figure(result), "marginals"),
                   f"Marginal posterior of each base parameter (blue){prior} and the nominal value (dashed) where it is in the "
                   "picture. Numbers as in the table."),
            _parameters(result, problem.regression.nominal),
            Html(f'<p class="note">{tag("alone")} one parameter of one link; {tag("combination")} a sum that only as a whole can '
                 f"be seen; {tag('prior')} the data leave more than 90 % of the prior's standard deviation: the value is the "
                 "prior's.</p>"),
        ], "Parameters"),
        *_narrowed(result),
        ShownSection("Effects and noise", _effects_and_noise(result)),
        ShownSection("Predictions of motions", _predictions(result), "Predictions"),
        ShownSection("Did the chains converge", [
            "Chains start far apart and know nothing of each other. R-hat compares them: 1 when they cannot be told apart. The "
            "effective sample size is the number of independent draws that would be as good, in the bulk and in the tails.",
            figure(svg(ranks(result), "ranks"),
                   "Ranks of each chain's draws among all draws, for the numbers with the largest R-hat: level and alike where "
                   "chains agree."),
            fold(f"R-hat and effective sample sizes of all {len(d.names)} numbers, by {d.draws} draws",
                 ShownTable(["parameter", "R-hat", "ESS, bulk", "ESS, tail"], chains, "w n n n")),
        ], "Chains"),
        how(*_how(result), seconds=result.seconds, packages=("emcee", "arviz", "numpy"),
            after="All draws are in `posterior.nc`, which ArviZ opens; numbers in `posterior.json`."),
    ]  # fmt: skip
    name, robot = problem.experiment.name, problem.experiment.robot.name
    fine = "No warnings: the chains agree and validation motions are predicted down to the noise."
    opening = [warnings(result.warnings, fine), lead(_lead(result)), cards(_cards(result))]
    kicker = f"Posterior of the inertial parameters of {robot}, from the {channel_text(problem.channel, problem.fitted)}"
    return page(name, kicker, opening, sections, f"{name}: posterior")


def marginals_figure(result: Posterior, ax: Any = None) -> Figure:
    """Posterior, prior and nominal value of every base parameter."""
    flat = result.base_draws.reshape(-1, result.base.rank)
    prior = result.model.prior_draws(_PRIOR_DRAWS, np.random.default_rng(result.seed))
    pushed = None if prior is None else prior @ result.base.matrix.T
    nominal = result.problem.regression.nominal if isinstance(result, ExperimentPosterior) else None
    return marginals(result.base.short_names, flat, pushed, nominal, ax)


def _lead(result: ExperimentPosterior) -> str:
    rank, d = result.base.rank, result.diagnosis
    draws = int(np.prod(result.chains.draws.shape[:2]))
    driven = int(np.sum(result.prior_share > PRIOR_DRIVEN))
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


def _cards(result: ExperimentPosterior) -> list[tuple[str, str, str]]:
    d = result.diagnosis
    mood = "good" if d.passed else "bad"
    large = [
        (str(int(np.prod(result.chains.draws.shape[:2]))), f"draws by {result.chains.engine}", ""),
        (number(float(d.r_hat.max()), 4), "largest R-hat over independent chains; below 1.01", mood),
        (number(float(d.ess.min()), 3), "smallest effective sample size; at least 400", mood),
    ]
    for p in sorted(result.validation, key=lambda p: -p.whitened_rms)[:1]:
        large.append((percent(p.relative_error), f"error of the signal on ‘{p.motion}’", judged(p).mood))
        large.append((percent(p.coverage), "of its readings inside 95 % predictive intervals", ""))
    return large


def _parameters(result: ExperimentPosterior, nominal: np.ndarray | None) -> ShownTable:
    rows = []
    for k, label in enumerate(result.base.labels):
        share = percent(result.prior_share[k], 2) if result.link_draws is not None else DASH
        known = DASH if nominal is None else number(nominal[k])
        mean, std = with_half(result.values[k], result.std[k])
        between = ends(result.low[k], result.high[k])
        rows.append([str(k + 1), label, mean, std, result.base.units[k], between, known, share, result.classes[k]])
    head = ["#", "base parameter", "mean", "± std", "unit", "95 % interval", "nominal", "of prior std", "class"]
    return ShownTable(head, rows, "nd w nb n ku n n n t")


def _narrowed(result: ExperimentPosterior) -> list[ShownSection]:
    """How far the data narrowed the prior; none with a flat one."""
    model = result.model
    if model.prior is None:
        return []
    cut = ", cut to bodies that can exist" if model.physical else ""
    return [ShownSection("What came from the data, and what from the prior", [
        f"Posterior over prior standard deviation. Near zero the data decide; near one (orange) the prior does{cut}. Single "
        "link parameters can stay the prior's even where every base parameter is well known: many links "
        "have the same base parameters.",
        figure(svg(narrowing(result), "narrowing"),
               "Above: base parameters. Below: the ten parameters of every body, by the body's number."),
    ], "Prior and data")]  # fmt: skip


def _effects_and_noise(result: ExperimentPosterior) -> list[Part]:
    model, found, rank = result.model, result.parameters(), result.base.rank
    effects = [
        [found.names[k], *with_half(found.values[k], found.std[k]), found.units[k], ends(found.low[k], found.high[k])]
        for k in range(rank, len(found))
    ]
    scales = [_summary(n, "× noise", result.scales[..., k]) for k, n in enumerate(model.scale_names)]
    scales += [] if result.dof is None else [_summary("degrees of freedom", "", result.dof)]
    head = ["mean", "± std", "unit", "95 % interval"]
    parts: list[Part] = ["No effects beyond rigid bodies are in the model."]
    if effects:
        parts = [ShownTable(["effect", *head], effects, "k nb n ku n", "narrow")]
    if scales:
        text = "Scales of the noise of each channel, in units of the noise that was learned from the residuals: 1 is as learned."
        if model.likelihood.estimate_only:
            text = (
                "The model is not complete, so there is one scale, of all standard deviations that the data state, in place of "
                "one a channel: above 1 where the prior contradicts them."
            )
        if model.noise == "student":
            text += " Few degrees of freedom say that outliers are frequent; above about 30 the noise is as good as Gaussian."
        parts += [text, ShownTable(["channel", *head], scales, "k nb n ku n", "narrow")]
    return parts


def _summary(name: str, unit: str, draws: np.ndarray) -> list[str]:
    mean, std = with_half(float(draws.mean()), float(draws.std()))
    return [name, mean, std, unit, ends(*np.quantile(draws, [0.025, 0.975]))]


def _predictions(result: ExperimentPosterior) -> list[Part]:
    """Errors of all motions, and figures of those that were not fitted and are predicted worst."""
    band = number(BAND, 2)
    rows = [
        [p.motion, role, percent(p.relative_error), (number(p.times_noise, 3), judged(p).mood), percent(p.coverage)]
        for role, ps in (("validation", result.validation), ("fitted", result.fitted)) for p in ps
    ]  # fmt: skip
    head = ["motion", "role", f"error of the signal below {band} Hz", "residual / noise", "in 95 % predictive intervals"]
    parts: list[Part] = [ShownTable(head, rows, "k - n n n", "narrow")]
    if not result.validation:
        parts.append(
            "**There is no validation motion**: nothing here tests the posterior on another motion. Add a motion with role "
            "validation."
        )
    for k, p in enumerate(sorted(result.validation, key=lambda p: -p.whitened_rms)[:_SHOWN_MOTIONS]):
        parts.append(below(
            f"{p.motion} (validation: not fitted)",
            figure(svg(measured_against_predicted(p), f"validation-{k}"),
                   f"{p.motion}: measured (broad, pale) and predicted by the posterior mean (thin, red). Both in the band up "
                   f"to {band} Hz."),
            figure(svg(residuals(p), f"residual-{k}"),
                   "What is left, in time and by frequency; the green band is where noise alone would be 95 % of the time."),
        ))  # fmt: skip
    return parts


def _how(result: ExperimentPosterior) -> list[tuple[str, str]]:
    model, chains, problem = result.model, result.chains, result.problem
    prior = "flat on the base parameters, no bounds on the links"
    if model.prior is not None:
        prior = "about the nominal links"
        prior += (
            f", scaled, shifted and warped by {percent(result.rel_std, 3)} (one standard deviation)" if result.rel_std else ""
        )
        check = result.prior_check
        if check is not None and check.widening > 1.0:
            prior += f", all times {number(check.widening, 2)}, for the data contradict it"
        prior += "; only bodies that can exist" if model.physical else ""
    engine = {
        "hmc": "exact Hamiltonian trajectories that bounce off the walls, Gibbs steps for the noise",
        "emcee": "emcee, independence moves from the Laplace approximation and differential evolution",
    }[chains.engine]
    noise = {
        "gaussian": f"Gaussian, one unknown scale {'in all' if model.likelihood.estimate_only else 'a channel'}",
        "student": "Student's t, one weight an instant for all channels, unknown scales and degrees of freedom",
    }[model.noise]
    return [
        ("Prior", prior),
        *([] if result.prior_check is None else [("Prior against data", result.prior_check.brief())]),
        ("Noise", f"{noise}; autoregressive in time as learned from residuals, correlated between channels"),
        ("Model complete", "yes" if model.likelihood.complete else "no: intervals count how far parts scatter"),
        ("Rows", f"{model.likelihood.rows} numbers, {number(1.0 / problem.row_model.step, 3)} rows a second"),
        ("Sampler", f"{engine}; a draw every {chains.thin} of its usual distances; seed {result.seed}"),
    ]


@figures_of.register
def _(result: Posterior) -> Figures:
    motions = {"predictions": measured_against_predicted, "residuals": residuals}
    own = {"marginals": partial(marginals_figure, result), "predictive": predictive}
    return {**motions, **own} if isinstance(result, ExperimentPosterior) else own


@figures_of.register
def _(result: LoadedPosterior) -> Figures:
    draws = result.base_draws.reshape(-1, result.base_draws.shape[-1])
    names = result.base.short_names if "base_map" in result.document else list(result.names)
    return {"marginals": partial(marginals, names, draws, None, None), "predictive": predictive}
