"""A robot's file as its author wrote it, as a URDF, checked before any parser of robots sees it.

What cannot be a robot is refused: numbers that are none, negative or absurd masses, joints that form a loop. What
is doubtful becomes a warning. `for_pinocchio` then hands on the links and joints alone, so that both read the same.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from xml.parsers import expat

import numpy as np
import pinocchio as pin

from bayesid.errors import InputError
from bayesid.robot import inertia
from bayesid.robot.mjcf import read_mjcf
from bayesid.robot.sources import expand, locate

_DEEPEST = 100  # nested elements; a URDF has five
_REMEDIES = {
    "unbound prefix": "declare the prefix (xmlns:...) or remove these elements; a xacro file declares "
    'xmlns:xacro="http://www.ros.org/wiki/xacro"',
    "XML or text declaration not at start of entity": "remove whatever stands before <?xml, blank lines too",
    "unknown encoding": "save the file as UTF-8",
}


def parse_xml(data: bytes, source: str) -> ET.Element:
    """Read XML into its root element.

    An `InputError` where it is no well-formed XML, declares a document type (entities grow without bound and read other files),
    or nests elements a hundred deep. No content of the file is quoted; ``source`` is what messages call it.
    """
    builder, wrong = ET.TreeBuilder(), partial(InputError, file=source)
    parser = expat.ParserCreate(namespace_separator="}")
    depth = 0

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal depth
        depth += 1
        if depth > _DEEPEST:
            problem = f"line {parser.CurrentLineNumber}: elements are nested more than {_DEEPEST} deep"
            raise wrong(problem, remedy="cannot be read as a URDF: check the file")
        builder.start(_qualified(tag), {_qualified(key): value for key, value in attributes.items()})

    def end(tag: str) -> None:
        nonlocal depth
        depth -= 1
        builder.end(_qualified(tag))

    def doctype(*_: object) -> None:
        raise wrong(f"line {parser.CurrentLineNumber}: <!DOCTYPE is not read", remedy="remove it, entities too")

    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.CharacterDataHandler = builder.data
    parser.StartDoctypeDeclHandler = doctype
    parser.buffer_text = True
    try:
        parser.Parse(data, True)
    except expat.ExpatError as error:
        reason = expat.ErrorString(error.code)
        remedy = _REMEDIES.get(reason, "correct the XML there")
        raise wrong(f"cannot be read as a URDF: line {error.lineno}: {reason}", remedy=remedy) from None
    except (LookupError, ValueError):  # an encoding that Python knows, but that is none of single bytes
        raise wrong("cannot be read as a URDF: its encoding", remedy="save the file as UTF-8") from None
    return builder.close()


def _qualified(name: str) -> str:
    """A name as ElementTree writes it: ``{namespace}tag``."""
    return "{" + name if "}" in name else name


#: A chain of so many links is no robot, and parsers that call themselves once a link run out of stack on longer ones.
LONGEST_CHAIN, MOST_LINKS = 500, 5000
#: No link weighs more [kg]; nor less, but for frames without any mass.
HEAVIEST, LIGHTEST = 1e7, 1e-12
#: Nothing of a robot is farther from its joint than that [m], nor any other number of a URDF larger.
FARTHEST, LARGEST = 1e4, 1e12
_KINDS = ("revolute", "continuous", "prismatic", "fixed", "floating", "planar")
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
_SHOWN = 40  # characters of a value that a message quotes
#: Makes an error at a place of the file.
Wrong = Callable[..., InputError]


@dataclass(frozen=True)
class UrdfJoint:
    """A joint as the file states it."""

    #: Its name, type, and the links that it connects.
    name: str
    kind: str
    parent: str
    child: str
    mimics: str | None  # the joint that it follows, or None


@dataclass(frozen=True)
class UrdfFile:
    """A URDF that has passed the checks, or what another format says as one."""

    path: Path  # the file that was read
    data: bytes  # the whole document; of a URDF, byte by byte
    joints: dict[str, UrdfJoint]  # by name
    warnings: tuple[str, ...]  # what is doubtful in it, one line each
    #: What an MJCF file states inside joints, by joint, as `bayesid.robot.mjcf.MjcfRobot` has it.
    inside: dict[str, dict[str, float]] = field(default_factory=dict)

    @property
    def root(self) -> ET.Element:
        """The whole document, the caller's own to change."""
        return parse_xml(self.data, self.path.name)

    @property
    def root_link(self) -> str:
        """The link that is no joint's child."""
        children = {joint.child for joint in self.joints.values()}
        return next(str(link.get("name")) for link in self.root.findall("link") if link.get("name") not in children)

    @property
    def text(self) -> str:
        """The whole document without its comments."""
        return ET.tostring(self.root, encoding="unicode")

    def for_pinocchio(self) -> str:
        """Links with their masses, and joints, as XML: what Pinocchio needs and nothing else."""
        whole = self.root
        root = ET.Element("robot", name=whole.get("name", ""))
        for kind, parts in (("link", ("inertial",)), ("joint", ("origin", "parent", "child", "axis", "limit"))):
            for element in whole.findall(kind):
                copy = ET.SubElement(root, kind, _plain(element))
                for part in parts:
                    for inner in element.findall(part)[:1]:
                        below = ET.SubElement(copy, part, _plain(inner))
                        for innermost in inner:
                            ET.SubElement(below, innermost.tag, _plain(innermost))
        return ET.tostring(root, encoding="unicode")


def read_urdf(given: str | Path, folder: Path | None = None) -> UrdfFile:
    """Read a robot's file and check all that can be checked without a robot in mind.

    It is ``given`` as for `bayesid.robot.sources.locate`, in a folder; default: where the program runs. An `InputError` where it
    is no XML, or no robot (which link or joint, which value, what to do; the file's name alone goes into it), or where a package
    is missing that the format needs.
    """
    source = locate(given, folder)
    path, wrong = source.path, partial(InputError, file=source.path.name)
    if not path.is_file():
        raise wrong("no such file", remedy="name the robot's URDF")
    try:
        data = path.read_bytes()
    except OSError as error:
        raise wrong(f"cannot be read ({error.strerror})", remedy="give a readable file") from None
    root = parse_xml(data, path.name)
    if root.tag == "mujoco":
        robot = read_mjcf(path)
        file = _checked(ET.tostring(robot.root), path, robot.notes, robot.inside)
        robot.check(file.for_pinocchio(), path.name)
        return file
    namespaces = (element.tag.partition("}")[0] for element in root.iter() if "}" in element.tag)
    if source.arguments or any("xacro" in namespace for namespace in namespaces):
        data = expand(source)
    return _checked(data, path)


def _checked(data: bytes, path: Path, notes: tuple[str, ...] = (), inside: dict | None = None) -> UrdfFile:
    root, wrong = parse_xml(data, path.name), partial(InputError, file=path.name)
    if root.tag.endswith("}robot"):
        raise wrong("<robot> has a default namespace (xmlns=...), so that none of its parts is URDF's", remedy="remove it")
    if root.tag != "robot":
        remedy = "it cannot be read as a URDF, which has <robot>, nor as MJCF, <mujoco>: name the robot's file"
        raise wrong(f"its root element is <{_cut(root.tag)}>", remedy=remedy)
    if root.find("joint/parent[@link='world']") is not None and root.find("link[@name='world']") is None:
        # Drake has a link of this name for the ground, so files made for it name it as a parent and leave it out.
        ET.SubElement(root, "link", name="world")
        data = ET.tostring(root)
    links, joints = _named(root, "link", wrong), _named(root, "joint", wrong)
    if not links:
        raise wrong("has no <link>", remedy="it cannot be read as a URDF: check the file")
    at_joint = {name: partial(wrong, key=f"joint {_cut(name)}") for name in joints}
    known = {name: _joint(element, links, at_joint[name]) for name, element in joints.items()}
    for name, element in joints.items():
        _check_numbers(element, known[name].kind, at_joint[name])
    root_link = _check_tree(links, known, wrong)
    bodies = {name: stated_body(element, partial(wrong, key=f"link {_cut(name)}")) for name, element in links.items()}
    for name, element in links.items():
        inertial, stated = element.find("inertial"), element.find("inertial/mass")
        if inertial is not None and stated is not None and float(stated.get("value", "0")) > 0.0 and not bodies[name].any():
            element.remove(inertial)
            data = ET.tostring(root)
    fixed: dict[str, list[str]] = {}
    for joint in known.values():
        fixed.setdefault(joint.parent, []).extend([joint.child] * (joint.kind == "fixed"))
    still = [root_link]
    for link in still:
        still += fixed.get(link, ())
    held = {*still}
    moved = {name: body for name, body in bodies.items() if name not in held}
    return UrdfFile(path, data, known, (*notes, *_doubts(moved, path.name)), inside or {})


def _plain(element: ET.Element) -> dict[str, str]:
    """Attributes as every parser reads them: values without line breaks."""
    return {key: " ".join(value.split()) if key != "name" else value for key, value in element.attrib.items()}


def _named(root: ET.Element, kind: str, wrong: Wrong) -> dict[str, ET.Element]:
    out: dict[str, ET.Element] = {}
    for element in root.findall(kind):
        name = element.get("name", "")
        if not name.strip():
            raise wrong(f"a <{kind}> has no name", remedy="name it")
        if name in out:
            raise wrong(f"{kind} {_cut(name)}: is there twice", remedy="name them apart")
        out[name] = element
    return out


def _joint(element: ET.Element, links: dict[str, ET.Element], wrong: Wrong) -> UrdfJoint:
    kind = element.get("type", "")
    if kind not in _KINDS:
        raise wrong(f'type "{_cut(kind)}" is not known', value=kind, remedy="write revolute, continuous, prismatic or fixed")
    ends = []
    for end in ("parent", "child"):
        inner = element.find(end)
        link = "" if inner is None else inner.get("link", "")
        if link not in links:
            raise wrong(f'{end} link "{_cut(link)}" is not in the file', value=link, remedy="correct the name there")
        ends.append(link)
    mimic = element.find("mimic")
    return UrdfJoint(str(element.get("name")), kind, ends[0], ends[1], None if mimic is None else mimic.get("joint", ""))


def _check_numbers(element: ET.Element, kind: str, wrong: Wrong) -> None:
    _origin(element, wrong)
    axis = element.find("axis")
    if axis is not None and kind != "fixed":
        given = _vector(axis, "xyz", (1.0, 0.0, 0.0), wrong, LARGEST)
        if kind in _KINDS[:3] and not np.linalg.norm(given) > 1e-6:
            raise wrong(f"axis {axis.get('xyz')} has no direction", value=given, remedy="write a unit vector")
    limit = element.find("limit")
    if kind not in _KINDS[:3] or (limit is None and kind == "continuous"):
        return
    if limit is None:
        raise wrong(f"is {kind} and has no <limit>", remedy="write lower, upper, velocity and effort")
    limits = []
    for key, default in (("lower", "0"), ("upper", "0"), ("velocity", None), ("effort", None)):
        given = limit.get(key, default)
        if given is None:
            raise wrong(f"<limit> lacks {key}", remedy="write it")
        limits.append(_number(given, f"limit {key}", wrong))
    lower, upper = limits[:2]
    if kind != "continuous" and lower > upper:
        problem = f"limits are reversed, from {lower:g} to {upper:g}"
        raise wrong(problem, value=(lower, upper), remedy="swap lower and upper")


def _check_tree(links: Iterable[str], joints: dict[str, UrdfJoint], wrong: Wrong) -> str:
    """Check that all links hang on one, by chains of bearable length; returns that one's name."""
    links = list(links)
    above: dict[str, UrdfJoint] = {}
    below: dict[str, list[str]] = {name: [] for name in links}
    for joint in joints.values():
        if joint.child in above:
            raise wrong(
                f"joints {_cut(above[joint.child].name)} and {_cut(joint.name)} have the same child, link {_cut(joint.child)}",
                remedy="a link hangs on one joint: remove the other (closed loops are not supported)",
            )
        above[joint.child] = joint
        below[joint.parent].append(joint.child)
    roots = [name for name in links if name not in above]
    if len(roots) > 1:
        raise wrong(f"links {_cut(roots[0])} and {_cut(roots[1])} hang on no joint", remedy="attach all but one of them")
    depth = {name: 1 for name in roots}
    queue = list(roots)
    for name in queue:
        for child in below[name]:
            depth[child] = depth[name] + 1
            queue.append(child)
    if looped := [name for name in links if name not in depth]:
        problem = f"joint {_cut(above[looped[0]].name)}: its links hang on each other in a loop, not on the robot's base"
        raise wrong(problem, remedy="correct its parent or child")
    if len(links) > MOST_LINKS or max(depth.values()) > LONGEST_CHAIN:
        problem = f"{len(links)} links, {max(depth.values())} of them in one chain; {MOST_LINKS} and {LONGEST_CHAIN} can be read"
        raise wrong(problem, remedy="merge links that fixed joints connect")
    return roots[0]


def stated_body(link: ET.Element, wrong: Wrong) -> np.ndarray:
    """Ten parameters of a link about its own origin (10,); zero without an ``<inertial>``, or with one of a mass next to none."""
    inertial = link.find("inertial")
    if inertial is None:
        return np.zeros(10)
    mass, about = inertial.find("mass"), inertial.find("inertia")
    if mass is None or about is None:
        raise wrong(f"<inertial> lacks <{'mass' if mass is None else 'inertia'}>", remedy="write it, or remove <inertial>")
    m = _number(mass.get("value"), "mass", wrong)
    if m < 0.0:
        raise wrong(f"mass {m:g} kg", value=m, remedy="masses are 0 or more: correct it")
    if m > HEAVIEST:
        raise wrong(f"mass {m:g} kg is no link's", value=m, remedy=f"write kilograms, up to {HEAVIEST:g}")
    tensor = np.zeros((3, 3))
    for key, (i, k) in inertia.ENTRIES.items():
        tensor[i, k] = tensor[k, i] = _number(about.get(key), key, wrong, LARGEST)
    com, rpy = _origin(inertial, wrong)
    if m < LIGHTEST and m > 0.0:
        return np.zeros(10)
    rotation = pin.rpy.rpyToMatrix(*map(float, rpy))
    return inertia.from_mass_com_inertia(m, com, rotation @ tensor @ rotation.T)


def _doubts(moved: dict[str, np.ndarray], source: str) -> list[str]:
    """What no physical link of those that move is: inertia without mass, or one that no distribution of mass has."""
    out = []
    if moved and not any(body[0] > 0.0 for body in moved.values()):
        out.append(
            f"{source}: no link but the root has a mass, so nothing is known of the nominal robot; "
            "write the masses, or state no [robot] inertia_rel_std"
        )
    empty = [name for name, body in moved.items() if body[0] == 0.0 and body.any()]
    if empty:
        out.append(f"{source}: mass 0 but an inertia: {_listed(empty)}; write the mass, or remove <inertial>")
    impossible = [name for name, body in moved.items() if body[0] > 0.0 and not inertia.is_physically_consistent(body).all()]
    if impossible:
        out.append(
            f"{source}: no body can have the mass, centre and inertia of {_listed(impossible)}; "
            "correct them, or leave [robot] inertia_rel_std out if they are not to be trusted"
        )
    return out


def _listed(names: list[str]) -> str:
    more = f" and {len(names) - 3} more" if len(names) > 3 else ""
    return f"link{'s' * (len(names) > 1)} " + ", ".join(map(_cut, names[:3])) + more


def _origin(element: ET.Element, wrong: Wrong) -> tuple[np.ndarray, np.ndarray]:
    """Position [m] and fixed-axis angles [rad] of an element's ``<origin>``."""
    origin = element.find("origin")
    if origin is None:
        return np.zeros(3), np.zeros(3)
    zero = (0.0, 0.0, 0.0)
    return _vector(origin, "xyz", zero, wrong, FARTHEST), _vector(origin, "rpy", zero, wrong, FARTHEST)


def _vector(element: ET.Element, key: str, default: tuple[float, ...], wrong: Wrong, largest: float) -> np.ndarray:
    text = element.get(key)
    if text is None:
        return np.array(default)
    parts = text.split()
    if len(parts) != 3:
        remedy = "write three, separated by blanks, with decimal points"
        raise wrong(f'<{element.tag}> {key} "{_cut(text)}" is not three numbers', value=text, remedy=remedy)
    return np.array([_number(part, f"<{element.tag}> {key}", wrong, largest) for part in parts])


def _number(text: str | None, what: str, wrong: Wrong, largest: float = np.inf) -> float:
    if text is None:
        raise wrong(f"{what} is missing", remedy="write it")
    if not _NUMBER.fullmatch(text.strip()):
        raise wrong(f'{what} "{_cut(text)}" is not a number', value=text, remedy="write one, with a decimal point")
    value = float(text)
    if not abs(value) <= largest or not np.isfinite(value):
        remedy = "write SI units (m, rad, kg, kg m^2)"
        raise wrong(f"{what} {_cut(text)} is beyond all robots", value=text, remedy=remedy)
    return value


def _cut(text: str) -> str:
    text = " ".join(text.split())
    return text if len(text) <= _SHOWN else text[: _SHOWN - 3] + "..."
