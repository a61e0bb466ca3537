"""Make the table of the speed benchmarks: a six-joint robot on a periodic Fourier motion, in one ``.npz``.

``python tests/benchmarks/make_table.py table.npz --samples 100000 --urdf robot.urdf`` writes ``t`` (N,) [s],
``q`` (N, n) [rad], ``w`` (N, 6), the wrench [N, N m] that the ground applies to the root link, in its frame,
and ``tau`` (N, n) [N m]. One period of 10 s is 1250 samples at 125 Hz, so the dynamics of any number of
samples are one period of Pinocchio's ``rnea``, repeated; the noise is fresh everywhere.
"""

# Pinocchio's names come from its compiled module.
import argparse
from pathlib import Path

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

Floats = NDArray[np.float64]
BASE_FREQUENCY = 0.1
HARMONICS = 5
SAMPLE_RATE = 125.0
RESOLUTION = 2e-5
FORCE_STD, TORQUE_STD = 0.5, 0.1
# Half-width of the motion [rad], and its largest share of the velocity limits.
SWING, VELOCITY_SHARE = 1.5, 0.6


def one_period(model: pin.Model, rng: np.random.Generator) -> tuple[Floats, Floats, Floats]:
    """Return positions, velocities and accelerations of one period, each of shape (1250, n).

    Parameters
    ----------
    model : pinocchio.Model
        The robot with a fixed base.
    rng : numpy.random.Generator
        Draws the coefficients.
    """
    times = np.arange(round(SAMPLE_RATE / BASE_FREQUENCY)) / SAMPLE_RATE
    rates = 2 * np.pi * BASE_FREQUENCY * np.arange(1, HARMONICS + 1)
    sine, cosine = rng.standard_normal((2, HARMONICS, model.nv)) / np.arange(1, HARMONICS + 1)[:, None]
    phase = np.outer(times, rates)
    s, c = np.sin(phase), np.cos(phase)
    q = s @ sine + c @ cosine
    v = (c * rates) @ sine - (s * rates) @ cosine
    a = -(s * rates**2) @ sine - (c * rates**2) @ cosine
    centre = (q.max(axis=0) + q.min(axis=0)) / 2
    scale = np.minimum(SWING / np.ptp(q, axis=0) * 2, VELOCITY_SHARE * model.velocityLimit / np.abs(v).max(axis=0))
    return (q - centre) * scale, v * scale, a * scale


def make_table(urdf: Path, samples: int, seed: int = 0) -> dict[str, Floats]:
    """Simulate the table.

    Parameters
    ----------
    urdf : Path
        A fixed-base robot of revolute joints with velocity limits.
    samples : int
        Number of samples N.
    seed : int
        Of the motion and of the noise.

    Returns
    -------
    dict of ndarray
        ``t``, ``q``, ``w`` and ``tau``.
    """
    rng = np.random.default_rng(seed)
    q, effort = clean_period(urdf, rng)
    repeats = -(-samples // len(q))
    clean = np.tile(effort, (repeats, 1))[:samples]
    std = np.full(effort.shape[1], TORQUE_STD)
    std[:3] = FORCE_STD
    clean += rng.standard_normal(clean.shape) * std
    return {
        "t": np.arange(samples) / SAMPLE_RATE,
        "q": np.tile(q, (repeats, 1))[:samples],
        "w": clean[:, :6].copy(),
        "tau": clean[:, 6:].copy(),
    }


def clean_period(urdf: Path, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Simulate one period without noise.

    Parameters
    ----------
    urdf : Path
        As for `make_table`.
    rng : numpy.random.Generator
        Draws the coefficients.

    Returns
    -------
    tuple of ndarray
        Encoder counts (1250, n) [rad]; the wrench and the joint torques (1250, 6 + n).
    """
    fixed = pin.buildModelFromUrdf(str(urdf))
    free = pin.buildModelFromUrdf(str(urdf), pin.JointModelFreeFlyer())
    data = free.createData()
    q, v, a = one_period(fixed, rng)
    pose, still = pin.neutral(free)[:7], np.zeros(6)
    # With a root that stands still, the first six efforts are the base wrench, the others the joint torques.
    effort = np.array(
        [
            pin.rnea(
                free,
                data,
                np.concatenate([pose, q_now]),
                np.concatenate([still, v_now]),
                np.concatenate([still, a_now]),
            ).copy()
            for q_now, v_now, a_now in zip(q, v, a, strict=True)
        ]
    )
    return np.round(q / RESOLUTION) * RESOLUTION, effort


def main() -> None:
    """Read the command line and write the table."""
    parser = argparse.ArgumentParser(description="Make the table of the speed benchmarks.")
    parser.add_argument("output", type=Path, help=".npz to write")
    parser.add_argument("--urdf", type=Path, required=True)
    parser.add_argument("--samples", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    table = make_table(options.urdf, options.samples, options.seed)
    np.savez(options.output, **table)


if __name__ == "__main__":
    main()
