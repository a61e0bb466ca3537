"""A recording that is read in chunks beside the same one in memory."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import bayesid
from bayesid.errors import InputError
from bayesid.recordings import stored
from bayesid.recordings.experiment import Experiment, Motion, Sensor, load_experiment
from bayesid.recordings.writer import write_experiment
from bayesid.regression import rows
from bayesid.regression.options import FitOptions
from bayesid.regression.problem import prepare
from bayesid.signals.filters import LowPass
from tests.simulated import fourier, puma2, recording

pytest.importorskip("pyarrow")


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """Two joints, 300 s at 125 Hz with a gap, in a Parquet file of small row groups; and a validation motion."""
    folder = tmp_path_factory.mktemp("long")
    robot = puma2(folder)
    noise = dict(force_std=0.3, torque_std=0.1, resolution=1e-5, offset=0.5)
    table = recording(robot, Sensor(), fourier(robot, 3, 300.0), seed=1, **noise)
    table = table[np.r_[:30_000, 30_100 : len(table)]]
    unseen = recording(robot, Sensor(), fourier(robot, 2, 20.0), seed=2, **noise)
    motions = (Motion("long", "identification", table), Motion("unseen", "validation", unseen))
    write_experiment(Experiment("long", robot, motions, Sensor(), position_resolution=1e-5), folder / "e")
    table.to_dataframe().to_parquet(folder / "e" / "long.parquet", row_group_size=3000)
    return folder / "e"


@pytest.fixture
def small(monkeypatch) -> None:
    """Chunks of a few thousand samples, windows of two runs of samples."""
    monkeypatch.setattr(rows, "_CHUNK", 512)
    monkeypatch.setattr(rows, "_BLOCK_ROWS", 500)
    monkeypatch.setattr(rows, "_TASK_SAMPLES", 4000)
    monkeypatch.setattr(rows, "_WINDOW", 2)


def load(folder: Path, flag: str, table: str = "long.parquet") -> Experiment:
    """The experiment, with its first motion from a file that is read in chunks (``true``), whole (``false``), or as it is."""
    chunked = f", chunked = {flag}" if flag else ""
    toml = (folder / "experiment.toml").read_text()
    toml, count = re.subn(r'table = "(?!unseen)[^}]*}', f'table = "{table}"{chunked} }}', toml)
    assert count == 1
    (folder / "experiment.toml").write_text(toml)
    return load_experiment(folder)


def blocks_of(experiment: Experiment, options: FitOptions):
    """All blocks of its regression."""
    return list(prepare(experiment, options).regression.rows.blocks())


@pytest.mark.parametrize(
    "options",
    [
        FitOptions("wrench"),
        FitOptions("torque", bandwidth=4.0, effects=["coulomb_friction", "viscous_friction"]),
        FitOptions("both", bandwidth=4.0),
        FitOptions("torque", low_pass=LowPass(2.0, 50.0), bandwidth=4.0),
        FitOptions("wrench", bandwidth=4.0, effects=["sensor_delay"]),
        FitOptions("wrench", low_pass=LowPass(2.0, 50.0), bandwidth=4.0, effects=["sensor_delay"]),
    ],
    ids=["chosen bandwidth", "friction", "both", "filters", "about a point", "filters about a point"],
)
def test_rows_are_those_of_the_whole_recording(folder, small, options):
    whole, chunked = (blocks_of(load(folder, flag), options) for flag in ("false", "true"))
    assert len(whole) == len(chunked) > 8
    size = np.sqrt(np.mean(np.concatenate([b.rows for b in whole]) ** 2, axis=0))
    for one, other in zip(whole, chunked, strict=True):
        assert (one.motion, one.start, one.group) == (other.motion, other.start, other.group)
        np.testing.assert_allclose(other.times, one.times, rtol=1e-14)
        off = np.abs(other.rows - one.rows) / np.maximum(size, 1e-3 * size.max(axis=1, keepdims=True))
        assert off.max() < 1e-8  # ends of the pieces that are smoothed on their own: 0.43**28


@pytest.mark.parametrize("method", ["wls", "huber", *(pytest.param(name, marks=pytest.mark.slow) for name in ("ols", "gls"))])
def test_estimates_agree(folder, small, method):
    whole, chunked = (bayesid.identify(load(folder, flag), "wrench", method) for flag in ("false", "true"))
    std = whole.estimate.full_std
    assert np.max(np.abs(chunked.estimate.solution - whole.estimate.solution) / std) < 1e-5
    np.testing.assert_allclose(chunked.estimate.full_std, std, rtol=1e-5)
    assert any("of which few are in memory" in text for text in chunked.warnings)
    assert chunked.validation[0].rmse == pytest.approx(whole.validation[0].rmse, rel=1e-6)


@pytest.mark.parametrize("channel", ["wrench", "torque"])
def test_an_excerpt_s_ends_are_no_gaps_and_its_rows_those_of_the_model(folder, monkeypatch, channel):
    """Of a recording longer than its excerpt `identify` stopped without a message, and `check` told gaps that are none."""
    monkeypatch.setattr(stored, "_EXCERPT_ROWS", 8_000)
    found = bayesid.identify(load(folder, "true"), channel, effects=["coulomb_friction", "viscous_friction"])
    (told,) = (text for text in found.warnings if "gap at" in text)
    times = found.problem.experiment.motions[0].stored.gap_times
    assert len(times) == 1 and told.count(" to ") == 1 and f"gap at {times[0][0]:.6g} to {times[0][1]:.6g} s (" in told
    assert found.validation[0].whitened_rms < 1.2


def test_csv_is_read_as_parquet_is(folder, small, monkeypatch):
    monkeypatch.setattr(stored, "_LINES_BYTES", 1 << 20)
    parquet = load(folder, "true").motions[0].stored
    csv = load(folder, "true", "long.csv").motions[0].stored
    assert parquet is not None and csv is not None and len(csv.parts) > 3
    assert len(csv) == len(parquet) and csv.segments() == parquet.segments() and len(csv.segments()) == 2
    one, other = csv.read(4000, 21000), parquet.read(4000, 21000)
    assert all(np.array_equal(one[group], other[group]) for group in ("t", "positions", "wrench", "torques"))
    for time in (-1.0, 0.0, 24.0, 57.1234, 239.99, 240.9, 1e3):
        times = load(folder, "false").motions[0].table.times
        assert csv.index(time) == np.searchsorted(times, time) and parquet.index(time, "right") == np.searchsorted(
            times, time, "right"
        )


def test_rows_without_a_reading_are_left_out(folder, small, tmp_path):
    import pandas as pd

    frame = pd.read_parquet(folder / "long.parquet")
    frame.loc[[10, 2999, 3000, 7777], ["fx", "q2", "t", "tau1"]] = np.nan
    frame.loc[12_000, "t"] = frame.loc[11_999, "t"]  # the first row of a row group
    frame.to_parquet(folder / "holes.parquet", row_group_size=3000)
    whole, chunked = (load(folder, flag, "holes.parquet") for flag in ("false", "true"))
    read = chunked.motions[0].stored
    assert read is not None and len(read) == len(whole.motions[0].table)
    assert np.array_equal(read.read(0, len(read))["t"][:, 0], whole.motions[0].table.times)
    assert any("5 rows without a reading" in text for text in chunked.warnings)


def test_what_cannot_be_read_in_chunks_is_refused(folder, small):
    import pandas as pd

    frame = pd.read_parquet(folder / "long.parquet")
    for column, row, value, said in [
        ("t", 5000, 0.0, "time goes back"),
        ("t", 6000, 1.0, "times must strictly increase"),  # between row groups
        ("q2", 9001, 9.0, "unwrap the angle"),
        ("q2", 9000, 9.0, "unwrap the angle"),
        ("fx", 7000, np.inf, "inf is no reading"),
    ]:
        wrong = frame.copy()
        wrong.loc[row, column] = value
        wrong.to_parquet(folder / "wrong.parquet", row_group_size=3000)
        with pytest.raises(InputError, match=said):
            load(folder, "true", "wrong.parquet")
    toml = (folder / "experiment.toml").read_text()
    for more, said in [
        ("period = 10.0", "goes without period"),
        ("parked = [[0.0, 1.0]]", "goes without parked"),
        ('static = "long.csv"', "static run row by row"),
    ]:
        load(folder, "true")
        text = (folder / "experiment.toml").read_text()
        (folder / "experiment.toml").write_text(text.replace("chunked = true", f"chunked = true, {more}"))
        with pytest.raises(InputError, match=said):
            load_experiment(folder)
    (folder / "experiment.toml").write_text(toml)
    with pytest.raises(InputError, match="copy the folder"):
        write_experiment(load(folder, "true"), folder / "again")
    for method in ("tls", "iv"):
        with pytest.raises(InputError, match="is read in chunks"):
            bayesid.identify(load(folder, "true"), "torque", method)


def test_large_tables_are_read_in_chunks_without_being_asked(folder, monkeypatch):
    assert load(folder, "").motions[0].stored is None
    monkeypatch.setattr(stored, "LARGE", 1_000_000)
    monkeypatch.setattr(stored, "_EXCERPT_ROWS", 8000)
    experiment = load(folder, "")
    read = experiment.motions[0].stored
    assert read is not None and len(experiment.motions[0].table) == 8000
    assert replace(read).segments() == read.segments()


@pytest.mark.slow
def test_starts_of_a_cable_are_tried_on_pieces(folder):
    """There is no cable, and its stiffness says so. Starts are tried on pieces of a recording read in chunks."""
    found = bayesid.identify(load(folder, "true"), effects=["tether@joint2"], bandwidth=5.0).estimate.parameters()
    at = found.names.index("tether@joint2.stiffness")
    assert found.low[at] < 0.0 < found.high[at]
