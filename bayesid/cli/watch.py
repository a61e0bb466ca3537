"""The verb ``watch``."""

from __future__ import annotations

import click

import bayesid
from bayesid.cli import options as shared
from bayesid.cli.terminal import say
from bayesid.errors import EstimationError


@click.command()
@click.argument("reference", type=shared.FILE)
@click.argument("recordings", type=shared.FILE, nargs=-1, required=True)
@shared.COMPARED_CHANNEL
@click.option("--motions", callback=shared.names, help="Motions to compare, separated by commas.")
@shared.KNOWN_EFFECTS
@shared.MODEL
@shared.EFFECTS_FROM
@shared.on_workers
@shared.OUT
@shared.SEED
def watch(reference, recordings, model, effects_from, out, **options) -> None:
    """A series of RECORDINGS against one REFERENCE of the same robot: what changed, and when."""
    with shared.running("watch", out) as run:
        known = shared.load(reference, model, effects_from)
        series = [shared.load(folder, model, effects_from) for folder in recordings]
        result = bayesid.watch(known, series, progress=run.progress, tell=say, **options)
        report = run.write(result, known.name)
    for sentence in result.sentences():
        say(f"  {sentence}.")
    for warning in result.all_warnings:
        say(f"  warning: {warning}")
    say(f"report: {report}")
    done = len(result.recordings)
    if done < result.planned:
        raise EstimationError(f"interrupted after {done} of {result.planned} recordings; those are in the report")
