"""The verb ``check``."""

from __future__ import annotations

import gc
from pathlib import Path

import click

import bayesid
from bayesid.cli.options import EFFECTS_FROM, EXPERIMENT, OUT, UNUSED_SEED, load, running


@click.command()
@EXPERIMENT
@EFFECTS_FROM
@OUT
@UNUSED_SEED
def check(experiment: Path, effects_from: tuple[Path, ...], out: Path | None) -> None:
    """Read and validate an experiment folder; say what is in it."""
    gc.disable()  # the search for cyclic garbage takes a twentieth of a run of a second; `main` turns it on again
    with running("check", out) as run:
        result = bayesid.check(load(experiment, None, effects_from), progress=run.progress)
        run.finish(result, result.name)
