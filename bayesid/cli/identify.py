"""The verb ``identify``."""

from __future__ import annotations

import click

import bayesid
from bayesid.cli import options as shared
from bayesid.cli.options import bounded
from bayesid.cli.terminal import say
from bayesid.results.files import check_output


@click.command()
@shared.EXPERIMENT
@shared.model_options
@click.option("--method", help=f"{', '.join(bayesid.METHODS)}  [default: {bayesid.DEFAULT_METHOD}; with a mount that rings, gls]")
@shared.BOUNDS
@shared.STATIC
@click.option("--unconstrained-urdf", is_flag=True, help="Also write the links with exactly the estimated base parameters.")
@shared.on_workers
@shared.OUT
@shared.UNUSED_SEED
def identify(experiment, filter_l, filter_d, model, effects_from, method, bounds, out, **options) -> None:
    """Base parameters with their uncertainty, link parameters, and held-out validation."""
    check_output(out or shared.OUTPUTS, "identify")
    filters = shared.low_pass(filter_l, filter_d)
    chosen = None if method is None else bayesid.estimator(method)
    with shared.show_progress() as progress:
        progress("reading")
        loaded = shared.load(experiment, model, effects_from)
        if bounds is not None:
            chosen = bounded(chosen or bayesid.estimator(bayesid.DEFAULT_METHOD), bounds, loaded)
        result = bayesid.identify(loaded, method=chosen, low_pass=filters, progress=progress, **options)
        progress("report")
        report = result.write(shared.output_folder(out, loaded.name, "identify"))
    say(bayesid.summary(result), result.warnings)
    say(f"report: {report}")
