"""Random effects of a place and direction, to be scaled to a size; and every effect that might be taken for another."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from arms import frames, parameters, pseudo_inertia, warped
from plant import AXES, LINK, Effect
from sizes import Study

WRENCH = (
    "sensor_offset", "sensor_drift", "sensor_gain", "sensor_crosstalk", "sensor_rotation", "sensor_translation", "sensor_delay",
    "base_tilt", "payload", "inertia_error", "tether", "fluid_drag", "rotor_momentum", "joint_flexibility", "encoder_offset",
    "external_contact", "base_compliance", "backlash",
)  # fmt: skip
TORQUE = (
    "base_tilt", "payload", "inertia_error", "tether", "fluid_drag", "joint_flexibility", "encoder_offset", "external_contact",
    "viscous_friction", "coulomb_friction", "torque_offset", "stribeck_friction", "load_friction", "rotor_inertia", "torque_gain",
    "torque_ripple", "spring", "backlash", "dahl_friction", "directional_friction", "posture_friction", "warming_friction",
    "torque_delay",
)  # fmt: skip
NOT_WITH_STATIC = ("sensor_offset", "sensor_drift", "external_contact", "base_compliance", "thermal")
UNLISTED = {
    "wrench": ("cubic_moment", "saturation", "hysteresis", "thermal", "vibration"),
    "torque": ("quadratic_friction",),
}
PARTLY_RIGHT = {
    "quadratic_friction": ["viscous_friction"],
    "cubic_moment": ["sensor_gain"], "saturation": ["sensor_gain"], "hysteresis": ["sensor_gain", "sensor_delay"],
    "thermal": ["sensor_drift", "sensor_offset"], "vibration": [],
}  # fmt: skip
UNITS = {
    "gain": "1", "delay": "s", "stiffness": "N/m", "rest_length": "m", "linear": "N s/m per m", "quadratic": "N s^2/m^2 per m",
    "compliance": "rad/(N m)", "angle": "rad", "start": "s", "end": "s", "resonance": "Hz", "damping": "1", "offset": "N m",
    "velocity": "rad/s", "amplitude": "N m", "periods": "1", "phase": "rad", "rest": "rad", "level": "N m", "m": "kg",
    "gap": "rad", "firm": "N m", "distance": "rad", "difference": "N m s/rad", "cosine": "N m", "sine": "N m", "time": "s",
}  # fmt: skip
SCALED = {
    "tether": ("stiffness",), "external_contact": ("fx", "fy", "fz"), "stribeck_friction": ("level",),
    "torque_ripple": ("amplitude",),
    "spring": ("stiffness",), "base_compliance": ("resonance",), "dahl_friction": ("level",), "backlash": ("gap",),
    "hysteresis": ("level",), "warming_friction": ("level", "coefficient"),
    "thermal": AXES, "vibration": AXES, "rotor_momentum": ("inertia",), "saturation": ("depth",),
}  # fmt: skip
NOT_MAIN = (
    "damping", "rest_length", "anchor_x", "anchor_y", "anchor_z", "point_x", "point_y", "point_z", "phase", "rest", "velocity",
    "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz", "firm",
    "distance", "time",
)  # fmt: skip
SOFTEST = 6.0  # a flexible joint rings at least at [Hz]
# Beyond these an effect is no longer what anybody would meet.
LARGEST = {
    "sensor_gain": ("gain", 0.5), "sensor_rotation": ("rx", 0.3), "sensor_translation": ("x", 0.15),
    "sensor_delay": ("delay", 0.04),
    "base_tilt": ("x", 0.15), "payload": ("m", 8.0), "encoder_offset": ("angle", 0.3), "load_friction": ("coefficient", 0.5),
    "torque_gain": ("gain", 0.6), "torque_delay": ("delay", 0.04), "saturation": ("depth", 0.7),
    "tether": ("stiffness", 800.0),
}  # fmt: skip


def scaled(effect: Effect, factor: float) -> Effect:
    """The effect with its amplitude multiplied; a mount's resonance goes with the inverse root."""
    keys = SCALED.get(effect.name, tuple(effect.values))
    power = -0.5 if effect.name == "base_compliance" else 1.0
    values = {key: value * factor**power if key in keys else value for key, value in effect.values.items()}
    return replace(effect, values=_clipping(values) if effect.name == "saturation" else values)


def _clipping(values: dict[str, float]) -> dict[str, float]:
    half = (values["top"] - values["bottom"]) / 2
    return values | {"high": values["top"] - values["depth"] * half, "low": values["bottom"] + values["depth"] * half}


def plausible(effect: Effect, study: Study) -> bool:
    """Whether anybody could meet the effect in this size, and the robot stays one."""
    if effect.name in ("payload", "inertia_error"):
        total = pseudo_inertia(study.arm.links[effect.joint] + effect.vector(*LINK))
        if np.linalg.eigvalsh(total)[0] <= 0:
            return False
    if effect.name == "joint_flexibility":  # its own resonance is clear of the motion, as in any arm that works
        inertia = study.part_inertia(effect.joint)
        return effect.values["compliance"] * inertia * (2 * np.pi * SOFTEST) ** 2 < 1.0
    if effect.name == "backlash":  # a worn gear's at most, and within the joint's range
        model, j = study.arm.model, 7 + effect.joint
        return effect.values["gap"] < min(0.02, model.upperPositionLimit[j] - model.lowerPositionLimit[j])
    if effect.name == "base_compliance":
        return 2.5 < effect.values["resonance"] < 45.0
    if effect.name == "sensor_crosstalk":
        source, reading = effect.where.split("->")
        return abs(effect.values["coefficient"]) < {"ff": 0.3, "mm": 0.3, "fm": 0.3, "mf": 3.0}[source[0] + reading[0]]
    key, most = LARGEST.get(effect.name, ("", np.inf))
    return abs(effect.values.get(key, 0.0)) < most


def draw(name: str, study: Study, static: bool, rng: np.random.Generator) -> Effect:
    """An effect at a random place, of about a tenth to ten times the floor."""
    n, sign = study.arm.n, rng.choice([-1.0, 1.0])
    joint = int(rng.integers(n))
    outer = int(rng.integers(1, n))
    lasting = study.parts[0].motion.t[-1]
    spread = np.array([study.floor[study.channels.index(axis)] if axis in study.channels else 0.0 for axis in AXES])

    def at(where: str, **values: float) -> Effect:
        return Effect(name, where, {key: float(value) for key, value in values.items()})

    def on(j: int, **values: float) -> Effect:
        return at(f"joint{j + 1}", **values)

    def six(time: float = 1.0) -> dict[str, float]:
        return dict(zip(AXES, 3 * spread * rng.normal(size=6) / time, strict=True))

    def vector(keys: tuple[str, ...], size: float) -> dict[str, float]:
        return dict(zip(keys, size * rng.normal(size=len(keys)), strict=True))

    point = dict(zip(("point_x", "point_y", "point_z"), rng.uniform(-0.1, 0.1, 3), strict=True))
    tau = float(study.floor[study.channels.index(f"tau{joint + 1}")]) if f"tau{joint + 1}" in study.channels else 0.1
    axis = AXES[int(rng.integers(6))]
    makers: dict[str, Callable[[], Effect]] = {
        "sensor_offset": lambda: at("sensor", **six()),
        "sensor_drift": lambda: at("sensor", **six(lasting / 3)),
        "sensor_gain": lambda: at(axis, gain=0.05 * sign),
        "sensor_crosstalk": lambda: _crosstalk(axis, AXES[int(rng.integers(6))], sign, study),
        "sensor_rotation": lambda: at("sensor", **vector(("rx", "ry", "rz"), 0.01)),
        "sensor_translation": lambda: at("sensor", **vector(("x", "y", "z"), 0.01)),
        "sensor_delay": lambda: at("sensor", delay=0.003),
        "base_tilt": lambda: at("base", **vector(("x", "y"), 0.005)),
        "payload": lambda: on(outer, **_payload(rng)),
        "inertia_error": lambda: on(joint, **_inertia_error(study.arm.links[joint], rng)),
        "tether": lambda: on(outer, **_tether(study, outer, rng), **point),
        "fluid_drag": lambda: at("robot", linear=rng.uniform(0.2, 2.0), quadratic=rng.uniform(0.2, 2.0)),
        "rotor_momentum": lambda: on(joint, inertia=0.01, gear_ratio=float(study.gears[joint])),
        "joint_flexibility": lambda: on(joint, compliance=1e-4),
        "encoder_offset": lambda: on(joint, angle=0.01 * sign),
        "external_contact": lambda: on(outer, **_window(lasting, rng), **vector(("fx", "fy", "fz"), 1.0), **point),
        "base_compliance": lambda: at("base", resonance=10.0, damping=rng.uniform(0.02, 0.08)),
        "viscous_friction": lambda: on(joint, coefficient=tau),
        "coulomb_friction": lambda: on(joint, level=tau),
        "torque_offset": lambda: on(joint, offset=tau * sign),
        "stribeck_friction": lambda: on(joint, level=tau, velocity=rng.uniform(0.05, 0.2)),
        "load_friction": lambda: on(joint, coefficient=0.05),
        "rotor_inertia": lambda: on(joint, inertia=tau),
        "torque_gain": lambda: on(joint, gain=0.05 * sign),
        "torque_ripple": lambda: on(joint, amplitude=tau, periods=float(rng.integers(6, 25)), phase=rng.uniform(0, 2 * np.pi)),
        "spring": lambda: on(joint, stiffness=tau, rest=rng.uniform(-0.5, 0.5)),
        "dahl_friction": lambda: on(joint, level=tau, distance=rng.uniform(0.03, 0.25)),
        "directional_friction": lambda: on(joint, difference=tau * sign),
        "posture_friction": lambda: on(joint, **vector(("cosine", "sine"), tau)),
        "warming_friction": lambda: on(joint, level=tau / lasting, coefficient=tau / lasting, time=rng.uniform(5.0, 100.0)),
        "torque_delay": lambda: at("robot", delay=0.003 * sign),
        "quadratic_friction": lambda: on(joint, coefficient=tau),
        "backlash": lambda: on(joint, gap=0.002, firm=rng.uniform(0.3, 1.0) * tau),
        "cubic_moment": lambda: at(axis, coefficient=1e-4 * sign),
        "saturation": lambda: _saturation(axis, study),
        "hysteresis": lambda: at(axis, level=3 * spread[AXES.index(axis)], width=_swing(axis, study) * rng.uniform(0.05, 0.2)),
        "thermal": lambda: at("sensor", **six(), time=rng.uniform(1.5, 4.0)),
        "vibration": lambda: at("base", **six(), frequency=rng.uniform(4.0, 8.5), phase=rng.uniform(0, 2 * np.pi)),
    }  # fmt: skip
    if name in ("cubic_moment",):
        axis = AXES[int(rng.integers(3, 5))]
    return makers[name]()


def _crosstalk(source: str, reading: str, sign: float, study: Study) -> Effect:
    if source == reading:
        reading = AXES[(AXES.index(source) + 1) % 6]
    return Effect("sensor_crosstalk", f"{source}->{reading}", {"coefficient": 0.01 * sign})


def _wrenches(study: Study) -> np.ndarray:
    return np.vstack([study.sensor.read(part.rigid[0]) for part in study.parts])


def _swing(axis: str, study: Study) -> float:
    return float(np.std(_wrenches(study)[:, AXES.index(axis)]))


def _saturation(axis: str, study: Study) -> Effect:
    values = [study.sensor.read(part.rigid[0])[:, AXES.index(axis)] for part in study.parts]
    top, bottom = min(float(x.max()) for x in values), max(float(x.min()) for x in values)  # every motion reaches both
    return Effect("saturation", axis, _clipping({"depth": 0.1, "top": top, "bottom": bottom}))


def _payload(rng: np.random.Generator) -> dict[str, float]:
    com, about = rng.uniform(-0.1, 0.1, 3), np.diag(rng.uniform(0.02, 0.08, 3) ** 2)
    pseudo = np.zeros((4, 4))
    pseudo[:3, :3], pseudo[:3, 3], pseudo[3, :3], pseudo[3, 3] = about + np.outer(com, com), com, com, 1.0
    return dict(zip(LINK, 0.3 * parameters(pseudo), strict=True))


def _inertia_error(link: np.ndarray, rng: np.random.Generator) -> dict[str, float]:
    while True:
        change = warped(link, 0.25, rng) - link
        values = np.linalg.eigvalsh(pseudo_inertia(change))
        if values[0] < -0.1 * values[-1]:  # not a possible body
            return dict(zip(LINK, 0.3 * change, strict=True))


def _tether(study: Study, joint: int, rng: np.random.Generator) -> dict[str, float]:
    home = study.parts[0].motion.q[:1]
    here = frames(study.arm, home, 0 * home).origin[0, joint]
    direction = rng.normal(size=3)
    direction[2] = abs(direction[2])
    away = rng.uniform(0.6, 1.2)
    anchor = here + away * direction / np.linalg.norm(direction)
    return dict(
        zip(
            ("stiffness", "rest_length", "anchor_x", "anchor_y", "anchor_z"),
            (5.0, away * rng.uniform(0.1, 0.6), *anchor),
            strict=True,
        )
    )


def _window(lasting: float, rng: np.random.Generator) -> dict[str, float]:
    length = rng.uniform(2.0, 5.0)
    start = rng.uniform(1.5, lasting - 1.5 - length)
    return {"start": start, "end": start + length}


def candidates(study: Study, static: bool) -> dict[tuple[str, str], list[list[np.ndarray]]]:
    """Unit signals of every effect of the vocabulary that is linear enough: by name and place, a list of columns of motions."""
    out: dict[tuple[str, str], list[list[np.ndarray]]] = {}
    wrench, torque = "fx" in study.channels, "tau1" in study.channels

    def add(name: str, where: str, size: float, *keys: str, **fixed: float) -> None:
        if static and name in NOT_WITH_STATIC:
            return
        out[name, where] = [study.signals((Effect(name, where, {key: size} | fixed),)) for key in keys]

    joints = [f"joint{j + 1}" for j in range(study.arm.n)]
    for j, where in enumerate(joints):
        columns = [[part.columns[:, :, 10 * j + k] for part in study.parts] for k in range(10)]
        out["inertia_error", where] = out["payload", where] = columns
        add("encoder_offset", where, 1e-3, "angle")
        add("joint_flexibility", where, 1e-5, "compliance")
        if torque:
            add("viscous_friction", where, 1.0, "coefficient")
            add("coulomb_friction", where, 1.0, "level")
            add("torque_offset", where, 1.0, "offset")
            add("load_friction", where, 0.1, "coefficient")
            add("rotor_inertia", where, 1.0, "inertia")
            add("torque_gain", where, 0.1, "gain")
            add("stribeck_friction", where, 1.0, "level", velocity=0.1)
            add("dahl_friction", where, 1.0, "level", distance=0.05)
            add("directional_friction", where, 1.0, "difference")
            add("posture_friction", where, 1.0, "cosine", "sine")
            add("warming_friction", where, 0.1, "level", "coefficient", time=100.0)
            spring = [study.signals((Effect("spring", where, {"stiffness": 1.0, "rest": rest}),)) for rest in (0.0, 1.0)]
            out["spring", where] = spring
        add("backlash", where, 1e-4, "gap", firm=0.1)
    if torque:
        add("torque_delay", "robot", 1e-3, "delay")
    add("base_tilt", "base", 1e-3, "x", "y")
    add("fluid_drag", "robot", 1.0, "linear", "quadratic")
    if wrench:
        add("sensor_offset", "sensor", 1.0, *AXES)
        add("sensor_drift", "sensor", 0.1, *AXES)
        add("sensor_rotation", "sensor", 1e-3, "rx", "ry", "rz")
        add("sensor_translation", "sensor", 1e-3, "x", "y", "z")
        add("sensor_delay", "sensor", 1e-3, "delay")
        for source in AXES:
            add("sensor_gain", source, 0.01, "gain")
            for reading in AXES:
                if source != reading:
                    add("sensor_crosstalk", f"{source}->{reading}", 0.01, "coefficient")
    return out
