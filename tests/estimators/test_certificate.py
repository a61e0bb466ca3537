"""Bounds on bodies, their conflicts, and the test of data against physics."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import kstest

from bayesid.errors import InputError
from bayesid.estimators import Physical, fit
from bayesid.estimators.conic.bounds import Bounds, load_bounds
from bayesid.estimators.conic.physical import PhysicsTest, explain
from bayesid.estimators.conic.problem import Conic, Infeasible, solve_conic
from bayesid.regression.regression import Regression
from bayesid.robot import inertia
from tests.physical_cases import arm, random_case

ONE = (tuple(range(10)),)


@pytest.fixture(scope="module")
def panda(tmp_path_factory):
    return arm(tmp_path_factory.mktemp("panda"))


def points_to_body(points, masses):
    """A cloud of point masses: the definition, sum of m [x; 1][x; 1]'."""
    homogeneous = np.column_stack([points, np.ones(len(points))])
    return inertia.from_pseudo_inertia((homogeneous * masses[:, None]).T @ homogeneous)


def holds(bounds, body):
    groups = bounds.linear(["a"], ONE, 10)
    return all((g.matrix @ body >= g.low - 1e-12 * np.abs(g.matrix) @ np.abs(body)).all() for g in groups)


@pytest.mark.parametrize("seed", range(20))
def test_bodies_inside_meet_the_bounds(seed):
    """Necessary: any cloud of points inside an ellipsoid or a box does."""
    rng = np.random.default_rng(seed)
    centre, axes = rng.normal(size=3), rng.uniform(0.05, 0.5, 3)
    direction = rng.normal(size=(30, 3))
    ball = direction / np.linalg.norm(direction, axis=1)[:, None] * rng.uniform(0, 1, (30, 1)) ** (rng.integers(0, 2) / 3)
    masses = rng.exponential(size=30)
    assert holds(Bounds(ellipsoid={"a": (centre, axes)}), points_to_body(centre + ball * axes, masses))
    corners = rng.choice([-1.0, 1.0], (30, 3)) if seed % 2 else rng.uniform(-1, 1, (30, 3))
    assert holds(Bounds(box={"a": (centre - axes, centre + axes)}), points_to_body(centre + corners * axes, masses))


@pytest.mark.parametrize("axis", range(3))
def test_bodies_that_stick_out_do_not(axis):
    centre, axes = np.array([0.1, -0.2, 0.3]), np.array([0.1, 0.2, 0.3])
    for sign in (-1.0, 1.0):
        tip = centre + 1.01 * sign * axes[axis] * np.eye(3)[axis]
        for bounds in (Bounds(ellipsoid={"a": (centre, axes)}), Bounds(box={"a": (centre - axes, centre + axes)})):
            assert not holds(bounds, points_to_body(tip[None], np.ones(1)))


def test_box_bounds_are_exact_for_two_axes():
    """Any second moment in a plane that meets them is a cloud of points on a grid in the box, found by linear programming."""
    from scipy.optimize import linprog

    rng = np.random.default_rng(0)
    line = np.linspace(-1, 1, 21)
    grid = np.stack(np.meshgrid(line, line, [0.0]), -1).reshape(-1, 3)
    moments = np.column_stack([np.ones(len(grid)), grid[:, :2], grid[:, 0] ** 2, grid[:, 1] ** 2, grid[:, 0] * grid[:, 1]]).T
    box, met, missed = Bounds(box={"a": ((-1, -1, -1e-6), (1, 1, 1e-6))}), 0, 0
    for _ in range(80):
        x, y = rng.uniform(-0.9, 0.9, 2)
        second = np.array([[rng.uniform(x * x, 1), 0], [0, rng.uniform(y * y, 1)]])
        second[0, 1] = second[1, 0] = rng.uniform(-1, 1)
        pseudo = np.zeros((4, 4))
        pseudo[:2, :2], pseudo[3, :2], pseudo[:2, 3], pseudo[3, 3] = second, (x, y), (x, y), 1.0
        inside = holds(box, inertia.from_pseudo_inertia(pseudo)) and np.linalg.eigvalsh(pseudo)[0] > -1e-12
        wanted = np.array([1.0, x, y, second[0, 0], second[1, 1], second[0, 1]])
        # A grid cannot hit every moment exactly: allow what its spacing allows.
        slack = np.concatenate([np.eye(6), -np.eye(6)], axis=1)
        cost = np.append(np.zeros(len(grid)), np.ones(12))
        distance = linprog(cost, A_eq=np.hstack([moments, slack]), b_eq=wanted).fun
        assert (distance < 0.01) if inside else True
        met, missed = met + inside, missed + (not inside and distance > 1e-6)
    assert met > 10 and missed > 10


@pytest.mark.parametrize(
    ("bounds", "named", "innocent"),
    [
        (Bounds(total_mass=(0, 5), mass={"a": (3, 9), "b": (4, 9), "c": (0, 1)}),
         ("total mass", "mass of a", "mass of b"), ("of c",)),
        (Bounds(total_mass=(0, 9), com={"a": ((1, 1, 1), (2, 2, 2))}, box={"a": ([-1] * 3, [0.5] * 3)}, mass={"a": (1, 2)}),
         ("centre of mass of a", "box of a", "mass of a"), ("total",)),
        (Bounds(mass={"a": (0, 1)}, ellipsoid={"b": ((0, 0, 0), (0.1, 0.1, 0.1))}, com={"b": ((0.2, -1, -1), (1, 1, 1))}),
         ("ellipsoid of b", "centre of mass of b"), ("mass of a",)),
    ],
)  # fmt: skip
def test_bounds_in_conflict_are_named(bounds, named, innocent):
    """The smallest set, in one line, and nothing that has no part in it."""
    bodies = tuple(tuple(range(10 * k, 10 * k + 10)) for k in range(3))
    unit = np.diag([0.01, 0.01, 0.01, 1.0])
    centre = np.tile(inertia.from_pseudo_inertia(unit), 3)
    problem = Conic(np.eye(30), centre, bodies, np.array([unit] * 3), bounds.linear("abc", bodies, 30))
    with pytest.raises(Infeasible):
        solve_conic(problem)
    message = str(explain(problem))
    assert "\n" not in message
    assert all(part in message for part in named), message
    assert not any(part in message.replace("centre of mass of", "") for part in innocent), message


def test_conflicts_reach_the_user(panda):
    rng = np.random.default_rng(0)
    rows = (panda.matrix[:700] @ panda.problem.regression.base.matrix).reshape(100, 7, -1)
    groups = [range(10 * k, 10 * k + 10) for k in range(7)]
    regression = Regression.from_arrays(rows, rng.normal(size=(100, 7)), bodies=groups)
    with pytest.raises(InputError, match=r"total mass in \[1, 2\] kg and mass of body3 >= 4 kg exclude each other"):
        fit(regression, Physical(bounds=Bounds(total_mass=(1, 2), mass={"body3": (4, np.inf)})))
    with pytest.raises(InputError, match="no body 'body9'; did you mean"):
        fit(regression, Physical(bounds=Bounds(mass={"body9": (4, np.inf)})))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("total_mas = [1, 2]", "did you mean 'total_mass'"),
        ("total_mass = [2, 1]", "the lower bound, then"),
        ("total_mass = 3", "give \\[low, high\\]"),
        ("mass = 3", "table with one entry a body"),
        ("[mass]\na = [1, 'x']", "give \\[low, high\\]"),
        ("[mass]\na = [nan, 1.0]", "the lower bound, then"),
        ("[box]\na = [[0, 0, 0], [1, 1]]", "three numbers each"),
        ("[box]\na = [[0, 0, 0], [1, 1, inf]]", "finite corners"),
        ("[com]\na = [[0, 0, 0], [-1, 1, 1]]", "three numbers each"),
        ("[ellipsoid]\na = [[0, 0, 0], [0, 1, 1]]", "above 0"),
        ("total_mass = [", "cannot be read as TOML"),
    ],
)
def test_bad_bounds_are_refused_in_one_line(tmp_path, text, message):
    path = tmp_path / "bounds.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=message) as caught:
        load_bounds(path)
    assert "bounds.toml" in str(caught.value)


@pytest.mark.parametrize("given", [dict(total_mass=22), dict(mass={"a": 5.0}), dict(mass={"a": (1, 2, 3)})])
def test_a_bound_of_one_number_is_refused_in_one_line(given):
    with pytest.raises(InputError, match=r"^bounds: (total_mass|mass.a) = .*: give \[low, high\]$"):
        Bounds(**given)


def test_collision_boxes_take_the_robot(tmp_path):
    (path := tmp_path / "bounds.toml").write_text('box = "collision"')
    with pytest.raises(InputError, match='box = "collision" takes the robot.s geometry: give load_bounds the robot'):
        load_bounds(path)


def test_bounds_from_a_file(tmp_path):
    path = tmp_path / "bounds.toml"
    path.write_text("total_mass = [1, inf]\n[mass]\na = [0.5, 1]\n[com]\na = [[-1, -1, -1], [1, 1, 1]]\n", encoding="utf-8")
    bounds = load_bounds(path)
    assert bounds == Bounds(total_mass=(1, np.inf), mass={"a": (0.5, 1)}, com={"a": ([-1, -1, -1], [1, 1, 1])})


def test_the_global_test_is_conservative_and_has_power(panda):
    """True bodies on the boundary: never more alarms than stated. Readings no body can cause: always."""
    from bayesid.estimators.conic.links import conic

    rng = np.random.default_rng(4)
    chances = []
    for _ in range(40):
        data, trust, _ = random_case(panda, rng, bounded=False, std=1.0, rel_std=0.3)
        solution = solve_conic(conic(data, trust, (), trust.loosened))
        distance = float(np.sum((data.matrix @ solution.x - data.target) ** 2))
        chances.append(PhysicsTest.of(distance, len(data.target), True).probability_at_most)
    # Uniform or larger: the empirical distribution may not lie above the diagonal.
    assert kstest(chances, "uniform", alternative="greater").pvalue > 0.01
    data, trust, _ = random_case(panda, rng, bounded=False, std=0.05, rel_std=0.3)
    wrong = data.matrix @ -trust.mean
    data = replace(data, target=wrong)
    solution = solve_conic(conic(data, trust, (), trust.loosened))
    distance = float(np.sum((data.matrix @ solution.x - data.target) ** 2))
    assert PhysicsTest.of(distance, len(data.target), True).data_contradict_physics
