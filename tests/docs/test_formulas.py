"""Formulas of the pages can be drawn: one that ``make docs`` does not know stops it."""

from __future__ import annotations

import re
import runpy
from pathlib import Path
from xml.etree import ElementTree

import pytest
from docutils.utils.math import MathError

ROOT = Path(__file__).parents[2]
PAGES = [
    p
    for p in (ROOT / "README.md", *ROOT.glob("docs/**/*.md"), *ROOT.glob("case_studies/*/README.md"))
    if "$" in p.read_text("utf-8")
]


@pytest.fixture(scope="module")
def mathml():
    return runpy.run_path(str(ROOT / "docs" / "formulas.py"))["mathml"]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_formula_is_drawn(page, mathml):
    text = re.sub(r"```.*?```|`[^`\n]+`", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    blocks = re.findall(r"\$\$(.+?)\$\$", text, re.DOTALL)
    inline = re.findall(r"\$(\S(?:[^$]*?\S)?)\$", re.sub(r"\$\$.+?\$\$", "", text, flags=re.DOTALL))
    assert blocks or inline or "$" not in text
    for formula in [*blocks, *inline]:
        try:
            mathml(" ".join(formula.split()), formula in blocks)
        except MathError as error:
            pytest.fail(f"{formula}: {error}")


def test_what_the_site_mends_of_mathml(mathml):
    """Digits of a fraction one by one, as TeX takes them; an index behind an accented letter; a number beside its formula."""
    half = ElementTree.fromstring(mathml(r"\tfrac12", block=False))
    fraction = next(e for e in half.iter() if e.tag.endswith("}mfrac"))
    assert [e.text for e in fraction.iter() if e.tag.endswith("}mn")] == ["1", "2"]
    assert mathml(r"a = b \tag{1}", block=True).endswith('<span class="eqno">(1)</span></div>')
    with pytest.raises(MathError):
        mathml(r"\Big( x \Big)", block=True)
