"""The verb ``identify``."""

from __future__ import annotations

import click

import bayesid
from bayesid.cli import options as shared
from bayesid.cli.terminal import say


@click.command()
@shared.EXPERIMENT
@shared.model_options
@shared.one_method
@shared.BOUNDS
@shared.STATIC
@click.option("--unconstrained-urdf", is_flag=True, help="Also write the links with exactly the estimated base parameters.")
@shared.on_workers
@shared.OUT
@shared.UNUSED_SEED
def identify(experiment, filter_l, filter_d, model, effects_from, method, bounds, out, **options) -> None:
    """Base parameters with their uncertainty, link parameters, and held-out validation."""
    with shared.running("identify", out) as run:
        filters = shared.low_pass(filter_l, filter_d)
        loaded = shared.load(experiment, model, effects_from)
        chosen = shared.bounded(method, bounds, loaded)
        result = bayesid.identify(loaded, method=chosen, low_pass=filters, progress=run.progress, **options)
        report = run.write(result, loaded.name)
    say(bayesid.summary(result), result.warnings)
    say(f"report: {report}")
