"""The verb ``excite``."""

from __future__ import annotations

from dataclasses import fields
from functools import partial

import click

import bayesid
from bayesid.cli import options as shared
from bayesid.design.excitation.options import ExcitationOptions
from bayesid.errors import InputError
from bayesid.recordings.experiment import load_experiment, load_setup

_DEFAULT = {item.name: item.default for item in fields(ExcitationOptions)}


_numbers = shared.numbers("give numbers, separated by commas")


def _number(option: str, text: str, **more):
    name = option[2:].replace("-", "_")
    return click.option(option, type=type(_DEFAULT[name]), default=_DEFAULT[name], show_default=True, help=text, **more)


_options = shared.together(
    click.option(
        "--tell", callback=shared.names, help="Effects to be told apart, by commas: the motion that does that best instead."
    ),
    click.option("--channel", type=shared.CHANNELS, help="Readings; default: wrench with a [sensor]."),
    click.option("--static", is_flag=True, help="A stop-and-go run will be subtracted, as in the paper."),
    click.option("--criterion", default="d", show_default=True, help="d, a, e, condition or quantity."),
    click.option(
        "--quantity", "quantities", callback=shared.names, help="What counts: payload@JOINT, torque@FILE.csv, joint2.mcx ..."
    ),
    click.option("--kind", default="fourier", show_default=True, help="fourier; liu1998: one pass and a stop-and-go run."),
    _number("--duration", "Length of the motion [s]."),
    click.option("--period", type=float, help="After which it repeats [s]; default: half the length."),
    _number("--harmonics", "Multiples of the fundamental frequency."),
    _number("--rate", "Samples a second."),
    click.option("--joints", callback=shared.names, help="Joints that move, by commas; default: all."),
    _number("--share", "How much of the joints' limits is used at most."),
    _number("--torque-share", "How much of the effort limits is used at most."),
    click.option("--acceleration", callback=_numbers, help="Largest joint accelerations [rad/s^2 or m/s^2], one or one a joint."),
    click.option("--sensor-range", callback=_numbers, help="Largest readings: force,moment or six numbers [N, N m]."),
    _number("--sensor-share", "How much of the sensor's range is used at most, the robot's weight included."),
    click.option("--mount-frequency", type=float, help="Resonance of the sensor's mount [Hz]: the motion stays below a fifth."),
    click.option("--collisions/--no-collisions", default=True, help="Whether bodies of the URDF are kept apart."),
    _number("--margin", "Least distance of bodies [m]."),
    click.option("--ground", type=float, help="Height of a ground that is kept clear [m], in the base frame."),
    click.option("--diagnosability", type=float, help="Weight of which effects could be told apart; 0: only the table."),
    click.option("--blocks", callback=shared.names, help="Scripted blocks: parked,poses,reversed,ladder, or all."),
    click.option("--stops", type=int, help="Stops of a static run; default: every sample, with --static."),
    _number("--settle", "How long the robot waits at a stop before it is read [s]."),
    _number("--read", "How long it is read at a stop [s]."),
    click.option("--warm-start", help="A motion to start from: a table t, q1 ..., or the name of a recorded motion."),
    _number("--starts", "How many motions are improved."),
    _number("--randoms", "How many random motions they are chosen from."),
    _number("--seconds", "No other improvement is begun after so long [s]."),
)


@click.command()
@shared.EXPERIMENT
@_options
@shared.MODEL
@shared.EFFECTS_FROM
@shared.on_workers
@shared.OUT
@shared.SEED
def excite(
    experiment, model, effects_from, out, joints, blocks, quantities, tell, warm_start, seed, workers, scheduler, **options
) -> None:
    """An exciting trajectory within limits: trajectory.csv; needs experiment.toml and the URDF only."""
    with shared.running("excite", out) as run:
        # What recordings tell already counts where effects are to be told apart.
        read = load_setup if tell is None else partial(load_experiment, planned=True)
        setup = shared.load(experiment, model, effects_from, read)
        run.folder(setup.name)  # can be written, before the long work
        chosen = ExcitationOptions(joints=joints, blocks=blocks or (), quantities=quantities or (), **options)
        if tell is None:
            result = bayesid.excite(
                setup, chosen, warm_start=warm_start, seed=seed, workers=workers, scheduler=scheduler, progress=run.progress
            )
        else:
            others = {
                "--warm-start": warm_start, "--blocks": blocks, "--quantity": quantities, "--workers": workers,
                "--scheduler": scheduler,
            }  # fmt: skip
            for name in (name for name, given in others.items() if given):
                raise InputError(f"{name} is given with --tell; leave one of them out")
            result = bayesid.tell(setup, tell, chosen, seed=seed, progress=run.progress)
        run.finish(result, setup.name, "trajectory: {folder}/trajectory.csv")
