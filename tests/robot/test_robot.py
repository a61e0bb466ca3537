"""load_robot against Pinocchio: merged and split links, joint order, limits, messages."""

import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from bayesid.errors import InputError
from bayesid.robot import inertia
from bayesid.robot.robot import load_robot
from bayesid.robot.urdf import write_urdf
from tests.robots import ROBOTS, write


@pytest.fixture
def tree(tmp_path):
    return write(tmp_path, ROBOTS["tree"]())


@pytest.fixture
def wrist(tmp_path):
    return write(tmp_path, ROBOTS["wrist_sensor_arm"]())


def parameters(model, name):
    return np.asarray(model.inertias[model.getJointId(name)].toDynamicParameters())


@pytest.mark.parametrize("name", ROBOTS)
def test_plain_robot_is_the_urdf(name, tmp_path):
    path = write(tmp_path, ROBOTS[name]())
    robot, model = load_robot(path), pin.buildModelFromUrdf(str(path))
    assert robot.joint_names == tuple(model.names)[1:] == robot.body_names
    assert robot.name == model.name and robot.urdf == path
    for i, joint in enumerate(robot.joint_names):
        np.testing.assert_allclose(robot.nominal[i], parameters(model, joint), atol=1e-14)
        np.testing.assert_allclose(robot.rotation[i], model.jointPlacements[i + 1].rotation, atol=1e-14)
        np.testing.assert_allclose(robot.translation[i], model.jointPlacements[i + 1].translation, atol=1e-14)
        assert robot.parent[i] == model.parents[i + 1] - 1
    np.testing.assert_allclose(robot.static_nominal, model.inertias[0].toDynamicParameters(), atol=1e-14)
    np.testing.assert_allclose(np.linalg.norm(robot.axis, axis=1), 1.0)
    assert robot.sensor_parent == -1 and robot.sensor_bodies.all()
    assert len(robot.parameter_names) == len(robot.parameter_units) == 10 * robot.n
    assert not robot.nominal.flags.writeable


@pytest.mark.parametrize("locked", [
    {"left_extension": 0.2}, {"waist": 0.4, "left_wrist": -2.5}, {"left_shoulder_joint": 1.0, "right_elbow_joint": 0.3},
    {"waist": -0.3, "right_shoulder_joint": 0.9},
])  # fmt: skip
def test_locked_joints_merge_their_links(tree, locked):
    model = pin.buildModelFromUrdf(str(tree))
    reference = pin.neutral(model)
    for name, x in locked.items():
        joint = model.joints[model.getJointId(name)]
        reference[joint.idx_q : joint.idx_q + joint.nq] = x if joint.nq == 1 else (np.cos(x), np.sin(x))
    reduced = pin.buildReducedModel(model, [model.getJointId(name) for name in locked], reference)
    moving = [name for name in list(reduced.names)[1:]]
    robot = load_robot(tree, moving[::-1], locked)  # another order than the URDF's
    assert robot.joint_names == tuple(moving[::-1])
    for i, name in enumerate(robot.joint_names):
        j = reduced.getJointId(name)
        np.testing.assert_allclose(robot.nominal[i], parameters(reduced, name), atol=1e-13)
        np.testing.assert_allclose(robot.rotation[i], reduced.jointPlacements[j].rotation, atol=1e-14)
        np.testing.assert_allclose(robot.translation[i], reduced.jointPlacements[j].translation, atol=1e-14)
        up = reduced.parents[j]
        assert robot.parent[i] == (-1 if up == 0 else robot.joint_names.index(reduced.names[up]))
    np.testing.assert_allclose(robot.static_nominal, reduced.inertias[0].toDynamicParameters(), atol=1e-13)


def test_order_and_reach_of_a_tree(tree):
    names = load_robot(tree).joint_names
    robot = load_robot(tree, names[::-1])
    place = np.argsort(robot.order)
    assert all(up < 0 or place[up] < place[i] for i, up in enumerate(robot.parent))
    reach = robot.moves_with
    waist, left, right = (robot.joint_names.index(n) for n in ("waist", "left_wrist", "right_elbow_joint"))
    assert reach[waist].all() and not reach[right, left] and reach[left].sum() == 1


def test_unlisted_joints_lock_at_zero(tree):
    assert np.array_equal(load_robot(tree, ["waist"]).nominal, load_robot(tree, ["waist"], {"left_wrist": 0.0}).nominal)


def test_kinds_and_limits(tree):
    robot = load_robot(tree)
    wrist, slide = robot.joint_names.index("left_wrist"), robot.joint_names.index("left_extension")
    assert robot.prismatic.tolist() == [i == slide for i in range(robot.n)]
    assert robot.lower[wrist] == -np.inf and robot.upper[wrist] == np.inf  # continuous
    assert (robot.velocity_limit[wrist], robot.effort_limit[wrist]) == (5.0, 20.0)
    assert (robot.lower[slide], robot.upper[slide]) == (0.0, 0.3)
    np.testing.assert_allclose(robot.axis[wrist], [0, 0, 1], atol=1e-15)
    np.testing.assert_allclose(robot.axis[robot.joint_names.index("right_shoulder_joint")], [0, 0.6, 0.8], atol=1e-15)


def test_sensor_splits_its_link(wrist):
    whole, split = load_robot(wrist), load_robot(wrist, sensor_joint="wrist_ft")
    last = split.sensor_parent
    assert last == whole.n - 1 and split.body_names == (*whole.body_names, "wrist_ft")
    assert split.sensor_bodies.tolist() == [False] * whole.n + [True]
    assert split.body_joint.tolist() == [*range(whole.n), last]
    far = inertia.transform(split.nominal[-1], split.body_rotation[-1], split.body_translation[-1])
    np.testing.assert_allclose(split.nominal[last] + far, whole.nominal[last], atol=1e-13)
    np.testing.assert_array_equal(split.nominal[:last], whole.nominal[:last])
    assert split.nominal[-1, 0] == pytest.approx(0.35 + 1.4)
    assert inertia.is_physically_consistent(split.nominal).all()
    # In the sensor joint's frame the plate lies where the URDF puts it; the tool is the rest.
    model = pin.buildModelFromUrdf(str(wrist))
    frame = model.frames[model.getFrameId("wrist_ft", pin.FrameType.FIXED_JOINT)]
    np.testing.assert_allclose(split.sensor_translation, frame.placement.translation, atol=1e-14)
    np.testing.assert_allclose(split.sensor_rotation, frame.placement.rotation, atol=1e-14)
    tool = load_robot(wrist, sensor_joint="tool_mount").nominal[-1]
    mount = model.frames[model.getFrameId("tool_mount", pin.FrameType.FIXED_JOINT)]
    between = frame.placement.inverse() * mount.placement
    plate = split.nominal[-1] - inertia.transform(tool, between.rotation, between.translation)
    mass, com, _ = inertia.to_mass_com_inertia(plate)
    assert mass == pytest.approx(0.35)
    np.testing.assert_allclose(com, [0.002, -0.001, 0.012], atol=1e-13)
    assert not split.static_nominal.any()


def test_sensor_in_a_moving_joint_splits_nothing(wrist):
    robot = load_robot(wrist, sensor_joint=load_robot(wrist).joint_names[3])
    assert robot.sensor_parent == 3 and len(robot.body_names) == robot.n
    assert robot.sensor_bodies.tolist() == [False] * 3 + [True] * 3


def test_sensor_in_a_locked_joint_of_the_root(tree):
    robot = load_robot(tree, ["right_elbow_joint", "left_wrist"], {"waist": 0.5}, sensor_joint="waist")
    assert robot.sensor_parent == -1 and robot.sensor_bodies.tolist() == [True, True]
    pelvis = 12.0
    assert robot.static_nominal[0] + pelvis == pytest.approx(load_robot(tree, robot.joint_names).static_nominal[0])


@pytest.mark.parametrize("arguments, words", [
    ({"joints": ["waist", "left_wirst"]}, ["'left_wirst' is not in robot.urdf", "did you mean 'left_wrist'?"]),
    ({"joints": ["zzz"]}, ["'zzz' is not in", "its moving joints are: waist, "]),
    ({"locked": {"left_clamp": 0.1}}, ["'left_clamp' is fixed in"]),
    ({"sensor_joint": "left_clmap"}, ["'left_clmap' is not in", "did you mean 'left_clamp'?"]),
    ({"sensor_joint": "zzz"}, ["its joints are:", "left_clamp"]),
])  # fmt: skip
def test_unknown_joints(tree, arguments, words):
    with pytest.raises(InputError) as error:
        load_robot(tree, **arguments)
    assert all(word in str(error.value) for word in words)


def test_a_body_that_cannot_be_is_doubted_where_it_moves_only(tmp_path):
    body = '<inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial>'
    links = "".join(f'<link name="{name}">{body}</link>' for name in ("base", "box", "lid", "arm", "hand"))
    fixed = '<joint name="{1}_fixed" type="fixed"><parent link="{0}"/><child link="{1}"/></joint>'
    turning = fixed.format("lid", "arm").replace('type="fixed">', 'type="continuous"><axis xyz="0 0 1"/>')
    joints = [fixed.format("box", "lid"), fixed.format("arm", "hand"), turning, fixed.format("base", "box")]
    robot = load_robot(write(tmp_path, f'<robot name="r">{links}{"".join(joints)}</robot>'))
    (said,) = robot.description.warnings
    assert "of links arm, hand;" in said


def test_joints_are_in_the_order_of_the_file_along_their_chains(tmp_path):
    """Branches as the file lists them, where Pinocchio sorts them by name; a chain from its base, however it is listed."""

    def joint(name, parent, child):
        limit = '<axis xyz="0 0 1"/><limit lower="-1" upper="1" velocity="1" effort="1"/>'
        return f'<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/>{limit}</joint>'

    links = "".join(f'<link name="{name}"/>' for name in ("base", "r1", "r2", "l1", "l2"))
    right, left = (
        [joint("right1", "base", "r1"), joint("right2", "r1", "r2")],
        [joint("left2", "l1", "l2"), joint("left1", "base", "l1")],
    )
    for listed, expected in (
        ([*right, *left], ("right1", "right2", "left1", "left2")),
        ([right[0], left[1], right[1], left[0]], ("right1", "left1", "right2", "left2")),
    ):
        assert load_robot(write(tmp_path, f'<robot name="r">{links}{"".join(listed)}</robot>')).joint_names == expected


def test_the_ground_of_drake_needs_no_link(tmp_path):
    text = ROBOTS["ur5"]()
    parents, children = ({end.get("link") for end in ET.fromstring(text).iter(kind)} for kind in ("parent", "child"))
    (base,) = parents - children
    weld = f'<joint name="weld" type="fixed"><parent link="world"/><child link="{base}"/></joint></robot>'
    whole, welded = (load_robot(write(tmp_path, t)) for t in (text, text.replace("</robot>", weld)))
    assert welded.joint_names == whole.joint_names
    np.testing.assert_allclose(welded.nominal, whole.nominal)


def test_unreadable_files(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        load_robot(tmp_path / "none.urdf")
    with pytest.raises(InputError, match="cannot be read as a URDF"):
        load_robot(write(tmp_path, "<robot"))


@pytest.mark.parametrize("kind", ["planar", "floating"])
def test_joints_of_many_degrees_of_freedom(tree, kind, tmp_path):
    text = tree.read_text().replace('name="left_wrist" type="continuous"', f'name="left_wrist" type="{kind}"')
    assert kind in text
    with pytest.raises(InputError, match="'left_wrist' has . degrees of freedom"):
        load_robot(write(tmp_path, text))


def test_meshes_beside_the_robots_file_are_found_from_any_folder(tmp_path):
    kept = ("package://arm/a.stl", "nowhere.stl", "")
    shapes = "".join(
        f'<visual><geometry><mesh filename="{name}"/></geometry></visual>' for name in ("meshes/a.stl", "../b.stl", *kept)
    )
    own, other = tmp_path / "arm", tmp_path / "results" / "identify"
    for folder in (own / "meshes", other):
        folder.mkdir(parents=True)
    for mesh in (own / "meshes" / "a.stl", tmp_path / "b.stl"):
        mesh.touch()
    path = write(own, ROBOTS["ur5"]())
    path.write_text(path.read_text().replace("<inertial>", f"{shapes}<inertial>", 1))
    robot = load_robot(path)
    write_urdf(robot, robot.nominal, other / "identified.urdf")
    names = [mesh.get("filename") for mesh in ET.parse(other / "identified.urdf").iter("mesh")]
    assert [Path(name) for name in names[:2]] == [(own / "meshes" / "a.stl").resolve(), (tmp_path / "b.stl").resolve()]
    assert tuple(names[2:]) == kept


def test_a_mass_that_stands_for_none_is_none(tmp_path):
    """As of a frame at the tip whose link some programs do not take without <inertial>."""
    text = ROBOTS["ur5"]()
    held = {joint.find("parent").get("link") for joint in ET.fromstring(text).iter("joint")}
    (tip,) = {link.get("name") for link in ET.fromstring(text).iter("link")} - held
    tiny = '<inertial><mass value="1e-15"/><inertia ixx="1e-11" ixy="0" ixz="0" iyy="1e-11" iyz="0" izz="1e-11"/></inertial>'
    ends = f'<parent link="{tip}"/><child link="frame"/>'
    frame = f'<link name="frame">{tiny}</link><joint name="at" type="fixed">{ends}</joint></robot>'
    whole, framed = (load_robot(write(tmp_path, t)) for t in (text, text.replace("</robot>", frame)))
    np.testing.assert_array_equal(framed.nominal, whole.nominal)
    assert framed.description.warnings == whole.description.warnings
    with pytest.raises(InputError, match="link frame: mass 1e[+]09 kg is no link's; write kilograms, up to 1e[+]07"):
        load_robot(write(tmp_path, text.replace("</robot>", frame.replace("1e-15", "1e9"))))
