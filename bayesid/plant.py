"""What a simulated plant has beyond rigid bodies, with values of plausible size.

Effects that can be estimated can be simulated; friction laws that only a real drive has come on top.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from difflib import get_close_matches

import numpy as np

from bayesid.effects import KINDS, REST_SPEED, Effect, State, parse_effects
from bayesid.errors import InputError
from bayesid.momentum import WRENCH_NAMES
from bayesid.robot import Robot
from bayesid.trajectories import motion_limits

Values = Mapping[str, float | bool]

#: Friction that only the plant has: its parameters and their units.
PLANT_ONLY = {
    "stribeck_friction": (("level", "velocity"), ("N m", "rad/s")),
    "load_friction": (("coefficient",), ("1",)),
}
#: Effort where the URDF states none [N m or N].
ANY_EFFORT = 100.0
# A strain-gauge platform under an arm: tens of newtons [N, N m]; drift per second is a thousandth.
_OFFSET = (14.0, -9.0, 26.0, 1.6, -2.1, 0.7)


def parameters(name: str) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names and units of an effect's parameters."""
    return PLANT_ONLY[name] if name in PLANT_ONLY else (KINDS[name].parameters, KINDS[name].units)


def default_values(name: str, joint: int | None, robot: Robot) -> dict[str, float]:
    """Parameters of plausible size.

    Rotor inertia is as in the PUMA 560's drives, where gear ratio^2 x rotor inertia is about 1 % of the effort
    limit (source: see `bayesid.demo.puma_friction`); all others are assumed, friction within the usual percentages
    of the rated torque.

    Parameters
    ----------
    name
        Of the effect.
    joint
        Where it acts; None: at the sensor.
    robot
        Its effort and velocity limits.
    """
    if joint is None:
        scale = 1e-3 if name == "sensor_drift" else 1.0
        return {key: scale * value for key, value in zip(WRENCH_NAMES, _OFFSET, strict=True)}
    effort = float(robot.effort_limit[joint]) if np.isfinite(robot.effort_limit[joint]) else ANY_EFFORT
    speed = float(motion_limits(robot)[2][joint])
    return {
        "viscous_friction": {"coefficient": 0.06 * effort / speed},
        "coulomb_friction": {"level": 0.05 * effort},
        "torque_offset": {"offset": 0.01 * effort},
        "rotor_inertia": {"inertia": 0.01 * effort},
        "stribeck_friction": {"level": 0.02 * effort, "velocity": 0.05 * speed},
        "load_friction": {"coefficient": 0.05},
    }[name]


def complete_effects(
    robot: Robot, effects: Mapping[str, Values | None] | Sequence[str], stated: Mapping[str, Values]
) -> dict[str, dict[str, float]]:
    """Every effect at each of its places, with all its values.

    Parameters
    ----------
    robot
        Its joints.
    effects
        ``name`` or ``name@where``, with values or None.
    stated
        Values for those without: ``[model.values]``. What is in neither is `default_values`, or zero for the axes
        of a sensor that are left out.

    Raises
    ------
    InputError
        Unknown effect, place or parameter.
    """
    given = effects if isinstance(effects, Mapping) else dict.fromkeys(effects)
    out: dict[str, dict[str, float]] = {}
    for spec, own in given.items():
        for name, where, joint in _places(spec, robot):
            place = f"{name}@{where}"
            if own is None:
                own_here = stated.get(place, stated.get(spec, stated.get(name)))
            else:
                own_here = own
            values = default_values(name, joint, robot)
            known = {key: float(value) for key, value in (own_here or {}).items() if key != "fixed"}
            for key in known:
                if key not in values:
                    raise InputError(f"effect '{spec}': no parameter '{key}'; it has {', '.join(values)}")
            if joint is None and known:
                values = dict.fromkeys(values, 0.0)
            out[place] = values | known
    return out


def _places(spec: str, robot: Robot) -> list[tuple[str, str, int | None]]:
    name, at, where = spec.partition("@")
    if name not in KINDS and name not in PLANT_ONLY:
        known = [*KINDS, *PLANT_ONLY]
        close = get_close_matches(name, known, 1)
        hint = f"did you mean '{close[0]}'?" if close else f"known: {', '.join(known)}"
        raise InputError(f"effect '{spec}': '{name}' cannot be simulated; {hint}")
    if name not in PLANT_ONLY:
        return [(effect.name, effect.where, effect.joint) for effect in _parse(spec, robot)]
    joints = {joint: i for i, joint in enumerate(robot.joint_names)} | {f"joint{i + 1}": i for i in range(robot.n)}
    if at and where not in joints:
        raise InputError(f"effect '{spec}': no joint '{where}'; write joint1 to joint{robot.n} or a URDF joint name")
    return [(name, f"joint{i + 1}", i) for i in ([joints[where]] if at else range(robot.n))]


def _parse(spec: str, robot: Robot) -> tuple[Effect, ...]:
    return parse_effects([spec], robot.joint_names, (*WRENCH_NAMES, *(f"tau{i + 1}" for i in range(robot.n))))


def readings(
    robot: Robot, plant: Mapping[str, Mapping[str, float]], state: State, channels: Sequence[str], rigid: np.ndarray
) -> np.ndarray:
    """What the effects add to the channels' readings (N, c).

    Parameters
    ----------
    robot, plant
        Its joints and `complete_effects`.
    state
        True motion.
    channels
        Names of the channels.
    rigid
        What the rigid bodies make them read (N, c).
    """
    out = np.zeros_like(rigid)
    for spec, values in plant.items():
        name, _, where = spec.partition("@")
        if name not in PLANT_ONLY:
            for effect in _parse(spec, robot):
                out += effect.columns(state, channels) @ np.array(list(values.values()))
        elif "tau" + where.removeprefix("joint") in channels:
            k = channels.index("tau" + where.removeprefix("joint"))
            velocity = state.velocities[:, int(where.removeprefix("joint")) - 1]
            sense = np.clip(velocity / REST_SPEED, -1.0, 1.0)
            if name == "load_friction":
                out[:, k] += values["coefficient"] * np.abs(rigid[:, k]) * sense
            else:
                out[:, k] += values["level"] * np.exp(-((velocity / values["velocity"]) ** 2)) * sense
    return out
