"""The case studies still run and still show what they claim."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

STUDY = Path(__file__).parents[2] / "case_studies" / "liu1998"
MODULES = ("run", "present")


@pytest.fixture(scope="module")
def outcome(study):
    return study.run(seconds=16.0, repeats=0)


def test_friction_spoils_the_torques_and_not_the_wrench(outcome):
    for ways in outcome[0]["claim"].values():
        wrench = ways["base wrench"]
        assert wrench["worst_sigmas"] < 4
        assert ways["torques, no friction model"]["torque_error"] > 10 * wrench["torque_error"]
        assert ways["torques, viscous and Coulomb friction"]["torque_error"] > 10 * wrench["torque_error"]


def test_drives_do_not_change_the_wrench(outcome):
    with_friction, with_rotors = (np.array(w["base wrench"]["values"]) for w in outcome[0]["claim"].values())
    np.testing.assert_array_equal(with_friction, with_rotors)


def test_the_twelve_parameters_are_found(outcome):
    for table in (outcome[0]["twelve"], outcome[0]["printed"]["twelve"]):
        assert max(abs(row["sigmas"]) for row in table) < 4
    assert outcome[0]["verification"]["whitened_rms"] == pytest.approx(1.0, abs=0.1)


def test_the_printed_numbers_belong_to_links_that_can_exist(outcome):
    printed = outcome[0]["printed"]
    assert printed["found"]
    np.testing.assert_allclose([r["truth"] for r in printed["twelve"]], [r["paper"] for r in printed["twelve"]], atol=1e-9)


def test_forward_differences_are_half_a_sample_late(outcome):
    recipes = outcome[0]["recipes"]
    forward, middle = recipes["paper: forward difference"], recipes["the same, difference used half a sample later"]
    assert forward["bias"] > 10 * middle["bias"]
    assert recipes["bayesid, the paper's filters and ols"]["bias"] < 1e-6
    assert recipes["bayesid, default"]["bias"] < 1e-6


def test_tables_and_figures(study, outcome, tmp_path):
    results, parts = outcome
    readme = (STUDY / "README.md").read_text(encoding="utf-8")
    filled = study.fill(readme.replace("<!-- repeats -->", "<!-- none -->"), study.tables(results))
    assert "| m1 r1x |" in filled and "| base wrench |" not in filled.split("## The claim")[0]
    with pytest.raises(RuntimeError, match="no marker"):
        study.fill("", {"twelve": ""})
    study.figures(results, parts, tmp_path)
    assert {p.name for p in tmp_path.iterdir()} == {"motions.png", "figure5.png", "torques.png"}
