"""The documentation as web pages: ``make docs``. The source is the repository itself, so that links work there and here alike."""

from __future__ import annotations

import inspect
import re
import sys
from importlib.metadata import version as version_of
from pathlib import Path

from docutils.nodes import SkipNode
from docutils.utils.math import MathError
from sphinx.errors import ExtensionError

import bayesid

sys.path.insert(0, str(Path(__file__).parent))
from formulas import mathml  # noqa: E402

project = "bayesid"
author = "The bayesid developers"
copyright = "the bayesid developers"
version = release = version_of("bayesid")

root_doc = "docs/index"
include_patterns = ["README.md", "docs/**", "case_studies/*/README.md"]
extensions = ["myst_nb", "numpydoc", "sphinx.ext.autosummary"]

myst_enable_extensions = ["amsmath", "dollarmath"]
myst_heading_anchors = 4
nb_execution_mode = "cache"  # of docs/notebooks; code blocks of other pages are run by the tests
nb_execution_cache_path = str(Path(__file__).parents[1] / "build" / "jupyter_cache")
nb_execution_in_temp = True
nb_execution_raise_on_error = True
nb_execution_timeout = 120
nb_output_stderr = "remove"  # progress
# Sources that only docstrings of the inside name.
suppress_warnings = ["ref.citation"]

autosummary_generate = True
autodoc_typehints = "none"  # the docstrings say shapes and units, which annotations do not
numpydoc_show_class_members = False
numpydoc_class_members_toctree = False

html_math_renderer = "mathml"
html_theme = "pydata_sphinx_theme"
html_title = "bayesid"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_show_sourcelink = False
html_theme_options = {"show_toc_level": 2, "navigation_with_keys": False, "secondary_sidebar_items": ["page-toc"]}


def _mathml(node, block: bool) -> str:
    try:
        return mathml(node.astext(), block)
    except MathError as error:
        raise ExtensionError(f"formula {node.astext()!r}: {error}") from None


def _inline(self, node) -> None:
    self.body.append(_mathml(node, block=False))
    raise SkipNode


def _display(self, node) -> None:
    self.body.append(_mathml(node, block=True))
    raise SkipNode


def _contents(app, page: str, source: list[str]) -> None:
    """Give an index the pages that it links to as the pages below it, in that order; the root has the README and the indices."""
    if page.endswith("/index"):
        links = list(dict.fromkeys(re.findall(r"\]\(([\w/.-]+)\.md\)", source[0])))
        if page == root_doc:
            links = ["The first minute <../README>", *(link for link in links if link.endswith("/index"))]
        if page == "docs/reference/index":
            links.append("api")
        source[0] += "\n".join(["", "```{toctree}", ":hidden:", *links, "```"])


def _folders(app, page: str, source: list[str]) -> None:
    """Where a page links to a package, which a browser of files opens, the site has the file that says what it is for."""
    here = (Path(app.srcdir) / page).parent
    source[0] = re.sub(
        r"\]\((\.[\w/.-]+)\)", lambda m: f"]({m[1]}/__init__.py)" if (here / m[1] / "__init__.py").is_file() else m[0], source[0]
    )


def setup(app) -> None:
    """Draw formulas, make the tree of pages, and mend links to packages."""
    app.add_html_math_renderer("mathml", (_inline, None), (_display, None))
    app.connect("source-read", _contents)
    app.connect("source-read", _folders)


def _reference() -> str:
    """The page of the public names, what is called first: what ``bayesid`` exports stands there."""
    named = {name: getattr(bayesid, name) for name in sorted(bayesid.__all__)}
    for module, holder in [(name, value) for name, value in named.items() if inspect.ismodule(value)]:
        named |= {f"{module}.{name}": getattr(holder, name) for name in holder.__all__}
    lines = ["Python reference", "=" * 16, "", "Everything that ``bayesid`` exports.", ""]
    for title, belongs in (("Functions", inspect.isroutine), ("Classes", inspect.isclass)):
        lines += [title, "-" * len(title), "", ".. currentmodule:: bayesid", "", ".. autosummary::", "   :toctree: api", ""]
        lines += [f"   {name}" for name, value in named.items() if belongs(value)] + [""]
    pages = (Path(__file__).parent / "reference" / "references.md").read_text(encoding="utf-8")
    sources = re.findall(r"^\*\*\[(\w+)\]\*\* (.+?)(?=\n\n|\Z)", pages, re.MULTILINE | re.DOTALL)
    lines += ["Sources", "-------", "", *(f".. [{key}] {' '.join(text.split())}" for key, text in sources), ""]
    return "\n".join(lines)


(Path(__file__).parent / "reference" / "api.rst").write_text(_reference(), encoding="utf-8")
