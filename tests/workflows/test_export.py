"""An identified robot handed on: code compiled and run, models loaded, against Pinocchio and `predict`."""

from __future__ import annotations

import importlib.util
import json
import math
import re
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path
from types import ModuleType, SimpleNamespace

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import norm

import bayesid
from bayesid.cli import main
from bayesid.dynamics.channels import torque_channels
from bayesid.dynamics.regressors import Kernel
from bayesid.effects import EffectLibrary, JointMotion
from bayesid.effects.segment import direction
from bayesid.results.export.inverse_dynamics import LAWS, JointLaw, inverse_dynamics, source_code
from bayesid.results.export.simulators import mjcf, sdf
from bayesid.robot.robot import load_robot
from bayesid.robot.urdf import JointDynamics, urdf_text
from bayesid.workflows import export as workflow
from bayesid.workflows.demo import PAPER_LOCKED, puma_two_joint_urdf
from tests.robots import ROBOTS, wrist_sensor_arm, write
from tests.simulated import Motion, Sensor, experiment, fourier, puma2, recording

ROTOR = 0.2
EFFECTS = ("viscous_friction", "coulomb_friction", "torque_offset")
MAIN = """
#include "inverse_dynamics.hpp"
#include <cstdio>
int main() {
    constexpr int n = bayesid_model::joints;
    double x[3 * n], torque[n], half[n];
    while (true) {
        for (double& value : x) if (std::scanf("%lf", &value) != 1) return 0;
        bayesid_model::inverse_dynamics(x, x + n, x + 2 * n, torque);
        bayesid_model::half_band(x, x + n, x + 2 * n, half);
        for (double value : torque) std::printf("%.17g ", value);
        for (double value : half) std::printf("%.17g ", value);
        std::printf("\\n");
    }
}
"""
BAND = norm.ppf(0.975)


def arm(folder: Path, name: str, effects=EFFECTS, sensor: Sensor | None = None, **options):
    """A simulated recording of an arm with friction."""
    robot = puma2(folder) if name == "puma2" else load_robot(write(folder, ROBOTS[name]()))
    rng = np.random.default_rng(5)
    viscous, coulomb = rng.uniform(0.5, 2.0, (2, robot.n))
    motions = []
    for seed, role in enumerate(("identification", "validation"), 1):
        motion = fourier(robot, seed, duration=10.0)
        table = recording(robot, sensor, motion, seed=seed, torque_std=0.2, force_std=0.3, resolution=1e-5)
        friction = viscous * motion[2] + coulomb * np.sign(motion[2])
        if "spring@joint1" in effects:
            friction[:, 0] += 12.0 * (motion[1][:, 0] - 0.4)
            friction[:, 1] += 0.1 * np.abs(table.torques[:, 1]) * np.sign(motion[2][:, 1])
        if "rotor_inertia@joint3" in effects:
            friction[:, 2] += ROTOR * motion[3][:, 2]
        motions.append(Motion(role, role, replace(table, torques=table.torques + friction)))
    return experiment(robot, motions, sensor, effects=effects, inertia_rel_std=0.1, **options)


@pytest.fixture(scope="module")
def identified(tmp_path_factory):
    """A six-joint arm with what most models have."""
    return bayesid.identify(arm(tmp_path_factory.mktemp("ur5"), "ur5", (*EFFECTS, "rotor_inertia@joint3")), method="wls")


@pytest.fixture(scope="module")
def curved(tmp_path_factory):
    """Two joints with laws that are not linear, and other joints locked where their angle counts."""
    effects = ("viscous_friction", "coulomb_friction", "spring@joint1", "load_friction@joint2")
    made = arm(tmp_path_factory.mktemp("puma"), "puma2", effects)
    return bayesid.identify(made, method="wls")


def states(robot, count: int = 40, seed: int = 3) -> list[np.ndarray]:
    rng = np.random.default_rng(seed)
    q, v, a = rng.uniform(-3.0, 3.0, (count, robot.n)), rng.normal(size=(count, robot.n)), rng.normal(size=(count, robot.n))
    q[:, robot.prismatic] *= 0.1
    v[0], a[0] = 0.0, 0.0
    v[1] *= 1e-4  # within the ramp of friction
    return [q, v, a]


def run_cpp(folder: Path, header: str, x: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Torques and half bands of the header, compiled with every warning as an error."""
    if shutil.which("g++") is None:
        pytest.skip("no g++ to compile the header with")
    (folder / "inverse_dynamics.hpp").write_text(header, encoding="utf-8")
    (folder / "main.cpp").write_text(MAIN, encoding="utf-8")
    words = ["g++", "-std=c++17", "-O1", "-Wall", "-Wextra", "-Werror", "-pedantic", "main.cpp", "-o", "model"]
    done = subprocess.run(words, cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    lines = "\n".join(" ".join(repr(float(number)) for number in row) for row in np.concatenate(x, axis=1))
    out = subprocess.run([folder / "model"], input=lines, capture_output=True, text=True, check=True).stdout
    rows = np.array([line.split() for line in out.splitlines()], float)
    return rows[:, : x[0].shape[1]], rows[:, x[0].shape[1] :]


def run_numpy(folder: Path, text: str, x: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    path = folder / "exported_model.py"
    path.write_text(text, encoding="utf-8")
    spec = importlib.util.spec_from_file_location("exported_model", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.inverse_dynamics(*x), module.half_band(*x)


RUN = {"cpp": run_cpp, "numpy": run_numpy}
FILE = {"cpp": "inverse_dynamics.hpp", "numpy": "inverse_dynamics.py"}


@pytest.mark.parametrize("form", RUN)
def test_code_gives_the_torques_and_the_band_of_predict(identified, form, tmp_path):
    x = states(identified.problem.experiment.robot)
    expected = identified.predict(*x)
    made = bayesid.export(identified, form)
    torque, half = RUN[form](tmp_path, made[FILE[form]], x)
    size = np.abs(expected.values).max()
    np.testing.assert_allclose(torque, expected.values, rtol=1e-9, atol=1e-9 * size)
    np.testing.assert_allclose(half, BAND * expected.std, rtol=1e-9, atol=1e-12)
    assert not made.left_out[form] and not made.warnings


def test_the_program_of_the_page_compiles(identified, tmp_path):
    page = Path(__file__).parents[2] / "docs" / "howto" / "export.md"
    (code,) = re.findall(r"^```cpp\n(.*?)^```$", page.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    x = [np.zeros((1, 6))] * 3
    torque, half = run_cpp(tmp_path, bayesid.export(identified, "cpp")["inverse_dynamics.hpp"], x)
    (tmp_path / "page.cpp").write_text(code, encoding="utf-8")
    subprocess.run(["g++", "-std=c++17", "-Wall", "-Wextra", "-Werror", "page.cpp", "-o", "page"], cwd=tmp_path, check=True)
    said = subprocess.run([tmp_path / "page"], capture_output=True, text=True, check=True).stdout.splitlines()
    numbers = np.array([re.findall(r"-?\d+\.\d+", line) for line in said], float)
    np.testing.assert_allclose(numbers, np.column_stack([torque[0], half[0]]), atol=1e-6)
    assert said[0].startswith("shoulder_pan_joint ")


@pytest.mark.parametrize("form", RUN)
def test_code_of_both_channels_gives_their_torques(form, tmp_path):
    """Base parameters of wrench and torques together; what is the sensor's own is none of the joints'."""
    made = arm(tmp_path, "puma2", ("viscous_friction", "coulomb_friction", "sensor_offset"), Sensor(translation=[0.0, 0.0, -0.1]))
    result = bayesid.identify(made, channel="both", method="wls")
    x, exported = states(made.robot), bayesid.export(result, [form, "urdf"])
    expected = result.predict(*x)
    torque, half = RUN[form](tmp_path, exported[FILE[form]], x)
    at = [expected.channel_names.index(f"tau{k}") for k in (1, 2)]
    np.testing.assert_allclose(torque, expected.values[:, at], atol=1e-9 * np.abs(torque).max())
    np.testing.assert_allclose(half, BAND * expected.std[:, at], rtol=1e-7, atol=1e-12)
    assert exported.left_out == {form: {}, "urdf": {}}


@pytest.mark.parametrize(
    "name", ["ur10e/before", *(pytest.param(name, marks=pytest.mark.slow) for name in ("kuka-lwr4", "tx40"))]
)
def test_code_of_a_real_arm_predicts_as_the_estimate(name, shared, tmp_path):
    """Frames as makers write them, right angles rounded, offsets that only one of two sums shows."""
    made = bayesid.load_experiment(shared(f"data/{name}"))
    result = bayesid.identify(made, channel="torque", effects=[*EFFECTS, "rotor_inertia"])
    x, exported = states(made.robot), bayesid.export(result, "cpp,numpy,mjcf")
    expected = result.predict(*x)
    for form in RUN:
        torque, half = RUN[form](tmp_path, exported[FILE[form]], x)
        np.testing.assert_allclose(torque, expected.values, rtol=1e-9, atol=1e-9 * np.abs(expected.values).max())
        np.testing.assert_allclose(half, BAND * expected.std, rtol=1e-9, atol=1e-12)
    assert mujoco.MjModel.from_xml_string(exported["identified.xml"]).nv == made.robot.n


def test_friction_of_joints_without_a_torque_is_said_to_be_missing(tmp_path):
    made = arm(tmp_path, "puma2")
    motions = [replace(m, table=replace(m.table, torques=m.table.torques * [1.0, np.nan])) for m in made.motions]
    result = bayesid.identify(replace(made, motions=tuple(motions)), channel="torque", method="wls")
    result.write(tmp_path / "saved")
    for given in (result, tmp_path / "saved"):
        made = bayesid.export(given, "numpy,cpp")
        (said,) = [text for text in made.warnings if "friction" in text]
        assert said.startswith("No torque was read of joint2: ")
        for file in FILE.values():
            assert "Not in it, for their torque was not read: what acts inside joint2.\n" in made[file]


def test_names_are_no_code(identified):
    """A name with quotes, or with a line's end, stays within its comment or its text."""
    robot = identified.problem.experiment.robot
    robot = replace(robot, joint_names=('a"b', *robot.joint_names[1:]))
    found = replace(workflow._found(identified)[0], name='x\n"""\\', robot=robot)
    model = inverse_dynamics(found)
    scope = {}
    exec(source_code("inverse_dynamics.py", found, model), scope)
    assert scope["JOINT_NAMES"][0] == 'a"b'
    header = source_code("inverse_dynamics.hpp", found, model)
    assert header.splitlines()[0].startswith("// Joint torques of x '''', identified") and '{"a\\"b", ' in header


def test_two_robots_stand_in_one_program(identified, curved, tmp_path):
    if shutil.which("g++") is None:
        pytest.skip("no g++ to compile the header with")
    for folder, result in (("left", identified), ("right", curved)):
        bayesid.export(result, "cpp", tmp_path / folder)
    text = """
    #define BAYESID_NAMESPACE left_arm
    #include "left/inverse_dynamics.hpp"
    #define BAYESID_NAMESPACE right_arm
    #include "right/inverse_dynamics.hpp"
    static_assert(left_arm::joints == 6 && right_arm::joints == 2);
    int main() { return 0; }
    """
    (tmp_path / "main.cpp").write_text(text, encoding="utf-8")
    subprocess.run(["g++", "-std=c++17", "-Wall", "-Wextra", "-Werror", "main.cpp", "-o", "two"], cwd=tmp_path, check=True)


@pytest.mark.parametrize("form", RUN)
def test_code_and_mjcf_of_a_link_that_a_sensor_splits(form, tmp_path):
    """The last link is two bodies, the far one in the sensor's frame."""
    robot = load_robot(write(tmp_path, wrist_sensor_arm()), sensor_joint="wrist_ft")
    table = recording(robot, None, fourier(robot, 1, duration=8.0), seed=1, torque_std=0.2, resolution=1e-5)
    made = experiment(robot, [Motion("identification", "identification", table)], Sensor(joint="wrist_ft"))
    result = bayesid.identify(made, channel="torque", effects=[])
    x = states(robot)
    expected, exported = result.predict(*x), bayesid.export(result, [form, "mjcf"])
    torque, half = RUN[form](tmp_path, exported[FILE[form]], x)
    np.testing.assert_allclose(torque, expected.values, rtol=1e-9, atol=1e-9 * np.abs(expected.values).max())
    np.testing.assert_allclose(half, BAND * expected.std, rtol=1e-9, atol=1e-12)
    model = mujoco.MjModel.from_xml_string(exported["identified.xml"])
    masses = dict(zip(robot.body_names, result.link_parameters[::10], strict=True))
    assert model.body("wrist_3_link").mass[0] == pytest.approx(masses["wrist_3_joint"])
    assert model.body("sensor_plate").mass[0] == pytest.approx(masses["wrist_ft"])
    assert model.body("tool").mass[0] == 0.0


@pytest.mark.parametrize("form", RUN)
def test_code_gives_laws_that_are_not_linear(curved, form, tmp_path):
    """The law itself, where `predict` takes it straight from the last step of the fit, which has settled to 1e-4."""
    x = states(curved.problem.experiment.robot)
    expected = curved.predict(*x)
    torque, half = RUN[form](tmp_path, bayesid.export(curved, form)[FILE[form]], x)
    np.testing.assert_allclose(torque, expected.values, atol=1e-4 * np.abs(expected.values).max())
    np.testing.assert_allclose(half, BAND * expected.std, rtol=1e-2)


@pytest.mark.parametrize("name", LAWS)
def test_a_law_is_that_of_its_effect(name):
    """Torque as the class computes it, derivatives as central differences."""
    kind = EffectLibrary().classes[name]
    rng = np.random.default_rng(2)
    q, v, a, load = rng.normal(size=(4, 50))
    values = rng.uniform(0.3, 2.0, len(kind.quantities))
    effect = kind("joint1", 0)
    scope = {name: getattr(np, name) for name in ("abs", "cos", "exp", "sign", "sin")}
    scope |= {"q": q, "v": v, "a": a, "s": direction(v, a, 0.0), "l": load}

    def torque(at, load=load):
        return effect.torque(JointMotion(np.arange(50.0), q, v, a, load, 0.0), at)

    law = JointLaw("", name, 0, tuple(values), tuple(range(len(values))))
    np.testing.assert_allclose(eval(law.torque, scope), torque(values), rtol=1e-13, atol=1e-14)
    assert [column for column, _ in law.derivatives] == list(range(len(values)))
    for (_, text), step in zip(law.derivatives, 1e-6 * np.eye(len(values)), strict=True):
        slope = (torque(values + step) - torque(values - step)) / 2e-6
        np.testing.assert_allclose(eval(text, scope) + np.zeros(50), slope, rtol=1e-7, atol=1e-8)
    slope = (torque(values, load + 1e-6) - torque(values, load - 1e-6)) / 2e-6
    np.testing.assert_allclose(eval(law.per_load or "0.0", scope) + np.zeros(50), slope, rtol=1e-7, atol=1e-8)


def moving(robot) -> list[np.ndarray]:
    """States in which joints slip, away from their limits."""
    q, v, a = states(robot)
    q = np.clip(q, robot.lower + 0.1, robot.upper - 0.1)
    return [q, np.sign(v) * (3.0 + np.abs(v)) + 3.0 * (v == 0.0), a]


def test_mjcf_gives_the_torques_that_the_estimate_predicts(tmp_path):
    """Of an estimate that has links of its own; the offset of the amplifiers is the one effect that MuJoCo has no place for."""
    made = arm(tmp_path, "puma2", (*EFFECTS, "rotor_inertia@joint2"), locked=dict(PAPER_LOCKED))
    result = bayesid.identify(made, method="sdp")
    exported = bayesid.export(result, "mjcf")
    model = mujoco.MjModel.from_xml_string(exported["identified.xml"])
    offset = [exported.left_out["mjcf"][f"torque_offset@joint{k}.offset"][0] for k in (1, 2)]
    assert model.dof_armature[1] > 0.0 and len(exported.left_out["mjcf"]) == 2
    x = moving(made.robot)
    data = mujoco.MjData(model)
    for q, v, a, expected in zip(*x, result.predict(*x).values, strict=True):
        data.qpos[:], data.qvel[:], data.qacc[:] = q, v, a
        mujoco.mj_inverse(model, data)
        np.testing.assert_allclose(data.qfrc_inverse + offset, expected, atol=1e-6 * np.abs(expected).max())


def pinocchio_model(text: str, robot):
    """The URDF with all but the robot's joints locked at zero."""
    whole = pin.buildModelFromXML(text)
    whole.gravity.linear = np.array(robot.gravity)
    return whole


def test_mjcf_has_the_mass_matrix_of_the_links_and_the_torques_of_the_estimate(identified):
    """MuJoCo's inverse dynamics, damping, armature and friction included, against Pinocchio's on identified.urdf."""
    made = bayesid.export(identified, "mjcf,urdf")
    model = mujoco.MjModel.from_xml_string(made["identified.xml"])
    other = pinocchio_model(made["identified.urdf"], identified.problem.experiment.robot)
    data, own = other.createData(), mujoco.MjData(model)
    friction = identified.urdf.dynamics.friction
    rotor = identified.urdf.dynamics.beside["rotor_inertia@joint3.inertia"][0]
    armature = np.array([0.0, 0.0, rotor, 0.0, 0.0, 0.0])
    names = identified.problem.experiment.robot.joint_names
    damping, loss = (np.array([friction.get(n, {}).get(key, 0.0) for n in names]) for key in ("damping", "friction"))
    assert (damping > 0).all() and (loss > 0).all()
    np.testing.assert_array_equal(model.dof_damping, damping)
    np.testing.assert_array_equal(model.dof_frictionloss, loss)
    np.testing.assert_array_equal(model.dof_armature, armature)
    assert rotor == pytest.approx(ROTOR, rel=0.1)
    for q, v, a in zip(*moving(identified.problem.experiment.robot), strict=True):
        own.qpos[:], own.qvel[:], own.qacc[:] = q, v, a
        mujoco.mj_inverse(model, own)
        # Friction is a soft constraint: a joint as light as the last one slips to its full only at high speed. It is taken out.
        expected = pin.rnea(other, data, q, v, a) + damping * v + armature * a
        np.testing.assert_allclose(own.qfrc_inverse + own.qfrc_constraint, expected, atol=1e-8)
    assert {name.split("@")[0] for name in made.left_out["mjcf"]} == {"torque_offset"}
    assert (
        f"<!-- torque_offset@joint2.offset = {made.left_out['mjcf']['torque_offset@joint2.offset'][0]:.6g} N m -->"
        in (made["identified.xml"])
    )
    assert {name.split("@")[0] for name in made.left_out["urdf"]} == {"torque_offset", "rotor_inertia"}


@pytest.mark.parametrize("name", ROBOTS)
def test_every_robot_becomes_an_mjcf_with_pinocchios_mass_matrix(name, tmp_path):
    """Trees, sliding and endless joints, tools behind fixed joints."""
    robot = load_robot(write(tmp_path, ROBOTS[name]()))
    text = mjcf(robot, {}, robot.nominal.ravel(), JointDynamics({}))
    model = mujoco.MjModel.from_xml_string(text)
    assert [model.joint(k).name for k in range(model.njnt)] == [str(n) for n in pin.buildModelFromUrdf(str(robot.urdf)).names[1:]]
    at = [model.joint(n).qposadr[0] for n in robot.joint_names]
    q, v, a = states(robot, 3)
    expected = inverse_of_nominal(robot, q, v, a)
    data = mujoco.MjData(model)
    for k in range(3):
        data.qpos[at], data.qvel[at], data.qacc[at] = q[k], v[k], a[k]
        mujoco.mj_inverse(model, data)
        np.testing.assert_allclose((data.qfrc_inverse + data.qfrc_constraint)[at], expected[k], atol=1e-8)


def inverse_of_nominal(robot, q, v, a):
    return Kernel.of(robot, torque_channels(robot)).dynamics(q, v, a) @ robot.nominal.ravel()


class SdfReader:
    """Reads SDF by its specification alone, into a model of Pinocchio: frames by what they are attached or relative to."""

    def __init__(self, text: str) -> None:
        root = ET.fromstring(text)
        assert (root.tag, root.get("version")) == ("sdf", "1.9")
        self.parts = {str(e.get("name")): e for e in root[0] if e.tag in ("link", "joint", "frame")}
        self.joint_of = {e.findtext("child"): name for name, e in self.parts.items() if e.tag == "joint"}
        self.model, self.anchors = pin.Model(), {"world": (0, pin.SE3.Identity())}
        for name, part in self.parts.items():
            if part.tag == "link":
                self.anchor(name)

    @staticmethod
    def pose(element: ET.Element | None) -> pin.SE3:
        x = np.zeros(6) if element is None else np.array((element.text or "").split(), float)
        return pin.SE3(Rotation.from_euler("xyz", x[3:]).as_matrix(), x[:3])

    def anchor(self, name: str) -> tuple[int, pin.SE3]:
        """Pinocchio's joint that carries a link or frame, and its placement there."""
        if name in self.anchors:
            return self.anchors[name]
        part = self.parts[name]
        if part.tag == "frame":
            joint, placement = self.anchor(str(part.get("attached_to")))
            self.anchors[name] = joint, placement * self.pose(part.find("pose"))
            return self.anchors[name]
        joint_name = self.joint_of[name]
        element = self.parts[joint_name]
        above, placement = self.anchor(str(element.findtext("parent")))
        pose = element.find("pose")
        if pose is not None:
            assert pose.get("relative_to") == element.findtext("parent")
            assert part.find("pose").get("relative_to") == joint_name and part.find("pose").text is None
        placement = placement * self.pose(pose)
        if element.get("type") == "fixed":
            self.anchors[name] = above, placement
        else:
            axis = np.array(element.findtext("axis/xyz").split(), float)
            kind = pin.JointModelPrismaticUnaligned if element.get("type") == "prismatic" else pin.JointModelRevoluteUnaligned
            joint = self.model.addJoint(above, kind(axis / np.linalg.norm(axis)), placement, joint_name)
            self.anchors[name] = joint, pin.SE3.Identity()
        joint, placement = self.anchors[name]
        m, about = float(part.findtext("inertial/mass")), np.zeros((3, 3))
        for (i, j), key in {(0, 0): "ixx", (0, 1): "ixy", (0, 2): "ixz", (1, 1): "iyy", (1, 2): "iyz", (2, 2): "izz"}.items():
            about[i, j] = about[j, i] = float(part.findtext(f"inertial/inertia/{key}") or 0.0)
        body = self.pose(part.find("inertial/pose")).act(pin.Inertia(m, np.zeros(3), about))
        self.model.appendBodyToJoint(joint, placement.act(body), pin.SE3.Identity())
        return self.anchors[name]


@pytest.mark.parametrize("name", ROBOTS)
def test_every_robot_becomes_an_sdf_with_its_torques(name, tmp_path):
    """Read back without any reader of SDF that there is: mass matrix, gravity and Coriolis torques."""
    robot = load_robot(write(tmp_path, ROBOTS[name]()))
    model = SdfReader(sdf(robot, {}, robot.nominal.ravel(), JointDynamics({}))).model
    assert sorted(model.names[1:]) == sorted(robot.joint_names)
    at = [model.joints[model.getJointId(n)].idx_v for n in robot.joint_names]
    q, v, a = states(robot, 3)
    for k, expected in enumerate(inverse_of_nominal(robot, q, v, a)):
        full = np.zeros((3, robot.n))
        full[:, at] = q[k], v[k], a[k]
        np.testing.assert_allclose(pin.rnea(model, model.createData(), *full)[at], expected, atol=1e-9 * np.abs(expected).max())


def test_an_sdf_holds_friction_springs_limits_and_locked_joints(tmp_path):
    robot = puma2(tmp_path)
    beside = {
        "spring@joint2.stiffness": (40.0, "N m/rad"),
        "spring@joint2.rest": (0.3, "rad"),
        "rotor_inertia@joint1.inertia": (1.0, "kg m^2"),
    }
    text = sdf(
        robot, PAPER_LOCKED, robot.nominal.ravel(), JointDynamics({"joint1": {"damping": 2.0, "friction": 3.0}}, (), beside)
    )
    reader = SdfReader(text)
    assert list(reader.model.names[1:]) == ["joint1", "joint2"]
    # What hangs beyond locked joints has its mass in link 2, and is a frame there.
    assert reader.parts["link3"].tag == reader.parts["link6"].tag == "frame" and "joint3" not in reader.parts
    q, v, a = states(robot, 3)
    for k, expected in enumerate(inverse_of_nominal(robot, q, v, a)):
        np.testing.assert_allclose(pin.rnea(reader.model, reader.model.createData(), q[k], v[k], a[k]), expected, atol=1e-9)
    one, two = (reader.parts[name].find("axis/dynamics") for name in ("joint1", "joint2"))
    assert (one.findtext("damping"), one.findtext("friction")) == ("2.0", "3.0")
    assert (two.findtext("spring_stiffness"), two.findtext("spring_reference")) == ("40.0", "0.3")
    assert float(reader.parts["joint1"].findtext("axis/limit/upper")) == robot.upper[0]
    assert "<!-- rotor_inertia@joint1.inertia = 1 kg m^2 -->" in text and "spring@" not in text


def test_names_of_an_sdf_are_all_different_and_none_is_the_worlds(tmp_path):
    """Links and joints share their names there, and ``world`` is the world: the specification since version 1.7."""
    text = SLIDER.replace('"base"', '"world"').replace('"cart"', '"slide"').replace('"arm"', '"fixed_to_world"')
    robot = load_robot(write(tmp_path, text))
    text = sdf(robot, {}, robot.nominal.ravel(), JointDynamics({}))
    names = [str(element.get("name")) for element in ET.fromstring(text)[0] if element.get("name")]
    assert sorted(names) == ["fixed_to_world", "fixed_to_world_joint", "slide", "slide_link", "turn", "world_link"]
    reader, (q, v, a) = SdfReader(text), (x[-1] for x in states(robot, 3))
    found = pin.rnea(reader.model, reader.model.createData(), q, v, a)
    np.testing.assert_allclose(found, inverse_of_nominal(robot, q[None], v[None], a[None])[0], atol=1e-9)


def test_an_sdf_of_a_robot_without_masses_is_refused(tmp_path):
    robot = puma2(tmp_path)
    with pytest.raises(bayesid.InputError, match="robot.urdf: link link1 moves and has no mass, which SDF has no word for"):
        sdf(robot, {}, np.zeros(robot.nominal.size), JointDynamics({}))


BODY = """<inertial><origin xyz="0.1 0 0"/><mass value="2"/>
<inertia ixx="{}" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.03"/></inertial>"""
SLIDER = f"""<robot name="slider">
<link name="base">{BODY.format(1.0)}</link>
<link name="cart">{BODY.format(0.03)}</link>
<link name="arm">{BODY.format(0.03)}</link>
<joint name="slide" type="prismatic"><parent link="base"/><child link="cart"/><axis xyz="0 0 2"/>
<limit lower="0" upper="0" velocity="1" effort="1"/></joint>
<joint name="turn" type="revolute"><parent link="cart"/><child link="arm"/><origin xyz="0.2 0 0" rpy="0.1 {math.pi / 2} 0.2"/>
<axis xyz="0 1 0"/><limit lower="-1" upper="1" velocity="1" effort="1"/></joint>
</robot>"""


@pytest.mark.parametrize("form", [mjcf, sdf])
def test_a_base_that_no_body_can_be_a_slide_without_limits_and_an_upright_frame_are_exported(form, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    robot = load_robot(write(tmp_path, SLIDER), ["slide"], {"turn": 0.3})
    text = form(robot, {"turn": 0.3}, robot.nominal.ravel(), JointDynamics({}))  # warnings are errors: rpy has a pitch of pi / 2
    q, v, a = (x[-1] for x in states(robot, 3))
    expected = inverse_of_nominal(robot, q[None], v[None], a[None])[0]
    if form is sdf:
        reader = SdfReader(text)
        found = pin.rnea(reader.model, reader.model.createData(), q, v, a)
        assert reader.parts["slide"].find("axis/limit/lower") is None and reader.parts["slide"].find("axis/limit/upper") is None
    else:
        model = mujoco.MjModel.from_xml_string(text)
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:], data.qacc[:] = q, v, a
        mujoco.mj_inverse(model, data)
        found = data.qfrc_inverse
        assert not model.jnt_limited.any() and not Path("MUJOCO_LOG.TXT").exists()  # where MuJoCo keeps warnings
    np.testing.assert_allclose(found, expected, atol=1e-9)


def test_springs_and_delays_of_torques_are_mujocos(tmp_path):
    """Read late: a sensor that is late. Read before they act: a motor that acts late; both by the seconds that were found."""
    if not hasattr(mujoco.MjsActuator, "delay"):
        pytest.skip("MuJoCo has delays from 3.5 on")
    robot = puma2(tmp_path)
    beside = {
        "torque_delay@robot.delay": (-0.0073, "s"), "torque_delay@joint2.delay": (0.0133, "s"),
        "spring@joint1.stiffness": (5.0, "N m/rad"), "spring@joint1.rest": (0.2, "rad"),
    }  # fmt: skip
    text = mjcf(robot, PAPER_LOCKED, robot.nominal.ravel(), JointDynamics({}, (), beside))
    assert "<!--" not in text
    model = mujoco.MjModel.from_xml_string(text.replace("</actuator>", '<motor name="other" joint="joint2"/></actuator>'))
    assert [model.actuator(k).name for k in range(model.nu)] == ["joint1", "other"]
    assert (model.joint("joint1").stiffness[0], model.qpos_spring[0]) == (5.0, 0.2)
    data, times, forces, readings = mujoco.MjData(model), [], [], []
    for _ in range(60):
        times.append(data.time)
        data.ctrl[:] = data.time  # a ramp
        mujoco.mj_step(model, data)
        forces.append(data.actuator("joint1").force[0])
        readings.append(data.sensor("joint2_torque").data[0])
    late = np.array(times)[30:, None] - np.column_stack([forces, readings])[30:]
    np.testing.assert_allclose(late, np.tile([0.0073, 0.0060], (30, 1)), atol=1e-12)


def test_locked_joints_stand_still_in_the_mjcf_where_they_were(tmp_path):
    robot = puma2(tmp_path)
    model = mujoco.MjModel.from_xml_string(mjcf(robot, PAPER_LOCKED, robot.nominal.ravel(), JointDynamics({})))
    assert [model.joint(k).name for k in range(model.njnt)] == ["joint1", "joint2"]
    q, v, a = states(robot, 3)
    data = mujoco.MjData(model)
    for k, expected in enumerate(inverse_of_nominal(robot, q, v, a)):
        data.qpos[:], data.qvel[:], data.qacc[:] = q[k], v[k], a[k]
        mujoco.mj_inverse(model, data)
        np.testing.assert_allclose(data.qfrc_inverse + data.qfrc_constraint, expected, atol=1e-8)
    # The last link is where Pinocchio has it, which the masses, all in the link before, would not show.
    whole = pin.buildModelFromUrdf(str(robot.urdf))
    posture = pin.neutral(whole)
    for joint, position in [*PAPER_LOCKED.items(), *zip(robot.joint_names, q[2], strict=True)]:
        posture[whole.joints[whole.getJointId(joint)].idx_q] = position
    there = whole.createData()
    pin.framesForwardKinematics(whole, there, posture)
    last = whole.frames[-1]
    np.testing.assert_allclose(data.body(last.name).xpos, there.oMf[whole.nframes - 1].translation, atol=1e-9)


def test_a_saved_result_gives_the_same_files(identified, tmp_path, capsys):
    identified.write(tmp_path / "run")
    assert main(["export", str(tmp_path / "run"), "--to", "mjcf,urdf,cpp,numpy", "--out", str(tmp_path / "out")]) == 0
    said = capsys.readouterr().out
    direct = bayesid.export(identified, ["mjcf", "urdf", "cpp", "numpy"], tmp_path / "direct")
    for name, text in direct.texts.items():
        assert (tmp_path / "out" / name).read_text(encoding="utf-8") == text == (tmp_path / "direct" / name).read_text("utf-8")
        assert name in said
    document = json.loads((tmp_path / "out" / "export.json").read_text(encoding="utf-8"))
    assert document["not_held"]["mjcf"]["torque_offset@joint1.offset"]["unit"] == "N m"
    assert bayesid.load(tmp_path / "out").to == ["mjcf", "urdf", "cpp", "numpy"]
    assert "torque_offset@joint1.offset" in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")


def test_the_report_of_the_result_itself_is_not_replaced(identified, tmp_path, capsys):
    identified.write(tmp_path)
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    assert main(["export", str(tmp_path), "--to", "urdf", "--out", str(tmp_path)]) == 2
    assert "holds estimate.json, whose report would be replaced; name another folder" in capsys.readouterr().err
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


@pytest.fixture(scope="module")
def posterior(tmp_path_factory):
    return bayesid.sample(arm(tmp_path_factory.mktemp("sampled"), "puma2", ("viscous_friction", "coulomb_friction")), draws=400)


def test_draws_of_a_posterior_load_and_ranges_hold_them(posterior, tmp_path):
    """Twenty robots: masses of the links drawn, friction of the effects; ranges as numpy has them of all draws."""
    posterior.write(tmp_path / "run")
    assert main(["export", str(tmp_path / "run"), "--to", "mjcf,urdf,ranges", "--draws", "20", "--out", str(tmp_path / "o")]) == 0
    files = sorted((tmp_path / "o").glob("sampled-*.xml"))
    assert len(files) == len(sorted((tmp_path / "o").glob("sampled-*.urdf"))) == 20
    models = [mujoco.MjModel.from_xml_path(str(file)) for file in files]
    links = posterior.link_draws.reshape(-1, posterior.link_draws.shape[-1])
    drawn = np.random.default_rng(0).choice(len(links), 20, replace=False)
    children = ["link1", "link2"]
    masses = np.array([[m.body(name).mass[0] for name in children] for m in models])
    np.testing.assert_allclose(masses, links[drawn][:, ::10], rtol=1e-12)
    effects = posterior.effect_draws.reshape(len(links), -1)
    at = posterior.model.effect_names.index("viscous_friction@joint2.coefficient")
    np.testing.assert_allclose([m.dof_damping[1] for m in models], effects[drawn, at])
    ranges = json.loads((tmp_path / "o" / "ranges.json").read_text(encoding="utf-8"))
    assert ranges["draws"] == len(links) and list(ranges["links"]) == children
    mass = ranges["links"]["link2"]["mass"]
    assert [mass["mean"], mass["std"]] == pytest.approx([links[:, 10].mean(), links[:, 10].std(ddof=1)])
    com = ranges["links"]["link2"]["centre_of_mass"][0]
    assert [com["p05"], com["p95"]] == pytest.approx(np.quantile(links[:, 11] / links[:, 10], [0.05, 0.95]))
    damping = ranges["joints"]["joint2"]["damping"]
    assert damping["mean"] == pytest.approx(effects[:, at].mean()) and damping["unit"] == "N m s/rad"
    assert set(ranges["joints"]["joint1"]) == {"damping", "frictionloss"}


def test_code_of_a_posterior_has_the_band_of_its_draws(posterior, tmp_path):
    x = states(posterior.problem.experiment.robot)
    expected = posterior.predict(*x)
    torque, half = run_numpy(tmp_path, bayesid.export(posterior, "numpy")["inverse_dynamics.py"], x)
    np.testing.assert_allclose(torque, expected.values, rtol=1e-9, atol=1e-9 * np.abs(expected.values).max())
    np.testing.assert_allclose(half, BAND * expected.std, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("form", RUN)
def test_code_from_a_base_sensor_gives_the_links_torques(form, tmp_path):
    """The wrench tells the torques of the links, with the band that the base parameters of the wrench give, and no friction."""
    made = arm(tmp_path, "ur5", (), Sensor(translation=[0.0, 0.0, -0.1]))
    result = bayesid.identify(made, channel="wrench", method="wls")
    exported = bayesid.export(result, form)
    x = states(made.robot)
    torque, half = RUN[form](tmp_path, exported[FILE[form]], x)
    matrix = Kernel.of(made.robot, torque_channels(made.robot)).dynamics(*x)
    through = matrix @ np.linalg.pinv(result.base.matrix)  # torques are combinations of what the wrench shows
    np.testing.assert_allclose(torque, through @ result.values, atol=1e-6 * np.abs(torque).max())
    std = np.sqrt(np.einsum("ncp,pq,ncq->nc", through, result.covariance, through))
    np.testing.assert_allclose(half, BAND * std, rtol=1e-4, atol=1e-12)
    assert any("does not feel what acts inside the joints" in w for w in exported.warnings)


def test_what_cannot_be_exported_is_said_in_one_line(identified, tmp_path, monkeypatch, capsys):
    with pytest.raises(bayesid.InputError, match='to="sdf2": choose from mjcf, urdf, sdf, cpp'):
        bayesid.export(identified, "sdf2")
    with pytest.raises(bayesid.InputError, match="draws of links are asked for.*export one of `bayesid.sample`"):
        bayesid.export(identified, "mjcf", draws=3)
    with pytest.raises(bayesid.InputError, match='draws=2: is for to="mjcf" or urdf'):
        bayesid.export(identified, "cpp", draws=2)
    with pytest.raises(bayesid.InputError, match="draws of links"):
        bayesid.export(identified, "ranges")
    assert main(["export", str(tmp_path / "nothing")]) == 2
    assert "holds no result" in capsys.readouterr().err
    bayesid.export(identified, "numpy", tmp_path / "exported")
    assert main(["export", str(tmp_path / "exported")]) == 2
    assert "Exported: cannot be exported; give what `bayesid identify` or `bayesid sample` found" in capsys.readouterr().err
    identified.write(tmp_path / "run")
    document = json.loads((tmp_path / "run" / "estimate.json").read_text(encoding="utf-8"))
    del document["robot"]
    (tmp_path / "run" / "estimate.json").write_text(json.dumps(document), encoding="utf-8")
    assert main(["export", str(tmp_path / "run"), "--out", str(tmp_path / "out")]) == 2
    assert "run it again" in capsys.readouterr().err and not (tmp_path / "out").exists()
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(bayesid.InputError, match=r'not installed; pip install "bayesid\[mujoco\]"'):
        bayesid.export(identified, "mjcf")


def test_a_robot_that_mujoco_sees_otherwise_is_refused(identified, monkeypatch):
    """Were MuJoCo to read other inertias than Pinocchio, the file would not be written."""
    real = mujoco.MjModel.from_xml_string

    def heavier(text: str):
        model = real(text)
        model.body_mass[-1] *= 1.0 + 1e-4
        return model

    class Model:
        from_xml_string = staticmethod(heavier)

    monkeypatch.setattr(mujoco, "MjModel", Model)
    with pytest.raises(bayesid.InputError, match="mass matrices of MuJoCo and Pinocchio differ"):
        bayesid.export(identified, "mjcf")


def test_negative_friction_is_told_and_not_written(identified):
    changed = replace(identified.urdf.dynamics, left_out=("wrist_3_joint friction",))
    told = bayesid.export(replace(identified, urdf=replace(identified.urdf, dynamics=changed)), "mjcf,urdf").warnings
    assert [w.split(":")[0] for w in told] == ["Negative and so not in identified.xml", "Negative and so not in identified.urdf"]


def test_negative_friction_leaves_none_of_the_urdfs_own(tmp_path):
    text = puma_two_joint_urdf().replace("</joint>", '<dynamics damping="9" friction="8"/></joint>')
    robot = load_robot(write(tmp_path, text), ["joint1", "joint2"], PAPER_LOCKED)
    made = urdf_text(robot, robot.nominal, JointDynamics({"joint1": {"friction": 1.0}}, ("joint1 damping",)))
    joints = {joint.get("name"): joint.find("dynamics").attrib for joint in ET.fromstring(made).findall("joint")}
    assert joints["joint1"] == {"friction": "1.0"} and joints["joint2"] == {"damping": "9", "friction": "8"}


def test_a_law_that_has_no_place_is_told(tmp_path):
    """A delay is in the model, and not in the header."""
    made = arm(tmp_path, "puma2", ("viscous_friction", "torque_delay"))
    exported = bayesid.export(bayesid.identify(made), "cpp")
    assert list(exported.left_out["cpp"]) == ["torque_delay@joint1.delay", "torque_delay@joint2.delay"]
    assert "Not in it, though in the model that was identified: torque_delay@joint1" in exported["inverse_dynamics.hpp"]
    assert "not in cpp: torque_delay (2)" in str(exported)


def test_a_rotor_that_no_reading_tells_from_its_link_changes_no_band(tmp_path):
    """About the first axis, which is upright, both are one inertia: torques and bands are those without the rotor."""
    made = arm(tmp_path, "ur5", ("viscous_friction", "coulomb_friction"))
    x = states(made.robot)
    plain = bayesid.identify(made, method="wls").predict(*x)
    result = bayesid.identify(made, method="wls", effects=["viscous_friction", "coulomb_friction", "rotor_inertia@joint1"])
    assert result.estimate.undetermined.sum() == 2
    with_rotor = result.predict(*x)
    np.testing.assert_allclose(with_rotor.values, plain.values, atol=1e-6 * np.abs(plain.values).max())
    np.testing.assert_allclose(with_rotor.std, plain.std, rtol=1e-4, atol=1e-12)
    torque, half = run_numpy(tmp_path, bayesid.export(result, "numpy")["inverse_dynamics.py"], x)
    np.testing.assert_allclose(half, BAND * with_rotor.std, rtol=1e-9, atol=1e-12)


def page_functions() -> dict:
    """What the page's Python blocks define, with nothing of them run but definitions and imports."""
    page = Path(__file__).parents[2] / "docs" / "howto" / "export.md"
    blocks = re.findall(r"^```python\n(.*?)^```$", page.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    scope: dict = {}
    for code in blocks:
        if "def " in code:
            exec(code, scope)
    return scope


class Stand:
    """Stands for a model of MJX: remembers what is replaced in it."""

    def tree_replace(self, values):
        return values


def test_each_environment_of_the_pages_snippet_gets_one_whole_draw(posterior, tmp_path, monkeypatch):
    """With numpy in the place of JAX, which is not installed: what is chosen, and that MuJoCo's models have the fields."""
    bayesid.export(posterior, "mjcf", tmp_path / "for-learning", draws=5)
    monkeypatch.chdir(tmp_path)
    jax = ModuleType("jax")
    jax.numpy = np
    jax.vmap = lambda f: lambda keys: np.array([f(key) for key in keys])
    jax.random = SimpleNamespace(randint=lambda key, shape, low, high: low + key % (high - low))
    jax.tree_util = SimpleNamespace(tree_map=lambda f, model: model)
    monkeypatch.setitem(sys.modules, "jax", jax)
    monkeypatch.setitem(sys.modules, "jax.numpy", np)
    scope = page_functions()
    values, axes = scope["domain_randomize"](Stand(), np.arange(8))
    assert set(values) == set(axes) == set(scope["FIELDS"]) and set(axes.values()) == {0}
    models = [mujoco.MjModel.from_xml_path(path) for path in scope["DRAWS"]]
    assert len(models) == 5
    for field, drawn in values.items():
        np.testing.assert_array_equal(drawn, [getattr(models[k % 5], field) for k in range(8)])


def test_the_pages_terms_for_isaac_lab_hold_the_ranges(posterior, monkeypatch):
    terms, mdp = ModuleType("isaaclab.managers"), ModuleType("isaaclab.envs.mdp")
    terms.EventTermCfg = terms.SceneEntityCfg = lambda *given, **options: (given, options)
    mdp.randomize_rigid_body_mass, mdp.randomize_joint_parameters = "mass", "joint"
    lab, envs = ModuleType("isaaclab"), ModuleType("isaaclab.envs")
    lab.envs, envs.mdp = envs, mdp
    for module in (lab, envs, mdp, terms):
        monkeypatch.setitem(sys.modules, module.__name__, module)
    ranges = json.loads(bayesid.export(posterior, "ranges")["ranges.json"])
    made = page_functions()["events"](ranges)
    assert set(made) == {"mass_of_link1", "mass_of_link2", "inside_joint1", "inside_joint2"}
    mass, friction = made["mass_of_link2"][1], made["inside_joint1"][1]
    assert mass["func"] == "mass" and friction["func"] == "joint"
    entry = ranges["links"]["link2"]["mass"]
    assert mass["params"]["mass_distribution_params"] == (entry["p05"], entry["p95"])
    entry = ranges["joints"]["joint1"]["frictionloss"]
    assert friction["params"]["friction_distribution_params"] == (entry["p05"], entry["p95"])
