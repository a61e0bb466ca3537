"""The least moving mass of the printed estimate, by formulations that share nothing with the case study's."""

from __future__ import annotations

import sys
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import linprog, minimize

from bayesid.robot import inertia
from tests.example_robots import PAPER_ESTIMATE, paper_base_map

STUDY = Path(__file__).parents[2] / "case_studies" / "printed_estimate"
MODULES = ("run", "present", "feasibility")
P = np.array(PAPER_ESTIMATE)
A2 = 0.4318


@pytest.fixture(scope="module")
def feasibility(study):
    return sys.modules["feasibility"]


@pytest.fixture(scope="module")
def proven(feasibility):
    return {name: feasibility.least_mass(reading) for name, reading in feasibility.READINGS.items()}


def points(x: np.ndarray) -> np.ndarray:
    """Ten parameters (n, 10) of unit point masses at x (n, 3)."""
    return np.array([inertia.from_mass_com_inertia(1.0, c, np.zeros((3, 3))) for c in x])


def by_elimination(d2: float, elbow: bool) -> float:
    """The least mass from Schur complements: two unknowns, mass and first moment along z of link 2."""
    xx, yy, xy = (P[11] + P[9]) / 2, (P[11] - P[9]) / 2, -P[7]
    xz, yz = -P[8], -P[10]

    def mass(unknown):
        m2, hz = unknown
        h = np.array([P[2] - (A2 * m2 if elbow else 0.0), P[3]])
        block = np.array([[xx, xy, h[0]], [xy, yy, h[1]], [h[0], h[1], m2]])
        if np.linalg.eigvalsh(block)[0] <= 0:
            return 1e3
        side = np.array([xz, yz, hz])
        zz = side @ np.linalg.solve(block, side)
        about_axis = P[5] - m2 * d2**2 - 2 * d2 * hz - yy - zz  # I1yy
        if about_axis <= 0:
            return 1e3
        # Link 1 is a rod along the axis of joint 1: sum of squared first moments over its inertia about that axis.
        return m2 + (P[0] ** 2 + (P[1] - d2 * m2 - hz) ** 2) / about_axis

    starts = [(m, m * z) for m in np.linspace(2.5, 60, 24) for z in np.linspace(-0.8, 0.8, 33)]
    start = min(starts, key=mass)
    for _ in range(4):
        start = minimize(mass, start, method="Nelder-Mead", options={"xatol": 1e-10, "fatol": 1e-11, "maxiter": 4000}).x
    return mass(start)


@pytest.mark.parametrize("elbow", [False, True])
@pytest.mark.parametrize("d2", ["-0.2435", "0.2435"])
def test_least_mass_is_that_of_elimination(feasibility, proven, d2, elbow):
    found = proven[f"{'elbow' if elbow else 'joint 2'}, d2 = {d2}"]
    assert float(found.upper - found.lower) < 1e-3
    assert float(found.lower) - 1e-6 <= by_elimination(float(d2), elbow) <= float(found.upper) + 1e-4


def test_map_is_the_library_s_and_follows_from_moving_link_2(feasibility):
    readings = list(feasibility.READINGS.values())
    np.testing.assert_allclose(readings[0].matrix.astype(float), paper_base_map(), atol=1e-15)
    bodies = points(np.random.default_rng(0).normal(size=(2, 3)))
    for reading in readings:
        shift = np.array([A2 if reading.elbow else 0.0, 0.0, float(reading.d2)])
        moved = inertia.transform(bodies[1], np.eye(3), [0.0, 0.0, shift[2]])
        p = reading.matrix.astype(float) @ bodies.ravel()
        assert p[1] == pytest.approx(bodies[0, 3] + moved[3])
        assert p[5] == pytest.approx(bodies[0, 6] + moved[4])
        assert p[2] == pytest.approx(inertia.transform(bodies[1], np.eye(3), shift)[1])


def test_prices_prove_the_lower_bound(feasibility, proven):
    """No point mass, anywhere in either link, is worth more than its mass."""
    rng = np.random.default_rng(1)
    for name, reading in feasibility.READINGS.items():
        prices = proven[name].prices.astype(float)
        assert P @ prices == pytest.approx(float(proven[name].lower))
        cloud = points(rng.normal(size=(20000, 3)) * 10 ** rng.uniform(-2, 1, (20000, 1)))
        for i in range(2):
            worth = cloud @ (prices @ reading.matrix.astype(float)[:, 10 * i : 10 * i + 10])
            assert worth.max() <= 1 + 1e-9


def test_bodies_prove_the_upper_bound(feasibility, proven):
    for name, reading in feasibility.READINGS.items():
        bodies = proven[name].bodies
        assert list(feasibility.base_parameters(reading, bodies)) == [Fraction(str(v)) for v in PAPER_ESTIMATE]
        parameters = np.array([inertia.from_pseudo_inertia(body.astype(float)) for body in bodies])
        assert inertia.is_physically_consistent(parameters, 1e-14).all()
        np.testing.assert_allclose(reading.matrix.astype(float) @ parameters.ravel(), P, atol=1e-9)
        assert parameters[:, 0].sum() == pytest.approx(float(proven[name].upper))


def test_point_masses_on_a_grid_within_reach_come_near(feasibility):
    """Positive masses on a grid, a linear programme: never lighter than the proven bound, and little heavier."""
    axis = np.linspace(-0.5, 0.5, 17)
    grid = np.stack(np.meshgrid(axis, axis, axis), -1).reshape(-1, 3)
    cloud = points(grid[np.linalg.norm(grid, axis=1) <= 0.5])
    reading = feasibility.READINGS["joint 2, d2 = -0.2435"]
    k = reading.matrix.astype(float)
    columns = np.hstack([k[:, :10] @ cloud.T, k[:, 10:] @ cloud.T])
    found = linprog(np.ones(columns.shape[1]), A_eq=columns, b_eq=P, method="highs")
    held = feasibility.least_mass(reading, radius=Fraction(1, 2))
    assert found.status == 0 and float(held.lower) <= found.fun < 1.02 * float(held.upper)


def test_elimination_in_fractions_knows_positive_matrices(feasibility):
    def exact(rows):
        return np.array([[Fraction(v) for v in row] for row in rows], object)

    assert feasibility.is_positive(exact([[1, 2], [2, 4]]))
    assert feasibility.is_positive(exact([[0, 0], [0, 1]]))
    assert not feasibility.is_positive(exact([[0, 1], [1, 5]]))
    assert not feasibility.is_positive(exact([[1, 2], [2, Fraction(4) - Fraction(1, 10**30)]]))


@pytest.mark.parametrize("d2", [-0.2435, 0.2435])
def test_limits_of_each_number_are_where_bodies_end(study, feasibility, d2):
    reading = feasibility.READINGS[f"joint 2, d2 = {d2}"]
    for k, (low, high) in enumerate(study.alone(d2)):
        for limit in (low, high):
            if limit is None:
                continue
            for share, possible in ((0.9, True), (1.1, False)):
                values = list(feasibility.PRINTED)
                values[k] = Fraction(P[k] + share * (limit - P[k])).limit_denominator(10**6)
                assert (feasibility.lightest(reading, values) is not None) == possible, (k, limit, share)


def test_common_error_is_the_largest(study, feasibility):
    share = study.common_error(0.2435)
    rng = np.random.default_rng(2)

    def smallest(signs):
        return min(np.linalg.eigvalsh(feasibility.second_moments(P * (1 + s), 0.2435))[0] for s in signs)

    assert smallest(share * rng.uniform(-1, 1, (2000, 12))) >= 0
    assert smallest(1.001 * share * rng.choice([-1.0, 1.0], (4000, 12))) < 0


def test_link_2_is_limited_only_if_its_frame_is_at_the_elbow(feasibility):
    """The planar block of link 2 alone gives both limits."""
    inverse = np.linalg.inv([[(P[11] + P[9]) / 2, -P[7]], [-P[7], (P[11] - P[9]) / 2]])
    h, a = np.array([P[2], P[3]]), np.array([A2, 0.0])
    # m >= (h - a m)' S^-1 (h - a m)
    limits = np.sort(np.roots([a @ inverse @ a, -2 * (a @ inverse @ h) - 1, h @ inverse @ h]))
    for name, reading in feasibility.READINGS.items():
        low, high = feasibility.range_of_link_2(reading)
        if reading.elbow:
            np.testing.assert_allclose([low, high], limits, rtol=1e-5)
        else:
            assert high is None, name
            assert low == pytest.approx(h @ inverse @ h, rel=1e-5)


def test_impossible_numbers_are_refused(feasibility):
    values = list(feasibility.PRINTED)
    values[11] = Fraction(8, 10)  # I2zz below I2yy - I2xx
    with pytest.raises(RuntimeError, match="no bodies"):
        feasibility.least_mass(feasibility.READINGS["joint 2, d2 = -0.2435"], values)


def test_readme_shows_the_figures(study, feasibility, proven):
    text = (STUDY / "README.md").read_text(encoding="utf-8")
    for found in proven.values():
        assert f"{float(found.lower) // 0.001 * 0.001:.3f} to " in text
    assert f"{study.by_hand():.2f} kg" in text
    for found in proven.values():
        assert study.by_hand() < float(found.lower)


@pytest.mark.slow
def test_tables_and_figure(study, tmp_path):
    results = study.run(points=4)
    present = sys.modules["present"]
    filled = present.fill((STUDY / "README.md").read_text(encoding="utf-8"), present.tables(results))
    assert "| joint 2 | -0.2435 | yes |" in filled
    with pytest.raises(RuntimeError, match="no marker"):
        present.fill("", {"masses": ""})
    present.figure(results, tmp_path / "figure.png")
    assert (tmp_path / "figure.png").stat().st_size > 10000
