"""What the KUKA case study claims, and its bootstrap against a plain loop. Skipped without the recordings."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import bayesid
from bayesid.dynamics.base_parameters import BaseParameters
from bayesid.estimators.conic.physical import Physical
from bayesid.regression.regression import PriorKnowledge
from bayesid.robot.inertia import PARAMETERS

STUDY = Path(__file__).parents[2] / "case_studies" / "kuka_lwr4"
MODULES = ("run", "present")


@pytest.fixture(scope="module")
def experiment(shared):
    return bayesid.load_experiment(shared("data/kuka-lwr4"))


@pytest.fixture(scope="module")
def found(study, experiment):
    return study.entries(experiment, study.FRICTION, ["wls", "sdp", study.PriorOnly()])


def test_physical_links_beat_cad_and_least_squares_does_not(study, experiment, found):
    for other in ("nominal", "nominal + effects"):
        assert np.quantile(study.differences(found["sdp"], found[other]), 0.975) < -0.02
    assert np.quantile(study.differences(found["wls"], found["nominal"]), 0.975) > 0
    assert np.quantile(study.differences(found["wls"], found["nominal + effects"]), 0.025) > 0
    assert not study.impossible(found["sdp"], experiment.robot)
    assert study.impossible(found["wls"], experiment.robot) and found["wls"].physically_consistent


def test_errors_are_the_comparison_s(study, found):
    for entry in found.values():
        # The study sees at most 4000 evenly picked samples of the motion.
        assert study.relative(*study.squares(entry)[:2]) == pytest.approx(entry.validation[0].relative_error, rel=1e-2)


def test_resampling_counts_are_those_of_a_loop(study):
    draws, count, length = 50, 17, 5
    counts = study.resample(count, length, draws, 3)
    starts = np.random.default_rng(3).integers(0, count, (draws, 4))
    slow = np.zeros((draws, count))
    for d in range(draws):
        for start in starts[d]:
            for k in range(length):
                slow[d, (start + k) % count] += 1
    np.testing.assert_array_equal(counts, slow)


def test_bootstrap_knows_the_spread_of_an_average(study):
    """Blocks of an autoregressive series: the standard deviation of its mean, which single samples miss."""
    rng = np.random.default_rng(0)
    noise, series = rng.normal(size=20000), np.zeros(20000)
    for k in range(1, len(series)):
        series[k] = 0.9 * series[k - 1] + noise[k]
    truth = 10.0 / np.sqrt(len(series))  # 1 / (1 - 0.9)
    blocks = study.resample(len(series), 300, 400, 1) @ series / len(series)
    assert blocks.std() == pytest.approx(truth, rel=0.2)


def test_a_part_taken_out_leaves_a_gap(study, experiment):
    less = study.without(experiment, 1, 5)
    assert len(less.motions[0].table) == pytest.approx(0.8 * len(experiment.motions[0].table), abs=1)
    assert len(less.motions[0].table.segments()) == 2
    assert less.motions[1] is experiment.motions[1]


def test_prior_alone_is_the_physical_estimate_where_the_cone_is_not_met(study):
    """One body, a nominal model that is right, some noise: both minimise the same sum."""
    nominal = np.array([2.0, 0.2, 0, 0, 0.05, 0, 0.07, 0, 0, 0.08])
    rng = np.random.default_rng(0)
    k = np.zeros((3, 10))
    k[[0, 1, 2], [1, 2, 9]] = 1.0
    base = BaseParameters(k, np.array([1, 2, 9]), tuple(f"a.{n}" for n in PARAMETERS),
                          ("mx", "my", "zz"), ("mx", "my", "zz"), ("kg m", "kg m", "kg m^2"))  # fmt: skip
    matrix = rng.normal(size=(400, 3))
    target = matrix @ k @ nominal + rng.normal(size=400)
    regression = bayesid.Regression.from_arrays(
        matrix[:, None], target[:, None], parameter_names=["mx", "my", "zz"], channel_names=["tau"], times=np.arange(400) * 0.01
    )
    knowledge = PriorKnowledge(nominal, 0.3, (tuple(range(10)),))
    regression = replace(regression, base=base, knowledge=knowledge)
    one = bayesid.fit(regression, study.PriorOnly())
    other = bayesid.fit(regression, Physical(weights="channel"))
    assert other.details.certificate
    np.testing.assert_allclose(one.values, other.values, rtol=1e-5, atol=1e-7)
