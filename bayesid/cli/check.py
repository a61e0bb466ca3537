"""The verb ``check``."""

from __future__ import annotations

from pathlib import Path

import click

import bayesid
from bayesid.cli.options import EXPERIMENT, OUT, OUTPUTS, SEED, output_folder, show_progress
from bayesid.results.files import check_output


@click.command()
@EXPERIMENT
@OUT
@SEED
def check(experiment: Path, out: Path | None, seed: int) -> None:
    """Read and validate an experiment folder; say what is in it."""
    del seed
    check_output(out or OUTPUTS, "check")
    with show_progress() as progress:
        result = bayesid.check(bayesid.load_experiment(experiment), progress=progress)
        report = result.write(output_folder(out, result.name, "check"))
    click.echo(str(result))
    click.echo(f"report: {report}")
