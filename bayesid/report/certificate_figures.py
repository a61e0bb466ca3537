"""The figure of a coverage certificate."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from bayesid.design.accuracy.certificate import Certificate
from bayesid.dynamics.base_parameters import BaseParameters
from bayesid.estimators.estimator import LEVEL
from bayesid.report.figures import GREY, NOISE, make_grid, styled
from bayesid.report.notation import short_names

_BLUE, _BAD = "#1d4ed8", "#b91c1c"
_NAMED = 48


@styled
def certificate_figure(certificate: Certificate, base: BaseParameters) -> Figure:
    """Coverage of each base parameter with its 95 % interval, beside the band of exact intervals."""
    short = short_names(base)
    below = 0.45 if base.rank > _NAMED else 0.3 + 0.072 * max(map(len, short))
    figure, axes = make_grid(1, 1, 2.2, top=0.35)
    total = 0.35 + 2.2 + below
    figure.set_size_inches(10.4, total)
    figure.subplots_adjust(top=1 - 0.35 / total, bottom=below / total)
    ax = axes[0, 0]
    x = np.arange(base.rank)
    low, high = 100 * certificate.intervals
    share = 100 * certificate.coverage
    band = 100 * np.array(certificate.band)
    ax.axhspan(*band, color=NOISE, alpha=0.14, lw=0)
    ax.axhline(100 * LEVEL, color=GREY, lw=0.8)
    known = np.isfinite(share)
    bad = known & (share < band[0] - 1e-9)
    for part, colour in ((known & ~bad, _BLUE), (bad, _BAD)):
        ax.vlines(x[part], low[part], high[part], color=colour, lw=1.5, alpha=0.5)
        ax.plot(x[part], share[part], "o", ms=4, color=colour)
    shown = np.concatenate([low[known], band])
    ax.set_ylim(max(float(shown.min(initial=90.0)) - 1.0, 0.0), 100.6)
    ax.set_xlim(-0.7, base.rank - 0.3)
    if base.rank > _NAMED:
        ax.set_xlabel("base parameter, numbers as in the table")
    else:
        ax.set_xticks(x, short, rotation=90, fontsize=7.5)
    ax.grid(axis="x", visible=False)
    ax.set_title(f"Intervals that held the truth, of {certificate.twins} twins [%]")
    return figure
