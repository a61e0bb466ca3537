"""Crossings of a gear's play sought anew, against the ones that were simulated and against plain least squares."""

import numpy as np
import pytest

from bayesid.effects.play import crossed_anew, intervals_that_stand_out, local_energy
from bayesid.signals.smoothing import Splines

STEP, GAP, COUNT = 0.008, 4e-3, 1e-4
T = np.arange(1000) * STEP
SPLINES = Splines.over(T, 8.0)
SIDES = np.array([-GAP / 2, 0.0, GAP / 2])


def crossed(encoders, start, splines, still, where):
    """How far the link is behind then (M,)."""
    side = crossed_anew(encoders, start, SIDES, splines, still, STEP, where)
    return np.where(side >= 0, SIDES[side], start)


def recorded(crossings, sides):
    """Counted encoder of a slow link motion, and how far the link is behind."""
    behind = np.asarray(sides)[np.searchsorted(crossings, T, side="right")] * GAP / 2
    return np.round((0.8 * np.sin(1.3 * T) + behind) / COUNT) * COUNT, behind


@pytest.mark.parametrize("crossings", [(3.1,), (3.0, 3.4), (2.9, 3.07)])
@pytest.mark.parametrize("sides", [(-1, 1, -1), (-1, 0, 1), (1, -1, 0)])
def test_a_stretch_that_chatters_is_crossed_as_it_was(crossings, sides):
    encoders, truth = recorded(crossings, sides)
    chattering = (T > 2.7) & (T < 3.6)
    start = np.where(chattering, GAP / 2 * np.sign(np.sin(40 * T)), truth)
    where = intervals_that_stand_out(local_energy(SPLINES.remainder(encoders - start), STEP))
    assert where and T[where[0][0]] < crossings[0] and T[where[-1][1]] > crossings[-1]
    got = crossed(encoders, start, SPLINES, np.zeros(len(T), bool), where)
    assert np.sum(np.abs(got - truth) > 0.01 * GAP) <= 2 * len(crossings)  # a sample each may belong to either side
    assert SPLINES.remainder(encoders - got).std() < 2 * SPLINES.remainder(encoders - truth).std()


def test_what_is_right_and_what_stands_still_is_left_alone():
    encoders, truth = recorded((3.0, 3.4), (-1, 0, 1))
    assert not intervals_that_stand_out(local_energy(SPLINES.remainder(encoders - truth), STEP))
    whole = [(0, len(T))]
    assert np.array_equal(crossed(encoders, truth, SPLINES, np.ones(len(T), bool), whole), truth)
    kept = crossed(encoders, truth, SPLINES, np.zeros(len(T), bool), [(340, 400)])
    assert SPLINES.remainder(encoders - kept).std() <= SPLINES.remainder(encoders - truth).std() * (1 + 1e-9)
    assert np.array_equal(kept[:340], truth[:340]) and np.array_equal(kept[400:], truth[400:])


def test_no_other_two_crossings_leave_less():
    """Every pair of times and three sides, by dense least squares over the same samples."""
    rng = np.random.default_rng(0)
    encoders, truth = recorded((0.9, 1.5), (-1, 1, 0))
    encoders = (encoders + rng.normal(0.0, 1e-3, len(T)))[:250]
    splines = SPLINES.part(slice(0, 250))
    basis = splines.motion(np.eye(splines.count))[0]
    project = basis @ np.linalg.pinv(basis)
    start = np.where(T[:250] < 1.2, GAP / 2, -GAP / 2)
    got = crossed(encoders, start, splines, np.zeros(250, bool), [(100, 125)])
    least, samples = np.inf, np.arange(250)
    for i in range(100, 126):
        for j in range(i, 126):
            for one in (-1, 0, 1):
                for two in (-1, 0, 1):
                    for three in (-1, 0, 1):
                        inside = GAP / 2 * np.where(samples < i, one, np.where(samples < j, two, three))
                        left = encoders - np.where((samples >= 100) & (samples < 125), inside, start)
                        left = left - project @ left
                        least = min(least, left @ left)
    own = encoders - got
    own = own - project @ own
    assert own @ own == pytest.approx(least, rel=1e-6)
