"""What bounds for controllers say, as lines and tables for a terminal, a notebook and a report."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from bayesid.design.bounds.bands import Band
from bayesid.design.bounds.region import Region
from bayesid.design.bounds.remainder import InsideJoints, Remainder
from bayesid.design.bounds.workspace import Workspace
from bayesid.results.text import number, percent

#: Head and rows.
Table = tuple[list[str], list[list[str]]]

#: What holds for every number.
HEAD = "each bound holds with probability 95 %"


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
            f"M_hat is {number(w.ratio[0], 4)} to {number(w.ratio[1], 4)} times M; alpha {number(w.alpha, 3)}"
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
        rotor = "identified" if not np.isfinite(inside.rotor[j]) else f"{percent(inside.rotor_share[j], 2)} of inertia"
        share = inside.friction_share[j]
        known = not (np.isfinite(inside.coulomb[j]) or np.isfinite(inside.viscous[j]))
        friction = f"{percent(share, 2)} of gravity" if np.isfinite(share) else number(inside.coulomb[j], 2)
        rows.append(
            [name, f"{number(w.inertia[j, 0], 3)} … {number(w.inertia[j, 1], 3)}", percent(w.inertia_error[j], 2),
             number(gravity[j], 3), number(error[j], 2), rotor, "identified" if known else friction]
        )  # fmt: skip
    return head, rows


def trajectories(bands: Iterable[tuple[str, Band]]) -> Table:
    """Bands by trajectory: head and rows."""
    head = ["trajectory", "torque: half band, by joint", "std over that of the fitted motions"]
    rows = [
        [name, ", ".join(number(x, 2) for x in torque.factor * torque.std.max(axis=0)),
         ", ".join(number(x, 2) for x in torque.extrapolation)]
        for name, torque in bands
    ]  # fmt: skip
    return head, rows

