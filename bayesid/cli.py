"""The command line: parse arguments, call the library, say where the report is."""

from __future__ import annotations

import contextlib
import math
import sys
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import click
from rich.console import Console

import bayesid
from bayesid.comparison import DEFAULT_SET
from bayesid.demo import NAME as DEMO_NAME
from bayesid.demo import demo as run_demo
from bayesid.errors import BayesidError, EstimationError, InputError
from bayesid.filters import LowPass
from bayesid.output import check_output
from bayesid.plant import complete_effects
from bayesid.sampling import checkpoint_of
from bayesid.schema import read_model
from bayesid.simulation import Recorder, load_setup, write_simulation
from bayesid.trajectories import make_trajectories


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status: 0 done, 1 the work failed, 2 bad input or usage."""
    try:
        commands.main(list(sys.argv[1:] if arguments is None else arguments), prog_name="bayesid", standalone_mode=False)
    except InputError as error:
        return _fail(str(error), 2)
    except BayesidError as error:
        return _fail(str(error), 1)
    except click.exceptions.NoArgsIsHelpError as error:
        click.echo(error.format_message())
        return 2
    except click.ClickException as error:
        return _fail(error.format_message(), 2)
    except (click.Abort, KeyboardInterrupt):
        return _fail("interrupted; nothing was written", 1)
    except (OSError, MemoryError, ArithmeticError) as error:
        return _fail(f"failed: {error}", 1)
    return 0


def _fail(message: str, status: int) -> int:
    click.echo("bayesid: " + " ".join(message.split()), err=True)
    return status


@contextlib.contextmanager
def _progress() -> Iterator:
    """Shows the stage on a terminal; silent elsewhere. Library warnings become one line each."""
    console = Console(stderr=True)
    with warnings.catch_warnings():
        warnings.showwarning = lambda message, *_, **__: click.echo(f"warning: {message}", err=True)
        if not console.is_terminal:
            yield lambda stage: None
            return
        with console.status("starting") as status:
            yield lambda stage: status.update(f"{stage} ...")


@click.group(context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(bayesid.__version__, prog_name="bayesid")
def commands() -> None:
    """Inertial parameters of a robot from a base force/torque sensor and joint torques, with honest uncertainty."""


_EXPERIMENT = click.argument("experiment", type=click.Path(path_type=Path))
_OUT = click.option("--out", type=click.Path(path_type=Path), help="Folder for the results.")
_STATIC = click.option(
    "--static", type=click.Choice(["motion", "joint"]), default="motion", show_default=True,
    help="Subtract a stop-and-go run, or fit it along.",
)  # fmt: skip
_BOUNDS = click.option("--bounds", type=click.Path(path_type=Path), help="A TOML file of what is known of the links; for sdp.")
_SEED = click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Seed of everything random.")


def _names(_context, _parameter, value: str | None) -> list[str] | None:
    return None if value is None else [part.strip() for part in value.split(",") if part.strip()]


def _model_options(command):
    """Options of every verb that fits a model."""
    options = [
        click.option("--channel", type=click.Choice(["wrench", "torque", "both"]), help="Which readings to fit."),
        click.option("--filter-l", type=float, help="First low-pass of the paper [rad/s]; default: none."),
        click.option("--filter-d", type=float, help="Second low-pass of the paper [rad/s]; default 50 with --filter-l."),
        click.option("--bandwidth", type=float, help="Bandwidth of the joint motion [Hz]; default: from the positions."),
        click.option("--motions", callback=_names, help="Motions to fit, separated by commas."),
        click.option("--effects", callback=_names, help="Effects in the model, separated by commas."),
        click.option("--model", type=click.Path(path_type=Path), help="A model.toml that replaces [model]."),
    ]
    for option in reversed(options):
        command = option(command)
    return command


def _low_pass(l: float | None, d: float | None) -> LowPass | None:  # noqa: E741
    if l is None and d is None:
        return None
    if l is None:
        raise InputError("--filter-d is given without --filter-l; give both, for example --filter-l 1 --filter-d 50")
    return LowPass(l, 50.0 if d is None else d)


def _load(experiment: Path, model: Path | None):
    loaded = bayesid.load_experiment(experiment)
    if model is None:
        return loaded
    effects, values = read_model(model)
    return replace(loaded, effects=effects, effect_values=values)


def _bounded(method, bounds: Path | None, loaded):
    """The estimator with the bounds of a file."""
    if bounds is None:
        return method
    if not isinstance(method, bayesid.Physical):
        raise InputError(f"--bounds is given with --method {method.name}, which takes none; add --method sdp")
    return replace(method, bounds=bayesid.load_bounds(bounds, loaded.robot, loaded.locked))


def _all_bounded(names, bounds: Path, loaded) -> list:
    """Estimators by name, those that take bounds with the bounds of a file."""
    chosen = [bayesid.estimator(name) for name in names]
    if not any(isinstance(method, bayesid.Physical) for method in chosen):
        raise InputError("--bounds is given, but none of --methods takes any; add sdp to --methods")
    return [_bounded(method, bounds, loaded) if isinstance(method, bayesid.Physical) else method for method in chosen]


def _out(out: Path | None, name: str, verb: str) -> Path:
    return check_output(out or Path("bayesid-out") / f"{name}-{verb}")


@commands.command()
@_EXPERIMENT
@_OUT
@_SEED
def check(experiment: Path, out: Path | None, seed: int) -> None:
    """Read and validate an experiment folder; say what is in it."""
    del seed
    if out is not None:
        check_output(out)
    with _progress() as progress:
        result = bayesid.check(bayesid.load_experiment(experiment), progress=progress)
        report = result.write(_out(out, result.name, "check"))
    click.echo(str(result))
    click.echo(f"report: {report}")


@commands.command()
@_EXPERIMENT
@_model_options
@click.option("--method", default=bayesid.DEFAULT_METHOD, show_default=True, help=", ".join(bayesid.METHODS))
@_BOUNDS
@_STATIC
@_OUT
@_SEED
def identify(experiment, filter_l, filter_d, model, method, bounds, out, seed, **options) -> None:
    """Base parameters with honest uncertainty, link parameters, proof on the validation motions."""
    del seed
    if out is not None:
        check_output(out)
    filters = _low_pass(filter_l, filter_d)
    chosen = bayesid.estimator(method)
    with _progress() as progress:
        progress("reading")
        loaded = _load(experiment, model)
        chosen = _bounded(chosen, bounds, loaded)
        result = bayesid.identify(loaded, method=chosen, low_pass=filters, progress=progress, **options)
        progress("report")
        report = result.write(_out(out, loaded.name, "identify"))
    click.echo(bayesid.summary(result))
    click.echo(f"report: {report}")


@commands.command()
@_EXPERIMENT
@_model_options
@click.option("--methods", callback=_names, help="Estimators, separated by commas; default: one of each kind.")
@_BOUNDS
@_STATIC
@_OUT
@_SEED
def compare(experiment, filter_l, filter_d, model, methods, bounds, out, seed, **options) -> None:
    """Several estimators on the same data, side by side, and the nominal model beside them."""
    del seed
    if out is not None:
        check_output(out)
    filters = _low_pass(filter_l, filter_d)
    for method in methods or ():
        bayesid.estimator(method)
    with _progress() as progress:
        progress("reading")
        loaded = _load(experiment, model)
        if bounds is not None:
            methods = _all_bounded(methods or DEFAULT_SET, bounds, loaded)
        result = bayesid.compare(loaded, methods, low_pass=filters, progress=progress, **options)
        progress("report")
        report = result.write(_out(out, loaded.name, "compare"))
    click.echo(str(result))
    click.echo(f"report: {report}")


@commands.command()
@_EXPERIMENT
@_model_options
@click.option("--draws", type=int, default=2000, show_default=True, help="Draws in all.")
@click.option("--chains", type=int, default=4, show_default=True, help="Independent chains.")
@click.option("--prior", help="nominal or flat; default: nominal where the experiment has an inertia_rel_std above 0.")
@click.option("--prior-std", type=float, help="Relative standard deviation of every nominal mass; default: inertia_rel_std.")
@click.option("--noise", default="gaussian", show_default=True, help="gaussian, or student against outliers.")
@click.option("--engine", help="hmc or emcee; default: the one that suits.")
@click.option("--longest", type=int, default=32, show_default=True, help="Times the usual length before giving up.")
@click.option("--keep-going", is_flag=True, help="Write draws that have not converged, with a warning.")
@click.option("--resume", is_flag=True, help="Go on with a run of the same --out that was interrupted.")
@_STATIC
@_OUT
@_SEED
def sample(experiment, filter_l, filter_d, model, out, resume, **options) -> None:
    """Draws from the posterior, with convergence checks and proof on the validation motions."""
    if out is not None:
        check_output(out)
    filters = _low_pass(filter_l, filter_d)
    loaded = _load(experiment, model)
    folder = _out(out, loaded.name, "sample")
    kept = checkpoint_of(folder)
    try:
        with _progress() as progress:
            result = bayesid.sample(
                loaded, low_pass=filters, checkpoint=kept, resume=resume, progress=progress, **options
            )
            progress("report")
            report = result.write(folder)
    except KeyboardInterrupt:
        raise EstimationError(f"interrupted; add --resume to go on from {kept}" if kept.exists() else "interrupted") from None
    kept.unlink(missing_ok=True)
    click.echo(str(result))
    for warning in result.warnings:
        click.echo(f"  warning: {warning}")
    click.echo(f"report: {report}")


@commands.command()
@_EXPERIMENT
@click.option("--channel", type=click.Choice(["wrench", "torque", "both"]), help="Which readings to compare.")
@click.option("--motions", callback=_names, help="Motions to fit, separated by commas.")
@click.option("--effects", callback=_names, help="Effects that the model already has, separated by commas.")
@click.option("--model", type=click.Path(path_type=Path), help="A model.toml that replaces [model].")
@_OUT
@_SEED
def diagnose(experiment, channel, motions, effects, model, out, seed) -> None:
    """Where model and data disagree, which effect is missing, and proof on motions that were not fitted."""
    if out is not None:
        check_output(out)
    with _progress() as progress:
        progress("reading")
        loaded = _load(experiment, model)
        result = bayesid.diagnose(loaded, channel, motions=motions, effects=effects, seed=seed, progress=progress)
        progress("report")
        report = result.write(_out(out, loaded.name, "diagnose"))
    click.echo(str(result))
    click.echo(f"report: {report}")


@commands.command()
@_EXPERIMENT
@click.option("--new", is_flag=True, help="New random motions; default: those of the experiment's tables again.")
@click.option("--duration", type=float, help="Length of a new motion [s]; default 20.")
@click.option("--rate", type=float, help="Samples a second of a new motion; default 125.")
@click.option("--static/--no-static", default=None, help="Whether stop-and-go runs are made; default: as recorded, or none.")
@click.option("--effects", callback=_names, help="What the plant has beyond rigid bodies, by commas; default: [model] effects.")
@click.option("--model", type=click.Path(path_type=Path), help="A model.toml with values of the effects.")
@click.option("--perturb", type=float, default=0.0, help="Relative standard deviation of the true links about the nominal ones.")
@click.option("--force-std", type=float, help="Noise of a sample [N].")
@click.option("--torque-std", type=float, help="Noise of a sample [N m].")
@click.option("--resolution", type=float, help="One encoder count [rad or m].")
@click.option("--position-std", type=float, help="Random encoder noise [rad or m].")
@_OUT
@_SEED
def simulate(experiment, new, duration, rate, static, effects, model, perturb, out, seed, **instruments) -> None:
    """Simulate a recording with known truth (truth.json); [model] stays the experiment's, whatever the plant has."""
    if not new and (duration is not None or rate is not None):
        raise InputError(f"--{'rate' if duration is None else 'duration'} is for new motions; add --new")
    if not (math.isfinite(perturb) and perturb >= 0):
        raise InputError(f"--perturb {perturb}: give a number of at least 0, such as 0.1")
    if out is not None:
        check_output(out)
    recorder = Recorder(**instruments)
    with _progress() as progress:
        progress("simulating")
        setup = load_setup(experiment) if new else bayesid.load_experiment(experiment)
        hidden, values = (setup.effects, setup.effect_values) if model is None else read_model(model)
        plant = complete_effects(setup.robot, hidden if effects is None else effects, values)
        made = make_trajectories(
            setup, new=new, duration=20.0 if duration is None else duration, rate=125.0 if rate is None else rate,
            static=static, seed=seed,
        )  # fmt: skip
        simulation = bayesid.simulate(setup, made, effects=plant, perturb=perturb, recorder=recorder, seed=seed)
        folder = _out(out, simulation.name, "simulate")
        write_simulation(simulation, folder)
    for spec, given in simulation.truth.effects.items():
        click.echo(f"  {spec}: " + ", ".join(f"{key} {value:.4g}" for key, value in given.items()))
    for motion in simulation.motions:
        click.echo(f"  {motion.role} '{motion.name}': {len(motion.table)} samples" + (", static run" if motion.static else ""))
    click.echo(f"experiment: {folder}")


@commands.command()
@_OUT
@_SEED
def demo(out: Path | None, seed: int) -> None:
    """The main job on an embedded example: simulate a two-joint PUMA, identify it, compare with the truth."""
    with _progress() as progress:
        result = run_demo(_out(out, DEMO_NAME, "demo"), seed, progress)
    click.echo(str(result))
    click.echo(f"experiment: {result.report.parent / 'experiment'}")
    click.echo(f"report: {result.report}")


if __name__ == "__main__":
    sys.exit(main())
