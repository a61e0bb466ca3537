"""The picture of a description: what was measured against what a term says, over the term's own variable."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from bayesid.report.figures import MEASURED, PREDICTED, add_legend, make_grid, styled

#: Points drawn of a recording.
_POINTS = 3000


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
        ax.plot(x[::thin], measured[::thin], lw=1.8, color=MEASURED, rasterized=True, label="measured less all the rest")
        ax.plot(x[::thin], said[::thin], lw=0.9, color=PREDICTED, rasterized=True, label="the term")
        ax.set_title(title)
        ax.set_xlabel(variable)
    add_legend(axes, *axes[0, 0].get_legend_handles_labels())
    return figure
