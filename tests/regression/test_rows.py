"""Rows from regressors on a grid of times against rows from those of all samples."""

import numpy as np
import pytest

import bayesid
from bayesid.regression.options import FitOptions
from bayesid.regression.problem import prepare
from bayesid.regression.rows import make_blocks
from bayesid.robot.robot import load_robot
from tests.robots import panda, write
from tests.simulated import Motion, experiment, fourier, recording

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


@pytest.mark.parametrize("effects", [(), EFFECTS, ("viscous_friction", "directional_friction")])
@pytest.mark.parametrize("uneven", [False, True])
def test_rows_of_a_grid_are_those_of_all_samples(effects, uneven, tmp_path):
    robot = load_robot(write(tmp_path, panda()))
    motion = fourier(robot, 3, 30.0, 1500.0)
    taken = np.arange(1, len(motion[0]) - 1, 3)
    if uneven:
        taken = taken + np.random.default_rng(0).integers(-1, 2, len(taken))
    motion = tuple(part[taken] for part in motion)
    table = recording(robot, None, motion, torque_std=0.1, resolution=2e-5)
    problem = prepare(experiment(robot, [Motion("a", "identification", table)]), FitOptions("torque", effects=effects))
    rows, every = both_ways(problem)
    size = np.sqrt(np.mean(every**2, axis=(0, 1)))
    assert np.array_equal(rows[:, :, -1], every[:, :, -1])
    off = np.sqrt(np.mean((rows - every) ** 2, axis=(0, 1)))
    assert np.all(off <= 2e-5 * size) and (off[:-1].max() > 0.0) == (effects != ("viscous_friction", "directional_friction"))


def test_what_cannot_be_told_apart_stays_so(tmp_path):
    """A rotor's inertia is that of the first link, too: the interpolated columns are as exactly dependent as the others."""
    robot = load_robot(write(tmp_path, panda()))
    table = recording(robot, None, fourier(robot, 3, 30.0, 500.0), torque_std=0.1, resolution=2e-5)
    problem = prepare(experiment(robot, [Motion("a", "identification", table)]), FitOptions("torque", effects=EFFECTS))
    assert problem.row_model.interpolable
    (one, std, rank), (other, _, full) = (solved(rows) for rows in both_ways(problem))
    assert rank == full < len(one) and np.abs(one - other).max() < 1e-3 * std.max()
    assert np.all(np.abs(one - other) < 1e-2 * std)


@pytest.mark.parametrize("effect", ["directional_friction", "coupled_friction@joint6->joint7"])
def test_with_other_effects_everything_is_taken_at_all_samples(effect, tmp_path):
    robot = load_robot(write(tmp_path, panda()))
    table = recording(robot, None, fourier(robot, 3, 20.0, 500.0), torque_std=0.1, resolution=2e-5)
    effects = ("torque_offset", "rotor_inertia", effect)
    problem = prepare(experiment(robot, [Motion("a", "identification", table)]), FitOptions("torque", effects=effects))
    assert problem.row_model.point is not None or not problem.row_model.interpolable
    np.testing.assert_array_equal(*both_ways(problem))


@pytest.mark.parametrize("name", ["tx40", "ur10", "kuka-lwr4"])
def test_rows_of_recorded_arms(name, shared):
    problem = prepare(bayesid.load_experiment(shared(f"data/{name}")), FitOptions("torque"))
    rows, every = both_ways(problem)
    off, size = (np.sqrt(np.mean(x**2, axis=(0, 1))) for x in (rows - every, every))
    assert np.all(off <= 1e-5 * size) and off.max() > 0.0
    (one, std, rank), (other, _, full) = solved(rows), solved(every)
    assert rank == full and np.all(np.abs(one - other) < 1e-3 * std)
