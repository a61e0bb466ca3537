"""The verb ``identifiability``."""

from __future__ import annotations

from functools import partial

import click

import bayesid
from bayesid.cli import options as shared
from bayesid.errors import InputError
from bayesid.recordings.experiment import load_experiment, load_setup


def _noise(_context, _parameter, value: str | None) -> dict[str, float] | None:
    """Standard deviations from ``fx=0.5,torque=2``."""
    if value is None:
        return None
    out = {}
    for part in filter(None, (p.strip() for p in value.split(","))):
        name, equals, number = part.partition("=")
        try:
            out[name.strip()] = float(number)
        except ValueError:
            raise InputError(f"--noise {part}: write name=standard deviation, such as force=0.5,moment=0.05,torque=1") from None
    return out


@click.command()
@shared.EXPERIMENT
@click.option(
    "--trajectory", type=shared.FILE, multiple=True,
    help="A planned motion (columns t, q1 ...) as excite writes it, in place of the tables.",
)  # fmt: skip
@click.option("--sensor-sets", callback=shared.names, help="Sensor sets, separated by commas; default all.")
@click.option("--noise", callback=_noise, help="Noise of one sample, such as force=0.5,moment=0.05,torque=1,tau2=2.")
@click.option("--motions", callback=shared.names, help="Motions that count, separated by commas.")
@shared.EFFECTS
@click.option("--tell", callback=shared.names, help="Effects to be told apart, such as sensor_delay,base_tilt.")
@shared.BANDWIDTH
@shared.MODEL
@shared.EFFECTS_FROM
@shared.OUT
@shared.UNUSED_SEED
def identifiability(experiment, trajectory, model, effects_from, out, **options) -> None:
    """What these motions can and cannot determine, per sensor set."""
    with shared.running("identifiability", out) as run:
        read = load_setup if trajectory else partial(load_experiment, planned=True)
        loaded = shared.load(experiment, model, effects_from, read)
        result = bayesid.identifiability(loaded, trajectory or None, progress=run.progress, **options)
        run.finish(result, loaded.name)
