"""The verb ``identify``."""

from __future__ import annotations

import click

import bayesid
from bayesid.cli.known_bounds import bounded
from bayesid.cli.options import (
    BOUNDS,
    EXPERIMENT,
    OUT,
    OUTPUTS,
    STATIC,
    UNUSED_SEED,
    load,
    low_pass,
    model_options,
    on_workers,
    output_folder,
    show_progress,
)
from bayesid.cli.terminal import say
from bayesid.results.files import check_output


@click.command()
@EXPERIMENT
@model_options
@click.option("--method", help=f"{', '.join(bayesid.METHODS)}  [default: {bayesid.DEFAULT_METHOD}; with a mount that rings, gls]")
@BOUNDS
@STATIC
@click.option("--unconstrained-urdf", is_flag=True, help="Also write the links with exactly the estimated base parameters.")
@on_workers
@OUT
@UNUSED_SEED
def identify(experiment, filter_l, filter_d, model, effects_from, method, bounds, out, **options) -> None:
    """Base parameters with their uncertainty, link parameters, and held-out validation."""
    check_output(out or OUTPUTS, "identify")
    filters = low_pass(filter_l, filter_d)
    chosen = None if method is None else bayesid.estimator(method)
    with show_progress() as progress:
        progress("reading")
        loaded = load(experiment, model, effects_from)
        if bounds is not None:
            chosen = bounded(chosen or bayesid.estimator(bayesid.DEFAULT_METHOD), bounds, loaded)
        result = bayesid.identify(loaded, method=chosen, low_pass=filters, progress=progress, **options)
        progress("report")
        report = result.write(output_folder(out, loaded.name, "identify"))
    say(bayesid.summary(result), result.warnings)
    say(f"report: {report}")
