"""The verb ``diagnose``."""

from __future__ import annotations

import click

import bayesid
from bayesid.cli.options import COMPARED_CHANNEL, EXPERIMENT, FILE, diagnosis_options, load, names, running


@click.command()
@EXPERIMENT
@click.option("--reference", type=FILE, help="The robot in its known state: a folder; names what changed.")
@click.option("--tell", callback=names, help="Effects to be told apart, by commas: the next motion is the one that does that.")
@COMPARED_CHANNEL
@diagnosis_options
def diagnose(experiment, reference, model, effects_from, out, **options) -> None:
    """Where model and data disagree, which effect is missing, and validation on motions that were not fitted."""
    with running("diagnose", out) as run:
        loaded = load(experiment, model, effects_from)
        known = None if reference is None else load(reference, model, effects_from)
        result = bayesid.diagnose(loaded, reference=known, progress=run.progress, **options)
        run.finish(result, loaded.name)
