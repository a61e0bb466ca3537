"""Robots of MuJoCo: an MJCF file as a URDF, and the comparison of both libraries that such a robot must pass.

MuJoCo compiles the file, so that defaults, includes, angles, frames and inertias of shapes mean what they mean there; the
compiled model becomes links and joints. What MuJoCo has inside a joint (armature, damping, friction loss, a spring) has no place
in a link: it is handed on beside them.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from scipy.spatial.transform import Rotation

from bayesid.errors import InputError, required
from bayesid.robot.inertia import ENTRIES

#: States that both libraries are compared in, and the largest difference, relative to the largest number: MuJoCo 4 agrees to
#: rounding, MuJoCo 3 finds principal axes of inertia to 1e-7.
STATES, AGREEMENT = 20, 1e-6
_EARTH = (0.0, 0.0, -9.81)


@dataclass(frozen=True)
class MjcfRobot:
    """A compiled MJCF file."""

    root: ET.Element  # the robot as a URDF, about the same base frame, MuJoCo's world; without shapes
    #: What each joint has inside, by joint and kind: ``damping`` [N m s/rad], ``frictionloss`` [N m], ``armature`` [kg m^2],
    #: ``stiffness`` [N m/rad] and ``springref`` [rad], or those of a slide; kinds that are zero are left out.
    inside: dict[str, dict[str, float]]
    notes: tuple[str, ...]  # what of the file the robot does not have, one line each
    model: Any  # MuJoCo's own

    def check(self, urdf: str, source: str) -> None:
        """Compare with Pinocchio's reading of the URDF; an `InputError` where mass matrices or bias forces differ."""
        joints = [str(j.get("name")) for j in self.root.findall("joint") if j.get("type") != "fixed"]
        armature = np.array([self.inside.get(name, {}).get("armature", 0.0) for name in joints])
        compare(
            self.model, urdf, joints, armature, self.model.opt.gravity, source,
            "tendons or actuators may carry inertia: take them out, or write a URDF",
        )  # fmt: skip


def load_mujoco() -> Any:
    """The package mujoco; an `InputError` where it is not installed."""
    return required("mujoco", InputError('MJCF needs MuJoCo, which is not installed; pip install "bayesid[mujoco]"'))


def read_mjcf(path: Path) -> MjcfRobot:
    """Read an MJCF file through MuJoCo.

    An `InputError` where MuJoCo is missing or refuses the file, or the robot is none that is fixed to the world by a tree of
    hinges and slides.
    """
    mujoco = load_mujoco()
    try:
        spec = mujoco.MjSpec.from_file(str(path))
    except (ValueError, OSError) as error:
        raise _refused(error, path) from None
    try:
        model = spec.compile()
    except ValueError as error:
        # Meshes may be missing that only draw the robot. What failed to compile is of no more use: the file is read again.
        spec = mujoco.MjSpec.from_file(str(path))
        model = _without_shapes(mujoco, spec)
        if model is None:
            raise _refused(error, path) from None
    _check_tree(mujoco, model, path.name)
    names = [model.joint(j).name or f"{model.body(model.jnt_bodyid[j]).name or 'body'}_joint{j}" for j in range(model.njnt)]
    root = _as_urdf(mujoco, model, names, str(spec.modelname))
    return MjcfRobot(root, _inside(mujoco, model, names), tuple(_notes(mujoco, model, names, path.name)), model)


def compare(
    model: Any, urdf: str, joints: Sequence[str], armature: np.ndarray, gravity: Sequence[float], source: str, remedy: str
) -> None:
    """Refuse a robot whose mass matrix or bias forces are not the same for MuJoCo's model and Pinocchio's reading of the URDF.

    ``joints`` are all that move, by name (n,); MuJoCo's are those of these names, or in this order where it has none. Their
    ``armature`` (n,) is part of MuJoCo's mass matrix, and no part of a URDF; ``gravity`` is in the base frame (3,) [m/s^2].
    """
    mujoco, n = load_mujoco(), len(joints)
    other = pin.buildModelFromXML(urdf)
    other.gravity.linear = np.array(gravity, float)
    if model.nv != n or other.nv != n:
        raise InputError(f"{source}: MuJoCo has {model.nv} joints and Pinocchio {other.nv}, not {n}; {remedy}")
    at = [mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, name) for name in joints]
    at = [k if found < 0 else found for k, found in enumerate(at)]
    mine, places = model.jnt_dofadr[at], model.jnt_qposadr[at]
    slides = model.jnt_type[at] == mujoco.mjtJoint.mjJNT_SLIDE
    dofs = np.array([other.joints[other.getJointId(name)].idx_v for name in joints], int)
    rng, data, own = np.random.default_rng(0), other.createData(), mujoco.MjData(model)
    found: list[list[np.ndarray]] = [[], []]
    for _ in range(STATES):
        q, v = rng.uniform(-np.pi, np.pi, n), rng.normal(size=n)
        q[slides] *= 0.2
        turn, rate = np.zeros((2, n))
        turn[dofs], rate[dofs] = q, v
        posture = pin.integrate(other, pin.neutral(other), turn)
        upper = np.triu(pin.crba(other, data, posture))
        mass = (upper + np.triu(upper, 1).T)[np.ix_(dofs, dofs)] + np.diag(armature)
        bias = pin.nonLinearEffects(other, data, posture, rate)[dofs]
        own.qpos[places], own.qvel[mine] = q, v
        mujoco.mj_forward(model, own)
        full = np.zeros((n, n))
        for column, unit in zip(full, np.eye(n), strict=True):
            mujoco.mj_mulM(model, own, column, unit)
        found[0].append(np.column_stack([full[np.ix_(mine, mine)], own.qfrc_bias[mine]]))
        found[1].append(np.column_stack([mass, bias]))
    one, two = (np.array(f) for f in found)
    # Bias forces may all be rounding, as of one upright axis; at speeds of about 1 they are usually as large as the inertias.
    for what, part, largest in (("mass matrices", slice(-1), two[..., :-1]), ("bias forces", slice(-1, None), two)):
        difference = float(np.abs(one[..., part] - two[..., part]).max(initial=0.0) / np.abs(largest).max(initial=1e-300))
        if not difference <= AGREEMENT:
            raise InputError(
                f"{source}: the {what} of MuJoCo and Pinocchio differ by {difference:.2g} of the largest number in "
                f"{STATES} random states, which must not be; {remedy}"
            )


def _refused(error: Exception, path: Path) -> InputError:
    reason = " ".join(str(error).split()).removeprefix("Error: ")[:200]
    return InputError(f"MuJoCo does not read it ({reason})", file=path.name, remedy="give a file that MuJoCo's viewer shows")


def _without_shapes(mujoco: Any, spec: Any) -> Any:
    """The model without geoms and what refers to them; None where the file has inertias from shapes, or is wrong otherwise."""
    shaped = [body for body in spec.bodies if len(body.geoms)]
    if spec.compiler.inertiafromgeom == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE:
        return None
    if any(not body.explicitinertial and _moves(body) for body in shaped):
        return None
    parts = (spec.sensors, spec.pairs, spec.skins, spec.geoms, spec.meshes, spec.hfields, spec.materials, spec.textures)
    try:
        for element in [element for part in parts for element in part]:
            spec.delete(element)
        return spec.compile()
    except ValueError:
        return None


def _moves(body: Any) -> bool:
    """Whether a body, or one that carries it, is on a joint; what is fixed to the world weighs on none."""
    while body is not None:
        if len(body.joints):
            return True
        body = body.parent
    return False


def _check_tree(mujoco: Any, model: Any, source: str) -> None:
    wrong = partial(InputError, file=source)
    for j in range(model.njnt):
        kind, what = model.jnt_type[j], f"joint {model.joint(j).name or j}"
        if kind == mujoco.mjtJoint.mjJNT_FREE:
            remedy = "only robots with a fixed base are identified: remove the joint, if the base does not move"
            raise wrong(f"{what} is free, so that the robot floats", remedy=remedy)
        if kind == mujoco.mjtJoint.mjJNT_BALL:
            raise wrong(f"{what} is a ball", remedy="write three hinges, as the positions of a log are")
    loops = {mujoco.mjtEq.mjEQ_CONNECT: "connect", mujoco.mjtEq.mjEQ_WELD: "weld", mujoco.mjtEq.mjEQ_TENDON: "tendon"}
    for k in range(model.neq):
        if model.eq_active0[k] and (kind := loops.get(mujoco.mjtEq(model.eq_type[k]))):
            remedy = "only trees are identified: remove it, if the loop does not carry load"
            raise wrong(f"equality {model.equality(k).name or k} ({kind}) closes a loop", remedy=remedy)
    if model.nflex:
        raise wrong("has a flex, a soft body", remedy="only rigid bodies are identified: remove it")


def _as_urdf(mujoco: Any, model: Any, names: Sequence[str], name: str) -> ET.Element:
    """Links and joints. A link's frame is that of its body, moved to the anchor of the body's last joint."""
    root = ET.Element("robot", name=name or "mjcf")
    taken = {model.body(b).name for b in range(model.nbody)} | {""}

    def unique(text: str) -> str:
        while text in taken:
            text += "_"
        taken.add(text)
        return text

    links = [model.body(b).name or unique(f"body{b}") for b in range(model.nbody)]
    links[0] = "world"
    anchors = np.zeros((model.nbody, 3))  # of each link's frame in its body's
    follows, efforts = _followed(mujoco, model, names), _efforts(mujoco, model)
    ET.SubElement(root, "link", name="world")
    for b in range(1, model.nbody):
        up = int(model.body_parentid[b])
        parent, at, turn = links[up], model.body_pos[b] - anchors[up], _rotation(model.body_quat[b])
        first = int(model.body_jntadr[b])
        moving = range(first, first + int(model.body_jntnum[b]))  # none where the body is welded
        for j in moving:
            # At its reference position the body stands as the file places it: there the joint's own frame is turned back by it.
            axis, reference = model.jnt_axis[j], float(model.qpos0[model.jnt_qposadr[j]])
            slides = model.jnt_type[j] == mujoco.mjtJoint.mjJNT_SLIDE
            at = at + turn @ (model.jnt_pos[j] - anchors[b] - (reference * axis if slides else 0.0))
            if not slides:
                turn = turn @ Rotation.from_rotvec(-reference * axis).as_matrix()
            child = links[b] if j == moving[-1] else unique(f"{names[j]}_link")
            element = _joint(root, names[j], "prismatic" if slides else "continuous", parent, child, at, turn)
            ET.SubElement(element, "axis", xyz=number_text(axis))
            _limit(element, model, j, slides, efforts[j])
            if names[j] in follows:
                ET.SubElement(element, "mimic", joint=follows[names[j]])
            if j != moving[-1]:
                ET.SubElement(root, "link", name=child)
            parent, at, turn, anchors[b] = child, np.zeros(3), np.eye(3), model.jnt_pos[j]
        if not moving:
            _joint(root, unique(f"{links[b]}_fixed"), "fixed", parent, links[b], at, turn)
        link = ET.SubElement(root, "link", name=links[b])
        if model.body_mass[b] > 0.0:
            inertial = ET.SubElement(link, "inertial")
            axes = _rotation(model.body_iquat[b])
            about = axes @ np.diag(model.body_inertia[b]) @ axes.T
            ET.SubElement(inertial, "origin", xyz=number_text(model.body_ipos[b] - anchors[b]), rpy="0 0 0")
            ET.SubElement(inertial, "mass", value=number_text(model.body_mass[b]))
            ET.SubElement(inertial, "inertia", {key: number_text(about[index]) for key, index in ENTRIES.items()})
    return root


def _joint(root: ET.Element, name: str, kind: str, parent: str, child: str, at: np.ndarray, turn: np.ndarray) -> ET.Element:
    element = ET.SubElement(root, "joint", name=name, type=kind)
    ET.SubElement(element, "parent", link=parent)
    ET.SubElement(element, "child", link=child)
    ET.SubElement(element, "origin", xyz=number_text(at), rpy=number_text(pin.rpy.matrixToRpy(turn)))
    return element


def _limit(joint: ET.Element, model: Any, j: int, slides: bool, effort: float) -> None:
    """Limits; zeros where there are none, as URDF has it."""
    limited = bool(model.jnt_limited[j])
    lower, upper = model.jnt_range[j] if limited else (0.0, 0.0)
    if limited and not slides:
        joint.set("type", "revolute")
    ET.SubElement(joint, "limit", lower=number_text(lower), upper=number_text(upper), velocity="0", effort=number_text(effort))


def _efforts(mujoco: Any, model: Any) -> np.ndarray:
    """Largest torque or force of each joint, of the joint's own range and of its motor's at its gear; 0 for none (n,)."""
    out = np.where(model.jnt_actfrclimited, np.abs(model.jnt_actfrcrange).max(axis=1), 0.0)
    for k in range(model.nu):
        if model.actuator_forcelimited[k] and model.actuator_trntype[k] == mujoco.mjtTrn.mjTRN_JOINT:
            joint = int(model.actuator_trnid[k, 0])
            own = abs(float(model.actuator_gear[k, 0])) * float(np.abs(model.actuator_forcerange[k]).max())
            out[joint] = min(own, out[joint] or own)
    return out


def _followed(mujoco: Any, model: Any, names: Sequence[str]) -> dict[str, str]:
    """Which joint an equality makes follow which other."""
    pairs = [
        (int(model.eq_obj1id[k]), int(model.eq_obj2id[k])) for k in range(model.neq)
        if model.eq_active0[k] and model.eq_type[k] == mujoco.mjtEq.mjEQ_JOINT
    ]  # fmt: skip
    return {names[one]: names[other] for one, other in pairs if other >= 0}


def _inside(mujoco: Any, model: Any, names: Sequence[str]) -> dict[str, dict[str, float]]:
    """What joints have inside, their motors' own included: at gear g, armature and damping of a motor count g^2."""
    dof, at = model.jnt_dofadr, model.jnt_qposadr
    damping, armature = model.dof_damping[dof].copy(), model.dof_armature[dof].copy()
    for k in range(model.nu):
        if hasattr(model, "actuator_armature") and model.actuator_trntype[k] == mujoco.mjtTrn.mjTRN_JOINT:  # MuJoCo 4
            joint, gear = int(model.actuator_trnid[k, 0]), float(model.actuator_gear[k, 0])
            armature[joint] += gear**2 * float(model.actuator_armature[k])
            damping[joint] += gear**2 * float(model.actuator_damping[k])
    out: dict[str, dict[str, float]] = {}
    for j, name in enumerate(names):
        values = {"damping": damping[j], "frictionloss": model.dof_frictionloss[dof[j]], "armature": armature[j]}
        values = {key: float(value) for key, value in values.items() if value}
        if model.jnt_stiffness[j]:
            values |= {"stiffness": float(model.jnt_stiffness[j]), "springref": float(model.qpos_spring[at[j]])}
        if values:
            out[name] = values
    return out


def _notes(mujoco: Any, model: Any, names: Sequence[str], source: str) -> list[str]:
    """What of the model the robot here does not have, one line each."""
    out = []
    if not np.allclose(model.opt.gravity, _EARTH, atol=1e-3):
        out.append(
            f"{source}: its gravity, {number_text(model.opt.gravity)} m/s^2, is not taken: state gravity, if the recording's is "
            f"not {number_text(_EARTH)}"
        )
    if model.body_gravcomp.any():
        out.append(f"{source}: gravcomp is left out: measured torques carry the whole weight; write 0, or correct the log")
    bent = [name for j, name in enumerate(names) if _bends(model, j)]
    if bent:
        out.append(f"{source}: damping or stiffness that is no constant is left out: {', '.join(bent)}; state an effect for it")
    if any(getattr(model, f"tendon_{key}").any() for key in ("stiffness", "damping", "frictionloss")):
        out.append(f"{source}: springs and friction of tendons are left out; state an effect of your own for them")
    for k in range(model.neq):
        if model.eq_active0[k] and model.eq_type[k] == mujoco.mjtEq.mjEQ_JOINT and model.eq_obj2id[k] < 0:
            joint = names[int(model.eq_obj1id[k])]
            out.append(f"{source}: joint {joint} is held by an equality; here it is not: list it in locked, if it stands")
    return out


def _bends(model: Any, j: int) -> bool:
    if not hasattr(model, "dof_dampingpoly"):  # before MuJoCo 4
        return False
    return bool(model.dof_dampingpoly[model.jnt_dofadr[j]].any() or model.jnt_stiffnesspoly[j].any())


def _rotation(quaternion: np.ndarray) -> np.ndarray:
    """Rotation matrix (3, 3) of MuJoCo's quaternion, scalar first (4,)."""
    return Rotation.from_quat(np.roll(quaternion, -1)).as_matrix()


def number_text(values: Any) -> str:
    """Numbers as an attribute of XML holds them, with all their digits."""
    return " ".join(repr(float(x)) for x in np.atleast_1d(values))
