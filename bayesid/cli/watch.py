"""The verb ``watch``."""

from __future__ import annotations

from pathlib import Path

import click

import bayesid
from bayesid.cli import options as shared
from bayesid.cli.terminal import say
from bayesid.errors import EstimationError
from bayesid.results.files import check_output


@click.command()
@click.argument("reference", type=click.Path(path_type=Path))
@click.argument("recordings", type=click.Path(path_type=Path), nargs=-1, required=True)
@click.option("--channel", type=click.Choice(["wrench", "torque", "both"]), help="Which readings to compare.")
@click.option("--motions", callback=shared.names, help="Motions to compare, separated by commas.")
@shared.KNOWN_EFFECTS
@shared.MODEL
@shared.EFFECTS_FROM
@shared.on_workers
@shared.OUT
@shared.SEED
def watch(reference, recordings, channel, motions, effects, model, effects_from, out, seed, workers, scheduler) -> None:
    """A series of RECORDINGS against one REFERENCE of the same robot: what changed, and when."""
    check_output(out or shared.OUTPUTS, "watch")
    with shared.show_progress() as progress:
        progress("reading")
        known = shared.load(reference, model, effects_from)
        series = [shared.load(folder, model, effects_from) for folder in recordings]
        result = bayesid.watch(
            known, series, channel, motions=motions, effects=effects, seed=seed, workers=workers,
            scheduler=scheduler, progress=progress,
            tell=lambda recording: say(recording),
        )  # fmt: skip
        progress("report")
        report = result.write(shared.output_folder(out, known.name, "watch"))
    for sentence in result.sentences():
        say(f"  {sentence}.")
    say(f"report: {report}")
    done = len(result.recordings)
    if done < result.planned:
        raise EstimationError(f"interrupted after {done} of {result.planned} recordings; those are in the report")
