"""The verb ``payload``."""

from __future__ import annotations

import click

import bayesid
from bayesid.cli.options import CHANNEL, EXPERIMENT, FILE, diagnosis_options, load, numbers, running

_TWO = numbers("give two numbers, KG,M, such as 0.005,0.001", 2)


@click.command()
@EXPERIMENT
@click.option("--reference", type=FILE, help="The robot without the payload: a folder.")
@CHANNEL
@click.option("--joint", help="Joint whose link carries the payload; default: the last one, or the sensor's.")
@click.option("--frame", help="URDF link in whose frame it is given; default: the flange.")
@click.option("--extent", type=float, help="No part of it is farther from its centre of mass [m]; bounds what is not shown.")
@click.option("--next", "target", callback=_TWO, help="KG,M: half intervals wanted; proposes poses that reach them.")
@click.option("--diagnosis/--no-diagnosis", default=True, help="Look for what else is in the readings.")
@diagnosis_options
def payload(experiment, reference, model, effects_from, out, **options) -> None:
    """Mass, centre of mass and inertia of what the last link carries, in the forms that controllers take."""
    with running("payload", out) as run:
        loaded = load(experiment, model, effects_from)
        known = None if reference is None else load(reference, model, effects_from)
        result = bayesid.payload(loaded, reference=known, progress=run.progress, **options)
        files = ", ".join(result.exports())
        run.finish(result, loaded.name, *[f"for controllers: {files} in {{folder}}"] * bool(files))
