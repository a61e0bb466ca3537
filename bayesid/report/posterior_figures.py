"""Figures of `sample`: names and draws go in, a Figure comes out."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from bayesid.report.charts import CYCLE
from bayesid.report.figures import CLASSES, GREY, NOISE, add_legend, make_grid, picked, styled

_COLUMNS = 6
_BINS = 36
_RANKS = 20


@styled
def marginals(
    names: Sequence[str], draws: np.ndarray, prior: np.ndarray | None, nominal: np.ndarray | None, ax: Any = None
) -> Figure:
    """Marginal posterior of every base parameter beside its prior.

    Parameters
    ----------
    names
        Short names (r,).
    draws
        (n, r).
    prior
        Draws from the prior (m, r), or None where it is flat.
    nominal
        (r,), or None.
    """
    columns = _COLUMNS if ax is None else 1
    figure, axes = make_grid(-(-len(names) // columns), columns, 1.0, left=0.2, gap=0.22, ax=ax)
    if ax is None:
        figure.subplots_adjust(hspace=0.6)
    for k, ax in enumerate(axes.ravel()):
        if k >= len(names):
            ax.set_visible(False)
            continue
        x = draws[:, k]
        low, high = np.quantile(x, [0.001, 0.999])
        reach = 0.6 * max(high - low, 1e-12 * max(abs(high), 1.0))
        middle = 0.5 * (low + high)
        if nominal is not None and abs(nominal[k] - middle) < 3.0 * reach:
            reach = max(reach, 1.15 * abs(nominal[k] - middle))
        edges = np.linspace(middle - reach, middle + reach, _BINS + 1)
        height, _ = np.histogram(x, edges, density=True)
        ax.stairs(height, edges, fill=True, color=CYCLE[0], alpha=0.75, label="posterior")
        if prior is not None:
            # A smooth curve of the prior on its own scale: it is often much wider than the picture.
            wide, where = np.histogram(prior[:, k], 40, density=True)
            centre = 0.5 * (where[1:] + where[:-1])
            grid = np.linspace(edges[0], edges[-1], 60)
            ax.plot(grid, np.interp(grid, centre, wide, left=0.0, right=0.0), color=CLASSES["weak"], lw=1.4, label="prior")
        if nominal is not None and edges[0] <= nominal[k] <= edges[-1]:
            ax.axvline(nominal[k], color=GREY, lw=1.0, ls="--", label="nominal")
        ax.set_title(f"{names[k]}  ({k + 1})", fontsize=8)
        ax.set_yticks([])
        ax.set(xlim=(edges[0], edges[-1]), ylim=(0.0, 1.12 * height.max()))
        ax.xaxis.set_major_locator(MaxNLocator(3))
        ax.tick_params(labelsize=7, pad=1)
        ax.spines["left"].set_visible(False)
    handles: dict[str, object] = {}
    for ax in axes.ravel():
        handles |= {label: handle for handle, label in zip(*ax.get_legend_handles_labels(), strict=True)}
    add_legend(axes, list(handles.values()), list(handles))
    return figure


@styled
def predictive(
    names: Sequence[str],
    replicated: np.ndarray,
    measured: np.ndarray,
    channels: Sequence[str] | str | None = None,
    ax: Any = None,
) -> Figure:
    """Rows as they were measured, over the central 95 % of those that the posterior predicts, noise included.

    Parameters
    ----------
    names
        Of the channels (c,).
    replicated, measured
        (chains, draws, k, c), (k, c).
    channels, ax
        Which of them, and where to draw.
    """
    chosen = picked(tuple(names), channels)
    columns = 2 if len(chosen) > 1 and ax is None else 1
    figure, axes = make_grid(-(-len(chosen) // columns), columns, 1.15, sharex=True, ax=ax)
    low, high = np.quantile(replicated, [0.025, 0.975], axis=(0, 1))
    x = np.arange(len(measured))
    for k, panel in zip(chosen, axes.ravel(), strict=False):
        panel.fill_between(x, low[:, k], high[:, k], color=CYCLE[0], alpha=0.35, lw=0.0, label="95 % of predicted readings")
        panel.plot(x, measured[:, k], ".", ms=2.5, color="#334155", label="measured")
        panel.set_title(names[k])
        panel.yaxis.set_major_locator(MaxNLocator(4))
    for panel in axes.ravel()[len(chosen) :]:
        panel.set_visible(False)
    for panel in axes[-1]:
        panel.set_xlabel("row, evenly picked")
    add_legend(axes, *axes.ravel()[0].get_legend_handles_labels())
    return figure


@styled
def narrowing(groups: Sequence[tuple[str, Sequence[str], np.ndarray]], driven: float) -> Figure:
    """Posterior over prior standard deviation: what the data narrowed, and what they did not.

    Parameters
    ----------
    groups
        Title, names and ratios (k,) of each panel.
    driven
        Ratio from which a parameter counts as driven by the prior.
    """
    figure, axes = make_grid(len(groups), 1, 1.7, left=0.6)
    figure.subplots_adjust(hspace=0.85)
    for ax, (title, names, share) in zip(axes[:, 0], groups, strict=True):
        at = np.arange(len(share))
        colours = [CLASSES["weak"] if s > driven else CYCLE[0] for s in share]
        ax.bar(at, np.minimum(share, 1.1), width=0.75, color=colours, lw=0)
        ax.axhline(driven, color=CLASSES["weak"], lw=0.9, ls="--")
        ax.axhline(1.0, color=GREY, lw=0.8)
        ax.set(xlim=(-0.7, len(share) - 0.3), ylim=(0.0, 1.12), title=title, ylabel="posterior / prior std")
        ax.set_xticks(at, names, rotation=90, fontsize=6 if len(share) > 45 else 7)
        ax.grid(axis="x", visible=False)
        ax.tick_params(axis="x", length=0)
    return figure


@styled
def ranks(names: Sequence[str], draws: np.ndarray) -> Figure:
    """Ranks of each chain's draws among all: alike and level where the chains agree.

    Parameters
    ----------
    names
        Of the numbers shown (k,).
    draws
        (chains, draws, k).
    """
    chains, count, numbers = draws.shape
    figure, axes = make_grid(1, numbers, 1.5, left=0.35, gap=0.3)
    for k, ax in enumerate(axes[0]):
        order = np.argsort(np.argsort(draws[:, :, k].ravel())).reshape(chains, count)
        edges = np.linspace(0, chains * count, _RANKS + 1)
        level = count / _RANKS
        spread = 1.96 * np.sqrt(level * (1 - 1 / _RANKS))
        ax.axhspan(level - spread, level + spread, color=NOISE, alpha=0.12, lw=0, label="95 % of bars, chains alike")
        for c in range(chains):
            ax.stairs(np.histogram(order[c], edges)[0], edges, color=CYCLE[c % len(CYCLE)], lw=1.2, label=f"chain {c + 1}")
        ax.set_title(names[k] if len(names[k]) < 34 else names[k][:31] + "...", fontsize=8)
        ax.set(ylim=(0, 2.0 * level), xlim=(0, chains * count), xlabel="rank", yticks=[])
        ax.xaxis.set_major_locator(MaxNLocator(3))
    add_legend(axes, *axes[0, 0].get_legend_handles_labels())
    return figure
