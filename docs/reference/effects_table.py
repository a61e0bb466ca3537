"""Write effects.md from the classes of the effects. Run from anywhere."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from bayesid.dynamics.channels import WRENCH_NAMES
from bayesid.effects import Effect, EffectLibrary
from bayesid.effects.friction import BRISTLE_MEMORY
from bayesid.effects.play import FASTEST
from bayesid.robot.robot import load_robot

sys.path.append(str(Path(__file__).resolve().parents[2]))
from tests.example_robots import puma560_urdf

PAGE = Path(__file__).resolve().parent / "effects.md"
LIBRARY = EffectLibrary()
_PLACES = {
    "axis": "an axis, `fx` … `mz`",
    "axis->axis": "`fx->mz`: source, reading axis",
    "joint": "`jointK`",
    "joint->joint": "`jointJ->jointK`: driver, joint whose motor it turns",
    "joint|robot": "`jointK`, `robot`",
}
_HEAD = """# Effects

What a robot, its drives and its instruments can do beyond rigid bodies. Each is written `name` (everywhere it can be) or
`name@place` in `[model] effects`, `--effects` and `simulate`; starting values stand in `[model.values."name@place"]`. `w` is the
true wrench that the sensor applies, `tau` a joint's true torque. Each is one class in `bayesid/effects`, and this page is written
from what the classes say, by `docs/reference/effects_table.py`.

| name | channel | place | parameters | reads, or adds | looks like |
| --- | --- | --- | --- | --- | --- |
"""
_FOOT = """
The steps act in this order: encoder offset, coupled transmissions, play, flexible joints; the compliant base; bodies, gravity and
what pulls or pushes them; inside the joints, at the time that a torque is read for, then the torque's gain; the sensor's pose,
its delay, gains and cross-talk, offset and drift.
A flexible joint gives way to the torques of a base at rest: with a base that rings as well, what the ringing bends is left out.
When a gear's teeth change sides is read off the encoders' single samples, for motions of links up to %(fastest).0f Hz: play that
is crossed many times a second, or that is so wide that the torque turns on the way, is beyond this model.

The time $t$ of `sensor_drift` and `warming_friction` is that of each table. Where the tables of an experiment go on with one
clock, so does the warming; where each starts at zero, the drive is as cold at the start of every motion. `warming_friction`
falls from the friction at $t = 0$: `coulomb_friction` and `viscous_friction` beside it are those of the cold drive.

`dahl_friction` remembers the last %(memory)g s of motion; a joint that moves when that begins is taken for slipping.

`diagnose` seeks `coupled_transmission` of a joint and the one before it, from 1 and -1, where other effects leave something
unexplained, and `torque_delay` of all joints at once. It does not name `dahl_friction` beside another friction of a kind of its
own at the same joint (`stribeck_friction`, `load_friction`, `posture_friction`, `warming_friction`).
A coupling shows in what the links take alone, for friction and rotors go with the motors' positions that tables hold: behind the
motors of a light wrist, a short recording has too little of it for a name.
Where tables hold positions and torques of the joints, as a controller that knows the coupling gives them, it is the other way
round: links are right, and the motor's friction and rotor show in two joints. That is `coupled_friction`, sought from couplings
of 1 and -1 for what viscous and Coulomb friction and rotors of the two joints leave; below a tenth it is called the latter. In
the wrist of a TX40 it is found with its published coefficients ([measured](../studies/named-in-part/README.md)).
Where it is known from the data sheet, state it as `[model.values."coupled_transmission@joint5->joint6"]` with
`coupling = 1.0` and `fixed = true`.

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


def page() -> str:
    """The whole page."""
    rows, starts = [], []
    for effect in example_effects():
        grouped: dict[str, list[str]] = {}
        for p in effect.quantities:
            grouped.setdefault(p.unit.replace("^2", "²").replace("^3", "³"), []).append(f"`{p.name}`")
        parameters = ", ".join(f"{' '.join(keys)} [{unit}]" for unit, keys in grouped.items())
        place = _PLACES.get(effect.at, f"`{effect.at}`")
        alike = ", ".join(f"`{name}`" for name in effect.confusable_with)
        cells = [f"`{effect.name}`", ", ".join(effect.channels), place, parameters, effect.equation, alike]
        rows.append(f"| {' | '.join(cells)} |\n")
        if any(effect.starts):
            values = ", ".join(f"`{p.name}` {p.start:g}" for p in effect.quantities)
            starts.append(f"- `{effect.name}`: {values}\n")
    foot = _FOOT % {"memory": BRISTLE_MEMORY, "fastest": FASTEST}
    return _HEAD + "".join(rows) + foot + "".join(starts) + _SIZES + "".join(sizes())


def example_effects() -> Iterator[Effect]:
    """Each class at one place of the example arm."""
    for name, kind in LIBRARY.classes.items():
        places = {"joint": "joint2", "joint|robot": "joint2", "axis": "mz", "axis->axis": "fx->mz"}
        places["joint->joint"] = "joint1->joint2"
        at = places.get(kind.at, kind.at)
        [effect] = LIBRARY.parse([f"{name}@{at}"], ["joint1", "joint2"], (*WRENCH_NAMES, "tau1", "tau2"))
        yield effect


def sizes() -> Iterator[str]:
    """A line for each effect: its typical values on the example arm, what is possible, and where its equation comes from."""
    with TemporaryDirectory() as folder:
        (path := Path(folder) / "arm.urdf").write_text(puma560_urdf(), encoding="utf-8")
        robot = load_robot(path)
    for effect in example_effects():
        usual = ", ".join(f"`{p.name}` {v:.2g}" for p, v in zip(effect.quantities, effect.typical(robot), strict=True))
        bounds: dict[tuple[float, float], list[str]] = {}
        for p in effect.quantities:
            lower = 0.0 if p.never_negative else p.lower
            if np.isfinite([lower, p.upper]).any():
                bounds.setdefault((lower, p.upper), []).append(f"`{p.name}`")
        possible = ", ".join(f"{' '.join(keys)} {_range(*ends)}" for ends, keys in bounds.items()) or "any"
        yield f"| `{effect.name}` | {usual} | {possible} | {effect.source} |\n"


def _range(low: float, high: float) -> str:
    return f"≥ {low:g}" if np.isinf(high) else f"≤ {high:g}" if np.isinf(low) else f"{low:g} … {high:g}"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
