"""Robust fits do not run away, and say so when they cannot be right."""

from dataclasses import replace

import numpy as np
import pytest

import bayesid
from bayesid.estimators.robust.divergence import Directions, ResidualSizes, reasons
from bayesid.regression.options import FitOptions
from bayesid.regression.problem import prepare
from bayesid.regression.regression import Regression
from tests.simulated import Motion, Sensor, experiment, fourier, puma2, recording


def late_joint(folder, error):
    """The second joint moves in the last third alone, where something that is not in the model acts."""
    robot, sensor = puma2(folder), Sensor()
    times, q, v, a = fourier(robot, 1)
    u = np.clip((times - 13.0) / 2.0, 0.0, 1.0)
    gate, rate, change = u**3 * (10 - 15 * u + 6 * u**2), 15 * u**2 * (1 - u) ** 2, 15 * u * (1 - u) * (1 - 2 * u)
    moved = [x.copy() for x in (q, v, a)]
    moved[0][:, 1] = gate * q[:, 1]
    moved[1][:, 1] = rate * q[:, 1] + gate * v[:, 1]
    moved[2][:, 1] = change * q[:, 1] + 2 * rate * v[:, 1] + gate * a[:, 1]
    table = recording(robot, sensor, (times, *moved), seed=1, force_std=0.5, torque_std=0.05, resolution=2e-5)
    missing = error * np.abs(moved[1][:, 1:]) * np.sin(3.0 * moved[0][:, 1:]) * [1.0, -1.0, 0.5, 0.2, 0.1, -0.2]
    return experiment(robot, [Motion("a", "identification", replace(table, wrench=table.wrench + missing))], sensor)


@pytest.mark.parametrize("method", ["huber", "student"])
def test_rows_that_alone_show_a_parameter_are_not_rejected(tmp_path, method):
    regression = prepare(late_joint(tmp_path, 20.0)).regression
    plain, robust = (bayesid.fit(regression, m) for m in ("wls", method))

    def error(estimate):
        power = sum(np.sum((b.target - b.matrix @ estimate.solution) ** 2) for b in regression.rows.blocks())
        return np.sqrt(power)

    assert error(robust) < 1.5 * error(plain)
    assert not robust.details.diverged and robust.details.rejected_share < 0.2
    assert any("the only ones that show" in w for w in robust.details.warnings)


def test_rank_is_that_of_all_rows_and_lost_information_has_a_direction():
    rng = np.random.default_rng(0)
    rows = rng.normal(size=(100, 3)) @ np.diag([1.0, 1e-4, 1e3])
    rows[:, 2] = 0.0
    directions = Directions.of(np.linalg.qr(rows, mode="r"))
    assert directions.basis.shape == (3, 2)
    weights = np.where(np.arange(100) < 50, 1.0, 0.0)
    rows[:50, 1] *= 1e-3  # what has weight hardly shows the second

    class Weighted:
        matrix = np.linalg.qr(rows * weights[:, None], mode="r")

    share, direction = directions.least(Weighted())
    assert share < 1e-5 and np.argmax(np.abs(direction) * [1.0, 1e-4, 1e3]) == 1


def test_each_sign_of_divergence_is_named():
    rng = np.random.default_rng(0)
    regression = Regression.from_arrays(rng.normal(size=(50, 2, 3)), rng.normal(size=(50, 2)), parameter_names=["a", "b", "c"])
    fine, values, direction = ResidualSizes(1.0, 0.1), np.ones(3), np.array([0.0, 1.0, 0.0])
    assert reasons(regression, 0.5, direction, 1.0, fine, fine, values, values) == ()
    (lost,) = reasons(regression, 1e-6, direction, 1.0, fine, fine, values, values)
    assert lost.endswith("information on b")
    (large,) = reasons(regression, 0.5, direction, 1.0, ResidualSizes(1.0, 800.0), fine, values, values)
    assert "8e+04 % of the signal" in large
    assert len(reasons(regression, 0.5, direction, 1e-6, ResidualSizes(9.0, 0.1), fine, values, values)) == 2
    known = replace(regression, knowledge=replace(regression.knowledge, nominal_links=np.ones(3)))
    known.__dict__["nominal_scale"] = np.ones(3)
    (far,) = reasons(known, 0.5, direction, 1.0, fine, fine, np.array([1.0, -274_727.0, 1.0]), values)
    assert "b = -2.75e+05" in far


def contaminated(made, kind, share, seed=0):
    """The fitted motions with disturbed readings: in a contact, in bursts of noise, or one channel that reads zero."""
    rng, motions = np.random.default_rng(seed), []
    for motion in made.motions:
        if motion.role == "identification":
            table = motion.table
            key = "torques" if table.wrench is None else "wrench"
            y = np.array(getattr(table, key))
            size, length = y.std(axis=0), int(share * len(y))
            parts = [rng.integers(len(y) - length)] if kind != "bursts" else rng.integers(len(y) - length // 5, size=5)
            for start in parts:
                span = slice(start, start + length // len(parts))
                if kind == "contact":
                    y[span] += 2.0 * size * rng.normal(size=y.shape[1])
                elif kind == "bursts":
                    y[span] += 5.0 * size * rng.normal(size=y[span].shape)
                else:
                    y[span, rng.integers(y.shape[1])] = 0.0
            motion = replace(motion, table=replace(table, **{key: y}))
        motions.append(motion)
    return replace(made, motions=tuple(motions))


@pytest.mark.parametrize("name", ["tx40", "kuka-med-wrist"])
@pytest.mark.parametrize("kind", ["contact", "bursts", "dropout"])
def test_a_fifth_of_a_real_recording_may_be_disturbed(shared, name, kind):
    made = bayesid.load_experiment(shared(f"data/{name}"))
    clean = prepare(made)
    spoiled = prepare(contaminated(made, kind, 0.2), FitOptions(bandwidth=clean.smoother.bandwidth))

    def error(estimate):
        blocks = list(clean.rows.blocks(clean.fitted))
        power = sum(np.sum((b.target - b.matrix @ estimate.solution) ** 2) for b in blocks)
        return np.sqrt(power / sum(np.sum(b.target**2) for b in blocks))

    usual, plain = error(bayesid.fit(clean.regression, "wls")), error(bayesid.fit(spoiled.regression, "wls"))
    # Bursts of noise are found later than what stays; then robust fits are no worse than least squares.
    allowed = max(1.3 * usual, 1.02 * plain) if kind == "bursts" else 1.3 * usual
    for method in ("huber", "student"):
        found = bayesid.fit(spoiled.regression, method)
        assert not found.details.diverged and error(found) < allowed
