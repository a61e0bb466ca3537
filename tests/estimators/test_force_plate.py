"""A human on a force plate, posed exactly: known noise, a prior, ellipsoids that the segments fill, the whole mass.

A floating chain of segments; six channels of ground reaction; the same convex problem is written down again in CVXPY on the
rows themselves.
"""

import cvxpy as cp
import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial.transform import Rotation

import bayesid

NAMES = ("pelvis", "thigh", "shank")
TEN = ("m", "mcx", "mcy", "mcz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
STD = np.array([20.0, 20.0, 20.0, 8.0, 8.0, 8.0])
CENTRES = np.array([[0.0, 0.0, 0.05], [0.0, 0.02, -0.2], [0.01, 0.0, -0.2]])
AXES = np.array([[0.15, 0.11, 0.12], [0.09, 0.08, 0.24], [0.07, 0.06, 0.23]])
TURNS = np.array([[0.0, 0.3, 0.0], [0.2, 0.0, 0.1], [0.0, -0.1, 0.4]])
MASSES = np.array([12.0, 9.0, 4.0])
REL_STD = 0.3


def uniform(mass, centre, axes, rpy) -> pin.Inertia:
    """A solid ellipsoid."""
    turn = Rotation.from_euler("xyz", rpy).as_matrix()
    square = np.asarray(axes) ** 2
    return pin.Inertia(mass, np.asarray(centre), turn @ np.diag(mass / 5 * (square.sum() - square)) @ turn.T)


TRUTH = np.concatenate([uniform(*part).toDynamicParameters() for part in zip(MASSES, CENTRES, 0.98 * AXES, TURNS, strict=True)])


@pytest.fixture(scope="module")
def plate() -> tuple[np.ndarray, np.ndarray]:
    """Regressor (N, 6, 30) of the ground reaction, and its noisy readings (N, 6)."""
    model, rng = pin.Model(), np.random.default_rng(0)
    root = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "root")
    model.appendBodyToJoint(root, pin.Inertia.Random(), pin.SE3.Identity())
    for k, name in enumerate(NAMES[1:]):
        place = pin.SE3(np.eye(3), np.array([0.0, 0.1 * (k == 0), -0.1 if k == 0 else -0.42]))
        joint = model.addJoint(k + 1, pin.JointModelSpherical(), place, name)
        model.appendBodyToJoint(joint, pin.Inertia.Random(), pin.SE3.Identity())
    data = model.createData()
    rows = []
    for _ in range(60):
        q = pin.integrate(model, pin.neutral(model), 0.5 * rng.normal(size=model.nv))
        rows.append(pin.computeJointTorqueRegressor(model, data, q, rng.normal(size=model.nv), 2 * rng.normal(size=model.nv))[:6])
    matrix = np.array(rows)
    return matrix, matrix @ TRUTH + STD * rng.normal(size=(60, 6))


def known() -> bayesid.Bounds:
    ellipsoids = {
        "pelvis": (CENTRES[0], AXES[0], TURNS[0]),  # as in a URDF
        "thigh": (CENTRES[1], AXES[1], Rotation.from_euler("xyz", TURNS[1]).as_matrix()),
        "shank": (CENTRES[2], AXES[2], TURNS[2]),
    }
    return bayesid.Bounds(total_mass=(24.9, 25.1), ellipsoid=ellipsoids)


def pseudo(x) -> cp.Expression:
    """Second moment of mass in homogeneous coordinates (4, 4), from the ten parameters."""
    mass, first, (xx, xy, yy, xz, yz, zz) = x[0], x[1:4], (x[k] for k in range(4, 10))
    half = 0.5 * (xx + yy + zz)
    return cp.bmat([
        [half - xx, -xy, -xz, first[0]], [-xy, half - yy, -yz, first[1]], [-xz, -yz, half - zz, first[2]],
        [first[0], first[1], first[2], mass],
    ])  # fmt: skip


def by_cvxpy(matrix, target, nominal, metric) -> np.ndarray:
    x = cp.Variable(30)
    scaled = (matrix / STD[:, None]).reshape(-1, 30)
    cost = 0.5 * cp.sum_squares(scaled @ x - (target / STD).ravel())
    rules = [cp.sum(x[::10]) >= 24.9, cp.sum(x[::10]) <= 25.1]
    for k in range(3):
        body, reference = pseudo(x[10 * k : 10 * k + 10]), pseudo(nominal[10 * k : 10 * k + 10]).value
        lower = np.linalg.inv(np.linalg.cholesky(reference))
        relative = lower @ body @ lower.T
        if metric == "entropic":
            cost += (cp.trace(relative) - cp.log_det(0.5 * (relative + relative.T))) / REL_STD**2
        else:
            cost += 0.5 * cp.sum_squares(relative - np.eye(4)) / REL_STD**2
        unit = np.eye(4)  # from the unit ball to the ellipsoid
        unit[:3, :3] = Rotation.from_euler("xyz", TURNS[k]).as_matrix() * AXES[k]
        unit[:3, 3] = CENTRES[k]
        back = np.linalg.inv(unit)
        rules += [body >> 0, cp.trace((back.T @ np.diag([-1.0, -1.0, -1.0, 1.0]) @ back) @ body) >= 0]
    task = cp.Problem(cp.Minimize(cost), rules)
    task.solve(solver=cp.CLARABEL)
    assert task.status == cp.OPTIMAL
    return x.value


@pytest.mark.parametrize("metric", ["pullback", "entropic"])
def test_the_problem_is_the_one_that_was_published(plate, metric):
    matrix, target = plate
    tables = zip(MASSES * [1.3, 0.75, 1.2], CENTRES, 1.3 * AXES, TURNS, strict=True)  # too large for the ellipsoids
    nominal = np.concatenate([uniform(*part).toDynamicParameters() for part in tables])
    regression = bayesid.Regression.from_arrays(
        matrix, target, parameter_names=[f"{name}.{p}" for name in NAMES for p in TEN],
        bodies=[range(10 * k, 10 * k + 10) for k in range(3)], noise_std=STD,
    )  # fmt: skip
    method = bayesid.Physical(
        prior=bayesid.Prior.nominal(nominal, REL_STD), rel_std=REL_STD, metric=metric, bounds=known(), weights="noise"
    )
    estimate = bayesid.fit(regression, method)
    expected = by_cvxpy(matrix, target, nominal, metric)
    size = np.sqrt(np.diag(np.linalg.inv(bayesid.Prior.nominal(nominal, REL_STD).precision)))
    np.testing.assert_allclose((estimate.links - expected) / size, 0.0, atol=1e-3)  # CVXPY's own accuracy
    assert any("ellipsoid" in name for name in estimate.details.certificate.active_bounds)
