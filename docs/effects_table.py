"""Write effects.md from the catalogue of effects. Run from anywhere."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from bayesid.effects import KINDS, parse_effects
from bayesid.effects.catalogue import WRENCH_NAMES
from bayesid.effects.sizes import typical
from bayesid.robot.examples import puma560_urdf
from bayesid.robot.robot import load_robot

PAGE = Path(__file__).resolve().parent / "effects.md"
_PLACES = {
    "axis": "an axis, `fx` … `mz`",
    "axis->axis": "`fx->mz`: source, reading axis",
    "joint": "`jointK`",
    "joint|robot": "`jointK`, `robot`",
}
_EQUATIONS = {
    "sensor_offset": "$w + o$",
    "sensor_drift": "$w + d\\,t$, with $t$ of the table",
    "sensor_gain": "$(1 + g)\\,w_i$",
    "sensor_crosstalk": "$w_k + c\\,w_i$",
    "sensor_rotation": "$\\exp([r]_\\times)^\\top$ times force and moment",
    "sensor_translation": "moments about the origin shifted by $d$, in base axes (for a sensor in a joint: in that joint's link)",
    "sensor_delay": "$w(t - T)$",
    "base_tilt": "gravity is turned about base $x$, then $y$",
    "payload": "a possible body in the joint's frame; on the far side of a sensor in that link",
    "inertia_error": "the same, but the change need not be a possible body",
    "tether": "$k \\max(\\lVert d\\rVert - L, 0)\\,d / \\lVert d\\rVert$ on the point, $d$ from there to the anchor",
    "fluid_drag": "$-(l + q\\lVert v\\rVert)\\,v$ per metre of the straight rods between joint origins",
    "rotor_momentum": "moment $J\\,\\mathrm{d}(\\dot q z)/\\mathrm{d}t$ on what the joint's parent is carried by; "
    "on its own torque $J z \\cdot \\dot\\omega$, and gear ratio $\\times J \\ddot q$ where `gear_ratio` is stated",
    "joint_flexibility": "link at $q - C\\tau$, $\\tau$ the torque that moves the links",
    "encoder_offset": "the encoder reads $q + a$",
    "external_contact": "force $F$ in base axes on the point, from start to end, with ramps of 0.2 s along half a cosine",
    "base_compliance": "$I(q)\\ddot\\theta + c\\dot\\theta + k\\theta = -h$, $h$ the moment about base $x$ and $y$ "
    "that the robot asks for; $k$, $c$ from the mean of the two inertias at the middle of the motion, the root link's included",
    "viscous_friction": "$c\\,\\dot q$",
    "coulomb_friction": "$l\\,\\mathrm{sign}\\,\\dot q$, a ramp below 0.001 rad/s (m/s)",
    "torque_offset": "$o$",
    "stribeck_friction": "$l\\,e^{-(\\dot q / v)^2}\\,\\mathrm{sign}\\,\\dot q$",
    "load_friction": "$c\\,\\lvert\\tau\\rvert\\,\\mathrm{sign}\\,\\dot q$",
    "rotor_inertia": "$J\\,\\ddot q$; the value is gear ratio² × rotor inertia",
    "torque_gain": "$(1 + g)\\,\\tau$, friction included",
    "torque_ripple": "$A \\sin(n q + \\varphi)$",
    "spring": "$k\\,(q - q_0)$",
}
_HEAD = """# Effects

What a robot, its drives and its instruments can do beyond rigid bodies. Each is written `name` (everywhere it can be) or
`name@place` in `[model] effects`, `--effects` and `simulate`; starting values stand in `[model.values."name@place"]`. `w` is the
true wrench that the sensor applies, `tau` a joint's true torque. Written by `docs/effects_table.py` from the catalogue in
`bayesid/effects/catalogue.py`.

| name | channel | place | parameters | reads, or adds | looks like |
| --- | --- | --- | --- | --- | --- |
"""
_FOOT = """
The steps act in this order: encoder offset and flexible joints; the compliant base; bodies, gravity and what pulls or pushes
them; inside the joints, then the torque's gain; the sensor's pose, its delay, gains and cross-talk, offset and drift.
A flexible joint gives way to the torques of a base at rest: with a base that rings as well, what the ringing bends is left out.

Starting values where none are stated are zero, except:

"""


_SIZES = """
## Sizes, ranges, sources

**Typical** is what `simulate` takes where no values are stated, here on the example PUMA 560 (joint 2), in the units above. Most
are shares of the robot's own weight, reach and effort limits (`bayesid/effects/sizes.py`); the shares are assumed. **Possible**
is the range that estimates are kept in.

| name | typical | possible | source |
| --- | --- | --- | --- |
"""
_DEFINITION = "definition"
_FRICTION = "[Armstrong1994](references.md)"
#: Where an equation is more than the definition of what it is called.
_SOURCES = {
    "rotor_momentum": "angular momentum, cf. [Spong1987](references.md), which leaves it out",
    "joint_flexibility": "[Spong1987](references.md), torque by the rigid model of the links",
    "base_compliance": "a rigid body on a spring and damper",
    "fluid_drag": "integral of the drag on a rod's elements",
    "tether": "one-sided linear spring",
    "viscous_friction": _FRICTION,
    "coulomb_friction": _FRICTION,
    "stribeck_friction": _FRICTION,
    "load_friction": _FRICTION,
}


def page() -> str:
    """The whole page."""
    rows = []
    for kind in KINDS.values():
        grouped: dict[str, list[str]] = {}
        for key, unit in zip(kind.parameters, kind.units, strict=True):
            grouped.setdefault(unit.replace("^2", "²").replace("^3", "³"), []).append(f"`{key}`")
        parameters = ", ".join(f"{' '.join(keys)} [{unit}]" for unit, keys in grouped.items())
        place = _PLACES.get(kind.at, f"`{kind.at}`")
        alike = ", ".join(f"`{name}`" for name in kind.confusable_with)
        cells = [f"`{kind.name}`", ", ".join(kind.channels), place, parameters, _EQUATIONS[kind.name], alike]
        rows.append(f"| {' | '.join(cells)} |\n")
    starts = []
    for kind in KINDS.values():
        if any(kind.starts):
            values = ", ".join(f"`{key}` {value:g}" for key, value in zip(kind.parameters, kind.starts, strict=True))
            starts.append(f"- `{kind.name}`: {values}\n")
    return _HEAD + "".join(rows) + _FOOT + "".join(starts) + _SIZES + "".join(sizes())


def sizes() -> Iterator[str]:
    """A line for each effect: its typical values on the example arm, what is possible, and where its equation comes from."""
    with TemporaryDirectory() as folder:
        (path := Path(folder) / "arm.urdf").write_text(puma560_urdf(), encoding="utf-8")
        robot = load_robot(path)
    for kind in KINDS.values():
        at = {"joint": "joint2", "joint|robot": "joint2", "axis": "mz", "axis->axis": "fx->mz"}.get(kind.at, kind.at)
        [effect] = parse_effects([f"{kind.name}@{at}"], robot.joint_names, (*WRENCH_NAMES, "tau1", "tau2"), None)
        usual = ", ".join(f"`{key}` {v:.2g}" for key, v in zip(kind.parameters, typical(effect, robot), strict=True))
        bounds: dict[tuple[float, float], list[str]] = {}
        for key, low, high in zip(kind.parameters, kind.lower, kind.upper, strict=True):
            if np.isfinite([low, high]).any():
                bounds.setdefault((low, high), []).append(f"`{key}`")
        possible = ", ".join(f"{' '.join(keys)} {_range(*ends)}" for ends, keys in bounds.items()) or "any"
        yield f"| `{kind.name}` | {usual} | {possible} | {_SOURCES.get(kind.name, _DEFINITION)} |\n"


def _range(low: float, high: float) -> str:
    return f"≥ {low:g}" if np.isinf(high) else f"≤ {high:g}" if np.isinf(low) else f"{low:g} … {high:g}"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
