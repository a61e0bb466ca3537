"""Samples that a log holds: found with their true rate whatever the rates, and nowhere where nothing is held."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import bayesid
from bayesid.recordings.experiment import Experiment, load_experiment
from bayesid.recordings.motion_checks import held_columns
from bayesid.recordings.table import Table
from tests.malformed import DATA
from tests.simulated import fourier, puma2, recording

WILD = DATA / "wild"


@pytest.fixture(scope="module")
def smooth(tmp_path_factory: pytest.TempPathFactory) -> Table:
    """A recording of 125 Hz with noise in the torques and fine counts in the positions."""
    robot = puma2(tmp_path_factory.mktemp("held"))
    return recording(robot, None, fourier(robot, 3, duration=20.0), torque_std=0.05, resolution=1e-5)


def hold(times: np.ndarray, values: np.ndarray, rate: float, jitter: float = 0.0) -> np.ndarray:
    """What a log holds of a topic of another rate (N, ...): the newest sample that has come, with the topic's own clock."""
    rng = np.random.default_rng(0)
    sent = np.arange(times[0], times[-1] + 1.0 / rate, 1.0 / rate)
    sent = sent + np.clip(jitter * rng.normal(size=len(sent)), -0.4 / rate, 0.4 / rate)
    newest = np.maximum(np.searchsorted(sent, times, side="right") - 1, 0)
    return np.stack([np.interp(sent, times, column) for column in values.T], axis=1)[newest]


@pytest.mark.parametrize("rate", [10.0, 25.0, 33.0, 41.7, 60.0, 80.0])
@pytest.mark.parametrize("jitter", [0.0, 1e-3])
def test_the_rate_of_a_held_topic_is_found(rate: float, jitter: float, smooth: Table) -> None:
    positions = hold(smooth.times, smooth.positions, rate, jitter)
    assert smooth.torques is not None
    torques = np.column_stack([smooth.torques[:, 0], hold(smooth.times, smooth.torques, rate, jitter)[:, 1]])
    held = held_columns(replace(smooth, positions=positions, torques=torques))
    assert list(held) == ["q1", "q2", "tau2"]
    for rows in held.values():
        assert 125.0 / rows == pytest.approx(rate, rel=0.05)


@pytest.mark.parametrize("count", [0.0, 1e-5, 1e-3, 1e-2, 0.1])
@pytest.mark.parametrize("rest", [0.0, 0.5])
def test_coarse_counts_slow_joints_and_rests_are_not_held(count: float, rest: float, smooth: Table) -> None:
    """An encoder of few counts repeats its reading, too, but not at a rate of its own."""
    assert smooth.torques is not None
    positions, torques = np.array(smooth.positions), np.array(smooth.torques)
    still = slice(0, int(rest * len(smooth)))
    positions[still], torques[still] = positions[still.stop], torques[still.stop]
    if count:
        positions, torques = np.round(positions / count) * count, np.round(torques / (10 * count)) * 10 * count
    for slower in (1.0, 0.05):
        assert held_columns(replace(smooth, positions=slower * positions, torques=torques)) == {}


def test_a_constant_speed_in_counts_is_not_held() -> None:
    times = np.arange(2000) / 100.0
    positions = np.round(np.outer(times, [0.05, 0.025]) / 1e-3) * 1e-3  # every second and every fourth row is new
    assert held_columns(Table(times, positions)) == {}


def test_lost_messages_now_and_then_are_not_held(smooth: Table) -> None:
    assert smooth.torques is not None
    torques = np.array(smooth.torques)
    torques[50::20] = torques[49:-1:20]
    assert held_columns(replace(smooth, torques=torques)) == {}


def interpolated(experiment: Experiment) -> Experiment:
    """What the finding asks for: held columns interpolated between the rows in which they change."""

    def of(table: Table) -> Table:
        names = set(held_columns(table))
        frame = pd.DataFrame(table.to_dataframe())
        for name in names:
            new = np.append(True, np.diff(frame[name]) != 0.0)
            frame[name] = np.interp(frame["t"], frame["t"][new], frame[name][new])
        n = table.positions.shape[1]
        q, tau = ([f"{prefix}{j + 1}" for j in range(n)] for prefix in ("q", "tau"))
        return Table(frame["t"].to_numpy(), frame[q].to_numpy(), torques=frame[tau].to_numpy())

    motions = tuple(replace(m, table=of(m.table), examined=False) for m in experiment.motions)
    return replace(experiment, motions=motions, warnings=(), findings=())


HELD = {
    "11-log-1kHz-position-40Hz/q-held": ("q1, q2, q3, q4, q5, q6: new only every 12 rows (41.7 Hz in a log of 500 Hz)", ()),
    "11-log-1kHz-position-40Hz/q-and-v-held": ("v5, v6: new only every 12 rows (41.7 Hz", ()),
    "09-log-oddities/tau-held-8Hz": ("tau6, tau7: new only every 12 rows (8.33 Hz", ("torque",)),
    "09-log-oddities/tau4-held-8Hz": ("column tau4: new only every 12 rows (8.33 Hz", ("torque",)),
}
#: Of each log, the second way to hold columns of it.
BESIDE = {"11-log-1kHz-position-40Hz/q-and-v-held", "09-log-oddities/tau-held-8Hz"}


@pytest.mark.skipif(not WILD.is_dir(), reason=f"no recordings under {WILD}; set BAYESID_DATA")
@pytest.mark.parametrize("name", [pytest.param(name, marks=pytest.mark.slow if name in BESIDE else ()) for name in HELD])
def test_held_recordings_are_told_and_the_remedy_improves_what_is_predicted(name: str) -> None:
    experiment = load_experiment(WILD / name)
    says, silences = HELD[name]
    assert says in experiment.findings[0].text and experiment.findings[0].silences == (silences or ("wrench", "torque"))
    mended = interpolated(experiment)
    assert mended.findings == ()
    effects = ["viscous_friction", "coulomb_friction", "torque_offset"]
    before, after = (bayesid.identify(e, effects=effects).validation[0].relative_error for e in (experiment, mended))
    # Of one column of seven the steps that it was held in lie above the band of the rows, and what they do in it is little.
    assert after < (1.0 if "tau4" in name else 0.99) * before
    said = bayesid.check(experiment)
    assert said.warnings[0] == experiment.findings[0].text and said.mistakes == ()


CONTROLS = ["09-log-oddities/control", "07-ur-joint-states-order/control", "03-med7-real/flipped", "12-schunk-lwa4p-short/exp"]


@pytest.mark.skipif(not WILD.is_dir(), reason=f"no recordings under {WILD}; set BAYESID_DATA")
@pytest.mark.parametrize("name", CONTROLS)
def test_nothing_is_found_in_the_controls(name: str) -> None:
    assert load_experiment(WILD / Path(name)).findings == ()
