"""TOML files that a user writes: tables of known keys and bearable numbers, and one line when a file is not like that."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any, TypeVar

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from bayesid.errors import InputError
from bayesid.recordings.complaints import cut, describe, one_line

#: Keys that a section may have, by the path to it without list indices.
Keys = Mapping[tuple[str, ...], Iterable[str]]

#: No quantity of a robot in SI units is larger, and no size smaller without being zero: squares of both stay numbers.
LARGEST, SMALLEST = 1e12, 1e-15
_LONGEST_NAME = 100


def _bearable(value: float) -> float:
    """Refuse a number that no robot needs: arithmetic with it overflows later, where nothing can be said about it."""
    if abs(value) > LARGEST:
        raise ValueError(f"write a number up to {LARGEST:g}, in SI units")
    return value


def _a_size(value: float) -> float:
    """Refuse a size that is next to nothing, but not zero."""
    if 0.0 < abs(value) < SMALLEST:
        raise ValueError(f"write 0, or at least {SMALLEST:g}, in SI units")
    return value


Number = Annotated[float, AfterValidator(_bearable)]
NonNegative = Annotated[Number, AfterValidator(_a_size), Field(ge=0.0)]
Positive = Annotated[Number, AfterValidator(_a_size), Field(gt=0.0)]
Vector3 = Annotated[list[Number], Field(min_length=3, max_length=3)]


def _plain_name(text: str) -> str:
    """Refuse a name that cannot be a folder name or an item of a comma-separated option."""
    if not text.strip() or text.startswith(".") or any(c in '/\\,"' or not c.isprintable() for c in text):
        raise ValueError('write a name without / \\ , " and line breaks, not starting with a dot')
    if len(text.encode("utf-8")) > _LONGEST_NAME:
        raise ValueError(f"write at most {_LONGEST_NAME} characters")
    return text


Name = Annotated[str, AfterValidator(_plain_name)]


class Section(BaseModel):
    """A table of a file: no other keys than its own, numbers finite."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)


File = TypeVar("File", bound=BaseModel)


def read_toml(path: Path, kind: type[File], keys: Keys, asked: str) -> File:
    """Read a TOML file into its model; ``keys`` of its sections are for suggestions, ``asked`` says what file it should be.

    An `InputError` where the file is absent, unreadable, not UTF-8, not TOML, or holds a wrong key or value.
    """
    try:
        if path.exists() and not path.is_file():
            raise InputError(f"{path}: is no file; give the path of a TOML file")
        data = tomllib.loads(path.read_bytes().decode("utf-8-sig"))  # Windows' editors begin files with a mark
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; give the path of {asked}") from None
    except UnicodeDecodeError as error:
        line = error.object[: error.start].count(b"\n") + 1
        raise InputError(
            f"{path.name}: line {line}: byte 0x{error.object[error.start]:02x} is not UTF-8; save the file as UTF-8"
        ) from None
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{path.name}: not valid TOML: {cut(one_line(str(error)), 160)}; correct it there") from None
    except RecursionError:
        raise InputError(f"{path.name}: not valid TOML: brackets are nested too deep; write it flatter") from None
    except ValueError:  # Python reads integers up to a number of digits
        raise InputError(f"{path.name}: not valid TOML: a number has thousands of digits; write 1e9 and the like") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); give a readable file") from None
    return as_file(data, kind, keys, path.name)


def as_file(data: Mapping[str, Any], kind: type[File], keys: Keys, name: str) -> File:
    """What a TOML file of a name holds, as its model; an `InputError` where it holds a wrong key or value."""
    try:
        return kind.model_validate(data)
    except ValidationError as error:
        # A misspelt key often shows twice, as an unknown key and as a missing one: the first says more.
        details = sorted(error.errors(include_url=False), key=lambda e: e["type"] != "extra_forbidden")
        raise InputError(f"{name}: {describe(details[0], keys, kind.model_fields, data)}") from None
