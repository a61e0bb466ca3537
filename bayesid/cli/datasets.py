"""The verb ``datasets``."""

from __future__ import annotations

import shutil
from pathlib import Path

import click

from bayesid import datasets as public
from bayesid.cli.options import FILE, UNUSED_SEED
from bayesid.cli.terminal import say
from bayesid.errors import InputError


@click.command()
@click.argument("name", required=False)
@click.option("--out", type=FILE, help="The experiment folder to be made; default: it stays in the cache.")
@UNUSED_SEED
def datasets(name, out) -> None:
    """List public recordings of real robots, or fetch the one of this NAME as an experiment folder."""
    if name is None:
        if out is not None:
            raise InputError(f"--out {out}: name the data set that is to be there")
        say("\n".join(str(public.about(each)) for each in public.names()))
        return
    if out is not None and out.exists():
        raise InputError(f"{out}: is there already; name a folder that does not exist or remove it first")
    folder = public.fetch(name)
    if out is not None:
        folder = Path(shutil.copytree(folder, out))
    say(public.about(name))
    say(f"experiment: {folder}")
