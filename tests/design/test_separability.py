"""How well effects are told apart: closed form against dense least squares, and its probability against simulated evidence."""

import numpy as np
import pytest

import bayesid
from bayesid.dynamics.channels import torque_channels
from bayesid.dynamics.regressors import Kernel
from bayesid.simulation.trajectories import fourier_trajectory
from tests.simulated import experiment, puma2

STD = 1.0


def friction_case(folder, std):
    """A two-joint arm, the result for viscous against Coulomb friction of joint 2, and the dense columns behind it."""
    robot = puma2(folder)
    motion = fourier_trajectory(robot, duration=20.0, rate=100.0, seed=4)
    setup = experiment(robot, [], bayesid.Sensor())
    specs = ["viscous_friction@joint2", "coulomb_friction@joint2"]
    found = bayesid.identifiability(setup, motion, noise={"torque": std}, tell=specs)
    inside = slice(40, -40)  # ends that rows leave out do not matter at 2 %
    q, v, a = (x[inside] for x in (motion.positions, motion.velocities, motion.accelerations))
    x = Kernel.of(robot, torque_channels(robot)).dynamics(q, v, a).reshape(-1, 20)
    x = np.linalg.svd(x, full_matrices=False)[0][:, :8]
    columns = {}
    for name, values in (("viscous_friction", v[:, 1]), ("coulomb_friction", np.sign(v[:, 1]))):
        usual = float(setup.library.parse([f"{name}@joint2"], robot.joint_names, ["tau2"])[0].typical(robot)[0])
        z = np.zeros((len(v), 2))
        z[:, 1] = usual * values / std
        columns[name] = z.ravel()
    return found, x, columns


def left(columns, trace):
    return float(np.sum((trace - columns @ np.linalg.lstsq(columns, trace, rcond=None)[0]) ** 2))


def test_noncentrality_is_what_least_squares_leaves(tmp_path):
    found, x, columns = friction_case(tmp_path, STD)
    pairs = found.separations["torque"]
    assert [p.true.partition("@")[0] for p in pairs] == ["viscous_friction", "coulomb_friction"]
    for p in pairs:
        true, other = (columns[s.partition("@")[0]] for s in (p.true, p.other))
        assert p.seen == pytest.approx(left(x, true), rel=0.05)
        assert p.noncentrality == pytest.approx(left(np.column_stack([x, other]), true), rel=0.08)
        assert p.smallest is not None and p.noncentrality < p.seen
    # No base wrench shows friction, so nothing can be told there.
    assert found.separations["wrench"] == () and "not both seen" in str(found)
    assert {s["sensor_set"] for s in found.to_dict()["tell"]} == set(found.separations)


def test_the_probability_is_that_of_simulated_evidence(tmp_path):
    """Readings with one effect, both fitted: how often the log-likelihood ratio exceeds what a diagnosis asks for."""
    _, x, columns = friction_case(tmp_path, STD)
    true, other = columns["viscous_friction"], columns["coulomb_friction"]
    std = np.sqrt(left(np.column_stack([x, other]), true) / 12.0)  # lambda = 12: neither sure nor hopeless
    found, x, columns = friction_case(tmp_path, float(STD * std))
    pair = found.separations["torque"][0]
    true, other = columns["viscous_friction"], columns["coulomb_friction"]
    rng = np.random.default_rng(0)
    y = true + rng.normal(size=(2000, len(true)))
    rest = []
    for z in (true, other):
        q = np.linalg.qr(np.column_stack([x, z]))[0]
        rest.append(np.sum(y**2, axis=1) - np.sum((y @ q) ** 2, axis=1))
    share = np.mean(0.5 * (rest[1] - rest[0]) > 3.0)
    assert 0.5 < pair.probability < 0.95
    assert share == pytest.approx(pair.probability, abs=0.05)


@pytest.mark.parametrize(
    "specs, said",
    [
        (["viscous_friction@joint2"], "give at least two"), (["viscous_friction", "base_tilt"], "could be at 2 places"),
        (["nothing", "base_tilt"], "tell: effect 'nothing'"), (["base_tilt", "base_tilt"], "give at least two"),
    ],
)  # fmt: skip
def test_effects_that_cannot_be_told_are_refused(specs, said, tmp_path):
    with pytest.raises(bayesid.InputError, match=said):
        bayesid.identifiability(puma2(tmp_path), tell=specs)


def test_an_effect_in_the_model_is_refused(tmp_path):
    setup = experiment(puma2(tmp_path), [], bayesid.Sensor(), effects=("base_tilt",))
    motion = fourier_trajectory(setup.robot)
    with pytest.raises(bayesid.InputError, match="is in the model already"):
        bayesid.identifiability(setup, motion, tell=["base_tilt", "sensor_delay"])


def test_what_a_static_run_removes_is_not_told(tmp_path):
    """Base tilt acts on gravity alone, which a static run takes away; with the offset fitted it is seen."""
    robot = puma2(tmp_path)
    found = bayesid.identifiability(robot, tell=["base_tilt", "sensor_rotation"])
    tilt = {name: next(p for p in pairs if p.true == "base_tilt@base") for name, pairs in found.separations.items() if pairs}
    assert tilt["wrench-static"].noncentrality < 1e-3 and tilt["wrench-static"].probability < 0.01
    assert tilt["wrench-offset"].probability > 0.99
