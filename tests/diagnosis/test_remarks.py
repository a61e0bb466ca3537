"""Remarks that are tests of their own: what they say must be as rare as they say where nothing is wrong."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np

from bayesid.diagnosis.remarks import _at_an_end, _of_the_links, moment_sentence
from bayesid.diagnosis.stability import Moment, Stability
from bayesid.effects import Term
from bayesid.effects.drives import Spring
from bayesid.effects.friction import DahlFriction
from bayesid.estimators.prior_check import CONFLICT


def _search(r: np.ndarray, u: np.ndarray) -> Any:
    """What a search leaves behind for two links with a prior of unit size."""
    prior = SimpleNamespace(mean=np.full(20, 10.0), covariance=np.eye(20))
    data = SimpleNamespace(
        prior=prior, experiment=SimpleNamespace(inertia_rel_std=0.05), robot=SimpleNamespace(body_names=("upper", "lower"))
    )
    projector = SimpleNamespace(data=data, root=np.eye(20), r=r)
    return cast(Any, SimpleNamespace(projector=projector, best=SimpleNamespace(links=prior.mean + u[:20], coordinates=u)))


def test_links_are_said_to_lie_too_far_out_as_often_as_their_law_has_it():
    """Links drawn from the prior, with an offset beside them, and least squares over that prior; then three times as far."""
    rng = np.random.default_rng(1)
    columns = rng.normal(size=(60, 26)) * np.geomspace(1e-3, 30.0, 26)  # from directions never seen to those seen exactly
    r = np.linalg.qr(np.vstack([columns, np.eye(26)]))[1]
    said = {1.0: 0, 3.0: 0}
    for scale in said:
        for _ in range(2000):
            readings = columns @ (scale * rng.normal(size=26)) + rng.normal(size=60)
            said[scale] += bool(_of_the_links(_search(r, np.linalg.solve(r.T @ r, columns.T @ readings)), "nothing_missing"))
    assert said[1.0] <= 8  # of 2,000 at a chance of 0.001: more than that has a probability of 2e-4
    assert said[3.0] > 1700


def test_the_mass_that_is_furthest_out_is_told():
    r = np.diag(np.full(20, 100.0))
    far = _search(r, np.where(np.arange(20) == 10, 9.0, 0.0))
    (text,) = _of_the_links(far, "nothing_missing")
    assert "lower, 19 kg, nominally 10" in text and "81" in text and "too little to name one of them" in text
    assert CONFLICT == 1e-3
    assert _of_the_links(_search(r, np.zeros(20)), "nothing_missing") == []
    # Where something is missing it may be that: a URDF with a gripper that the robot does not have was not told.
    (text,) = _of_the_links(far, "unknown")
    assert "or was taken off" in text and "or what is missing puts them there" in text


def test_a_value_at_an_end_of_its_range_is_told():
    """Of shape parameters alone: a level of nothing is an effect that is not there."""
    effect = DahlFriction("joint2", 1)
    assert _at_an_end(Term(effect, (0.0, 0.02))) == []
    (low,), (high,) = (_at_an_end(Term(effect, (1.3, value))) for value in (1e-3, 1.0))
    assert "dahl_friction@joint2: distance 0.001 rad is the lower end" in low and "smaller" in low
    assert "upper end" in high and "larger" in high


def test_a_spring_whose_rest_is_far_beyond_the_motion_is_mostly_an_offset():
    positions = np.column_stack([np.zeros(50), np.linspace(-1.0, 1.0, 50)])
    assert Term(Spring("joint2", 1), (0.3, 1.5)).caveats(positions) == []
    (told,) = Term(Spring("joint2", 1), (0.3, 14.0)).caveats(positions)
    assert (
        "spring@joint2: the rest lies beyond the motion, -1 to 1 rad, over which it is a torque of -4.2 N m that changes by 0.6"
        in told
    )


def test_poses_are_told_by_their_number():
    at = Stability("sensor_gain@fz", 10, 3.0, Moment(2.0, 4.0, "still"), ((0.0, 1.0),))
    assert "poses 3 to 5 of ‘still’" in moment_sentence(at, 12.0, poses=True)
    assert "one moment, 2.0 to 4.0 s" in moment_sentence(at, 12.0)
