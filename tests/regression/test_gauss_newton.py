"""Step control on problems whose minimum is known."""

from dataclasses import replace

import numpy as np
from scipy.optimize import least_squares

from bayesid.estimators.nonlinear import Linearised, StepControl, minimise

SHARES = StepControl(30, 40, 1.0, lambda c: 0.5 * c, lambda _: 1.0, lambda cost: 1e-9 * cost)
DAMPED = StepControl(200, 30, 1e-3, lambda c: max(10.0 * c, 1e-4), lambda c: 0.1 * c, lambda _: 0.0, 1e-20)
START = np.array([-1.2, 1.0])


def rosenbrock(x):
    return np.array([10.0 * (x[1] - x[0] ** 2), 1.0 - x[0]])


def cost(x):
    return float(np.sum(rosenbrock(x) ** 2))


def slope(x):
    return np.array([[-20.0 * x[0], 10.0], [-1.0, 0.0]])


def by_shares(x):
    step = np.linalg.lstsq(slope(x), -rosenbrock(x))[0]
    if np.linalg.norm(step) < 1e-12:
        return None
    return Linearised(cost(x), lambda c: (x + c * step, cost(x + c * step)))


def by_damping(x):
    j, r = slope(x), rosenbrock(x)

    def trial(c):
        new = x - np.linalg.solve(j.T @ j + c * np.eye(2), j.T @ r)
        return new, cost(new)

    return Linearised(cost(x), trial)


def test_both_kinds_of_caution_find_the_minimum_that_scipy_finds():
    expected = least_squares(rosenbrock, START).x
    np.testing.assert_allclose(minimise(START, by_shares, SHARES), expected, atol=1e-8)
    np.testing.assert_allclose(minimise(START, by_damping, DAMPED), expected, atol=1e-6)


def test_the_cost_never_rises():
    seen = []

    def watched(x):
        seen.append(cost(x))
        return by_shares(x)

    minimise(START, watched, SHARES)
    assert len(seen) > 2 and all(b <= a * (1 + 1e-9) for a, b in zip(seen, seen[1:], strict=False))


def test_a_trial_that_diverges_is_refused_and_the_fit_stays_where_it_was():
    tried = []

    def diverging(x):
        def trial(c):
            tried.append(c)
            return x * np.nan, float("nan")

        return Linearised(1.0, trial)

    assert minimise(3.0, diverging, replace(SHARES, trials=4)) == 3.0
    assert tried == [1.0, 0.5, 0.25, 0.125]


def test_a_model_that_has_settled_takes_no_step():
    assert minimise(5.0, lambda _: None, SHARES) == 5.0
    assert minimise(5.0, lambda x: Linearised(x, lambda _: (x - 1.0, x - 1.0)), replace(SHARES, settled=2.0)) == 4.0
