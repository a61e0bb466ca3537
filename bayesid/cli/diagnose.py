"""The verb ``diagnose``."""

from __future__ import annotations

from pathlib import Path

import click

import bayesid
from bayesid.cli.options import EXPERIMENT, OUTPUTS, diagnosis_options, load, output_folder, show_progress
from bayesid.cli.terminal import say
from bayesid.results.files import check_output


@click.command()
@EXPERIMENT
@click.option("--reference", type=click.Path(path_type=Path), help="The robot in its known state: a folder; names what changed.")
@click.option("--channel", type=click.Choice(["wrench", "torque", "both"]), help="Which readings to compare.")
@diagnosis_options
def diagnose(experiment, reference, channel, motions, effects, model, effects_from, out, seed) -> None:
    """Where model and data disagree, which effect is missing, and validation on motions that were not fitted."""
    check_output(out or OUTPUTS, "diagnose")
    with show_progress() as progress:
        progress("reading")
        loaded = load(experiment, model, effects_from)
        known = None if reference is None else load(reference, model, effects_from)
        result = bayesid.diagnose(
            loaded, channel, reference=known, motions=motions, effects=effects, seed=seed, progress=progress
        )
        progress("report")
        report = result.write(output_folder(out, loaded.name, "diagnose"))
    say(result)
    say(f"report: {report}")
