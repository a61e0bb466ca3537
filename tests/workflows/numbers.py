"""Numbers of texts and documents: what is printed is looked for in what is stored, to the digits printed."""

from __future__ import annotations

import re
from collections.abc import Iterator
from html import unescape
from typing import Any, NamedTuple

import numpy as np

from bayesid.rounding import HALF

_RAISED = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")
_NUMBER = re.compile(r"(?<![\w.,^@\[])([−-]?\d+(?:\.\d+)?(?:e[+-]?\d+)?)(·10[⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+)?(?![\w])(?:\s*(%|ms|min)(?!\w))?")
_UNITS = {"%": 100.0, "ms": 1e3, "min": 1.0 / 60.0}
#: Lists of numbers longer than this are arrays; one that matches says nothing.
_SHORT = 6
#: Probability of all intervals, and what a perfect residual is.
CONSTANTS = (0.95, 1.0)


def scalars(document: Any) -> Iterator[float]:
    """Numbers of a document, lengths of its lists, and of every interval half its width."""
    if isinstance(document, dict):
        numbers = {k: v for k, v in document.items() if isinstance(v, (int, float)) and not isinstance(v, bool)}
        if "low" in numbers and "high" in numbers:
            yield 0.5 * (numbers["high"] - numbers["low"])
        yield from (HALF * v for k, v in numbers.items() if k == "std")
        for value in document.values():
            yield from scalars(value)
    elif isinstance(document, (list, tuple)):
        yield float(len(document))
        if len(document) <= _SHORT or any(isinstance(v, dict) for v in document):
            for value in document:
                yield from scalars(value)
    elif isinstance(document, (int, float, np.number)) and not isinstance(document, bool):
        yield float(document)


def texts(document: Any) -> Iterator[str]:
    """Every text of a document, keys of its dictionaries included."""
    if isinstance(document, dict):
        yield from document
        document = list(document.values())
    if isinstance(document, (list, tuple)):
        for value in document:
            yield from texts(value)
    elif isinstance(document, str):
        yield document


def plain(html: str) -> str:
    """The text of a piece of HTML."""
    return unescape(re.sub(r"<[^>]+>", "  ", html))


class Printed(NamedTuple):
    """A number of a text.

    Attributes
    ----------
    around
        Where it stands.
    value, half
        As it reads, and half a unit of its last digit.
    scale
        What a stored number is multiplied with to be compared.
    told_as
        ``over`` or ``<`` where it is a bound, ``change`` where it is a ratio less one, else empty.
    """

    around: str
    value: float
    half: float
    scale: float
    told_as: str

    def found_in(self, stored: np.ndarray) -> bool:
        """Whether one of the numbers stored rounds to it; sizes alone, for signs may be told in words."""
        sizes, size = np.abs(self.scale * stored), abs(self.value)
        if self.told_as == "change":
            sizes = np.concatenate([sizes, np.abs(self.scale * (stored - 1.0))])
        if self.told_as == "over":
            near = (sizes >= size) & (sizes <= self.scale)
        elif self.told_as == "<":
            near = sizes < size
        else:
            near = np.abs(sizes - size) <= self.half * (1 + 1e-6) + 1e-12 * size
        return bool(near.any())


def printed(text: str, document: Any) -> list[Printed]:
    """Numbers of a text that are no part of a name or a sentence of the document."""
    known = sorted({t for t in texts(document) if re.search(r"\d", t)}, key=len, reverse=True)
    for name in known:  # a long name may be cut
        for part in (name, name[:60], name[:42]):
            if len(part) > 1:
                text = re.sub(rf"(?<!\w){re.escape(part)}", " @ ", text)
    out = []
    for match in _NUMBER.finditer(text):
        digits = match[1].replace("−", "-")
        mantissa, _, exponent = digits.partition("e")
        power = int(exponent or 0) + int((match[2] or "").removeprefix("·10").translate(_RAISED) or 0)
        half = 0.5 * 10.0 ** (power - len(mantissa.partition(".")[2]))
        around, before = text[max(match.start() - 30, 0) : match.end() + 20], text[: match.start()].rstrip()
        told_as = next((word for word in ("over", "<") if before.endswith(word)), "")
        if match[3] == "%" and (before.endswith("+") or mantissa.startswith("-")):
            told_as = "change"
        out.append(Printed(around, float(mantissa) * 10.0**power, half, _UNITS.get(match[3], 1.0), told_as))
    return out


def missing(text: str, document: Any, allowed: tuple[float, ...] = ()) -> list[str]:
    """Numbers of a text that the document does not hold to the digits printed, with what stands around them."""
    stored = np.array([*scalars(document), *CONSTANTS, *allowed])
    stored = stored[np.isfinite(stored)]
    return [" ".join(p.around.split()) for p in printed(text, document) if not p.found_in(stored)]
