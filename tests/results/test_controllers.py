"""Every controller's format, read back by a reader of its own and compared as a body that Pinocchio knows."""

from __future__ import annotations

import ast
import json
import re

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bayesid.errors import InputError
from bayesid.results.controllers import FORMATS, Load, principal_axes

TURN = pin.rpy.rpyToMatrix(0.3, -0.5, 0.8)
LOAD = Load(
    1.2345678, np.array([0.0123456, -0.02, 0.0654321]), TURN @ np.diag([0.003, 0.005, 0.006]) @ TURN.T, "tool0", "base_link",
    np.array([0.0, 0.0, -9.81]), "ft_frame", np.array([0.01, -0.02, 0.05]), np.array([1.0, -2.0, 3.0, 0.1, -0.2, 0.3]),
)  # fmt: skip


def arguments(text: str) -> tuple[str, list]:
    """Name and arguments of the one call in a line of Python or URScript."""
    call = ast.parse(text).body[0].value
    return ast.unparse(call.func), [ast.literal_eval(a) for a in call.args]


def yaml(text: str) -> dict:
    """Nested mappings of numbers, lists, booleans and words by their indentation: YAML as far as it is written here."""
    root: dict = {}
    levels = [(-1, root)]
    for line in text.splitlines():
        key, _, value = line.strip().partition(":")
        depth = len(line) - len(line.lstrip())
        while levels[-1][0] >= depth:
            levels.pop()
        if value.strip():
            word = value.strip()
            known = {"true": True, "false": False}
            number = re.fullmatch(r"\[.*\]|-?\d+(\.\d+)?", word)
            levels[-1][1][key] = ast.literal_eval(word) if number else known.get(word, word)
        else:
            levels[-1][1][key] = {}
            levels.append((depth, levels[-1][1][key]))
    return root


def weight_of(mass: float, centre, attitude: np.ndarray) -> np.ndarray:
    """Force and moment that hold a body at rest in a frame of some attitude."""
    force = -mass * attitude.T @ LOAD.gravity
    return np.concatenate([force, np.cross(centre, force)])


def test_universal_robots():
    name, (mass, centre, moments) = arguments(FORMATS["ur"].write(LOAD))
    assert name == "set_target_payload"
    xx, yy, zz, xy, xz, yz = moments
    body = pin.Inertia(mass, np.array(centre), np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))
    assert body.isApprox(pin.Inertia(LOAD.mass, LOAD.centre, LOAD.inertia), 1e-3)
    assert len(arguments(FORMATS["ur"].write(Load(1.0, np.zeros(3), None, "tool0", "base", LOAD.gravity)))[1]) == 2


def test_franka():
    told = json.loads(FORMATS["franka"].write(LOAD))
    assert set(told) == {"id", "name", "mass", "centerOfMass", "inertia", "transformation"}
    body = pin.Inertia(told["mass"], np.array(told["centerOfMass"]), np.array(told["inertia"]).reshape(3, 3, order="F"))
    assert body.isApprox(pin.Inertia(LOAD.mass, LOAD.centre, LOAD.inertia), 1e-3)
    np.testing.assert_array_equal(np.array(told["transformation"]).reshape(4, 4, order="F"), np.eye(4))


def test_kuka():
    numbers = dict(re.findall(r"\b([MXYZABC]) (-?[\d.]+)", FORMATS["kuka"].write(LOAD).partition(",J")[0]))
    x = {k: float(v) for k, v in numbers.items()}
    moments = [float(v) for v in re.findall(r"[XYZ] (-?[\d.]+)", FORMATS["kuka"].write(LOAD).partition(",J")[2])]
    a, b, c = np.radians([x["A"], x["B"], x["C"]])
    axes = pin.utils.rotate("z", a) @ pin.utils.rotate("y", b) @ pin.utils.rotate("x", c)
    body = pin.Inertia(x["M"], 1e-3 * np.array([x["X"], x["Y"], x["Z"]]), axes @ np.diag(moments) @ axes.T)
    assert body.isApprox(pin.Inertia(LOAD.mass, LOAD.centre, LOAD.inertia), 1e-3)
    point = FORMATS["kuka"].write(Load(0.5, np.zeros(3), None, "tool0", "base", LOAD.gravity))
    assert "A 0.0000,B 0.0000,C 0.0000},J {X 0.000000,Y 0.000000,Z 0.000000}" in point


def test_xarm():
    name, (mass, centre) = arguments(FORMATS["xarm"].write(LOAD))
    assert name == "arm.set_tcp_load" and mass == pytest.approx(LOAD.mass, abs=1e-4)
    np.testing.assert_allclose(centre, 1e3 * LOAD.centre, atol=1e-3)


def test_gravity_compensation_in_ros():
    """What each of the three takes away is the body's weight, at any attitude of the sensor."""
    one, two, three = (yaml(FORMATS[name].write(LOAD)) for name in ("ros", "ros2", "admittance"))
    np.testing.assert_allclose(one["bias"], LOAD.offset)
    assert one["gripper_com_frame_id"] == two["sensor_frame"] == three["gravity_compensation"]["frame"]["id"] == "ft_frame"
    assert one["gripper_com_pose"][3:] == [0.0, 0.0, 0.0] and two["world_frame"] == "base_link"
    assert three["gravity_compensation"]["frame"]["external"] is False
    np.testing.assert_allclose(two["tool"]["gravity_field"], LOAD.gravity)
    told = [
        (one["gripper_mass"], one["gripper_com_pose"][:3]),
        (two["tool"]["mass"], two["tool"]["pos"]),
        (three["gravity_compensation"]["CoG"]["force"] / 9.81, three["gravity_compensation"]["CoG"]["pos"]),
    ]
    for mass, centre in told:
        np.testing.assert_allclose(weight_of(mass, centre, TURN), weight_of(LOAD.mass, LOAD.centre_in_sensor, TURN), atol=1e-4)


def test_without_a_sensor_there_is_nothing_to_compensate():
    for name in ("ros", "ros2", "admittance"):
        with pytest.raises(InputError, match="no force/torque sensor carries this payload"):
            FORMATS[name].write(Load(1.0, np.zeros(3), None, "tool0", "base", LOAD.gravity))


@given(st.lists(st.floats(-3.0, 3.0), min_size=3, max_size=3), st.lists(st.floats(1e-4, 1.0), min_size=3, max_size=3))
def test_principal_axes_are_the_inertia_again(angles, moments):
    turn = pin.rpy.rpyToMatrix(*angles)
    whole = turn @ np.diag(moments) @ turn.T
    found, degrees = principal_axes(whole)
    a, b, c = np.radians(degrees)
    axes = pin.utils.rotate("z", a) @ pin.utils.rotate("y", b) @ pin.utils.rotate("x", c)
    np.testing.assert_allclose(axes @ np.diag(found) @ axes.T, whole, atol=1e-9)
