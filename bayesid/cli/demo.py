"""The verb ``demo``."""

from __future__ import annotations

from pathlib import Path

import click

from bayesid.cli.options import OUT, SEED, output_folder, show_progress
from bayesid.cli.terminal import say
from bayesid.workflows.demo import NAME
from bayesid.workflows.demo import demo as run_demo


@click.command()
@OUT
@SEED
def demo(out: Path | None, seed: int) -> None:
    """The main job on an embedded example: simulate a two-joint PUMA, identify it, compare with the truth."""
    with show_progress() as progress:
        result = run_demo(output_folder(out, NAME, "demo"), seed, progress)
    say(result)
    say(f"experiment: {result.report.parent / 'experiment'}")
    say(f"report: {result.report}")
