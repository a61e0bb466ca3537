"""The verb ``calibrate``."""

from __future__ import annotations

import click

import bayesid
from bayesid.cli.options import EXPERIMENT, FILE, diagnosis_options, load, running


@click.command()
@EXPERIMENT
@click.option("--reference", type=FILE, help="The same sensor without the known mass: a folder.")
@click.option("--mass", type=float, help="Known mass [kg] that it carries, or with --reference that was hung on.")
@click.option("--mass-std", type=float, default=0.0, show_default=True, help="Standard deviation of that mass [kg].")
@diagnosis_options
def calibrate(experiment, reference, model, effects_from, out, **options) -> None:
    """What a force/torque sensor in place has: offset, gain, cross-talk, orientation, origin, drift, delay."""
    with running("calibrate", out) as run:
        loaded = load(experiment, model, effects_from)
        known = None if reference is None else load(reference, model, effects_from)
        result = bayesid.calibrate(loaded, reference=known, progress=run.progress, **options)
        files = ", ".join(result.exports())
        run.finish(result, loaded.name, *[f"gravity compensation: {files} in {{folder}}"] * bool(files))
