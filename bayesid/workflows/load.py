"""Figures of results that were read back from their files."""

from __future__ import annotations

from functools import partial

from bayesid.drawing import Figures, figures_of
from bayesid.results.loaded import Loaded, LoadedComparison, LoadedIdentification, LoadedPosterior


@figures_of.register
def _(_: Loaded) -> Figures:
    return {}


@figures_of.register
def _(result: LoadedIdentification) -> Figures:
    from bayesid.report.identification import intervals_figure

    return {"intervals": partial(intervals_figure, result, result.estimate)}


@figures_of.register
def _(result: LoadedComparison) -> Figures:
    from bayesid.report.comparison import errors_figure, values_figure

    values = {} if result.reference is None else {"values": partial(values_figure, result, result.reference)}
    return {"errors": partial(errors_figure, result), **values} if result.entries[0].predictions or result.baselines else values


@figures_of.register
def _(result: LoadedPosterior) -> Figures:
    from bayesid.report.posterior import marginals

    draws = result.base_draws.reshape(-1, result.base_draws.shape[-1])
    names = result.base.short_names if "base_map" in result.document else list(result.names)
    return {"marginals": partial(marginals, names, draws, None, None)}
