"""What bounds rest on, and what their user should know, in sentences."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayesid.arguments import call
from bayesid.design.bounds.bands import FAR
from bayesid.results.bounds import ControllerBounds
from bayesid.results.text import number
from bayesid.workflows.warnings import listed


def assumptions(result: ControllerBounds, dropped: Sequence[str]) -> tuple[str, ...]:
    """What the bounds rest on."""
    known, w = result.known, result.workspace
    robot = known.problem.experiment.robot
    law = (
        f"Parameters follow a normal law with the covariance of the {known.source} ({known.method})."
        if known.draws is None
        else f"Parameters follow {len(known.draws)} posterior draws ({known.method})."
    )
    out = [law]
    if known.dispersion > 1.0:
        out.append(
            f"What the model lacks is counted: the covariance is {known.dispersion:.3g} times what noise alone would give, by "
            "the scatter between stretches of the recording."
        )
    if known.held_out_scale < 1.0:
        out.append(
            f"Motions that were not fitted are predicted better than that, so {known.held_out_scale:.3g} of that covariance "
            "is kept."
        )
    out.append(
        f"Mass matrix, Coriolis terms and gravity are bounded over {w.draws} robots that can exist, drawn within the "
        f"uncertainty, at {w.configurations} configurations. What the data do not determine is as uncertain as nominal links are "
        f"with a relative standard deviation of {known.trust:.3g} of every mass, and bodies that can exist allow."
    )
    unlimited = ~(np.isfinite(robot.lower) & np.isfinite(robot.upper))
    if unlimited.any():
        names = [n for n, u in zip(robot.joint_names, unlimited, strict=True) if u]
        out.append(f"The URDF states no position limits of {listed(names, 4)}: half a turn to both sides is taken (0.25 m).")
    out.append(
        "Links are rigid, and the robot's geometry is as the URDF says. Configurations may collide; nobody looks out for that."
    )
    if dropped:
        out.append(
            f"Not in the torques: {listed(dropped, 4)}, which depend on more than the joint's own motion. They count as other "
            "uncertainty."
        )
    return tuple(out)


def warnings(result: ControllerBounds, dropped: Sequence[str]) -> list[str]:
    """What the user should know, most important first."""
    known, w, out = result.known, result.workspace, []
    if known.links.complaint:
        out.append(
            f"The draws of links that can exist did not converge ({known.links.complaint}): bounds of the workspace are not sure."
        )
    left = result.remainder
    if left is not None and left.held_out and not left.complete:
        out.append(
            f"Something is missing in the model: {listed(left.motions, 3)}, not fitted, is predicted worse than noise and "
            "parameters explain. Bands of torques hold what is left as other uncertainty; sets of parameters do not. "
            f"`{call('diagnose')}` looks for what is missing."
        )
    if w.nominal_eigenvalue <= 0.0:
        out.append(
            "The mass matrix of the estimate itself is not positive definite everywhere: mass matrix, Coriolis terms and "
            "gravity are those of identified.urdf, whose links can exist. Take these for a controller that inverts it."
        )
    if w.alpha >= 1.0:
        out.append(
            f"alpha = {w.alpha:.3g} is not below 1: no gain of a computed-torque controller is proven to be stable. Identify "
            "with motions that move all links in other ways."
        )
    driven = [label for label, d in zip(result.region.labels, result.region.prior_driven, strict=True) if d]
    if driven:
        out.append(
            f"Driven by the prior, the data hardly narrow them: {listed(driven, 4)}. Bounds that depend on them are as good as "
            "the nominal model and its stated trust."
        )
    if result.wrench_model is not None:
        region = result.wrench_model.region
        beyond = [label for label, d in zip(region.labels, region.prior_driven, strict=True) if d]
        if beyond:
            out.append(f"The wrench's bands, not those of the torques, rest on the prior for {listed(beyond, 3)}.")
    if not result.inside.complete:
        rotor = np.nanmax(np.append(result.inside.rotor_share, 0.0))
        sees = "does not see" if known.problem.channel == "wrench" else "could see, but the model has not all of"
        extra = f"; rotors usually add up to {number(rotor, 2)} times a joint's inertia" if rotor > 0.0 else ""
        out.append(
            f"The {'sensor' if known.problem.channel == 'wrench' else 'torque reading'} {sees} what is inside the joints{extra}. "
            "Bounds of the mass matrix are without it: identify it from the torques (effects rotor_inertia, "
            "viscous_friction, coulomb_friction), or add a data sheet's numbers."
        )
    if result.remainder is None:
        out.append(
            "No joint torques were recorded, so nothing says how large the other uncertainty is: friction, rotors, flexibility."
        )
    elif not result.remainder.held_out:
        out.append(
            "Other uncertainty is that of motions that were fitted, which hides some of it: record a validation motion's torques."
        )
    for t in result.trajectories:
        far = [*t.torque.far, *(() if t.wrench is None else t.wrench.far)]
        if far:
            out.append(
                f"Trajectory '{t.name}' goes beyond the fitted motions: standard deviations are more than {FAR:g} times those "
                f"there in {listed(far, 6)}. Such a motion tests what was hardly fitted."
            )
    return out
