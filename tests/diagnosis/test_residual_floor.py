"""Where a diagnosis takes its noise from: repeats and rests against noise of a spectrum that is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import butter, freqz, lfilter

from bayesid import diagnose
from bayesid.diagnosis import noise as noise_of_segments
from bayesid.diagnosis import noise_spectrum
from bayesid.diagnosis.data import residual_rows
from bayesid.diagnosis.encoders import Encoders, with_noise
from bayesid.diagnosis.fit import fit
from bayesid.diagnosis.noise import smoothed
from bayesid.diagnosis.prepare import prepare_data
from bayesid.diagnosis.projector import make_projector
from bayesid.diagnosis.settings import DEFAULT
from bayesid.diagnosis.spectra import taper
from bayesid.dynamics.channels import torque_channels, wrench_channels
from bayesid.dynamics.regressors import Kernel
from bayesid.effects import MotionSegment, Term, readings
from bayesid.recordings.table import Table
from bayesid.robot.robot import load_robot
from bayesid.signals import repeats
from bayesid.signals.white_noise import quiet_noise
from tests.robots import ur5, write
from tests.simulated import Motion, Sensor, experiment, fourier, puma2, recording

RATE = 125.0
SENSOR = Sensor(translation=(0.0, 0.0, -0.1))
STD = np.repeat([0.3, 0.03], 3)
#: Channels share a quarter of their noise.
MIXING = np.linalg.cholesky(0.75 * np.eye(6) + 0.25)
#: A sensor that smooths before it is recorded, and one whose noise is red without a filter.
FILTERED = butter(2, 4.0, fs=RATE)
RED = (np.array([0.1]), np.array([1.0, -0.9]))
WHITE = (np.array([1.0]), np.array([1.0]))


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    """The paper's two-joint robot."""
    return puma2(tmp_path_factory.mktemp("robot"))


def noise(shape: tuple[int, int], law, seed: int) -> np.ndarray:
    """Noise of the spectrum ``STD^2 |H|^2``, correlated across channels."""
    white = np.random.default_rng(seed).normal(size=(shape[0] + 1000, 6)) @ MIXING.T * STD
    return lfilter(*law, white, axis=0)[1000:]


def spectrum(law, frequencies: np.ndarray) -> np.ndarray:
    """Standard deviation of white noise that is as strong (K, c)."""
    return np.abs(freqz(*law, worN=frequencies, fs=RATE)[1])[:, None] * STD


def recorded(robot, motion, law, seed: int, *, delay: float = 0.0, resolution: float = 2e-5) -> Table:
    """A wrench and rounded positions."""
    times, q, v, a = motion
    channels = wrench_channels(robot, np.eye(3), SENSOR.translation)
    wrench = Kernel.of(robot, channels).dynamics(q, v, a) @ robot.nominal.ravel() + channels.static_wrench
    late = np.stack([np.interp(times - delay, times, w) for w in wrench.T], axis=1) if delay else wrench
    read = np.round(q / resolution) * resolution
    return Table(times=times, positions=read, wrench=late + noise(late.shape, law, seed))


def swept(robot, seed: int, duration: float):
    """A motion that never repeats itself."""
    times, q, v, a = fourier(robot, seed, duration=duration, speed=0.8)
    w = 2.0 * np.pi * 0.037 * np.sqrt(np.array([2.0, 5.0]))
    return times, q + 0.3 * np.sin(w * times[:, None]), v + 0.3 * w * np.cos(w * times[:, None]), a - 0.3 * w**2 * np.sin(
        w * times[:, None]
    )  # fmt: skip


def parked(robot, seed: int, rest: float):
    """The same with a rest at both ends, reached smoothly."""
    times, q, _, _ = swept(robot, seed, 20.0)
    held = int(rest * RATE)
    s = np.clip(times / 2.0, 0, 1) * np.clip((times[-1] - times) / 2.0, 0, 1)
    edge = s**4 * (35 - 84 * s + 70 * s**2 - 20 * s**3)
    q = np.pad((q - q[0]) * edge[:, None], ((held, held), (0, 0)), mode="edge")
    v = np.gradient(q, 1.0 / RATE, axis=0)
    return np.arange(len(q)) / RATE, q, v, np.gradient(v, 1.0 / RATE, axis=0)


def setting(robot, motion, law, unseen=None, **options):
    """An experiment with exact links; the noise of the second motion is another draw."""
    delay = options.pop("delay", 0.0)
    motions = [Motion("fit", "identification", recorded(robot, motion, law, 1, delay=delay))]
    if unseen is not None:
        motions.append(Motion("unseen", "validation", recorded(robot, unseen, law, 2, delay=delay)))
    return experiment(robot, motions, SENSOR, inertia_rel_std=0.0, position_resolution=2e-5, **options)


def made(given):
    """Its data."""
    return prepare_data(given, "wrench", (), None, 0)


@pytest.mark.parametrize(("law", "name"), [(FILTERED, "filtered"), (RED, "red")])
def test_repeats_give_the_spectrum_of_coloured_noise(robot, law, name):
    """Four periods of ten seconds; filtered noise falls by 16 within the band, red noise by 5. Bands are known to 13 %."""
    found = made(setting(robot, fourier(robot, 3, duration=40.0), law))
    assert (found.floor_known, found.floor_source) == (True, "repeats"), name
    measured = found.spectrum
    assert measured is not None
    assert measured.lowest < 0.1
    # Above the encoders' share, which grows with frequency, and where bands are not wider than the slope allows.
    where = np.array([0.3, 0.7, 1.0, 2.0, 3.0, 4.0])
    got = np.sqrt(measured.at(where, 1.0 / RATE).diagonal(0, 1, 2))
    ratio = got / spectrum(law, where)
    assert np.all((ratio > 0.7) & (ratio < 1.4)), ratio
    assert abs(np.mean(np.log(ratio))) < 0.1
    off = measured.correlation[:3][:, ~np.eye(6, dtype=bool)]
    assert 0.12 < off.mean() < 0.33  # 0.25, shrunk a little


def test_whitened_noise_of_another_draw_has_variance_one(robot):
    """By band of frequency, on noise that the spectrum was not made from; with the white estimate it is nothing like it."""
    motion = fourier(robot, 3, duration=40.0)
    found = made(setting(robot, motion, FILTERED))
    s = found.segments[0]
    for seed in (7, 8):
        z = s.whiten(s.measured(noise(s.readings.shape, FILTERED, seed)))
        for low, high in [(0.1, 1.0), (1.0, 3.0), (3.0, 6.0)]:
            inside = (s.frequencies >= low) & (s.frequencies < high)
            # The covariance holds the encoders' errors, too: at most 1, and not far below where they are small.
            assert 0.75 < np.mean(z[inside] ** 2) < 1.2, (low, high)
    assert np.mean((s.measured(noise(s.readings.shape, FILTERED, 9)) / quiet_noise([s.readings])) ** 2) > 100.0


def test_filtered_noise_raises_no_alarm_and_hides_no_delay(robot):
    """Nothing hidden: nothing named, with the floor known. A late sensor: named, and its gap closed."""
    motion, unseen = fourier(robot, 3, duration=30.0), swept(robot, 4, 12.0)
    quiet = diagnose(setting(robot, motion, FILTERED, unseen))
    assert quiet.verdict == "nothing_missing"
    told = quiet.to_dict()["gap"]
    assert (told["floor_known"], told["floor_source"]) == (True, "repeats")
    assert quiet.gap is not None
    assert 0.8 < quiet.gap.after / quiet.gap.floor < 1.15
    assert any("repeats" in r for r in quiet.remarks)
    late = diagnose(setting(robot, motion, FILTERED, unseen, delay=0.004))
    assert [f.term.effect.name for f in late.found] == ["sensor_delay"]
    assert abs(late.found[0].term.values[0] - 0.004) < 4 * late.found[0].std[0]


def test_two_recordings_of_one_motion_are_repeats(robot):
    """Neither repeats itself; the second starts later."""
    times, *motion = swept(robot, 5, 22.0)
    cut = 150
    first = (times[:-cut], *(x[:-cut] for x in motion))
    second = (times[:-cut], *(x[cut:] for x in motion))
    found = made(setting(robot, first, FILTERED, second))
    assert found.floor_source == "repeats"
    moving = [*found.segments, *found.unseen]
    pair = repeats.find_repeats([noise_spectrum.course(s) for s in moving], np.full(2, 2e-5))
    assert [(p.first, p.second) for p in pair] == [(0, 1)]
    assert pair[0].lag == pytest.approx(-cut / RATE, abs=2e-4)
    where = np.array([0.5, 1.0, 2.0, 3.0])
    ratio = np.sqrt(found.spectrum.at(where, 1.0 / RATE).diagonal(0, 1, 2)) / spectrum(FILTERED, where)
    assert np.all((ratio > 0.65) & (ratio < 1.5)), ratio


def test_encoder_errors_that_do_not_repeat_are_not_taken_for_the_sensors(robot):
    """Random encoder noise makes differences of repeats larger. That comes off again, so that both are counted once."""
    motion, std = fourier(robot, 3, duration=40.0), 1e-4
    given = setting(robot, motion, FILTERED)

    def read(seed: int) -> np.ndarray:
        return motion[1] + std * np.random.default_rng(seed).normal(size=motion[1].shape)

    table = replace(given.motions[0].table, positions=read(5))
    found = made(replace(given, motions=(replace(given.motions[0], table=table),), position_resolution=0.0, position_std=std))
    s, pair = found.segments[0], repeats.find_repeats([noise_spectrum.course(s) for s in found.segments], np.zeros(2))
    pieces = noise_spectrum.repeat_pieces([s], pair, lambda x: found.predict(x, found.links, ()), {0: []})
    whole = noise_spectrum.measured_spectrum(pieces)
    assert whole is not None
    where = np.array([1.0, 2.0, 3.0, 4.0])
    ratio = np.sqrt(found.spectrum.at(where, 1.0 / RATE).diagonal(0, 1, 2)) / spectrum(FILTERED, where)
    raw = np.sqrt(whole.at(where, 1.0 / RATE).diagonal(0, 1, 2)) / spectrum(FILTERED, where)
    assert np.mean(np.log(raw[-1])) > 0.4
    assert abs(np.mean(np.log(ratio[:3]))) < 0.2
    # Another recording of both: the floor is what remains, neither less nor twice as much.
    trajectory = smoothed(s.times, read(6), s.trajectory.times, s.trajectory.bandwidth, False, s.trajectory.middle_positions)
    exact = s.measured(recorded(robot, motion, FILTERED, 17).wrench)
    z = s.whiten(exact - s.spectrum(found.predict(replace(s, trajectory=trajectory), found.links, ())))
    # Above 6 Hz the encoders are some hundred times louder than the sensor, which is then guessed too loud, never too quiet.
    for low, high, least in [(0.2, 1.0, 0.75), (1.0, 3.0, 0.75), (3.0, 6.0, 0.75), (6.0, 10.0, 0.5)]:
        inside = (s.frequencies >= low) & (s.frequencies < high)
        assert least < np.mean(z[inside] ** 2) < 1.3, (low, high)


def test_a_robot_that_stands_still_shows_its_noise(robot):
    """Five seconds at both ends of a motion that never repeats."""
    found = made(setting(robot, parked(robot, 6, 5.5), FILTERED))
    assert (found.floor_known, found.floor_source) == (True, "parked")
    where = np.array([0.5, 1.0, 2.0, 3.0])
    ratio = np.sqrt(found.spectrum.at(where, 1.0 / RATE).diagonal(0, 1, 2)) / spectrum(FILTERED, where)
    assert np.all((ratio > 0.6) & (ratio < 1.6)), ratio
    assert abs(np.mean(np.log(ratio))) < 0.15


def test_the_noise_of_a_rest_is_the_same_at_any_rate(robot):
    """Two motions that begin and end at rest, one recorded at a third of the other's rate: coloured noise keeps its density."""
    given = setting(robot, parked(robot, 6, 5.5), FILTERED, parked(robot, 7, 5.5))
    fast, slow = given.motions
    third = Table(times=slow.table.times[::3], positions=slow.table.positions[::3], wrench=slow.table.wrench[::3])
    found = made(replace(given, motions=(fast, replace(slow, table=third))))
    assert found.floor_source == "parked"
    for segments in (found.segments, found.unseen):
        left = residual_rows(found, segments, found.links, np.zeros(6), ())
        assert 0.8 < np.mean(left**2) < 1.25


def test_a_rest_that_the_experiment_states_shows_its_noise(robot):
    """Encoders that flicker by more than a robot at rest moves: only the experiment says when it stands still."""
    given = setting(robot, parked(robot, 6, 5.5), FILTERED)
    table = given.motions[0].table
    flicker = 2e-3 * np.random.default_rng(3).normal(size=table.positions.shape)
    motion = replace(given.motions[0], table=replace(table, positions=table.positions + flicker))
    given = replace(given, motions=(motion,), position_resolution=None)
    assert made(given).floor_source == "richest model"
    found = made(replace(given, motions=(replace(motion, parked=((0.5, 5.0), (26.0, 30.5))),)))
    assert (found.floor_known, found.floor_source) == (True, "parked")
    where = np.array([0.5, 1.0, 2.0, 3.0])
    ratio = np.sqrt(found.spectrum.at(where, 1.0 / RATE).diagonal(0, 1, 2)) / spectrum(FILTERED, where)
    assert abs(np.mean(np.log(ratio))) < 0.15


def test_neither_repeats_nor_rests_leave_the_floor_unknown(robot):
    """Filtered readings of one motion, and of one with a rest that is too short; what the data sheet says counts as the least."""
    for motion in (swept(robot, 5, 20.0), parked(robot, 6, 1.5)):
        found = made(setting(robot, motion, FILTERED))
        assert (found.floor_known, found.floor_source, found.spectrum) == (False, "richest model", None)
    diagnosis = diagnose(setting(robot, swept(robot, 5, 6.0), FILTERED, swept(robot, 4, 6.0)))
    assert diagnosis.verdict in ("unknown", "nothing_missing")
    assert any("Noise floor unknown" in r for r in diagnosis.remarks)
    stated = setting(robot, swept(robot, 5, 20.0), FILTERED)
    stated = replace(stated, sensor=replace(SENSOR, force_std=0.3, torque_std=0.03))
    found = made(stated)
    assert (found.floor_known, found.floor_source) == (False, "stated")
    s = found.segments[0]
    least = np.mean(s.weight(s.times) ** 2, axis=0) * STD**2
    assert np.all(s.covariance.diagonal(0, 1, 2) > 0.999 * least)


@pytest.mark.parametrize("motion", ["periodic", "parked", "touched", "pushed"])
def test_a_good_white_estimate_stays_to_the_last_bit(robot, motion, monkeypatch):
    """Repeats, rests, and a touch or a strong push in one period alone do not replace it."""
    path = parked(robot, 6, 5.5) if motion == "parked" else fourier(robot, 3, duration=30.0)
    given = setting(robot, path, WHITE)
    if motion in ("touched", "pushed"):
        table = given.motions[0].table
        start, force = (12.0, 4.0) if motion == "touched" else (2.0, 40.0)
        push = np.outer((table.times > start) & (table.times < start + 2.0), [force, 0, 0, 0, force / 8.0, 0])
        given = replace(given, motions=(replace(given.motions[0], table=replace(table, wrench=table.wrench + push)),))
    found = made(given)
    assert (found.floor_known, found.floor_source, found.spectrum) == (True, "white noise above the band", None)
    monkeypatch.setattr(noise_of_segments, "measure", lambda *_: None)
    np.testing.assert_array_equal(found.segments[0].covariance, made(given).segments[0].covariance)


def test_a_rest_of_a_drive_is_no_reason_to_distrust_white_noise(robot):
    """Stiction holds whatever torque the drive happens to give; it may wander while nothing moves."""
    motion = parked(robot, 6, 6.0)
    times, q, v, a = motion
    still = np.all(v == 0, axis=1)
    torque = Kernel.of(robot, torque_channels(robot)).dynamics(q, v, a) @ robot.nominal.ravel()
    rng = np.random.default_rng(2)
    torque += 0.05 * rng.normal(size=torque.shape)
    torque[still] += np.cumsum(0.05 * rng.normal(size=torque.shape), axis=0)[still]
    table = Table(times=times, positions=np.round(q / 2e-5) * 2e-5, torques=torque)
    given = experiment(robot, [Motion("fit", "identification", table)], None, inertia_rel_std=0.0, position_resolution=2e-5)
    found = prepare_data(given, "torque", (), None, 0)
    assert (found.floor_known, found.floor_source) == (True, "white noise above the band")


def test_a_period_is_found_behind_a_slow_start_to_a_ten_thousandth(robot):
    """A motion that swells up during its first seconds; the lag need not be a whole number of samples."""
    times, q, v, a = fourier(robot, 3, duration=27.0)
    stretch_by = 0.93337
    given = setting(robot, (times * stretch_by, q, v / stretch_by, a / stretch_by**2), WHITE)
    table = given.motions[0].table
    swell = np.clip(table.times / 3.0, 0.0, 1.0)[:, None] ** 2
    given = replace(given, motions=(replace(given.motions[0], table=replace(table, positions=table.positions * swell)),))
    found = repeats.find_repeats([noise_spectrum.course(s) for s in made(given).segments], np.full(2, 2e-5))
    assert len(found) == 1
    assert found[0].lag == pytest.approx(10.0 * stretch_by, abs=1e-3)
    assert found[0].start > 2.5


def test_rests_are_where_nothing_moves():
    """One joint still is not enough, and what rings after a stop is left out."""
    times = np.arange(0.0, 20.0, 0.01)
    q = np.stack([np.interp(times, [5.0, 12.0], [0.0, 1.0]), np.interp(times, [4.0, 5.0], [0.0, 0.5])], axis=1)
    found = repeats.find_rests(times, q, np.zeros(2))
    assert len(found) == 2
    np.testing.assert_allclose(found, [(0.25, 3.5), (12.5, 19.75)], atol=0.02)


def test_pieces_of_white_noise_give_its_variance():
    """Differences and rests alike, the taper's loss included (a slow check by hand: the mean of many draws)."""
    rng = np.random.default_rng(0)
    times = np.arange(0, 12.0, 0.008)
    weight = np.repeat(taper(times, times, 12.0, DEFAULT)[:, None], 2, axis=1)
    values = []
    for gain in (1.0, 2.0):
        pieces = [
            noise_spectrum.Piece(times, np.sqrt(gain) * rng.normal(size=(len(times), 2)) * [1.0, 5.0], weight, gain, 0.1, 0.8,
                          np.zeros((0, len(times), 2)), DEFAULT)
            for _ in range(20)
        ]  # fmt: skip
        found = noise_spectrum.measured_spectrum(pieces)
        assert found is not None
        values.append(np.average(found.density**2 / 0.008 * (1 - 2 / found.freedom)[:, None], axis=0, weights=found.freedom))
    np.testing.assert_allclose(values, [[1.0, 25.0]] * 2, rtol=0.05)


def test_no_channel_is_known_better_than_to_four_digits(robot):
    """Of what is predicted and of what is read: a joint of which the model predicts nothing is not weighted by rounding."""
    segment = prepare_data(setting(robot, swept(robot, 3, 20.0), WHITE), "wrench", (), None, 0).segments[0]
    none, read = np.zeros(robot.n), np.sum(segment.measured_readings**2, axis=0)

    def least(predicted: np.ndarray) -> np.ndarray:
        quiet = with_noise(
            segment, lambda _: predicted, lambda s, _: s, np.full(6, 1e-12), none, none, np.random.default_rng(0)
        )  # fmt: skip
        return np.einsum("kcc->c", quiet.covariance)

    moving = np.repeat(segment.trajectory.positions[:, :1], 6, axis=1)
    # Neighbouring frequencies are pooled, those at the ends less: sums differ a little.
    np.testing.assert_allclose(least(0.0 * moving), 1e-8 * read, rtol=0.3)
    large = np.sum(segment.spectrum(1e6 * moving) ** 2, axis=0)
    np.testing.assert_allclose(least(1e6 * moving), 1e-8 * large, rtol=0.3)


@pytest.mark.parametrize("random", [0.0, 0.4])
def test_counts_make_errors_as_large_as_their_noise_says(tmp_path, random):
    """Errors of torques predicted from rounded positions, beside those predicted from the true ones, between 3 and 10 Hz.

    Rounded once more, positions that had followed the counts of their recording made errors whose power was a sixth too small.
    Random errors of 0.4 counts, which make the power three times that of rounding alone, were left out.
    """
    robot = load_robot(write(tmp_path, ur5()))
    ratios = []
    for seed in range(16):
        times, q, v, a = fourier(robot, seed, duration=10.0, speed=1.0)
        table = recording(robot, None, (times, q, v, a), seed=seed, torque_std=1e-6, resolution=1e-3)
        read = q + random * 1e-3 * np.random.default_rng(seed).normal(size=q.shape)
        table = replace(table, positions=1e-3 * np.round(read / 1e-3))
        data = prepare_data(experiment(robot, [Motion("m", "identification", table)]), "torque", (), None, 0)
        data = noise_of_segments.with_noise_of(data, data.links, (), 0)
        s = data.segments[0]
        old = s.trajectory
        exact = smoothed(times, q, old.times, old.bandwidth, s.still, old.middle_positions, old.clear, old.cell)
        error = s.spectrum(data.predict(s, data.links, ()) - data.predict(replace(s, trajectory=exact), data.links, ()))
        high = s.frequencies > 3.0
        ratios.append(np.mean(error[high] ** 2 / np.diagonal(s.covariance, axis1=1, axis2=2)[high]))
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.08)
    assert np.std(ratios) / 4.0 < 0.03


def mounted(robot, resonance: float, damping: float, seed: int):
    """Data with the noise of a mount that rings, recorded from rest to rest by coarse encoders; the mount, and true positions."""
    times, q, v, a = fourier(robot, seed, duration=14.0)
    # A fade of degree five in and out, by the product rule.
    c, slope = np.clip(np.stack([times - 0.5, times[-1] - 0.5 - times]) / 2.0, 0.0, 1.0), np.array([[0.5], [-0.5]])
    f, df, ddf = c**3 * (10 - 15 * c + 6 * c**2), slope * 30 * c**2 * (1 - c) ** 2, slope**2 * 60 * c * (1 - c) * (1 - 2 * c)
    fade, rate = f[0] * f[1], df[0] * f[1] + f[0] * df[1]
    bend = ddf[0] * f[1] + 2 * df[0] * df[1] + f[0] * ddf[1]
    fade, rate, bend = fade[:, None], rate[:, None], bend[:, None]
    motion = times, fade * q, rate * q + fade * v, bend * q + 2 * rate * v + fade * a
    table = recording(robot, SENSOR, motion, seed=seed, force_std=0.2, torque_std=0.02, resolution=1e-4)
    setup = experiment(robot, [Motion("m", "identification", table)], SENSOR, inertia_rel_std=0.03)
    data = prepare_data(setup, "wrench", (), None, 0)
    term = Term(data.places("base_compliance")[0], (resonance, damping))
    exact, channels = MotionSegment(*motion), wrench_channels(robot, np.eye(3), SENSOR.translation)
    both = [readings(robot, channels, exact, robot.nominal, terms) for terms in ((term,), ())]
    assert table.wrench is not None
    setup = replace(setup, motions=(Motion("m", "identification", replace(table, wrench=table.wrench + both[0] - both[1])),))
    data = prepare_data(setup, "wrench", (), None, 0)
    return noise_of_segments.at_instants(data, data.links, (term,), 0), term


def test_what_encoders_add_to_the_normal_equations_is_the_slope_of_their_squares(robot):
    """``-E (D' u)' (D u)`` is minus half the derivative of ``E |D u|^2``, here by central differences in each value."""
    data, term = mounted(robot, 9.0, 0.05, 0)

    count, random = np.full(robot.n, 1e-4), np.zeros(robot.n)
    encoders = Encoders(lambda s: data.predict(s, data.links, (term,)), noise_of_segments._resmoothed, count, random, 0)
    ((s,), others) = data.segments, encoders.roundings(data.segments, {0})[0]

    def squares(values) -> float:
        terms, offset = (Term(term.effect, values),), np.zeros(6)
        read = residual_rows(data, [s], data.links, offset, terms)
        return float(np.mean([np.sum((read - residual_rows(data, [o], data.links, offset, terms)) ** 2) for o in others]))

    found = noise_of_segments._Attenuation(data.links, (term,), count, random, 0)(data)[term.effect]
    slopes = [(squares((9.0 + d, 0.05 + e)) - squares((9.0 - d, 0.05 - e))) / 2e-3 for d, e in ((1e-3, 0.0), (0.0, 1e-3))]
    np.testing.assert_allclose(found, -0.5 * np.array(slopes), rtol=0.02)


def test_intervals_of_a_mount_count_what_encoders_make_of_it(robot):
    """A mount that rings at 12 Hz, twelve recordings: estimates are off by as much as their intervals say.

    Least squares alone takes it for damped too much, for it then passes on less of the encoders' errors: z of 1.7 and 2.0 (rms).
    """
    plain, told = [], []
    for seed in range(12):
        data, term = mounted(robot, 12.0, 0.05, seed)
        best = fit(make_projector(data, (term,)), (term,))
        for _ in range(2):  # under the noise of the mount that was found
            data = noise_of_segments.with_noise_of(data, best.links, best.terms, 0)
            best = fit(make_projector(data, best.terms), best.terms, best)
        plain.append((np.array(best.terms[0].values) - term.values) / np.sqrt(np.diag(best.covariance)))
        told.append((np.array(best.unbiased(0).values) - term.values) / best.std(0, 1.0))
    assert np.all(np.sqrt(np.mean(np.square(plain), axis=0)) > 1.4)
    assert np.all(np.sqrt(np.mean(np.square(told), axis=0)) < 1.1)
