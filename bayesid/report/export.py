"""The report of ``export``."""

from __future__ import annotations

from bayesid.report.page import render, versions
from bayesid.results.exported import Exported
from bayesid.results.text import channel_text, number


def export_report(result: Exported) -> str:
    """The report of ``export``: which files there are, and what they do not hold."""
    rows = [
        (form, name, number(value, 4), unit)
        for form, values in result.left_out.items() for name, (value, unit) in values.items()
    ]  # fmt: skip
    return render(
        "export.html", name=result.name, method=result.method, channel=channel_text(result.channel),
        about=list(result.about.items()), rows=rows, warnings_list=result.warnings, files=list(result.texts),
        how=[versions("numpy", "pin")],
    )  # fmt: skip
