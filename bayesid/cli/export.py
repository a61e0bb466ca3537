"""The verb ``export``."""

from __future__ import annotations

from pathlib import Path

import click

import bayesid
from bayesid.cli.options import OUT, OUTPUTS, SEED, names, output_folder, show_progress
from bayesid.cli.terminal import say
from bayesid.results.files import check_output


@click.command()
@click.argument("result", type=click.Path(path_type=Path))
@click.option(
    "--to", callback=names, default="mjcf", show_default=True, help="mjcf, urdf, sdf, cpp, numpy, ranges; several by commas."
)
@click.option(
    "--draws", type=click.IntRange(min=0), default=0, show_default=True,
    help="How many draws of a posterior to write as robots of their own, in the forms mjcf and urdf.",
)  # fmt: skip
@OUT
@SEED
def export(result, to, draws, out, seed) -> None:
    """Hand an identified robot on: RESULT is a folder that identify or sample wrote."""
    check_output(out or OUTPUTS, "export")
    with show_progress() as progress:
        progress("reading")
        exported = bayesid.export(result, to, draws=draws, seed=seed, progress=progress)
        report = exported.write(output_folder(out, exported.name, "export"))
    say(exported)
    say(f"report: {report}")
