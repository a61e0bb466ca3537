"""Errors and what they depend on: formulae against simulation, biases predicted against those of a simulated effect."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from bayesid.design.accuracy.bench import Bench, Setting, _model, make_bench, missing_effects, own_setting, twin
from bayesid.design.accuracy.fits import Errors, Learned, combinations, differenced, errors_of, fit_twin, learn, run_twin
from bayesid.design.accuracy.susceptibility import susceptibility
from bayesid.design.accuracy.sweeps import Trial, _by_formula, _level, _noise, sweep
from bayesid.dynamics.base_parameters import structural_base
from bayesid.effects import Term
from bayesid.estimators import estimator
from bayesid.recordings.experiment import Experiment, Motion, Sensor
from bayesid.regression.options import FitOptions
from bayesid.regression.problem import prepare
from bayesid.regression.readings import make_channels
from bayesid.robot.robot import load_robot
from bayesid.signals.filters import LowPass
from bayesid.signals.noise import NoiseModel
from bayesid.simulation.simulation import Recorder, simulate
from bayesid.simulation.trajectories import fourier_trajectory, recorded_trajectories
from tests.robots import ur5, write
from tests.simulated import puma2


def test_what_is_fixed_under_a_joints_own_name_stays_fixed_in_twins():
    spring = {"stiffness": 1.0, "rest": 0.2}
    given = SimpleNamespace(
        effect_values={"spring@elbow": spring | {"fixed": True}}, effects=("spring",), position_std=None,
        robot=SimpleNamespace(joint_names=("shoulder", "elbow")),
    )  # fmt: skip
    curved = SimpleNamespace(row_model=SimpleNamespace(effects=[SimpleNamespace(shape=("rest",), from_motion_alone=False)]))
    plant = {"spring@joint1": dict(spring), "spring@joint2": dict(spring)}
    bench = SimpleNamespace(plant=plant, experiment=given, options=FitOptions(), problem=curved, resolution=0.0)
    values = _model(bench, SimpleNamespace(offset="fitted", encoder=1.0))["effect_values"]
    assert values["spring@joint2"] == spring | {"fixed": True} and "fixed" not in values["spring@joint1"]


def recorded(robot, *, static: bool, duration: float = 10.0, seed: int = 3) -> Experiment:
    """A simulated experiment of two motions with a sensor under the base."""
    motions = [
        fourier_trajectory(robot, duration=duration, static=static, fundamental=0.2, seed=seed),
        fourier_trajectory(robot, "validation", "validation", duration=duration, static=static, fundamental=0.26, seed=seed + 1),
    ]
    setup = Experiment(robot.name, robot, (), Sensor(translation=np.array([0.0, 0.0, -0.1])), position_resolution=1e-4)
    return simulate(setup, motions, effects=["sensor_offset"], recorder=Recorder(force_std=0.5, torque_std=0.05), seed=seed)


@cache
def bench(name: str) -> Bench:
    """The two-joint PUMA with a static run, or a UR5 without."""
    folder = Path(tempfile.mkdtemp())
    if name == "puma":
        return make_bench(recorded(puma2(folder), static=True), estimator("wls"), FitOptions())
    return make_bench(recorded(load_robot(write(folder, ur5())), static=False), estimator("wls"), FitOptions())


@cache
def learned(name: str) -> Learned:
    return learn(bench(name), own_setting(bench(name)), 1)


def fitted(name: str, *more: Term) -> np.ndarray:
    """Mean base parameters of four twins with further effects in the plant; weights learned anew, perfect encoders."""
    b = bench(name)
    quiet = replace(own_setting(b), encoder=0.0, options=replace(b.options, bandwidth=learned(name).bandwidth))
    model = {"effects": b.experiment.effects, "effect_values": b.experiment.effect_values}
    plant = replace(b, terms=(*b.terms, *more))
    made = [replace(twin(plant, quiet, seed), **model) for seed in range(4)]
    return np.mean([fit_twin(b, quiet, m)[1].values for m in made], axis=0)


@cache
def without(name: str) -> np.ndarray:
    return fitted(name)


# -- noise and motion of twins


def test_noise_that_is_drawn_has_the_covariance_of_its_model():
    model = NoiseModel(np.array([[1.0, -0.8], [1.0, 0.3]]), np.array([[1.0, 0.5], [0.5, 4.0]]))
    noise = model.drawn(200_000, np.random.default_rng(1))
    np.testing.assert_allclose(noise.std(axis=0), [1 / (1 - 0.64) ** 0.5, 2 / (1 - 0.09) ** 0.5], rtol=0.02)
    np.testing.assert_allclose(np.mean(noise[1:] * noise[:-1], axis=0) / noise.var(axis=0), [0.8, -0.3], atol=0.01)
    # Of two first-order recursions with innovations that belong together: s12 / (1 - a1 a2).
    assert np.mean(noise[:, 0] * noise[:, 1]) == pytest.approx(0.5 / (1 + 0.24), abs=0.05)


def test_a_recorded_motion_is_a_function_of_time():
    motion = bench("puma").motions[0]
    own, between = motion.trajectory(), motion.trajectory(lambda t: t[:-1] + 0.004)
    np.testing.assert_allclose(recorded_trajectories(bench("puma").experiment)[0].positions, own.positions)
    step = between.times - own.times[:-1]
    expected = own.positions[:-1] + step[:, None] * own.velocities[:-1] + 0.5 * step[:, None] ** 2 * own.accelerations[:-1]
    np.testing.assert_allclose(between.positions, expected, atol=1e-5)


def test_twins_keep_the_motion_and_round_it_afresh():
    b = bench("puma")
    one, other = (twin(b, own_setting(b), seed).motions[0] for seed in (1, 2))
    true = b.motions[0].trajectory(lambda t: one.table.times)
    assert np.abs(one.table.positions - true.positions).max() < 1.01e-4
    error = [m.table.positions - b.motions[0].trajectory(lambda t, m=m: m.table.times).positions for m in (one, other)]
    rounding = [e[:1000] - e[:1000].mean(axis=0) for e in error]
    assert abs(np.corrcoef(rounding[0].ravel(), rounding[1].ravel())[0, 1]) < 0.2
    assert one.stop_and_go and set(np.round(np.diff(one.table.times), 6)) == {0.008}


@pytest.mark.parametrize(("rate", "samples"), [(0.25, 313), (1.0, 1249), (2.0, 2498)])
def test_twins_are_sampled_as_asked(rate, samples):
    b = bench("puma")
    table = twin(b, replace(own_setting(b), rate=rate), 1).motions[0].table
    assert len(table) == samples and table.step == pytest.approx(0.008 / rate)


# -- errors


def test_combinations_of_other_base_parameters_are_found_and_others_are_not_determined():
    b = bench("ur5")
    robot = b.experiment.robot
    gravity_free = structural_base(robot, make_channels(b.experiment, "wrench"), gravity=False)
    full = structural_base(robot, make_channels(b.experiment, "wrench"))
    down = combinations(gravity_free, full)
    np.testing.assert_allclose(down @ full.matrix, gravity_free.matrix, atol=1e-8)
    up = combinations(full, gravity_free)
    lost = ~np.isfinite(up).all(axis=1)
    assert lost.sum() == full.rank - gravity_free.rank
    np.testing.assert_allclose(up[~lost] @ gravity_free.matrix, full.matrix[~lost], atol=1e-8)


def test_formula_and_simulation_agree_and_noise_scales_errors():
    b = bench("puma")
    own, known = own_setting(b), learned("puma")
    columns = {k: errors_of(b, np.array([run_twin(b, replace(own, noise=k), s, known) for s in range(40)])) for k in (1.0, 3.0)}
    # A standard deviation of 40 draws is known to 11 %, the median of twelve better.
    assert np.median(columns[1.0].std / b.estimate.std) == pytest.approx(1.0, abs=0.15)
    assert np.median(columns[3.0].std / columns[1.0].std) == pytest.approx(3.0, rel=0.03)  # the same draws
    assert np.all(np.abs(columns[1.0].bias) < 4.5 * columns[1.0].std / 40**0.5)


def test_forward_differences_are_half_a_sample_late_and_central_ones_are_not():
    b = bench("puma")
    options = replace(b.options, low_pass=LowPass(1.0, 50.0), bandwidth=learned("puma").bandwidth)
    quiet = Setting(noise=0.0, encoder=0.0, options=options)
    errors = {kind: run_twin(b, replace(quiet, velocity=kind), 1, None) for kind in ("smoothed", "central", "forward")}
    size = {kind: np.abs(e[: b.rank] / b.estimate.std).max() for kind, e in errors.items()}
    assert size["smoothed"] < 0.3 and size["central"] < 0.3 and size["forward"] > 3.0


def test_differences_of_a_cubic():
    b = bench("puma")
    problem = differenced(prepare(b.experiment, b.options), "central")
    segment = problem.segments["identification"][0]
    times = segment.times
    cubic = replace(segment, positions=np.stack([times**3, 2.0 * times], axis=1))
    state = problem.row_model.state(cubic, 100, 200)
    # (t + h)^3 - (t - h)^3 over 2 h is 3 t^2 + h^2.
    np.testing.assert_allclose(state.velocities[:, 0], 3 * state.times**2 + 0.008**2, rtol=1e-9)
    np.testing.assert_allclose(state.velocities[:, 1], 2.0, rtol=1e-9)
    np.testing.assert_allclose(state.accelerations[:, 0], 6 * state.times, rtol=1e-6)


@pytest.mark.slow
def test_a_sweep_ranks_what_helps_and_tells_what_is_refused():
    b = bench("puma")
    told: list[str] = []
    found = sweep(b, 5, 0, told.append)
    names = [s.name for s in found.sweeps]
    assert names == ["sensor_noise", "sensor_resolution", "encoder", "sampling_rate", "record_length", "filter", "bandwidth",
                     "velocity", "offset"]  # fmt: skip
    noise = {v.value: v for v in found.sweeps[0].levels}
    assert noise[0.5].source == "formula" and noise[0.5].ratio == pytest.approx(0.5, abs=0.02)
    length = {v.value: v for v in found.sweeps[4].levels}
    assert length[4.0].ratio == pytest.approx(0.5, abs=0.01) and length[0.5].ratio > 1.1
    offset = {v.label: v for v in found.sweeps[8].levels}
    assert offset["no static run, offset ignored"].ratio > 10.0
    ranked = [v.ratio for _, v in found.improvements()]
    assert ranked == sorted(ranked) and all(r < 1.0 for r in ranked)
    assert "half the sensor noise" in [v.improvement for _, v in found.improvements()]
    assert told[-1].endswith("twins")


# -- effects left out

SMALL = [
    ("puma", "sensor_gain@mz"), ("puma", "sensor_delay@sensor"), ("puma", "sensor_crosstalk@fx->my"), ("puma", "payload@joint2"),
    ("ur5", "sensor_rotation@sensor"), ("ur5", "sensor_translation@sensor"), ("ur5", "base_tilt@base"), ("ur5", "tether@joint3"),
    ("ur5", "encoder_offset@joint2"), ("ur5", "joint_flexibility@joint2"),
]  # fmt: skip


def test_repeats_leave_the_bias_in_predictions_too_whatever_the_estimator():
    """Errors of a fit that is off by 3 and scatters by 1, predicted by themselves: a hundred repeats leave the 3."""
    scatter = np.random.default_rng(0).normal(size=(1000, 1))
    columns = 3.0 + (scatter - scatter.mean()) / scatter.std()
    errors = Errors(columns, np.abs(columns[:, 0]), 1)
    own = _level(Trial("own", 1.0, None), errors, errors)
    level = _by_formula(Trial("repeated 100 times", 100.0, None, (1.0, 0.1)), own, None, 3.0)
    assert level.prediction == pytest.approx(np.hypot(3.0, 0.1), rel=1e-3)
    assert level.prediction_ratio == pytest.approx(level.ratio, rel=1e-3)


@pytest.mark.parametrize(("name", "spec"), SMALL)
def test_bias_predicted_is_that_of_a_simulated_effect(name, spec):
    """The real effect in the plant, readings simulated anew with the same noise, fitted without it, weights learned anew."""
    b = bench(name)
    effect = next(t.effect for t in missing_effects(b.experiment, b.problem.row_model) if t.effect.spec == spec)
    values = np.array(effect.typical(b.experiment.robot))
    (usual,) = susceptibility(b, b.estimate.std, (Term(effect, tuple(values)),))
    linear = [k for k, p in enumerate(effect.quantities) if p.linear] or list(range(len(values)))
    values[linear] *= min(2.0 / usual.largest, 1.0)  # a small effect: two standard deviations at most
    term = Term(effect, tuple(values))
    (predicted,) = susceptibility(b, b.estimate.std, (term,))
    shift = (fitted(name, term) - without(name)) / b.estimate.std
    assert predicted.largest > 0.5
    assert np.linalg.norm(shift - predicted.sigmas) < 0.2 * np.linalg.norm(predicted.sigmas)
    worst = predicted.most_biased
    assert shift[worst] == pytest.approx(predicted.sigmas[worst], rel=0.2)


def test_a_static_run_takes_offsets_and_tilts_away():
    found = {s.effect.spec: s.largest for s in susceptibility(bench("puma"), bench("puma").estimate.std)}
    assert found["sensor_offset@sensor"] < 1e-9 and found["base_tilt@base"] < 1e-9
    assert found["sensor_delay@sensor"] > 5.0


def test_a_fit_without_a_covariance_has_no_formula():
    """As one that leaves no residual: then twins tell what noise and length do."""
    sure = bench("puma")
    bare = replace(sure, estimate=replace(sure.estimate, full_covariance=None, interval="none"))
    half, halved = (next(t for t in _noise(b, own_setting(b)).trials if t.value == 0.5) for b in (sure, bare))
    assert half.setting is None and halved.setting is not None and halved.setting.noise == 0.5


def test_errors_of_predictions_are_shares_of_the_readings_where_friction_is_held_at_its_value(tmp_path):
    """What is held is in the readings, though not in the target of the rows."""
    robot = puma2(tmp_path)
    true = {f"coulomb_friction@joint{k}": {"level": 20.0} for k in (1, 2)}
    path = [fourier_trajectory(robot, duration=6.0, fundamental=0.2, seed=1)]
    made = replace(simulate(Experiment("arm", robot, ()), path, effects=true, seed=1), effects=("coulomb_friction",))
    held = {spec: {**values, "fixed": True} for spec, values in true.items()}
    options = FitOptions("torque", bandwidth=4.0)
    free, fixed = (make_bench(replace(made, effect_values=v), estimator("wls"), options) for v in ({}, held))
    np.testing.assert_allclose(fixed.prediction_gram, free.prediction_gram[: free.rank, : free.rank], rtol=1e-9, atol=1e-15)


def test_torques_of_some_joints_are_varied_as_they_were_recorded(tmp_path):
    setup = recorded(puma2(tmp_path), static=False)

    def partly(motion: Motion) -> Motion:
        return replace(motion, table=replace(motion.table, torques=np.where([True, False], np.nan, motion.table.torques)))

    some = make_bench(replace(setup, motions=tuple(map(partly, setup.motions))), estimator("ols"), FitOptions(channel="torque"))
    made = twin(some, own_setting(some), 1)
    assert made.torque_joints == (1,)
    problem, estimate = fit_twin(some, own_setting(some), made)
    assert problem.row_model.channels.names == ("tau2",)
    np.testing.assert_allclose(estimate.values, some.estimate.values, atol=6.0 * some.estimate.std.max())
    assert "coupled_transmission@joint1->joint2" in {s.effect.spec for s in susceptibility(some, some.estimate.std)}
