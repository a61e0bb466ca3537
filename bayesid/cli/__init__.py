"""The command line: one file a verb, imported when the verb is called."""

from bayesid.cli.main import main

__all__ = ["main"]
