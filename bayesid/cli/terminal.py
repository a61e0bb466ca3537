"""What verbs print: on a terminal wrapped to its width, with colour and with short warnings; elsewhere the text as it is."""

from __future__ import annotations

import os
import re
import shutil
import sys
import textwrap
from collections.abc import Sequence
from itertools import groupby
from typing import TextIO

import click

#: Sentences are hard to read in lines that are longer.
_WIDEST = 120
#: A warning takes so many lines on a terminal, about; the rest of it is in the report.
_LINES = 2
_WARNING = re.compile(r"^( *)warning: (.*)$")


def say(result: object, numbered: Sequence[str] | None = None) -> None:
    """Print a result, or a line of text, warnings as its report has ``numbered`` them, default its own; others in full."""
    text = str(result)
    if not sys.stdout.isatty():
        click.echo(text)
        return
    listed = getattr(result, "warnings", None) if numbered is None else numbered
    width = min(shutil.get_terminal_size().columns, _WIDEST)
    colour = colours(sys.stdout)
    click.echo(laid_out(text, width, listed, colour=colour), color=colour)


def colours(stream: TextIO) -> bool:
    """Whether a stream shows colours, and the user wants them (https://no-color.org)."""
    return stream.isatty() and not os.environ.get("NO_COLOR") and os.environ.get("TERM") != "dumb"


def laid_out(text: str, width: int, numbered: Sequence[str] | None = None, *, colour: bool = False) -> str:
    """Text for a terminal of so many columns: sentences, one a line, and tables, whose columns are two blanks apart at least.

    Warnings that the report has ``numbered`` are cut short here. ``colour`` is for the first line, warnings, and the words
    before a path.
    """
    out: list[str] = []
    shortened: list[int] = []
    after = 0  # the last warning
    for is_table, lines in groupby(text.split("\n"), lambda line: re.search(r"\S {2,}\S", line) is not None):
        if is_table:
            out += folded(list(lines), width)
            continue
        for line in lines:
            if found := _WARNING.match(line):
                number = 1 + list(numbered).index(found[2]) if numbered and found[2] in numbered else None
                rest = found[2] if number is None else _short(found[2], _LINES * width - len(found[1]) - 14)
                if number is not None and rest != found[2]:
                    shortened.append(number)
                head = f"{found[1]}warning{'' if number is None else f' {number}'}:"
                new = wrapped(f"{head} {rest}", width)
                new[0] = _coloured(new[0], head, "yellow") if colour else new[0]
                after = len(out) + len(new)
            else:
                new = wrapped(line, width)
                head = re.match(r"^[a-z ]+:(?= \S+$)", line)
                if colour and head:
                    new[0] = _coloured(new[0], head[0], "green")
                elif colour and not out and not line.startswith(" "):
                    new = [click.style(each, bold=True) for each in new]
            out += new
    if shortened:
        which = ", ".join(map(str, sorted(shortened)))
        out[after:after] = wrapped(
            f"  in full, with what to do, in the report: warning{'s' * (len(shortened) > 1)} {which}", width
        )
    return "\n".join(out)


def wrapped(line: str, width: int) -> list[str]:
    """A line of words in lines of a width, those that follow with a deeper indent."""
    indent = len(line) - len(line.lstrip())
    deeper = " " * (indent + 2)
    # A number stays with its unit or sign.
    held = re.sub(r"(?<=\d) (?=[^\W\d]|%)", "\u00a0", line.strip()).replace(" ± ", "\u00a0±\u00a0")
    lines = textwrap.wrap(
        held, width, initial_indent=" " * indent, subsequent_indent=deeper, break_long_words=False, break_on_hyphens=False
    )
    return [each.replace("\u00a0", " ") for each in lines] or [""]


def folded(lines: list[str], width: int) -> list[str]:
    """A table of a width at most: columns that are too many follow below, beside the first one again."""
    if max(map(len, lines)) <= width:
        return lines
    for k in range(2, len(lines) - 1):  # two tables one below the other have no columns in common
        if len(_columns(lines[:k])) > len(_columns(lines)) < len(_columns(lines[k:])):
            return [*folded(lines[:k], width), *folded(lines[k:], width)]
    first, *others = _columns(lines)
    longest = max(map(len, lines))
    padded = [line.ljust(longest) for line in lines]
    out: list[str] = []
    while others:
        taken, room = [others.pop(0)], width - first[1]
        room -= 2 + taken[0][1] - taken[0][0]
        while others and room >= 2 + others[0][1] - others[0][0]:
            taken.append(others.pop(0))
            room -= 2 + taken[-1][1] - taken[-1][0]
        out += [""] * bool(out)
        out += ["  ".join([line[: first[1]], *(line[a:b] for a, b in taken)]).rstrip() for line in padded]
    return out or lines


def _columns(lines: list[str]) -> list[tuple[int, int]]:
    """Where columns begin and end, which two blanks in every line keep apart; the first begins with the line."""
    longest = max(map(len, lines))
    padded = [line.ljust(longest) for line in lines]
    indent = min(len(line) - len(line.lstrip()) for line in lines)
    blank = "".join(" " if k >= indent and all(line[k] == " " for line in padded) else "x" for k in range(longest))
    return [found.span() for found in re.finditer(r"x(?:x| (?! ))*", blank)]


def _short(text: str, room: int) -> str:
    """The first sentence of a text, or as much of it as there is room for."""
    sentence = re.split(r"(?<=[.!?])\s+(?=[A-Z\"'])", text, maxsplit=1)[0]
    return sentence if len(sentence) <= room else textwrap.shorten(sentence, max(room, 20), placeholder=" …")


def _coloured(line: str, head: str, colour: str) -> str:
    return line.replace(head, click.style(head, fg=colour), 1)
