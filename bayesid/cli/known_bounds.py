"""Estimators with what is known of the links beforehand: the option ``--bounds FILE``."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from bayesid.errors import InputError
from bayesid.estimators import Physical, estimator, load_bounds


def bounded(method, bounds: Path | None, loaded):
    """The estimator with the bounds of a file."""
    if bounds is None:
        return method
    if not isinstance(method, Physical):
        raise InputError(f"--bounds is given with --method {method.name}, which takes none; add --method sdp")
    return replace(method, bounds=load_bounds(bounds, loaded.robot, loaded.locked))


def all_bounded(names, bounds: Path, loaded) -> list:
    """Estimators by name, those that take bounds with the bounds of a file."""
    chosen = [estimator(name) for name in names]
    if not any(isinstance(method, Physical) for method in chosen):
        raise InputError("--bounds is given, but none of --methods takes any; add sdp to --methods")
    return [bounded(method, bounds, loaded) if isinstance(method, Physical) else method for method in chosen]
