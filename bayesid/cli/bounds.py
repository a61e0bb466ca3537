"""The verb ``bounds``."""

from __future__ import annotations

from pathlib import Path

import click

import bayesid
from bayesid.cli import options as shared
from bayesid.errors import InputError
from bayesid.estimators import Estimator


@click.command()
@shared.EXPERIMENT
@shared.model_options
@click.option("--posterior", type=shared.FILE, help="Folder that bayesid sample wrote; default: sample now.")
@click.option("--estimate", type=shared.FILE, help="Folder that bayesid identify wrote.")
@click.option("--method", callback=shared.as_estimator, help="Identify with this estimator and do not sample.")
@shared.BOUNDS
@click.option("--static", type=click.Choice(["motion", "joint"]), help="Subtract a stop-and-go run (default), or fit it along.")
@click.option("--trajectory", type=shared.FILE, help="A planned motion, a table with t, q1 ...: its readings get bands.")
@click.option("--urdfs", type=click.IntRange(min=0), default=0, show_default=True, help="How many sampled URDFs to write.")
@click.option("--prior-std", type=float, help="Relative standard deviation of every nominal mass; default: inertia_rel_std.")
@click.option(
    "--configurations", type=click.IntRange(min=1), default=512, show_default=True, help="Joint positions of the workspace."
)
@shared.OUT
@shared.SEED
def bounds(experiment, filter_l, filter_d, model, effects_from, posterior, estimate, method, bounds, out, **options) -> None:
    """What a controller may rely on: bounds of parameters, mass matrix, gravity and torques."""
    with shared.running("bounds", out) as run:
        filters = shared.low_pass(filter_l, filter_d)
        known = _run(posterior, estimate, method, bounds)
        loaded = shared.load(experiment, model, effects_from)
        run.folder(loaded.name)  # can be written, before the long work
        chosen = shared.bounded(method, bounds, loaded)
        result = bayesid.bounds(loaded, run=known, method=chosen, low_pass=filters, progress=run.progress, **options)
        run.finish(result, loaded.name)


def _run(posterior: Path | None, estimate: Path | None, method: Estimator | None, bounds: Path | None) -> Path | None:
    """The file of the run that is named; None where none is."""
    if posterior is not None and estimate is not None:
        raise InputError("--posterior and --estimate are both given; name one run")
    kind, run = ("posterior", posterior) if estimate is None else ("estimate", estimate)
    if run is not None and (method is not None or bounds is not None):
        raise InputError(f"--{kind} names a run that was made; leave out {'--method' if method else '--bounds'}")
    if bounds is not None and method is None:
        raise InputError("--bounds is for estimators that take it; add --method sdp")
    return None if run is None else run / f"{kind}.json"
