"""The group of verbs, and how a failure is shown."""

from __future__ import annotations

import contextlib
import keyword
import os
import sys
import traceback
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module

import click

from bayesid.arguments import on_command_line
from bayesid.cli.terminal import colours
from bayesid.errors import BayesidError, InputError

#: What each verb does; its command stands in the module of its name.
VERBS = {
    "accuracy": "What errors depend on, effects left out, whether intervals hold.",
    "bounds": "What a controller may rely on: bounds of parameters, mass matrix and torques.",
    "calibrate": "What a force/torque sensor in place has: offset, gain, cross-talk, orientation.",
    "check": "Read and validate an experiment folder; say what is in it.",
    "compare": "Several estimators on the same data, side by side.",
    "datasets": "Public recordings of real robots: what there is, and each as an experiment.",
    "demo": "The main job on an embedded example, in under a minute.",
    "diagnose": "Where model and data disagree, and which effect is missing.",
    "excite": "An exciting trajectory within limits.",
    "export": "An identified robot as MJCF, URDF, SDF, C++, NumPy, or ranges for learning.",
    "identifiability": "What these motions can and cannot determine, per sensor set.",
    "identify": "Base parameters with 95 % intervals, and link parameters.",
    "import": "Files of other tools (bags, MCAP, CSV, MAT, ...) into an experiment folder.",
    "payload": "Mass, centre of mass and inertia of what hangs at the flange.",
    "sample": "Draws from the posterior, with convergence checks.",
    "simulate": "A recording from the model, with known truth.",
    "watch": "A series of recordings against one reference: what changed, when.",
}


class Verbs(click.Group):
    """Imports a verb's module when the verb is called: ``--help`` and ``--version`` need none of them."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Names of the verbs."""
        return list(VERBS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """The verb's command, or None."""
        module = f"{cmd_name}_" if keyword.iskeyword(cmd_name) else cmd_name
        return getattr(import_module(f"bayesid.cli.{module}"), module) if cmd_name in VERBS else None

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Verbs with what they do, without importing them."""
        with formatter.section("Verbs"):
            formatter.write_dl(list(VERBS.items()))


@dataclass
class _Telling:
    """How a failure is shown: with a traceback, or in its one line alone."""

    traceback: bool = False

    def fail(self, message: str, status: int) -> int:
        """Tell why the program ends; returns the status."""
        with contextlib.suppress(OSError):  # nobody reads
            if self.traceback:
                click.echo(traceback.format_exc(), err=True)
            name = click.style("bayesid:", fg="red") if colours(sys.stderr) else "bayesid:"
            click.echo(f"{name} {_plain(message)}", err=True)
        return status


def run(arguments: Sequence[str]) -> int:
    """Run the verb that the arguments name; every failure but a KeyboardInterrupt is shown in one line.

    The status is 0 (done), 1 (the work failed) or 2 (bad input or usage).
    """
    telling = _Telling()
    try:
        with on_command_line(), commands.make_context("bayesid", list(arguments), obj=telling) as context:
            commands.invoke(context)
        if sys.stdout is not None:
            sys.stdout.flush()
    except BrokenPipeError:
        # Whoever read the output has enough of it, and the files are written. Nothing must be left to flush at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    except InputError as error:
        return telling.fail(str(error), 2)
    except BayesidError as error:
        return telling.fail(str(error), 1)
    except click.exceptions.NoArgsIsHelpError as error:
        click.echo(error.format_message())
        return 2
    except click.ClickException as error:
        return telling.fail(error.format_message(), 2)
    except click.exceptions.Exit as done:  # --help, --version
        return done.exit_code
    except MemoryError as error:
        detail = f" ({error})" if str(error) else ""
        return telling.fail(f"out of memory{detail}; fit fewer motions (--motions), or record at a lower rate", 1)
    except Exception as error:  # whatever else there is, a user gets one line
        return telling.fail(_fault(error), 1)
    return 0


def _fault(error: Exception) -> str:
    """What to say of an error that nobody expected: of the system, or a fault of bayesid itself."""
    if isinstance(error, OSError) and error.strerror:
        place = f"{error.filename}: " if error.filename else ""
        return f"{place}{error.strerror}; make room or give access, and run it again"
    what = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
    return (
        f"failed on these data ({_plain(what)[:160]}); look for doubtful values with bayesid check; "
        "bayesid --traceback ... shows where it failed"
    )


#: A word longer than this is a broken file's; only a path may be [characters].
_LONGEST_WORD = 200


def _plain(text: str) -> str:
    """One line that a terminal only shows, and that can be read."""
    words = "".join(c if c.isprintable() else " " for c in text).split()
    return " ".join(w if len(w) <= _LONGEST_WORD or "/" in w else w[: _LONGEST_WORD - 3] + "..." for w in words)


@click.group(cls=Verbs, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="bayesid", prog_name="bayesid")
@click.option("--traceback", "wanted", is_flag=True, envvar="BAYESID_TRACEBACK", help="On a failure, show where in the code.")
@click.pass_obj
def commands(telling: _Telling, wanted: bool) -> None:
    """Inertial parameters of a robot from a base force/torque sensor and joint torques, with their uncertainty."""
    telling.traceback = wanted
