"""The verb ``calibrate``."""

from __future__ import annotations

from pathlib import Path

import click

import bayesid
from bayesid.cli.options import EXPERIMENT, OUTPUTS, diagnosis_options, load, output_folder, show_progress
from bayesid.cli.terminal import say
from bayesid.results.files import check_output


@click.command()
@EXPERIMENT
@click.option("--reference", type=click.Path(path_type=Path), help="The same sensor without the known mass: a folder.")
@click.option("--mass", type=float, help="Known mass [kg] that it carries, or with --reference that was hung on.")
@click.option("--mass-std", type=float, default=0.0, show_default=True, help="Standard deviation of that mass [kg].")
@diagnosis_options
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
    say(result)
    if files := ", ".join(result.exports()):
        say(f"gravity compensation: {files} in {report.parent}")
    say(f"report: {report}")
