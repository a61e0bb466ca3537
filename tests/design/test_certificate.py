"""Coverage on twins: counted as it is, bad intervals found out, nothing lost by an interruption."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom

from bayesid.design.accuracy.bench import Bench
from bayesid.design.accuracy.certificate import SIMULTANEOUS, certify
from bayesid.errors import InputError
from bayesid.estimators import estimator
from tests.design.test_accuracy import bench


def quiet(_: str) -> None:
    return None


class TooSure:
    """Least squares with standard deviations half as long as they should be."""

    name = "too sure"

    def fit(self, regression):
        found = estimator("wls").fit(regression)
        return replace(found, method=self.name, full_covariance=0.25 * found.full_covariance)


@pytest.fixture(scope="module")
def own() -> Bench:
    return bench("puma")


@pytest.mark.slow
def test_intervals_hold_the_truth_and_the_counts_are_those_of_the_band(own):
    found = certify(own, 40, 0, quiet)
    assert found.twins == 40 and found.refused == 0 and found.holds
    tail = (1.0 - SIMULTANEOUS) / own.rank / 2.0
    assert found.band[0] == binom.ppf(tail, 40, 0.95) / 40
    assert np.all(found.coverage >= found.band[0]) and abs(found.overall - 0.95) < 4.5 * max(found.overall_error, 0.01)
    assert np.all(np.abs(found.mean_z) < 5.0 / 40**0.5) and np.median(found.std_z) == pytest.approx(1.0, abs=0.25)
    low, high = found.intervals
    assert np.all((low <= found.coverage) & (found.coverage <= high))
    document = found.to_dict()
    assert document["coverage"] == found.overall and len(document["parameters"]) == own.rank


def test_intervals_that_are_too_short_are_found_out(own):
    # At half the standard deviation a 95 % interval of a normal error holds the truth in 67 %.
    found = certify(replace(own, method=TooSure()), 40, 0, quiet)
    assert not found.holds and found.overall == pytest.approx(0.673, abs=0.1)
    assert np.median(found.std_z) == pytest.approx(2.0, abs=0.5)


def test_an_interrupted_run_goes_on_where_it_was(own, tmp_path, monkeypatch):
    monkeypatch.setattr("bayesid.design.accuracy.certificate.FEWEST", 10)
    kept, told = tmp_path / "twins.npz", []
    whole = certify(own, 10, 3, quiet)

    def stop(text: str) -> None:
        told.append(text)
        if len(told) == 7:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        certify(own, 10, 3, stop, kept)
    assert kept.exists()
    told.clear()
    again = certify(own, 10, 3, told.append, kept, resume=True)
    assert len(told) == 3 and told[0] == "certificate: 8 of 10 twins"
    np.testing.assert_array_equal(again.inside, whole.inside)
    np.testing.assert_array_equal(again.mean_z, whole.mean_z)
    with pytest.raises(InputError, match="belongs to another run"):
        certify(own, 10, 4, quiet, kept, resume=True)


def test_methods_without_intervals_and_too_few_twins_are_refused(own):
    with pytest.raises(InputError, match="give at least 20"):
        certify(own, 19, 0, quiet)
    biased = estimator("ridge").fit(own.problem.regression)
    with pytest.raises(InputError, match="method ridge prints no intervals"):
        certify(replace(own, method=estimator("ridge"), estimate=biased), 20, 0, quiet)
