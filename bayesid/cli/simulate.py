"""The verb ``simulate``."""

from __future__ import annotations

from dataclasses import replace

import click

import bayesid
from bayesid.cli import options as shared
from bayesid.cli.terminal import say
from bayesid.errors import InputError
from bayesid.recordings.experiment import load_setup
from bayesid.results.files import check_output
from bayesid.simulation.simulation import Recorder, complete_effects, write_simulation
from bayesid.simulation.trajectories import make_trajectories, planned_trajectories


@click.command()
@shared.EXPERIMENT
@click.option("--new", is_flag=True, help="New random motions; default: those of the experiment's tables again.")
@click.option(
    "--trajectory", type=shared.FILE, multiple=True,
    help="A planned motion (columns t, q1 ..., v1 ..., a1 ...), as excite writes it; several: the last is for validation.",
)  # fmt: skip
@click.option("--duration", type=float, help="Length of a new motion [s]; default 20.")
@click.option("--rate", type=float, help="Samples a second of a new motion; default 125.")
@click.option("--static/--no-static", default=None, help="Whether stop-and-go runs are made; default: as recorded, or none.")
@click.option(
    "--effects", callback=shared.names, help="What the plant has beyond rigid bodies, by commas; default: [model] effects."
)
@click.option("--model", type=shared.FILE, help="A model.toml with values of the effects.")
@click.option("--perturb", type=float, default=0.0, help="Relative standard deviation of the true links about the nominal ones.")
@click.option("--force-std", type=float, help="Noise of a sample [N].")
@click.option("--torque-std", type=float, help="Noise of a sample [N m].")
@click.option("--resolution", type=float, help="One encoder count [rad or m].")
@click.option("--position-std", type=float, help="Random encoder noise [rad or m].")
@shared.EFFECTS_FROM
@shared.OUT
@shared.SEED
def simulate(
    experiment, new, trajectory, duration, rate, static, effects, model, effects_from, perturb, out, seed, **instruments
) -> None:
    """Simulate a recording with known truth (truth.json); [model] stays the experiment's, whatever the plant has."""
    if not new and (duration is not None or rate is not None):
        raise InputError(f"--{'rate' if duration is None else 'duration'} is for new motions; add --new")
    if trajectory and new:
        raise InputError("--trajectory is given with --new; name the motions, or let new ones be made")
    check_output(out or shared.OUTPUTS)
    recorder = Recorder(**instruments)
    with shared.show_progress() as progress:
        progress("simulating")
        library = shared.own_effects(effects_from)
        setup = load_setup(experiment, library) if new or trajectory else bayesid.load_experiment(experiment, library)
        given = setup if model is None else setup.with_model(model)
        setup = replace(setup, library=given.library)
        plant = complete_effects(setup.robot, given.effects if effects is None else effects, given.effect_values, setup.library)
        made = planned_trajectories(setup.robot, trajectory, bool(static)) if trajectory else make_trajectories(
            setup, new=new, duration=20.0 if duration is None else duration, rate=125.0 if rate is None else rate,
            static=static, seed=seed,
        )  # fmt: skip
        simulation = bayesid.simulate(setup, made, effects=plant, perturb=perturb, recorder=recorder, seed=seed)
        folder = shared.output_folder(out, simulation.name, "simulate")
        write_simulation(simulation, folder)
    for text in setup.warnings:
        say(f"  warning: {text}")
    for spec, given in simulation.truth.effects.items():
        say(f"  {spec}: " + ", ".join(f"{key} {value:.4g}" for key, value in given.items()))
    for motion in simulation.motions:
        say(f"  {motion.role} '{motion.name}': {len(motion.table)} samples" + (", static run" if motion.static else ""))
    say(f"experiment: {folder}")
