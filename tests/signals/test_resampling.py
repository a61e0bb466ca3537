"""Samples at uneven times become even ones: the motion is where it was, and white noise stays white."""

from __future__ import annotations

import numpy as np
import pytest

from bayesid.signals.resampling import resample_evenly, uneven


def stamps(kind: str, rng: np.random.Generator) -> np.ndarray:
    """True times of 4,000 samples about 4 ms apart."""
    even = 0.004 * np.arange(4000)
    if kind == "jitter":
        return even + 0.0008 * rng.uniform(-1.0, 1.0, size=len(even))
    if kind == "dropped":
        return even[rng.uniform(size=len(even)) > 0.1]
    return even * (1.0 + 0.05 * even / even[-1])  # drift


@pytest.mark.parametrize("kind", ["jitter", "dropped", "drift"])
def test_motion_stays_in_its_place_and_noise_white(kind: str) -> None:
    rng = np.random.default_rng(1)
    times = stamps(kind, rng)
    assert uneven(times)

    def motion(t: np.ndarray) -> np.ndarray:
        return np.stack([np.sin(2 * np.pi * 0.7 * t), 3.0 + np.cos(2 * np.pi * 1.9 * t)], axis=1)

    even, exact = resample_evenly(times, motion(times), 10.0)
    assert not uneven(even)
    assert even[0] == times[0] and even[-1] == times[-1]
    assert np.abs(exact - motion(even))[100:-100].max() < 1e-5
    noise = 0.1 * rng.normal(size=(len(times), 2))
    residual = (resample_evenly(times, motion(times) + noise, 10.0)[1] - motion(even))[100:-100]
    assert residual.std() == pytest.approx(0.1, rel=0.05)
    neighbours = np.mean(residual[1:] * residual[:-1], axis=0) / np.mean(residual**2, axis=0)
    assert np.abs(neighbours).max() < 4.0 / np.sqrt(len(residual))


def test_even_times_are_left_alone() -> None:
    assert not uneven(0.008 * np.arange(1000) + 12.5)
    assert not uneven(np.round(0.008 * np.arange(1000), 4))
