"""What the case studies share: tables, a README with markers, numbers for JSON and the look of figures."""

from __future__ import annotations

import re
from typing import Any

import numpy as np

STYLE = {"font.size": 9, "axes.spines.top": False, "axes.spines.right": False, "axes.grid": True, "grid.alpha": 0.25}


def table(head: str, rows: list[str]) -> str:
    """A Markdown table; the head's columns are separated by bars, rows are whole lines."""
    return "\n".join([f"| {head} |", "|" + " --- |" * (head.count("|") + 1), *rows])


def fill(text: str, parts: dict[str, str]) -> str:
    """Put each part between its markers."""
    for name, part in parts.items():
        pattern = rf"(<!-- {name} -->\n).*?(<!-- end -->)"
        text, found = re.subn(pattern, lambda m, part=part: f"{m[1]}{part}\n{m[2]}", text, flags=re.S)
        if not found:
            raise RuntimeError(f"README.md has no marker {name}")
    return text


def plain(value: Any, digits: int = 6) -> Any:
    """For JSON, with the digits that mean something."""
    if isinstance(value, dict):
        return {str(key): plain(v, digits) for key, v in value.items()}
    if isinstance(value, np.ndarray | list | tuple):
        return [plain(v, digits) for v in value]
    return float(f"{value:.{digits}g}") if isinstance(value, float | np.floating) else value
