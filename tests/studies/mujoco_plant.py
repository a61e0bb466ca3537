"""A robot arm that MuJoCo simulates: its dynamics, friction and sensor are neither bayesid's nor Pinocchio's.

Pinocchio reads where the URDF has its joints; from there on all is MuJoCo's.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

import mujoco
import numpy as np
import pinocchio as pin

#: Friction is a constraint of MuJoCo: how stiffly it holds a joint that rests.
_HELD = 'solreffriction="0.0012 1" solimpfriction="0.9995 0.9995 0.001 0.5 2"'


def recorded(
    model: pin.Model, links: np.ndarray, friction: float, step: float, start: tuple[np.ndarray, np.ndarray],
    drives: Iterable[Callable[[np.ndarray, np.ndarray], np.ndarray]],
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Positions (N, n) [rad] of a serial arm, and the wrench of the ground on its base (N, 6) [N, N m], at every step.

    The wrench is without the weight of the base, a constant.

    Parameters
    ----------
    model
        Where the joints are, all of them revolute.
    links
        Ten parameters of each link in a row (10 n,).
    friction
        Coulomb friction of each joint [N m].
    step
        Of the simulation [s].
    start
        Position and velocity (n,) that it starts with.
    drives
        For each step, what gives the drives' torques (n,) at a position and a velocity.
    """
    plant = _plant(model, links, friction, step)
    state, positions, wrenches = mujoco.MjData(plant), [], []
    state.qpos[:], state.qvel[:] = start
    for drive in drives:
        positions.append(state.qpos.copy())
        state.qfrc_applied[:] = drive(state.qpos.copy(), state.qvel.copy())
        mujoco.mj_step(plant, state)  # reads the sensor before it moves
        wrenches.append(state.sensordata.copy())
    return np.array(positions), np.array(wrenches)


def _plant(model: pin.Model, links: np.ndarray, friction: float, step: float) -> mujoco.MjModel:
    """MuJoCo's model of the arm, on a sensor in the origin of its base."""

    def text(*values: float) -> str:
        return " ".join(f"{x:.17g}" for x in values)

    bodies = []
    for joint, link in enumerate(links.reshape(-1, 10), start=1):
        if model.parents[joint] != joint - 1:
            raise ValueError("the arm has branches")
        place, body = model.jointPlacements[joint], pin.Inertia.FromDynamicParameters(link)
        turn, inertia = pin.Quaternion(place.rotation), body.inertia
        axis = np.ravel(model.joints[joint].createData().S)[3:]
        bodies.append(
            f'<body pos="{text(*place.translation)}" quat="{text(turn.w, turn.x, turn.y, turn.z)}">'
            f'<inertial mass="{text(body.mass)}" pos="{text(*body.lever)}" '
            f'fullinertia="{text(*inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]])}"/>'
            f'<joint type="hinge" axis="{text(*axis)}" frictionloss="{text(friction)}" {_HELD}/>'
        )
    return mujoco.MjModel.from_xml_string(
        '<mujoco><compiler angle="radian" balanceinertia="false"/>'
        f'<option timestep="{text(step)}" gravity="{text(*model.gravity.linear)}" integrator="implicitfast" tolerance="1e-12">'
        '<flag contact="disable"/></option><worldbody><body><site name="sensor"/>'
        f"{''.join(bodies)}{'</body>' * len(bodies)}"
        '</body></worldbody><sensor><force site="sensor"/><torque site="sensor"/></sensor></mujoco>'
    )
