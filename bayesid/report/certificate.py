"""The section on coverage in the reports of ``accuracy`` and ``identify``."""

from __future__ import annotations

import re
from typing import Any

from matplotlib.figure import Figure

from bayesid.design.accuracy.certificate import CoverageCertificate
from bayesid.dynamics.base_parameters import BaseParameters
from bayesid.report.accuracy_figures import certificate_figure
from bayesid.report.page import figure, fold, svg
from bayesid.results.accuracy import coverage_text
from bayesid.results.text import number, percent
from bayesid.section import Html, Part, ShownSection, ShownTable, as_html

#: Where the section stands in a page.
_BEGIN, _END = "<!-- certificate -->", "<!-- end of certificate -->"


def certificate_section(certificate: CoverageCertificate | None, base: BaseParameters) -> list[Part]:
    """Coverage of every base parameter, with a figure; the empty place for it without a certificate."""
    if certificate is None:
        return [Html(_BEGIN), Html(_END)]
    more = f" {certificate.refused} more twins could not be fitted." if certificate.refused else ""
    section = ShownSection(
        "Coverage certificate",
        [
            coverage_text(certificate) + more,
            figure(
                svg(coverage_figure(certificate, base), "certificate"),
                "Dots: share of 95 % intervals that held the truth; strokes: its own 95 % interval. Green band: where exact "
                "intervals of all parameters lie together with a probability of 99 %.",
            ),
            fold("Every base parameter", _table(certificate, base)),
        ],
        "Certificate",
    )
    return [Html(_BEGIN), section, Html(_END)]


def with_certificate(page: str, certificate: CoverageCertificate, base: BaseParameters) -> str:
    """A page that was written before, with the section in its place; the same where there is no place for it."""
    section = as_html(certificate_section(certificate, base))
    return re.sub(f"{_BEGIN}.*?{_END}", lambda _: section, page, count=1, flags=re.DOTALL)


def coverage_figure(certificate: CoverageCertificate, base: BaseParameters, ax: Any = None) -> Figure:
    """Coverage of every base parameter."""
    return certificate_figure(certificate, base.short_names, ax)


def _table(certificate: CoverageCertificate, base: BaseParameters) -> ShownTable:
    low, high = certificate.intervals
    rows = [
        [
            str(k + 1), label, (percent(share), "bad" if share < certificate.band[0] - 1e-12 else ""),
            f"{percent(low[k])} … {percent(high[k])}", number(certificate.mean_z[k], 2), number(certificate.std_z[k], 3),
        ]
        for k, (label, share) in enumerate(zip(base.labels, certificate.coverage, strict=True))
    ]  # fmt: skip
    return ShownTable(
        ["#", "base parameter", "coverage", "95 % interval", "mean error [σ]", "scatter [σ]"], rows, "nd w nb n n n"
    )
