"""Recordings with known truth for the study of coverage: how they are made, fitted and bounded.

What is simulated, and why so:

* Motion: for each robot one Fourier series of 0.1 Hz and five harmonics, scaled to 0.9 of the joints' limits or
  2 rad/s, whichever comes first; 20 s, 125 Hz.
* Encoder: counts of 2e-5 rad, rounded. The same motion would be rounded in the same way every time, so each recording
  starts a random part of a sample later, and runs a random part of a count beside the last one: rounding is fresh.
* Sensor: 0.5 N and 0.1 N m of white noise and a constant offset, both new in each recording. The two-joint PUMA has
  a static run of the same positions with noise of its own.
* Truth: the nominal bodies, each deformed once by about a tenth of its size, so that they stay possible bodies.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np

from bayesid import estimators
from bayesid.dynamics.base_parameters import BaseParameters, structural_base
from bayesid.dynamics.channels import Channels
from bayesid.dynamics.regressors import Kernel
from bayesid.recordings.experiment import Experiment, Motion, Sensor, Table
from bayesid.regression.options import FitOptions
from bayesid.regression.problem import Problem, prepare
from bayesid.regression.readings import make_channels
from bayesid.robot import inertia
from bayesid.robot.robot import Robot, load_robot
from bayesid.signals.filters import LowPass, low_pass
from bayesid.workflows.demo import PAPER_LOCKED, puma_two_joint_urdf
from tests.robots import ur5

RATE, DURATION = 125.0, 20.0  # [Hz], [s]
FUNDAMENTAL, HARMONICS = 0.1, 5  # [Hz]
RESOLUTION = 2e-5  # [rad]
NOISE = np.array([0.5] * 3 + [0.1] * 3)  # [N], [N m]
OFFSET = np.array([10.0] * 3 + [2.0] * 3)  # sizes of the constant offsets
FASTEST = 2.0  # [rad/s]
PAPER = LowPass(1.0, 50.0)

#: Fits of every recording: name -> filters, method. The first is what `bayesid.identify` does by itself.
FITS: dict[str, tuple[LowPass | None, str]] = {
    "default": (None, estimators.DEFAULT_METHOD),
    "gls": (None, "gls"),
    "l = 1, d = 50, default": (PAPER, estimators.DEFAULT_METHOD),
    "l = 1, d = 50, ols": (PAPER, "ols"),
    "l = 1, d = 50, gls": (PAPER, "gls"),
}
#: The same with intervals that take full-rate rows for independent.
WHITE: dict[str, LowPass | None] = {"default, white noise": None, "l = 1, d = 50, white noise": PAPER}


@dataclass(frozen=True)
class Arm:
    """A robot of the study; ``seed`` draws its motion and its true parameters."""

    name: str
    urdf: Callable[[], str]
    joints: tuple[str, ...] | None
    locked: dict[str, float]
    static: bool
    seed: int


ARMS = {
    arm.name: arm
    for arm in (
        Arm("puma", puma_two_joint_urdf, ("joint1", "joint2"), PAPER_LOCKED, True, 1998),
        Arm("ur5", ur5, None, {}, False, 2005),
    )
}


@dataclass(frozen=True)
class Setup:
    """What does not change from recording to recording."""

    arm: Arm
    robot: Robot
    truth: np.ndarray  # ten parameters a body, in a row
    centre: np.ndarray  # (n,) [rad]
    waves: np.ndarray  # (2, harmonics, n): sines, cosines [rad]

    def trajectory(self, times: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Positions, velocities, accelerations (N, n)."""
        rate = 2 * np.pi * FUNDAMENTAL * np.arange(1, HARMONICS + 1)
        sine, cosine = np.sin(np.outer(times, rate)), np.cos(np.outer(times, rate))
        a, b = self.waves
        q = self.centre + sine @ a + cosine @ b
        return q, (cosine * rate) @ a - (sine * rate) @ b, -(sine * rate**2) @ a - (cosine * rate**2) @ b


def links_unlike(robot: Robot, rng: np.random.Generator) -> np.ndarray:
    """Links that could exist (10 n,): the URDF's, stretched and sheared by a tenth, and displaced by 0.1 m, a wrist's length."""
    truth = []
    for body in robot.nominal:
        deform = np.eye(4) + 0.1 * rng.normal(size=(4, 4))
        deform[3, :3] = 0.0
        pseudo = deform @ inertia.pseudo_inertia(body) @ deform.T
        truth.append(np.linalg.lstsq(inertia.BASIS.reshape(10, 16).T, pseudo.ravel(), rcond=None)[0])
    return np.concatenate(truth)


@cache
def setup(name: str) -> Setup:
    """Robot, truth and motion of an arm."""
    arm = ARMS[name]
    rng = np.random.default_rng(arm.seed)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "robot.urdf"
        path.write_text(arm.urdf(), encoding="utf-8")
        robot = load_robot(path, arm.joints, arm.locked)
    truth = links_unlike(robot, rng)
    waves = rng.normal(size=(2, HARMONICS, robot.n))
    at_one = Setup(arm, robot, truth, np.zeros(robot.n), waves)
    q, v, _ = at_one.trajectory(np.arange(0.0, 1.0 / FUNDAMENTAL, 1.0 / RATE))
    bounded = np.isfinite(robot.lower) & np.isfinite(robot.upper)
    lower, upper = np.where(bounded, robot.lower, -np.pi), np.where(bounded, robot.upper, np.pi)
    speed = np.minimum(0.9 * robot.velocity_limit, FASTEST)
    scale = np.minimum(speed / np.abs(v).max(axis=0), 0.9 * (upper - lower) / np.ptp(q, axis=0))
    centre = 0.5 * (lower + upper) - 0.5 * scale * (q.max(axis=0) + q.min(axis=0))
    return replace(at_one, centre=centre, waves=scale * waves)


def record(case: Setup, rng: np.random.Generator) -> Experiment:
    """One simulated experiment."""
    times = np.arange(round(RATE * DURATION)) / RATE
    q, v, a = case.trajectory(times + rng.uniform(0.0, 1.0 / RATE))
    q = q + RESOLUTION * rng.uniform(-0.5, 0.5, case.robot.n)
    bare = Experiment(case.arm.name, case.robot, (), Sensor(), position_resolution=RESOLUTION)
    channels = _channels(case)
    constant = channels.static_wrench + OFFSET * rng.uniform(-1.0, 1.0, 6)

    def reading(v, a):
        exact = Kernel.of(case.robot, channels).dynamics(q, v, a) @ case.truth
        return exact + constant + NOISE * rng.normal(size=exact.shape)

    counts = RESOLUTION * np.round(q / RESOLUTION)
    table = Table(times, counts, wrench=reading(v, a))
    still = Table(times, counts, wrench=reading(0 * v, 0 * a)) if case.arm.static else None
    return replace(bare, motions=(Motion("fourier", "identification", table, static=still),))


def white_noise_fit(problem: Problem) -> tuple[np.ndarray, np.ndarray]:
    """Channel-weighted least squares on every sample's row, ``s^2 (X'X)^-1`` for covariance.

    Right for white noise; what it says of rows that went through a slow filter is the negative control.

    Returns
    -------
    values, std
        Of the base parameters (r,).
    """
    row_model, rank = problem.row_model, problem.row_model.base.rank
    (recording,) = problem.segments[problem.fitted[0]]
    first = int(np.searchsorted(recording.times, recording.times[0] + row_model.margin))
    rows = row_model.samples(recording, first, len(recording.times) - first)
    if row_model.filters is not None:
        times = recording.times[first : len(recording.times) - first]
        rows = low_pass(row_model.filters, times, -rows.reshape(len(times), -1))[0].reshape(rows.shape)
    scale = np.ones(rows.shape[1])
    for _ in range(2):
        flat = (rows / scale[:, None]).reshape(-1, rows.shape[2])
        factor = np.linalg.qr(flat, mode="r")
        inverse = np.linalg.inv(factor[:-1, :-1])
        values = inverse @ factor[:-1, -1]
        scale = np.std(rows[:, :, -1] - rows[:, :, :-1] @ values, axis=0)
    variance = factor[-1, -1] ** 2 / (len(flat) - len(values))
    std = np.sqrt(variance * np.sum(inverse**2, axis=1))
    return values[:rank], std[:rank]


@dataclass(frozen=True)
class Bound:
    """Cramér-Rao bounds of the base parameters (r,), standard deviations.

    Attributes
    ----------
    sensor
        The true trajectory is known and all samples count: sensor noise only.
    encoder
        Sensor noise and encoder noise mapped to the wrench.
    both_runs
        As ``sensor``, with the moving and the static readings fitted together instead of subtracted.
    """

    sensor: np.ndarray
    encoder: np.ndarray
    both_runs: np.ndarray


def base(name: str) -> BaseParameters:
    """Base parameters of an arm's readings: of the motion wrench where there is a static run."""
    case = setup(name)
    free = not case.arm.static
    return structural_base(case.robot, _channels(case), gravity=free, offset=free)


def _channels(case: Setup) -> Channels:
    return make_channels(Experiment(case.arm.name, case.robot, (), Sensor()), "wrench")


def bound(name: str) -> Bound:
    """Bounds for an arm's motion.

    Readings are ``w = Y(q, v, a) b + offset + e``; with a static run the motion wrench, without gravity and
    offset and with the noise of two readings. For the encoder the trajectory is unknown within the family it was
    drawn from, mean and five harmonics a joint, ``q = F c``. White encoder noise of variance s^2 = count^2 / 12
    leaves c a covariance ``C = s^2 (F'F)^-1``, and what the wrench inherits, ``J C J'`` with
    ``J = w_q F + w_v F' + w_a F''``, is added to the sensor's. That is the bound of readings and counts together; no
    wider family of trajectories can have a lower one.
    """
    case = setup(name)
    times = np.arange(round(RATE * DURATION)) / RATE
    trajectory = case.trajectory(times)
    channels, own = _channels(case), base(name)
    moving = not case.arm.static
    constant = np.broadcast_to(np.eye(6), (len(times), 6, 6))

    def rows(state, columns, gravity, offset):
        matrix = Kernel.of(case.robot, channels, columns.independent).dynamics(*state, gravity=gravity)
        return (np.concatenate([matrix, constant], axis=2) if offset else matrix) / NOISE[:, None]

    def std(information, combine):
        return np.sqrt(np.diag(combine @ np.linalg.inv(information)[: combine.shape[1], : combine.shape[1]] @ combine.T))

    readings = 1.0 if moving else 2.0
    x = rows(trajectory, own, moving, moving).reshape(6 * len(times), -1) / np.sqrt(readings)
    information = x.T @ x

    def wrench(state):
        return Kernel.of(case.robot, channels).dynamics(*state, gravity=moving) @ case.truth / NOISE / np.sqrt(readings)

    rate = 2 * np.pi * FUNDAMENTAL * np.arange(1, HARMONICS + 1)
    sine, cosine = np.sin(np.outer(times, rate)), np.cos(np.outer(times, rate))
    nothing = np.zeros((len(times), 1))
    family = (
        np.hstack([nothing + 1.0, sine, cosine]),
        np.hstack([nothing, cosine * rate, -sine * rate]),
        np.hstack([nothing, -sine * rate**2, -cosine * rate**2]),
    )
    jacobian = []
    for joint in range(case.robot.n):
        total = np.zeros((len(times), 6, 2 * HARMONICS + 1))
        for order, basis in enumerate(family):
            step = np.zeros(case.robot.n)
            step[joint] = 1e-5
            up, down = ([s + sign * step * (k == order) for k, s in enumerate(trajectory)] for sign in (1, -1))
            total += ((wrench(up) - wrench(down)) / 2e-5)[:, :, None] * basis[:, None, :]
        jacobian.append(total)
    j = np.concatenate(jacobian, axis=2).reshape(6 * len(times), -1)
    counts = np.kron(np.eye(case.robot.n), family[0].T @ family[0]) / (RESOLUTION**2 / 12)
    # (x' (1 + j C j')^-1 x) by the matrix inversion lemma.
    with_encoder = information - x.T @ j @ np.linalg.solve(counts + j.T @ j, j.T @ x)
    combine = np.eye(own.rank)
    both = std(information, combine)
    if not moving:
        full = structural_base(case.robot, channels, gravity=True, offset=True)
        still = (trajectory[0], *np.zeros((2, *trajectory[0].shape)))
        runs = np.concatenate([rows(s, full, True, True) for s in (trajectory, still)]).reshape(12 * len(times), -1)
        both = std(runs.T @ runs, own.matrix @ np.linalg.pinv(full.matrix))
    return Bound(std(information, combine), std(with_encoder, combine), both)


def fit_all(case: Setup, seed: np.random.SeedSequence) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Simulate one recording and fit it in every way.

    Returns
    -------
    error, std
        Of the base parameters, (fits, r), in the order of `FITS` and then `WHITE`.
    joint
        For each of `FITS` the squared error of all base parameters together in units of its covariance, and
        whether the noise was taken from an efficient fit, (fits, 2).
    """
    experiment = record(case, np.random.default_rng(seed))
    problems = {f: prepare(experiment, FitOptions(low_pass=f)) for f in (None, PAPER)}
    truth = problems[None].row_model.base.matrix @ case.truth
    errors, stds, joint = [], [], []
    for filters, method in FITS.values():
        estimate = estimators.fit(problems[filters].regression, method)
        error = estimate.values - truth
        assert estimate.covariance is not None
        errors.append(error)
        stds.append(estimate.std)
        joint.append([error @ np.linalg.solve(estimate.covariance, error), estimate.details.model_complete])
    for filters in WHITE.values():
        values, std = white_noise_fit(problems[filters])
        errors.append(values - truth)
        stds.append(std)
    return np.array(errors), np.array(stds), np.array(joint, float)
