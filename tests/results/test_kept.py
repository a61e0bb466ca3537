"""Results are kept: pickled, copied, sent to another process, written and loaded again."""

import copy
import pickle
from dataclasses import replace

import joblib
import numpy as np
import pytest

import bayesid
from tests.simulated import Motion, Sensor, experiment, fourier, puma2, recording

SENSOR = Sensor(translation=np.array([0.0, 0.0, -0.1]))
KINDS = ["identification", "estimate", "prediction", "comparison", "posterior", "own_posterior", "bounds", "diagnosis", "changes",
         "accuracy", "identifiability", "excitation", "telling", "watch", "inspection", "experiment", "simulation", "regression",
         "table"]  # fmt: skip


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    """A two-joint robot recorded in two motions, with viscous friction that the model states."""
    robot = puma2(tmp_path_factory.mktemp("puma"))
    motions = []
    for k, name in enumerate(("identification", "validation")):
        table = recording(
            robot, SENSOR, fourier(robot, k + 1, duration=8.0), seed=k, force_std=0.5, torque_std=0.1, resolution=2e-5
        )
        velocity = np.gradient(table.positions, table.times, axis=0)
        motions.append(Motion(name, name, replace(table, torques=table.torques + 3.0 * velocity)))
    return experiment(robot, motions, SENSOR, inertia_rel_std=0.1, effects=("viscous_friction",))


def own_regression():
    """Rows of one's own, with instruments and errors."""
    rng = np.random.default_rng(1)
    matrix = rng.normal(size=(200, 2, 4))
    return bayesid.Regression.from_arrays(
        matrix, matrix @ np.ones(4) + 0.1 * rng.normal(size=(200, 2)), instruments=matrix,
        regressor_noise=1e-3 * rng.normal(size=(3, 200, 2, 4)),
    )  # fmt: skip


@pytest.fixture(scope="module")
def results(arm):
    """One result of every kind; the costly ones small."""
    identified = bayesid.identify(arm, "torque")
    posterior = bayesid.sample(arm, draws=200, chains=2, channel="torque", keep_going=True)
    quick = dict(starts=1, randoms=3, seconds=0.2, rate=50.0)
    return {
        "identification": identified,
        "estimate": identified.estimate,
        "prediction": identified.validation[0],
        "comparison": bayesid.compare(arm, ["wls", "ols", "iv", "tls"], "torque"),
        "posterior": posterior,
        "own_posterior": bayesid.sample(own_regression(), draws=200, chains=2, keep_going=True),
        "bounds": bayesid.bounds(identified, configurations=8),
        "diagnosis": bayesid.diagnose(arm, "torque", effects=()),
        "changes": bayesid.diagnose(arm, "torque", reference=arm),
        "accuracy": bayesid.accuracy(identified, runs=5),
        "identifiability": bayesid.identifiability(arm),
        "excitation": bayesid.excite(arm, duration=10.0, period=5.0, **quick),
        "telling": bayesid.tell(arm, ["base_tilt", "sensor_rotation"], bayesid.ExcitationOptions(duration=6.0, **quick)),
        "watch": bayesid.watch(arm, [arm], "torque"),
        "inspection": bayesid.check(arm),
        "experiment": arm,
        "simulation": bayesid.simulate(arm, seed=1),
        "regression": own_regression(),
        "table": arm.motions[0].table,
    }


def said(result):
    """What a result says, as numbers and words in lists and dictionaries."""
    if isinstance(result, bayesid.Regression):
        law, instruments = result.regressor_noise, result.instruments
        rows = [b.rows for b in (*result.blocks(), *law.perturbed(1, 1.0))] + [p.instruments.rows for p in instruments.pairs()]
        return [r.tolist() for r in rows]
    if isinstance(result, bayesid.Experiment):
        return [said(m.table) for m in result.motions], result.robot.nominal.tolist(), result.effects
    if isinstance(result, bayesid.Table):
        return result.times.tolist(), result.positions.tolist(), result.torques.tolist()
    return result.to_dict(), str(result), repr(result)


def assert_same(one, other, where=""):
    """Equal up to rounding: sums over an array depend on how it lies in memory."""
    if isinstance(one, dict):
        assert list(one) == list(other), where
        for key in one:
            assert_same(one[key], other[key], f"{where}.{key}")
    elif isinstance(one, (list, tuple)):
        assert len(one) == len(other), where
        for k, pair in enumerate(zip(one, other, strict=True)):
            assert_same(*pair, f"{where}[{k}]")
    elif isinstance(one, (float, np.floating, np.ndarray)):
        np.testing.assert_allclose(other, one, rtol=1e-9, atol=1e-12, err_msg=where)
    else:
        assert one == other, where


def sent(result):
    """The result as another process gives it back."""
    (back,) = joblib.Parallel(n_jobs=2)([joblib.delayed(copy.copy)(result)])
    return back


@pytest.mark.parametrize("kind", KINDS)
def test_a_result_is_pickled_copied_and_sent(results, kind):
    result = results[kind]
    for back in (pickle.loads(pickle.dumps(result)), copy.deepcopy(result), sent(result)):
        assert type(back) is type(result) and back is not result
        assert_same(said(result), said(back))
