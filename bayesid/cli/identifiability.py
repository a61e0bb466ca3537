"""The verb ``identifiability``."""

from __future__ import annotations

from pathlib import Path

import click

import bayesid
from bayesid.cli import options as shared
from bayesid.cli.terminal import say
from bayesid.errors import InputError
from bayesid.recordings.experiment import load_experiment, load_setup
from bayesid.results.files import check_output


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
    "--trajectory",
    type=click.Path(path_type=Path),
    multiple=True,
    help="A planned motion (columns t, q1 ...) as excite writes it, in place of the tables.",
)
@click.option("--sensor-sets", callback=shared.names, help="Sensor sets, separated by commas; default all.")
@click.option("--noise", callback=_noise, help="Noise of one sample, such as force=0.5,moment=0.05,torque=1,tau2=2.")
@click.option("--motions", callback=shared.names, help="Motions that count, separated by commas.")
@click.option("--effects", callback=shared.names, help="Effects in the model, separated by commas.")
@click.option("--tell", callback=shared.names, help="Effects to be told apart, such as sensor_delay,base_tilt.")
@click.option("--bandwidth", type=float, help="Bandwidth of the joint motion [Hz]; default: from the positions.")
@shared.MODEL
@shared.EFFECTS_FROM
@shared.OUT
@shared.UNUSED_SEED
def identifiability(experiment, trajectory, model, effects_from, out, **options) -> None:
    """What these motions can and cannot determine, per sensor set."""
    check_output(out or shared.OUTPUTS, "identifiability")
    with shared.show_progress() as progress:
        progress("reading")
        library = shared.own_effects(effects_from)
        loaded = load_experiment(experiment, library, planned=True) if not trajectory else load_setup(experiment, library)
        loaded = loaded if model is None else loaded.with_model(model)
        result = bayesid.identifiability(loaded, trajectory or None, progress=progress, **options)
        progress("report")
        report = result.write(shared.output_folder(out, loaded.name, "identifiability"))
    say(result)
    say(f"report: {report}")
