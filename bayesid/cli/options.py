"""Options that verbs share, and what they mean."""

from __future__ import annotations

import contextlib
import functools
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from bayesid.cli.terminal import say
from bayesid.errors import InputError

if TYPE_CHECKING:
    from bayesid.effects import EffectLibrary
    from bayesid.estimators import Estimator
    from bayesid.recordings.experiment import Experiment
    from bayesid.results.files import Result
    from bayesid.signals.filters import LowPass


@contextlib.contextmanager
def show_progress() -> Iterator:
    """Shows the stage on a terminal; silent elsewhere. Library warnings become one line each."""
    from rich.console import Console

    console = Console(stderr=True)
    with warnings.catch_warnings():
        warnings.showwarning = lambda message, *_, **__: click.echo(f"warning: {message}", err=True)
        if not console.is_terminal:
            yield lambda stage: None
            return
        with console.status("starting") as status:
            yield lambda stage: status.update(f"{stage} ...")


@dataclass(frozen=True)
class Run:
    """A verb at work."""

    verb: str
    out: Path | None  # where results go, as given
    progress: Callable[[str], None]
    said: list[object] = field(default_factory=list)  # what is printed once it is done

    def folder(self, name: str) -> Path:
        """``--out``, or the default folder of the verb for an experiment; an `InputError` where it cannot be written."""
        return output_folder(self.out, name, self.verb)

    def write(self, result: Result, name: str) -> Path:
        """Write a result into its `folder`; the report's path."""
        self.progress("report")
        return result.write(self.folder(name))

    def finish(self, result: Result, name: str, *lines: str) -> None:
        """Write a result; once the verb is done, print it, some lines on files in its ``{folder}``, and where its report is."""
        report = self.write(result, name)
        self.said.extend([result, *(line.format(folder=report.parent) for line in lines), f"report: {report}"])

    @contextlib.contextmanager
    def resumable(self, name: str) -> Iterator[Path]:
        """The file beside the results that keeps an unfinished run; gone once that is done, named where it is interrupted."""
        folder = self.folder(name)
        kept = folder.parent / f".{folder.name}-checkpoint.npz"
        try:
            yield kept
        except KeyboardInterrupt:
            if kept.exists():
                raise KeyboardInterrupt(f"add --resume to go on from {kept}") from None
            raise
        kept.unlink(missing_ok=True)


@contextlib.contextmanager
def running(verb: str, out: Path | None) -> Iterator[Run]:
    """A verb at work, once it is clear that its results can be written."""
    from bayesid.results.files import check_output

    check_output(out or OUTPUTS, verb)
    with show_progress() as progress:
        progress("reading")
        run = Run(verb, out, progress)
        yield run
    for text in run.said:
        say(text)


def together(*options: Callable) -> Callable:
    """Several options as one decorator, listed in this order."""
    return lambda command: functools.reduce(lambda made, option: option(made), reversed(options), command)


def one_method(command: Callable) -> Callable:
    """``--method`` of a verb that fits with one estimator."""
    from bayesid.estimators import DEFAULT_METHOD, METHODS  # not of every verb: that takes time

    told = f"{', '.join(METHODS)}  [default: {DEFAULT_METHOD}; with a mount that rings, gls]"
    return click.option("--method", callback=as_estimator, help=told)(command)


def as_estimator(_context, _parameter, name: str | None) -> Estimator | None:
    """The estimator that an option names."""
    from bayesid.estimators import estimator

    return None if name is None else estimator(name)


def names(_context, _parameter, value: str | None) -> list[str] | None:
    """Parts of an option that commas separate."""
    return None if value is None else [part.strip() for part in value.split(",") if part.strip()]


def numbers(hint: str, count: int | None = None, kind: type[float] = float) -> Callable:
    """Reads numbers of a kind that commas separate, so many where ``count`` is given; a complaint ends with the ``hint``."""

    def read(_context, parameter, value: str | None) -> tuple[float, ...] | None:
        if value is None:
            return None
        try:
            found = tuple(map(kind, value.split(",")))
        except ValueError:
            found = ()
        if not found or count not in (None, len(found)):
            raise InputError(f"{parameter.opts[0]} {value}: {hint}")
        return found

    return read


#: Where results go by default: a folder a verb and experiment.
OUTPUTS = Path("bayesid-out")
FILE = click.Path(path_type=Path)
CHANNELS = click.Choice(["wrench", "torque", "both"])
EXPERIMENT = click.argument("experiment", type=FILE)
OUT = click.option("--out", type=FILE, help="Folder for the results.")
STATIC = click.option(
    "--static", type=click.Choice(["motion", "joint"]), default="motion", show_default=True,
    help="Subtract a stop-and-go run, or fit it along.",
)  # fmt: skip
BOUNDS = click.option("--bounds", type=FILE, help="A TOML file of what is known of the links; for sdp.")
MODEL = click.option("--model", type=FILE, help="A model.toml that replaces [model].")
EFFECTS_FROM = click.option(
    "--effects-from", type=FILE, multiple=True, help="A Python file with effects of your own, or a draft_effect.toml."
)
UNUSED_SEED = click.option(
    "--seed", type=click.IntRange(min=0), default=0, expose_value=False,
    help="Accepted by every verb; the results of this one are the same for any seed.",
)  # fmt: skip
SEED = click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Seed of everything random.")
#: Options of every verb with many runs that depend on nothing but their number, or with recordings read in chunks.
on_workers = together(
    click.option("--workers", type=click.IntRange(min=1), help="Processes on this machine that share the work; needs Dask."),
    click.option("--scheduler", help="Address of a running Dask cluster that does the work, such as tcp://10.0.0.1:8786."),
)
CHANNEL = click.option("--channel", type=CHANNELS, help="Which readings to fit.")
COMPARED_CHANNEL = click.option("--channel", type=CHANNELS, help="Which readings to compare.")
MOTIONS = click.option("--motions", callback=names, help="Motions to fit, separated by commas.")
KNOWN_EFFECTS = click.option("--effects", callback=names, help="Effects that the model already has, separated by commas.")
EFFECTS = click.option("--effects", callback=names, help="Effects in the model, separated by commas.")
BANDWIDTH = click.option("--bandwidth", type=float, help="Bandwidth of the joint motion [Hz]; default: from the positions.")
#: Options of every verb that looks for effects in a recording.
diagnosis_options = together(MOTIONS, KNOWN_EFFECTS, MODEL, EFFECTS_FROM, OUT, SEED)
#: Options of every verb that fits a model.
model_options = together(
    CHANNEL,
    click.option("--filter-l", type=float, help="First low-pass of the paper [rad/s]; default: none."),
    click.option("--filter-d", type=float, help="Second low-pass of the paper [rad/s]; default 50 with --filter-l."),
    BANDWIDTH, MOTIONS, EFFECTS, MODEL, EFFECTS_FROM,
)  # fmt: skip


def low_pass(l: float | None, d: float | None) -> LowPass | None:
    """The paper's filters, or None where neither option is given."""
    from bayesid.signals.filters import LowPass

    if l is None and d is None:
        return None
    if l is None:
        raise InputError("--filter-d is given without --filter-l; give both, for example --filter-l 1 --filter-d 50")
    return LowPass(l, 50.0 if d is None else d)


def load(
    experiment: Path, model: Path | None, effects_from: Sequence[Path], read: Callable[..., Experiment] | None = None
) -> Experiment:
    """The experiment folder, with the user's own effects, and with the model of another file where one is named."""
    from bayesid.recordings.experiment import load_experiment

    loaded = (read or load_experiment)(experiment, own_effects(effects_from))
    return loaded if model is None else loaded.with_model(model)


def own_effects(files: Sequence[Path]) -> EffectLibrary | None:
    """The effects that there are with those of Python files and of model.toml files' formulas; None without any."""
    from bayesid.effects import EffectLibrary, load_effects
    from bayesid.recordings.schema import read_model

    library = None
    for path in files:
        if path.suffix == ".toml":
            formulas = read_model(path)[2]
            if not formulas:
                raise InputError(f"{path}: holds no effect; write its formulas into [model.expressions.NAME]")
            library = (library or EffectLibrary()).with_expressions(formulas, None, path.name)
        else:
            library = load_effects(path, library)
    return library


def output_folder(out: Path | None, name: str, verb: str) -> Path:
    """Where the results go: ``--out``, or the default folder of the verb."""
    from bayesid.results.files import check_output

    return check_output(out or OUTPUTS / f"{name}-{verb}")


def bounded(method, bounds: Path | None, loaded):
    """The estimator with the bounds of a file."""
    from bayesid.estimators.conic.bounds import load_bounds
    from bayesid.estimators.conic.physical import Physical

    if bounds is None:
        return method
    if not isinstance(method, Physical):
        name = "the default one" if method is None else method.name
        raise InputError(f"--bounds is for an estimator that keeps to bounds, which {name} does not; add --method sdp")
    return replace(method, bounds=load_bounds(bounds, loaded.robot, loaded.locked))


def all_bounded(names, bounds: Path, loaded) -> list:
    """Estimators by name, those that take bounds with the bounds of a file."""
    from bayesid.estimators import Physical, estimator

    chosen = [estimator(name) for name in names]
    if not any(isinstance(method, Physical) for method in chosen):
        raise InputError("--bounds is given, but none of --methods takes any; add sdp to --methods")
    return [bounded(method, bounds, loaded) if isinstance(method, Physical) else method for method in chosen]
