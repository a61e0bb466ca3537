import numpy as np
import pytest

from bayesid.dynamics.base_parameters import regroup, structural_base
from bayesid.dynamics.channels import torque_channels, wrench_channels
from bayesid.dynamics.regressors import Kernel
from bayesid.robot.robot import load_robot
from tests.example_robots import PAPER_LABELS, paper_base_map
from tests.robots import lwr4, panda, prismatic_arm, tree, ur5, ur10, wrist_sensor_arm, write
from tests.simulated import puma2

EYE, ORIGIN = np.eye(3), np.array([0.1, -0.2, 0.3])


def ranks(text, folder):
    robot = load_robot(write(folder, text))
    wrench, torque = wrench_channels(robot, EYE, ORIGIN), torque_channels(robot)
    return [
        structural_base(robot, torque).rank,
        structural_base(robot, wrench).rank,
        structural_base(robot, wrench, offset=True).rank,
        structural_base(robot, wrench, gravity=False).rank,
    ]


@pytest.mark.parametrize(
    "text, expected",
    [(ur5(), [36, 41, 40, 40]), (panda(), [43, 48, 47, 47]), (ur10(), [36, 41, 40, 40]), (lwr4(), [43, 48, 47, 47])],
    ids=["ur5", "panda", "ur10", "lwr4"],
)
def test_ranks_of_known_arms(text, expected, tmp_path):
    assert ranks(text, tmp_path) == expected


def test_the_papers_twelve(tmp_path):
    """Motion wrenches of the two-joint PUMA have exactly the paper's base parameters, in its form."""
    robot = puma2(tmp_path)
    base = structural_base(robot, wrench_channels(robot, EYE, np.zeros(3)), gravity=False)
    assert base.rank == 12
    # The paper lists first moments, then inertias; here links come one after the other.
    in_order = [base.matrix[k] for k in np.lexsort(base.matrix.T)]
    papers = paper_base_map()
    np.testing.assert_allclose(in_order, papers[np.lexsort(papers.T)], atol=1e-9)
    for label in ("m1 r1z - 0.2435 m2 + m2 r2z", "I1yy + 0.05929 m2 - 0.487 m2 r2z + I2xx", "-I2xx + I2yy"):
        assert label in base.labels
    assert len(PAPER_LABELS) == 12


@pytest.mark.parametrize("text", [ur5(), panda(), prismatic_arm(), tree(), wrist_sensor_arm()])
@pytest.mark.parametrize("sensor", ["wrench", "torque"])
@pytest.mark.parametrize("gravity", [True, False])
def test_kept_columns_times_base_parameters_are_the_whole_regressor(text, sensor, gravity, tmp_path):
    robot = load_robot(write(tmp_path, text))
    channels = wrench_channels(robot, EYE, ORIGIN) if sensor == "wrench" else torque_channels(robot)
    base = structural_base(robot, channels, gravity=gravity)
    rng = np.random.default_rng(1)
    q, v, a = rng.normal(size=(3, 40, robot.n))
    whole = Kernel.of(robot, channels).dynamics(q, v, a, gravity=gravity)
    phi = robot.nominal.ravel() * rng.uniform(0.5, 1.5, robot.nominal.size)
    kept = Kernel.of(robot, channels, base.independent).dynamics(q, v, a, gravity=gravity)
    np.testing.assert_allclose(kept @ (base.matrix @ phi), whole @ phi, atol=1e-7 * np.abs(whole @ phi).max())
    assert np.linalg.matrix_rank(whole.reshape(-1, whole.shape[2]), tol=1e-6) == base.rank


def test_offsets_absorb_the_total_mass(tmp_path):
    robot = load_robot(write(tmp_path, ur5()))
    channels = wrench_channels(robot, EYE, np.zeros(3))
    base = structural_base(robot, channels, offset=True)
    masses = [k for k, n in enumerate(base.parameter_names) if n.endswith(".m")]
    np.testing.assert_allclose(base.absorbed[2, masses], 9.81, rtol=1e-6)
    np.testing.assert_allclose(base.absorbed[:2, masses], 0.0, atol=1e-9)


def test_at_rest_only_gravity_shows(tmp_path):
    robot = load_robot(write(tmp_path, ur5()))
    base = structural_base(robot, torque_channels(robot), at_rest=True)
    assert base.rank == 10 and not any("I" in n for n in base.names)


def test_noise_in_zero_columns_is_no_information():
    """Scaling columns before dropping the empty ones would give rank one too many."""
    rng = np.random.default_rng(0)
    rows = rng.normal(size=(200, 5))
    rows[:, 3] = 1e-13 * rng.normal(size=200)
    rows[:, 4] = rows[:, 0] - 2 * rows[:, 1]
    base = regroup(rows, list("abcde"), ["1"] * 5)
    assert base.rank == 3 and base.invisible == ("d",)
    assert base.names == ("a + e", "b - 2 e", "c")


def test_rank_does_not_depend_on_units():
    rng = np.random.default_rng(0)
    rows = rng.normal(size=(100, 4)) @ rng.normal(size=(4, 6))
    for scale in (1.0, 1e-6, 1e6):
        mixed = rows * np.array([1, scale, 1, 1 / scale, 1, 1])
        assert regroup(mixed, list("abcdef"), ["1"] * 6, tolerance=1e-9).rank == 4
