"""Lags by cross-correlation, against closed forms of least squares."""

from __future__ import annotations

import numpy as np
import pytest

from bayesid.recordings.importing.clock import lag

TIMES = np.arange(0.0, 20.0, 0.04)
FREQUENCIES = 2.0 * np.pi * np.array([0.3, 0.7, 1.1])


def course(at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two columns of sines, and their rates."""
    phase = np.outer(at, FREQUENCIES)
    values = np.column_stack([np.sin(phase).sum(axis=1), np.cos(phase).sum(axis=1)])
    rates = np.column_stack([np.cos(phase) @ FREQUENCIES, -np.sin(phase) @ FREQUENCIES])
    return values, rates


@pytest.mark.parametrize("truth", [-0.2, -0.0123, 0.0, 0.0456, 0.3])
def test_an_exact_lag_is_found_whatever_the_offset(truth):
    found = lag(TIMES, course(TIMES - truth)[0] + 3.0, course, -1.0, 21.0)
    assert found is not None and found[0] == pytest.approx(truth, abs=1e-9) and found[1] < 1e-9


def test_the_standard_deviation_is_that_of_least_squares_and_holds_the_truth():
    """White noise s has ``s / sqrt(sum rate^2)``; recordings scatter by it, and by more where noise lasts, which is told."""
    rng, truth, std = np.random.default_rng(5), 0.0456, 0.3
    used = (TIMES >= -0.5) & (TIMES <= 20.5)
    exact = std / np.sqrt((course(TIMES[used] - truth)[1] ** 2).sum())
    white, lasting = [], []
    for _ in range(40):
        noise = rng.normal(size=(len(TIMES) + 20, 2))
        found = lag(TIMES, course(TIMES - truth)[0] + std * noise[20:], course, -1.0, 21.0)
        assert found is not None and found[1] == pytest.approx(exact, rel=0.35)
        white.append((found[0] - truth) / found[1])
        slow = np.cumsum(noise, axis=0)
        found = lag(TIMES, course(TIMES - truth)[0] + 0.1 * (slow[20:] - slow[10:-10]), course, -1.0, 21.0)
        assert found is not None
        lasting.append((found[0] - truth) / found[1])
    # Root mean squares of 40 normal numbers scatter by 1 / sqrt(80): four of these.
    assert np.sqrt(np.mean(np.square(white))) == pytest.approx(1.0, abs=0.45)
    assert np.sqrt(np.mean(np.square(lasting))) == pytest.approx(1.0, abs=0.45)


def test_courses_that_have_nothing_in_common_or_too_few_samples_have_no_lag():
    rng = np.random.default_rng(1)
    assert lag(TIMES, rng.normal(size=(len(TIMES), 2)), course, -1.0, 21.0) is None
    assert lag(TIMES[:100], course(TIMES[:100])[0], course, -1.0, 21.0) is None
    assert lag(TIMES, course(TIMES - 0.9)[0], course, -1.0, 21.0) is None  # beyond what is tried
