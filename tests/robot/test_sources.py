"""Robots by xacro and by name."""

from __future__ import annotations

import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

import bayesid
from bayesid.robot.robot import load_robot
from bayesid.robot.sources import locate
from bayesid.robot.urdf_file import read_urdf
from tests.robots import write

XACRO = """<?xml version="1.0"?>
<robot xmlns:xacro="http://www.ros.org/wiki/xacro" name="two">
  <xacro:include filename="{include}"/>
  <xacro:arg name="mass" default="3.0"/>
  <link name="base"/>
  <xacro:bar name="$(arg prefix)upper" parent="base" mass="${{$(arg mass)}}" length="0.4"/>
  <xacro:bar name="$(arg prefix)fore" parent="$(arg prefix)upper" mass="${{$(arg mass) / 2}}" length="${{0.1 + 0.2}}"/>
</robot>"""
BAR = """<?xml version="1.0"?>
<robot xmlns:xacro="http://www.ros.org/wiki/xacro">
  <xacro:macro name="bar" params="name parent mass length">
    <xacro:property name="i" value="${mass * length**2 / 12}"/>
    <link name="${name}"><inertial><origin xyz="0 0 ${length / 2}"/><mass value="${mass}"/>
      <inertia ixx="${i}" iyy="${i}" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial></link>
    <joint name="${name}_joint" type="continuous"><parent link="${parent}"/><child link="${name}"/><axis xyz="0 1 0"/></joint>
  </xacro:macro>
</robot>"""
PACKAGE = "<package format='2'><name>{}</name><version>1.0.0</version></package>"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A package with a robot whose macro is in a file beside it."""
    pytest.importorskip("xacrodoc")
    (tmp_path / "urdf").mkdir()
    (tmp_path / "package.xml").write_text(PACKAGE.format("two_description"))
    (tmp_path / "urdf" / "bar.xacro").write_text(BAR)
    (tmp_path / "urdf" / "two.urdf.xacro").write_text(XACRO.format(include="bar.xacro"))
    return tmp_path


@pytest.mark.parametrize("include", ["bar.xacro", "$(find two_description)/urdf/bar.xacro"])
def test_a_xacro_file_is_expanded_with_its_arguments(folder, include):
    """Files that it includes are found beside it and in its package; numbers as a URDF with the same has them."""
    file = folder / "urdf" / "two.urdf.xacro"
    file.write_text(XACRO.format(include=include))
    robot = load_robot(f"{file} prefix:=left_ mass:=4.0")
    assert robot.joint_names == ("left_upper_joint", "left_fore_joint") and robot.urdf == file
    bar = [
        mass * np.array([1.0, 0, 0, length / 2, length**2 / 3, 0, length**2 / 3, 0, 0, 0])
        for mass, length in [(4, 0.4), (2, 0.3)]
    ]
    expected = np.array(bar) + np.array([0.0] * 9 + [0.001])
    np.testing.assert_allclose(robot.nominal, expected, atol=1e-15)
    plain = write(folder, robot.description.text)
    np.testing.assert_array_equal(load_robot(plain).nominal, robot.nominal)


def test_an_experiment_names_a_xacro_file_with_arguments(folder):
    t = np.linspace(0.0, 5.0, 200)
    q = np.column_stack([np.sin(t), np.cos(2 * t)])
    made = bayesid.Experiment.from_arrays(f"{folder / 'urdf' / 'two.urdf.xacro'} prefix:=", t, q, torques=q)
    bayesid.write_experiment(made, folder / "experiment")
    for name in ("two.urdf.xacro", "bar.xacro"):
        (folder / "experiment" / name).write_bytes((folder / "urdf" / name).read_bytes())
    toml = folder / "experiment" / "experiment.toml"
    text = toml.read_text().replace('"robot.urdf"', '"two.urdf.xacro prefix:= mass:=5"')
    toml.write_text(text)
    assert bayesid.load_experiment(folder / "experiment").robot.nominal[0, 0] == 5.0
    toml.write_text(text.replace("two.urdf", "tow.urdf"))
    with pytest.raises(bayesid.InputError, match='urdf: "tow.urdf.xacro prefix:= mass:=5" is no file in .*; name the URDF there'):
        bayesid.load_experiment(folder / "experiment")


WRONG = {
    r"two.urdf.xacro: xacro cannot expand it \(Undefined substitution argument prefix.*FILE name:=value": ("bar.xacro", ""),
    r"two.urdf.xacro: xacro cannot expand it \(.*No such file.*nothing.xacro.*ROS_PACKAGE_PATH": ("nothing.xacro", "prefix:="),
    r"two.urdf.xacro: xacro cannot expand it \(.*ot found: elsewhere.*ROS_PACKAGE_PATH": (
        "$(find elsewhere)/bar.xacro",
        "prefix:=",
    ),
    r"two.urdf.xacro: xacro cannot expand it \(.*correct the file": ("bar.xacro", "prefix:= mass:=heavy"),
}


@pytest.mark.parametrize("said", WRONG)
def test_what_xacro_cannot_expand_is_said_in_one_line(said, folder, capsys):
    include, arguments = WRONG[said]
    (folder / "urdf" / "two.urdf.xacro").write_text(XACRO.format(include=include))
    with pytest.raises(bayesid.InputError, match=said) as error:
        load_robot(f"{folder / 'urdf' / 'two.urdf.xacro'} {arguments}".rstrip())
    assert "\n" not in str(error.value)
    assert capsys.readouterr() == ("", "")


def test_a_package_of_the_same_name_elsewhere_is_not_taken(folder, tmp_path_factory):
    load_robot(f"{folder / 'urdf' / 'two.urdf.xacro'} prefix:=")
    other = tmp_path_factory.mktemp("other")
    (other / "package.xml").write_text(PACKAGE.format("two_description"))
    (other / "bar.xacro").write_text(BAR.replace("${name}_joint", "${name}_axis"))
    (other / "two.xacro").write_text(XACRO.format(include="$(find two_description)/bar.xacro"))
    assert load_robot(f"{other / 'two.xacro'} prefix:=").joint_names == ("upper_axis", "fore_axis")


def test_without_xacrodoc_the_message_says_what_to_install(folder, monkeypatch):
    monkeypatch.setitem(sys.modules, "xacrodoc.packages", None)
    with pytest.raises(
        bayesid.InputError, match=r'two.urdf.xacro: is a xacro file.*pip install "bayesid\[robots\]", or expand it'
    ):
        load_robot(f"{folder / 'urdf' / 'two.urdf.xacro'} prefix:=")


def test_arguments_stand_after_a_file_name_with_blanks():
    source = locate("my robots/arm 2.xacro a:=1  b_c:=x:=y", Path("folder"))
    assert (source.path, source.arguments) == (Path("folder/my robots/arm 2.xacro"), {"a": "1", "b_c": "x:=y"})
    assert locate(Path("a.urdf")).path == Path("a.urdf")


@pytest.fixture
def descriptions(monkeypatch):
    """The package robot_descriptions with a description that is on this machine, and one whose repository is not to be had."""
    package = ModuleType("robot_descriptions")
    package.DESCRIPTIONS = dict.fromkeys(["two_description", "far_description", "srdf_description"])
    package.__path__ = []

    def add(name: str, **paths) -> None:
        module = ModuleType(f"robot_descriptions.{name}")
        vars(module).update(paths)
        monkeypatch.setitem(sys.modules, module.__name__, module)

    monkeypatch.setitem(sys.modules, "robot_descriptions", package)
    return add


def test_a_description_by_name_is_its_urdf_or_xacro_file(folder, descriptions):
    descriptions("two_description", XACRO_PATH=str(folder / "urdf" / "two.urdf.xacro"), XACRO_ARGS={"prefix": "r_", "mass": "2"})
    robot = load_robot("robot_descriptions:two_description mass:=6")
    assert robot.joint_names == ("r_upper_joint", "r_fore_joint") and robot.nominal[0, 0] == 6.0
    descriptions("two_description", URDF_PATH=str(write(folder, robot.description.text)))
    assert read_urdf("robot_descriptions:two_description").path == folder / "robot.urdf"
    t = np.linspace(0.0, 5.0, 200)
    q = np.column_stack([np.sin(t), np.cos(2 * t)])
    bayesid.write_experiment(bayesid.Experiment.from_arrays(robot, t, q, torques=q), folder / "experiment")
    toml = folder / "experiment" / "experiment.toml"
    toml.write_text(toml.read_text().replace('"robot.urdf"', '"robot_descriptions:two_description"'))
    assert bayesid.load_experiment(folder / "experiment").robot.joint_names == robot.joint_names


def test_a_description_that_is_not_to_be_had_is_said_in_one_line(descriptions, monkeypatch):
    descriptions("srdf_description", SRDF_PATH="x.srdf")
    with pytest.raises(bayesid.InputError, match="two_descriptoin: no such description; did you mean two_description"):
        load_robot("robot_descriptions:two_descriptoin")
    with pytest.raises(bayesid.InputError, match="srdf_description: has no URDF and no MJCF"):
        load_robot("robot_descriptions:srdf_description")

    class NoNetwork:
        def find_spec(self, name, *_):
            if name == "robot_descriptions.far_description":
                raise RuntimeError("Cmd('git') failed due to: exit code(128)\n  stderr: 'fatal: unable to access: no route'")

    monkeypatch.setattr(sys, "meta_path", [NoNetwork(), *sys.meta_path])
    with pytest.raises(bayesid.InputError, match="far_description: cannot be fetched .*no route.*connect to the network"):
        load_robot("robot_descriptions:far_description")
    monkeypatch.setitem(sys.modules, "robot_descriptions", None)
    with pytest.raises(bayesid.InputError, match=r'needs the package robot_descriptions; pip install "bayesid\[robots\]"'):
        load_robot("robot_descriptions:two_description")
