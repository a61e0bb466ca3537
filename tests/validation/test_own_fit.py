"""One number for what a model leaves of a motion, whichever verb says it."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

import bayesid
from bayesid.errors import BayesidError
from bayesid.estimators.nonlinear import default_method
from bayesid.regression.options import FitOptions
from bayesid.results.files import report_of
from bayesid.simulation.trajectories import Trajectory
from bayesid.validation.own_fit import MotionErrors, before_and_after, chosen_bandwidth, left_text, predicted_worse
from bayesid.validation.prediction import Prediction, judged
from tests.malformed import DATA
from tests.robots import wrist_sensor_arm, write
from tests.simulated import Motion, Sensor, experiment, fourier, puma2, recording

REAL = sorted(path.parent for path in (DATA / "data").glob("**/experiment.toml"))
#: The cheapest with a wrench and the cheapest with torques alone; all others are slow.
QUICK = {"kuka-med-wrist", "feb06-20s-5h"}
NOISE = {"force_std": 0.05, "torque_std": 0.02, "resolution": 2e-5, "offset": 0.4}


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    return puma2(tmp_path_factory.mktemp("arm"))


def simulated(robot, seed: int):
    """A wrench or torques, a correct model or one that lacks a load of 5 % on the last link, one validation motion or two."""
    heavier = robot.nominal.copy()
    heavier[-1] *= 1.0 + 0.05 * (seed % 2)
    sensor = Sensor() if seed % 3 else None
    made = [
        recording(robot, sensor, fourier(robot, 10 * seed + k, 8.0), seed=seed + k, phi=heavier.ravel(), **NOISE)
        for k in range(3)
    ]
    roles = ("identification", "validation", "validation" if seed % 4 else "identification")
    motions = [Motion(f"motion{k}", role, table) for k, (role, table) in enumerate(zip(roles, made, strict=True))]
    return experiment(robot, motions, sensor)


def agree(one, channel: str | None = None) -> None:
    """The verbs that fit say the same of every motion."""
    by_identify = bayesid.identify(one, channel, progress=None)
    expected = {p.motion: p.whitened_rms for p in (*by_identify.fitted, *by_identify.validation)}
    problem = by_identify.problem
    compared = bayesid.compare(one, channel=channel, methods=[default_method(problem)], progress=None).entries[0]
    checked = bayesid.check(one, progress=None)
    told = {
        "check": checked.left if problem.channel == checked.channel else (),
        "compare": (*compared.fitted, *compared.validation),
        "diagnose": [e.before for e in before_and_after(one, None, FitOptions(problem.channel)).errors],
    }
    for verb, predictions in told.items():
        assert {p.motion for p in predictions} in (set(expected), set()), verb
        for p in predictions:
            assert p.whitened_rms == pytest.approx(expected[p.motion], rel=1e-9), verb
    try:
        (watched,) = bayesid.watch(one, one, problem.channel, progress=None).recordings
    except BayesidError:  # poses alone
        return
    for p in watched.left:
        if p.motion in expected:
            assert p.whitened_rms == pytest.approx(expected[p.motion], rel=1e-9), "watch"


# From the seventh on, combinations of what is measured, what the model lacks and which motions there are repeat those before.
@pytest.mark.parametrize("seed", [1, 2, 3, 4, 6, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (5, 7, 8, 9, 10))])
def test_every_verb_says_the_same_of_simulated_recordings(robot, seed):
    agree(simulated(robot, seed))


@pytest.mark.skipif(not REAL, reason=f"no real recordings under {DATA / 'data'}; set BAYESID_DATA")
@pytest.mark.parametrize("folder", [pytest.param(f, id=f.name, marks=() if f.name in QUICK else pytest.mark.slow) for f in REAL])
def test_every_verb_says_the_same_of_real_recordings(folder: Path):
    agree(bayesid.load_experiment(folder))


def test_a_better_model_leaves_less_of_the_noise_and_not_because_noise_is_another(robot):
    lacking = simulated(robot, 1)
    effects = ("viscous_friction",)
    plain, more = (bayesid.identify(replace(lacking, effects=e), progress=None) for e in ((), effects))
    assert more.fitted[0].whitened_rms <= plain.fitted[0].whitened_rms * (1.0 + 1e-6)
    assert plain.floor is not None and more.floor is not None
    np.testing.assert_allclose(more.floor.sensor, plain.floor.sensor, rtol=1e-12)


def test_what_nothing_tells_has_no_number(robot):
    """Readings filtered before they were recorded: the fit's own residual is no measure of the model."""
    from scipy.signal import butter, sosfiltfilt

    one = simulated(robot, 1)
    slow = butter(4, 8.0, fs=125.0, output="sos")
    motions = tuple(replace(m, table=replace(m.table, wrench=sosfiltfilt(slow, m.table.wrench, axis=0))) for m in one.motions)
    checked = bayesid.check(replace(one, motions=motions), progress=None)
    assert checked.left and all(np.isnan(p.times_noise) for p in checked.left)
    assert "noise not known" in left_text(checked.left[0]) and checked.to_dict()["left"][0]["times_noise"] is None
    assert "noise not known" in str(checked)


def test_a_model_that_cannot_be_fitted_is_said_to_be_one(robot):
    """Errors are left out with their reason, not silently."""
    one = simulated(robot, 1)
    impossible, options = replace(one, effects=("no_such_effect",)), FitOptions("torque")
    both = before_and_after(one, impossible, options)
    assert both.errors and all(e.after is None for e in both.errors)
    assert "with the effects named" in both.refused and "no_such_effect" in both.refused
    assert chosen_bandwidth(one, options) == bayesid.identify(one, options=options, progress=None).problem.smoother.bandwidth
    assert chosen_bandwidth(impossible, options) == np.inf
    nothing = before_and_after(impossible, None, options)
    assert nothing.errors == () and "cannot fit it" in nothing.refused
    assert before_and_after(one, None, options).refused == ""


def test_base_parameters_move_as_identify_estimates_them(robot):
    """Without friction of two joints in the model, torques bend the links' parameters; the diagnosis says as much as identify."""
    one = simulated(robot, 3)
    motions = []
    for m in one.motions:
        speed = np.gradient(m.table.positions, m.table.times, axis=0)
        motions.append(replace(m, table=replace(m.table, torques=m.table.torques + 4.0 * speed)))
    one = replace(one, motions=tuple(motions))
    found = bayesid.diagnose(one, "torque", progress=None)
    assert found.verdict == "named" and found.shifts
    effects, values = found.model
    plain, more = (
        bayesid.identify(replace(one, effects=e, effect_values=v), "torque", progress=None)
        for e, v in (((), {}), (effects, values))
    )
    for shift in found.shifts:
        k = more.base.labels.index(shift.label)
        assert shift.after == pytest.approx(more.values[k], rel=1e-12)
        assert shift.before == pytest.approx(plain.values[plain.base.labels.index(shift.label)], rel=1e-12)
        assert shift.sigmas == pytest.approx((shift.before - shift.after) / more.std[k], rel=1e-9) and abs(shift.sigmas) > 3.0
    # Where identify has fitted one of them alone, the page does not say that nothing moved.
    unfitted = replace(found, shifts=(), errors=tuple(replace(e, after=None) for e in found.errors))
    page = report_of(unfitted)
    assert "has not fitted both models" in page and "Hardly anything" not in page


@pytest.mark.parametrize("resolution", [1e-5, 2e-2])
def test_poses_are_compared_with_the_noise_that_is_stated(tmp_path, resolution):
    """And with what encoder counts make of the prediction; without stated noise nothing tells theirs."""
    robot = bayesid.load_robot(write(tmp_path, wrist_sensor_arm()), sensor_joint="wrist_ft")
    arm = experiment(robot, [], Sensor("wrist_ft", force_std=0.05, torque_std=0.003), position_resolution=resolution)
    rng = np.random.default_rng(1)
    paths = []
    for name, role, count in (("poses", "identification", 40), ("check", "validation", 60)):
        q = rng.uniform(-2.5, 2.5, (count, robot.n))
        paths.append(Trajectory(name, role, np.arange(float(count)), q, 0.0 * q, 0.0 * q, kind="poses"))
    recorder = bayesid.Recorder(force_std=0.05, torque_std=0.003, resolution=resolution)
    made = bayesid.simulate(arm, paths, recorder=recorder, seed=2)
    (left,) = bayesid.identify(made, progress=None).validation
    assert (left.noise_source, left.noise_known) == ("data sheet", True)
    assert left.whitened_rms == pytest.approx(left.expected_rms, abs=0.15)
    assert resolution < 1e-3 or np.sqrt(np.mean((left.residuals / np.repeat([0.05, 0.003], 3)) ** 2)) > 2.0 * left.whitened_rms
    assert judged(left).mood == "good"
    unstated = replace(made, sensor=replace(made.sensor, force_std=None, torque_std=None))
    assert not bayesid.identify(unstated, progress=None).validation[0].noise_known


@pytest.mark.parametrize(("after", "known", "worse"), [
    ((0.6, 3.0), True, True), ((0.6, 1.0), True, False), ((0.4, 3.0), True, False), ((0.6, 1.0), False, True),
    (None, True, False),
])  # fmt: skip
def test_unseen_motions_are_predicted_worse_by_every_measure_that_is_known(after, known, worse):
    """Neither by the error's size alone nor by the noise's; motions that were fitted say nothing."""

    def errors(fitted: bool, *sides: tuple[float, float] | None) -> MotionErrors:
        made = [None if x is None else SimpleNamespace(relative_error=x[0], times_noise=x[1], noise_known=known) for x in sides]
        return MotionErrors("m", fitted, *cast(list[Prediction], made))

    assert predicted_worse([errors(True, (0.5, 2.0), (0.1, 1.0)), errors(False, (0.5, 2.0), after)]) == worse
