"""`sdp`: bodies that can exist. Against least squares, an independent cvxpy formulation, and its own certificate."""

from __future__ import annotations

import json
import re
import warnings
from dataclasses import replace

import clarabel
import cvxpy as cp
import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2
from threadpoolctl import threadpool_limits

from bayesid.errors import BayesidWarning, InputError
from bayesid.estimators import Physical, fit
from bayesid.estimators.conic.bounds import Bounds, collision_boxes, load_bounds
from bayesid.estimators.conic.problem import _RIGHT, _UP, MARGIN, Conic, _inward, solution_at, solve_conic, solve_entropic
from bayesid.regression.options import FitOptions
from bayesid.regression.problem import prepare
from bayesid.regression.regression import PriorKnowledge, Regression
from bayesid.robot import inertia
from bayesid.robot.prior import Prior
from bayesid.robot.robot import load_robot
from bayesid.simulation.simulation import perturbed_links
from bayesid.workflows.identify import identify
from tests.physical_cases import arm, possible_draw, random_case
from tests.robots import ROBOTS, write
from tests.simulated import Motion, experiment, fourier, recording
from tests.studies import encoder_coverage
from tests.studies import physical as study


@pytest.fixture(scope="module")
def panda(tmp_path_factory):
    return arm(tmp_path_factory.mktemp("panda"))


def second_moment(phi):
    """Written out once more, by hand, for cvxpy: [[Sxx, Sxy, Sxz, hx], ...]."""
    m, hx, hy, hz, ixx, ixy, iyy, ixz, iyz, izz = (phi[k] for k in range(10))
    sxx, syy, szz = (iyy + izz - ixx) / 2, (ixx + izz - iyy) / 2, (ixx + iyy - izz) / 2
    return cp.bmat([[sxx, -ixy, -ixz, hx], [-ixy, syy, -iyz, hy], [-ixz, -iyz, szz, hz], [hx, hy, hz, m]])


def by_cvxpy(data, trust, bounds, units, margin=MARGIN):
    """The same problem as a person would write it down, without compression."""
    x = cp.multiply(units, cp.Variable(data.matrix.shape[1]))
    bodies = [x[10 * k : 10 * k + 10] for k in range(len(data.bodies))]
    cost = cp.sum_squares(data.matrix @ x - data.target) + cp.sum_squares(trust.root @ (x[: data.size] - trust.mean))
    rules = [second_moment(b) >> margin * s for b, s in zip(bodies, trust.references, strict=True)]
    names = list(data.names)
    if bounds.total_mass is not None:
        total = cp.sum([b[0] for b in bodies])
        rules += [total >= bounds.total_mass[0], total <= bounds.total_mass[1]]
    for name, (low, high) in bounds.mass.items():
        rules += [bodies[names.index(name)][0] >= low, bodies[names.index(name)][0] <= high]
    for name, (low, high) in bounds.com.items():
        b = bodies[names.index(name)]
        rules += [b[1:4] >= b[0] * np.array(low), b[1:4] <= b[0] * np.array(high)]
    problem = cp.Problem(cp.Minimize(cost / 2), rules)
    problem.solve(solver=cp.CLARABEL, tol_gap_abs=1e-11, tol_gap_rel=1e-11, tol_feas=1e-11)
    return x.value


def simulated(folder, name="ur5", *, seed=0, rel=0.0, std=0.02, trust=None, resolution=1e-5):
    """Torques of a robot whose links are not the nominal ones."""
    robot = load_robot(write(folder, ROBOTS[name]()))
    truth = perturbed_links(robot, rel, seed).ravel() if rel else robot.nominal.ravel()
    table = recording(robot, None, fourier(robot, seed), torque_std=std, resolution=resolution, phi=truth, seed=seed)
    made = experiment(robot, [Motion("a", "identification", table)], inertia_rel_std=trust)
    return robot, truth, made


@pytest.mark.parametrize("weights", ["channel", "noise"])
def test_without_active_constraints_and_pull_it_is_least_squares(tmp_path, weights):
    """Long recording, thick bodies, next to no pull: nothing but the data is left."""
    robot, _, made = simulated(tmp_path, std=1e-4, resolution=0.0)
    regression = prepare(made, FitOptions("torque")).regression
    plain = fit(regression, "wls" if weights == "channel" else "gls")
    ours = fit(regression, Physical(rel_std=1e3, weights=weights))
    assert ours.details.certificate.iterations == 0  # the unconstrained optimum was inside
    assert np.abs((ours.values - plain.values) / plain.std).max() < 1e-6
    np.testing.assert_allclose(ours.std, plain.std, rtol=1e-6)


@pytest.mark.parametrize("seed", range(6))
def test_direct_path_equals_cvxpy(panda, seed):
    """To 1e-6 of the bodies' sizes and of the noise, with links on the boundary and bounds active."""
    rng = np.random.default_rng(100 + seed)
    # By the pull-back metric, with which CVXPY's own solver comes to its last digits.
    data, trust, problem = random_case(
        panda, rng, bounded=False, std=10.0 ** rng.uniform(-0.5, 1.0), rel_std=0.5, metric="pullback"
    )
    total = problem.centre[: data.size : 10].sum()  # where it would be without bounds
    bounds = Bounds(
        total_mass=(1.01 * total, 1.1 * total),
        mass={data.names[2]: (0.0, 3.0)},
        com={data.names[1]: ((-0.05, -0.1, -0.05), (0.05, 0.1, 0.05))},
    )
    problem = replace(problem, bounds=bounds.linear(data.names, data.bodies, len(problem.centre)))
    ours, theirs = solve_conic(problem), by_cvxpy(data, trust, bounds, problem.units)
    assert ours.certified and ours.active
    assert np.linalg.norm(problem.factor @ (ours.x - theirs)) < 1e-5
    np.testing.assert_allclose(ours.x / problem.units, theirs / problem.units, atol=1e-6)


def certify(panda, seed, count):
    """Bodies without extent, bounds or not, noise over five decades: how many optima are on the boundary of several links."""
    rng, several = np.random.default_rng(seed), 0
    for _ in range(count):
        solution = solve_conic(random_case(panda, rng)[2])
        assert solution.certified, solution
        assert abs(solution.gap) < 1e-8
        bodies = solution.x[:70].reshape(-1, 10)
        assert (np.linalg.eigvalsh(inertia.pseudo_inertia(bodies))[:, 0] > 0).all()  # truly inside, not to a tolerance
        several += np.count_nonzero(solution.ranks < 4) >= 2
    return several


def test_random_problems_are_all_certified(panda):
    assert certify(panda, 77, 150) > 60


@pytest.mark.slow
@pytest.mark.parametrize("seed", [20261121, 4711, 8128])
def test_thousands_more_are_all_certified(panda, seed):
    assert certify(panda, seed, 1000) > 400


def test_a_point_beside_the_boundary_is_moved_inside_at_next_to_no_cost(panda):
    """What a solver may leave: a point outside by half of what is allowed."""
    rng, moved = np.random.default_rng(5), 0
    while moved < 5:
        _, _, problem = random_case(panda, rng, std=10.0, rel_std=0.5)
        solution = solve_conic(problem)
        if (solution.ranks == 4).all() or solution.iterations == 0:
            continue
        body = int(np.argmin(solution.ranks))
        values, vectors = np.linalg.eigh(problem.pseudo_inertias(solution.x)[body])
        back = np.linalg.cholesky(problem.references[body]) @ vectors[:, 0]
        x = solution.x.copy()
        x[list(problem.bodies[body])] -= (values[0] + 0.5 * MARGIN) * inertia.from_pseudo_inertia(np.outer(back, back))
        outside = solution_at(problem, x, solution.multipliers, 1)
        assert outside.violation == pytest.approx(0.5 * MARGIN, rel=1e-3)
        inside = _inward(problem, outside)
        assert inside.certified and inside.violation <= 0.1 * MARGIN
        moved += 1


def test_a_wrong_solution_is_not_certified(panda):
    """The certificate looks at the problem, so a moved point, a moved multiplier or a scaled one fails it."""
    rng = np.random.default_rng(3)
    solution = None
    while solution is None or solution.iterations == 0 or (solution.ranks == 4).all():
        _, _, problem = random_case(panda, rng, bounded=False)
        solution = solve_conic(problem)
    away = np.linalg.solve(problem.factor, rng.normal(size=len(solution.x)))
    for x, z in ((solution.x + 1e-2 * away, solution.multipliers), (solution.x, 1.1 * solution.multipliers),
                 (solution.x, 0 * solution.multipliers), (problem.centre, solution.multipliers)):  # fmt: skip
        assert not solution_at(problem, x, z, 1).certified


# Links of negative mass are far from any body: the solver may stop at three times the gap that it is asked for, and says so.
@pytest.mark.filterwarnings("ignore:sdp. certified to:bayesid.errors.BayesidWarning")
def test_readings_of_no_body_are_warned_of(tmp_path):
    """Torques of the wrong sign are those of negative masses."""
    robot, truth, _ = simulated(tmp_path, trust=0.3)
    table = recording(robot, None, fourier(robot, 0), torque_std=0.02, resolution=1e-5, phi=truth, seed=0)
    flipped = replace(table, torques=-table.torques)
    for given, warned in ((flipped, True), (table, False)):
        made = experiment(robot, [Motion("a", "identification", given)], inertia_rel_std=0.3)
        found = identify(made, "torque", "sdp")
        assert any("contradict physics" in w for w in found.warnings) == warned


def test_a_bound_that_the_data_contradict_is_named(tmp_path):
    """It was said that no body can exist and the model misses something, and of the bound nothing."""
    robot, truth, _ = simulated(tmp_path, trust=0.3)
    table = recording(robot, None, fourier(robot, 0), torque_std=0.02, resolution=1e-5, phi=truth, seed=0)
    total = truth.reshape(-1, 10)[:, 0].sum()
    regression = prepare(experiment(robot, [Motion("a", "identification", table)], inertia_rel_std=0.3)).regression
    wrong, right = (
        fit(regression, Physical(bounds=Bounds(total_mass=(a * total, b * total)))) for a, b in ((0.1, 0.2), (0.5, 2))
    )
    (line,) = (w for w in wrong.details.warnings if "contradict" in w)
    assert "total mass in [" in line and "Is the bound right?" in line and "contradict physics" not in line
    assert not any("contradict" in w for w in right.details.warnings)


@pytest.mark.filterwarnings("ignore:sdp. certified to:bayesid.errors.BayesidWarning")
def test_a_solver_that_stops_still_tells_what_contradicts_physics(tmp_path, monkeypatch):
    """Multipliers of an unfinished solution bound the distance from below: enough where the readings are of no body at all."""
    robot, truth, _ = simulated(tmp_path, trust=0.3)
    table = recording(robot, None, fourier(robot, 0), torque_std=0.02, resolution=1e-5, phi=truth, seed=0)
    flipped = experiment(robot, [Motion("a", "identification", replace(table, torques=-table.torques))], inertia_rel_std=0.3)
    regression = prepare(flipped, FitOptions("torque")).regression
    whole = fit(regression, "sdp").details.physics

    def stopped(problem):
        unfinished = clarabel.DefaultSettings()
        unfinished.verbose, unfinished.max_threads, unfinished.max_iter = False, 1, 12
        with monkeypatch.context() as m:
            m.setattr("bayesid.estimators.conic.problem._settings", lambda: iter([unfinished]))
            return solve_conic(problem)

    solvers = iter([solve_conic, stopped])
    monkeypatch.setattr("bayesid.estimators.conic.physical.solve_conic", lambda problem: next(solvers)(problem))
    bounded = fit(regression, "sdp").details.physics
    assert whole.data_contradict_physics and bounded.data_contradict_physics and not bounded.tested
    assert 100.0 * bounded.directions < bounded.distance <= whole.distance * (1.0 + 1e-6)


def test_links_can_exist_and_have_the_base_parameters(tmp_path):
    """Noise that makes plain least squares impossible; what simulators get is inside the cone."""
    _, truth, made = simulated(tmp_path, rel=0.3, std=2.0, trust=0.3, seed=4)
    plain, ours = identify(made, "torque"), identify(made, "torque", "sdp")
    assert not inertia.is_physically_consistent(plain.urdf.unconstrained.reshape(-1, 10)).all() and ours.physically_consistent
    np.testing.assert_allclose(ours.base.matrix @ ours.link_parameters, ours.values, rtol=1e-9, atol=1e-12)
    np.testing.assert_array_equal(ours.link_parameters, ours.estimate.links)
    true = ours.base.matrix @ truth
    assert np.linalg.norm((ours.values - true) / plain.std) < np.linalg.norm((plain.values - true) / plain.std)
    certificate = ours.estimate.details.certificate
    assert certificate.certified and not ours.estimate.details.physics.data_contradict_physics
    written = ours.write(tmp_path / "out").parent / "identified.urdf"
    again = load_robot(written, made.robot.joint_names)
    assert inertia.is_physically_consistent(again.nominal, tolerance=0.0).all()


def test_friction_cannot_be_negative(tmp_path):
    _, _, made = simulated(tmp_path, std=0.5, trust=0.3)
    regression = prepare(made, FitOptions("torque", effects=["viscous_friction", "coulomb_friction", "torque_offset"])).regression
    plain, ours = fit(regression), fit(regression, "sdp")
    held = np.array(regression.knowledge.effect_non_negative)
    r = regression.base.rank
    assert (plain.solution[r:][held] < 0).any()  # there is none, so about half come out negative
    assert (ours.solution[r:][held] > -1e-6).all()
    assert ours.details.certificate.certified and ours.details.certificate.active_bounds


def test_intervals_end_where_no_robot_is_possible(tmp_path):
    """Masses and friction are not negative, whatever the noise; what is inside of the intervals stays as it was."""
    _, truth, made = simulated(tmp_path, std=5.0)
    regression = prepare(made, FitOptions("torque", effects=["viscous_friction", "torque_offset"])).regression
    estimate = fit(regression, Physical(rel_std=1.0))
    rank, (low, high) = regression.base.rank, estimate.possible
    friction = np.array(regression.knowledge.effect_non_negative)
    assert (low[rank:][friction] == 0.0).all() and np.isinf(low[rank:][~friction]).all() and np.isinf(high).all()
    assert (estimate.parameters().low >= low).all() and (estimate.parameters().low[rank:][friction] == 0.0).any()
    whole = estimate.solution - 1.959964 * estimate.full_std
    np.testing.assert_allclose(estimate.parameters().low[np.isinf(low)], whole[np.isinf(low)], rtol=1e-5, atol=1e-9)
    assert re.search(r" in 0(\.0+)? … ", str(estimate))
    # Thousands of possible robots: none leaves the range, and each of its ends is one's that is almost empty.
    rng, size = np.random.default_rng(0), regression.base.matrix.shape[1]
    roots = rng.normal(size=(4000, size // 10, 4, 4)) * 10.0 ** rng.uniform(-3, 1, (4000, 1, 1, 4))
    bodies = [[inertia.from_pseudo_inertia(r @ r.T) for r in robot] for robot in roots]
    values = np.reshape(bodies, (4000, size)) @ regression.base.matrix.T
    assert (values >= low[:rank]).all() and (values.min(axis=0)[np.isinf(low[:rank])] < 0.0).all()
    mass = regression.base.matrix[:, ::10].any(axis=1)
    assert 3 <= np.isfinite(low[:rank]).sum() < rank and mass.any()


def test_a_bound_ends_intervals_of_the_parameter_that_it_bounds():
    rng = np.random.default_rng(0)
    rows = rng.normal(size=(200, 1, 10))
    readings = rows @ np.array([2.0, 0.1, 0.0, 0.0, 0.3, 0.0, 0.3, 0.0, 0.0, 0.2]) + rng.normal(size=(200, 1))
    regression = Regression.from_arrays(rows, readings, bodies=[range(10)],
                                        parameter_names=[f"a.{p}" for p in inertia.PARAMETERS])  # fmt: skip
    bounded = fit(regression, Physical(bounds=Bounds(mass={"a": (1.9, 2.05)})))
    where = list(regression.base.names).index("a.m")
    np.testing.assert_allclose(bounded.possible[:, where], [1.9, 2.05], rtol=1e-9)
    assert bounded.low[where] >= 1.9 and bounded.high[where] <= 2.05 + 1e-9


def test_a_closed_form_on_the_boundary():
    """One body, all ten parameters measured alike in the metric of the unit body: eigenvalues are clipped at zero."""
    rng = np.random.default_rng(0)
    reference = np.eye(4)
    pack = np.array([inertia.pseudo_inertia(e)[_UP, _RIGHT] * np.where(_UP == _RIGHT, 1, 2**0.5) for e in np.eye(10)]).T
    q, r = np.linalg.qr(pack)
    r = r * np.sign(np.diag(r))[:, None]
    for _ in range(10):
        wanted = rng.normal(size=(4, 4))
        wanted = wanted + wanted.T
        problem = Conic(r, inertia.from_pseudo_inertia(wanted), (tuple(range(10)),), reference[None], margin=0.0)
        got = inertia.pseudo_inertia(solve_conic(problem).x)
        values, vectors = np.linalg.eigh(wanted)
        np.testing.assert_allclose(got, (vectors * np.maximum(values, 0)) @ vectors.T, atol=2e-5)
        assert solve_conic(problem).ranks[0] == np.count_nonzero(values > 0)


@pytest.mark.parametrize("metric", ["warped", "pullback", "euclidean", "entropic"])
def test_metrics_and_units(tmp_path, metric):
    _, truth, made = simulated(tmp_path, rel=0.2, std=0.5, trust=0.2)
    regression = prepare(made, FitOptions("torque")).regression
    ours = fit(regression, Physical(metric=metric))
    assert ours.details.certificate.certified and ours.details.prior.metric == metric
    assert inertia.is_physically_consistent(ours.links.reshape(-1, 10), tolerance=0.0).all()


def test_the_trust_is_found_where_none_is_stated(tmp_path):
    """Links are scaled, shifted and warped by 20 %; the data find about that, and say so."""
    found = []
    for seed in range(5):
        robot = load_robot(write(tmp_path, ROBOTS["ur5"]()))
        truth = possible_draw(Prior.warped(robot.nominal, 0.2), np.random.default_rng(seed))
        table = recording(robot, None, fourier(robot, seed), torque_std=0.05, resolution=1e-5, phi=truth, seed=seed)
        made = experiment(robot, [Motion("a", "identification", table)])
        details = fit(prepare(made, FitOptions("torque")).regression, "sdp").details.prior
        assert not details.stated
        found.append(details.rel_std)
    assert 0.13 < np.median(found) < 0.28


def test_closest_body_fits_as_well_as_the_data_demand(tmp_path):
    _, _, made = simulated(tmp_path, rel=0.2, std=0.5, trust=0.2)
    regression = prepare(made, FitOptions("torque")).regression
    both, near = fit(regression, "sdp"), fit(regression, Physical(closest=0.95))
    limit = near.details.closest.largest_misfit
    assert near.details.misfit == pytest.approx(limit, rel=1e-5)  # as far as it may go
    assert near.interval == "none" and near.interval_reason
    metric = Prior.nominal(made.robot.nominal, 1.0).precision

    def distance(links):
        return (links - made.robot.nominal.ravel()) @ metric @ (links - made.robot.nominal.ravel())

    assert limit >= chi2.ppf(0.95, regression.base.rank)
    assert both.details.misfit < limit  # so the estimate is one of those that may be chosen
    assert distance(near.links) <= distance(both.links) * (1 + 1e-6)
    # And tightening the demand can only take it further away.
    assert distance(fit(regression, Physical(closest=0.5)).links) >= distance(near.links)


def test_closest_body_is_the_nominal_one_where_that_fits(tmp_path):
    _, _, made = simulated(tmp_path, rel=0.0, std=50.0, trust=0.2)
    near = fit(prepare(made, FitOptions("torque")).regression, Physical(closest=0.95))
    assert near.details.misfit <= near.details.closest.largest_misfit
    nominal = made.robot.nominal
    off = np.abs(near.links.reshape(-1, 10) - nominal) / np.abs(nominal).max(axis=1, keepdims=True)
    assert off.max() < 1e-4


def test_arrays_of_ones_own_with_and_without_a_prior(panda):
    """No robot, no URDF: bodies are named by their columns; the prior is the caller's."""
    rng = np.random.default_rng(0)
    robot, base = panda.robot, panda.problem.regression.base
    rows = (panda.matrix[:1400] @ base.matrix).reshape(200, 7, -1)
    target = rows @ robot.nominal.ravel() + 0.5 * rng.normal(size=(200, 7))
    groups = [range(10 * k, 10 * k + 10) for k in range(7)]
    regression = Regression.from_arrays(rows, target, bodies=groups)
    prior = Prior.nominal(robot.nominal, 0.2)
    with_prior, without = fit(regression, "sdp", prior=prior), fit(regression, "sdp")
    for estimate in (with_prior, without):
        assert estimate.details.certificate.certified
        assert inertia.is_physically_consistent(estimate.links.reshape(-1, 10), tolerance=0.0).all()
    assert set(with_prior.details.certificate.bodies) == {f"body{k + 1}" for k in range(7)}
    truth = regression.base.matrix @ robot.nominal.ravel()
    plain = fit(regression)
    assert np.linalg.norm((with_prior.values - truth) / plain.std) < np.linalg.norm((plain.values - truth) / plain.std)
    with pytest.raises(InputError, match="bodies="):
        fit(Regression.from_arrays(rows, target), "sdp")
    with pytest.raises(InputError, match="takes no prior"):
        fit(regression, "wls", prior=prior)
    with pytest.raises(InputError, match="prior is for 60"):
        fit(regression, "sdp", prior=Prior.nominal(robot.nominal[:6], 0.2))


def test_a_massless_frame_stays_next_to_nothing(tmp_path):
    text = ROBOTS["ur5"]()
    robot = load_robot(write(tmp_path, text))
    bodies = robot.nominal.copy()
    bodies[5] = 0.0
    light = replace(robot, nominal=bodies)
    table = recording(light, None, fourier(light, 0), torque_std=0.1)
    made = experiment(light, [Motion("a", "identification", table)], inertia_rel_std=0.3)
    result = fit(prepare(made, FitOptions("torque")).regression, "sdp")
    assert result.details.certificate.certified
    assert 0 <= result.links[50] < 0.01


@pytest.mark.parametrize(
    ("method", "message"),
    [
        (Physical(metric="riemannian"), "choose one of warped"),
        (Physical(rel_std=-1.0), "above 0"),
        (Physical(closest=1.5), "between 0 and 1"),
        (Physical(weights="some"), "choose one of auto"),
    ],
)
def test_unknown_options_are_refused(tmp_path, method, message):
    rng = np.random.default_rng(0)
    regression = Regression.from_arrays(rng.normal(size=(50, 2, 10)), rng.normal(size=(50, 2)), bodies=[range(10)])
    with pytest.raises(InputError, match=message):
        fit(regression, method)


@pytest.mark.parametrize("bounded", [False, True])
def test_entropic_equals_a_general_minimiser(bounded):
    """One body and few readings; against SLSQP on the log-Cholesky factor."""
    from scipy.optimize import minimize

    rng = np.random.default_rng(1)
    nominal = inertia.from_mass_com_inertia(2.0, np.array([0.1, -0.05, 0.2]), np.diag([0.03, 0.04, 0.02]))
    rows, std = rng.normal(size=(40, 1, 10)), 0.3
    target = rows @ (nominal * 1.5) + 0.3 * rng.normal(size=(40, 1))
    regression = Regression.from_arrays(rows, target, bodies=[range(10)])
    limits = Bounds(mass={"body1": (0.0, 2.2)}) if bounded else Bounds()
    prior = Prior.nominal(nominal, std)
    ours = fit(regression, Physical(prior=prior, rel_std=std, metric="entropic", bounds=limits, weights="noise"))
    plain = fit(regression, "gls")
    metric = np.linalg.inv(plain.covariance)
    inverse = np.linalg.inv(inertia.pseudo_inertia(nominal))

    def cost(flat):
        root = np.zeros((4, 4))
        root[np.tril_indices(4)] = flat
        np.fill_diagonal(root, np.exp(np.diag(root)))
        pseudo = root @ root.T
        d = inertia.from_pseudo_inertia(pseudo) - plain.values
        return 0.5 * d @ metric @ d + (np.trace(inverse @ pseudo) - np.linalg.slogdet(inverse @ pseudo)[1] - 4) / std**2, pseudo

    start = np.linalg.cholesky(inertia.pseudo_inertia(nominal))
    np.fill_diagonal(start, np.log(np.diag(start)))
    rules = [{"type": "ineq", "fun": lambda f: 2.2 - cost(f)[1][3, 3]}] if bounded else []
    found = minimize(lambda f: cost(f)[0], start[np.tril_indices(4)], method="SLSQP", constraints=rules, bounds=[(-5, 3)] * 10,
                     options={"ftol": 1e-13, "maxiter": 2000})  # fmt: skip
    certificate = ours.details.certificate
    assert certificate.objective == pytest.approx(found.fun, rel=1e-5)
    assert certificate.lower_bound <= found.fun * (1 + 1e-6) and certificate.certified
    assert bool(certificate.active_bounds) == bounded


def test_entropic_with_many_bounds_is_certified(panda):
    rng, active = np.random.default_rng(5), 0
    for _ in range(5):
        std = 10.0 ** rng.uniform(-1.3, 0.3)
        data, _, problem = random_case(panda, rng, bounded=True, rel_std=std)
        solution = solve_entropic(problem, data.matrix, data.target, std)
        assert solution.certified and (solution.eigenvalues > 0).all(), solution
        active += bool(solution.active)
    assert active


def test_collision_geometry_bounds_a_body(tmp_path):
    """Primitives in fixed and moving links; the box in the joint's frame by hand."""
    text = """<robot name="r"><link name="base"/>
    <link name="a"><inertial><mass value="2"/><inertia ixx=".02" iyy=".02" izz=".02" ixy="0" ixz="0" iyz="0"/></inertial>
      <collision><origin xyz="0.1 0 0"/><geometry><box size="0.4 0.2 0.1"/></geometry></collision></link>
    <link name="b"><inertial><mass value="1"/><inertia ixx=".01" iyy=".01" izz=".01" ixy="0" ixz="0" iyz="0"/></inertial>
      <collision><geometry><sphere radius="0.05"/></geometry></collision></link>
    <joint name="j" type="revolute"><parent link="base"/><child link="a"/><axis xyz="0 0 1"/>
      <limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
    <joint name="f" type="fixed"><parent link="a"/><child link="b"/><origin xyz="0 0 0.3"/></joint></robot>"""
    robot = load_robot(write(tmp_path, text))
    low, high = collision_boxes(robot)["j"]
    np.testing.assert_allclose(low, [-0.1, -0.1, -0.05], atol=1e-12)
    np.testing.assert_allclose(high, [0.3, 0.1, 0.35], atol=1e-12)
    (tmp_path / "bounds.toml").write_text('box = "collision"', encoding="utf-8")
    assert set(load_bounds(tmp_path / "bounds.toml", robot).box) == {"j"}
    with pytest.raises(InputError, match="no <collision>"):
        collision_boxes(load_robot(write(tmp_path, ROBOTS["ur5"]())))


def test_intervals_take_the_nominal_model_in_only_where_that_was_proved(tmp_path):
    """docs/studies/physical: up to a stated trust of 0.2; beyond, and where it is found from the data, the data's alone."""
    stds = {}
    for trust in (0.2, 0.5, None):
        _, _, made = simulated(tmp_path, rel=0.2, std=2.0, trust=trust)
        regression = prepare(made, FitOptions("torque")).regression
        estimate = fit(regression, Physical(weights="channel"))
        stds[trust] = estimate.std
        assert estimate.interval == ("credible" if trust == 0.2 else "confidence")
        if trust != 0.2:
            np.testing.assert_allclose(estimate.std, fit(regression, "wls").std, rtol=1e-6)
    assert (stds[0.2] <= stds[0.5] * (1 + 1e-9)).all()


def test_a_trust_that_the_data_contradict_is_left_out_of_intervals(tmp_path):
    _, _, made = simulated(tmp_path, rel=0.5, std=0.1, trust=0.02)
    regression = prepare(made, FitOptions("torque")).regression
    estimate = fit(regression, Physical(weights="channel"))
    assert estimate.details.prior.probability < 0.05
    assert estimate.interval == "confidence"
    np.testing.assert_allclose(estimate.std, fit(regression, "wls").std, rtol=1e-6)


@pytest.mark.slow
def test_links_that_lie_elsewhere_are_not_pulled_to_the_nominal_ones():
    """Links a tenth of a metre off, which of a wrist is its length: a pull of some of them to the nominal ones does only harm."""
    errors = {"sdp": [], "wls": []}
    with warnings.catch_warnings(), threadpool_limits(1, user_api="blas"):
        warnings.simplefilter("ignore", BayesidWarning)
        for k in range(6):
            made, links = encoder_coverage.record("ur5, white, 0 rad", np.random.default_rng(k))
            regression = prepare(made, FitOptions()).regression
            for name, found in errors.items():
                estimate = fit(regression, name)
                found.append((estimate.values - regression.base.matrix @ links) / estimate.std)
                if name == "sdp":
                    assert estimate.details.prior.rel_std == 100.0
                    assert "fill only what data leave open" in estimate.details.prior.rule
    rms = {name: float(np.sqrt(np.mean(np.square(found)))) for name, found in errors.items()}
    assert rms["sdp"] < 1.02 * rms["wls"], rms  # 1.1 times with the pull that makes the data most probable
    squares = np.sum(np.square(errors["sdp"]), axis=0)
    assert squares.max() < chi2.ppf(1.0 - 0.01 / len(squares), 6), squares  # of all parameters at once, in a hundred studies one


@pytest.mark.parametrize(("times", "end", "words"), [(1.0, "smallest", "smallest"), (1e4, "largest", "no value explains")])
def test_a_search_for_the_prior_strength_that_stops_at_an_end_says_so(panda, times, end, words):
    """Readings exactly as nominal, and those of bodies ten thousand times as heavy."""
    robot, base = panda.robot, panda.problem.regression.base
    rows = (panda.matrix[:1400] @ base.matrix).reshape(200, 7, -1)
    rng = np.random.default_rng(0)
    noise = 0.1 * rng.normal(size=(200, 7))
    reading = rows @ robot.nominal.ravel() * times + noise
    bodies = tuple(tuple(range(10 * k, 10 * k + 10)) for k in range(7))
    regression = replace(
        Regression.from_arrays(rows, reading),
        knowledge=PriorKnowledge(nominal_links=robot.nominal.ravel(), bodies=bodies),
    )
    prior = fit(regression, "sdp").details.prior
    assert prior.end == end and words in prior.rule


def test_compare_takes_bounds(tmp_path, capsys):
    from bayesid import write_experiment
    from bayesid.cli import main

    _, _, made = simulated(tmp_path, rel=0.2, std=0.5, trust=0.2)
    folder = tmp_path / "experiment"
    write_experiment(made, folder)
    total = made.robot.nominal[:, 0].sum()
    (tmp_path / "bounds.toml").write_text(f"total_mass = [{1.5 * total}, {2 * total}]", encoding="utf-8")
    bounds, out = str(tmp_path / "bounds.toml"), str(tmp_path / "out")
    asked = ["compare", str(folder), "--channel", "torque", "--bounds", bounds, "--out", out]
    assert main([*asked, "--methods", "ols, sdp"]) == 0
    result = json.loads((tmp_path / "out" / "comparison.json").read_text(encoding="utf-8"))
    sdp = next(m for m in result["methods"] if m["name"] == "sdp")
    total_mass = fit(prepare(made, FitOptions("torque")).regression, Physical(bounds=Bounds(total_mass=(1.5 * total, 2 * total))))
    values = [p["value"] for p in sdp["base_parameters"]] if "base_parameters" in sdp else None
    assert values is not None
    np.testing.assert_allclose(values, total_mass.values, rtol=1e-6, atol=1e-8)
    assert main([*asked, "--methods", "ols"]) == 2
    assert "add sdp to --methods" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize("case", [study.CASES[k] for k in (0, 3, 6, 7)], ids=str)
def test_intervals_cover_also_with_every_run_on_the_boundary(case):
    """Other recordings than those of docs/studies/physical."""
    found = study.study(*case, 60, 40_000_000)
    methods = [m for name, m in found["methods"].items() if name.startswith("sdp")]
    for method in methods:
        assert method["certified"] == 1.0
        assert 0.92 < method["coverage"]["mean"] and found["band"][0] <= method["coverage"]["lowest"]
        if case[3] == "nominal":
            assert method["links_on_boundary"] > 0.9


def test_the_page_of_the_study_is_what_its_numbers_say(tmp_path):
    docs = study.ROOT / "docs" / "studies" / "physical"
    study.write_page(json.loads((docs / "results.json").read_text(encoding="utf-8")), tmp_path)
    for name in ("results.json", "README.md"):
        assert (tmp_path / name).read_text(encoding="utf-8") == (docs / name).read_text(encoding="utf-8")


def test_a_turned_ellipsoid_bounds_bodies_as_the_same_one_in_its_own_axes_does():
    turn = Rotation.from_euler("xyz", [0.3, -0.2, 0.5]).as_matrix()
    centre, axes = np.array([0.1, -0.05, 0.2]), np.array([0.3, 0.2, 0.1])
    turned = Bounds(ellipsoid={"a": (centre, axes, [0.3, -0.2, 0.5])}).linear(("a",), (tuple(range(10)),), 10)[0]
    matrix = Bounds(ellipsoid={"a": (centre, axes, turn)}).linear(("a",), (tuple(range(10)),), 10)[0]
    straight = Bounds(ellipsoid={"a": (turn.T @ centre, axes)}).linear(("a",), (tuple(range(10)),), 10)[0]
    rng = np.random.default_rng(0)
    for _ in range(20):  # points of mass: inside, and outside
        point = centre + 0.2 * rng.normal(size=3)
        body, seen = (pin.Inertia(1.0, p, np.zeros((3, 3))).toDynamicParameters() for p in (point, turn.T @ point))
        value = (turned.matrix @ body)[0]
        np.testing.assert_allclose([value, (matrix.matrix @ body)[0]], (straight.matrix @ seen)[0], rtol=1e-9, atol=1e-9)
        assert (value >= 0) == (np.sum((turn.T @ (point - centre) / axes) ** 2) <= 1.0)


@pytest.mark.parametrize("turn", [[0.1, 0.2], [[1.0, 0.0], [0.0, 1.0]], (2.0 * np.eye(3)).tolist(), ["a", 0.0, 0.0]])
def test_what_turns_no_ellipsoid_is_refused(turn):
    with pytest.raises(InputError, match="roll, pitch"):
        Bounds.from_dict({"ellipsoid": {"a": [[0, 0, 0], [1, 1, 1], turn]}})


def test_bounds_from_a_file_with_a_mark_in_front_and_a_turned_ellipsoid(tmp_path):
    path = tmp_path / "bounds.toml"
    path.write_text("[ellipsoid]\na = [[0, 0, 0], [1, 2, 3], [0.0, 0.0, 1.5707963267948966]]", encoding="utf-8-sig")
    (group,) = load_bounds(path).linear(("a",), (tuple(range(10)),), 10)
    (other,) = Bounds(ellipsoid={"a": ([0, 0, 0], [2, 1, 3])}).linear(("a",), (tuple(range(10)),), 10)
    np.testing.assert_allclose(group.matrix, other.matrix, atol=1e-12)
    assert group.name.endswith("turned")
