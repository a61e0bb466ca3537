"""Which effects a planned motion could show: known ambiguities, and a size worked out by other means."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

import bayesid
from bayesid.design.excitation import optimise
from bayesid.design.excitation.diagnosability import diagnosability
from bayesid.design.excitation.optimise import random_feasible
from bayesid.design.excitation.options import ExcitationOptions
from bayesid.design.excitation.plan import make_task
from tests.design.test_excitation import QUICK, experiment_of
from tests.design.test_excitation_quantities import wrench_rows


@pytest.fixture(scope="module")
def planned(tmp_path_factory):
    experiment = experiment_of("ur5", tmp_path_factory.mktemp("arm"))
    task, _ = make_task(experiment, ExcitationOptions(channel="wrench"))
    series = random_feasible(task.coordinates, task.limits, np.random.default_rng(0), 240)
    return experiment, task, series, diagnosability(experiment, task.information, series, 2500.0)


def test_known_ambiguities_are_found(planned):
    """Rotors' momentum is links' inertia, in the wrench; the first encoder's zero is the sensor's yaw, both axes upright."""
    *_, shown = planned
    assert {f"rotor_momentum@joint{k}" for k in range(1, 7)} <= set(shown.hidden)
    by_name = {e.effect.spec: e for e in shown.effects}
    zero = by_name["encoder_offset@joint1"]
    assert zero.rival == "sensor_rotation@sensor" and zero.share > 0.9999
    assert not any(e.effect.spec.startswith("sensor_offset") for e in shown.effects)  # it is in the model
    assert all(0.0 <= e.share <= 1.0 and e.smallest > 0 and e.named >= e.smallest for e in shown.effects)


def test_smallest_delay_is_that_of_the_wrench_rate(planned):
    """A delay adds minus the wrench's rate: by Pinocchio and central differences, less what links and offset explain."""
    experiment, _, series, shown = planned
    robot, count = experiment.robot, 300
    step = series.period / count
    times = step * np.arange(count)
    free = pin.buildModelFromUrdf(str(robot.urdf), pin.JointModelFreeFlyer())
    data = free.createData()

    def wrench(t):
        q, v, a = (x[0] for x in series.at(np.array([t])))
        at = np.r_[np.zeros(6), 1.0, q], np.r_[np.zeros(6), v], np.r_[np.zeros(6), a]
        force = pin.rnea(free, data, *at)[:6]
        return np.r_[force[:3], force[3:] - np.cross([0.0, 0.0, -0.1], force[:3])]

    rate = np.array([(wrench(t + 1e-4) - wrench(t - 1e-4)) / 2e-4 for t in times]) / np.repeat([0.5, 0.05], 3)
    rows, offset = wrench_rows(robot, series.at(times))
    whole = np.hstack([rows, offset])
    values, vectors = np.linalg.eigh(whole.T @ whole / np.outer(*[np.linalg.norm(whole, axis=0) + 1e-12] * 2))
    basis = np.linalg.qr(whole / (np.linalg.norm(whole, axis=0) + 1e-12) @ vectors[:, values > 1e-9])[0]
    rest = rate.ravel() - basis @ (basis.T @ rate.ravel())
    expected = 5.0 / (np.linalg.norm(rest) * np.sqrt(2500.0 / count))
    assert next(e for e in shown.effects if e.effect.spec == "sensor_delay@sensor").smallest == pytest.approx(expected, rel=0.05)


def test_weight_chooses_among_the_motions_found(tmp_path, monkeypatch):
    """With all weight on it, the motion that shows most is taken, though another is better by the criterion."""
    monkeypatch.setattr(optimise, "_ROUNDS", 2)
    experiment = experiment_of("puma560", tmp_path)
    quick = QUICK | {"starts": 2, "seconds": 20.0}
    told = bayesid.excite(experiment, joints=("joint1", "joint2"), harmonics=3, diagnosability=0.0, seed=2, **quick)
    chosen = bayesid.excite(experiment, joints=("joint1", "joint2"), harmonics=3, diagnosability=1e6, seed=2, **quick)
    assert told.diagnosability is not None and chosen.diagnosability is not None
    assert chosen.diagnosability.value <= told.diagnosability.value
    assert chosen.value <= told.value and chosen.within_limits
    assert len(chosen.to_dict()["diagnosability"]["effects"]) == len(chosen.diagnosability.effects)


def test_a_delay_of_all_torques_is_among_the_effects(tmp_path):
    experiment = experiment_of("puma560", tmp_path)
    task, _ = make_task(experiment, ExcitationOptions(channel="torque"))
    series = random_feasible(task.coordinates, task.limits, np.random.default_rng(0), 240)
    shown = diagnosability(experiment, task.information, series, 2500.0)
    assert "torque_delay@robot" in {e.effect.spec for e in shown.effects}


def test_an_offset_that_a_static_run_takes_away_is_not_among_the_effects(tmp_path):
    experiment = experiment_of("puma560", tmp_path)
    task, _ = make_task(experiment, ExcitationOptions(channel="wrench", static=True))
    series = random_feasible(task.coordinates, task.limits, np.random.default_rng(0), 240)
    shown = diagnosability(experiment, task.information, series, 2500.0)
    assert "sensor_offset@sensor" not in {*shown.hidden, *(e.effect.spec for e in shown.effects)}


def test_what_only_rounding_shows_does_not_choose_a_motion(tmp_path):
    """The zero of an encoder about a vertical axis changes no torque: it counts as a hundred, whatever rounding leaves of it."""
    experiment = experiment_of("puma560", tmp_path)
    task, _ = make_task(experiment, ExcitationOptions(channel="torque"))
    values = []
    for recorded in (2500.0, 250000.0):
        series = random_feasible(task.coordinates, task.limits, np.random.default_rng(0), 240)
        shown = diagnosability(experiment, task.information, series, recorded)
        zero = next(e for e in shown.effects if e.effect.spec == "encoder_offset@joint1")
        assert zero.smallest == zero.named == np.inf
        values.append(shown.value)
    # A hundred times the samples show a tenth of each size, and nothing of what is rounding.
    seen = [e.smallest / e.usual for e in shown.effects if np.isfinite(e.smallest)]
    expected = sum(np.log(min(10.0 * size, 100.0) / size) for size in seen) / len(shown.effects)
    assert values[0] - values[1] == pytest.approx(expected)
