"""The noise of single samples, read off above the motion."""

import numpy as np
from scipy.signal import butter, sosfilt

from bayesid.signals.white_noise import low_passed, quiet_noise, steady_noise


def readings(seed, std=(0.5, 0.02), seconds=30.0, rate=125.0, burst=0.0):
    rng = np.random.default_rng(seed)
    times = np.arange(0.0, seconds, 1.0 / rate)
    motion = 80.0 * np.sin(2 * np.pi * 0.4 * times)[:, None] * [1.0, 0.1]
    noise = rng.normal(size=(len(times), 2)) * std
    return motion + noise * (1.0 + burst * ((times > 10) & (times < 20)))[:, None]


def test_the_noise_is_read_whatever_the_motion():
    found = [steady_noise([readings(k)]) for k in range(20)]
    np.testing.assert_allclose(np.mean(found, axis=0), [0.5, 0.02], rtol=0.02)
    assert np.std([f[0] for f in found]) < 0.04 * 0.5
    np.testing.assert_allclose(np.mean([quiet_noise([readings(k)]) for k in range(20)], axis=0), [0.5, 0.02], rtol=0.02)


def test_the_noise_of_short_recordings_is_read_to_a_few_per_cent():
    # 16 s at 100 Hz: 576 degrees of freedom at the frequencies looked at, so 3 % of the standard deviation at best.
    found = np.array(
        [quiet_noise([readings(k, seconds=8.0, rate=100.0), readings(1000 + k, seconds=8.0, rate=100.0)]) for k in range(40)]
    )
    np.testing.assert_allclose(found.mean(axis=0), [0.5, 0.02], rtol=0.02)
    assert np.all(found.std(axis=0) < 0.045 * np.array([0.5, 0.02]))


def test_the_quiet_moments_count_where_it_is_not_steady():
    np.testing.assert_allclose(steady_noise([readings(1, burst=5.0)]), [0.5, 0.02], rtol=0.25)


def test_readings_filtered_before_they_were_recorded_are_noticed():
    plain = readings(3)
    assert not low_passed([plain])
    assert low_passed([sosfilt(butter(2, 15.0, fs=125.0, output="sos"), plain, axis=0)])
    # So steep a filter that only the digits of the file are left above the band, as white as noise.
    assert low_passed([40.0 + 1e-5 * (plain - readings(3, std=(0.0, 0.0)))])
    assert not low_passed([40.0 + 1e-2 * (plain - readings(3, std=(0.0, 0.0)))])
