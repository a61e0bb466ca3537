"""The group of verbs, and how a failure is told."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib import import_module

import click

import bayesid
from bayesid.errors import BayesidError, InputError

#: What each verb does; its command stands in the module of its name.
VERBS = {
    "check": "Read and validate an experiment folder; say what is in it.",
    "compare": "Several estimators on the same data, side by side.",
    "demo": "The main job on an embedded example, in under a minute.",
    "diagnose": "Where model and data disagree, and which effect is missing.",
    "identify": "Base parameters with honest uncertainty, and link parameters.",
    "sample": "Draws from the posterior, with convergence checks.",
    "simulate": "A recording from the model, with known truth.",
}


class Verbs(click.Group):
    """Imports a verb's module when the verb is called: ``--help`` and ``--version`` need none of them."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Names of the verbs."""
        return list(VERBS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """The verb's command, or None."""
        return getattr(import_module(f"bayesid.cli.{cmd_name}"), cmd_name) if cmd_name in VERBS else None

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Verbs with what they do, without importing them."""
        with formatter.section("Verbs"):
            formatter.write_dl(list(VERBS.items()))


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


@click.group(cls=Verbs, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(bayesid.__version__, prog_name="bayesid")
def commands() -> None:
    """Inertial parameters of a robot from a base force/torque sensor and joint torques, with honest uncertainty."""
