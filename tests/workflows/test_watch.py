"""A series of recordings against one reference: what changed and when, told as it is found, and cut short without loss."""

import json
from dataclasses import replace

import numpy as np
import pytest

import bayesid
from bayesid.cli import main
from bayesid.recordings.experiment import Sensor
from bayesid.regression.options import FitOptions
from bayesid.regression.problem import prepare
from bayesid.validation.mistakes.candidates import Mistake
from bayesid.workflows.warnings import mistaken, mistakes
from tests.simulated import experiment, puma2

TOOL = {
    "payload@joint2": {"m": 0.5, "mcx": 0.1, "mcy": 0.02, "mcz": 0.0, "Ixx": 0.002, "Ixy": -0.004, "Iyy": 0.022, "Izz": 0.023}
}


@pytest.fixture(scope="module")
def series(tmp_path_factory):
    """Reference, two recordings as it was, two with a tool."""
    robot = puma2(tmp_path_factory.mktemp("arm"))
    arm = experiment(robot, [], Sensor(translation=np.array([0.0, 0.0, -0.1])), position_resolution=1e-5)
    path = [bayesid.fourier_trajectory(robot, duration=8.0, seed=1)]
    made = [bayesid.simulate(arm, path, effects=TOOL if k > 2 else (), seed=k) for k in range(5)]
    return [replace(m, name=f"day{k}") for k, m in enumerate(made)]


@pytest.fixture(scope="module")
def watched(series):
    return bayesid.watch(series[0], series[1:])


def test_the_first_recording_with_the_tool_is_told(watched, series, tmp_path):
    assert [w.verdict for w in watched.recordings] == ["nothing_missing", "nothing_missing", "named", "named"]
    assert watched.history == {"payload@joint2": ("day3", "day4")}
    assert watched.sentences() == ["payload@joint2: first in day3, in all recordings from then on"]
    for w in watched.recordings[2:]:
        mass = w.changes[0].values[0]
        assert abs(mass.value - 0.5) < 3.0 * mass.std
    alone = bayesid.diagnose(series[3], reference=series[0])
    assert watched.recordings[2].comparison.scores[0][1] == pytest.approx(alone.comparison.scores[0][1], rel=1e-12)
    assert watched.recordings[2].gap == pytest.approx(alone.to_dict()["gap"]["before"], rel=1e-12)
    page = watched.write(tmp_path / "out").read_text(encoding="utf-8")
    assert page.count("<svg") == 3 and "day4" in page
    told = json.loads((tmp_path / "out" / "watch.json").read_text(encoding="utf-8"))
    assert told["history"] == {"payload@joint2": ["day3", "day4"]} and told["planned"] == 4
    assert repr(watched) == "<Watch of 4 recordings against day0: 2 with changes>"
    assert "payload@joint2 m" in str(watched) and "<table" in watched._repr_html_()


def test_what_is_left_is_that_of_the_motions_that_are_compared(series):
    one = series[1].motions[0]
    other = replace(one, name="other", table=replace(one.table, wrench=2.0 * one.table.wrench))
    found = bayesid.watch(series[0], replace(series[1], motions=(one, other)), motions=one.name)
    assert [p.motion for p in found.recordings[0].left] == [one.name] and found.recordings[0].times_noise < 1.2


def test_a_change_without_a_name_is_told(watched):
    still, _, changed, _ = watched.recordings
    unknown = replace(changed, comparison=replace(changed.comparison, verdict="unknown", changes=()))
    said = "Changed in day3, and no effect of the library is confirmed to explain any of it"
    assert replace(watched, recordings=(still, unknown), planned=2).sentences() == [said]
    assert replace(watched, recordings=(still,), planned=1).sentences() == ["Nothing changed that these recordings could show"]


def test_a_longer_series_asks_for_more_evidence(watched):
    """Bonferroni: the chance of a false name in the whole series is that of one recording."""
    assert watched.accept == pytest.approx(12.0 + np.log(4.0))


def test_what_cannot_be_compared_is_told_in_its_place(series, tmp_path):
    from tests.robots import ur5, write

    robot = bayesid.load_robot(write(tmp_path, ur5()))
    other = bayesid.simulate(experiment(robot, [], Sensor()), [bayesid.fourier_trajectory(robot, duration=4.0)], seed=0)
    found = bayesid.watch(series[0], [replace(other, name="other"), series[1]])
    assert [w.verdict for w in found.recordings] == ["not_compared", "nothing_missing"]
    assert "same robot" in str(found.recordings[0]) and found.to_dict()["recordings"][0]["complaint"]
    found.write(tmp_path / "out")
    with pytest.raises(bayesid.InputError, match="none of the recordings could be compared"):
        bayesid.watch(series[0], [other])
    with pytest.raises(bayesid.InputError, match="no recordings"):
        bayesid.watch(series[0], [])


@pytest.mark.parametrize(
    ("duration", "rate", "says"), [(0.6, 60.0, "10 numbers leave no residual"), (1.0, 25.0, "16 parameters for 16 numbers")]
)
def test_recordings_that_are_too_short_are_refused_in_one_line(duration, rate, says, series):
    path = [bayesid.fourier_trajectory(series[0].robot, duration=duration, rate=rate, seed=1, harmonics=2, fundamental=0.5)]
    short = bayesid.simulate(experiment(series[0].robot, []), path, seed=0)
    with pytest.raises(bayesid.InputError, match=says):
        bayesid.watch(short, [short])


def test_an_interrupted_series_is_kept(series, tmp_path, capsys, monkeypatch):
    for made in series[:4]:
        bayesid.write_experiment(made, tmp_path / made.name)
    plain, seen = bayesid.watch, []

    def stopped(*args, tell, **options):
        def stop(recording):
            tell(recording)
            seen.append(recording)
            if len(seen) == 2:
                raise KeyboardInterrupt

        return plain(*args, tell=stop, **options)

    monkeypatch.setattr(bayesid, "watch", stopped)
    folders = [str(tmp_path / f"day{k}") for k in range(4)]
    assert main(["watch", *folders, "--out", str(tmp_path / "out")]) == 1
    said = capsys.readouterr()
    assert "interrupted after 2 of 3" in said.err and "day2: nothing changed" in said.out
    told = json.loads((tmp_path / "out" / "watch.json").read_text(encoding="utf-8"))
    assert [w["name"] for w in told["recordings"]] == ["day1", "day2"]
    monkeypatch.undo()
    assert main(["watch", folders[0], str(tmp_path / "none")]) == 2
    assert len(capsys.readouterr().err.strip().splitlines()) == 1


def reversed_wrench(made):
    """Readings of what the robot does to the sensor."""
    return replace(made, motions=tuple(replace(m, table=replace(m.table, wrench=-m.table.wrench)) for m in made.motions))


def test_mistakes_of_recordings_and_reference_are_told(series, tmp_path):
    """A reversed wrench was a payload of -48 kg, without a word."""
    wrong = [replace(reversed_wrench(s), name=f"{s.name}-reversed") for s in series[:2]]
    told = "The wrench seems to be that of the robot on the sensor"
    for before, after, place in ((series[0], wrong[1], 0), (wrong[0], series[1], -1)):
        change, watched = bayesid.diagnose(after, reference=before), bayesid.watch(before, [after])
        assert told in change.remarks[place] and change.remarks[place].startswith("In the reference: ") == (place == -1)
        assert told in str(change) and told in change.to_dict()["remarks"][place]
        assert [told in w for w in watched.all_warnings].count(True) == 1 and told in str(watched)
        kept = watched.to_dict()
        assert change.remarks[place] in (kept["recordings"][0] if place == 0 else kept)["warnings"]
        assert told in watched.write(tmp_path / after.name).read_text(encoding="utf-8")
    assert told in bayesid.accuracy(wrong[0], runs=0).warnings[0]


def test_mistakes_are_searched_once(series, monkeypatch):
    searched = []
    monkeypatch.setattr("bayesid.validation.mistakes.search.find_mistakes", lambda e: searched.append(e) or ())
    for verb in (bayesid.diagnose, bayesid.payload, bayesid.calibrate):
        verb(replace(series[1], inertia_rel_std=0.05))
        assert [e.name for e in searched] == ["day1"], verb.__name__
        searched.clear()


@pytest.mark.parametrize("name", ["sensor_delay", "joint_flexibility", "base_compliance", "viscous_friction"])
def test_what_gives_explains_that_readings_lag(series, monkeypatch, name):
    """Beside a flexible joint that was right the reader was told to shift the wrench by 7 ms first."""
    late = Mistake("wrench_delay", "", "The wrench is late", "wrench", 40.0, (), ())
    monkeypatch.setattr("bayesid.validation.mistakes.search.find_mistakes", lambda _: (late,))
    assert bool(mistakes(series[0], [name])) == (name == "viscous_friction")
    where = {"sensor_delay": "sensor", "base_compliance": "base"}.get(name, "joint1")
    problem = prepare(series[0], FitOptions(effects=[f"{name}@{where}"]))
    assert bool(mistaken(problem, (), impossible=True)) == (name == "viscous_friction")


@pytest.mark.parametrize("name", ["sensor_rotation", "base_tilt", "sensor_offset"])
def test_a_turned_sensor_explains_that_gravity_seems_turned(series, monkeypatch, name):
    """Beside a sensor that was turned by 21 degrees, rightly named, the reader was told to tilt the base by 21 degrees first."""
    tilted = Mistake("base_tilt", "", "The base seems to be tilted", "wrench", 40.0, (), ())
    monkeypatch.setattr("bayesid.validation.mistakes.search.find_mistakes", lambda _: (tilted,))
    assert bool(mistakes(series[0], [name])) == (name == "sensor_offset")


def test_a_recording_too_short_for_a_measure_of_noise_is_not_compared(tmp_path):
    """Its own fit leaves nothing: nine changes were named of a robot as it was, at billions of times what that leaves."""
    robot = puma2(tmp_path)
    arm = experiment(robot, [], position_resolution=2e-5, effects=("viscous_friction", "coulomb_friction"))
    drives = {f"viscous_friction@joint{k}": {"coefficient": 1.0} for k in (1, 2)}
    drives |= {f"coulomb_friction@joint{k}": {"level": 2.0} for k in (1, 2)}
    recorder = bayesid.Recorder(torque_std=0.05, resolution=2e-5)
    path = [bayesid.fourier_trajectory(robot, duration=8.0, seed=1)]
    before, later = (bayesid.simulate(arm, path, effects=drives, recorder=recorder, seed=k) for k in range(2))

    def first(seconds):
        table = later.motions[0].table
        rows = table.times < seconds
        short = replace(table, times=table.times[rows], positions=table.positions[rows], torques=table.torques[rows])
        return replace(later, name=f"{seconds} s", motions=(replace(later.motions[0], table=short),))

    watched = bayesid.watch(before, [first(0.8), first(1.0), first(2.0)])
    assert [w.verdict for w in watched.recordings] == ["not_compared", "not_compared", "nothing_missing"]
    assert "record longer" in watched.recordings[0].complaint
    assert watched.recordings[2].comparison.errors.floor == pytest.approx(1.0)
