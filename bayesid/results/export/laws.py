"""Laws of what acts inside a joint, as text that is C++ and Python alike.

Each says what the class of the same name in `bayesid.effects` computes; a test compares the two.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from bayesid.effects.segment import REST_SPEED

#: Torque [N m or N], then its derivatives with respect to the parameters, in the order of the effect's own: ``q, v, a`` are
#: of the joint, ``s`` is the velocity's sign with a narrow ramp, ``l`` the torque that moves and carries the links, ``p0 ...``
#: are the parameters.
LAWS: dict[str, tuple[str, ...]] = {
    "viscous_friction": ("p0 * v", "v"),
    "directional_friction": ("p0 * abs(v)", "abs(v)"),
    "coulomb_friction": ("p0 * s", "s"),
    "posture_friction": ("(p0 * cos(q) + p1 * sin(q)) * s", "cos(q) * s", "sin(q) * s"),
    "stribeck_friction": (
        "p0 * exp(-(v / p1) * (v / p1)) * s",
        "exp(-(v / p1) * (v / p1)) * s",
        "p0 * exp(-(v / p1) * (v / p1)) * s * 2.0 * (v / p1) * (v / p1) / p1",
    ),
    "load_friction": ("p0 * abs(l) * s", "abs(l) * s"),
    "torque_offset": ("p0", "1.0"),
    "rotor_inertia": ("p0 * a", "a"),
    "torque_ripple": ("p0 * sin(p1 * q + p2)", "sin(p1 * q + p2)", "p0 * q * cos(p1 * q + p2)", "p0 * cos(p1 * q + p2)"),
    "spring": ("p0 * (q - p1)", "q - p1", "-p0"),
}
#: Derivatives of the torque with respect to ``l``, where it depends on it; ``sign`` is 0 at 0.
PER_LOAD = {"load_friction": "p0 * sign(l) * s"}
#: Speed at which the ramp of ``s`` ends [rad/s or m/s].
RAMP = REST_SPEED
#: Stribeck velocity below which there is none [rad/s or m/s]: it is divided by.
_SLOWEST = 1e-9


@dataclass(frozen=True)
class JointLaw:
    """An effect inside a joint with its values.

    Attributes
    ----------
    spec
        ``name@where``.
    name
        A key of `LAWS`.
    joint
        Index of the joint.
    values
        Of the effect's parameters (k,).
    columns
        Where each of them stands among the estimated parameters; None: it is fixed (k,).
    """

    spec: str
    name: str
    joint: int
    values: tuple[float, ...]
    columns: tuple[int | None, ...]

    @property
    def torque(self) -> str:
        """Its torque as an expression of ``q, v, a, s, l``."""
        return self._filled(LAWS[self.name][0])

    @property
    def per_load(self) -> str | None:
        """Its derivative with respect to the links' torque; None where it does not depend on that."""
        return self._filled(PER_LOAD[self.name]) if self.name in PER_LOAD else None

    @property
    def derivatives(self) -> list[tuple[int, str]]:
        """Column and derivative of each parameter that was estimated."""
        texts = zip(self.columns, LAWS[self.name][1:], strict=True)
        return [(column, self._filled(text)) for column, text in texts if column is not None]

    def _filled(self, text: str) -> str:
        values = list(self.values)
        if self.name == "stribeck_friction":
            values[1] = max(values[1], _SLOWEST)
        return re.sub(r"\bp(\d)\b", lambda found: f"({float(values[int(found[1])])!r})", text)
