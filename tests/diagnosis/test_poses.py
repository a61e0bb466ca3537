"""A diagnosis of poses at rest: the wrench of each is a measurement of its own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import bayesid
from bayesid.errors import InputError
from bayesid.recordings.experiment import Sensor
from bayesid.report.diagnosis import diagnosis_report
from bayesid.simulation.trajectories import Trajectory
from tests.simulated import experiment, puma2

EFFECTS = {
    "sensor_crosstalk@mx->fz": {"coefficient": 0.1},
    "sensor_rotation@sensor": {"rx": 0.05, "ry": 0.0, "rz": 0.03},
    "payload@joint2": {"m": 4.0, "mcx": 1.2, "Ixx": 0.02, "Iyy": 0.4, "Izz": 0.4},
}


def poses(name: str, role, count: int, seed: int) -> Trajectory:
    q = np.random.default_rng(seed).uniform(-2.0, 2.0, (count, 2))
    return Trajectory(name, role, np.arange(float(count)), q, 0.0 * q, 0.0 * q, kind="poses")


def recorded(folder: Path, effects: dict, seed: int = 1) -> bayesid.Simulation:
    """140 poses of the two-joint robot, links known to 1 %."""
    robot = puma2(folder)
    setup = experiment(robot, [], Sensor(translation=np.array([0.0, 0.0, -0.1])), inertia_rel_std=0.01)
    planned = [poses("identification", "identification", 100, seed), poses("validation", "validation", 40, seed + 1)]
    recorder = bayesid.Recorder(force_std=0.2, torque_std=0.02, resolution=1e-5)
    return bayesid.simulate(setup, planned, effects=effects, recorder=recorder, seed=seed)


@pytest.mark.parametrize(
    ("effect", "stated"),
    [
        *(pytest.param(effect, True, id=f"{effect}-noise stated") for effect in EFFECTS),
        pytest.param("sensor_crosstalk@mx->fz", False, id="sensor_crosstalk@mx->fz-noise not stated"),
        pytest.param("payload@joint2", False, id="payload@joint2-noise not stated", marks=pytest.mark.slow),
        pytest.param("sensor_rotation@sensor", False, id="sensor_rotation@sensor-noise not stated", marks=pytest.mark.slow),
    ],
)
def test_a_hidden_effect_is_named(effect: str, stated: bool, tmp_path: Path) -> None:
    simulation = recorded(tmp_path, {effect: EFFECTS[effect]})
    assert simulation.sensor is not None
    if not stated:
        simulation = replace(simulation, sensor=replace(simulation.sensor, force_std=None, torque_std=None))
    diagnosis = bayesid.diagnose(simulation, channel="wrench")
    assert diagnosis.verdict == "named" and [f.term.effect.spec for f in diagnosis.found] == [effect]
    (entry,) = diagnosis.to_dict()["effects"]
    for key, truth in EFFECTS[effect].items():
        value, std = entry["parameters"][key]["value"], entry["parameters"][key]["std"]
        if std is not None:
            assert abs(value - truth) < 5.0 * std
    # A body is told by how far the links would be from the nominal ones without it; the sensor's effects by what they leave.
    assert diagnosis.gap.after < 1.1 and (diagnosis.gap.before > 2.0 or effect.startswith("payload"))
    diagnosis.write(tmp_path / "out")
    assert (tmp_path / "out" / "report.html").stat().st_size > 10_000


@pytest.mark.parametrize("seed", [1, 2, 3, 4])
def test_nothing_is_named_where_nothing_is_missing(seed: int, tmp_path: Path) -> None:
    assert bayesid.diagnose(recorded(tmp_path, {}, seed), channel="wrench").verdict == "nothing_missing"


def test_when_poses_were_taken_changes_nothing_but_a_drift(tmp_path: Path) -> None:
    """Seconds apart as they are recorded, at uneven times, or just numbered; only the sensor's drift looks at the times."""
    made = recorded(tmp_path, {"sensor_gain@mx": {"gain": 0.05}})
    assert made.sensor is not None
    unknown = replace(made, sensor=replace(made.sensor, force_std=None, torque_std=None))
    waits = np.random.default_rng(3).uniform(2.0, 12.0, 200)

    def at(experiment: bayesid.Experiment, times: Callable[[int], np.ndarray]) -> bayesid.Diagnosis:
        motions = [replace(m, table=replace(m.table, times=times(len(m.table)))) for m in experiment.motions]
        return bayesid.diagnose(replace(experiment, motions=tuple(motions)), channel="wrench")

    for setup in (made, unknown):
        numbered = at(setup, lambda n: np.arange(float(n)))
        assert numbered.verdict == "named" and "filtered" not in " ".join(numbered.remarks)
        for times in (lambda n: 8.0 * np.arange(n), lambda n: 0.01 * np.arange(n), lambda n: np.cumsum(waits[:n])):
            timed = at(setup, times)
            assert [f.term for f in timed.found] == [f.term for f in numbered.found]
            assert timed.found[0].std == pytest.approx(numbered.found[0].std)


def test_torques_of_poses_hold_friction_and_say_nothing(tmp_path: Path) -> None:
    poses = recorded(tmp_path, {})
    with pytest.raises(InputError, match="where friction holds with whatever torque.*, or take the wrench of the sensor with"):
        bayesid.diagnose(poses, channel="torque")
    bare = tuple(replace(m, table=replace(m.table, wrench=None)) for m in poses.motions)
    with pytest.raises(InputError, match="record a trajectory$"):
        bayesid.diagnose(replace(poses, motions=bare, sensor=None))


def test_poses_that_leave_a_name_open_ask_for_no_planned_motion(shared: Callable[[str], Path]) -> None:
    """A real wrist: nothing is known of the noise of a motion there, so none is planned, and the words alone say what to do."""
    diagnosis = bayesid.diagnose(shared("data/kuka-med-wrist"))
    assert diagnosis.verdict == "ambiguous" and diagnosis.found[0].rivals
    said = diagnosis.to_dict()
    assert "poses" in said["next_experiment"] and "speed" not in said["next_experiment"]
    assert said["next_motion"] is None


def test_trajectories_beside_fitted_poses_take_no_part_in_the_search_and_have_errors(shared: Callable[[str], Path]) -> None:
    """What is said of motions agrees with what took part, poses are told by their number, and nothing of frequencies is said."""
    diagnosis = bayesid.diagnose(shared("data/kuka-med-wrist"))
    assert {(name, why) for name, why in diagnosis.data.skipped} == {
        (name, "poses at rest are fitted, not trajectories") for name in ("baseline", "vibrations")
    }
    assert [e.motion for e in diagnosis.errors if not e.fitted] == ["baseline", "vibrations"]
    text, page = str(diagnosis), diagnosis_report(diagnosis)
    for said in (text, page, diagnosis._repr_html_()):
        assert "No motion that took no part in the fit" not in said and "On the fitted one" not in said
    assert "On ‘baseline’ and ‘vibrations’, which took no part in any fit" in page
    assert "no validation motion" not in page
    assert "pose 23:" in text and " Hz" not in text and "time [s]" not in page and "run at rest" not in page
