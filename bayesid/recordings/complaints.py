"""What is wrong with a value that a user wrote, and what to write instead, in one line that copies no more of it than needed."""

from __future__ import annotations

import difflib
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from pydantic_core import ErrorDetails


@dataclass(frozen=True)
class Finding:
    """Something in the data that is certain: it comes first."""

    text: str  # one line: which file and column, what it is, what was done or what to do about it
    #: Channels, ``wrench`` or ``torque``, whose bad fit it explains: no mistake is guessed from their readings.
    silences: tuple[str, ...] = ()


def suggest(word: str, known: Iterable[str], are: str = "known") -> str:
    """Return ``did you mean "x"?`` for the nearest known word, or the list of them when none is near."""
    known = [str(k) for k in known]
    near = difflib.get_close_matches(word, known, n=1, cutoff=0.6)
    if near:
        return f'did you mean "{cut(near[0])}"?'
    return f"{are}: {listed(map(cut, known))}"


def listed(names: Iterable[str], shown: int = 12) -> str:
    """Return the first of some names, and how many more there are."""
    every = list(names)
    return ", ".join(every[:shown]) + (f" and {len(every) - shown} more" if len(every) > shown else "")


def in_words(words: Sequence[str], comma: str = ", ") -> str:
    """Return ``a, b and c``; nothing for no words."""
    return f"{comma.join(words[:-1])} and {words[-1]}" if len(words) > 1 else "".join(words)


def columns_of(names: Sequence[str], shown: int = 12) -> str:
    """Return ``column q1``, or ``columns q1, q2``, of which there is one at least."""
    return f"column{'s' * (len(names) > 1)} {listed(names, shown)}"


def is_number(cell: Any) -> bool:
    """Return whether a cell of a table can be read as a number."""
    try:
        float(cell)
    except (TypeError, ValueError):
        return False
    return True


def describe(
    error: ErrorDetails, keys: Mapping[tuple[str, ...], Iterable[str]], others: Iterable[str], data: Mapping[str, Any]
) -> str:
    """Return ``[section] key: what is wrong; what to write`` for one pydantic error.

    ``keys`` are those that a section may have, by the path to it without list indices; ``others`` those of every other section.
    ``data`` is what the file holds: an entry of a list (a motion) is called by its name.
    """
    where = [part for part in error["loc"] if part != "[key]"]
    # Trailing indices belong to the value (joints[2]), not to the section.
    end = len(where)
    while end and isinstance(where[end - 1], int) and end > 2:
        end -= 1
    index = "".join(f"[{i}]" for i in where[end:])
    key = f"{cut(str(where[end - 1]))}{index}" if end else "the file"
    names = tuple(part for part in where[: end - 1] if isinstance(part, str))
    section = ".".join(
        cut(str(part)) if str(part).replace("_", "").isalnum() else f'"{cut(str(part))}"' for part in where[: end - 1]
    )
    if end == 2 and isinstance(where[1], int):  # the motion itself is not a table
        section, key = "", f"motion[{where[1]}]"
    place = f"[{section}] {key}" if section else key
    if end > 2 and isinstance(where[1], int) and key != "name":
        entry = data[str(where[0])][where[1]]
        name = entry.get("name") if isinstance(entry, dict) else None
        place += f' of "{cut(name)}"' if isinstance(name, str) else ""
    known = keys.get(names, others)
    return one_line(f"{place}: {_fault(error, str(where[-1]) if where else '', known)}")


def _fault(error: ErrorDetails, key: str, known: Iterable[str]) -> str:
    """Return what is wrong with one value and what to write instead."""
    given, context = _shown(error["input"]), error.get("ctx", {})
    match error["type"]:
        case "missing":
            return "is missing; write it"
        case "extra_forbidden":
            return f"unknown key; {suggest(key, known)}"
        case "literal_error":
            options = str(context["expected"]).replace(" or ", ", ").replace("'", "").split(", ")
            if len(options) == 1:
                return f"{given} is not supported; write {options[0]}"
            hint = f'write "{options[0]}"' if isinstance(error["input"], str) else f"write {options[0]}"
            near = difflib.get_close_matches(given.strip('"'), options, n=1, cutoff=0.5)
            return f"{given} is not one of {', '.join(options)}; " + (f'did you mean "{near[0]}"?' if near else hint)
        case "too_short" | "too_long" if "max_length" in context or context.get("min_length", 0) > 1:
            length = context.get("min_length", context.get("max_length"))
            return f"{given} has {context['actual_length']} numbers; write {length}"
        case "too_short" | "string_too_short":
            return "is empty; write at least one"
        case "value_error":
            return f"{given} will not do; {context['error']}"
        case "greater_than" | "greater_than_equal":
            limit = "above 0" if error["type"] == "greater_than" else "0 or more"
            return f"{given} is out of range; write a number {limit}, or leave the key out if it is not known"
        case "finite_number":
            return f"{given} is not finite; write a number"
        case kind if kind.endswith("_type") or kind.endswith("_parsing"):
            wanted = {
                "float": "a number", "int": "a whole number", "string": "a text in quotes", "list": "a list [...]",
                "bool": "true or false",
            }.get(kind.split("_")[0], "a table")  # fmt: skip
            return f"{given} is not {wanted}; write {wanted}"
        case _:
            return f"{given}: {error['msg']}"


def _shown(value: object) -> str:
    """Return a value as it stands in TOML, shortened."""
    try:
        text = json.dumps(value, ensure_ascii=False)
    except (TypeError, ValueError):  # dates, and integers of thousands of digits
        text = "a number of thousands of digits" if isinstance(value, int) else str(value)
    return cut(text, 60)


def cut(text: str, length: int = 40) -> str:
    """Return a text shortened to a length: messages name what is wrong, they do not copy files."""
    return text if len(text) <= length else text[: length - 3] + "..."


def one_line(text: str) -> str:
    """Return a text without line breaks."""
    return " ".join(text.split())
