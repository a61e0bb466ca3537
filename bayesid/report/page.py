"""What all reports share: templates, and numbers with sensible digits."""

from __future__ import annotations

import functools
import platform
import re
from collections.abc import Mapping
from importlib.metadata import version
from typing import Any

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from bayesid.results.text import number
from bayesid.robot import inertia

_LONGEST_LABEL = 90


def render(template: str, **context: Any) -> str:
    """A page from one of the package's templates; everything but `Markup` is escaped."""
    return _environment().get_template(template).render(version=version("bayesid"), **context)


@functools.cache
def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader("bayesid.report", "templates"), autoescape=True, undefined=StrictUndefined,
        trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip
    environment.filters |= {"shorten": shorten, "unit": lambda text: text.replace("^2", "²").replace("^3", "³")}
    return environment


def svg(figure: Any, name: str) -> Markup:
    """A matplotlib figure ready to be put into a template."""
    from bayesid.report.figures import to_svg

    return Markup(to_svg(figure, name))


def run_times(seconds: Mapping[str, float]) -> tuple[str, str]:
    """The row that tells the run time [s] of every stage."""
    return "Run time", ", ".join(f"{stage} {number(s, 2)} s" for stage, s in seconds.items())


def versions(*packages: str) -> tuple[str, str]:
    """The row that tells the versions of Python, this package and others."""
    return "Versions", ", ".join([f"Python {platform.python_version()}", *(f"{p} {version(p)}" for p in ("bayesid", *packages))])


def shorten(text: str) -> tuple[str, int]:
    """A sum's first terms and how many more there are."""
    if len(text) <= _LONGEST_LABEL:
        return text, 0
    terms = re.split(r"(?= [+-] )", text)
    kept = 1
    while kept < len(terms) and len("".join(terms[: kept + 1])) <= _LONGEST_LABEL - 20:
        kept += 1
    return "".join(terms[:kept]), len(terms) - kept


def physical(body: np.ndarray) -> np.ndarray:
    """Mass, centre of mass and inertia about it: ten numbers, nan where there is no mass to divide by."""
    if abs(body[0]) < 1e-9:
        return np.concatenate([body[:1], np.full(9, np.nan)])
    mass, com, about = inertia.to_mass_com_inertia(body)
    size = max(float(np.sqrt(np.abs(about).max() / abs(mass))), float(np.abs(com).max()))
    about = np.where(np.abs(about) > 1e-9 * np.abs(about).max(), about, 0.0)  # rounding is no product of inertia
    com = np.where(np.abs(com) > 1e-9 * size, com, 0.0)
    return np.array([mass, *com, about[0, 0], about[0, 1], about[1, 1], about[0, 2], about[1, 2], about[2, 2]])
