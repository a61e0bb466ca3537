"""The hidden hose is still found; README and figures belong to results.json; what the other studies claim is in it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

STUDY = Path(__file__).parents[2] / "case_studies" / "diagnosis"
MODULES = ("run", "present", "arms", "cases", "draws", "motions", "plant", "practice", "sizes", "judge")


@pytest.fixture(scope="module")
def results():
    return json.loads((STUDY / "results.json").read_text(encoding="utf-8"))


def test_readme_s_numbers_are_those_of_the_results(study, results):
    text = (STUDY / "README.md").read_text(encoding="utf-8")
    assert study.fill(text, study.tables(results)) == text
    assert "<!-- end -->" in text and set(results) == {"hose", "robot", "wrist", "failure"}


def test_every_figure_is_there_and_shown(study):
    text = (STUDY / "README.md").read_text(encoding="utf-8")
    for name in study.FIGURES:
        assert (STUDY / f"{name}.png").stat().st_size > 10_000
        assert f"({name}.png)" in text


@pytest.mark.slow
def test_the_hose_is_found_and_the_base_parameters_put_right(study, results):
    found = study.plain(study.hose())
    assert found["verdict"] == "named" and found["named"] == ["tether@joint2"]
    for p in found["parameters"]:
        assert abs(p["value"] - p["truth"]) < 4 * p["std"]
    assert found["gap"]["before"] > 10 and found["gap"]["after"] < 1.1 * found["gap"]["floor"]
    assert max(abs(r["sigmas"]) for r in found["base_before"]) > 20
    assert max(abs(r["sigmas"]) for r in found["base_after"]) < 4
    again, printed = ([p["value"] for p in r["parameters"]] for r in (found, results["hose"]))
    assert again == pytest.approx(printed, rel=0.02, abs=2e-3)


def test_a_curved_reading_is_caught_when_it_is_large(results):
    """Small it gets a wrong name, large one in part at most, beside a gap that stays open: the case study says so."""
    largest = [c for c in results["failure"] if c["size"] == max(c["size"] for c in results["failure"])]
    assert {c["verdict"] for c in largest} <= {"unknown", "named_in_part"}
    assert all(c["gap"]["after"] > 2.0 * c["gap"]["floor"] for c in largest)
    assert any(c["named"] for c in results["failure"])


def test_where_the_real_arms_floors_come_from_is_said(results):
    """The KUKA repeats its motions; the UR10's readings were filtered, and nothing repeats. Rigid bodies lack friction."""
    sources = {name: {(c["floor_known"], c["floor_source"]) for c in cases.values()} for name, cases in results["robot"].items()}
    assert sources == {"kuka-lwr4": {(True, "repeats")}, "ur10": {(False, "richest model")}}
    for cases in results["robot"].values():
        assert {c["verdict"] for c in cases.values()} == {"named_in_part"}
        assert cases["friction"]["named"] == cases["rigid"]["named"]  # what is stated of friction is left out and sought anew
        assert cases["rigid"]["gap"]["after"] < 0.2 * cases["rigid"]["gap"]["before"]
        assert any("friction" in name for name in cases["rigid"]["named"])


def test_real_taps_are_what_student_rejects(study, results, shared):
    """Windows that `student` rejects hold a tap that `diagnose` finds, in the accelerometer's three loudest quarter seconds."""
    import numpy as np
    import pandas as pd

    import bayesid

    folder = shared("data/kuka-med-wrist")
    robust = bayesid.identify(folder, motions=["vibrations"], method="student")
    table = pd.read_csv(folder / "vibrations.csv")
    edges = np.searchsorted(table["t"].to_numpy(), np.arange(0.0, 6.25, 0.25))
    loud = np.argsort(study.jolts(table, edges))[::-1][:3] * 0.25
    rejected = robust.estimate.details.rejected_windows["vibrations"]
    assert rejected
    for start, end in rejected:
        assert any(start < at + 0.25 and end > at for at in loud)
        assert any(start < at < end for at in results["wrist"]["vibrations"]["events"])
