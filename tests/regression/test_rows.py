"""Rows from regressors on a grid of times against rows from those of all samples."""

import numpy as np
import pytest

import bayesid
from bayesid.effects.friction import ViscousFriction
from bayesid.regression.options import FitOptions
from bayesid.regression.problem import prepare
from bayesid.regression.rows import make_blocks
from bayesid.robot.robot import load_robot
from tests.robots import panda, prismatic_arm, write
from tests.simulated import Motion, Sensor, experiment, fourier, recording

EFFECTS = ("viscous_friction", "coulomb_friction", "torque_offset", "rotor_inertia")


def both_ways(problem):
    """Rows as they are made, and of all samples (rows, numbers in a row)."""
    segments = [s for name in problem.fitted for s in problem.segments[name]]
    ways = (None, problem.row_model.samples)
    return [np.concatenate([b.rows for b in make_blocks(problem.row_model, segments, way)]) for way in ways]


def solved(rows):
    """Least squares on columns of unit length: solution, deviations, rank."""
    flat = rows.reshape(-1, rows.shape[-1])
    length = np.linalg.norm(flat[:, :-1], axis=0)
    u, s, vt = np.linalg.svd(flat[:, :-1] / length, full_matrices=False)
    seen = s > 1e-10 * s[0]
    solution = vt[seen].T @ (u[:, seen].T @ flat[:, -1] / s[seen])
    left = flat[:, -1] - flat[:, :-1] @ (solution / length)
    return solution, np.linalg.norm(vt[seen].T / s[seen], axis=1) * left.std(), int(seen.sum())


def recorded(robot, rate=500.0, duration=30.0, speed=1.5, resolution=2e-5, changed=None, sensor=None, **options):
    """One motion; ``changed`` may change its samples first."""
    motion = fourier(robot, 3, duration, rate, speed)
    if changed is not None:
        motion = changed(motion)
    table = recording(robot, sensor, motion, torque_std=0.1, force_std=0.3, resolution=resolution)
    return experiment(robot, [Motion("a", "identification", table)], sensor, **options)


def like_all_samples(problem, share=2e-2):
    """Rows are those of all samples to 5e-6, and so are rank and, to a share of their deviations, estimates."""
    rows, every = both_ways(problem)
    off, size = (np.sqrt(np.mean(x**2, axis=(0, 1))) for x in (rows - every, every))
    assert np.array_equal(rows[:, :, -1], every[:, :, -1]) and np.all(off <= 5e-6 * size)
    (one, std, rank), (other, _, full) = solved(rows), solved(every)
    assert rank == full and np.all(np.abs(one - other) <= share * std)
    return off.max() > 0.0, rank, len(one)


def bursts_lost(motion):
    """Two bursts of messages lost, with 0.14 s between them."""
    t = motion[0]
    kept = ~((t >= 3.0) & (t < 3.06) | (t >= 3.2) & (t < 3.26))
    return tuple(part[kept] for part in motion)


def uneven(motion):
    """A third of the samples, at uneven times."""
    taken = np.arange(1, len(motion[0]) - 1, 3)
    taken = taken + np.random.default_rng(0).integers(-1, 2, len(taken))
    return tuple(part[taken] for part in motion)


@pytest.mark.parametrize("effects", [(), EFFECTS])
@pytest.mark.parametrize("changed", [None, uneven])
def test_rows_of_a_grid_are_those_of_all_samples(effects, changed, tmp_path):
    robot = load_robot(write(tmp_path, panda()))
    made = recorded(robot, 500.0 if changed is None else 1500.0, changed=changed)
    interpolated, rank, count = like_all_samples(prepare(made, FitOptions("torque", effects=effects)))
    # A rotor's inertia is that of the first link, too: the interpolated columns are as exactly dependent as the others.
    assert interpolated and (rank < count) == bool(effects)


@pytest.mark.parametrize("speed", [1e-4, 5e-4])
def test_viscous_and_dry_friction_of_a_resting_joint_stay_one(speed, tmp_path):
    """Below the speed at which dry friction turns over, they are the same but for a factor."""
    robot = load_robot(write(tmp_path, panda()))

    def parked(motion):
        times, q, v, a = (np.array(part) for part in motion)
        w = 2.0 * np.pi * 0.1
        q[:, 6], v[:, 6], a[:, 6] = speed / w * np.sin(w * times), speed * np.cos(w * times), -speed * w * np.sin(w * times)
        return times, q, v, a

    made = recorded(robot, changed=parked, resolution=1e-7)
    problem = prepare(made, FitOptions("torque", effects=("viscous_friction", "coulomb_friction")))
    interpolated, rank, count = like_all_samples(problem)
    assert interpolated and rank < count


@pytest.mark.parametrize(("speed", "bandwidth"), [(6.0, None), (12.0, None), (1.5, 4.0), (1.5, 2.0), (1.5, 1.0)])
def test_fast_motions_and_low_bandwidths_are_as_accurate(speed, bandwidth, tmp_path):
    """What a grid does not show well enough is computed at all samples."""
    robot = load_robot(write(tmp_path, panda()))
    like_all_samples(prepare(recorded(robot, speed=speed), FitOptions("torque", bandwidth=bandwidth)))


@pytest.mark.parametrize("text", [panda(), prismatic_arm()], ids=["panda", "prismatic"])
@pytest.mark.parametrize("channel", ["wrench", "both"])
def test_wrenches_too(text, channel, tmp_path):
    robot = load_robot(write(tmp_path, text))
    made = recorded(robot, sensor=Sensor(translation=np.array([0.02, -0.01, -0.1])))
    interpolated, _, _ = like_all_samples(prepare(made, FitOptions(channel)))
    assert interpolated


def test_with_other_effects_everything_is_taken_at_all_samples(tmp_path):
    robot = load_robot(write(tmp_path, panda()))
    problem = prepare(recorded(robot), FitOptions("torque", effects=("torque_offset", "rotor_inertia", "directional_friction")))
    assert problem.row_model.point is None and not problem.row_model.may_interpolate
    np.testing.assert_allclose(*both_ways(problem), rtol=0, atol=1e-12)


def test_a_class_says_itself_how_its_column_is_made():
    """One that is derived from friction need not be friction."""

    class Other(ViscousFriction):
        name = "other"

        def torque(self, motion, values):
            return values[0] * motion.acceleration

    assert ViscousFriction.column_in_time == "sampled" and Other.column_in_time == ""


@pytest.mark.parametrize("name", ["tx40", "ur10", "kuka-lwr4"])
@pytest.mark.parametrize("bandwidth", [None, 4.0, 1.5])
def test_rows_of_recorded_arms(name, bandwidth, shared):
    problem = prepare(bayesid.load_experiment(shared(f"data/{name}")), FitOptions("torque", bandwidth=bandwidth))
    like_all_samples(problem)


def test_a_piece_between_gaps_that_is_too_short_is_left_out_and_the_rest_is_used(tmp_path):
    """The whole recording was refused for it."""
    robot = load_robot(write(tmp_path, panda()))
    problem = prepare(recorded(robot, duration=12.0, changed=bursts_lost), FitOptions("torque", bandwidth=5.0))
    times = np.concatenate([block.times for block in make_blocks(problem.row_model, problem.fitted_segments)])
    assert times.min() < 1.0 and times.max() > 11.0
    assert not ((times > 2.9) & (times < 3.4)).any()
