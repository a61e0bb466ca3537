"""Formulas of the pages as MathML, which browsers draw themselves."""

from __future__ import annotations

import re
from xml.etree import ElementTree

from docutils.utils.math.latex2mathml import tex2mathml

_MATHML = "http://www.w3.org/1998/Math/MathML"

ElementTree.register_namespace("", _MATHML)


def mathml(formula: str, block: bool) -> str:
    """A formula as browsers draw it themselves: no script, no network.

    Raises
    ------
    docutils.utils.math.MathError
        For a command of TeX that docutils does not know.

    """
    formula, _, number = formula.partition(r"\tag{")
    formula = re.sub(r"(\\[td]?frac) ?(\d)(\d)", r"\1{\2}{\3}", formula)  # TeX takes digits one by one, docutils the number
    drawn = _mended(tex2mathml(formula, as_block=block))
    if not number:
        return drawn
    return f'<div class="math-wrapper">{drawn}<span class="eqno">({number.rstrip().rstrip("}")})</span></div>'


def _mended(drawn: str) -> str:
    """MathML with indices behind accented letters, overlines of any length, and names of functions apart from what follows."""
    # Not every font has an overline that stretches; a border does.
    over = r'<mover accent="false">(.*?)<mo accent="true">_</mo>\s*</mover>'
    drawn = re.sub(over, r'<mrow class="overline">\1</mrow>', drawn, flags=re.DOTALL)
    drawn = drawn.replace(' accent="true"', "")  # with it, browsers draw the dots of derivatives into the letter
    drawn = re.sub(r"<mo>&ApplyFunction;</mo>(?=\s*<m(?!o))", '<mspace width="0.17em"/>', drawn)
    root = ElementTree.fromstring(drawn.replace("&ApplyFunction;", "\u2061"))
    for both in root.iter(f"{{{_MATHML}}}munderover"):
        letter, index, accent = both
        if letter.tag.endswith("}mi") and accent.tag.endswith("}mo"):
            both.tag = f"{{{_MATHML}}}msub"
            both[:] = [ElementTree.Element(f"{{{_MATHML}}}mover"), index]
            both[0].extend([letter, accent])
    return ElementTree.tostring(root, encoding="unicode")
