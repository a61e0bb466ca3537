"""What reports register for results, such as figures, found when it is first asked for."""

from __future__ import annotations

import functools
import importlib
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, ClassVar, TypeAlias, TypeVar

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_T = TypeVar("_T")
#: Functions that draw, by what they show.
Figures: TypeAlias = Mapping[str, Callable[..., Any]]


def registered_by_report(function: Callable[[Any], _T]) -> functools._SingleDispatchCallable[_T]:
    """A function of a result that each module of `bayesid.report` registers for the types that it is about.

    So results need to know nothing of reports and figures. The module is loaded where it is not yet: the result names it in
    ``report``.
    """

    @functools.singledispatch
    @functools.wraps(function)
    def dispatched(result: Any) -> _T:
        if report := getattr(type(result), "report", ""):
            importlib.import_module(f"bayesid.report.{report}")
        found = dispatched.dispatch(type(result))
        return (function if found is dispatched.dispatch(object) else found)(result)

    return dispatched


@registered_by_report
def figures_of(result: object) -> Figures:
    """Functions that draw a result's figures, by what they show; the first is that of ``plot()``."""
    raise TypeError(f"{type(result).__name__} has no figures: no module of bayesid.report registers them")


class Plots:
    """What can be drawn.

    Attributes
    ----------
    report
        The module of `bayesid.report` that registers its figures.
    """

    report: ClassVar[str] = ""

    def plot(self, *, ax: Any = None) -> Figure:
        """Draw the figure that says most.

        Parameters
        ----------
        ax
            matplotlib's Axes to draw into, one for each panel; default a figure of its own.

        Returns
        -------
        Figure
            matplotlib's; a notebook shows it, ``savefig`` keeps it.

        Raises
        ------
        InputError
            There is nothing to draw, or there are fewer or more axes than panels.
        """
        return next(iter(figures_of(self).values()))(ax=ax)
