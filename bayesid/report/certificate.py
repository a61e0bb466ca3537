"""The section on coverage in the reports of ``accuracy`` and ``identify``."""

from __future__ import annotations

import re
from typing import Any

from markupsafe import Markup
from matplotlib.figure import Figure

from bayesid.design.accuracy.certificate import CoverageCertificate
from bayesid.dynamics.base_parameters import BaseParameters
from bayesid.report.accuracy_figures import certificate_figure
from bayesid.report.page import render, svg
from bayesid.results.accuracy import coverage_text
from bayesid.results.text import number, percent

#: Where the section stands in a page.
_BEGIN, _END = "<!-- certificate -->", "<!-- end of certificate -->"


def certificate_section(certificate: CoverageCertificate | None, base: BaseParameters) -> Markup:
    """Coverage of every base parameter, with a figure; the empty place for it without a certificate."""
    text = ""
    if certificate is not None:
        figure = svg(coverage_figure(certificate, base), "certificate")
        text = render(
            "certificate.html", text=coverage_text(certificate), figure=figure, refused=certificate.refused,
            rows=_rows(certificate, base),
        )  # fmt: skip
    return Markup(f"{_BEGIN}\n{text}\n{_END}")


def with_certificate(page: str, certificate: CoverageCertificate, base: BaseParameters) -> str:
    """A page that was written before, with the section in its place; the same where there is no place for it."""
    section = str(certificate_section(certificate, base))
    return re.sub(f"{_BEGIN}.*?{_END}", lambda _: section, page, count=1, flags=re.DOTALL)


def coverage_figure(certificate: CoverageCertificate, base: BaseParameters, ax: Any = None) -> Figure:
    """Coverage of every base parameter."""
    return certificate_figure(certificate, base.short_names, ax)


def _rows(certificate: CoverageCertificate, base: BaseParameters) -> list[dict[str, Any]]:
    low, high = certificate.intervals
    return [
        {
            "index": k + 1, "label": label, "coverage": percent(certificate.coverage[k]),
            "interval": f"{percent(low[k])} … {percent(high[k])}",
            "bad": bool(certificate.coverage[k] < certificate.band[0] - 1e-12),
            "mean": number(certificate.mean_z[k], 2), "std": number(certificate.std_z[k], 3),
        }
        for k, label in enumerate(base.labels)
    ]  # fmt: skip
