"""Simulation-based calibration: its own arithmetic, a few runs, and the whole study where there is time."""

from __future__ import annotations

import json

import numpy as np
import pytest

from tests.studies import sbc


def test_uniform_ranks_leave_their_band_as_often_as_stated():
    rng = np.random.default_rng(0)
    ranks = rng.integers(0, sbc.DRAWS + 1, (200, 3000))
    p = sbc.probabilities(ranks)
    assert abs(np.mean(p < 0.1) - 0.1) < 4 * np.sqrt(0.09 / 3000)
    assert np.mean(p < 0.01) < 0.02
    low, high = sbc.band(200, 0.99)
    z = np.arange(1, sbc.DRAWS + 1) / (sbc.DRAWS + 1)
    ecdf = np.array([np.cumsum(np.bincount(r, minlength=sbc.DRAWS + 1))[:-1] for r in ranks.T]) / 200 - z
    inside = np.all((ecdf >= low - 1e-12) & (ecdf <= high + 1e-12), axis=1)
    assert abs(inside.mean() - 0.99) < 0.01


@pytest.mark.parametrize("wrong", ["narrow", "shifted"])
def test_wrong_posteriors_are_seen(wrong):
    """Draws a quarter too narrow, or a third of their spread off: far outside the band."""
    rng = np.random.default_rng(1)
    truth = rng.normal(size=(500, 1))
    draws = rng.normal(size=(500, sbc.DRAWS)) * (0.75 if wrong == "narrow" else 1.0) + (0.33 if wrong == "shifted" else 0.0)
    assert sbc.probabilities(np.sum(draws < truth, axis=1)[:, None])[0] < 1e-3


@pytest.mark.parametrize("name", [pytest.param("ur5-active", marks=pytest.mark.slow), "panda-inactive"])
def test_a_few_runs_lie_in_the_band(name):
    ranks = sbc.run(name, 12, 31, processes=1)
    assert ranks.shape == (12, len(sbc.names_of(name))) and ranks.min() >= 0 and ranks.max() <= sbc.DRAWS
    assert np.all(sbc.probabilities(ranks) > 1e-5)


def test_truths_are_possible_bodies_and_page_is_written(tmp_path):
    case = sbc.setup("ur5-active")
    links, effects, scales, _ = sbc.draw_truth(case, np.random.default_rng(0))
    assert np.linalg.eigvalsh(sbc.inertia.pseudo_inertia(links.reshape(-1, 10))).min() > 0
    assert effects.min() >= 0 and scales.min() > 0
    ranks = np.random.default_rng(0).integers(0, sbc.DRAWS + 1, (20, len(sbc.names_of("ur5-active"))))
    sbc.write({"seed": 0, "runs": 20, "cases": {"ur5-active": sbc.summarise("ur5-active", ranks)}}, tmp_path)
    assert {p.name for p in tmp_path.iterdir()} == {"results.json", "README.md", "sbc.png"}


@pytest.mark.slow
def test_the_whole_study_is_calibrated_and_is_the_page_shown():
    result = sbc.study(folder=sbc.kept())
    shown = json.loads((sbc.FOLDER / "results.json").read_text(encoding="utf-8"))
    for name, case in result["cases"].items():
        assert case["smallest_probability"] > case["family_limit"], name
        assert len(case["outside"]) <= 0.05 * case["quantities"], name
        assert abs(case["mean_rank"] - shown["cases"][name]["mean_rank"]) < 0.01
