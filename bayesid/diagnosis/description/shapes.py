"""Shapes: products of simple functions of a motion and of true readings, as formulas with numbers that can be adapted.

A shape is written as it stands in ``[model.expressions]``; what multiplies it, the amplitude, is no part of it.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np

Kind = Literal["position", "ripple", "speed", "direction", "acceleration", "load", "limit", "time", "oscillation", "memory"]

#: Units of the variables of formulas, by how they begin; and of those that are others for a joint that slides.
_UNITS = {"q": "rad", "v": "rad/s", "a": "rad/s^2", "tau": "N m", "f": "N", "m": "N m", "t": "s"}
_SLIDING = {"q": "m", "v": "m/s", "a": "m/s^2", "tau": "N"}


def unit_of_variable(name: str, sliding: Collection[int] = ()) -> str:
    """Unit of a variable or reading such as ``q2``, with the indices of the joints that slide."""
    kind = next(k for k in ("tau", "q", "v", "a", "f", "m", "t") if name.startswith(k))
    number = name.removeprefix(kind)
    return _SLIDING[kind] if kind in _SLIDING and int(number) - 1 in sliding else _UNITS[kind]


@dataclass(frozen=True)
class ShapeFactor:
    """One function of one variable."""

    form: str  # with ``{x}`` for the variable and ``{n}`` for the number
    variable: str  # as in formulas: ``q2``, ``dir1``, ``tau3``, ``mx``, ``t``
    kind: Kind  # what sort of function it is, for what it may be physically
    power: int = 0  # power of the variable's unit in it
    number: float | None = None  # what can be adapted in it, a width, a threshold or a rate; None where there is nothing
    step: float = 0.0  # how far the number is changed first when it is adapted

    @cached_property
    def text(self) -> str:
        """The factor as it stands in a formula."""
        shown = "" if self.number is None else f"{self.number:.4g}"
        return self.form.format(x=self.variable, n=shown).replace("- -", "+ ")

    def unit(self, sliding: Collection[int] = ()) -> str:
        """Its unit, with the indices of the joints that slide; empty where it has none."""
        if not self.power:
            return ""
        of = unit_of_variable(self.variable, sliding)
        return of if self.power == 1 else f"({of})^{self.power}"


@dataclass(frozen=True)
class Shape:
    """One product of factors, or two of which each has its amplitude (a sine and a cosine)."""

    products: tuple[tuple[ShapeFactor, ...], ...]  # the factors of each

    @cached_property
    def texts(self) -> tuple[str, ...]:
        """The products as formulas."""
        return tuple(" * ".join(f.text for f in product) for product in self.products)

    @property
    def length(self) -> int:
        """Number of factors."""
        return len(self.products[0])

    @property
    def variables(self) -> tuple[str, ...]:
        """Its variables, in the order in which they come."""
        return tuple(dict.fromkeys(f.variable for f in self.products[0]))

    @property
    def kinds(self) -> frozenset[Kind]:
        """What sorts of functions it is made of."""
        return frozenset(f.kind for f in self.products[0])

    @property
    def numbers(self) -> tuple[tuple[str, float, float], ...]:
        """Variable, value and first step of each number that can be adapted."""
        return tuple((f.variable, f.number, f.step) for f in self.products[0] if f.number is not None)

    def moved(self, index: int, value: float) -> Shape:
        """The shape with another number in one of its factors, in both products."""
        at = [k for k, f in enumerate(self.products[0]) if f.number is not None][index]
        changed = (
            tuple(replace(f, number=value) if k == at else f for k, f in enumerate(product)) for product in self.products
        )  # fmt: skip
        return Shape(tuple(changed))


@dataclass(frozen=True)
class Range:
    """Where a variable goes in the fitted motions: least and largest value, and standard deviation."""

    low: float
    high: float
    std: float

    @property
    def size(self) -> float:
        """The largest absolute value."""
        return max(abs(self.low), abs(self.high))

    @property
    def span(self) -> float:
        """Difference between the largest and the least."""
        return self.high - self.low


#: Says where a variable goes.
Ranges = Callable[[str], Range]


def single(*factors: ShapeFactor) -> Shape:
    """A shape of one product."""
    return Shape((factors,))


def positions(q: str) -> list[ShapeFactor]:
    """Smooth functions of a joint's position."""
    return [
        ShapeFactor("{x}", q, "position", 1), ShapeFactor("{x}**2", q, "position", 2),
        ShapeFactor("sin({x})", q, "position"), ShapeFactor("cos({x})", q, "position"),
    ]  # fmt: skip


def speeds(v: str, ranges: Ranges) -> list[ShapeFactor]:
    """Functions of a joint's speed."""
    widths = [share * ranges(v).size for share in (0.03, 0.1, 0.3)]
    return [
        ShapeFactor("{x}", v, "speed", 1), ShapeFactor("abs({x})", v, "speed", 1), ShapeFactor("{x}**2", v, "speed", 2),
        ShapeFactor("{x} * abs({x})", v, "speed", 2), ShapeFactor("{x}**3", v, "speed", 3),
        ShapeFactor("{x}", f"dir{v[1:]}", "direction"),
        *(ShapeFactor("tanh({x} / {n})", v, "speed", number=w, step=0.5 * w) for w in widths),
    ]  # fmt: skip


def accelerations(a: str) -> list[ShapeFactor]:
    """Functions of a joint's acceleration."""
    return [ShapeFactor("{x}", a, "acceleration", 1), ShapeFactor("abs({x})", a, "acceleration", 1)]


def loads(x: str, ranges: Ranges) -> list[ShapeFactor]:
    """Functions of a true reading: curved, saturating, beyond a threshold on either side."""
    r = ranges(x)
    widths = [share * r.size for share in (0.15, 0.5)]
    high, low = ([r.low + share * r.span for share in shares] for shares in ((0.6, 0.75, 0.88), (0.4, 0.25, 0.12)))
    return [
        ShapeFactor("abs({x})", x, "load", 1), ShapeFactor("{x}**2", x, "load", 2), ShapeFactor("{x} * abs({x})", x, "load", 2),
        ShapeFactor("{x}**3", x, "load", 3), *(ShapeFactor("tanh({x} / {n})", x, "load", number=w, step=0.5 * w) for w in widths),
        *(ShapeFactor("max({x} - {n}, 0)", x, "limit", 1, n, 0.08 * r.span) for n in high),
        *(ShapeFactor("min({x} - {n}, 0)", x, "limit", 1, n, 0.08 * r.span) for n in low),
    ]  # fmt: skip


def memories(x: str, ranges: Ranges) -> list[ShapeFactor]:
    """Bristles that a position or a load drags along."""
    widths = [share * ranges(x).std for share in (0.01, 0.03, 0.06, 0.12, 0.25, 0.5, 1.0)]
    return [ShapeFactor("hysteresis({x}, {n})", x, "memory", number=w, step=0.4 * w) for w in widths]


def times(ranges: Ranges) -> list[ShapeFactor]:
    """Courses that grow or fade through a recording, for what they multiply."""
    constants = [share * ranges("t").span for share in (0.1, 0.3, 1.0)]
    return [
        ShapeFactor("{x}", "t", "time", 1),
        *(ShapeFactor("exp(-{x} / {n})", "t", "time", number=c, step=0.4 * c) for c in constants),
    ]


def settling(ranges: Ranges) -> list[ShapeFactor]:
    """Courses that settle at a value."""
    constants = [share * ranges("t").span for share in (0.03, 0.1, 0.3, 1.0)]
    return [ShapeFactor("(1 - exp(-{x} / {n}))", "t", "time", number=c, step=0.4 * c) for c in constants]


def ripples(q: str, ranges: Ranges, most: float = 30.0) -> Iterator[Shape]:
    """A sine and a cosine of a joint's position, with so many periods that neighbours differ by one turn over the range."""
    spacing = 2.0 / max(ranges(q).span, 0.2)
    for k in range(1, min(int(most / spacing), 40)):
        yield _waves(q, "ripple", k * spacing + 1.0, 0.25 * spacing)


def oscillations(ranges: Ranges, band: float) -> Iterator[Shape]:
    """A sine and a cosine of time, of three periods or more, up to the band's end [Hz]."""
    spacing = 3.0 / max(ranges("t").span, 1.0)
    for k in range(6, int(2.0 * np.pi * band / spacing)):
        yield _waves("t", "oscillation", k * spacing, 0.25 * spacing)


def _waves(x: str, kind: Kind, rate: float, step: float) -> Shape:
    return Shape(tuple((ShapeFactor(f"{wave}({{n}} * {{x}})", x, kind, number=rate, step=step),) for wave in ("sin", "cos")))


def times_each(shape: Shape, factor: ShapeFactor) -> Shape:
    """A shape times one more factor."""
    return Shape(tuple((*product, factor) for product in shape.products))
