"""How large a hidden effect is on a recording, what a refit would swallow, and which other effects look the same."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from arms import Arm, inverse_dynamics, pseudo_inertia, regressor
from plant import AXES, LINK, Effect, Motion, Sensor, respond
from scipy.interpolate import CubicSpline
from scipy.signal import butter, sosfiltfilt

TRIM = 0.6  # [s] left out at both ends
CUT = 10.0  # residuals are compared below [Hz]
VALUES = 16.0  # independent values a second that pass the filter
POSITION_CUT = 25.0  # positions are smoothed below [Hz]
STATIC_SHARE = 0.2  # noise of a static reading over that of a moving sample
LINK_PATTERNS = {key: np.array(k) for k, key in enumerate(LINK)}
MISMATCHED = ("payload", "inertia_error")  # sized against the prior: a free refit swallows them
ONE_MOTION = ("external_contact",)  # sized on the identification motions: it happens only there


@lru_cache
def _sections(cut: float, step: float) -> np.ndarray:
    return butter(4, min(cut, 0.4 / step), fs=1 / step, output="sos")


def filtered(values: np.ndarray, step: float, cut: float = CUT) -> np.ndarray:
    """Zero-phase Butterworth low-pass of order 4."""
    return sosfiltfilt(_sections(cut, round(step, 9)), values, axis=0, padtype="constant", padlen=min(200, len(values) - 1))


def shifted(motion: Motion, shift: np.ndarray, still: bool = False) -> Motion:
    """The motion that encoders show which read the links with a shift."""
    if not shift.any():
        return motion
    spline = CubicSpline(motion.t, shift)
    moves = 0.0 if still else 1.0
    return replace(motion, q=motion.q + shift, v=motion.v + moves * spline(motion.t, 1), a=motion.a + moves * spline(motion.t, 2))


@dataclass(frozen=True, eq=False)
class Part:
    """One motion at some 60 Hz: rigid readings and, on kept rows, the regressor (K, C, 10 n)."""

    motion: Motion
    fine: Motion
    rigid: tuple[np.ndarray, np.ndarray]
    rest: tuple[np.ndarray, np.ndarray] | None
    rows: np.ndarray
    columns: np.ndarray
    thin: int


@dataclass(frozen=True, eq=False)
class Study:
    """A case without its effect: what every effect's size is measured on."""

    arm: Arm
    sensor: Sensor
    parts: tuple[Part, ...]
    channels: tuple[str, ...]
    floor: np.ndarray
    mismatch: np.ndarray
    prior: np.ndarray | None
    gears: np.ndarray

    def readings(self, part: Part, effects: tuple[Effect, ...]) -> np.ndarray:
        """What effects change in the readings against a rigid model on the encoders' motion, filtered, kept rows (K, C)."""
        total = self._change(part.motion, effects, part.rigid, False, part)
        if part.rest is not None:
            total = total - self._change(part.motion.still(), effects, part.rest, True, part)
        return filtered(total, part.motion.t[1] - part.motion.t[0])[part.rows]

    def _change(
        self, motion: Motion, effects: tuple[Effect, ...], rigid: tuple[np.ndarray, np.ndarray], still: bool, part: Part
    ) -> np.ndarray:
        if not still and any(effect.name == "base_compliance" for effect in effects):  # its resonance needs the fine grid
            fine = respond(self.arm, self.sensor, part.fine, effects)
            every = part.fine.every * part.thin
            rows = slice(part.fine.first, part.fine.first + part.fine.count * part.fine.every, every)
            got = fine.wrench[rows], fine.torques[rows], fine.shift[rows]
        else:
            one = respond(self.arm, self.sensor, motion, effects, rigid, still)
            got = one.wrench, one.torques, one.shift
        seen = shifted(motion, got[2], still)
        base = rigid if seen is motion else inverse_dynamics(self.arm, seen.q, seen.v, seen.a)
        model = respond(self.arm, self.sensor, seen, (), base)
        return self.pick(got[0] - model.wrench, got[1] - model.torques)

    def pick(self, wrench: np.ndarray, torques: np.ndarray) -> np.ndarray:
        """The measured channels (N, c) of a wrench (N, 6) and torques (N, n)."""
        both = np.hstack([wrench, torques])
        names = [*AXES, *(f"tau{j + 1}" for j in range(self.arm.n))]
        return both[:, [names.index(channel) for channel in self.channels]]

    def part_inertia(self, joint: int) -> float:
        """Inertia about a joint in the first pose [kg m^2]."""
        unit = np.eye(self.arm.n)[joint][None]
        pose = self.parts[0].motion.q[:1]
        moved, still = (inverse_dynamics(self.arm, pose, 0 * pose, a)[1] for a in (unit, 0 * unit))
        return float((moved - still)[0, joint])

    def signals(self, effects: tuple[Effect, ...]) -> list[np.ndarray]:
        """`readings` of every motion."""
        return [self.readings(part, effects) for part in self.parts]

    def _role(self, arrays: Iterable[np.ndarray], role: str) -> np.ndarray:
        return np.concatenate([array for array, part in zip(arrays, self.parts, strict=True) if part.motion.role == role])

    def ratios(self, signals: list[np.ndarray]) -> dict[str, float | dict[str, float]]:
        """Sizes over the floor, largest channel: as it is, after a free refit, and against floor and nominal mismatch."""
        y = [part.columns / self.floor[:, None] for part in self.parts]
        z = [signal / self.floor for signal in signals]
        fit_y, fit_z = self._role(y, "identification"), self._role(z, "identification")
        flat = fit_y.reshape(-1, fit_y.shape[2])
        scale = np.linalg.norm(flat, axis=0) + 1e-12
        phi = np.linalg.lstsq(flat / scale, fit_z.ravel(), rcond=1e-9)[0] / scale
        left = [one - columns @ phi for one, columns in zip(z, y, strict=True)]
        size = {}
        for key, role, arrays in (
            ("known", "validation", z), ("known_id", "identification", z),
            ("after_refit", "validation", left), ("after_refit_id", "identification", left),
        ):  # fmt: skip
            size[key] = np.sqrt(np.mean(self._role(arrays, role) ** 2, axis=0))
        result: dict[str, float | dict[str, float]] = {key: float(value.max()) for key, value in size.items()}
        off = self.mismatch / self.floor
        result["against_prior"] = float((size["known"] / np.sqrt(1 + off**2)).max())
        result["nominal_mismatch"] = float(off.max())
        for key in ("known", "after_refit"):
            result[f"per_channel_{key}"] = {c: round(float(x), 3) for c, x in zip(self.channels, size[key], strict=True)}
        return result

    def unexplained(
        self, signals: list[np.ndarray], candidates: dict[tuple[str, str], list[list[np.ndarray]]]
    ) -> tuple[float, dict]:
        """Chi-square of a signal left by the nominal model within its trust, and left by each candidate on top.

        VALUES independent values a second and channel.
        """
        weight = [
            np.sqrt(VALUES * (part.motion.t[1] - part.motion.t[0]) * np.diff(part.rows)[0]) / self.floor for part in self.parts
        ]

        def stack(arrays):
            return np.concatenate([(a * w).ravel() for a, w in zip(arrays, weight, strict=True)])

        target = stack(signals)
        base = np.zeros((len(target), 0))
        if self.prior is not None:
            y = np.concatenate(
                [(p.columns * w[:, None]).reshape(-1, p.columns.shape[2]) for p, w in zip(self.parts, weight, strict=True)]
            )
            base = np.vstack([y, self.prior])
        extra = len(base) - len(target) if base.shape[1] else 0

        def pad(x):
            return np.concatenate([x, np.zeros(extra)])

        scale = np.linalg.norm(base, axis=0)
        basis = np.linalg.qr(base / np.where(scale, scale, 1.0))[0] if base.shape[1] else np.zeros((len(target), 0))

        def clear(x):
            return x - basis @ (basis.T @ x)

        rest = clear(pad(target))
        whole = float(rest @ rest)
        left = {}
        for key, blocks in candidates.items():
            columns = np.stack([clear(pad(stack(block))) for block in blocks], axis=1)
            size = np.linalg.norm(columns, axis=0)
            keep = size > 1e-7 * max(np.linalg.norm(target), 1e-12)
            if not keep.any():
                continue
            fit = np.linalg.lstsq(columns[:, keep] / size[keep], rest, rcond=1e-6)[0]
            left[key] = float(np.sum((rest - columns[:, keep] / size[keep] @ fit) ** 2))
        return whole, left


def study(
    arm: Arm, sensor: Sensor, motions: list[Motion], channels: tuple[str, ...], noise: np.ndarray, resolution: float,
    nominal: np.ndarray, rel_std: float, static: bool, gears: np.ndarray, rng: np.random.Generator,
) -> Study:  # fmt: skip
    """Prepare a case: floors from sensor noise and encoder counts, the nominal's mismatch, the regressors.

    Parameters
    ----------
    noise
        Noise of one sample per channel (C,).
    nominal
        Nominal link parameters (n, 10).
    gears
        Gear ratios (n,).
    """
    parts, spare = [], Study(arm, sensor, (), channels, noise, noise, None, np.zeros(arm.n))
    for fine in motions:
        thin = max(1, int(0.0165 / fine.sampled().t[1]))
        motion = fine.sampled(thin)
        step = motion.t[1] - motion.t[0]
        rows = np.arange(int(TRIM / step), len(motion.t) - int(TRIM / step), 3)
        rigid = inverse_dynamics(arm, motion.q, motion.v, motion.a)
        at = motion.q[rows], motion.v[rows], motion.a[rows]
        columns = regressor(arm, *at)
        rest = None
        if static:
            rest = inverse_dynamics(arm, motion.q, 0 * motion.v, 0 * motion.a)
            columns = columns - regressor(arm, at[0], 0 * at[1], 0 * at[2])
        flat = np.moveaxis(columns, 2, 1).reshape(-1, 6 + arm.n)
        read = spare.pick(sensor.read(flat[:, :6]), flat[:, 6:])
        columns = np.moveaxis(read.reshape(len(rows), -1, len(channels)), 1, 2)
        parts.append(Part(motion, fine, rigid, rest, rows, columns, thin))
    floors = []
    for part in parts:
        if part.motion.role != "validation":
            continue
        # The floor needs every sample: counts are smoothed and noise averaged over all of them.
        motion = part.fine.sampled()
        step = motion.t[1] - motion.t[0]
        counts = np.round(motion.q / resolution) * resolution
        smooth = CubicSpline(motion.t, filtered(counts, step, POSITION_CUT) - filtered(motion.q, step, POSITION_CUT))
        at = motion.q + smooth(motion.t), motion.v + smooth(motion.t, 1), motion.a + smooth(motion.t, 2)
        seen, true = (inverse_dynamics(arm, *state) for state in (at, (motion.q, motion.v, motion.a)))
        error = spare.pick(sensor.read(seen[0] - true[0]), seen[1] - true[1])
        error = error + noise * np.sqrt(1 + STATIC_SHARE**2 * static) * rng.normal(size=error.shape)
        floors.append(filtered(error, step)[int(TRIM / step) : -int(TRIM / step)])
    floor = np.sqrt(np.mean(np.concatenate(floors) ** 2, axis=0))
    delta = (nominal - arm.links).ravel()
    off = np.concatenate([part.columns @ delta for part in parts if part.motion.role == "validation"])
    return Study(arm, sensor, tuple(parts), channels, floor, np.sqrt(np.mean(off**2, axis=0)), _prior(arm.links, rel_std), gears)


def _prior(links: np.ndarray, rel_std: float) -> np.ndarray | None:
    """Rows (10 n, 10 n) of unit variance for changes of the links that keep within a relative trust; None: exact."""
    if rel_std == 0.0:
        return None
    units = [pseudo_inertia(unit) for unit in np.eye(10)]
    rows = np.zeros((10 * len(links), 10 * len(links)))
    for j, link in enumerate(links):
        values, vectors = np.linalg.eigh(pseudo_inertia(link))
        root = (vectors / np.sqrt(np.maximum(values, 1e-12 * values[-1]))) @ vectors.T
        square = np.array([(root @ unit @ root)[np.triu_indices(4)] for unit in units]).T
        square *= np.where(np.equal(*np.triu_indices(4)), 1.0, np.sqrt(2.0))[:, None]
        rows[10 * j : 10 * j + 10, 10 * j : 10 * j + 10] = square / rel_std
    return rows
