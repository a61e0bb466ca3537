"""What takes over two seconds shows its stages, in scripts and notebooks; nothing else does."""

import inspect
import sys
import time

import pytest

import bayesid
from bayesid.workflows import progress
from bayesid.workflows.progress import SHOWN, quiet, shows_progress

VERBS = ["accuracy", "bounds", "calibrate", "check", "compare", "diagnose", "excite", "export", "identifiability", "identify",
         "payload", "sample", "tell", "watch"]  # fmt: skip


@shows_progress
def work(stages, progress=SHOWN):
    """Takes a twentieth of a second a stage."""
    for stage in stages:
        (progress or quiet)(stage)
        time.sleep(0.05)
    return len(stages)


@pytest.mark.parametrize("name", VERBS)
def test_every_verb_shows_its_stages_by_itself(name):
    verb = getattr(bayesid, name)
    assert inspect.signature(verb).parameters["progress"].default is SHOWN
    assert verb.__wrapped__.__doc__ == verb.__doc__


def test_an_argument_that_a_verb_does_not_have_is_told_with_its_name():
    with pytest.raises(TypeError, match=r"^identify\(\) got an unexpected keyword argument 'filter_l'$"):
        bayesid.identify("my-arm", filter_l=10.0)


def test_what_takes_longer_is_shown_a_line_a_stage(monkeypatch, capsys):
    monkeypatch.setattr(progress, "DELAY", 0.02)
    monkeypatch.setattr(progress, "_REFRESHED", 0.005)
    assert work(["reading", *["rivals"] * 20, "verdict"]) == 22
    shown = capsys.readouterr().err
    assert shown.count("work: rivals") == 1 and "work: verdict" in shown and shown.endswith("\n")
    assert work(["reading"], None) == work(["reading"], quiet) == work(["reading"], progress=None) == 1
    assert capsys.readouterr().err == ""


def test_what_is_quick_shows_nothing(capsys):
    work(["reading", "rivals"])
    assert capsys.readouterr() == ("", "")


def test_on_a_terminal_the_time_goes_by_and_the_line_is_cleared(monkeypatch, capsys):
    monkeypatch.setattr(progress, "DELAY", 0.01)
    monkeypatch.setattr(progress, "_REFRESHED", 0.005)
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    work(["reading", "rivals"])
    shown = capsys.readouterr().err
    assert shown.count("work: rivals") > 1 and shown.endswith("\r")


def test_the_display_ends_with_an_error(monkeypatch, capsys):
    monkeypatch.setattr(progress, "DELAY", 0.01)

    @shows_progress
    def fails(progress=SHOWN):
        progress("reading")
        time.sleep(0.05)
        raise bayesid.InputError("no")

    with pytest.raises(bayesid.InputError, match="no"):
        fails()
    before = capsys.readouterr().err
    time.sleep(0.6)
    assert "fails: reading" in before and capsys.readouterr().err == ""


def test_a_callable_of_ones_own_is_told_instead():
    told = []
    assert work(["reading", "rivals"], progress=told.append) == 2
    assert told == ["reading", "rivals"]
