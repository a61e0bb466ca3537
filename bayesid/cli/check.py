"""The verb ``check``."""

from __future__ import annotations

import gc
from pathlib import Path

import click

import bayesid
from bayesid.cli.options import EFFECTS_FROM, EXPERIMENT, OUT, OUTPUTS, UNUSED_SEED, load, output_folder, show_progress
from bayesid.cli.terminal import say
from bayesid.results.files import check_output


@click.command()
@EXPERIMENT
@EFFECTS_FROM
@OUT
@UNUSED_SEED
def check(experiment: Path, effects_from: tuple[Path, ...], out: Path | None) -> None:
    """Read and validate an experiment folder; say what is in it."""
    gc.disable()  # the search for cyclic garbage takes a twentieth of a run of a second; `main` turns it on again
    check_output(out or OUTPUTS, "check")
    with show_progress() as progress:
        result = bayesid.check(load(experiment, None, effects_from), progress=progress)
        report = result.write(output_folder(out, result.name, "check"))
    say(result)
    say(f"report: {report}")
