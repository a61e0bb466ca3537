"""The verdict as a function of a few numbers: every branch, and both sides of every threshold."""

import math
from dataclasses import fields, replace

import pytest

from bayesid.diagnosis.settings import DEFAULT
from bayesid.diagnosis.verdict import Evidence, verdict

#: One effect that closes nearly all of a large gap, and leaves noise.
CLEAR = Evidence(
    residual=1.02, explained=0.999, effects=1, unrelated=1, before=9.0, after=1.02, floor=1.0, closed=0.998, closed_low=0.99
)
NONE = Evidence(residual=1.02, explained=0.0, effects=0, before=1.03, after=1.03, floor=1.0)
UNVALIDATED = replace(CLEAR, before=None, after=None, floor=None, closed=math.nan, closed_low=math.nan)
BELOW, ABOVE = 0.999, 1.001


@pytest.mark.parametrize(
    ("evidence", "expected"),
    [
        (CLEAR, ("named", "")),
        (UNVALIDATED, ("named", "")),
        (replace(CLEAR, rivals=True), ("ambiguous", "")),
        (NONE, ("nothing_missing", "")),
        (replace(NONE, before=None, after=None, floor=None), ("nothing_missing", "")),
        # A residual that nothing explains, on the fitted motions or on the others, with an effect or without.
        (replace(NONE, residual=DEFAULT.unexplained * ABOVE), ("unknown", "residual")),
        (replace(NONE, residual=DEFAULT.unexplained * BELOW), ("nothing_missing", "")),
        (replace(NONE, after=math.sqrt(DEFAULT.unexplained) * ABOVE), ("unknown", "residual")),
        (replace(NONE, after=math.sqrt(DEFAULT.unexplained) * BELOW), ("nothing_missing", "")),
        (replace(UNVALIDATED, residual=2.0), ("unknown", "residual")),
        (replace(CLEAR, residual=2.0, explained=0.9), ("unknown", "residual")),
        # A model that explains nearly everything may leave more than noise, where held-out motions agree.
        (replace(CLEAR, residual=2.0), ("named", "")),
        (replace(CLEAR, residual=2.0, closed=DEFAULT.nearly_all * BELOW), ("unknown", "residual")),
        (replace(CLEAR, residual=2.0, after=math.sqrt(DEFAULT.unexplained) * ABOVE), ("unknown", "residual")),
        (replace(CLEAR, residual=2.0, explained=DEFAULT.nearly_all * BELOW), ("unknown", "residual")),
        # ... down to about the noise: a floor that is high because effects are uncertain vouches for nothing.
        (replace(CLEAR, residual=2.0, before=9.0, after=1.5, floor=2.0), ("unknown", "residual")),
        (replace(CLEAR, residual=1.4, before=9.0, after=1.5, floor=2.0), ("named", "")),
        # Livelier held-out motions: a small share of a large gap is forgiven, a large one not.
        (replace(CLEAR, after=2.0, closed=DEFAULT.nearly_all * ABOVE), ("named", "")),
        (replace(CLEAR, after=2.0, closed=DEFAULT.nearly_all * BELOW), ("unknown", "residual")),
        # Held-out motions deny the effect: worse, or no better where there was a gap.
        (replace(CLEAR, before=1.0, after=ABOVE, closed=math.nan, closed_low=math.nan), ("unknown", "denied")),
        (replace(CLEAR, before=1.0, after=BELOW, closed=math.nan, closed_low=math.nan), ("named", "")),
        (replace(CLEAR, before=1.1, closed_low=0.0), ("unknown", "denied")),
        (replace(CLEAR, before=1.1, closed_low=0.001), ("named", "")),
        # What changes them too little to be seen there is not denied by their being no better.
        (replace(CLEAR, before=1.2, closed_low=0.0, difference=DEFAULT.detected**2 * BELOW), ("named", "")),
        (replace(CLEAR, before=1.2, closed_low=0.0, difference=DEFAULT.detected**2 * ABOVE), ("unknown", "denied")),
        (replace(CLEAR, after=math.sqrt(DEFAULT.unexplained) * BELOW, closed=0.5), ("named", "")),
        # One moment that speaks for an effect of the whole recording.
        (replace(CLEAR, momentary=True), ("unknown", "moment")),
        (replace(CLEAR, before=1.0, after=1.1, closed=math.nan, unconfirmable=True), ("named", "")),
        # Surrogates: too many unrelated effects, or others that were left out of a model that is not nearly complete.
        (replace(CLEAR, effects=2, unrelated=DEFAULT.likely_effects), ("named", "")),
        (replace(CLEAR, effects=3, unrelated=DEFAULT.likely_effects + 1), ("unknown", "surrogates")),
        (replace(CLEAR, dropped=True), ("named", "")),
        (replace(CLEAR, dropped=True, explained=0.9), ("unknown", "surrogates")),
        (replace(UNVALIDATED, dropped=True), ("unknown", "surrogates")),
    ],
)  # fmt: skip
def test_the_verdict(evidence, expected):
    """As the table says."""
    assert verdict(evidence, DEFAULT) == expected


def test_the_thresholds_that_decide_are_those_given():
    """A verdict near a threshold changes with it."""
    near = replace(NONE, residual=1.3)
    assert verdict(near, DEFAULT) == ("nothing_missing", "")
    assert verdict(near, replace(DEFAULT, unexplained=1.2)) == ("unknown", "residual")
    assert verdict(replace(CLEAR, unrelated=2), replace(DEFAULT, likely_effects=1)) == ("unknown", "surrogates")


def test_every_threshold_is_a_positive_number():
    """So that it can be moved by a share of itself."""
    assert all(getattr(DEFAULT, f.name) > 0 for f in fields(DEFAULT))
