"""Packages that reading other tools' files needs, which not everybody has installed."""

from __future__ import annotations

import importlib
from types import ModuleType

from bayesid.errors import InputError


def extra(module: str, package: str, source: str) -> ModuleType:
    """Import a module of an optional package.

    Raises
    ------
    InputError
        The package is not installed; the message says how to install it.
    """
    try:
        return importlib.import_module(module)
    except ImportError:
        raise InputError(f"reading it needs {package}", file=source, remedy='pip install "bayesid[import]"') from None
