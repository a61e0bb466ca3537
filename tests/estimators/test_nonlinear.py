"""Effects that readings are not linear in: simulated, estimated again, and held where they are fixed."""

from dataclasses import replace

import numpy as np
import pytest

import bayesid
from bayesid.effects import EffectLibrary
from bayesid.estimators import nonlinear
from bayesid.estimators.exact_rows import ExactRows
from bayesid.estimators.nonlinear import solve
from bayesid.recordings.experiment import Experiment, Sensor
from bayesid.regression.options import FitOptions
from bayesid.regression.problem import prepare
from bayesid.robot.robot import load_robot
from bayesid.simulation.simulation import complete_effects
from bayesid.simulation.trajectories import new_trajectories
from tests.robots import ROBOTS, write

LOADS = ("payload", "inertia_error")


@pytest.fixture(scope="module")
def setup(tmp_path_factory):
    robot = load_robot(write(tmp_path_factory.mktemp("puma"), ROBOTS["puma560"]()))
    sensor = Sensor(translation=(0.0, 0.0, -0.1), force_std=0.2, torque_std=0.02)
    return Experiment("puma", robot, (), sensor, inertia_rel_std=0.1, gear_ratio={"joint2": 107.0})


@pytest.fixture(scope="module")
def motions(setup):
    return new_trajectories(setup.robot, 12.0)[:1]


RECORDER = bayesid.Recorder(resolution=0.0, force_std=0.2, torque_std=0.02, drive_std=0.001)
#: What each is started from where it would not find the truth by itself.
STARTS = {
    "torque_ripple@joint2": {"periods": 19.9, "amplitude": 0.1},
}


def fit(setup, motions, effects, channel="both", starts=None, given=None):
    """Estimate with the effects that the recording was made with; every value with its standard deviation and the truth."""
    plant = complete_effects(setup.robot, given or effects, {})
    recording = bayesid.simulate(setup, motions, effects=plant, recorder=RECORDER, seed=3)
    recording = replace(recording, effect_values=starts or {})
    problem, estimate = solve(prepare(recording, FitOptions(channel, effects=effects)))
    rank = problem.row_model.base.rank
    names = problem.regression.effect_names
    truth = {f"{spec}.{key}": value for spec, values in plant.items() for key, value in values.items()}
    return {
        name: (estimate.solution[rank + k], estimate.full_std[rank + k], truth.get(name, 0.0)) for k, name in enumerate(names)
    }, problem


@pytest.mark.parametrize(
    ("spec", "channel"),
    [
        ("sensor_gain@mx", "wrench"), ("sensor_crosstalk@fx->mz", "wrench"), ("sensor_rotation", "wrench"),
        ("coupled_transmission@joint2->joint3", "torque"),
        ("sensor_delay", "wrench"), ("base_tilt", "both"), ("encoder_offset@joint2", "wrench"),
        ("encoder_offset@joint3", "torque"),
        ("joint_flexibility@joint2", "both"), ("fluid_drag", "both"),
        pytest.param("base_compliance@base", "wrench", marks=pytest.mark.slow),  # as test_mounts.py, there without a start
        ("torque_gain@joint2", "both"), ("load_friction@joint2", "torque"), ("stribeck_friction@joint2", "torque"),
        ("torque_ripple@joint2", "torque"), ("rotor_momentum@joint2", "both"),
    ],
)  # fmt: skip
def test_simulated_effects_are_found_again(setup, motions, spec, channel):
    found, problem = fit(setup, motions, [spec], channel, STARTS)
    mine = {k: v for k, v in found.items() if not k.startswith("sensor_offset")}
    assert mine and problem.row_model.point is not None
    for name, (value, std, truth) in mine.items():
        assert np.isfinite(std), name
        # The phase of a ripple turns by whole turns.
        miss = (value - truth + np.pi) % (2 * np.pi) - np.pi if name.endswith("phase") else value - truth
        assert abs(miss) < 4 * std + 0.01 * abs(truth), (name, value, std, truth)


def test_steps_that_turn_back_end_soon_at_the_minimum(setup, motions, monkeypatch):
    """Of Stribeck friction each may turn back by 60 to 90 % of the last: all 15 that are allowed were taken here."""
    steps, step = list[nonlinear.Fitted](), nonlinear.Fitted.next

    def counted(self: nonlinear.Fitted) -> nonlinear.Fitted | None:
        steps.append(self)
        return step(self)

    monkeypatch.setattr(nonlinear.Fitted, "next", counted)
    effects = [f"{kind}@joint{j}" for j in (1, 2, 3) for kind in ("viscous_friction", "coulomb_friction", "stribeck_friction")]
    plant = complete_effects(setup.robot, effects, {})
    plant |= {spec: {"level": 3.0, "velocity": 0.5} for spec in effects if spec.startswith("stribeck")}
    recording = bayesid.simulate(setup, motions, effects=plant, recorder=bayesid.Recorder(resolution=0.0, drive_std=0.05), seed=3)
    problem, estimate = solve(prepare(recording, FitOptions("torque", effects=effects)))
    assert len(steps) <= 10
    exact = ExactRows(problem, {"trajectory": estimate.noise["trajectory"].std})
    least, chi2 = exact.least(exact.start, tolerance=1e-12)
    assert np.sum(exact.rows(exact.start)[0] ** 2) < chi2 + 0.01
    seen = ~estimate.undetermined
    assert np.all(np.abs(least - estimate.solution)[seen] < 0.1 * estimate.full_std[seen])


def test_friction_that_the_rows_do_not_tell_is_led_nowhere(setup, motions):
    """Stribeck friction where there is none runs away; a descent led it to no speed, at kilonewton metres."""
    effects = [f"{kind}@joint{j}" for j in (1, 2, 3) for kind in ("viscous_friction", "stribeck_friction")]
    plant = complete_effects(setup.robot, [spec for spec in effects if spec.startswith("viscous")], {})
    recording = bayesid.simulate(setup, motions, effects=plant, recorder=bayesid.Recorder(resolution=0.0, drive_std=0.5), seed=3)
    problem, _ = solve(prepare(recording, FitOptions("torque", effects=effects)))
    point = problem.row_model.point
    assert point is not None and point.unsettled is not None and point.unsettled.any()
    assert np.abs(point.values).max() < 50.0


def test_a_mean_of_two_estimates_is_where_no_step_is_left_of_linear_steps():
    rng = np.random.default_rng(1)
    times, columns = 0.01 * np.arange(400), rng.normal(size=(400, 1, 3))
    estimate = bayesid.fit(bayesid.Regression.from_arrays(columns, columns @ np.ones(3) + rng.normal(size=(400, 1)), times=times))
    end, way = rng.normal(size=3), rng.normal(size=3)

    def pointed_to(at: np.ndarray) -> np.ndarray:
        return end - 0.8 * (at - end)

    first, second = end + way, end - 0.5 * way
    mean = nonlinear.where_no_step_is_left(second, replace(estimate, solution=pointed_to(second)), first, pointed_to(first))
    assert mean.solution == pytest.approx(end)
    ahead = replace(estimate, solution=second + way)  # a step on is taken as it is
    assert nonlinear.where_no_step_is_left(second, ahead, second - way, second) is ahead


def test_fixed_values_are_kept(setup, motions):
    """A payload that is known is taken off, and the links are those without it."""
    given = {"payload@joint6": {"m": 1.5, "mcx": 0.05, "mcy": 0.0, "mcz": 0.1, "Ixx": 0.02, "Iyy": 0.02, "Izz": 0.01}}
    given["payload@joint6"] |= {"Ixy": 0.0, "Ixz": 0.0, "Iyz": 0.0}
    starts = {"payload@joint6": given["payload@joint6"] | {"fixed": True}}
    found, problem = fit(setup, motions, ["payload@joint6"], "torque", starts, given)
    assert not found
    nominal = problem.row_model.base.matrix @ setup.robot.nominal.ravel()
    estimate = solve(problem)[1]
    assert np.all(np.abs(estimate.values - nominal) < 5 * estimate.std + 1e-3)
    result = bayesid.identify(
        replace(problem.experiment, effects=("payload@joint6",), effect_values=starts), channel="torque"
    )  # fmt: skip
    (entry,) = result.to_dict()["effects"]
    assert entry["parameters"]["m"] == {"value": 1.5, "std": None, "low": None, "high": None, "unit": "kg"}
    assert result.fitted[0].whitened_rms == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize("name", EffectLibrary().classes)
def test_every_effect_can_be_simulated_and_modelled(setup, motions, name):
    """One place of each: the recording differs from that without it, and a model with the true values explains it."""
    kind = EffectLibrary().classes[name]
    where = {
        "joint": "@joint2",
        "joint|robot": "@joint2",
        "axis": "@fy",
        "axis->axis": "@mx->fz",
        "joint->joint": "@joint1->joint2",
    }.get(kind.at, "")
    spec = name + where
    plant = complete_effects(setup.robot, [spec], {})
    quiet = bayesid.Recorder(resolution=0.0, force_std=1e-3, torque_std=1e-4, drive_std=1e-5)
    plain = bayesid.simulate(setup, motions, recorder=quiet, seed=1).motions[0].table
    recording = bayesid.simulate(setup, motions, effects=plant, recorder=quiet, seed=1)
    table = recording.motions[0].table
    change = np.abs(np.hstack([table.wrench - plain.wrench, table.torques - plain.torques, table.positions - plain.positions]))
    assert change.max() > 1e-3
    held = {key: {**values, "fixed": True} for key, values in plant.items()}
    offset = {"sensor_offset": {"fixed": True}} if name != "sensor_offset" else {}
    known = replace(recording, effect_values=held | offset)
    problem = prepare(known, FitOptions("both", effects=[spec, *offset], bandwidth=15.0))
    solution = problem.row_model.point.base
    assert problem.regression.effect_names == ()
    error, signal = 0.0, 0.0
    for block in problem.regression.rows.blocks():
        error = max(error, float(np.sqrt(np.mean((block.target - block.matrix @ solution) ** 2, axis=0)).max()))
        signal = max(signal, float(np.sqrt(np.mean(block.target**2, axis=0)).max()))
    # As teeth cross their play the motor makes a step that is faster than positions are smoothed to: docs/reference/effects.md.
    share = {"joint_flexibility": 0.05, "base_compliance": 0.05, "backlash": 0.1}.get(name, 0.01)
    assert error < share * change.max() + 1e-3 * signal
