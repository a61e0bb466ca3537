"""The verb ``compare``."""

from __future__ import annotations

import click

import bayesid
from bayesid.cli import options as shared
from bayesid.workflows.compare import DEFAULT_SET


@click.command()
@shared.EXPERIMENT
@shared.model_options
@click.option("--methods", callback=shared.names, help="Estimators, separated by commas; default: one of each kind.")
@shared.BOUNDS
@shared.STATIC
@shared.on_workers
@shared.OUT
@shared.UNUSED_SEED
def compare(experiment, filter_l, filter_d, model, effects_from, methods, bounds, out, **options) -> None:
    """Several estimators on the same data, side by side, and the nominal model beside them."""
    with shared.running("compare", out) as run:
        filters = shared.low_pass(filter_l, filter_d)
        for method in methods or ():
            bayesid.estimator(method)
        loaded = shared.load(experiment, model, effects_from)
        if bounds is not None:
            methods = shared.all_bounded(methods or DEFAULT_SET, bounds, loaded)
        result = bayesid.compare(loaded, methods, low_pass=filters, progress=run.progress, **options)
        run.finish(result, loaded.name)
