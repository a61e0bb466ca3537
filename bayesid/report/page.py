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

from bayesid.report import plots
from bayesid.robot import inertia

DASH = "–"
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
    """A figure ready to be put into a template."""
    return Markup(plots.to_svg(figure, name))


def number(value: float | None, digits: int = 4) -> str:
    """A number with so many significant digits, with a power of ten only where it is very small or large."""
    if value is None or not np.isfinite(value):
        return DASH
    if value == 0:
        return "0"
    exponent = int(np.floor(np.log10(abs(float(f"{value:.{digits - 1}e}")))))
    if -4 <= exponent < 6:
        return f"{value:.{max(digits - 1 - exponent, 0)}f}".replace("-", "−")
    return f"{value / 10.0**exponent:.{digits - 1}f}·10{_raised(exponent)}".replace("-", "−")


def _raised(exponent: int) -> str:
    return str(exponent).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))


def with_half(value: float, half: float | None) -> tuple[str, str]:
    """A value and half its interval, both to the interval's second digit."""
    if half is None or not np.isfinite(half) or half <= 0:
        return number(value), DASH
    return _alike(value, half, half=half)


def interval(value: float, half: float) -> str:
    """The interval's ends, to the second digit of half its width."""
    if not np.isfinite(half) or half <= 0:
        return DASH
    return " … ".join(_alike(value - half, value + half, half=half))


def _alike(one: float, other: float, *, half: float) -> tuple[str, str]:
    """Two numbers to the second digit of ``half``, both with the same power of ten."""
    last = int(np.floor(np.log10(half))) - 1
    size = int(np.floor(np.log10(max(abs(one), abs(other)))))
    plain = -4 <= size < 6 and last >= -7
    scale, places, power = (1.0, -last, "") if plain else (10.0**size, size - last, f"·10{_raised(size)}")
    places = max(places, 0)
    first, second = (f"{round(v / scale, places) + 0.0:.{places}f}{power}".replace("-", "−") for v in (one, other))
    return first, second


def percent(share: float, digits: int = 3) -> str:
    """A share as per cent."""
    return f"{number(100 * share, digits)} %" if np.isfinite(share) else DASH


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
    about = np.where(np.abs(about) > 1e-9 * np.abs(about).max(), about, 0.0)  # rounding is no product of inertia
    return np.array([mass, *com, about[0, 0], about[0, 1], about[1, 1], about[0, 2], about[1, 2], about[2, 2]])
