"""Robots in MuJoCo's own format: the same masses, gravity and joints as MuJoCo has, and one line where there is none."""

from __future__ import annotations

import pickle
import sys
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import bayesid
from bayesid.dynamics.channels import torque_channels
from bayesid.dynamics.regressors import Kernel
from bayesid.recordings.robot_section import with_stated_effects
from bayesid.results.export.simulators import mjcf
from bayesid.robot.mjcf import read_mjcf
from bayesid.robot.robot import load_robot
from bayesid.robot.urdf import JointDynamics
from tests.robots import ROBOTS, write

mujoco = pytest.importorskip("mujoco")

#: Everything that a reader of its own would get wrong: defaults, degrees, another order of Euler angles, limits that switch
#: themselves on, inertias of shapes, a joint whose zero is not where the file draws it, one off the body's origin, two joints in
#: one body, bodies welded to others, one of them to the world, names left out.
ODD = """<mujoco model="odd">
  <compiler angle="degree" eulerseq="zyx" autolimits="true"/>
  <default>
    <joint damping="0.4" armature="0.02"/>
    <default class="light"><joint damping="0" frictionloss="0.3" axis="0 1 0"/><geom density="500"/></default>
  </default>
  <worldbody>
    <body name="pedestal" pos="0.1 0 0.2"><geom type="box" size="0.1 0.1 0.1"/>
      <body name="shoulder" pos="0 0.1 0.2" euler="30 -20 10">
        <joint name="pan" axis="0 0 1" range="-170 170" ref="25"/>
        <geom type="capsule" fromto="0 0 0 0.1 0 0.4" size="0.05"/>
        <body name="tool_plate" pos="0.1 0.02 0.4" quat="1 1 0 0"><geom type="cylinder" size="0.04 0.02"/></body>
        <body name="elbow" pos="0.1 0 0.4" childclass="light" euler="0 90 0">
          <joint name="lift" pos="0 0.03 -0.02" ref="-15"/>
          <joint name="twist" pos="0.02 0 0.1" axis="1 2 3"/>
          <inertial pos="0.02 -0.01 0.2" mass="1.5" fullinertia="0.03 0.025 0.01 0.002 -0.001 0.003"/>
          <body pos="0 0 0.3" axisangle="0 0 1 40">
            <joint type="slide" axis="1 0 1" range="-0.2 0.1" ref="0.05" stiffness="120" springref="0.02"
              actuatorfrcrange="-9 9"/>
            <geom type="ellipsoid" size="0.03 0.05 0.08"/>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>"""


def written(folder: Path, text: str, name: str = "robot.xml") -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def states(n: int, count: int = 5) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(3)
    return rng.uniform(-1.0, 1.0, (count, n)), rng.normal(size=(count, n)), rng.normal(size=(count, n))


def rigid_torques(model, q, v, a) -> np.ndarray:
    """MuJoCo's inverse dynamics without limits, springs, friction and armature."""
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT) | int(mujoco.mjtDisableBit.mjDSBL_SPRING)
    model.dof_damping[:] = model.dof_frictionloss[:] = model.dof_armature[:] = model.jnt_stiffness[:] = 0.0
    data, out = mujoco.MjData(model), []
    for row in zip(q, v, a, strict=True):
        data.qpos[:], data.qvel[:], data.qacc[:] = row
        mujoco.mj_inverse(model, data)
        out.append(data.qfrc_inverse.copy())
    return np.array(out)


def test_an_odd_robot_has_mujocos_torques(tmp_path):
    path = written(tmp_path, ODD)
    robot, model = load_robot(path), mujoco.MjModel.from_xml_path(str(path))
    assert robot.joint_names == ("pan", "lift", "twist", "body_joint3") and robot.prismatic.tolist() == [False] * 3 + [True]
    assert robot.name == "odd" and len(robot.nominal) == 4
    np.testing.assert_allclose(robot.lower, [-np.radians(170), -np.inf, -np.inf, -0.2])
    np.testing.assert_allclose(robot.effort_limit, [np.inf] * 3 + [9.0])
    x = states(4)
    regressor = Kernel.of(robot, torque_channels(robot)).dynamics(*x)
    np.testing.assert_allclose(regressor @ robot.nominal.ravel(), rigid_torques(model, *x), atol=1e-9)
    # The welded plate is in the link that carries it, the pedestal under the whole robot.
    assert robot.nominal[0, 0] == pytest.approx(model.body("shoulder").mass[0] + model.body("tool_plate").mass[0])
    assert robot.static_nominal[0] == pytest.approx(model.body("pedestal").mass[0])
    # Where the last body is.
    data, other = mujoco.MjData(model), pin.buildModelFromXML(robot.description.text)
    data.qpos[:] = x[0][0]
    mujoco.mj_kinematics(model, data)
    placed, q = other.createData(), pin.integrate(other, pin.neutral(other), x[0][0])
    pin.framesForwardKinematics(other, placed, q)
    frame = other.getFrameId("tool_plate")
    np.testing.assert_allclose(placed.oMf[frame].translation, data.body("tool_plate").xpos, atol=1e-12)
    np.testing.assert_allclose(placed.oMf[frame].rotation.ravel(), data.body("tool_plate").xmat, atol=1e-12)


@pytest.mark.parametrize("name", ROBOTS)
def test_a_robot_comes_back_from_its_export(name, tmp_path):
    """The writer of this package makes MJCF of a URDF; read again, it has the same joints and inertial parameters."""
    robot = load_robot(write(tmp_path, ROBOTS[name]()))
    text = mjcf(robot, {}, robot.nominal.ravel(), JointDynamics({}))
    back = load_robot(written(tmp_path, text, "back.xml"), robot.joint_names)
    x = states(robot.n)
    expected = Kernel.of(robot, torque_channels(robot)).dynamics(*x) @ robot.nominal.ravel()
    there = Kernel.of(back, torque_channels(back)).dynamics(*x) @ back.nominal.ravel()
    np.testing.assert_allclose(there, expected, atol=1e-9 * np.abs(expected).max())
    limits = [np.nan_to_num(r.lower, neginf=-9.0) for r in (robot, back)]
    np.testing.assert_allclose(limits[0], limits[1])


def test_a_turntable_whose_bias_forces_are_rounding_alone_is_read_and_exported(tmp_path):
    inside = '<joint name="turn" axis="0 0 1"/><geom type="box" size="0.1 0.2 0.3" pos="0.2 0.1 0" euler="20 30 40"/>'
    path = tmp_path / "table.xml"
    path.write_text(f'<mujoco><worldbody><body name="table" euler="0 0 50">{inside}</body></worldbody></mujoco>')
    robot = load_robot(path)
    model = mujoco.MjModel.from_xml_string(mjcf(robot, {}, robot.nominal.ravel(), JointDynamics({})))
    assert model.dof_M0[0] == pytest.approx(robot.nominal[0, -1], rel=1e-12)


def test_what_is_inside_joints_becomes_effects_of_the_model(tmp_path):
    path = written(tmp_path, ODD)
    robot = load_robot(path, ["twist", "pan", "body_joint3"])
    assert robot.description.inside["body_joint3"] == {
        "frictionloss": 0.3, "armature": 0.02, "stiffness": 120.0, "springref": 0.02,
    }  # fmt: skip
    effects, values = with_stated_effects(robot)
    assert effects == (
        "viscous_friction@joint2", "coulomb_friction@joint1", "coulomb_friction@joint3", "rotor_inertia@joint1",
        "rotor_inertia@joint2", "rotor_inertia@joint3", "spring@joint3",
    )  # fmt: skip
    assert values["viscous_friction@joint2"] == {"coefficient": 0.4}
    assert values["spring@joint3"] == {"stiffness": 120.0, "rest": 0.02}
    # What the user states goes before; effects that are not listed bring no values.
    stated = {"rotor_inertia@pan": {"inertia": 0.05, "fixed": True}}
    effects, values = with_stated_effects(robot, ["rotor_inertia"], stated)
    assert effects == ("rotor_inertia",)
    assert values == {**stated, "rotor_inertia@joint1": {"inertia": 0.02}, "rotor_inertia@joint3": {"inertia": 0.02}}


def test_motors_limit_efforts_by_their_gears(tmp_path):
    more = '<motor joint="pan" gear="10" forcerange="-2 3"/><motor joint="body_joint3" forcerange="-40 40"/>'
    text = ODD.replace("</mujoco>", f"<actuator>{more}</actuator></mujoco>").replace(
        '<joint type="slide"', '<joint name="body_joint3" type="slide"'
    )
    np.testing.assert_allclose(load_robot(written(tmp_path, text)).effort_limit, [30.0, np.inf, np.inf, 9.0])


def test_armature_and_damping_of_motors_count_with_their_gears(tmp_path):
    text = ODD.replace("</mujoco>", '<actuator><motor joint="pan" gear="10" armature="0.01" damping="0.02"/></actuator></mujoco>')
    path = written(tmp_path, text)
    if not hasattr(mujoco.MjModel.from_xml_string(ODD), "actuator_armature"):
        pytest.skip("motors have neither before MuJoCo 4")
    inside = load_robot(path).description.inside["pan"]
    assert inside == {"damping": pytest.approx(2.4), "armature": pytest.approx(1.02)}


ARM = """<mujoco model="arm"><compiler angle="radian"/><worldbody>
  <body name="upper" pos="0 0 0.4"><joint name="a" axis="0 1 0" damping="0.7" frictionloss="0.4" armature="0.05" ref="0.3"/>
    <geom type="capsule" fromto="0 0 0 0 0.02 0.4" size="0.05"/>
    <body name="fore" pos="0 0.02 0.4"><joint name="b" axis="1 0 0" damping="0.2" armature="0.03"/>
      <geom type="capsule" fromto="0 0 0 0.1 0 0.3" size="0.04"/></body>
  </body></worldbody></mujoco>"""


def recording(text: str) -> dict[str, np.ndarray]:
    """A motion of a robot with MuJoCo's own torques, friction included."""
    model = mujoco.MjModel.from_xml_string(text)
    t = np.arange(0.0, 10.0, 0.005)
    amplitude, rate, phase = np.array([0.7, 0.9]), np.array([1.9, 2.7]), np.array([0.2, 1.1])
    angle = t[:, None] * rate + phase
    q, v, a = amplitude * np.sin(angle), amplitude * rate * np.cos(angle), -amplitude * rate**2 * np.sin(angle)
    inside = model.dof_damping * v + model.dof_frictionloss * np.sign(v) + model.dof_armature * a
    noise = 0.01 * np.random.default_rng(0).normal(size=q.shape)
    return dict(t=t, q=q, torques=rigid_torques(model, q, v, a) + inside + noise)


def test_the_friction_of_an_mjcf_is_identified_without_being_asked_for(tmp_path):
    path = written(tmp_path, ARM)
    experiment = bayesid.Experiment.from_arrays(path, **recording(ARM))
    assert {e.partition("@")[0] for e in experiment.effects} == {"viscous_friction", "coulomb_friction", "rotor_inertia"}
    result = bayesid.identify(experiment, method="wls", progress=None)
    found = {(e["name"], e["where"]): next(iter(e["parameters"].values()))["value"] for e in result.effects()}
    assert found["viscous_friction", "joint1"] == pytest.approx(0.7, abs=0.02)
    assert found["coulomb_friction", "joint1"] == pytest.approx(0.4, abs=0.02)
    folder = tmp_path / "folder"
    bayesid.write_experiment(experiment, folder)
    again = bayesid.load_experiment(folder)
    assert (again.effects, again.effect_values) == (experiment.effects, experiment.effect_values)
    np.testing.assert_allclose(again.robot.nominal, experiment.robot.nominal)


def test_an_experiment_folder_names_an_mjcf_or_leaves_its_friction_out(tmp_path):
    bayesid.write_experiment(bayesid.Experiment.from_arrays(written(tmp_path, ARM), **recording(ARM)), tmp_path / "arm")
    written(tmp_path / "arm", ARM)
    toml = tmp_path / "arm" / "experiment.toml"
    text = toml.read_text(encoding="utf-8").replace("robot.urdf", "robot.xml")
    model = text[text.index("[model]") : text.index("[[motion]]")]
    toml.write_text(text.replace(model, ""), encoding="utf-8")
    experiment = bayesid.load_experiment(tmp_path / "arm")
    assert experiment.robot.urdf.name == "robot.xml" and len(experiment.effects) == 5
    toml.write_text(text.replace(model, "[model]\neffects = []\n"), encoding="utf-8")
    assert bayesid.load_experiment(tmp_path / "arm").effects == ()
    # Copies in other processes need neither the file nor MuJoCo.
    copy = pickle.loads(pickle.dumps(experiment.robot))
    assert copy.fingerprint == experiment.robot.fingerprint and copy.description == experiment.robot.description


def test_a_file_without_its_meshes_is_read_where_they_only_draw(tmp_path):
    mesh = '<asset><mesh name="m" file="there_is_none.stl"/></asset><worldbody><geom type="plane" size="1 1 1"/>'
    inertial = '<inertial pos="0 0 0.1" mass="2" diaginertia="0.1 0.1 0.1"/>'
    body = '<body name="one"><joint name="a" axis="0 1 0"/>{}<geom type="mesh" mesh="m"/></body></worldbody></mujoco>'
    path = written(tmp_path, "<mujoco>" + mesh + body.format(inertial))
    assert load_robot(path).nominal[0, 0] == 2.0
    base = '<body name="base"><geom type="mesh" mesh="m"/>' + body.format(inertial).replace("</body>", "</body></body>")
    assert load_robot(written(tmp_path, "<mujoco>" + mesh + base)).nominal[0, 0] == 2.0  # what is fixed to the world states none
    path = written(tmp_path, "<mujoco>" + mesh + body.format(""))
    with pytest.raises(bayesid.InputError, match=r"robot.xml: MuJoCo does not read it \(.*there_is_none.stl"):
        load_robot(path)


WRONG = {
    "joint root is free, so that the robot floats": ODD.replace('0.2"><geom', '0.2"><freejoint name="root"/><geom', 1),
    "joint socket is a ball": ODD.replace(
        '<joint name="pan" axis="0 0 1" range="-170 170" ref="25"/>', '<joint name="socket" type="ball"/>'
    ),
    r"equality tie \(connect\) closes a loop": ODD.replace(
        "</mujoco>", '<equality><connect name="tie" body1="shoulder" body2="elbow" anchor="0 0 0"/></equality></mujoco>'
    ),
    r"MuJoCo does not read it \(.*": ODD.replace('type="slide"', 'type="screw"'),
    "the mass matrices of MuJoCo and Pinocchio differ by .*tendons or actuators": ODD.replace(
        "</mujoco>",
        '<tendon><fixed armature="0.5"><joint joint="pan" coef="1"/><joint joint="lift" coef="2"/></fixed></tendon></mujoco>',
    ),
}


@pytest.mark.parametrize("said", WRONG)
def test_what_is_no_robot_here_is_said_in_one_line(said, tmp_path):
    with pytest.raises(bayesid.InputError, match=said) as error:
        load_robot(written(tmp_path, WRONG[said]))
    assert "\n" not in str(error.value) and str(error.value).startswith("robot.xml")


def test_what_is_left_out_is_told(tmp_path):
    more = (
        '<tendon><fixed name="t" stiffness="3"><joint joint="pan" coef="1"/></fixed></tendon>'
        '<equality><joint joint1="lift" joint2="twist"/><joint joint1="pan"/></equality></mujoco>'
    )
    text = ODD.replace("<default>", '<option gravity="0 0 -1.62"/><default>', 1).replace("</mujoco>", more)
    text = text.replace('<body name="elbow"', '<body name="elbow" gravcomp="1"').replace('damping="0.4"', 'damping="0.4 0.1"')
    file = load_robot(written(tmp_path, text)).description
    assert [text.removeprefix("robot.xml: ").split(",")[0].split(" is ")[0] for text in file.warnings] == [
        "its gravity", "gravcomp", "damping or stiffness that", "springs and friction of tendons are left out; state an effect "
        "of your own for them", "joint pan",
    ]  # fmt: skip
    assert file.joints["lift"].mimics == "twist"


def test_without_mujoco_the_message_says_what_to_install(tmp_path, monkeypatch):
    path = written(tmp_path, ODD)
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(bayesid.InputError, match=r'pip install "bayesid\[mujoco\]"'):
        load_robot(path)


def test_placements_at_right_angles_lose_no_digit(tmp_path):
    """URDF states roll, pitch and yaw, which are not unique at a pitch of 90 degrees."""
    for euler in ("0 90 0", "40 90 -20", "13 -90 70", "180 90 180"):
        text = f"""<mujoco><worldbody><body name="b" pos="0.1 0.2 0.3" euler="{euler}"><joint name="j" axis="0 0 1"/>
            <inertial pos="0.1 0 0.2" mass="1" diaginertia="0.02 0.03 0.04"/></body></worldbody></mujoco>"""
        robot = read_mjcf(written(tmp_path, text))
        origin = robot.root.find("joint/origin")
        assert origin is not None
        turn = pin.rpy.rpyToMatrix(*map(float, origin.get("rpy", "").split()))
        expected = np.zeros(9)
        mujoco.mju_quat2Mat(expected, robot.model.body("b").quat)
        np.testing.assert_allclose(turn.ravel(), expected, atol=1e-14)
