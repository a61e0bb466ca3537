import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import lsim

from bayesid.errors import InputError
from bayesid.signals.filters import LowPass, low_pass


def test_low_pass_equals_the_continuous_filters():
    times = np.arange(0, 20, 0.002)
    signal = np.sin(1.7 * times) + 0.3 * np.cos(5 * times)
    filtered, _ = low_pass(LowPass(1.0, 50.0), times, -signal[:, None])
    exact = lsim(([50.0], [1.0, 51.0, 50.0]), signal, times)[1]
    assert np.abs(filtered[:, 0] - exact).max() < 1e-4 * np.abs(exact).max()


@pytest.mark.parametrize("l, d", [(1.0, 50.0), (20.0, 50.0), (50.0, 100.0)])
def test_filtered_rate_equals_filtered_derivative(l, d):
    """Equation 14 of the paper: the derivative under the filter needs no differentiation."""
    times = np.arange(0, 10, 0.001)
    momentum, rate = np.sin(2 * times) + 0.5, 2 * np.cos(2 * times)
    zero = np.zeros((len(times), 1))
    by_parts, _ = low_pass(LowPass(l, d), times, zero, momentum[:, None])
    direct, _ = low_pass(LowPass(l, d), times, -rate[:, None])
    assert np.abs(by_parts - direct).max() < 2e-6


def test_start_is_clean_whatever_the_initial_momentum():
    times = np.arange(0, 3, 0.01)
    constant = np.full((len(times), 1), 7.3)
    filtered, _ = low_pass(LowPass(5.0, 50.0), times, np.zeros_like(constant), constant)
    assert np.abs(filtered).max() < 1e-12


@given(st.integers(1, 299), st.integers(0, 2**31))
def test_pieces_give_the_same_as_the_whole(cut, seed):
    rng = np.random.default_rng(seed)
    times = np.cumsum(rng.uniform(0.005, 0.012, 300))
    rest, rate = rng.normal(size=(2, 300, 3))
    whole, _ = low_pass(LowPass(2.0, 30.0), times, rest, rate)
    first, state = low_pass(LowPass(2.0, 30.0), times[:cut], rest[:cut], rate[:cut])
    second, _ = low_pass(LowPass(2.0, 30.0), times[cut:], rest[cut:], rate[cut:], state)
    np.testing.assert_allclose(np.vstack([first, second]), whole, rtol=0, atol=1e-12)


@pytest.mark.parametrize("l, d", [(0.0, 50.0), (1.0, -1.0), (np.nan, 50.0), (1.0, np.inf)])
def test_impossible_bandwidths_are_refused(l, d):
    with pytest.raises(InputError, match="low-pass"):
        LowPass(l, d)
