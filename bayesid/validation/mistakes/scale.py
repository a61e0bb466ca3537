"""Whether readings have the size that a robot of these links must have: units, gear sides and motor currents."""

from __future__ import annotations

import numpy as np
from scipy.optimize import nnls

from bayesid.validation.mistakes.candidates import Candidate, Mistake, in_words, signs
from bayesid.validation.mistakes.evidence import AS_RECORDED, EXPLAINED, WORSE, Change, Explainer
from bayesid.validation.mistakes.plausible import usual_bodies

#: Masses of a stated model are right to this factor.
_NOMINAL = 4.0
#: Masses guessed from the lengths of links are right to this factor: it lies between those of a hydraulic leg and of a toy arm.
_GUESSED = 30.0
_KNOWN = {1e3: "N mm instead of N m", 1.0 / 9.80665: "kgf m instead of N m", 1e-3: "kN m instead of N m"}
_KNOWN_FORCE = {1.0 / 9.80665: "kgf and kgf m instead of N and N m", 1e-3: "kN and kN m instead of N and N m"}
_NEAR = 2.5  # factor within which a unit is recognised
#: Links of one stated model are right to this factor beside each other; torques further apart have no unit in common.
_ALIKE = 1.5
_ABSURD = 1e4  # times as large as another is no torque in any unit
_STEPS = 2  # of fitting bodies to readings of these sizes, and sizes to those of the bodies


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
    for _ in range(_STEPS):
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
    if guessed is None or factor is None or 1.0 / allowed < factor < allowed:
        return []
    if np.sign(np.log(guessed)) != np.sign(np.log(factor)) or abs(np.log(guessed)) < np.log(_NOMINAL):
        return []
    # A small motion hardly tells weight from friction and offsets: bodies of a size that can be must explain the readings worse.
    if explainer.gained_by_size(stated, float(np.clip(factor, 1.0 / allowed, allowed)), change) < WORSE:
        return []
    known = _KNOWN if explainer.torque else _KNOWN_FORCE
    unit = next((text for times, text in known.items() if 1.0 / _NEAR < factor / times < _NEAR), None)
    if not explainer.torque:
        says = f"The wrench (fx ... mz) seems to be in {unit or 'another unit'}"
        text = f"{says}: it is {factor:.2g} times what {_beside(explainer)}; write N and N m"
        return [Mistake("wrench_units", "", text, "wrench", evidence=float("inf"))]
    sizes, shown = _sizes(explainer, stated)
    sizes = np.abs(sizes[shown])
    apart = len(sizes) > 1 and sizes.max() > _ALIKE * sizes.min()
    size = f"{sizes.min():.2g} to {sizes.max():.2g}" if apart else f"{factor:.2g}"
    unit_of_all = (f"in {unit}" if unit else "in another unit", "write N and N m")
    constant = "multiply each by its gear ratio, or its motor's constant and gear ratio"
    of_motors = ("those of the motors, or their currents [A]", constant)
    # A factor of a thousand is a unit; a tenth may be a current as well, and rather is one where joints differ.
    if factor > 1.0 or (unit is not None and factor < _NEAR * 1e-3):
        either = [unit_of_all]
    else:
        either = [of_motors] if unit is None else [of_motors, unit_of_all] if apart else [unit_of_all, of_motors]
    says = "; or ".join(what for what, _ in either)
    remedy = "; or ".join(remedy for _, remedy in either)
    text = f"The joint torques (tau) seem to be {says}: they are {size} times what {_beside(explainer)}; {remedy}"
    return [Mistake("torque_units", "", text, "torque", evidence=float("inf"))]


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
