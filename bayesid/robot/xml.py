"""XML that others wrote, read with care: no document type, no entities, no deep nesting, errors in one line."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path
from xml.parsers import expat

from bayesid.errors import InputError

_DEEPEST = 100  # nested elements; a URDF has five
_REMEDIES = {
    "unbound prefix": "declare the prefix (xmlns:...) or remove these elements; a xacro file declares "
    'xmlns:xacro="http://www.ros.org/wiki/xacro"',
    "XML or text declaration not at start of entity": "remove whatever stands before <?xml, blank lines too",
    "unknown encoding": "save the file as UTF-8",
}


def read_bytes(path: Path, source: str) -> bytes:
    """What a file holds; InputError where it cannot be read, under the name that messages call it."""
    if not path.is_file():
        raise InputError("no such file", file=source, remedy="name the robot's URDF")
    try:
        return path.read_bytes()
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror})", file=source, remedy="give a readable file") from None


def parse_xml(data: bytes, source: str) -> ET.Element:
    """Read XML into its root element.

    Parameters
    ----------
    data
        What the file holds.
    source
        What messages call it.

    Raises
    ------
    InputError
        It is no well-formed XML, declares a document type (entities grow without bound and read
        other files), or nests elements a hundred deep. No content of the file is quoted.
    """
    builder = ET.TreeBuilder()
    parser = expat.ParserCreate(namespace_separator="}")
    depth = 0

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal depth
        depth += 1
        if depth > _DEEPEST:
            raise InputError(
                f"line {parser.CurrentLineNumber}: elements are nested more than {_DEEPEST} deep",
                file=source, remedy="cannot be read as a URDF: check the file",
            )  # fmt: skip
        builder.start(_qualified(tag), {_qualified(key): value for key, value in attributes.items()})

    def end(tag: str) -> None:
        nonlocal depth
        depth -= 1
        builder.end(_qualified(tag))

    def doctype(*_: object) -> None:
        raise InputError(f"line {parser.CurrentLineNumber}: <!DOCTYPE is not read", file=source, remedy="remove it, entities too")

    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.CharacterDataHandler = builder.data
    parser.StartDoctypeDeclHandler = doctype
    parser.buffer_text = True
    try:
        parser.Parse(data, True)
    except expat.ExpatError as error:
        reason = expat.ErrorString(error.code)
        raise InputError(
            f"cannot be read as a URDF: line {error.lineno}: {reason}",
            file=source, remedy=_REMEDIES.get(reason, "correct the XML there"),
        ) from None  # fmt: skip
    except (LookupError, ValueError):  # an encoding that Python knows, but that is none of single bytes
        raise InputError("cannot be read as a URDF: its encoding", file=source, remedy="save the file as UTF-8") from None
    return builder.close()


def _qualified(name: str) -> str:
    """A name as ElementTree writes it: ``{namespace}tag``."""
    return "{" + name if "}" in name else name
