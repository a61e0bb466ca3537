"""What is lost of a segment at its ends."""

import numpy as np

from bayesid.regression.segment import Segment


def segment(positions: np.ndarray) -> Segment:
    times = 0.01 * np.arange(len(positions))
    return Segment(times, positions[:, None], np.zeros((len(times), 1)), np.zeros(1), 0, settling=2.0)


def test_time_to_settle_is_given_where_a_segment_starts_in_motion():
    t = 0.01 * np.arange(1000)
    moving = segment(np.sin(2.0 * t))
    assert moving.inner(0.1) == (200, 990)
    resting = segment(np.where(t < 1.0, 0.0, np.sin(2.0 * (t - 1.0)) ** 2))
    assert resting.inner(0.1) == (10, 990)
    assert resting.part(300, 1000).inner(0.1) == (200, 690)  # a piece of it starts in motion
    assert moving.lost(3.0) == 3.0
