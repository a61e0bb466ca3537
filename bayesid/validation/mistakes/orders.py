"""Columns in another order, alphabetical or cyclic or any other: found as an assignment of columns to joints."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace
from math import factorial, log

import numpy as np
from scipy.optimize import linear_sum_assignment

from bayesid.validation.mistakes.candidates import Candidate, order
from bayesid.validation.mistakes.evidence import WORSE, Change, Explainer

_Order = tuple[int, ...]
#: Log odds of a second mistake of its own [nats]: one in a thousand.
_SECOND = -log(1e3)


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
