"""How studies write their pages and numbers, and what their command lines take."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from jinja2 import Environment, StrictUndefined

DOCS = Path(__file__).parents[2] / "docs"


def write_numbers(result: dict[str, Any], path: Path, digits: int) -> dict[str, Any]:
    """Write a result as JSON with so many significant digits; returns it as written."""
    rounded = json.loads(json.dumps(result), parse_float=lambda text: float(f"{float(text):.{digits}g}"))
    path.write_text(json.dumps(rounded, indent=1) + "\n", encoding="utf-8")
    return rounded


def write_page(template: str, path: Path, **values: Any) -> None:
    """Write a Markdown page from a template."""
    environment = Environment(undefined=StrictUndefined, trim_blocks=True, keep_trailing_newline=True, autoescape=False)
    path.write_text(environment.from_string(template).render(pct=lambda x: f"{100 * x:.1f}", **values), encoding="utf-8")


def parsed(arguments: list[str], about: str | None, *, count: int, of: str, seed: int) -> argparse.Namespace:
    """``count`` (recordings of each ``of``), ``seed``, ``processes`` and ``docs`` from the command line."""
    parser = argparse.ArgumentParser(description=about, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=count, help=f"recordings of each {of}")
    parser.add_argument("--seed", type=int, default=seed)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--docs", type=Path, default=DOCS, help="where the page is written")
    return parser.parse_args(arguments)
