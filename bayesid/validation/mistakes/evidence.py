"""How well a robot that could exist explains readings, with and without a candidate mistake undone."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag, cholesky, solve_triangular
from scipy.optimize import nnls

from bayesid.dynamics.channels import Channels
from bayesid.dynamics.regressors import Kernel
from bayesid.robot.robot import Robot
from bayesid.validation.mistakes.plausible import body_generators, friction_columns, offset_columns
from bayesid.validation.mistakes.samples import Samples

#: A channel explained to this share of its variation is explained; a better fit is no evidence for anything.
EXPLAINED = 0.02
#: Nor is any reading trusted beyond this share of the largest of its kind: sensors and drives of one robot are alike, and where
#: a wrist's torques are this small beside the shoulder's, friction and crosstalk are as large.
TRUSTED = 0.01
#: Ridge of the generators' scaled normal equations, which are many more than the data show, and of those of a few whole bodies,
#: whose sizes it must not shrink where a small motion hardly tells their weight from friction and offsets.
_RIDGE, _HARDLY_ANY = 1e-5, 1e-10
_ROUNDS = 2  # of weighting channels by what they leave


@dataclass(frozen=True)
class Fit:
    """The best robot that could exist.

    Attributes
    ----------
    errors
        Residual of each channel over its variation, rms (c,).
    left
        The same in the recording's own columns and units (c,).
    residual
        (N, c) [unit of the channel].
    log_likelihood
        Of one sample of the readings as recorded, with the noise of every channel profiled out.
    count
        How many numbers the data as they are needed for the same bodies.
    """

    errors: np.ndarray
    left: np.ndarray
    residual: np.ndarray
    log_likelihood: float
    count: int

    def score(self, worth: float) -> float:
        """Log evidence by the Bayesian information criterion, of so many independent samples [nats]."""
        return _score(self.log_likelihood, self.count, worth)


class Explainer:
    """Fits robots that could exist to readings, under changes of the readings, joints or gravity.

    Parameters
    ----------
    robot, channels
        What is measured.
    samples
        Joint motion and readings.
    """

    def __init__(self, robot: Robot, channels: Channels, samples: Samples) -> None:
        self.robot, self.channels, self.samples = robot, channels, samples
        self.torque = channels.names[0].startswith("tau")
        others = np.eye((5 if self.torque else 2 * len(np.unique(samples.motion))) * len(channels))
        families = [body_generators(robot)]
        if robot.nominal[:, 0].sum() > 0.0:  # each nominal body times a factor: far fewer numbers, where the URDF is good
            families.append(np.asarray(block_diag(*robot.nominal[:, :, None])))
        self._families = [np.asarray(block_diag(bodies, others)) for bodies in families]
        variation = np.sqrt(np.mean((samples.readings - samples.readings.mean(axis=0)) ** 2, axis=0))
        if not self.torque:  # forces share a scale and moments another, so that a turned frame changes neither
            variation = np.repeat(np.sqrt(np.mean(variation.reshape(2, 3) ** 2, axis=1)), 3)
        self.variation = np.maximum(variation, 1e-9)
        self._counts: list[int] = []
        self._designs: dict[bytes, tuple[np.ndarray, np.ndarray]] = {}

    def fit(
        self, readings: np.ndarray | None = None, joints: np.ndarray | None = None, gravity: np.ndarray | None = None
    ) -> list[Fit]:
        """The best robots that could exist for changed data: any bodies, then the nominal ones times a factor each.

        Parameters
        ----------
        readings
            Matrix that the readings are multiplied by (c, c).
        joints
            Matrix that positions and their rates are multiplied by (n, n).
        gravity
            In place of the stated one (3,) [m/s^2].
        """
        design, squares = self._design(joints, gravity)
        change = np.eye(len(self.channels)) if readings is None else readings
        target = self.samples.readings @ change.T
        variation = np.sqrt(change**2 @ self.variation**2)
        floor = self.floor(variation)
        products = np.einsum("ncm,nc->cm", design, target, optimize=True)
        back = np.linalg.inv(change) ** 2
        fits = []
        for k, expand in enumerate(self._families):
            left, residual, factors = variation, target, np.zeros(expand.shape[1])
            for _ in range(_ROUNDS):
                weights = np.maximum(left, floor) ** -2
                whole = np.tensordot(weights, squares, 1)
                ridge = _RIDGE if k == 0 else _HARDLY_ANY
                factors = _non_negative(expand.T @ whole @ expand, expand.T @ (weights @ products), ridge)
                residual = target - design @ (expand @ factors)
                left = np.sqrt(np.mean(residual**2, axis=0))
            likelihood = _log_likelihood(change, np.maximum(left, floor))
            if k == len(self._counts):
                self._counts.append(int(np.count_nonzero(factors)))
            fits.append(Fit(left / variation, np.sqrt(back @ left**2), residual, likelihood, self._counts[k]))
        return fits

    def highest_score(self, readings: np.ndarray | None, worth: float) -> float:
        """What `Fit.score` of changed readings cannot exceed: every channel explained to its floor, by the fewest numbers [nats].

        Parameters
        ----------
        readings
            Matrix that the readings are multiplied by (c, c), as `fit` takes it.
        worth
            How many independent samples the data are worth.
        """
        change = np.eye(len(self.channels)) if readings is None else readings
        floor = self.floor(np.sqrt(change**2 @ self.variation**2))
        return _score(_log_likelihood(change, floor), min(self._counts, default=0), worth)

    def floor(self, variation: np.ndarray) -> np.ndarray:
        """Residuals (c,) that are no evidence, for channels of this variation (c,)."""
        units = np.array(self.channels.units)
        largest = np.array([variation[units == unit].max() for unit in units])
        return np.maximum(EXPLAINED * variation, TRUSTED * largest)

    def size_beside(self, bodies: np.ndarray) -> float | None:
        """How many times the readings are those of given bodies (b, 10) with any friction; None where those say nothing."""
        factors = self._sized(bodies, None)[0]
        return float(factors[0]) if factors[0] > 0.0 else None

    def gained_by_size(self, bodies: np.ndarray, factor: float) -> float:
        """Log likelihood of a sample that bodies of any size gain over this many times the given ones, friction beside both."""
        left = [self._sized(bodies, fixed)[1] for fixed in (None, factor)]
        floor = self.floor(self.variation)
        return float(np.sum(np.log(np.maximum(left[1], floor)) - np.log(np.maximum(left[0], floor))))

    def _sized(self, bodies: np.ndarray, fixed: float | None) -> tuple[np.ndarray, np.ndarray]:
        """Factors of the bodies (fixed, or None) and of everything beside them, and what they leave of each channel (c,)."""
        design, squares = self._design(None, None)
        count = bodies.size
        expand = np.zeros((design.shape[2], 1 + design.shape[2] - count))
        expand[:count, 0] = bodies.ravel()
        expand[count:, 1:] = np.eye(design.shape[2] - count)
        weights, target = self.floor(self.variation) ** -2, self.samples.readings
        if fixed is not None:
            target = target - design @ (fixed * expand[:, 0])
        products = weights @ np.einsum("ncm,nc->cm", design, target, optimize=True)
        free = expand if fixed is None else expand[:, 1:]
        factors = _non_negative(free.T @ np.tensordot(weights, squares, 1) @ free, free.T @ products, _HARDLY_ANY)
        left = np.sqrt(np.mean((target - design @ (free @ factors)) ** 2, axis=0))
        return (factors if fixed is None else np.append(fixed, factors)), left

    def _design(self, joints: np.ndarray | None, gravity: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        """Columns of all parameters (N, c, p), and the products of columns by channel (c, p, p)."""
        key = b"|".join(b"" if a is None else np.asarray(a, dtype=float).tobytes() for a in (joints, gravity))
        if key in self._designs:
            return self._designs[key]
        s, robot = self.samples, self.robot
        motion = (s.positions, s.velocities, s.accelerations)
        if joints is not None:
            motion = tuple(m @ joints.T for m in motion)
        if gravity is not None:
            robot = replace(robot, gravity=np.asarray(gravity, dtype=float))
        rigid = Kernel.of(robot, self.channels).dynamics(*motion)
        more = friction_columns(*motion[1:]) if self.torque else offset_columns(s.motion, len(self.channels))
        design = np.concatenate([rigid, more], axis=2)
        squares = np.array([design[:, c].T @ design[:, c] for c in range(design.shape[1])])
        self._designs[key] = design, squares
        return design, squares

    def independent_samples(self, fit: Fit) -> float:
        """How many independent samples the residual of a fit is worth: model error is correlated in time."""
        part, counts = self.samples.part, []
        for column in fit.residual.T:
            column = column - column.mean()
            power, lag, time = float(column @ column), 1, 1.0
            while lag < len(column) and power > 0.0:
                same = part[lag:] == part[:-lag]
                rho = float(column[lag:][same] @ column[:-lag][same]) / power
                if rho <= 0.0:
                    break
                time += 2.0 * rho
                lag += 1
            counts.append(len(column) / time)
        return float(np.median(counts))


def _non_negative(squares: np.ndarray, products: np.ndarray, ridge: float) -> np.ndarray:
    """Least squares with factors that are not negative, from its normal equations."""
    size = np.sqrt(np.diag(squares))
    seen = size > 1e-9 * size.max()
    scaled = squares[np.ix_(seen, seen)] / np.outer(size[seen], size[seen])
    root = cholesky(scaled + ridge * np.eye(len(scaled)))
    out = np.zeros(len(size))
    out[seen] = nnls(root, solve_triangular(root, products[seen] / size[seen], trans=1))[0] / size[seen]
    return out


def _log_likelihood(change: np.ndarray, left: np.ndarray) -> float:
    """Of one sample, by what is left of each channel (c,).

    The density is that of the readings as recorded: a change (c, c) that shrinks them explains nothing by that.
    """
    return float(np.linalg.slogdet(change)[1]) - float(np.log(left).sum())


def _score(log_likelihood: float, count: int, worth: float) -> float:
    """By the Bayesian information criterion [nats]."""
    return worth * log_likelihood - 0.5 * count * float(np.log(max(worth, 2.0)))
