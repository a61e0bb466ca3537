"""A seven-joint arm from its drawing to a controller with a guarantee.

    python case_studies/seven_joint_arm/run.py [--out DIR]

writes results.json, torques.png, tracking.png and README.md with its tables filled in; it takes some minutes.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from arm import FRICTION, ROTORS, SEED, follow, inside, mass_matrix, plant, setup, true_links, true_torques
from present import fill, plain, tables, torque_figure, tracking_figure

import bayesid
from bayesid.design.bounds.workspace import sobol_configurations

HERE = Path(__file__).parent
#: Robust control: gains over the joints' smallest inertias and rate [1/s], boundary layer.
GAIN, RATE, WIDTH = 20.0, 8.0, 0.05
TIME, STEP = 4.0, 0.005
#: What a motion at random has in common with the optimal one.
DURATION, SAMPLES = 20.0, 125.0


def task(robot: bayesid.Robot):
    """The motion that the controller has to follow: from rest, all joints at once."""
    reach = 0.25 * (robot.upper - robot.lower) * np.array([1.0, -0.6, 0.8, 0.9, -1.0, 0.7, 1.0])
    start = 0.1 * (robot.upper - robot.lower) * np.array([1.0, 1.0, -1.0, 1.0, 1.0, -1.0, 1.0])

    def desired(t: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Position, velocity, acceleration: there and back, with no jump of acceleration."""
        w = 2.0 * np.pi / TIME
        s = (0.5 * (1.0 - np.cos(w * t))) ** 2
        rate = 0.5 * w * np.sin(w * t) * (1.0 - np.cos(w * t))
        bend = 0.5 * w**2 * (np.cos(w * t) - np.cos(2.0 * w * t))
        return start + reach * s, reach * rate, reach * bend

    return desired


def planned(robot: bayesid.Robot) -> bayesid.Trajectory:
    """The task as a motion."""
    desired, times = task(robot), np.arange(0.0, TIME, 0.01)
    q, v, a = (np.array(x) for x in zip(*(desired(t) for t in times), strict=True))
    return bayesid.Trajectory("task", "validation", times, q, v, a)


def plan(known: bayesid.Experiment) -> tuple[dict[str, Any], bayesid.Trajectory]:
    """What each sensor set would determine, and the motion that determines it best."""
    random = bayesid.fourier_trajectory(known.robot, duration=DURATION, rate=SAMPLES, seed=SEED)
    before = bayesid.identifiability(known, random)
    # So much time that the search ends by itself, on a busy machine too: the motion, and all that follows, are always the same.
    found = bayesid.excite(known, channel="both", duration=DURATION, rate=SAMPLES, starts=1, randoms=20, seconds=600.0, seed=SEED)
    after = bayesid.identifiability(known, found.trajectory)

    def deviations(report) -> list[float]:
        return [b.std for b in report["both"].base_parameters]

    ratio = np.array(deviations(before)) / np.array(deviations(after))
    sets = [
        {"readings": r.sensor_set.title, "rank": r.rank, "better_than_size": r.well_known, "condition_number": r.condition_number}
        for r in after.sensor_sets
    ]
    return {
        "sensor_sets": sets, "within_limits": found.within_limits, "gain_over_random": found.gain,
        "median_std_ratio": float(np.median(ratio)), "seconds": dict(found.seconds),
    }, found.trajectory  # fmt: skip


def errors(result: bayesid.Identification, truth: np.ndarray) -> dict[str, Any]:
    """How far the estimate is from the truth, in its own standard deviations."""
    z = (result.values - result.base.matrix @ truth.ravel()) / result.std
    effects = {e["name"] + "@" + e["where"]: next(iter(e["parameters"].values())) for e in result.effects()}
    true = inside()
    inner = [(effects[key]["value"] - next(iter(values.values()))) / effects[key]["std"] for key, values in true.items()]
    (judge,) = result.validation
    return {
        "base_parameters": len(z), "rms_z": float(np.sqrt(np.mean(z**2))), "within_95": float(np.mean(np.abs(z) < 1.96)),
        "drives": len(inner), "drives_within_95": float(np.mean(np.abs(inner) < 1.96)),
        "validation_whitened": float(judge.whitened_rms), "validation_expected": float(judge.expected_rms),
    }  # fmt: skip


def susceptibility(result: bayesid.Identification) -> list[dict[str, Any]]:
    """What effects that the model may lack would do, each at the place where it does most, the worst first."""
    worst: dict[str, dict[str, Any]] = {}
    for s in bayesid.accuracy(result, runs=0, seed=SEED).susceptibility:
        entry = {"effect": s.effect.name, "where": s.effect.where, "largest_sigmas": s.largest, "prediction": s.prediction}
        worst.setdefault(s.effect.name, entry)
    return list(worst.values())[:8]


def control(
    bounds: bayesid.ControllerBounds, known: bayesid.Experiment, truth: np.ndarray
) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Four controllers on the true arm, and what was promised of them."""
    robot, model, desired = known.robot, plant(known.robot, truth), task(known.robot)
    gains = GAIN * bounds.workspace.inertia[:, 0]
    drawing = bounds.torque_model.base.matrix @ robot.nominal.ravel()
    drawing = np.concatenate([drawing, np.zeros(len(bounds.values) - len(drawing))])

    def columns(q, v, vr, ar):
        constant, matrix = bounds.control_columns(q, v, vr, ar)
        return constant[0], matrix[0]

    def computed_torque(values: np.ndarray):
        def command(q, v, qd, vd, ad):
            constant, matrix = columns(q, v, v, ad - 2.0 * RATE * (v - vd) - RATE**2 * (q - qd))
            return constant + matrix @ values

        return command

    def robust(shape: str):
        def command(q, v, qd, vd, ad):
            vr, ar = vd - RATE * (q - qd), ad - RATE * (v - vd)
            constant, matrix = columns(q, v, vr, ar)
            change = bounds.robust_term(matrix.T @ (v - vr), WIDTH, shape)
            return constant + matrix @ (bounds.values + change) - gains * (v - vr)

        return command

    controllers = {
        "computed torque, drawing": computed_torque(drawing), "computed torque, identified": computed_torque(bounds.values),
        "robust, ellipsoid": robust("ellipsoid"), "robust, ball": robust("ball"),
    }  # fmt: skip
    results, curves = {}, {}
    for name, command in controllers.items():
        times, error, torque = follow(model, command, desired, TIME, STEP)
        bound = None
        if name.startswith("robust"):
            bound = bounds.tracking_bound(gains, RATE, WIDTH, name.partition(", ")[2])[1]
        results[name] = {
            "largest_error": float(np.abs(error).max()), "rms_error": float(np.sqrt(np.mean(error**2))),
            "largest_torque": float(np.abs(torque).max()), "bound": None if bound is None else bound.tolist(),
            "kept": None if bound is None else bool(np.all(np.abs(error) <= bound)),
            "largest_share_of_bound": None if bound is None else float((np.abs(error) / bound).max()),
        }  # fmt: skip
        curves[name] = error
    curves["times"] = times
    return results, curves


def workspace(bounds: bayesid.ControllerBounds, known: bayesid.Experiment, truth: np.ndarray) -> dict[str, Any]:
    """What was promised of the mass matrix, and what is true."""
    w, model = bounds.workspace, plant(known.robot, truth)
    data, found = model.createData(), []
    inner = bounds.torque_model.drive_inertia()[1] @ bounds.values[bounds.torque_model.base.rank :]
    for q in sobol_configurations(known.robot, 200, SEED)[0]:
        still = np.zeros((known.robot.n, known.robot.n))
        unit = bounds.torque_model.rigid(np.tile(q, (7, 1)), still, np.eye(7), gravity=False)
        hat = (unit @ bounds.values[: bounds.torque_model.base.rank]).T + inner
        found.append(np.linalg.eigvals(np.linalg.solve(mass_matrix(model, data, q), hat)).real)
    return {
        "alpha": w.alpha, "ratio": list(w.ratio), "true_ratio": [float(np.min(found)), float(np.max(found))],
        "true_alpha": float(np.abs(np.array(found) - 1.0).max()), "smallest_eigenvalue_of_draws": w.smallest_drawn,
        "gravity_error": w.gravity_error.tolist(),
    }  # fmt: skip


def study(folder: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """All steps; results, and what figures need."""
    known = setup(folder)
    truth = true_links(known.robot)
    print("plan", flush=True)
    planning, motion = plan(known)
    other = bayesid.fourier_trajectory(known.robot, "validation", "validation", duration=15.0, rate=SAMPLES, seed=SEED + 1)
    recorded = bayesid.simulate(known, [motion, other], effects=inside(), links=truth, seed=SEED)
    print("estimate and posterior", flush=True)
    identified = bayesid.identify(recorded, channel="both")
    posterior = bayesid.sample(recorded, draws=1000, channel="both", seed=SEED)
    move = planned(known.robot)
    print("bounds", flush=True)
    bounds = bayesid.bounds(posterior, trajectory=move, seed=SEED)
    exact = np.concatenate([bounds.torque_model.base.matrix @ truth.ravel(), *_drives(bounds)])
    band = bounds.trajectories[0].torque
    true = true_torques(plant(known.robot, truth), move.positions, move.velocities, move.accelerations)
    rounding = 1e-9 * np.abs(true).max()  # joint 1 is vertical: at rest its torque is known to be zero, and its band has no width
    print("control", flush=True)
    controllers, curves = control(bounds, known, truth)
    print("accuracy", flush=True)
    results = {
        "seed": SEED, "plan": planning, "estimate": errors(identified, truth), "susceptibility": susceptibility(identified),
        "posterior": {"draws": 1000, "largest_r_hat": float(posterior.diagnosis.r_hat.max())},
        "bounds": {
            "parameters": len(bounds.values), "rho": bounds.rho, "rho_V": bounds.ellipsoid, "effort_ratio": bounds.effort_ratio,
            "distance": bounds.region.distance(exact), "in_box": bounds.region.in_box(exact),
            "norm": float(np.linalg.norm(exact - bounds.values)), "prior_driven": int(bounds.region.prior_driven.sum()),
            "band_holds": bool(np.all((true >= band.low - rounding) & (true <= band.high + rounding))),
            "band_factor": band.factor, "half_band": (band.factor * band.std).max(axis=0).tolist(),
            "largest_torque": np.abs(true).max(axis=0).tolist(), "extrapolation": band.extrapolation.tolist(),
            "warnings": list(bounds.warnings),
        },
        "workspace": workspace(bounds, known, truth), "control": controllers,
    }  # fmt: skip
    return results, {"band": band, "true": true, "curves": curves}


def _drives(bounds: bayesid.ControllerBounds) -> list[np.ndarray]:
    """True values of what was identified inside the joints, in the order of the parameters."""
    values = {"viscous_friction": FRICTION, "rotor_inertia": ROTORS}
    return [np.array([values[drive.effect.name][drive.effect.joint or 0]]) for drive in bounds.torque_model.drives]


def main() -> None:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=HERE)
    out = parser.parse_args().out
    with tempfile.TemporaryDirectory() as folder:
        results, shown = study(Path(folder))
    results = plain(results, 5)
    out.mkdir(parents=True, exist_ok=True)
    (out / "results.json").write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")
    torque_figure(shown["band"], shown["true"], out / "torques.png")
    tracking_figure(shown["curves"], results["control"], out / "tracking.png")
    page = (HERE / "README.md").read_text(encoding="utf-8")
    (out / "README.md").write_text(fill(page, tables(results)), encoding="utf-8")


if __name__ == "__main__":
    main()
