"""The study that moves thresholds of the diagnosis."""

import pytest

from bayesid.diagnosis.settings import Settings
from tests.studies.diagnosis_settings import COMPARED, LIMITS, limit, moved


def test_all_numbers_that_it_moves_are_there():
    assert set(COMPARED) <= set(Settings.__dataclass_fields__)
    for name in LIMITS:
        assert moved(limit(name), 1) > limit(name), name


@pytest.mark.parametrize("value, down, up", [(12.0, 8.4, 15.6), (0.95, 0.665, 0.975), (10, 7, 13), (2, 1, 3)])
def test_numbers_move_by_30_percent_wholes_by_one_and_shares_not_past_one(value, down, up):
    assert (moved(value, -1), moved(value, 1)) == pytest.approx((down, up))
