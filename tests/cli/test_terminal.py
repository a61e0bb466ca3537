"""What a terminal shows: wrapped, folded, with short warnings; what a pipe gets: the text as it is."""

import re

import click
import pytest

from bayesid.cli.terminal import folded, laid_out, say, wrapped

TABLE = """\
  value ± 95 %            ols          huber   unit
  m1 r1x        0.118 ± 0.025  0.124 ± 0.020   kg m
  I1xy          0.023 ± 0.015  0.024 ± 0.015  kg m²"""
LONG = (
    "Not excited by these motions: m1 + m2, " + ", ".join(f"m{k} r{k}x" for k in range(3, 30)) + ". Add motions that move them."
)
SHORT = "The URDF states no masses."
TITLE = "arm: 12 base parameters from the wrench of a motion with a rather long name (wls)"
TEXT = f"{TITLE}\n{TABLE}\n  warning: {LONG}\n  warning: {SHORT}\n"


class Result:
    warnings = (LONG, SHORT)

    def __str__(self) -> str:
        return TEXT


@pytest.mark.parametrize("width", [40, 60, 80, 120])
def test_no_line_is_wider_and_no_word_is_lost(width):
    lines = laid_out(TEXT, width, None).split("\n")
    assert max(map(len, lines)) <= width
    assert sorted(" ".join(lines).split()) == sorted(TEXT.split()) or width < 60
    assert lines[0].startswith("arm:") and all(line.startswith("  ") for line in lines[1:] if line)


def test_a_table_that_is_too_wide_is_folded_beside_its_first_column():
    assert folded(TABLE.split("\n"), 60) == TABLE.split("\n")
    assert folded(TABLE.split("\n"), 40) == [
        "  value ± 95 %            ols",
        "  m1 r1x        0.118 ± 0.025",
        "  I1xy          0.023 ± 0.015",
        "",
        "  value ± 95 %          huber   unit",
        "  m1 r1x        0.124 ± 0.020   kg m",
        "  I1xy          0.024 ± 0.015  kg m²",
    ]


def test_tables_one_below_the_other_are_folded_apart():
    one = ["  joint       inertia   error  gravity", "  joint1  1.72 … 2.84  0.42 %     33.2"]
    other = ["  channel  unit  pointwise ±  std", "  tau1      N m        0.095    1"]
    assert folded(one + other, 30) == [*folded(one, 30), *folded(other, 30)]
    assert max(map(len, folded(one + other, 34))) <= 34


def test_long_warnings_are_cut_and_numbered_as_in_the_report():
    shown = laid_out(TEXT, 60, Result.warnings)
    assert "warning 1: Not excited" in shown and "Add motions" not in shown and " …" in shown
    assert f"warning 2: {SHORT}" in shown
    assert shown.rstrip().endswith("in full, with what to do, in the report: warning 1")
    below = laid_out(f"{TEXT}  more: 3", 120, Result.warnings).split("\n")
    assert below[-1] == "  more: 3" and "in the report: warning 1" in below[-2]  # where the warnings end
    full = " ".join(laid_out(TEXT, 60, None).split())
    assert LONG in full and "in the report" not in full


def test_colour_changes_no_letter():
    plain, coloured = (laid_out(f"{TEXT}report: out/report.html", 80, Result.warnings, colour=c) for c in (False, True))
    assert click.unstyle(coloured) == plain and coloured != plain


def test_lines_that_follow_are_indented():
    assert wrapped("  one two three four", 12) == ["  one two", "    three", "    four"]
    assert wrapped("", 10) == [""]
    assert wrapped("a/path/that/is/longer/than/that", 10) == ["a/path/that/is/longer/than/that"]


def test_a_pipe_gets_the_text_as_it_is(capsys):
    say(Result())
    assert capsys.readouterr().out == f"{TEXT}\n"


@pytest.mark.parametrize("variable", ["NO_COLOR", None])
def test_a_terminal_gets_colour_unless_somebody_minds(variable, monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "60")
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.delenv("NO_COLOR", raising=False)
    if variable:
        monkeypatch.setenv(variable, "1")
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    say(Result())
    out = capsys.readouterr().out
    assert bool(re.search("\x1b", out)) == (variable is None)
    assert max(map(len, click.unstyle(out).split("\n"))) <= 60
