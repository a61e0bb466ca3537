"""The picture of a description: what was measured against what a term says, over the term's own variable."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from bayesid.report.figures import MEASURED, PREDICTED, add_legend, make_grid, styled

#: Points drawn of a recording, and bins of the mean.
_POINTS, _BINS = 3000, 30


@styled
def described(panels: Sequence[tuple[str, str, np.ndarray, np.ndarray, np.ndarray]]) -> Figure:
    """One panel a term.

    Parameters
    ----------
    panels
        Title, name of the variable, its values (N,), what was measured less all the rest (N,), and what the term says (N,).
    """
    figure, axes = make_grid(1, len(panels), 2.4, left=0.75, top=0.5, gap=0.6)
    for ax, (title, variable, x, measured, said) in zip(axes[0], panels, strict=True):
        thin = max(len(x) // _POINTS, 1)
        dots = {"mew": 0, "rasterized": True}
        ax.plot(x[::thin], measured[::thin], ".", ms=2.0, color=MEASURED, label="measured less all the rest", **dots)
        ax.plot(x[::thin], said[::thin], ".", ms=1.6, color=PREDICTED, label="the term", **dots)
        edges = np.quantile(x, np.linspace(0.0, 1.0, _BINS + 1))
        at = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, _BINS - 1)
        count = np.bincount(at, minlength=_BINS)
        middle, mean = (np.bincount(at, v, _BINS) / np.maximum(count, 1) for v in (x, measured))
        kept = count > 3
        ax.plot(middle[kept], mean[kept], "o", ms=3.6, color="#334155", mew=0, label="mean of what was measured")
        ax.set_title(title)
        ax.set_xlabel(variable)
    add_legend(figure, *axes[0, 0].get_legend_handles_labels())
    return figure
