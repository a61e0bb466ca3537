"""The report of ``export``."""

from __future__ import annotations

from bayesid.report.page import how, note, page, terms, warnings
from bayesid.results.exported import Exported
from bayesid.results.files import report_of
from bayesid.rounding import channel_text, number
from bayesid.section import ShownSection, ShownTable


@report_of.register
def export_report(result: Exported) -> str:
    """The report of ``export``: which files there are, and what they do not hold."""
    rows = [
        [form, name, number(value, 4), unit]
        for form, values in result.left_out.items() for name, (value, unit) in values.items()
    ]  # fmt: skip
    left_out = ShownTable(["form", "parameter", "value", "unit"], rows, "k - n ku", "narrow")
    sections = [
        ShownSection("Files", [terms(list(result.about.items())), note(", ".join(result.texts))]),
        *([ShownSection("Identified, and not in these files", [left_out])] if rows else []),
        how(packages=("numpy", "pin")),
    ]
    kicker = f"Identified by {result.method}, from the {channel_text(result.channel)}"
    return page(f"{result.name} for other tools", kicker, [warnings(result.warnings)], sections)
