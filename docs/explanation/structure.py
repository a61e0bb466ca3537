"""Draw the packages of bayesid and what they import, and renew the tables of architecture.md.

``python docs/explanation/structure.py`` reads the imports from the code and the order of the layers from pyproject.toml, and
writes structure.svg and what stands between the marks of architecture.md. Needs grimp, which comes with import-linter.
"""

from __future__ import annotations

import ast
import re
import sys
import tomllib
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import grimp
import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch, FancyBboxPatch
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

sys.path.append(str(Path(__file__).resolve().parents[2]))
from tests.studies.page import fill

DOCS = Path(__file__).resolve().parent
ROOT = DOCS.parents[1]
PAGE, PICTURE = DOCS / "architecture.md", DOCS / "structure.svg"
SHOWN_MODULES = 8


@dataclass(frozen=True)
class Structure:
    """The code as it is.

    Attributes
    ----------
    layers
        Packages by layer, the lowest layer first.
    imports
        How many imports of modules lead from one package to another: (importer, imported) -> count.
    circles
        Groups of modules that import each other, directly or by way of others; there should be none.
    lines
        Lines of each module, by its path below the repository.
    about
        First sentence of each package's documentation.
    """

    layers: tuple[tuple[str, ...], ...]
    imports: dict[tuple[str, str], int]
    circles: tuple[tuple[str, ...], ...]
    lines: dict[str, int]
    about: dict[str, str]

    @property
    def packages(self) -> list[str]:
        """All packages, the lowest first."""
        return [name for layer in self.layers for name in layer]


def read_structure() -> Structure:
    """Read packages, imports (those for types included) and sizes from the code."""
    contract = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"]["contracts"][0]
    layers = tuple(tuple(re.split(r"\s*[|:]\s*", layer)) for layer in reversed(contract["layers"]))
    graph = grimp.build_graph("bayesid", cache_dir=None)
    modules = sorted(graph.modules)
    edges = [(a, b) for a in modules for b in graph.find_modules_directly_imported_by(a)]
    between: Counter[tuple[str, str]] = Counter()
    for pair in edges:
        one, other = ((*name.split("."), "")[1] for name in pair)
        if one and other and one != other:
            between[one, other] += 1
    files = sorted((ROOT / "bayesid").rglob("*.py"))
    lines = {f.relative_to(ROOT).as_posix(): len(f.read_text(encoding="utf-8").splitlines()) for f in files}
    names = [name for layer in layers for name in layer]
    return Structure(layers, dict(between), _circles(modules, edges), lines, {name: _about(name) for name in names})


def _circles(modules: list[str], edges: list[tuple[str, str]]) -> tuple[tuple[str, ...], ...]:
    """Strongly connected groups of more than one module."""
    place = {name: k for k, name in enumerate(modules)}
    rows, columns = np.array([(place[a], place[b]) for a, b in edges]).T
    matrix = coo_array((np.ones(len(edges)), (rows, columns)), shape=(len(modules),) * 2)
    _, label = connected_components(matrix, directed=True, connection="strong")
    groups = [tuple(modules[k] for k in np.flatnonzero(label == g)) for g in np.unique(label)]
    return tuple(group for group in groups if len(group) > 1)


def _about(name: str) -> str:
    path = ROOT / "bayesid" / name
    text = (path / "__init__.py" if path.is_dir() else path.with_suffix(".py")).read_text(encoding="utf-8")
    return (ast.get_docstring(ast.parse(text)) or "").split("\n")[0]


def tables(found: Structure) -> dict[str, str]:
    """What stands between the marks of the page, by the name of the mark."""
    rows = ["| package | what it is for | imports |", "| --- | --- | --- |"]
    for name in reversed(found.packages):
        below = [other for other in reversed(found.packages) if (name, other) in found.imports]
        link = f"../../bayesid/{name}" + ("" if (ROOT / "bayesid" / name).is_dir() else ".py")
        rows.append(f"| [`{name}`]({link}) | {found.about[name]} | {', '.join(below) or 'nothing'} |")
    folders = sum((ROOT / "bayesid" / name).is_dir() for name in found.packages)
    circles = "; ".join(" - ".join(group) for group in found.circles) or "none"
    largest = sorted(found.lines.items(), key=lambda item: -item[1])[:SHOWN_MODULES]
    counts = [
        f"- Packages at the top: {folders} (at most 16), beside {len(found.packages) - folders} modules.",
        f"- Circles among the {len(found.lines)} modules, imports for types included: {circles}.",
        f"- Lines of code, comments and documentation: {sum(found.lines.values()):,}; the middle module has "
        f"{int(np.median(list(found.lines.values())))}.",
        "- Largest modules: " + ", ".join(f"`{path.removeprefix('bayesid/')}` ({count})" for path, count in largest) + ".",
    ]
    return {"packages": "\n".join(rows), "counts": "\n".join(counts)}


def direct(found: Structure) -> list[tuple[str, str]]:
    """Imports that do not follow from others: a package to the highest of those below it."""
    below = {name: {other for one, other in found.imports if one == name} for name in found.packages}
    reached: dict[str, set[str]] = {}
    for name in found.packages:
        reached[name] = below[name].union(*(reached.get(other, set()) for other in below[name]))
    return [(one, other) for one in found.packages for other in sorted(below[one])
            if not any(other in reached.get(third, set()) for third in below[one] - {other})]  # fmt: skip


def in_words(found: Structure) -> str:
    """What the picture shows, for those who cannot see it."""
    arrows = direct(found)
    parts = [f"{name}: {', '.join(other for one, other in arrows if one == name)}" for name in reversed(found.packages)]
    return "Packages and what they import directly. " + "; ".join(part.removesuffix(": ") for part in parts)


def picture(found: Structure) -> Figure:
    """Packages as boxes on levels, each above all that it imports, with an arrow for each import that is `direct`."""
    height, width = 0.58, 1.9
    arrows = direct(found)
    level: dict[str, int] = {}
    for name in found.packages:
        level[name] = 1 + max((level.get(other, -1) for one, other in arrows if one == name), default=-1)
    rows = [[name for name in found.packages if level[name] == k] for k in range(max(level.values()) + 1)]
    centre = {name: (2.5 * (k - (len(row) - 1) / 2), float(y)) for y, row in enumerate(rows) for k, name in enumerate(row)}
    figure = Figure(figsize=(7, 0.72 * len(rows) + 0.3))
    axes = figure.add_axes((0, 0, 1, 1))
    for one, other in arrows:
        (x, y), (u, v) = centre[one], centre[other]
        far = abs(level[one] - level[other]) > 1  # past other boxes: from side to side
        side = -1.0 if x + u < 0 else 1.0
        axes.add_patch(FancyArrowPatch(
            (x + (side * width / 2 if far else 0), y - (0 if far else height / 2)),
            (u + (side * width / 2 if far else 0.25 * np.sign(x - u)), v + (0 if far else height / 2)),
            connectionstyle=f"arc3,rad={-0.35 * side if far else 0}", arrowstyle="-|>", mutation_scale=9, lw=1.0,
            color="#1f6feb" if level[one] > level[other] else "#d9480f", shrinkA=0, shrinkB=1,
        ))  # fmt: skip
    for name, (x, y) in centre.items():
        count = sum(path.startswith((f"bayesid/{name}/", f"bayesid/{name}.py")) for path in found.lines)
        axes.add_patch(FancyBboxPatch((x - width / 2, y - height / 2), width, height, boxstyle="round,pad=0,rounding_size=0.1",
                                      fc="#f6f8fa", ec="#57606a", lw=0.9, zorder=3))  # fmt: skip
        axes.text(x, y + 0.08, name, ha="center", va="center", fontsize=11, weight="bold", zorder=4)
        modules = f"{count} module{'s' * (count != 1)}"
        axes.text(x, y - 0.17, modules, ha="center", va="center", fontsize=7, color="#57606a", zorder=4)
    axes.set(xlim=(-4, 4), ylim=(-0.5, len(rows) - 0.5))
    axes.axis("off")
    return figure


def main() -> None:
    """Renew picture and page."""
    found = read_structure()
    with mpl.rc_context({"svg.hashsalt": "bayesid", "svg.fonttype": "none", "font.family": "sans-serif"}):
        picture(found).savefig(PICTURE, metadata={"Date": None, "Creator": None, "Description": in_words(found)})
    PAGE.write_text(fill(PAGE.read_text(encoding="utf-8"), tables(found)), encoding="utf-8")


if __name__ == "__main__":
    main()
