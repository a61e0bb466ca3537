"""What all reports share: the page around the sections, its parts that no terminal shows, and numbers with sensible digits."""

from __future__ import annotations

import functools
import platform
from collections.abc import Mapping, Sequence
from html import escape
from importlib.metadata import version
from typing import Any

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined, Template
from markupsafe import Markup

from bayesid.robot import inertia
from bayesid.rounding import number
from bayesid.section import Html, Part, ShownSection, as_html, long, marked
from bayesid.validation.prediction import TOLERATED

#: Residuals up to so many times the noise count as fair; as good those that `TOLERATED` names.
_FAIR = 1.5
#: A page with so many sections begins with a list of them.
_LISTED = 4


def page(heading: str, kicker: str, opening: Sequence[Part], sections: Sequence[Part], title: str = "") -> str:
    """A report: heading, the line below it, what comes before the first section, and the sections; ``title`` is the window's."""
    listed = [part for part in sections if isinstance(part, ShownSection)]
    return _template().render(
        version=version("bayesid"), title=title or heading, heading=heading, kicker=kicker, opening=Markup(as_html(opening)),
        listed=listed if len(listed) >= _LISTED else (), body=Markup(as_html(sections)),
    )  # fmt: skip


def warnings(items: Sequence[str], otherwise: str = "No warnings.", title: str = "") -> Html:
    """A box with numbered warnings, or a sentence where there are none."""
    if not items:
        return Html(f'<p class="fine" id="warnings">{escape(otherwise)}</p>' if otherwise else "")
    title = title or f"{len(items)} warning{'s' if len(items) > 1 else ''}, most important first"
    listed = "".join(f"<li>{marked(item)}</li>" for item in items)
    return Html(f'<section class="warnings" id="warnings">\n<h2>{escape(title)}</h2>\n<ol>{listed}</ol>\n</section>')


def cards(items: Sequence[tuple[str, str, str]]) -> Html:
    """Numbers in large type: each with what it is, and ``good``, ``fair``, ``bad`` or nothing for its colour."""
    each = (
        f'<div class="card"><b class="{mood}">{escape(value)}</b><span>{escape(text)}</span></div>' for value, text, mood in items
    )
    return Html(f'<div class="cards">{"".join(each)}</div>')


def lead(text: str, mood: str = "") -> Html:
    """A paragraph in larger type."""
    return Html(f'<p class="{f"lead {mood}".rstrip()}">{marked(text)}</p>')


def note(text: str) -> Html:
    """A paragraph in smaller type; nothing where there is no text."""
    return Html(f'<p class="note">{marked(text)}</p>' if text else "")


def below(title: str, *parts: Part) -> Html:
    """A heading below that of the section, and what stands under it."""
    return Html(f"<h3>{escape(title)}</h3>\n{as_html(parts)}")


def figure(picture: str, caption: str) -> Html:
    """A picture as SVG, or nothing where it is empty, with what it shows."""
    return Html(f"<figure>{picture}<figcaption>{escape(caption)}</figcaption></figure>" if picture else "")


def fold(summary: str, *parts: Part, opened: bool = False) -> Html:
    """What opens when its summary is clicked."""
    return Html(f"<details{' open' * opened}><summary>{escape(summary)}</summary>{as_html(parts)}</details>")


def bullets(items: Sequence[str], *, sums: bool = False) -> Html:
    """A list, of long ``sums`` or of sentences; nothing where it is empty."""
    listed = "".join(f"<li>{long(item) if sums else marked(item)}</li>" for item in items)
    return Html(f'<ul class="plain">{listed}</ul>' if items else "")


def terms(pairs: Sequence[tuple[str, str]]) -> Html:
    """Names and what they stand for."""
    return Html("<dl>" + "".join(f"<dt>{escape(k)}</dt><dd>{escape(v)}</dd>" for k, v in pairs) + "</dl>")


def how(
    *pairs: tuple[str, str], seconds: Mapping[str, float] | float | None = None,
    packages: Sequence[str] = ("numpy", "scipy", "pin"), after: str = "", title: str = "How",
) -> ShownSection:  # fmt: skip
    """The last section: how it was done, in which time [s], in all or of every stage, and with which versions."""
    rows = [*pairs]
    if isinstance(seconds, Mapping):
        rows.append(("Run time", ", ".join(f"{stage} {number(s, 2)} s" for stage, s in seconds.items())))
    elif seconds is not None:
        rows.append(("Run time", f"{number(seconds, 3)} s"))
    versions = [f"Python {platform.python_version()}", *(f"{name} {version(name)}" for name in ("bayesid", *packages))]
    return ShownSection(title, [terms([*rows, ("Versions", ", ".join(versions))]), note(after)], "How")


@functools.cache
def _template() -> Template:
    loader = PackageLoader("bayesid.report", "templates")
    options = {"autoescape": True, "undefined": StrictUndefined, "trim_blocks": True, "lstrip_blocks": True}
    return Environment(loader=loader, **options).get_template("page.html")


def svg(figure: Any, name: str) -> Markup:
    """A matplotlib figure ready to be put into a template."""
    from bayesid.report.figures import to_svg

    return Markup(to_svg(figure, name))


def mood_of(white: float) -> str:
    """``good``, ``fair`` or ``bad`` for a residual in units of the noise."""
    return "good" if white <= TOLERATED else "fair" if white <= _FAIR else "bad"


def physical(body: np.ndarray) -> np.ndarray:
    """Mass, centre of mass and inertia about it: ten numbers, nan where there is no mass to divide by."""
    if abs(body[0]) < 1e-9:
        return np.concatenate([body[:1], np.full(9, np.nan)])
    mass, com, about = inertia.to_mass_com_inertia(body)
    size = max(float(np.sqrt(np.abs(about).max() / abs(mass))), float(np.abs(com).max()))
    about = np.where(np.abs(about) > 1e-9 * np.abs(about).max(), about, 0.0)  # rounding is no product of inertia
    com = np.where(np.abs(com) > 1e-9 * size, com, 0.0)
    return np.array([mass, *com, about[0, 0], about[0, 1], about[1, 1], about[0, 2], about[1, 2], about[2, 2]])
