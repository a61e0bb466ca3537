"""What results and reports say, once for the terminal, a notebook and a page: paragraphs, tables, and sections of them.

A paragraph is plain text in which ``**bold**`` and ```code``` are marked; it is escaped where it becomes HTML. Nothing is
marked in the cells of tables.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from typing import TypeAlias

_LONGEST_LABEL = 90
_WIDEST = 60  # first column of a table in a terminal
#: What a letter of `ShownTable.columns` stands for in the style sheet.
_STYLES = {"n": "n", "k": "k", "w": "w", "b": "sure", "d": "dim"}
#: Text, or text and the style of this cell alone, such as ``good`` or ``bad``.
Cell: TypeAlias = str | tuple[str, str]


@dataclass(frozen=True)
class ShownTable:
    """A table of a report."""

    head: Sequence[str]  # titles of the columns
    rows: Sequence[Sequence[Cell]]  # cells, as many a row as there are titles
    #: Letters for each column, separated by blanks: ``n`` a number, to the right; ``k`` never broken into lines; ``w`` wide
    #: text or a long sum, folded after its first terms; ``u`` powers of units raised; ``b`` bold; ``d`` dim; ``t`` a class of
    #: parameters, on its colour; ``-`` none of these. The first is ``k`` and all others ``n`` by default.
    columns: str = ""
    style: str = ""  # ``narrow``, as wide as its text; ``tight``, in small type; or neither
    #: Style of single rows by their index: ``rule``, a line above; ``dim``.
    marks: Mapping[int, str] = field(default_factory=dict)

    @property
    def _letters(self) -> list[str]:
        return self.columns.split() or ["k", *["n"] * (len(self.head) - 1)]

    def text(self) -> list[str]:
        """Lines for a terminal, the first column to the left, the others to the right."""
        raised = ["u" in letter for letter in self._letters]
        plain = [[cell if isinstance(cell, str) else cell[0] for cell in row] for row in self.rows]
        rows = [[powers(text) if u else text for text, u in zip(row, raised, strict=True)] for row in plain]
        cut = [[row[0] if len(row[0]) <= _WIDEST else f"{row[0][: _WIDEST - 2]} …", *row[1:]] for row in rows]
        cells = [list(self.head), *cut]
        first, *others = (max(map(len, column)) for column in zip(*cells, strict=True))
        lines = [[row[0].ljust(first), *(c.rjust(w) for c, w in zip(row[1:], others, strict=True))] for row in cells]
        return [f"  {'  '.join(line)}".rstrip() for line in lines]

    def html(self) -> str:
        """The table for a page or a notebook."""
        letters = self._letters
        styles = [[_STYLES[k] for k in letter if k in _STYLES] for letter in letters]
        head = "".join(_element("th", "n" if "n" in s else "", escape(title)) for s, title in zip(styles, self.head, strict=True))
        lines = [f"<tr>{head}</tr>"]
        for k, row in enumerate(self.rows):
            cells = []
            for letter, style, cell in zip(letters, styles, row, strict=True):
                text, own = (cell, "") if isinstance(cell, str) else cell
                shown = long(text) if "w" in letter else escape(powers(text) if "u" in letter else text)
                shown = tag(text) if "t" in letter else shown
                cells.append(_element("td", " ".join(filter(None, [*style, own])), shown))
            lines.append(_element("tr", self.marks.get(k, ""), "".join(cells)))
        return f'<div class="scroll">{_element("table", self.style, chr(10).join(lines))}</div>'


@dataclass(frozen=True)
class Html:
    """A figure, a list and what else only a page can show; a terminal leaves it out."""

    content: str


Part: TypeAlias = "str | ShownTable | Html | ShownSection"


@dataclass(frozen=True)
class ShownSection:
    """Paragraphs, tables and figures under a title."""

    title: str  # the heading
    parts: Sequence[Part]  # what stands under it; empty paragraphs are left out
    name: str = ""  # a word or two for the list of sections; the title by default

    @property
    def anchor(self) -> str:
        """What a link to it is called."""
        return re.sub(r"\W+", "-", (self.name or self.title).lower()).strip("-")


def as_text(parts: Iterable[Part]) -> list[str]:
    """Lines for a terminal: paragraphs set in by two blanks, sections with a blank line before and after."""
    lines, section = [], False
    for part in parts:
        if isinstance(part, ShownSection):
            if shown := as_text(part.parts):
                lines += ["", part.title, *shown]
        elif isinstance(part, ShownTable):
            lines += part.text()
        elif isinstance(part, str) and part:
            lines += [""] * section
            lines.append(f"  {_BOLD.sub(lambda m: m[1], part)}")
        section = isinstance(part, ShownSection) or (section and not part)
    return lines


def as_html(parts: Iterable[Part]) -> str:
    """The same as HTML."""
    out = []
    for part in parts:
        if isinstance(part, ShownSection):
            out.append(f'\n<h2 id="{part.anchor}">{escape(part.title)}</h2>\n{as_html(part.parts)}')
        elif isinstance(part, str):
            out.append(f"<p>{marked(part)}</p>" if part else "")
        else:
            out.append(part.content if isinstance(part, Html) else part.html())
    return "\n".join(filter(None, out))


#: A product such as a**2 * b**2 is not marked: marks stand at the ends of words.
_BOLD = re.compile(r"(?<![\w*)])\*\*(?=\S)(.+?)(?<=\S)\*\*(?![\w(])")


def marked(text: str) -> str:
    """Text as HTML, what is marked as bold or as code."""
    bold = _BOLD.sub(lambda m: f"<b>{m[1]}</b>", escape(text))
    return re.sub("`([^`]+)`", r"<code>\1</code>", bold)


def long(text: str) -> str:
    """A sum as HTML, folded after its first terms where it is long."""
    if len(text) <= _LONGEST_LABEL:
        return escape(text)
    terms = re.split(r"(?= [+-] )", text)
    kept = 1
    while kept < len(terms) and len("".join(terms[: kept + 1])) <= _LONGEST_LABEL - 20:
        kept += 1
    if kept == len(terms):
        return escape(text)
    first, more = escape("".join(terms[:kept])), len(terms) - kept
    return f"<details><summary>{first} … <small>({more} more terms)</small></summary>{escape(text)}</details>"


def tag(kind: str) -> str:
    """A class of parameters as HTML, on its colour."""
    return f'<span class="tag {escape(kind.replace(" ", "_"))}">{escape(kind)}</span>'


def powers(text: str) -> str:
    """A unit with its powers raised."""
    return text.replace("^2", "²").replace("^3", "³")


def _element(tag: str, style: str, content: str) -> str:
    return f'<{tag} class="{style}">{content}</{tag}>' if style else f"<{tag}>{content}</{tag}>"
