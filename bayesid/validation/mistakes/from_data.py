"""Mistakes that are found from the data.

Columns in another order, alphabetical or cyclic or any other, as an assignment of columns to joints; zeros of several joints that
are quarter turns off; and a base that stands at any angle, as the direction of gravity that explains the readings best.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace
from math import factorial, log

import numpy as np
from scipy.optimize import linear_sum_assignment

from bayesid.dynamics.regressors import Kernel
from bayesid.validation.mistakes.candidates import Candidate, along, order, zeros
from bayesid.validation.mistakes.evidence import EXPLAINED, UNEXPLAINED, WORSE, Change, Explainer, RobotFit

_Order = tuple[int, ...]
#: Log odds of a second mistake of its own [nats]: one in a thousand.
_SECOND = -log(1e3)
_STEPS = 4  # of turning gravity and fitting bodies again
#: A mount stands as it is stated to this angle [degrees]; less is no mistake of the recording but an effect (``base_tilt``).
_LEVEL = 3.0


def orders(explainer: Explainer, doubted: np.ndarray) -> list[Candidate]:
    """Orders of the columns that could explain the readings, the usual ones first.

    For an order of the positions, each column of torques explained by itself as each joint's torque is a matrix of costs, so
    that the best order of the torques is an assignment problem. It is solved for costs that no robot undercuts and for those of
    the nominal bodies. Orders of positions are the usual ones (alphabetical, backwards, cyclic, two exchanged), and whatever
    exchanging two more makes better still; only joints that are ``doubted`` (n,) are looked for elsewhere one by one.
    """
    names, n = explainer.robot.joint_names, explainer.robot.n
    free = [j for j in range(n) if doubted[j]]
    if len(free) < 2:
        return []
    whole_arm = explainer.torque and len(explainer.channels) == n  # torques of some joints keep their places
    same, whole = tuple(range(n)), _whole(names)
    pairs = [_exchanged(same, j, k) for j, k in itertools.combinations(free, 2)]
    usual = {same, *whole, *pairs}
    least: dict[_Order, float] = {}
    found: dict[tuple[_Order, _Order], Candidate] = {}

    def try_out(positions: _Order) -> float:
        if positions in least:
            return least[positions]
        change = Change() if positions == same else Change(joints=np.eye(n)[list(positions)])
        costs = np.log(np.maximum(explainer.alone(change), explainer.floor[:, None]))
        torques = {same: None}
        if whole_arm:
            torques |= dict.fromkeys([positions, *(usual if positions == same else ())])
            stated = np.log(np.maximum(explainer.alone_by_nominal(change), explainer.floor[:, None]))
            torques |= dict.fromkeys(_assigned(c, held, free) for c in (costs, stated) for held in (same, positions))
        for held in torques:
            if positions == same == held:
                continue
            candidate = order(names, positions, held)
            odds = sum(-log(factorial(_moved(o))) for o in {positions, held} - usual)
            odds += _SECOND if candidate.name == "column_order" else 0.0
            found[positions, held] = replace(candidate, odds=odds)
        if whole_arm:
            least[positions] = min(float(sum(costs[column, joint] for joint, column in enumerate(held))) for held in torques)
        else:
            least[positions] = float(costs.trace())
        return least[positions]

    for positions in [same, *whole, *pairs]:
        try_out(positions)
    best = min(least, key=lambda p: least[p])
    for _ in range(n):
        if least[best] > least[same] - WORSE:
            break
        step = min((_exchanged(best, j, k) for j, k in itertools.combinations(free, 2)), key=try_out)
        if least[step] > least[best] - WORSE:
            break
        best = step
    return list(found.values())


def _whole(names: Sequence[str]) -> list[_Order]:
    """Orders of all columns that loggers and their readers make: by name, backwards, turned round."""
    n = len(names)
    same, by_name = tuple(range(n)), np.argsort(names, kind="stable")
    if n < 3:
        return []
    turned = [same[shift:] + same[:shift] for shift in range(1, n)]
    return [tuple(map(int, np.argsort(by_name))), tuple(map(int, by_name)), same[::-1], *turned]


def _moved(columns: _Order) -> int:
    return sum(j != column for j, column in enumerate(columns))


def _exchanged(columns: _Order, j: int, k: int) -> _Order:
    out = list(columns)
    out[j], out[k] = out[k], out[j]
    return tuple(out)


def _assigned(costs: np.ndarray, usual: _Order, free: Sequence[int]) -> _Order:
    """Which column holds each joint's torque: a column moves from the usual order only for much of a residual."""
    costs = costs.copy()
    costs[list(usual), range(len(usual))] -= WORSE
    columns = [usual[j] for j in free]
    rows, joints = linear_sum_assignment(costs[np.ix_(columns, free)])
    out = list(usual)
    for row, joint in zip(rows, joints, strict=True):
        out[free[joint]] = columns[row]
    return tuple(out)


def other_zeros(explainer: Explainer, worth: float, needed: float, further: float) -> list[Candidate]:
    """Zeros that are a quarter or half a turn off, as those of Denavit and Hartenberg's angles are beside a URDF's.

    One joint after the other is turned, the one that gains most first; the first must gain what is ``needed`` [nats]. Where one
    joint counts from such a zero, others are likely to: each ``further`` one must gain that much, and the residual of a column
    most of which is trusted counts down to its own floor, however small it is beside others: there a wrist's zero shows.
    """
    robot, names = explainer.robot, explainer.robot.joint_names
    trusted = explainer.floor**2 <= UNEXPLAINED * explainer.variation**2
    own = np.where(trusted, EXPLAINED, 1.0) * explainer.variation
    turns = [(j, turn) for j in np.flatnonzero(~robot.prismatic) for turn in (-0.5 * np.pi, 0.5 * np.pi, np.pi)]
    found: list[Candidate] = []
    angles, units, floor = np.zeros(robot.n), np.eye(robot.n), explainer.floor
    for count in range(robot.n):
        now = max(fit.score(worth, floor) for fit in explainer.fit(Change(zeros=angles)))
        changes = [Change(zeros=angles + turn * units[j]) for j, turn in turns if angles[j] == 0.0]
        if count == 0:
            found = [zeros(names, turn * units[j]) for j, turn in turns]
            changes = [c for c in changes if explainer.highest_score(c, worth) - now > needed]
        scores = [max(fit.score(worth, floor) for fit in explainer.fit(c)) - now for c in changes]
        if max(scores, default=0.0) < (further if count else needed):
            break
        likeliest = changes[int(np.argmax(scores))].zeros
        assert likeliest is not None
        angles, floor = likeliest, own
        found = [replace(zeros(names, angles), odds=-count * log(len(turns))), *(c for c in found if not _begins(c, angles))]
    return found


def _begins(candidate: Candidate, turned: np.ndarray) -> bool:
    """Whether all that a candidate turns is turned so."""
    own = candidate.change.zeros
    return own is not None and bool(((own == 0.0) | (own == turned)).all())


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


def _direction(explainer: Explainer, fit: RobotFit) -> np.ndarray:
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
