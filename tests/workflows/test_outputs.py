"""What `identify` hands on to programs: model.toml, covariances, tables, figures, predicted readings."""

import json
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

import bayesid
from bayesid.regression.problem import prepare
from bayesid.robot.examples import PAPER_LOCKED
from tests.simulated import Motion, Sensor, experiment, fourier, puma2, recording

EFFECTS = ("viscous_friction", "coulomb_friction")
VISCOUS, COULOMB = np.array([3.0, 1.5]), np.array([2.0, 1.0])


def friction(v: np.ndarray) -> np.ndarray:
    """Torques of friction (N, 2) [N m], written out here."""
    return v * VISCOUS + np.sign(v) * COULOMB


def inverse_dynamics(robot, q, v, a) -> np.ndarray:
    """Torques (N, 2) by Pinocchio's recursion on the URDF itself."""
    whole = pin.buildModelFromUrdf(str(robot.urdf))
    still = pin.neutral(whole)
    locked = [whole.getJointId(name) for name in PAPER_LOCKED]
    for name, position in PAPER_LOCKED.items():
        still[whole.joints[whole.getJointId(name)].idx_q] = position
    model = pin.buildReducedModel(whole, locked, still)
    data = model.createData()
    return np.array([pin.rnea(model, data, *x) for x in zip(q, v, a, strict=True)])


def rubbing(robot, seed: int, role: str) -> Motion:
    motion = fourier(robot, seed)
    table = recording(robot, None, motion, seed=seed, torque_std=0.2)
    return Motion(role, role, replace(table, torques=table.torques + friction(motion[2])))


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    robot = puma2(tmp_path_factory.mktemp("arm"))
    motions = [rubbing(robot, 1, "identification"), rubbing(robot, 2, "validation")]
    return bayesid.identify(experiment(robot, motions, effects=EFFECTS, inertia_rel_std=0.1))


def test_the_model_that_is_written_holds_the_effects_found_and_gives_the_same_estimate(result, tmp_path):
    result.write(tmp_path)
    again = result.problem.experiment.with_model(tmp_path / "model.toml")
    assert again.effects == EFFECTS
    assert again.effect_values["viscous_friction@joint1"]["coefficient"] == pytest.approx(VISCOUS[0], abs=0.1)
    assert set(again.effect_values) == {f"{name}@joint{k}" for name in EFFECTS for k in (1, 2)}
    np.testing.assert_allclose(bayesid.identify(again).values, result.values, rtol=1e-9)


def test_a_fit_that_is_not_linear_starts_from_the_model_written_and_fixed_values_stay(result, tmp_path):
    effects = (*EFFECTS, "encoder_offset@joint2")
    stated = {"viscous_friction@joint2": {"coefficient": 1.5, "fixed": True}}
    motions = tuple(
        replace(m, table=replace(m.table, positions=m.table.positions + [0.0, 0.05])) for m in result.problem.experiment.motions
    )
    loaded = replace(result.problem.experiment, motions=motions, effect_values=stated)
    first = bayesid.identify(loaded, effects=effects)
    first.write(tmp_path)
    again = loaded.with_model(tmp_path / "model.toml")
    assert again.effects == effects
    assert again.effect_values["viscous_friction@joint2"] == {"coefficient": 1.5, "fixed": True}
    start = prepare(again).row_model.point.values
    assert start[-1] == first.effects()[-1]["parameters"]["angle"]["value"] != 0.0


def test_the_covariance_written_has_the_effects_behind_the_base_parameters(result, tmp_path):
    result.write(tmp_path)
    document = json.loads((tmp_path / "estimate.json").read_text())
    whole, rank = np.array(document["full_covariance"]), document["rank"]
    np.testing.assert_array_equal(whole[:rank, :rank], document["covariance"])
    names = document["full_covariance_names"]
    assert names[:rank] == [p["name"] for p in document["base_parameters"]] and len(names) == len(whole) == rank + 4
    for effect in document["effects"]:
        k = names.index(f"{effect['name']}@{effect['where']}.{next(iter(effect['parameters']))}")
        assert np.sqrt(whole[k, k]) == pytest.approx(next(iter(effect["parameters"].values()))["std"])


def test_readings_predicted_are_those_of_inverse_dynamics_with_friction_added(result):
    robot = result.problem.experiment.robot
    _, q, v, a = fourier(robot, 7, duration=4.0)
    found = result.predict(q, v, a)
    expected = inverse_dynamics(robot, q, v, a) + friction(v)
    assert found.values.shape == found.std.shape == q.shape and found.channel_names == ("tau1", "tau2") and found.gravity
    moving = np.abs(v) > 0.05  # Coulomb friction turns around in a ramp
    assert np.abs(found.values - expected)[moving].max() < 0.3  # of some 100 N m
    z = (found.values - expected)[moving] / found.std[moving]
    assert 0.3 < np.sqrt(np.mean(z**2)) < 2.0
    np.testing.assert_allclose(found.high - found.low, 2 * 1.959964 * found.std)
    one = result.predict(q[5], v[5], a[5])
    np.testing.assert_allclose(one.values, found.values[5:6])


def test_the_band_is_the_spread_of_predictions_over_estimates(result):
    """Bands from the covariance against predictions of the same readings by draws of the parameters."""
    robot, rng = result.problem.experiment.robot, np.random.default_rng(0)
    _, q, v, a = fourier(robot, 8, duration=0.4)
    draws = rng.multivariate_normal(result.estimate.solution, result.estimate.full_covariance, size=400)
    each = [replace(result, estimate=replace(result.estimate, solution=d)).predict(q, v, a).values for d in draws]
    np.testing.assert_allclose(np.std(each, axis=0), result.predict(q, v, a).std, rtol=0.2)


def test_readings_that_depend_on_time_ask_for_times(result):
    robot = result.problem.experiment.robot
    times, q, v, a = fourier(robot, 7, duration=2.0)
    sensor = Sensor(translation=np.array([0.0, 0.0, -0.1]))
    table = recording(robot, sensor, fourier(robot, 1), force_std=0.1, torque_std=0.1)
    motion = Motion("identification", "identification", table)
    drifting = bayesid.identify(experiment(robot, [motion], sensor, effects=["sensor_drift"]), channel="wrench")
    with pytest.raises(bayesid.InputError, match="give times="):
        drifting.predict(q, v, a)
    early, late = (drifting.predict(q, v, a, times=times + t).values for t in (0.0, 10.0))
    rates = [p["value"] for p in drifting.effects()[-1]["parameters"].values()]
    np.testing.assert_allclose(late - early, np.tile(10.0 * np.array(rates), (len(q), 1)), atol=1e-9)


def test_effects_that_are_not_linear_are_predicted_as_the_model_reads(result):
    robot = result.problem.experiment.robot
    motions = tuple(
        replace(m, table=replace(m.table, positions=m.table.positions + [0.0, 0.05])) for m in result.problem.experiment.motions
    )
    bent = bayesid.identify(replace(result.problem.experiment, motions=motions), effects=[*EFFECTS, "encoder_offset@joint2"])
    _, q, v, a = fourier(robot, 7, duration=2.0)
    found = bent.predict(q + [0.0, 0.05], v, a).values  # what the encoders say of the motion q
    expected = inverse_dynamics(robot, q, v, a) + friction(v)
    assert np.abs(found - expected)[np.abs(v) > 0.05].max() < 0.5


@pytest.mark.parametrize("q, message", [(np.zeros((3, 5)), r"give \(N, 2\)"), (np.full((3, 2), np.nan), "not finite in row 0")])
def test_states_that_cannot_be_are_refused(result, q, message):
    with pytest.raises(bayesid.InputError, match=message):
        result.predict(q, q, q)
