"""What a term may be physically, from its form alone."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from bayesid.diagnosis.description.candidates import Candidate
from bayesid.diagnosis.description.shapes import Kind


@dataclass(frozen=True)
class Reading:
    """A term as the rules below look at it: its sorts of functions, how many joints, whether of a torque, of its own state."""

    kinds: frozenset[Kind]
    joints: int
    torque: bool
    own: bool


#: What a form suggests, and when; all that hold are said, the first ones first.
_RULES: tuple[tuple[Callable[[Reading], bool], str], ...] = (
    (lambda r: "oscillation" in r.kinds, "a vibration from outside: a motor, a pump or a fan nearby, the mains or a loose base"),
    (lambda r: "memory" in r.kinds and r.torque and r.own, "friction with presliding, or the hysteresis of a harmonic drive"),
    (lambda r: "memory" in r.kinds and not r.own, "a hose or cable that drags after another joint"),
    (lambda r: "memory" in r.kinds and not r.torque and r.own, "hysteresis of the sensor or of what it is mounted on"),
    (lambda r: "time" in r.kinds and r.kinds & {"speed", "direction"} != set(), "friction that changes as the drive warms up"),
    (lambda r: "time" in r.kinds and not r.torque, "a sensor that warms up or was not zeroed, or a mount that creeps"),
    (lambda r: "time" in r.kinds and r.torque, "a drive or its current sensor that warms up"),
    (lambda r: "limit" in r.kinds, "a reading that is clipped, an amplifier that saturates, or a stop that is touched"),
    (lambda r: "load" in r.kinds and "direction" in r.kinds, "friction that grows with the load of the gear"),
    (lambda r: "load" in r.kinds and r.joints > 0 and not r.own, "cross-talk between axes that depends on the posture"),
    (lambda r: r.kinds == {"load"} and not r.torque, "a sensor that is not linear: calibration, overload, a bent flexure"),
    (lambda r: r.kinds == {"load"} and r.torque, "a motor constant that saturates, or gears that are less efficient at load"),
    (lambda r: "load" in r.kinds and r.joints > 0 and r.own, "a gain that depends on posture or speed"),
    (lambda r: {"ripple", "direction"} <= r.kinds, "friction that varies over a turn: a bent shaft, a bearing, a seal"),
    (lambda r: r.torque and r.kinds & {"ripple", "direction"} == {"ripple"}, "cogging of the motor, gears out of true"),
    (lambda r: "ripple" in r.kinds and not r.torque, "an encoder or gear that runs out of true"),
    (lambda r: r.joints > 1, "a coupling of joints: a cable or hose between links, or transmissions that turn one another"),
    (lambda r: r.kinds & {"speed", "direction"} != set() and "position" in r.kinds, "friction that depends on posture"),
    (lambda r: r.kinds == {"position"} and r.own, "a spring, a gravity compensator, a tether or a cable that is bent"),
    (lambda r: r.kinds == {"position"} and not r.own, "a tether, hose or cable that pulls with the posture"),
    (lambda r: r.kinds <= {"speed", "direction"} and r.own, "friction of another curve than the library's: seals, grease"),
    (lambda r: r.kinds <= {"speed", "direction"} and not r.own, "drag, or a force that follows another joint's motion"),
    (lambda r: "acceleration" in r.kinds, "inertia that is not in the links, or readings and positions at different times"),
)
_MOST = 2


def may_be(candidate: Candidate, names: Sequence[str]) -> tuple[str, ...]:
    """Physical causes that have such a form, at most two.

    Parameters
    ----------
    candidate
        The term.
    names
        Of the channels.
    """
    shape = candidate.shape
    mine = {names[c] for c in candidate.channels}
    joints = {v.lstrip("qvadirtu") for v in shape.variables if v != "t" and v[-1].isdigit()}
    torque = all(name.startswith("tau") for name in mine)
    own = joints <= {name[3:] for name in mine} if torque else not joints
    seen = Reading(shape.kinds, len(joints), torque, own)
    found = tuple(text for holds, text in _RULES if holds(seen))[:_MOST]
    return found or ("none of the usual causes has such a form",)
