"""The verb ``watch``."""

from __future__ import annotations

from pathlib import Path

import click

import bayesid
from bayesid.cli.options import (
    EFFECTS_FROM,
    KNOWN_EFFECTS,
    MODEL,
    OUT,
    OUTPUTS,
    SEED,
    load,
    names,
    on_workers,
    output_folder,
    show_progress,
)
from bayesid.cli.terminal import say
from bayesid.errors import EstimationError
from bayesid.results.files import check_output


@click.command()
@click.argument("reference", type=click.Path(path_type=Path))
@click.argument("recordings", type=click.Path(path_type=Path), nargs=-1, required=True)
@click.option("--channel", type=click.Choice(["wrench", "torque", "both"]), help="Which readings to compare.")
@click.option("--motions", callback=names, help="Motions to compare, separated by commas.")
@KNOWN_EFFECTS
@MODEL
@EFFECTS_FROM
@on_workers
@OUT
@SEED
def watch(reference, recordings, channel, motions, effects, model, effects_from, out, seed, workers, scheduler) -> None:
    """A series of RECORDINGS against one REFERENCE of the same robot: what changed, and when."""
    check_output(out or OUTPUTS, "watch")
    with show_progress() as progress:
        progress("reading")
        known = load(reference, model, effects_from)
        series = [load(folder, model, effects_from) for folder in recordings]
        result = bayesid.watch(
            known, series, channel, motions=motions, effects=effects, seed=seed, workers=workers,
            scheduler=scheduler, progress=progress,
            tell=lambda recording: say(recording),
        )  # fmt: skip
        progress("report")
        report = result.write(output_folder(out, known.name, "watch"))
    for sentence in result.sentences():
        say(f"  {sentence}.")
    say(f"report: {report}")
    done = len(result.recordings)
    if done < result.planned:
        raise EstimationError(f"interrupted after {done} of {result.planned} recordings; those are in the report")
