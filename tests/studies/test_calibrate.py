"""A few of the sensors of the page on calibration: faults named, intervals that hold them."""

from __future__ import annotations

import pytest

from tests.studies import calibrate


@pytest.mark.slow
def test_faults_of_sensors_are_named_and_held():
    found = calibrate.summarise(calibrate.run(100, 7, processes=1))
    assert found["without"]["named"] <= 0.06 and found["all"]["told"] >= 0.9
    # Parameters of one sensor err together: four standard errors of a hundredth and a half.
    assert found["all"]["coverage"] > 0.89 and found["all"]["offset"] > 0.89 and found["without"]["offset"] > 0.89
