"""The verb ``calibrate``."""

from __future__ import annotations

from pathlib import Path

import click

import bayesid
from bayesid.cli.options import EFFECTS_FROM, EXPERIMENT, MODEL, OUT, OUTPUTS, SEED, load, names, output_folder, show_progress
from bayesid.results.files import check_output


@click.command()
@EXPERIMENT
@click.option("--reference", type=click.Path(path_type=Path), help="The same sensor without the known mass: a folder.")
@click.option("--mass", type=float, help="Known mass [kg] that it carries, or with --reference that was hung on.")
@click.option("--mass-std", type=float, default=0.0, show_default=True, help="Standard deviation of that mass [kg].")
@click.option("--motions", callback=names, help="Motions to fit, separated by commas.")
@click.option("--effects", callback=names, help="Effects that the model already has, separated by commas.")
@MODEL
@EFFECTS_FROM
@OUT
@SEED
def calibrate(experiment, reference, mass, mass_std, motions, effects, model, effects_from, out, seed) -> None:
    """What a force/torque sensor in place has: offset, gain, cross-talk, orientation, origin, drift, delay."""
    check_output(out or OUTPUTS, "calibrate")
    with show_progress() as progress:
        progress("reading")
        loaded = load(experiment, model, effects_from)
        known = None if reference is None else load(reference, model, effects_from)
        result = bayesid.calibrate(
            loaded, reference=known, mass=mass, mass_std=mass_std, motions=motions, effects=effects, seed=seed, progress=progress
        )
        progress("report")
        report = result.write(output_folder(out, loaded.name, "calibrate"))
    click.echo(str(result))
    if files := ", ".join(result.exports()):
        click.echo(f"gravity compensation: {files} in {report.parent}")
    click.echo(f"report: {report}")
