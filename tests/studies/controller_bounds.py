"""Do the bounds for controllers hold the truth, and does a robust controller keep its tracking bound?

``python -m tests.studies.controller_bounds --write`` from the repository runs every case and writes
``docs/studies/controller-bounds``; a run that was stopped goes on where it was. Seeds stand in this file.

Each robot has links of its own, a recording with sensor and encoder noise, an estimate or a posterior, its bounds, and Spong's
controller with these bounds on the true robot. Readings, true torques and the controlled robot are Pinocchio's.
"""

from __future__ import annotations

import argparse
import hashlib
import sys
import tempfile
import warnings
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from threadpoolctl import threadpool_limits

import bayesid
from bayesid import estimators
from bayesid.design.bounds.bands import band as band_of
from bayesid.design.bounds.knowledge import Known, known_from, prior_links
from bayesid.design.bounds.model import ReadingModel, torque_model
from bayesid.design.bounds.region import ellipsoid_term, norm_term, tracking_bound
from bayesid.design.bounds.remainder import remainder
from bayesid.design.bounds.workspace import Terms, Workspace, mass_eigenvalues, sobol_configurations, workspace_bounds
from bayesid.dynamics.base_parameters import structural_base
from bayesid.dynamics.channels import torque_channels
from bayesid.errors import BayesidWarning
from bayesid.posterior.model import PosteriorModel
from bayesid.posterior.run import choose_engine, run
from bayesid.recordings.experiment import Experiment, Motion, Sensor
from bayesid.recordings.table import Table
from bayesid.regression.options import FitOptions
from bayesid.regression.problem import prepare
from bayesid.robot.prior import Prior
from bayesid.robot.robot import Robot, load_robot
from bayesid.tasks import cluster, map_tasks
from bayesid.validation.noise_floor import noise_floor
from bayesid.workflows.demo import PAPER_LOCKED, puma_two_joint_urdf
from tests import robots
from tests.simulated import fourier
from tests.studies.interval_coverage import band
from tests.studies.page import STUDIES, table, write_numbers, write_page

SEED = 20_261_213
CHUNK = 40
TRUST = 0.1
RATE, DURATION = 100.0, 12.0  # [Hz], [s]
FORCE, ENCODER = 0.5, 1e-5  # noise of one sample [N], [rad]
OFFSET = np.array([10.0] * 3 + [2.0] * 3)  # sizes of the sensor's constant offsets
CONFIGURATIONS, DRAWS = 64, 200
#: Of the controller: gain over the joint's smallest inertia and rate [1/s], ||K^1/2 r|| where the robust term ends, and time [s].
GAIN, LAMBDA, REST, TIME = 15.0, 5.0, 0.06, 1.2
SHAPES = ("ellipsoid", "ball")
CHECKS = {
    "identified_ellipsoid": "identified base parameters in their ellipsoid",
    "identified_box": "identified base parameters in their box",
    "ellipsoid": "parameters of the joint torques in the ellipsoid",
    "box": "... in the box",
    "ball": "... in the ball",
    "torque": "true torques of another motion in the simultaneous band",
    "alpha": "alpha of the true mass matrix",
    "coriolis": "error of the Coriolis terms",
    "gravity": "errors of gravity, all joints at once",
}


@dataclass(frozen=True)
class Case:
    """Robots of one kind, what is recorded of them, and how bounds are made.

    Attributes
    ----------
    speed, noise
        Largest speed of each joint [rad/s], and noise of one sample of moments and torques [N m].
    step
        Of the integration under control [s].
    """

    title: str
    urdf: Any
    joints: tuple[str, ...] | None
    locked: dict[str, float]
    channel: str
    source: str
    speed: float
    noise: float
    step: float
    count: int


CASES = {
    "puma-estimate": Case(
        "PUMA, two joints, base wrench, `wls`", puma_two_joint_urdf, ("joint1", "joint2"), PAPER_LOCKED,
        "wrench", "estimate", 1.5, 0.05, 0.004, 1000,
    ),
    "ur5-estimate": Case("UR5, six joints, torques, `wls`", robots.ur5, None, {}, "torque", "estimate", 3.0, 0.01, 0.002, 200),
    "puma-posterior": Case(
        "PUMA, two joints, base wrench, posterior", puma_two_joint_urdf, ("joint1", "joint2"), PAPER_LOCKED,
        "wrench", "posterior", 1.5, 0.05, 0.004, 200,
    ),
    "ur5-posterior": Case(
        "UR5, six joints, torques, posterior", robots.ur5, None, {}, "torque", "posterior", 1.5, 0.05, 0.002, 200,
    ),
}  # fmt: skip


@dataclass(frozen=True)
class Setup:
    """What all robots of a case share: motions, Pinocchio's regressors of them, and true links drawn from the prior."""

    robot: Robot
    reference: pin.Model
    times: np.ndarray
    positions: np.ndarray
    regressor: np.ndarray
    other: tuple[np.ndarray, ...]
    other_regressor: np.ndarray
    links: np.ndarray


@cache
def setup(name: str) -> Setup:
    """The setup of a case; motions and links by its own seed."""
    case, seed = CASES[name], SEED + list(CASES).index(name)
    with tempfile.TemporaryDirectory() as folder:
        path = robots.write(Path(folder), case.urdf())
        robot = load_robot(path, case.joints, case.locked)
        model = pin.buildModelFromXML(path.read_text(encoding="utf-8"), pin.JointModelFreeFlyer())
    active = [*robot.joint_names]
    reference = pin.neutral(model)
    for joint, angle in case.locked.items():
        reference[model.joints[model.getJointId(joint)].idx_q] = angle
    still = [model.getJointId(j) for j in tuple(model.names)[2:] if j not in active]
    model = pin.buildReducedModel(model, still, reference) if still else model
    model.gravity.linear = np.array([0.0, 0.0, -9.81])
    times, *states = fourier(robot, seed, DURATION, RATE, case.speed)
    _, *other = fourier(robot, seed + 1000, 4.0, 50.0, 1.2 * case.speed)
    base = structural_base(robot, torque_channels(robot))
    links = prior_links(base, Prior.nominal(robot.nominal, TRUST), case.count, seed)
    return Setup(
        robot, model, times, states[0], regressor(model, *states), tuple(other), regressor(model, *other), links
    )  # fmt: skip


def regressor(model: pin.Model, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
    """Pinocchio's regressor of base wrench and joint torques (N, 6 + n, 10 (n + 1)), the base at rest."""
    data, still = model.createData(), np.zeros((len(q), 6))
    place = np.concatenate([still, np.ones((len(q), 1)), q], axis=1)
    return np.array([
        pin.computeJointTorqueRegressor(model, data, *state).copy()
        for state in zip(place, np.hstack([still, v]), np.hstack([still, a]), strict=True)
    ])  # fmt: skip


def record(name: str, index: int, rng: np.random.Generator) -> Experiment:
    """The recording of one robot."""
    case, s = CASES[name], setup(name)
    whole = s.regressor @ np.concatenate([s.robot.static_nominal, s.links[index]])
    q = s.positions + ENCODER * rng.normal(size=s.positions.shape)
    wrench = torques = None
    if case.channel == "wrench":
        noise = np.repeat([FORCE, case.noise], 3) * rng.normal(size=(len(q), 6))
        wrench = whole[:, :6] + OFFSET * rng.uniform(-1.0, 1.0, 6) + noise
    else:
        torques = whole[:, 6:] + case.noise * rng.normal(size=q.shape)
    table = Table(s.times, q, wrench=wrench, torques=torques)
    motions = (Motion("identification", "identification", table),)
    sensor = Sensor() if wrench is not None else None
    return Experiment(name, s.robot, motions, sensor, inertia_rel_std=TRUST, position_std=ENCODER)


def known_of(name: str, index: int, rng: np.random.Generator) -> Known:
    """What is known of one robot, by the default estimator or by the posterior."""
    problem, seed = prepare(record(name, index, rng), FitOptions()), int(rng.integers(1 << 31))
    if CASES[name].source == "estimate":
        e = estimators.fit(problem.regression, estimators.DEFAULT_METHOD)
        return known_from(
            problem, source="estimate", method=e.method, mean=e.solution, covariance=e.full_covariance,
            undetermined=e.undetermined, dispersion=e.details.dispersion or 1.0, count=DRAWS, seed=seed,
        )  # fmt: skip
    prior = Prior.nominal(problem.experiment.robot.nominal, TRUST)
    model = PosteriorModel.of(problem.regression, prior)
    drawn = run(model, choose_engine(model, "hmc"), draws=2000, seed=seed).draws
    linear = model.split(drawn)[0].reshape(-1, len(model.linear_names))
    columns = linear @ model.to_columns.T
    nothing = np.zeros(columns.shape[1], bool)
    return known_from(
        problem, source="posterior", method="nominal prior", mean=columns.mean(axis=0), covariance=np.cov(columns.T),
        undetermined=nothing, draws=columns, link_draws=linear[:, : model.link_count],
        prior_draws=model.prior_draws(500, rng), rel_std=TRUST, count=2000, seed=seed,
    )  # fmt: skip


@dataclass(frozen=True)
class Bounded:
    """Bounds of one robot."""

    model: ReadingModel
    workspace: Workspace


def one(name: str, index: int) -> tuple[Bounded, dict[str, float]]:
    """Bounds of one robot, and which of them hold."""
    s = setup(name)
    rng = np.random.default_rng(np.random.SeedSequence(SEED, spawn_key=(list(CASES).index(name), index)))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", BayesidWarning)
        known = known_of(name, index, rng)
    model, parameters, truth = torque_model(known), known.parameters(), s.links[index]
    workspace = workspace_bounds(model, draws=DRAWS, configurations=CONFIGURATIONS)
    region, b = model.region, model.base.matrix @ truth
    true = s.other_regressor[:, 6:] @ np.concatenate([s.robot.static_nominal, truth])
    left = remainder(known.problem, model, noise_floor(known.problem))
    torque = band_of(model, *s.other, left=left)
    identified = known.base.matrix @ truth
    inside = (true >= torque.low) & (true <= torque.high)
    pointwise = (true >= torque.pointwise_low) & (true <= torque.pointwise_high)
    terms = Terms.of(model, sobol_configurations(s.robot, CONFIGURATIONS, 0)[0])
    mass, hat = terms.mass @ b, terms.mass @ region.values
    ratio = np.array([np.linalg.eigvals(np.linalg.solve(m, h)).real for m, h in zip(mass, hat, strict=True)])
    away = region.values - b
    held = {
        "identified_ellipsoid": parameters.distance(identified) <= parameters.ellipsoid,
        "identified_box": parameters.in_box(identified),
        "ellipsoid": region.distance(b) <= region.ellipsoid,
        "box": region.in_box(b),
        "ball": float(np.linalg.norm(away)) <= region.rho,
        "torque": inside.all(),
        "alpha": float(np.abs(ratio - 1.0).max()) <= workspace.alpha,
        "coriolis": float(np.linalg.norm(terms.coriolis @ away, 2, axis=(1, 2)).max()) <= workspace.coriolis_error,
        "gravity": bool(np.all(np.abs(terms.gravity @ away).max(axis=0) <= workspace.gravity_error)),
        "positive_definite": workspace.smallest_drawn > 0.0, "pointwise": float(pointwise.mean()),
        "complete": left is None or left.complete, "normal": region.draws is None, "alpha_bound": workspace.alpha,
        "rho": region.rho,
    }  # fmt: skip
    return Bounded(model, workspace), {key: float(value) for key, value in held.items()}


def track(name: str, indices: range, cases: list[Bounded], shape: str) -> np.ndarray:
    """Largest error of the controller over its bound, of each of some robots side by side."""
    s, m = setup(name), len(cases)
    model, size = cases[0].model, s.robot.n
    values = np.array([c.model.region.values for c in cases])
    radius = np.array([c.model.region.ellipsoid if shape == "ellipsoid" else c.model.region.rho for c in cases])
    covariances = [c.model.region.covariance for c in cases]
    width = 4.0 * REST**2 / radius
    gains = GAIN * np.array([c.workspace.inertia[:, 0] for c in cases])
    bounds = []
    for c, r, w, k in zip(cases, radius, width, gains, strict=True):
        eigenvalues = mass_eigenvalues(c.model, k, DRAWS, CONFIGURATIONS, 0)
        bounds.append(tracking_bound(float(r), float(w), k, LAMBDA, eigenvalues)[1])
    plants = [plant(s.reference, s.links[i]) for i in indices]
    lower, upper = np.maximum(s.robot.lower, -np.pi), np.minimum(s.robot.upper, np.pi)
    phase = np.arange(size)
    start = 0.5 * (lower + upper)

    def desired(t: float) -> tuple[np.ndarray, ...]:
        angle = 3.0 * t
        shape = 0.4 * np.cos(phase)
        q = start + shape * (angle - np.sin(angle)) / np.pi  # from rest, with a smooth acceleration
        return q, shape * 3.0 * (1.0 - np.cos(angle)) / np.pi, shape * 9.0 * np.sin(angle) / np.pi

    def torque(t: float, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        qd, vd, ad = desired(t)
        vr, ar = vd - LAMBDA * (q - qd), ad - LAMBDA * (v - vd)
        constant, columns = model.control_columns(q, v, vr, ar)
        sliding = np.einsum("tjk,tj->tk", columns, v - vr)
        if shape == "ellipsoid":
            change = np.array([
                ellipsoid_term(x, v, r, w) for x, v, r, w in zip(sliding, covariances, radius, width, strict=True)
            ])  # fmt: skip
        else:
            change = np.array([norm_term(x, r, w) for x, r, w in zip(sliding, radius, width, strict=True)])
        return constant + np.einsum("tjk,tk->tj", columns, values + change) - gains * (v - vr)

    def rates(t: float, x: np.ndarray) -> np.ndarray:
        q, v = x[:, :size], x[:, size:]
        a = [pin.aba(p, d, *state) for (p, d), state in zip(plants, zip(q, v, torque(t, q, v), strict=True), strict=True)]
        return np.hstack([v, np.array(a)])

    x = np.tile(np.concatenate([start, np.zeros(size)]), (m, 1))
    worst, step = np.zeros((m, size)), CASES[name].step
    for k in range(round(TIME / step)):
        t = step * k
        one = rates(t, x)
        two = rates(t + 0.5 * step, x + 0.5 * step * one)
        three = rates(t + 0.5 * step, x + 0.5 * step * two)
        x = x + step / 6.0 * (one + 2.0 * two + 2.0 * three + rates(t + step, x + step * three))
        worst = np.maximum(worst, np.abs(x[:, :size] - desired(t + step)[0]))
    return np.max(worst / np.array(bounds), axis=1)


def plant(reference: pin.Model, links: np.ndarray) -> tuple[pin.Model, pin.Data]:
    """Pinocchio's model of a robot on a base that does not move."""
    free = pin.Model(reference)
    for j, body in enumerate(links.reshape(-1, 10)):
        free.inertias[j + 2] = pin.Inertia.FromDynamicParameters(body)
    model = pin.buildReducedModel(free, [1], pin.neutral(free))
    return model, model.createData()


def chunk(name: str, first: int, last: int) -> dict[str, np.ndarray]:
    """Robots ``first`` to ``last - 1`` of a case."""
    with threadpool_limits(1, user_api="blas"):
        done = [one(name, index) for index in range(first, last)]
        out = {key: np.array([held[key] for _, held in done]) for key in done[0][1]}
        for shape in SHAPES:
            out[f"tracking_{shape}"] = track(name, range(first, last), [b for b, _ in done], shape)
    return out


def sources() -> str:
    """Fingerprint of the code that the results depend on."""
    package = Path(bayesid.__file__).parent
    files = [*sorted((package / "design" / "bounds").glob("*.py")), *sorted((package / "posterior").glob("*.py")), Path(__file__)]
    digest = hashlib.sha256()
    for file in files:
        digest.update(file.read_bytes())
    return digest.hexdigest()[:12]


def run_case(name: str, count: int, processes: int) -> dict[str, np.ndarray]:
    """All robots of a case; what was done before is kept."""
    folder = Path(tempfile.gettempdir()) / f"bayesid-controller-bounds-{sources()}"
    folder.mkdir(exist_ok=True)
    spans = [(a, min(a + CHUNK, count)) for a in range(0, count, CHUNK)]
    files = [folder / f"{name}-{a}-{b}.npz" for a, b in spans]
    waiting = [(span, file) for span, file in zip(spans, files, strict=True) if not file.exists()]
    with cluster(processes):
        made = map_tasks(lambda span: chunk(name, *span), [span for span, _ in waiting])
        for (_, file), part in zip(waiting, made, strict=True):
            np.savez(file, **part)
            print(file.name, flush=True)
    parts = [dict(np.load(file)) for file in files]
    return {key: np.concatenate([part[key] for part in parts]) for key in parts[0]}


def summarise(name: str, found: dict[str, np.ndarray]) -> dict[str, Any]:
    """What the page shows of a case, ready for JSON."""
    count = len(found["rho"])
    low, high = band(count, 1)
    return {
        "title": CASES[name].title, "robots": count, "band": [low, high],
        "held": {key: float(found[key].mean()) for key in CHECKS},
        "complete": float(found["complete"].mean()), "normal_law": float(found["normal"].mean()),
        "positive_definite": float(found["positive_definite"].mean()),
        "pointwise_share": float(found["pointwise"].mean()), "median_alpha": float(np.median(found["alpha_bound"])),
        "median_rho": float(np.median(found["rho"])),
        "tracking": {
            shape: {"kept": float(np.mean(found[f"tracking_{shape}"] <= 1.0)), "largest": float(found[f"tracking_{shape}"].max()),
                    "median": float(np.median(found[f"tracking_{shape}"]))}
            for shape in SHAPES
        },
    }  # fmt: skip


PAGE = """\
# Bounds for controllers, held against the truth

Robots with links of their own, drawn from the prior that is stated (relative standard deviation {{ rel_std }} of every mass); one
recording of each, {{ duration }} s at {{ rate }} Hz with white noise of {{ force }} N and {{ noises }} N m, and {{ encoder }} rad
of encoder noise; an estimate or a posterior; its [bounds](../../howto/controller.md); and Spong's controller with these
bounds on the
true robot. Recordings, true torques and the controlled robot are Pinocchio's. `python -m tests.studies.controller_bounds --write`
made this page and [results.json](results.json) from seed {{ seed }}.

Bounds hold with probability 95 %, so about 95 % of the robots have to keep each. The share that exact bounds keep to with 99 % is
in the last line of the table; what is outside is bold. Above it bounds are wider than need be.

{{ held }}

Of an estimate, alpha and the other bounds over the workspace come from links that can exist, drawn with the stated trust of the
nominal ones as well; the sets of the parameters use the data alone where these determine all of them.

## Tracking

Passivity-based control with the robust term of the ellipsoid, or Spong's of the ball
([method](../../explanation/method.md)): gains {{ gain }} 1/s
times the joints' smallest inertias, rate {{ rate_of }} 1/s, boundary layers such that the term alone ends at
‖K^½ r‖ = {{ rest }}; from rest on the path, {{ time }} s. The bound is that of `bounds.tracking_bound`, for the joint that comes
nearest to its own. Robots whose parameters are outside of their set are counted, too.

{{ tracked }}

All mass matrices of all links that were drawn are positive definite at all configurations: {{ definite }}.
"""


def write(result: dict[str, Any], folder: Path = STUDIES / "controller-bounds") -> None:
    """Page and JSON."""
    rounded = write_numbers(result, folder / "results.json", digits=4)
    cases = list(rounded["cases"].values())

    def share(case: dict[str, Any], key: str) -> str:
        value, (low, high) = case["held"][key], case["band"]
        return f"{100 * value:.1f}" if low <= value <= high else f"**{100 * value:.1f}**"

    head = " | ".join(["held, per cent of the robots", *(c["title"] for c in cases)])
    rows = [f"| {text} | " + " | ".join(share(c, key) for c in cases) + " |" for key, text in CHECKS.items()]
    samples = " | ".join(f"{100 * c['pointwise_share']:.1f}" for c in cases)
    rows.append(f"| samples of those torques in the pointwise band | {samples} |")
    rows.append("| robots | " + " | ".join(str(c["robots"]) for c in cases) + " |")
    rows.append("| exact bounds | " + " | ".join(f"{100 * c['band'][0]:.1f} … {100 * c['band'][1]:.1f}" for c in cases) + " |")
    tracked = [
        f"| {c['title']} | {shape} | {100 * t['kept']:.1f} % | {t['largest']:.2f} | {t['median']:.2f} |"
        for c in cases for shape, t in c["tracking"].items()
    ]  # fmt: skip
    write_page(
        PAGE, folder / "README.md", held=table(head, rows), seed=SEED, rel_std=TRUST, duration=f"{DURATION:g}",
        rate=f"{RATE:g}", force=FORCE, encoder=ENCODER, gain=f"{GAIN:g}", rate_of=f"{LAMBDA:g}", rest=REST,
        time=TIME,
        tracked=table("robots | term | kept the bound | largest error over the bound | median", tracked),
        noises=" or ".join(dict.fromkeys(f"{CASES[n].noise:g}" for n in rounded["cases"])),
        definite="yes" if all(c["positive_definite"] == 1.0 for c in cases) else "no",
    )  # fmt: skip


def main(arguments: list[str]) -> None:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", default=",".join(CASES), help="which, separated by commas")
    parser.add_argument("--count", type=int, help="robots of each case; default all")
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--write", action="store_true")
    given = parser.parse_args(arguments)
    results = {}
    for name in given.cases.split(","):
        results[name] = summarise(name, run_case(name, given.count or CASES[name].count, given.processes))
        print(results[name], flush=True)
    if given.write:
        write({"seed": SEED, "cases": results})


if __name__ == "__main__":
    main(sys.argv[1:])
