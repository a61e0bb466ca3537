"""Units that logs are written in, as factors to SI units."""

from __future__ import annotations

import math
import re

from bayesid.errors import InputError
from bayesid.recordings.complaints import cut, suggest

_TURN = 2.0 * math.pi
_ANGLE = {"rad": 1.0, "deg": math.pi / 180.0, "turn": _TURN, "m": 1.0, "mm": 1e-3, "cm": 1e-2}
_RATE = {
    "rad/s": 1.0, "deg/s": math.pi / 180.0, "turn/s": _TURN, "rpm": _TURN / 60.0, "m/s": 1.0, "mm/s": 1e-3, "cm/s": 1e-2,
}  # fmt: skip
_FORCE, _MOMENT = {"N": 1.0, "kN": 1e3, "mN": 1e-3}, {"N m": 1.0, "N mm": 1e-3, "N cm": 1e-2, "mN m": 1e-3, "kN m": 1e3}
#: Units of readings that say nothing of a torque without a constant of the joint.
NEED_CONSTANT = {"A": 1.0, "mA": 1e-3, "V": 1.0, "counts": 1.0, "%": 1.0}
_TIME = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
#: Units of a quantity: the first is the one that bayesid computes in.
UNITS: dict[str, dict[str, float]] = {
    "t": {**_TIME, "iso": math.nan}, "q": _ANGLE, "v": _RATE, "qr": _ANGLE, "tau": {**_MOMENT, **_FORCE, **NEED_CONSTANT},
    "f": _FORCE, "m": _MOMENT,
}  # fmt: skip
_SPELT = {"nm": "N m", "degree": "deg", "degrees": "deg", "°": "deg", "°/s": "deg/s", "radians": "rad", "radian": "rad",
          "sec": "s", "seconds": "s", "second": "s", "msec": "ms", "milliseconds": "ms", "µs": "us", "μs": "us", "usec": "us",
          "microseconds": "us", "nsec": "ns", "nanoseconds": "ns", "newton": "N", "rev": "turn", "rev/s": "turn/s",
          "amps": "A", "ampere": "A", "rads": "rad/s", "degs": "deg/s"}  # fmt: skip


def known_unit(quantity: str, text: str) -> str | None:
    """The unit of a quantity (a key of `UNITS`) that is meant by a text, in the spelling of `UNITS`; None where it is none."""
    plain = re.sub(r"[\s·*.]", "", text)
    spelt = {re.sub(r"\s", "", unit): unit for unit in UNITS[quantity]}
    if plain in spelt:
        return spelt[plain]
    meant = _SPELT.get(plain.lower())
    if meant is None:
        meant = {key.lower(): unit for key, unit in spelt.items()}.get(plain.lower())
    return meant if meant in UNITS[quantity] else None


def check_unit(quantity: str, text: str, file: str, key: str) -> str:
    """The unit that is meant by a text; an `InputError` where it is no unit of that quantity."""
    unit = known_unit(quantity, text)
    if unit is None:
        raise InputError(
            f'"{cut(text)}" is no unit here',
            file=file,
            key=key,
            value=text,
            remedy=suggest(text, UNITS[quantity], "write one of"),
        )
    return unit
