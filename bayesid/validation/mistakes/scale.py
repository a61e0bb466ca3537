"""Whether readings have the size that a robot of these links must have: units and gear sides of a whole table."""

from __future__ import annotations

import numpy as np

from bayesid.validation.mistakes.evidence import Explainer
from bayesid.validation.mistakes.mistake import Mistake
from bayesid.validation.mistakes.plausible import usual_bodies

#: Masses of a stated model are right to this factor.
_NOMINAL = 4.0
#: Masses guessed from the lengths of links are right to this factor: it lies between those of a hydraulic leg and of a toy arm.
_GUESSED = 30.0
_KNOWN = {1e3: "N mm instead of N m", 1.0 / 9.80665: "kgf m instead of N m", 1e-3: "kN m instead of N m"}
_KNOWN_FORCE = {1.0 / 9.80665: "kgf and kgf m instead of N and N m", 1e-3: "kN and kN m instead of N and N m"}
#: By how much one explanation must be worse than another, however many samples there are: a residual a third larger, of one
#: channel or of all together [nats a sample].
WORSE = float(np.log(4.0 / 3.0))
_NEAR = 2.5  # factor within which a unit is recognised


def implausible_size(explainer: Explainer) -> list[Mistake]:
    """Compare readings with those of the nominal bodies, or of usual bodies where the URDF has no masses.

    A mistake is named where both are off to the same side: nominal bodies alone may be placeholders.
    """
    nominal, usual = explainer.robot.nominal, usual_bodies(explainer.robot)
    guessed = explainer.size_beside(usual)
    stated = explainer.size_beside(nominal) if nominal[:, 0].sum() > 0.0 else None
    if guessed is None:
        return []
    if stated is None:
        factor, allowed = guessed, _GUESSED
    else:
        factor, allowed = stated, _NOMINAL
        if np.sign(np.log(guessed)) != np.sign(np.log(stated)) or abs(np.log(guessed)) < np.log(_NOMINAL):
            return []
    if 1.0 / allowed < factor < allowed:
        return []
    # A small motion hardly tells weight from friction and offsets: bodies of a size that can be must explain the readings worse.
    bodies = usual if stated is None else nominal
    if explainer.gained_by_size(bodies, float(np.clip(factor, 1.0 / allowed, allowed))) < WORSE:
        return []
    beside = "the URDF's masses need" if stated is not None else "links of these lengths usually need"
    units = _KNOWN if explainer.torque else _KNOWN_FORCE
    unit = next((text for known, text in units.items() if 1.0 / _NEAR < factor / known < _NEAR), None)
    what, columns = ("joint torques", "tau") if explainer.torque else ("wrench", "fx ... mz")
    if unit is not None:
        says, remedy = f"seem to be in {unit}" if explainer.torque else f"seems to be in {unit}", "write N and N m"
    elif explainer.torque and factor < 1.0:
        says, remedy = "seem to be those of the motors", "multiply each by its gear ratio"
    else:
        says, remedy = "seem to be in another unit" if explainer.torque else "seems to be in another unit", "write N and N m"
    text = f"The {what} ({columns}) {says}: they are {factor:.2g} times what {beside}; {remedy}"
    channel = "torque" if explainer.torque else "wrench"
    return [Mistake(f"{channel}_units", "", text, channel, evidence=float("inf"))]
