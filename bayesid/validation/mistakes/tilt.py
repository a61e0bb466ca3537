"""A base that stands at any angle: the direction of gravity that explains the readings best."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bayesid.dynamics.regressors import Kernel
from bayesid.validation.mistakes.candidates import Candidate, along
from bayesid.validation.mistakes.evidence import Change, Explainer, Fit

_STEPS = 4  # of turning gravity and fitting bodies again
#: A mount stands as it is stated to this angle [degrees]; less is no mistake of the recording but an effect (``base_tilt``).
_LEVEL = 3.0


def tilted(explainer: Explainer, starts: Sequence[Change], worth: float) -> list[Candidate]:
    """Gravity along the direction that suits the readings, where it is none of those that it starts from.

    Readings are linear in gravity for given bodies, and in the bodies for given gravity: each is fitted in turn.
    """
    stated, out = explainer.robot.gravity, []
    size = float(np.linalg.norm(stated))
    for start in starts if size > 0.0 else ():
        change = start
        for _ in range(_STEPS):
            fit = max(explainer.fit(change), key=lambda f: f.score(worth))
            direction = _direction(explainer, fit)
            if not np.linalg.norm(direction) > 0.0:
                break
            change = Change(gravity=size * direction / np.linalg.norm(direction))
        gravity = stated if change.gravity is None else change.gravity
        axes = [stated / size, *np.eye(3), *-np.eye(3)]
        if max(gravity @ axis for axis in axes) < size * np.cos(np.radians(_LEVEL)):
            out.append(along(gravity, stated))
    return out


def _direction(explainer: Explainer, fit: Fit) -> np.ndarray:
    """Gravity that the bodies of a fit need (3,), friction and offsets beside it."""
    samples, bodies = explainer.samples, explainer.robot.nominal.size
    still, links = np.zeros_like(samples.positions), fit.parameters[:bodies]

    def readings(gravity: np.ndarray, *rates: np.ndarray) -> np.ndarray:
        return (
            Kernel.of(replace(explainer.robot, gravity=gravity), explainer.channels).dynamics(samples.positions, *rates) @ links
        )

    moving = readings(np.zeros(3), samples.velocities, samples.accelerations)
    weight = np.stack([readings(axis, still, still) for axis in np.eye(3)], axis=-1)  # (N, c, 3)
    squares, products = np.zeros((3, 3)), np.zeros(3)
    for c, scale in enumerate(np.maximum(fit.left, explainer.floor)):
        basis = np.linalg.svd(explainer.beside(c), full_matrices=False)
        kept = basis.U[:, basis.S > 1e-9 * basis.S.max()]
        target = np.column_stack([samples.readings[:, c] - moving[:, c], weight[:, c]])
        target = (target - kept @ (kept.T @ target)) / scale
        squares += target[:, 1:].T @ target[:, 1:]
        products += target[:, 1:].T @ target[:, 0]
    return np.linalg.lstsq(squares, products, rcond=1e-9)[0]
