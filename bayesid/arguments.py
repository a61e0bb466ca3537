"""Arguments of public functions: how messages name them, one name where several may stand, and those of one options class."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

_O = TypeVar("_O", bound="DataclassInstance")
#: Options of the command line that are not called as the argument is.
_OPTIONS = {
    "bounds": "method sdp --bounds", "certificate": "twins", "folder": "out", "join_files": "join", "low_pass": "filter-l",
    "quantities": "quantity", "target": "next", "trajectories": "trajectory",
}  # fmt: skip
#: Arguments that belong to a class of options, and how Python passes that.
_GROUPS: dict[str, str] = {
    **dict.fromkeys(("engine", "moves", "longest", "resume"), "sampler=Sampler({name}={value})"),
    "bounds": "method=Physical(bounds=load_bounds({value}))",
}
#: Functions of Python that are not called as the verb is.
_FUNCTIONS = {"import": "read_recording"}
_command_line = False


@contextlib.contextmanager
def on_command_line() -> Iterator[None]:
    """Messages that are made inside name options in place of arguments, and commands in place of functions.

    This holds for the process, all its threads included: it is the command line that calls, or it is not.
    """
    global _command_line
    before, _command_line = _command_line, True
    try:
        yield
    finally:
        _command_line = before


def argument(name: str, value: Any = None) -> str:
    """How a message names an argument and what was given or should be: ``runs=2``, or ``--runs 2`` on the command line."""
    if _command_line:
        option = _OPTIONS.get(name, name).replace("_", "-")
        if isinstance(value, bool):
            return f"--{option}" if value else f"--no-{option}"
        return f"--{option}" if value is None else f"--{option} {_as_option(value)}"
    return name if value is None else _GROUPS.get(name, "{name}={value}").format(name=name, value=_as_python(value))


def call(verb: str) -> str:
    """How a message names what bayesid can do: ``bayesid.diagnose``, or ``bayesid diagnose`` on the command line."""
    return f"bayesid {verb}" if _command_line else f"bayesid.{_FUNCTIONS.get(verb, verb)}"


class ByName:
    """What gives its parts by name: ``name in`` it says whether there is one, and it is not iterated.

    Without these Python asks for part 0, 1 and so on.
    """

    __iter__: ClassVar[None] = None

    def __contains__(self, name: object) -> bool:
        """Whether there is a part of this name."""
        try:
            self[name]  # pyright: ignore[reportIndexIssue]
        except KeyError:
            return False
        return True


def names(given: str | Iterable[str] | None) -> tuple[str, ...] | None:
    """Names that were given, where a string is one name; None where none were."""
    if given is None:
        return None
    return (given,) if isinstance(given, str) else tuple(given)


def unmasked(given: Any) -> Any:
    """What was given for numbers: an array of numpy's with a mask holds nan there, which `numpy.asarray` would uncover."""
    import numpy as np  # the command line, which names its options here, starts without it

    masked = isinstance(given, np.ma.MaskedArray) and given.dtype.kind in "biuf"
    return np.ma.filled(given.astype(float), np.nan) if masked else given


def with_given(options: _O, **given: Any) -> _O:
    """Options of a dataclass with those in their place that were given one by one: all that are not None."""
    return replace(options, **{name: value for name, value in given.items() if value is not None})


def _as_option(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:g}"
    return ",".join(_as_option(part) for part in value) if isinstance(value, (list, tuple)) else str(value)


def _as_python(value: Any) -> str:
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(_as_python(part) for part in value)}]"
    return f"{value:g}" if isinstance(value, float) else str(value) if isinstance(value, (bool, int)) else f'"{value}"'
