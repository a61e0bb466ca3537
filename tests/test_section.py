"""Paragraphs and tables, for a terminal and as HTML."""

from bayesid.section import Html, ShownTable, as_html, as_text, marked
from tests.report_pages import read

TABLE = ShownTable(
    ["of", "value", "unit"], [["a & b", ("2.50", "bad"), "kg m^2"], ["c", "10", "m"]], "k nb ku", "narrow", {1: "rule"}
)


def test_a_table_in_a_terminal_has_columns_of_a_width():
    assert TABLE.text() == ["  of     value   unit", "  a & b   2.50  kg m²", "  c         10      m"]
    assert ShownTable(["a", "b"], [["c" * 61, "d"]]).text()[1].split() == ["c" * 58, "…", "d"]


def test_a_table_as_html_is_styled_by_column_row_and_cell():
    html = TABLE.html()
    assert '<td class="k">a &amp; b</td><td class="n sure bad">2.50</td><td class="k">kg m²</td>' in html
    assert '<tr class="rule"><td class="k">c</td>' in html and '<table class="narrow">' in html
    read(html)


def test_marks_become_bold_and_code_and_all_else_is_escaped():
    assert marked("**No <b>:** use `a < b`") == "<b>No &lt;b&gt;:</b> use <code>a &lt; b</code>"
    assert marked("q**2 + v**2") == "q**2 + v**2" and marked("2 ** q and v ** 2") == "2 ** q and v ** 2"


def test_parts_are_the_same_in_a_terminal_and_as_html_but_for_what_only_a_page_shows():
    parts = ["**Read** this.", "", Html("<hr>"), ShownTable(["a", "b"], [["c", "d"]])]
    assert as_text(parts) == ["  Read this.", "  a  b", "  c  d"]
    assert as_html(parts).startswith("<p><b>Read</b> this.</p>\n<hr>\n<div")
