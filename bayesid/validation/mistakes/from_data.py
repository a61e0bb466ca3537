"""Mistakes that are found from the data.

Columns in another order, alphabetical or cyclic or any other, as an assignment of columns to joints; zeros of several joints that
are quarter turns off; a base that stands at any angle, as the direction of gravity that explains the readings best; and readings
without the size that a robot of these links must have: units, gear sides and motor currents.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace
from math import factorial, log

import numpy as np
from scipy.optimize import linear_sum_assignment, nnls

from bayesid.dynamics.regressors import Kernel
from bayesid.recordings.complaints import in_words
from bayesid.validation.mistakes.candidates import Candidate, Mistake, along, order, signs, zeros
from bayesid.validation.mistakes.evidence import (
    AS_RECORDED,
    EXPLAINED,
    NEEDED,
    UNEXPLAINED,
    WORSE,
    Change,
    Explainer,
    RobotFit,
    usual_bodies,
)

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


def other_zeros(explainer: Explainer, worth: float, needed: float) -> list[Candidate]:
    """Zeros that are a quarter or half a turn off, as those of Denavit and Hartenberg's angles are beside a URDF's.

    One joint after the other is turned, the one that gains most first; the first must gain what is ``needed`` [nats]. Where one
    joint counts from such a zero, others are likely to: each further one must gain `NEEDED`, and the residual of a column
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
        if max(scores, default=0.0) < (NEEDED if count else needed):
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
    known = [stated / (size or 1.0), *np.eye(3), *-np.eye(3)]
    for start in starts if size > 0.0 else ():
        change = start
        for _ in range(_STEPS):
            fit = max(explainer.fit(change), key=lambda f: f.score(worth))
            direction = _direction(explainer, fit)
            if not np.linalg.norm(direction) > 0.0:
                break
            change = Change(gravity=size * direction / np.linalg.norm(direction))
        gravity = stated if change.gravity is None else change.gravity
        if max(gravity @ direction for direction in known) < size * np.cos(np.radians(_LEVEL)):
            out.append(along(gravity, stated))
            known.append(gravity / size)  # another start may lead to the same
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


#: Masses of a stated model are right to this factor.
_NOMINAL = 4.0
#: Masses guessed from the lengths of links are right to this factor: it lies between those of a hydraulic leg and of a toy arm.
_GUESSED = 30.0
_KNOWN = {1e3: "N mm instead of N m", 1.0 / 9.80665: "kgf m instead of N m", 1e-3: "kN m instead of N m"}
_KNOWN_FORCE = {1.0 / 9.80665: "kgf and kgf m instead of N and N m", 1e-3: "kN and kN m instead of N and N m"}
_NEAR = 2.5  # factor within which a unit is recognised
#: Links of one stated model are right to this factor beside each other; torques further apart have no unit in common.
_ALIKE = 1.5
_ROUNDED = 1e-8  # times what bodies need is nothing but rounding, as of a sensor without moments
_ABSURD = 1e4  # times as large as another is no torque in any unit
_ROUNDS = 2  # of fitting bodies to readings of these sizes, and sizes to those of the bodies


def by_joint(explainer: Explainer, worth: float) -> list[Candidate]:
    """Torques of which each has a sign or a scale of its own: those of motor currents, or of the motors' side of unlike gears."""
    n, bodies = len(explainer.channels), explainer.bodies
    found, shown = _sizes(explainer, bodies)
    out = []
    negative = np.flatnonzero(found < 0.0)
    if 1 < len(negative) < n:
        measured = [int(j) for j in explainer.channels.joint]
        out.append(signs(explainer.robot.joint_names, measured, [measured[k] for k in negative], "torque"))
    odd = [int(k) for k in np.flatnonzero(shown) if not 1.0 / _NOMINAL < abs(found[k]) < _NOMINAL]
    spread = np.ptp(np.log(np.abs(found[shown]))) if shown.any() else 0.0
    if not odd or not np.log(_ALIKE) < spread < np.log(_ABSURD):  # a factor that all have in common changes no fit
        return out
    sizes = np.where(shown, found, np.exp(np.median(np.log(np.abs(found[shown])))))
    for _ in range(_ROUNDS):
        fit = max(explainer.fit(Change(readings=np.diag(1.0 / sizes), numbers=n)), key=lambda f: f.score(worth))
        again, seen = _sizes(explainer, fit.parameters[: bodies.size])
        sizes = np.where(shown & seen, again, sizes)
    columns = explainer.channels.names
    factors = in_words([f"{found[k]:.2g} ({columns[k]})" for k in odd])
    says = (
        "the columns tau seem to be in units of their own, as motor currents [A] or torques before the gears are: "
        f"{factors} times what {_beside(explainer)}"
    )
    constants = in_words([f"{1.0 / found[k]:.2g} ({columns[k]})" for k in odd])
    remedy = f"multiply each by its motor's constant and gear ratio, with their sign; from these data about {constants}"
    return [*out, Candidate("torque_scales", "", says, remedy, Change(readings=np.diag(1.0 / sizes), numbers=n))]


def implausible_size(explainer: Explainer, change: Change = AS_RECORDED) -> list[Mistake]:
    """Compare readings with those of the nominal bodies, or of usual bodies where the URDF has no masses.

    A mistake is named where both are off to the same side: nominal bodies alone may be placeholders. ``change`` is that of
    signs, which makes the readings right but for their size.
    """
    stated, usual = explainer.bodies, usual_bodies(explainer.robot)
    guessed, factor = explainer.size_beside(usual, change), explainer.size_beside(stated, change)
    allowed = _NOMINAL if explainer.has_masses else _GUESSED
    # What a sensor carries alone is a tool that the URDF may know, and a load that it does not.
    loaded = not explainer.torque and explainer.robot.sensor_bodies.sum() == 1
    most = _GUESSED if loaded else allowed
    if guessed is None or factor is None or 1.0 / allowed < factor < most or factor < _ROUNDED:
        return []
    if np.sign(np.log(guessed)) != np.sign(np.log(factor)) or abs(np.log(guessed)) < np.log(_NOMINAL):
        return []
    # A small motion hardly tells weight from friction and offsets: bodies of a size that can be must explain the readings worse.
    if explainer.gained_by_size(stated, float(np.clip(factor, 1.0 / allowed, most)), change) < WORSE:
        return []
    known = _KNOWN if explainer.torque else _KNOWN_FORCE
    unit = next((text for times, text in known.items() if 1.0 / _NEAR < factor / times < _NEAR), None)
    sizes, shown = _sizes(explainer, stated)
    if not explainer.torque:
        moments = np.abs(sizes[3:][shown[3:]])
        if explainer.has_masses and len(moments) and 1.0 / _NOMINAL < np.median(moments) < _NOMINAL:
            what = unit.split()[0] if unit else "another unit"
            text = f"The forces seem to be in {what}: they are {factor:.2g} times what {_beside(explainer)}; write them in N"
            return [Mistake("force_unit", what if unit else "", text, "wrench", evidence=float("inf"))]
        says = f"The wrench (fx ... mz) seems to be in {unit or 'another unit'}"
        text = f"{says}: it is {factor:.2g} times what {_beside(explainer)}; write N and N m"
        return [Mistake("wrench_units", "", text, "wrench", evidence=float("inf"))]
    sizes = np.abs(sizes[shown])
    apart = len(sizes) > 1 and sizes.max() > _ALIKE * sizes.min()
    size = f"{sizes.min():.2g} to {sizes.max():.2g}" if apart else f"{factor:.2g}"
    unit_of_all = (f"in {unit}" if unit else "in another unit", "write N and N m")
    constant = "multiply each by its gear ratio, or its motor's constant and gear ratio"
    of_motors = ("those of the motors, or their currents [A]", constant)
    # Less may be what large gears leave of a torque as well, or a current, and rather is that where joints differ.
    if factor > 1.0:
        either = [unit_of_all]
    else:
        either = [of_motors] if unit is None else [of_motors, unit_of_all] if apart else [unit_of_all, of_motors]
    says = "; or ".join(what for what, _ in either)
    remedy = "; or ".join(remedy for _, remedy in either)
    text = f"The joint torques (tau) seem to be {says}: they are {size} times what {_beside(explainer)}; {remedy}"
    return [Mistake("torque_units", "", text, "torque", evidence=float("inf"))]


def unlike_nominal(explainer: Explainer) -> str | None:
    """Say that torques are of another size than the URDF's masses need in every joint, to the same side; mostly None.

    Whether that is a mistake, nothing here decides: a fit finds the masses that the torques need, and the URDF may be wrong.
    """
    if not (explainer.torque and explainer.has_masses):
        return None
    found, shown = _sizes(explainer, explainer.bodies)
    sizes = found[shown]
    less = bool(((sizes > 0.0) & (sizes < 1.0 / _ALIKE)).all())
    if len(sizes) < min(2, len(found)) or not (less or (sizes > _ALIKE).all()):
        return None
    # As in `implausible_size`: what the URDF's own masses explain as well, with friction, says nothing.
    if explainer.gained_by_size(explainer.bodies, 1.0) < WORSE:
        return None
    names = [explainer.channels.names[k] for k in np.flatnonzero(shown)]
    each = in_words([f"{size:.2g} ({name})" for size, name in zip(sizes, names, strict=True)])
    causes = "torques of the motors, currents" if less else "a load that the URDF does not have"
    return (
        f"The joint torques (tau) are {each} times what the URDF's masses need, in every joint that shows it: {causes}, another "
        f"unit, or a URDF whose links are {'heavier' if less else 'lighter'} than the robot's? Masses are identified as tau says"
    )


def weight_carried(explainer: Explainer) -> list[Mistake]:
    """Joints that carry a constant weight, as of a lift, which is not in their readings: no fit with an offset misses it."""
    if not explainer.torque or not explainer.has_masses:
        return []
    out, weight, read = [], explainer.nominal_weight, explainer.samples.readings.mean(axis=0)
    sizes, shown = _sizes(explainer, explainer.bodies)
    usual = float(np.median(np.abs(sizes[shown]))) if shown.any() else 1.0
    for k, column in enumerate(explainer.channels.names):
        mean, unit = weight[:, k].mean(), explainer.channels.units[k]
        constant = np.abs(weight[:, k] - mean).max() < EXPLAINED * abs(mean)
        if not constant or abs(mean) < explainer.floor[k] or abs(read[k]) > usual * abs(mean) / _NOMINAL:
            continue
        name = explainer.robot.joint_names[int(explainer.channels.joint[k])]
        text = (
            f"The weight that {name} carries is not in {column}: it is {read[k]:.2g} {unit} on average, and the URDF's masses "
            f"need {mean:.3g} {unit}; a counterbalance, a brake or the controller takes it. No mass comes from this column: "
            "leave it out, or record it before gravity is compensated"
        )
        out.append(Mistake("gravity_removed", column, text, "torque", evidence=float("inf")))
    return out


def _beside(explainer: Explainer) -> str:
    return "the URDF's masses need" if explainer.has_masses else "links of these lengths usually need"


def _sizes(explainer: Explainer, bodies: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How many times each column is what bodies make of it, friction beside it, and where that shows (c,).

    Negative where its sign is opposite, one where it does not show.
    """
    readings, rigid = explainer.samples.readings, explainer.rigid(bodies)
    sizes, shown = np.ones(readings.shape[1]), np.zeros(readings.shape[1], bool)
    for c in range(len(sizes)):
        beside, size = explainer.beside(c), np.linalg.norm(rigid[:, c])
        if not size > 0.0:
            continue
        least = np.sqrt(len(readings)) * explainer.floor[c]
        alone = min(nnls(_unit(beside), sign * readings[:, c])[1] for sign in (1.0, -1.0))
        left = alone
        for sign in (1.0, -1.0):
            factors, rest = nnls(_unit(np.column_stack([rigid[:, c], beside])), sign * readings[:, c])
            if rest < left and factors[0] > 0.0:
                left, sizes[c] = rest, sign * factors[0] / size
        shown[c] = np.log(max(alone, least) / max(left, least)) > WORSE
    return np.where(shown, sizes, 1.0), shown


def _unit(columns: np.ndarray) -> np.ndarray:
    """Columns of length one, those of zeros as they are."""
    size = np.linalg.norm(columns, axis=0)
    return columns / np.where(size > 0.0, size, 1.0)
