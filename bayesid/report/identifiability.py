"""The report of ``identifiability``."""

from __future__ import annotations

from functools import partial
from html import escape
from typing import Any

import numpy as np
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from bayesid.design.identifiability import ALONE, COMBINATION, EFFECT, LETTERS, NEVER, UNEXCITED, WEAK, WORDS, SetReport, by_body
from bayesid.drawing import Figures, figures_of
from bayesid.report.figures import CLASSES, GREY, list_rows, make_grid, place_legend, plain_log, styled
from bayesid.report.page import below, bullets, cards, figure, how, lead, note, page, svg, terms, warnings
from bayesid.results import identifiability as results
from bayesid.results.files import report_of
from bayesid.results.identifiability import Identifiability
from bayesid.rounding import DASH, number, percent
from bayesid.section import Html, Part, ShownSection, ShownTable, tag

#: Colour of every class, and of its letter, which tells it in print and to the colour-blind.
LOOKS = {
    ALONE: (CLASSES["alone"], "white"),
    COMBINATION: (CLASSES["combination"], "white"),
    WEAK: (CLASSES["weak"], "black"),
    EFFECT: ("#be185d", "white"),
    UNEXCITED: ("#cbd5e1", "black"),
    NEVER: ("#f8fafc", "#94a3b8"),
}
_COLUMNS = 3
_ROW = 0.2  # inches


@styled
def classes(result: Identifiability, ax: Any = None) -> Figure:
    """The class of every link parameter, a panel for each sensor set: bodies downwards, their ten parameters across."""
    reports, main, kinds = result.sensor_sets, result.main, tuple(LOOKS)
    names = [p.name for p in main.parameters]
    bodies, across = by_body(names)
    across_page = min(len(reports), _COLUMNS) if ax is None else 1
    rows = -(-len(reports) // across_page)
    longest = max(map(len, bodies))
    height = max(_ROW * len(bodies), 0.5)
    figure, axes = make_grid(rows, across_page, height, left=0.25 + 0.075 * longest, top=0.75 + 0.2 * (rows - 1), gap=0.25,
                             used=len(reports), ax=ax)  # fmt: skip
    if ax is None:
        figure.subplots_adjust(hspace=0.5 / height, top=1.0 - 0.75 / figure.get_figheight())
    for k, (report, ax) in enumerate(zip(reports, axes.ravel(), strict=False)):
        columns = len(across)
        table = np.array([kinds.index(p.kind) for p in report.parameters]).reshape(len(bodies), columns)
        colours = ListedColormap([LOOKS[kind][0] for kind in kinds])
        ax.pcolormesh(table, cmap=colours, vmin=-0.5, vmax=len(kinds) - 0.5, edgecolors="white", linewidth=1.2)
        for (i, j), kind in np.ndenumerate(table):
            ax.text(j + 0.5, i + 0.52, LETTERS[kinds[kind]], ha="center", va="center", fontsize=7.5, color=LOOKS[kinds[kind]][1])
        ax.invert_yaxis()
        ax.grid(False)
        ax.set_xticks(np.arange(columns) + 0.5, across, fontsize=7)
        ax.set_yticks(np.arange(len(bodies)) + 0.5, bodies if k % across_page == 0 else [""] * len(bodies), fontsize=8)
        ax.tick_params(length=0)
        ax.spines[:].set_visible(False)
        most = report.rank_of_any_motion
        rank = f"{report.rank}" if most in (None, report.rank) else f"{report.rank} of {most}"
        ax.set_title(f"{'● ' if report is main else ''}{report.sensor_set.title}: {rank}", fontsize=8.5)
    used = {p.kind for r in reports for p in r.parameters}
    shown = [k for k in kinds if k in used]
    handles = {f"{LETTERS[k]}: {WORDS[k]}": Patch(facecolor=LOOKS[k][0], edgecolor="#94a3b8", linewidth=0.5) for k in shown}
    place_legend(axes, handles, lines=2)
    return figure


@styled
def expected(report: SetReport, ax: Any = None) -> Figure:
    """Expected standard deviation of every combination, relative to its size where that is known, the surest first."""
    bases, names = report.base_parameters, report.shown.base.short_names
    sized = all(b.size for b in bases)
    values = np.array([b.std / b.size if sized and b.size else b.std for b in bases])
    order = np.argsort(values)
    figure, axes = make_grid(1, 1, max(0.165 * len(bases), 0.6), left=1.2, top=0.45, ax=ax)
    ax = axes[0, 0]
    colours = [CLASSES[bases[k].kind] for k in order]
    ax.barh(np.arange(len(bases)), values[order], color=colours, height=0.72, left=0.0)
    list_rows(ax, [names[int(k)] for k in order], fontsize=7.5)
    ax.set_xscale("log")
    ends = values[values > 0]
    ax.set_xlim(10 ** np.floor(np.log10(ends.min()) - 0.1), 10 ** np.ceil(np.log10(ends.max()) + 0.1))
    if sized:
        ax.axvline(1.0, color=GREY, lw=1.0, ls="--")
    ax.set_xlabel("expected standard deviation" + (" / size; dashed: as large as the body itself" if sized else " [SI units]"))
    plain_log(ax.xaxis)
    used = {b.kind for b in bases}
    place_legend(axes, {WORDS[k]: Patch(color=CLASSES[k]) for k in (ALONE, COMBINATION, WEAK) if k in used})
    return figure


_SOURCES = {
    "given": "as given", "data sheet": "the sensor's data sheet ([sensor] force_std, torque_std)", "assumed": "assumed",
    "readings": "what a fit leaves of the recorded readings, colour and model error included",
}  # fmt: skip


@report_of.register
def identifiability_report(result: Identifiability) -> str:
    """The report of ``identifiability``: an HTML page with all figures inside."""
    main, many = result.main, len(result.sensor_sets) > 1
    title = main.sensor_set.title
    sections: list[Part] = []
    if result.advice:
        sections.append(ShownSection("What would make a difference", [bullets([a.text for a in result.advice])]))
    each = ", for each sensor set; rank in the title. ● marks the readings that would be used." if many else "."
    sections.append(ShownSection("Sensors side by side" if many else "What these rows show", [
        "Rank is the number of combinations of link parameters (masses, first moments, inertias) that these motions determine "
        "at all; no motion determines more than the next column says. Better than size: of how many the expected error is "
        "smaller than the body itself. Then how many parameters are in each class, as below. * these readings would be used.",
        results.sets_table(result, counted=True),
        figure(svg(classes(result), "classes"), f"Every link parameter by what these motions show of it{each}"),
    ]))  # fmt: skip
    if result.separations:
        sections.append(ShownSection("Telling effects apart", [
            "One effect at its usual size is the truth, the other is fitted in its stead, links and all else in the model "
            "with it. Seen alone: by how many squared standard deviations the readings then differ from a model without "
            "it; left: from the best fit of the other. The probability is that the evidence rules the other out; told from: the "
            "share of the usual size from which it does so with 95 % probability.",
            results.pair_table(result),
        ]))  # fmt: skip
    drawn = svg(expected(main), "expected") if main.base_parameters else ""
    effects, unexcited = results.effect_lines(main), bullets(main.unexcited, sums=True)
    prior = any(b.prior_share is not None for b in main.base_parameters)
    sections += [
        ShownSection(f"Expected errors: {title}", [
            results.spread(main),
            figure(drawn, "Expected standard deviation of every combination, by the first parameter of each; the table has "
                          "them in full."),
            _combinations(main, prior),
            note("Of prior std: standard deviation once the data and the nominal links, as far as they are trusted, are put "
                 "together, over that of the nominal links alone; near 100 % the prior decides, not the data." if prior else ""),
            *([below("Effects in the model", terms(effects))] if effects else []),
            *([below("Combinations that another motion would show", unexcited)] if main.unexcited else []),
        ], "Expected errors"),
        ShownSection(f"Every link parameter: {title}", [
            Html("<p>" + "; ".join(f"{tag(k.replace('_', ' '))} {n} {escape(WORDS[k])}" for k, n in results.counts(main)) + ". "
                 "The standard deviation is that of the parameter itself where it is identified alone, else of the combination "
                 "that it has most of.</p>"),
            _links(result),
        ], "Every link parameter"),
        how(*_how(result), seconds=result.seconds, packages=("numpy", "pin"),
            after="All numbers, the expected covariance of each sensor set too, are in `identifiability.json`."),
    ]  # fmt: skip
    opening = [warnings(result.warnings), lead(results.answer(result)), cards(_cards(main))]
    what = {"regression": "given"}.get(result.source, result.source)
    motions = f"motion{'s' if len(result.motions) > 1 else ''} {results.motions_text(result)}"
    kicker = f"What can be determined from the {what} {motions}, before estimating"
    return page(result.name, kicker, opening, sections, f"{result.name}: identifiability")


def _cards(main: SetReport) -> list[tuple[str, str, str]]:
    most = main.rank_of_any_motion
    rank = f"{main.rank}" if most is None else f"{main.rank} of {most}"
    mood = "good" if most in (None, main.rank) else "fair"
    large = [(rank, "combinations determined, of those that any motion can show", mood)]
    if any(b.size for b in main.base_parameters):
        mood = "fair" if main.rank > main.well_known else "good"
        large.append((str(main.well_known), f"of them expected to be known better than by {results.measure(main)}", mood))
    alone = sum(p.kind == "alone" for p in main.parameters)
    large.append((f"{alone} of {len(main.parameters)}", "link parameters identified alone", ""))
    return [*large, (number(main.condition_number, 3), "condition number, columns at unit length", "")]


def _combinations(main: SetReport, prior: bool) -> ShownTable:
    sized = any(b.size for b in main.base_parameters)
    rows = []
    for k, b in enumerate(main.base_parameters):
        size = [number(b.size, 3), results.share(b.std / b.size) if b.size else DASH] if sized else []
        before = [DASH if b.prior_share is None else percent(b.prior_share, 2)] if prior else []
        rows.append([str(k + 1), b.label, number(b.std, 3), b.unit, *size, *before, b.kind])
    head = ["#", "combination", "expected ± std", "unit", *["size", "of size"] * sized, *["of prior std"] * prior, "class"]
    return ShownTable(head, rows, f"nd w nb ku{' n n' * sized}{' n' * prior} t")


def _links(result: Identifiability) -> ShownTable:
    main, rows, marks = result.main, [], {}
    for link in main.parameters:
        inside = [main.base_parameters[k] for k in link.combinations]
        better = [f"move {j}" for j in link.joints]
        # Sets come in the order of what they ask for: the first that shows more is enough.
        better += [r.sensor_set.title for r in result.sensor_sets if r.sensor_set.name in link.sensor_sets][:1]
        combination = inside[0].label if inside and inside[0].label != link.name else ""
        more = f" (and {len(inside) - 1} more)" if len(inside) > 1 else ""
        std, unit = (number(results.own_std(link, main), 3), inside[0].unit) if inside else (DASH, "")
        if link.kind == NEVER:
            marks[len(rows)] = "dim"
        rows.append([link.name, link.kind.replace("_", " "), std, unit, combination + more, ", ".join(better) or DASH])
    head = ["parameter", "class", "± std", "unit", "in which combination", "shown better by"]
    return ShownTable(head, rows, "k kt n ku w -", "tight", marks)


def _how(result: Identifiability) -> list[tuple[str, str]]:
    main = result.main
    rows = [("Noise", "; ".join(f"{k}: {_SOURCES[source]}" for k, source in main.noise.items()))]
    if main.noise_std:
        rows.append(("Standard deviation of a row", ", ".join(f"{n} {number(s, 3)}" for n, s in main.noise_std.items())))
    model = main.expected.row_model
    if model is not None:
        rows.append(("Rows", f"joint motion up to {number(model.bandwidth, 3)} Hz, {number(1.0 / model.step, 3)} rows a second"))
    if result.still:
        rows.append(("Joints that stand still", ", ".join(result.still)))
    rows += [
        ("Ranks", "of the regressor, effects projected out; a column counts from 3e-5 of its length on"),
        ("Size", "standard deviation of a combination when every body's mass distribution is uncertain by its own size"),
    ]
    return rows


@figures_of.register
def _(result: Identifiability) -> Figures:
    return {"classes": partial(classes, result), "expected": partial(expected, result.main)}
