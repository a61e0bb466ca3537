"""How studies write their pages, tables and numbers, what their command lines take, and how their figures look."""

from __future__ import annotations

import argparse
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, StrictUndefined

DOCS = Path(__file__).parents[2] / "docs"
STUDIES = DOCS / "studies"  #: A folder a study: its page, README.md, its numbers, results.json, and its picture.
STYLE = {"font.size": 9, "axes.spines.top": False, "axes.spines.right": False, "axes.grid": True, "grid.alpha": 0.25}
BLUE, ORANGE, GREY, GREEN = "#1f6feb", "#d9480f", "#6b7280", "#2b8a3e"


def plain(value: Any, digits: int = 6) -> Any:
    """A result for JSON, floating-point numbers with so many significant digits."""
    if isinstance(value, dict):
        return {str(key): plain(v, digits) for key, v in value.items()}
    if isinstance(value, np.ndarray | list | tuple):
        return [plain(v, digits) for v in value]
    return float(f"{value:.{digits}g}") if isinstance(value, float | np.floating) else value


def write_numbers(result: dict[str, Any], path: Path, digits: int) -> dict[str, Any]:
    """Write a result as JSON with so many significant digits; returns it as written."""
    rounded = plain(result, digits)
    path.write_text(json.dumps(rounded, indent=1) + "\n", encoding="utf-8")
    return rounded


def write_page(template: str, path: Path, **values: Any) -> None:
    """Write a Markdown page from a template."""
    environment = Environment(undefined=StrictUndefined, trim_blocks=True, keep_trailing_newline=True, autoescape=False)
    path.write_text(environment.from_string(template).render(pct=lambda x: f"{100 * x:.1f}", **values), encoding="utf-8")


def table(head: str, rows: list[str]) -> str:
    """A Markdown table; the head's columns are separated by bars, rows are whole lines."""
    return "\n".join([f"| {head} |", "|" + " --- |" * (head.count("|") + 1), *rows])


def fill(text: str, parts: dict[str, str]) -> str:
    """Put each part between its markers, ``<!-- name -->`` and ``<!-- end -->``, on lines of its own or within a sentence."""
    for name, part in parts.items():
        pattern = rf"(<!-- {re.escape(name)} -->)(\n?).*?(<!-- end -->)"
        text, found = re.subn(pattern, lambda m, part=part: f"{m[1]}{m[2]}{part}{m[2]}{m[3]}", text, flags=re.S)
        if not found:
            raise RuntimeError(f"the page has no marker {name}")
    return text


def parsed(arguments: list[str], about: str | None, *, docs: str, count: int, of: str, seed: int) -> argparse.Namespace:
    """``count`` (recordings of each ``of``), ``seed``, ``processes`` and ``docs`` (a folder of STUDIES) from the command line."""
    parser = argparse.ArgumentParser(description=about, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=count, help=f"recordings of each {of}")
    parser.add_argument("--seed", type=int, default=seed)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--docs", type=Path, default=STUDIES / docs, help="where the page is written")
    return parser.parse_args(arguments)
