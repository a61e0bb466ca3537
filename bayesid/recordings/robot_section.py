"""The robot of an experiment folder: its URDF, read under the names and limits that experiment.toml states."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from bayesid.effects.library import by_number
from bayesid.errors import InputError
from bayesid.recordings.complaints import listed, suggest
from bayesid.recordings.examination import LIMIT_SLACK
from bayesid.recordings.schema import EffectParameters, RobotSection
from bayesid.robot.prior import drawn_without_inertial, gyration_radius, point_like, states_masses
from bayesid.robot.robot import Robot, load_robot
from bayesid.robot.sources import NAMED, locate
from bayesid.robot.urdf_file import UrdfFile, read_urdf

#: What an effect's parameters are called in MJCF; where the first is absent or zero, so is the effect.
_INSIDE = {
    "viscous_friction": {"coefficient": "damping"},
    "coulomb_friction": {"level": "frictionloss"},
    "rotor_inertia": {"inertia": "armature"},
    "spring": {"stiffness": "stiffness", "rest": "springref"},
}


def read_robot(folder: Path, section: RobotSection, sensor_joint: str | None) -> tuple[Robot, list[str]]:
    """Read the robot of a ``[robot]`` section and check it, with warnings.

    An `InputError` where the URDF is absent or damaged, or lacks a joint that experiment.toml names.
    """
    if not section.urdf.startswith(NAMED) and not locate(section.urdf, folder).path.is_file():
        raise InputError(
            f'"{section.urdf}" is no file in {folder}', file="experiment.toml", key="[robot] urdf", value=section.urdf,
            remedy="name the URDF there",
        )  # fmt: skip
    urdf = read_urdf(section.urdf, folder)
    try:
        robot = load_robot(urdf, section.joints, section.locked, section.gravity, sensor_joint)
    except InputError as error:
        # The robot knows the URDF only; the user's mistake may be in the keys that name its joints.
        joints, locked = ([f"joint '{name}'" for name in names] for names in (section.joints, section.locked))
        keys = {"[robot] joints": joints, "[robot] locked": locked, "[sensor] joint": [f"sensor joint '{sensor_joint}'"]}
        for key, begins in keys.items():
            if str(error).startswith(tuple(begins)):
                raise InputError(str(error), file="experiment.toml", key=key) from None
        raise
    for name in section.gear_ratio:
        if name not in section.joints:
            raise InputError(
                f'"{name}" is not one of joints', file="experiment.toml", key="[robot] gear_ratio", value=name,
                remedy=suggest(name, section.joints),
            )  # fmt: skip
    return robot, robot_doubts(robot, section.locked, "experiment.toml: [robot] ", section.inertia_rel_std)


def with_stated_effects(
    robot: Robot, effects: Sequence[str] | None = None, values: EffectParameters | None = None
) -> tuple[tuple[str, ...], EffectParameters]:
    """Effects of a model, and starting values, with what the robot's own file states, as MJCF does: friction, rotors, springs.

    Default effects are those that the file states, of each joint that moves; what the user states goes before what the file
    does.
    """
    own: EffectParameters = {}
    values = values or {}
    stated = {by_number(spec, robot.joint_names) for spec in values}
    for effect, parameters in _INSIDE.items():
        for k, joint in enumerate(robot.joint_names):
            inside, spec = robot.description.inside.get(joint, {}), f"{effect}@joint{k + 1}"
            if next(iter(parameters.values())) in inside and not {effect, spec} & stated:
                own[spec] = {name: inside[key] for name, key in parameters.items()}
    if effects is None:
        return tuple(own), own | values
    listed = {by_number(spec, robot.joint_names) for spec in effects}
    used = {spec: start for spec, start in own.items() if {spec, spec.partition("@")[0]} & listed}
    return tuple(effects), used | values


def check_loaded(robot: Robot, joints: Sequence[str] | None, gravity: Sequence[float] | None) -> None:
    """Refuse joints and gravity (3,) [m/s^2], where there are any, that are not those with which a robot was loaded."""
    for key, asked, has in (("joints", joints, robot.joint_names), ("gravity", gravity, robot.gravity.tolist())):
        if asked is not None and list(asked) != list(has):
            raise InputError(f"{key} = {list(asked)}, but the robot was loaded with {list(has)}; give load_robot the same")


def check_knowledge(sizes: Mapping[str, float | None], gear_ratio: Mapping[str, float], robot: Robot) -> None:
    """Refuse what cannot be known of a robot: sizes by name that are no numbers from 0, gear ratios of what does not move."""
    for key, size in sizes.items():
        if size is not None and not 0.0 <= size < np.inf:
            raise InputError(f"{size} is out of range", key=key, value=size, remedy="give 0 or more, or None if it is not known")
    for name, ratio in gear_ratio.items():
        if name not in robot.joint_names:
            remedy = suggest(name, robot.joint_names)
            raise InputError(f'"{name}" is not one of joints', key="gear_ratio", value=name, remedy=remedy)
        if not 0.0 < ratio < np.inf:
            raise InputError(f"{name} = {ratio} is out of range", key="gear_ratio", value=ratio, remedy="give a number above 0")


def robot_doubts(robot: Robot, locked: Mapping[str, float], stated: str, rel_std: float | None = None) -> list[str]:
    """What is doubtful about a robot and its URDF, one line each; ``stated`` is where joints and their positions are.

    ``rel_std`` is the relative standard deviation of the nominal inertias, where that is known.
    """
    urdf = robot.description
    points = _points(robot, urdf, rel_std) if rel_std else []
    return [*urdf.warnings, *_missing(robot, urdf), *points, *_doubts(robot, urdf, locked, stated), *_weights(robot)]


def _missing(robot: Robot, urdf: UrdfFile) -> list[str]:
    """Links without an ``<inertial>`` that have a shape or a length, in a robot whose other links have masses."""
    if not states_masses(robot):
        return []  # reported of the whole file
    found = [urdf.joints[name].child for name, bare in zip(robot.joint_names, drawn_without_inertial(robot), strict=True) if bare]
    if not found:
        return []
    one, them = (f"link {found[0]}", "it") if len(found) == 1 else (f"links {listed(found)}", "them")
    return [
        f"{robot.urdf.name}: {one}: no <inertial>, so the nominal robot lacks the mass of {them}, which diagnose looks for "
        "and all other priors leave to the data; write the <inertial>"
    ]


def _points(robot: Robot, urdf: UrdfFile, rel_std: float) -> list[str]:
    """Links that are point masses in the URDF: a share of their own size is next to nothing."""
    found = np.flatnonzero(point_like(robot)).tolist()
    if not found:
        return []
    names = [urdf.joints[robot.joint_names[j]].child for j in found]
    size = 1e3 * max(gyration_radius(robot.nominal[j]) for j in found)
    one = f"link {names[0]} has its" if len(found) == 1 else f"links {listed(names)} have their"
    return [
        f"{robot.urdf.name}: {one} mass within {size:.2g} mm of one point, little for a link that long: inertia_rel_std = "
        f"{rel_std:g} trusts that point to {rel_std * size:.2g} mm, and what the URDF has wrong there passes for a payload; "
        "correct the inertia, or leave out inertia_rel_std"
    ]


def _doubts(robot: Robot, urdf: UrdfFile, locked: Mapping[str, float], stated: str) -> list[str]:
    """What is made of joints that the URDF means otherwise."""
    out = []
    for name, joint in urdf.joints.items():
        if joint.mimics is not None and joint.kind != "fixed":
            remedy = f"list it in {stated.rpartition(': ')[2]}joints if it moves, now it is locked"
            if name in robot.joint_names:
                remedy = "give it its own column of positions"
            out.append(f"{robot.urdf.name}: joint {name} mimics {joint.mimics}; here it does not follow; {remedy}")
    limits = {joint.get("name"): joint.find("limit") for joint in urdf.root.findall("joint")} if locked else {}
    for name, at in locked.items():
        kind, limit = urdf.joints[name].kind, limits[name]
        if kind in ("revolute", "continuous") and abs(at) > 2.0 * math.pi:
            out.append(f"{stated}locked: {name} = {at:g} rad is over a turn; is it in degrees? write radians")
        elif kind != "continuous" and limit is not None:
            lower, upper = (float(limit.get(end, "0")) for end in ("lower", "upper"))
            turned = [at] if kind == "prismatic" else [at - 2.0 * math.pi, at, at + 2.0 * math.pi]  # the same pose
            if lower < upper and not any(lower - LIMIT_SLACK <= one <= upper + LIMIT_SLACK for one in turned):
                out.append(
                    f"{stated}locked: {name} = {at:g}, {robot.urdf.name} allows {lower:g} to {upper:g} "
                    f"{'m' if kind == 'prismatic' else 'rad'}; check the unit (rad or m) and the limits"
                )
    return out


def _weights(robot: Robot) -> list[str]:
    """Robots too light for the tolerances inside."""
    total = float(robot.nominal[:, 0].sum())
    if 0.0 < total < 1e-3:
        return [
            f"{robot.urdf.name}: all moving links weigh {total:g} kg together; intervals are not validated for so light a robot: "
            "are the masses in kilograms? write kilograms"
        ]
    return []
