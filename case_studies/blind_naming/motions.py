"""How the arms of the blind set move: reference motions from rest to rest, and what their controllers make of them."""

from __future__ import annotations

import numpy as np
from plant import Motion
from scipy.signal import cont2discrete, lfilter, lfilter_zi

MARGIN = 0.1  # rest before and after the recording, for averages and delays [s]
BANDWIDTH = 2 * np.pi * 6.0  # of the joint controllers [rad/s]
DAMPING = 0.8
TURN = 0.06  # speed within which friction turns over, for the motion that it shapes [rad/s]
CHATTER = 50.0  # acceleration that encoder counts shake loose, per count [1/s^2]

Reference = tuple[np.ndarray, np.ndarray, np.ndarray]


def fourier(t: np.ndarray, period: float, home: np.ndarray, limits: np.ndarray, rng: np.random.Generator) -> Reference:
    """One period of a Fourier motion about home that starts and ends at rest; limits (3, n) of excursion, speed, acceleration."""
    k = np.arange(1, int(0.65 * period) + 1)
    w = 2 * np.pi / period
    n = len(home)
    sine, cosine = rng.normal(size=(2, n, len(k))) / k ** rng.uniform(0.6, 1.2, size=(n, 1))
    # position, velocity and acceleration vanish at the ends
    sine -= (sine @ k)[:, None] * k / (k @ k)
    rows = np.vstack([np.ones(len(k)), k**2])
    cosine -= cosine @ rows.T @ np.linalg.solve(rows @ rows.T, rows)
    inside = np.clip(t, 0.0, period)[:, None] * (w * k)
    s, c = np.sin(inside), np.cos(inside)
    moving = ((t >= 0) & (t <= period))[:, None]
    q = s @ sine.T + c @ cosine.T
    v = ((c * k) @ sine.T - (s * k) @ cosine.T) * w * moving
    a = -((s * k**2) @ sine.T + (c * k**2) @ cosine.T) * w**2 * moving
    scale = np.min([limit / np.abs(x).max(axis=0) for limit, x in zip(limits, (q, v, a), strict=True)], axis=0)
    return home + scale * q, scale * v, scale * a


def _quintic(s: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    s = np.clip(s, 0.0, 1.0)
    return s**3 * (10 - 15 * s + 6 * s**2), 30 * s**2 * (1 - s) ** 2, 60 * s * (1 - s) * (1 - 2 * s)


def point_to_point(t: np.ndarray, length: float, home: np.ndarray, limits: np.ndarray, rng: np.random.Generator) -> Reference:
    """Quintic moves between random poses with short stops."""
    reach, speed, acceleration = limits
    pose = home + rng.uniform(-1, 1, size=len(home)) * reach
    q, v, a = np.tile(pose, (len(t), 1)), np.zeros((len(t), len(home))), np.zeros((len(t), len(home)))
    start = 0.35
    while True:
        goal = home + rng.uniform(-1, 1, size=len(home)) * reach
        away = np.abs(goal - pose)
        lasting = max((1.875 * away / speed).max(), np.sqrt(5.78 * away / acceleration).max()) * rng.uniform(1.0, 1.3)
        if start + lasting > length - 0.35:
            return q, v, a
        shape = _quintic((t - start) / lasting)
        step = goal - pose
        q += shape[0][:, None] * step
        v += shape[1][:, None] * step / lasting
        a += shape[2][:, None] * step / lasting**2
        start, pose = start + lasting + rng.uniform(0.05, 0.35), goal


def chirp(t: np.ndarray, length: float, home: np.ndarray, limits: np.ndarray, rng: np.random.Generator) -> Reference:
    """Sines of rising frequency under a window that starts and ends at rest."""
    n, ramp = len(home), 1.5
    low, high, phase = rng.uniform(0.08, 0.2, n), rng.uniform(0.5, 0.9, n), rng.uniform(0, 2 * np.pi, n)
    x = t[:, None]
    angle = phase + 2 * np.pi * (low * x + (high - low) * x**2 / (2 * length))
    rate, gain = 2 * np.pi * (low + (high - low) * x / length), 2 * np.pi * (high - low) / length
    s = np.sin(angle), rate * np.cos(angle), gain * np.cos(angle) - rate**2 * np.sin(angle)
    up, down = _quintic(x / ramp), _quintic((length - x) / ramp)
    w = (
        up[0] * down[0],
        (up[1] * down[0] - up[0] * down[1]) / ramp,
        (up[2] * down[0] + up[0] * down[2] - 2 * up[1] * down[1]) / ramp**2,
    )
    q, v, a = w[0] * s[0], w[1] * s[0] + w[0] * s[1], w[2] * s[0] + 2 * w[1] * s[1] + w[0] * s[2]
    scale = np.min([limit / np.abs(y).max(axis=0) for limit, y in zip(limits, (q, v, a), strict=True)], axis=0)
    return home + scale * q, scale * v, scale * a


def tracked(
    t: np.ndarray, reference: Reference, dry: np.ndarray, viscous: np.ndarray, resolution: float, rng: np.random.Generator
) -> Reference:
    """Motion under control: e'' + 2 zeta w e' + w^2 e = -disturbance, solved exactly for a piecewise linear disturbance.

    Parameters
    ----------
    t
        Fine grid (N,).
    reference
        Commanded motion.
    dry, viscous
        Friction over inertia of each joint (n,) [rad/s^2], [1/s].
    resolution
        One encoder count [rad].
    """
    q, v, a = reference
    push = 0.03 * a + rng.uniform(-1.0, 1.0, q.shape[1]) * np.sin(q) - viscous * v
    push -= dry * np.tanh(v / TURN)
    push += resolution * CHATTER * rng.normal(size=q.shape) * (np.abs(v) > 0.01)
    den = [1.0, 2 * DAMPING * BANDWIDTH, BANDWIDTH**2]
    error = []
    for num in ([1.0], [1.0, 0.0]):
        b, back, _ = cont2discrete((num, den), t[1] - t[0], "foh")
        b = np.atleast_2d(b)[0]
        start = lfilter_zi(b, back)[:, None] * push[0]
        error.append(lfilter(b, back, push, axis=0, zi=start)[0])
    return q + error[0], v + error[1], a + push - den[1] * error[1] - den[2] * error[0]


def grid(length: float, step: float) -> tuple[np.ndarray, int, int, int]:
    """Fine grid of a recording: times, row of t = 0, rows a sample, samples. At least 1 kHz, an even number a sample."""
    every = 2 * int(np.ceil(step * 500 - 1e-9))
    count = int(round(length / step)) + 1
    before = every * int(np.ceil(MARGIN / step))
    rows = np.arange(-before, every * (count - 1) + before + 1)
    return rows * (step / every), before, every, count


def still_motion(motion: Motion, q: np.ndarray) -> Motion:
    """Poses q (count, n) at rest, row by row."""
    sampled = motion.sampled()
    return Motion(motion.name, motion.role, sampled.t, q, 0 * q, 0 * q, 0, 1, motion.count, False, motion.home)
