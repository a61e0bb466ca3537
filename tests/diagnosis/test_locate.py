"""Where model and data disagree: short windows, short events above the compared band, and their false alarms."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from scipy.signal import lfilter

from bayesid.diagnosis.impulse_events import kicks, short_events
from bayesid.diagnosis.locate import LISTED, by_window, locate, places_looked_at
from bayesid.diagnosis.noise import smoothed
from bayesid.diagnosis.prepare import prepare_data
from bayesid.diagnosis.settings import DEFAULT
from bayesid.diagnosis.spectra import SpectralSegment
from bayesid.recordings.experiment import load_experiment
from bayesid.results import diagnosis as text
from bayesid.signals.arrays import runs

JOINTS, CHANNELS = 3, 6
LEVEL = DEFAULT.level


def segment(seed, duration=20.0, rate=250.0, colour="white", still=False, joints=JOINTS, moving=True):
    """A recording of joints that swing, with readings that follow them and noise of unit size, its generator and times."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, duration, 1.0 / rate)
    speeds = 0.1 + 0.07 * np.arange(joints)
    q = moving * np.sin(2.0 * np.pi * speeds * t[:, None] + rng.uniform(0.0, 6.0, joints))
    noise = rng.normal(size=(len(t), CHANNELS))
    if colour == "coloured":
        noise = lfilter([1.0], [1.0, -0.9], noise, axis=0)
    elif colour == "loud while it moves":
        noise *= (0.2 + np.abs(np.gradient(q[:, 0], t)))[:, None]
    elif colour == "louder all at once":
        noise *= np.where((t > duration / 3) & (t < duration / 2), 30.0, 1.0)[:, None]
    readings = noise + 100.0 * q @ rng.normal(size=(joints, CHANNELS))
    trajectory = smoothed(t, q, t[::3], 12.0, still, np.zeros(joints))
    covariance = np.zeros((0, CHANNELS, CHANNELS))
    return SpectralSegment("motion", "identification", t, q, readings, trajectory, still, (), covariance)


def hit(s, at, size, length=0.02, channel=0):
    """The recording with a half sine added."""
    phase = np.clip((s.times - at) / length, 0.0, 1.0)
    readings = s.readings.copy()
    readings[:, channel] += size * np.sin(np.pi * phase)
    return replace(s, readings=readings)


# ---- short events above the band -------------------------------------------------------------------------------------


@pytest.mark.parametrize("colour", ["white", "coloured", "loud while it moves", "louder all at once"])
def test_noise_raises_no_more_alarms_than_stated(colour):
    """At a level of 5 %, in 120 recordings each, whatever the noise's colour and course."""
    alarms = sum(bool(short_events([segment(seed, 8.0, colour=colour)], 0.05)[0]) for seed in range(120))
    assert alarms <= 0.05 * 120


def test_taps_are_found_where_they_are():
    """Both, at their times, in their channels, as taps; nothing else; a moving arm between reversals and one at rest."""
    for seed in range(6):
        s = segment(seed, moving=seed < 3)
        near = kicks(s)
        early, late = (float(s.times[np.flatnonzero(~near & (s.times > t) & ~np.roll(near, -30))[0]]) for t in (5.0, 11.3))
        s = hit(hit(s, early + 0.05, 12.0), late + 0.05, -20.0, 0.01, channel=4)
        (events,) = short_events([s], LEVEL)
        assert [(e.channel, e.tap) for e in events] == [(0, True), (4, True)]
        assert [e.peak for e in events] == pytest.approx([early + 0.06, late + 0.055], abs=0.015)
        assert all(e.start <= e.peak <= e.end and e.end - e.start < 0.2 and e.p_value < LEVEL for e in events)
        assert all(e.band[0] == pytest.approx(9.6, abs=0.1) and e.band[1] == pytest.approx(125.0) for e in events)


def test_what_rings_for_long_is_no_tap():
    """A lightly damped vibration after a knock stands out, but is neither short nor broad."""
    s = segment(1, moving=False)
    ring = 30.0 * np.exp(-(s.times - 7.0) / 0.15) * np.sin(2.0 * np.pi * 30.0 * (s.times - 7.0)) * (s.times > 7.0)
    (events,) = short_events([replace(s, readings=s.readings + ring[:, None])], LEVEL)
    assert len(events) == 1 and not events[0].tap
    assert events[0].start == pytest.approx(7.0, abs=0.06)


def test_friction_at_reversals_is_no_event():
    """Kicks wherever a joint reverses or rests are not reported; the same kicks elsewhere are."""
    s = segment(2, joints=1)
    speed = np.gradient(s.encoders[:, 0], s.times)
    turns = s.times[1:][np.sign(speed[1:]) != np.sign(speed[:-1])]
    inner = turns[(turns > 1.0) & (turns < 19.0)]
    assert len(inner) >= 3
    one, other = s, s
    for k, t in enumerate(turns):
        one = hit(one, t - 0.01, 30.0 + 20.0 * k)
    for t in inner:
        other = hit(other, t + 0.8, 30.0)
    assert short_events([one], LEVEL) == ((),)
    assert 0.01 < kicks(s).mean() < 0.2 and not kicks(segment(2, moving=False)).any()
    assert len(short_events([other], LEVEL)[0]) == len(inner)


def test_where_nothing_can_be_said():
    """A static run, a rate that leaves no room above the band, a recording of a moment, its ends."""
    assert short_events([hit(segment(3, still=True, moving=False), 5.0, 50.0)], LEVEL) == ((),)
    assert short_events([hit(segment(3, rate=45.0, moving=False), 5.0, 50.0)], LEVEL) == ((),)
    assert short_events([hit(segment(3, duration=1.0, moving=False), 0.5, 50.0)], LEVEL) == ((),)
    assert short_events([hit(segment(3, moving=False), 0.05, 50.0)], LEVEL) == ((),)
    assert len(short_events([hit(segment(3, moving=False), 5.0, 50.0)], LEVEL)[0]) == 1
    constant = segment(3)
    assert short_events([replace(constant, readings=np.ones_like(constant.readings))], LEVEL) == ((),)


def test_runs_close_short_gaps():
    flags = np.array([0, 1, 1, 0, 1, 0, 0, 1], bool)
    assert runs(flags, 1) == [(1, 5), (7, 8)]
    assert runs(flags, 0) == [(1, 3), (4, 5), (7, 8)]
    assert runs(flags, 2) == [(1, 8)]
    assert runs(np.zeros(3, bool)) == []


# ---- the residual in the compared band -------------------------------------------------------------------------------


def data_of(*segments):
    channels = SimpleNamespace(names=("fx", "fy", "fz", "mx", "my", "mz"))
    return SimpleNamespace(channels=channels, robot=SimpleNamespace(n=JOINTS), segments=segments, unseen=(), settings=DEFAULT)


def white(s, seed):
    return np.random.default_rng(seed).normal(size=s.shape)


def test_white_residuals_disagree_nowhere():
    """Over 120 recordings at a level of one in a thousand each; and windows have the size of noise wherever they are."""
    s = segment(0)
    data = data_of(s)
    found = [w for seed in range(120) for w in locate(data, [s], [white(s, seed)], 1.0)]
    assert len(found) <= 2
    energy, freedom = [], []
    for seed in range(120):
        _, e, f, _ = by_window(s, white(s, seed) * 1.0, 1.0, 1, 4)
        energy.append(e), freedom.append(f)
    inner = slice(4, -4)
    assert np.mean(energy, axis=0)[inner].mean() == pytest.approx(np.mean(freedom, axis=0)[inner].mean(), rel=0.05)


def test_a_short_disagreement_is_placed_by_short_windows():
    """A third of a second in one channel is listed with that time, not with the second around it."""
    s = segment(4)
    course = np.zeros((len(s.times), CHANNELS))
    course[:, 2] = 8.0 * np.exp(-(((s.times - 9.4) / 0.1) ** 2)) * np.cos(2.0 * np.pi * 6.0 * (s.times - 9.4))
    left = white(s, 4) + s.measured(course) / 1.0
    (place,) = locate(data_of(s), [s], [left], 1.0)
    assert (place.channel, place.event) == ("fz", False)
    assert 8.9 < place.start < 9.4 < place.end < 9.9 and place.end - place.start < 0.8
    assert place.band_hz == (3.0, 10.0) and place.p_value < LEVEL


def test_a_disagreement_of_the_whole_recording_is_one_place():
    s = segment(5)
    left = white(s, 5)
    left[:20, 1] *= 30.0
    places = locate(data_of(s), [s], [left], 1.0)
    assert places[0].channel == "fy" and len([p for p in places if p.channel == "fy"]) <= 3
    assert sum(p.end - p.start for p in places if p.channel == "fy") > 0.6 * s.times[-1]
    assert {p.channel for p in places} == {"fy"}


def test_places_looked_at_count_both_lengths():
    s = segment(6)
    edges, _, _, p = by_window(s, white(s, 6), 1.0, 1)
    fine, *_ = by_window(s, white(s, 6), 1.0, 1, 4)
    np.testing.assert_array_equal(fine[::4], edges)
    assert places_looked_at([s]) == 5 * p.size


def test_the_list_holds_events_and_the_memo_tells_them():
    """Strongest first, short events marked as such, and what was not fitted said to be so."""
    quiet, tapped = (
        segment(7),
        replace(hit(hit(segment(8, moving=False), 6.0, 15.0), 14.0, 15.0), motion="other", role="validation"),
    )
    data = data_of(quiet)
    data.unseen = (tapped,)
    where = locate(data, [quiet], [white(quiet, 7)], 1.0)
    assert [(w.channel, w.motion, w.event, w.tap, w.unseen) for w in where] == [("fx", "other", True, True, True)] * 2
    assert where[0].ratio * np.sqrt(where[0].end - where[0].start) >= where[1].ratio * np.sqrt(where[1].end - where[1].start)
    entry = where[0].to_dict()
    assert entry["looks_like"] == "tap" and entry["band_hz"][1] == pytest.approx(125.0) and entry["joint"] is None
    (said,) = text.event_sentences(SimpleNamespace(where=where, data=data))
    assert said.startswith("2 short events in ‘other’ at 6.01 and 14.01 s, loudest in fx") and "look like taps" in said
    assert ", in a motion that took no part in the fit; they" in said
    (said,) = text.event_sentences(SimpleNamespace(where=[where[0], replace(where[1], tap=False)], data=data))
    assert "; one of them looks like a tap: " in said
    assert "a tap" in text.disagreement_line(where[0])
    (said,) = text.event_sentences(SimpleNamespace(data=data, where=[replace(where[0], tap=False, unseen=False)]))
    assert said.startswith("One short event") and "tap" not in said and "no part" not in said


def test_many_events_are_listed_by_the_strongest():
    s = segment(9, moving=False)
    for k in range(9):
        s = hit(s, 1.5 + 2.0 * k, 15.0 + 5.0 * k)
    where = locate(data_of(s), [s], [white(s, 9)], 1.0)
    assert len(where) == LISTED and all(w.start > 2.0 for w in where)


# ---- real taps -------------------------------------------------------------------------------------------------------


def test_real_hammer_taps_are_found_and_a_quiet_turn_has_none(shared):
    """Against the accelerometer on the tool, which this does not see: its four loudest moments, half a second apart."""
    folder = shared("data/kuka-med-wrist")
    data = prepare_data(load_experiment(folder), "wrench", (), ["baseline", "vibrations"], 0)
    events = dict(zip([s.motion for s in data.segments], short_events(data.segments, LEVEL), strict=True))
    assert events["baseline"] == ()
    table = pd.read_csv(folder / "vibrations.csv")
    steps = np.linalg.norm(np.diff(table[["accx", "accy", "accz"]].to_numpy(), axis=0), axis=1)
    times, heard = table["t"].to_numpy()[1:], []
    for _ in range(4):
        heard.append(float(times[np.argmax(steps)]))
        steps = np.where(np.abs(times - heard[-1]) < 0.5, 0.0, steps)
    assert [e.peak for e in events["vibrations"]] == pytest.approx(sorted(heard), abs=0.06)
    assert all(e.tap for e in events["vibrations"])
