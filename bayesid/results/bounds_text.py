"""What bounds for controllers say, as lines and tables for a terminal, a notebook and a report."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from bayesid.design.bounds.bands import Band
from bayesid.design.bounds.inside_joints import InsideJoints
from bayesid.design.bounds.region import Region
from bayesid.design.bounds.remainder import Remainder
from bayesid.design.bounds.workspace import Workspace
from bayesid.results.text import number, percent

#: Head and rows.
Table = tuple[list[str], list[list[str]]]


def headline(left: Remainder | None, fitted: Sequence[str]) -> str:
    """What the bounds hold with probability 95 % of, and what that is conditional on."""
    sets = "Sets of parameters hold with probability 95 %, given that the model is right"
    if left is None:
        return f"{sets}; no torques were recorded, so bands hold what parameters leave open and nothing that the model lacks."
    named = ", ".join(left.motions)
    if left.complete:
        where = "which were not fitted" if left.held_out else "which were fitted"
        return f"{sets}; so do bands: noise and parameters explain all that is left of {named}, {where}."
    if left.held_out:
        return (
            f"{sets}. Bands of torques hold 95 % of the samples of motions like {named}, not fitted: what is left there, "
            "which no parameter explains, is in them."
        )
    return (
        f"{sets}. Bands of torques hold 95 % of the samples of motions like {', '.join(fitted)}, with the robot as warm and worn "
        "as it was then: no motion was held out, so nothing shows another kind of motion or another day."
    )


def facts(region: Region, effort_ratio: float, w: Workspace, left: Remainder | None) -> list[tuple[str, str]]:
    """What there is to say in one line each: a name and a text."""
    out = [
        (
            "parameters of the joint torques",
            f"{len(region.values)}, all at once within {number(region.factor, 3)} standard deviations (box), "
            f"rho_V {number(region.ellipsoid, 4)} (ellipsoid), rho {number(region.rho, 3)} (ball, SI units)",
        ),
        ("torque of the ball over that of the ellipsoid", f"{number(effort_ratio, 2)} times (median)"),
        (
            "mass matrix",
            f"M_hat is {number(w.ratio[0], 3)} to {number(w.ratio[1], 3)} times M; alpha {number(w.alpha, 3)}"
            + (" (of identified.urdf)" if w.of_urdf else "")
            + ("" if w.alpha < 1.0 else ", not below 1: computed torque has no guarantee"),
        ),
        ("Coriolis", f"error {number(w.coriolis_error, 2)} of {number(w.coriolis, 3)} [N m s²]"),
        ("every drawn mass matrix", f"positive definite; smallest eigenvalue {number(w.smallest_drawn, 3)}"),
    ]
    if left is not None:
        kind = "motions that were not fitted" if left.held_out else "the fitted motions"
        bounds = ", ".join(number(b, 3) for b in left.bound)
        out.append(("other uncertainty", f"99 % of the torques of {kind} within {bounds}"))
    return out


def joints(w: Workspace, inside: InsideJoints) -> Table:
    """Bounds joint by joint: head and rows."""
    least = 1e-9 * float(w.gravity.max(initial=0.0))  # rounding of a joint that carries no weight
    gravity, error = (np.where(x > least, x, 0.0) for x in (w.gravity, w.gravity_error))
    head = ["joint", "inertia", "error", "gravity", "error", "usual rotor inertia", "usual friction"]
    rows = []
    for j, name in enumerate(inside.joints):
        rotor = "identified" if not np.isfinite(inside.rotor[j]) else f"{number(inside.rotor_share[j], 2)} × inertia"
        share = inside.friction_share[j]
        known = not (np.isfinite(inside.coulomb[j]) or np.isfinite(inside.viscous[j]))
        friction = f"{number(share, 2)} × gravity" if np.isfinite(share) else number(inside.coulomb[j], 2)
        rows.append(
            [name, f"{number(w.inertia[j, 0], 3)} … {number(w.inertia[j, 1], 3)}", share_of(w.inertia_error[j]),
             number(gravity[j], 3), number(error[j], 2), rotor, "identified" if known else friction]
        )  # fmt: skip
    return head, rows


def share_of(error: float) -> str:
    """A relative error as per cent, as far as it is one."""
    return percent(error, 2) if error <= 1.0 else "over 100 %"


def trajectories(bands: Iterable[tuple[str, Band]]) -> Table:
    """Bands by trajectory: head and rows."""
    head = ["trajectory", "torque: half band, by joint", "std over that of the fitted motions"]
    rows = [
        [name, ", ".join(number(x, 2) for x in torque.factor * torque.std.max(axis=0)),
         ", ".join(number(x, 2) for x in torque.extrapolation)]
        for name, torque in bands
    ]  # fmt: skip
    return head, rows
