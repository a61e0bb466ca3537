"""The verb ``export``."""

from __future__ import annotations

import click

import bayesid
from bayesid.cli.options import FILE, OUT, SEED, names, running


@click.command()
@click.argument("result", type=FILE)
@click.option(
    "--to", callback=names, default="mjcf", show_default=True, help="mjcf, urdf, sdf, cpp, numpy, ranges; several by commas."
)
@click.option(
    "--draws", type=click.IntRange(min=0), default=0, show_default=True,
    help="How many draws of a posterior to write as robots of their own, in the forms mjcf and urdf.",
)  # fmt: skip
@OUT
@SEED
def export(result, to, out, **options) -> None:
    """Hand an identified robot on: RESULT is a folder that identify or sample wrote."""
    with running("export", out) as run:
        exported = bayesid.export(result, to, progress=run.progress, **options)
        run.finish(exported, exported.name)
