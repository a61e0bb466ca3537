"""Where a robot is read from: a file, a xacro file with its arguments, or the name of a public description."""

from __future__ import annotations

import contextlib
import importlib
import io
import re
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from difflib import get_close_matches
from functools import partial
from pathlib import Path
from typing import Any

from bayesid.errors import InputError, required

#: Before the name of a description of the package robot_descriptions.
NAMED = "robot_descriptions:"
_ARGUMENT = re.compile(r"\s+([A-Za-z_][\w.-]*):=(\S*)$")
_REASON = 200  # characters of another package's message that are quoted


@dataclass(frozen=True)
class RobotSource:
    """A file, and the arguments that its macros take."""

    path: Path  # the file
    arguments: dict[str, str] = field(default_factory=dict)  # by name, as the command xacro takes them
    #: Where packages are that its macros name, beside those that are found.
    packages: dict[str, str] = field(default_factory=dict)


def locate(given: str | Path, folder: Path | None = None) -> RobotSource:
    """Find the file of a robot; an `InputError` where there is no such description, or it cannot be had.

    It is given as ``FILE`` in ``folder``, ``FILE name:=value ...`` with arguments for xacro, or ``robot_descriptions:NAME``,
    which is fetched where it is not there yet.
    """
    text, arguments = str(given), {}
    while found := _ARGUMENT.search(text):
        arguments[found[1]] = found[2]
        text = text[: found.start()]
    arguments = dict(reversed(arguments.items()))
    if text.startswith(NAMED):
        return _described(text.removeprefix(NAMED).strip(), arguments)
    return RobotSource((folder or Path()) / text, arguments)


def expand(source: RobotSource) -> bytes:
    """The URDF that a xacro file becomes; an `InputError` where xacrodoc, a file or a package is missing or wrong.

    Packages that it names are looked for in the folders above it, then where ROS has them.
    """
    path = source.path
    missing = InputError(
        "is a xacro file, which needs xacrodoc", file=path.name,
        remedy='pip install "bayesid[robots]", or expand it first: xacro FILE > robot.urdf',
    )  # fmt: skip
    packages, xacro = required("xacrodoc.packages", missing), required("xacro", missing)
    try:
        packages.reset()  # a package of the same name that another robot's file has found
        packages.walk_up_from(path)
        packages.update_package_cache(source.packages)
        with contextlib.redirect_stderr(io.StringIO()):  # its warnings; what went wrong is in the exception
            return xacro.process_file(str(path), mappings=dict(source.arguments)).toxml("utf-8")
    except Exception as error:  # whatever a user's expressions raise
        reason, remedy = " ".join(str(error).split())[:_REASON] or type(error).__name__, "correct the file"
        if "Undefined substitution argument" in reason:
            remedy = 'give its value: "FILE name:=value"'
        elif "not found" in reason or "No such file" in reason:
            remedy = "put it beside the file, or name its folder in ROS_PACKAGE_PATH"
        raise InputError(f"xacro cannot expand it ({reason})", file=path.name, remedy=remedy) from None


def _described(name: str, arguments: Mapping[str, str]) -> RobotSource:
    """A description by its name: its URDF, else its xacro file, else its MJCF."""
    wrong, remedy = partial(InputError, file=f"{NAMED}{name}"), 'pip install "bayesid[robots]", or name a file'
    known = required("robot_descriptions", wrong("needs the package robot_descriptions", remedy=remedy)).DESCRIPTIONS
    if name not in known:
        close = get_close_matches(name, known, 1)
        hint = f"did you mean {close[0]}?" if close else "`python -m robot_descriptions list` lists them"
        raise wrong("no such description", remedy=hint)
    try:
        with contextlib.redirect_stdout(sys.stderr):
            module: Any = importlib.import_module(f"robot_descriptions.{name}")
    except Exception as error:  # of git, of a network
        said = re.findall(r"fatal: .*", str(error)) or [" ".join(str(error).split())]
        reason = said[0][:_REASON] or type(error).__name__
        raise wrong(f"cannot be fetched ({reason})", remedy="connect to the network this once, or name a file") from None
    if hasattr(module, "XACRO_PATH") and not hasattr(module, "URDF_PATH"):
        stated = {**getattr(module, "XACRO_ARGS", {}), **arguments}
        return RobotSource(Path(module.XACRO_PATH), stated, dict(getattr(module, "XACRO_PACKAGE_PATHS", {})))
    path = getattr(module, "URDF_PATH", None) or getattr(module, "MJCF_PATH", None)
    if path is None:
        raise wrong("has no URDF and no MJCF", remedy="name another")
    return RobotSource(Path(path), dict(arguments))
