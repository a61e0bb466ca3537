"""The report of ``bounds``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from bayesid.arguments import argument, call
from bayesid.design.bounds.bands import FAR, Band
from bayesid.design.bounds.remainder import Remainder
from bayesid.design.bounds.workspace import Workspace
from bayesid.drawing import Figures, figures_of
from bayesid.report.figures import (
    CLASSES,
    DENSE,
    GREY,
    PREDICTED,
    add_legend,
    label_lowest,
    list_rows,
    make_grid,
    picked,
    styled,
    tidy_time,
)
from bayesid.report.page import below, bullets, cards, figure, how, lead, note, page, svg, warnings
from bayesid.results.bounds import ControllerBounds, MatrixUnits, TrajectoryBands, band_table, bands_of, joints, matrix_units
from bayesid.results.files import report_of
from bayesid.rounding import channel_text, ends, number, percent, with_half
from bayesid.section import Part, ShownSection, ShownTable

_BLUE = CLASSES["alone"]
#: Parameters that are shown, those whose uncertainty makes most torque.
_PARAMETERS = 20


@styled
def band_figure(band: Band, channels: Sequence[str] | str | None = None, ax: Any = None) -> Figure:
    """Readings of a trajectory with their bands; below each, half their widths, which are often too thin to be seen."""
    chosen = picked(band.names, channels)
    count = len(chosen)
    columns = 2 if count > 1 and ax is None else 1
    rows = -(-count // columns)
    figure, axes = make_grid(2 * rows, columns, 0.85, ax=ax, sharex=True, height_ratios=(1.5, 0.8) * rows)
    dense = len(band.times) > DENSE
    panels = list(zip(axes[::2].ravel(), axes[1::2].ravel(), strict=True))
    for k, (ax, halves) in zip(chosen, panels, strict=False):
        name, unit = band.names[k], band.units[k]
        both = (
            ("simultaneous", "all samples at once", 0.15, "-", band.low, band.high, band.half_width),
            ("pointwise", "95 % of the samples", 0.4, "--", band.pointwise_low, band.pointwise_high, band.pointwise_half_width),
        )
        for kind, holds, alpha, style, low, high, half in both:
            ax.fill_between(band.times, low[:, k], high[:, k], color=_BLUE, alpha=alpha, lw=0, label=f"{kind}: {holds}")
            halves.plot(band.times, half[:, k], color=_BLUE, lw=0.9, ls=style, label=f"half {kind}", rasterized=dense)
        ax.plot(band.times, band.values[:, k], color=PREDICTED, lw=0.9, label="predicted", rasterized=dense)
        ax.set_title(f"{name} [{unit}]")
        halves.set_ylim(bottom=0.0)
        for panel in (ax, halves):
            panel.yaxis.set_major_locator(MaxNLocator(3))
        tidy_time(ax, False)
    for ax in (ax for both in panels[count:] for ax in both):
        ax.set_visible(False)
    label_lowest(axes, "time [s]")
    add_legend(axes, *axes[:2, 0])
    return figure


@styled
def parameter_figure(result: ControllerBounds) -> Figure:
    """What each parameter moves in the fitted motions, and what its uncertainty does, in torque; the least certain first."""
    region, base = result.region, result.torque_model.base
    names = [*base.short_names, *region.names[base.rank :]]
    moves = np.abs(region.values) * result.torque_per_unit
    unsure = np.where(region.undetermined, 0.0, np.nan_to_num(region.factor * region.std)) * result.torque_per_unit
    order = np.argsort(-unsure, kind="stable")[:_PARAMETERS]
    margin = 0.35 + 0.062 * max((len(names[k]) for k in order), default=0)
    figure, axes = make_grid(1, 1, max(len(order) * 0.22, 0.8), left=margin)
    ax, y = axes[0, 0], np.arange(len(order))
    for kind, colour, label in ((False, _BLUE, "uncertain, 95 %, all at once"), (True, "#d97706", "... driven by the prior")):
        at = region.prior_driven[order] == kind
        if at.any():
            ax.barh(y[at], unsure[order][at], height=0.62, color=colour, alpha=0.55, lw=0, label=label)
    ax.plot(moves[order], y, "o", ms=4, mfc="white", mec=GREY, label="moved by the value itself")
    list_rows(ax, [names[int(k)] for k in order], 0.55)
    ax.set(xlim=(0.0, None), xlabel="root mean square torque in the fitted motions, at the joint it moves most [N m or N]")
    add_legend(axes)
    return figure


@styled
def remainder_figure(left: Remainder, names: Sequence[str], units: Sequence[str]) -> Figure:
    """99 % of what is left of each joint's torque, by speed."""
    columns = min(len(names), 4)
    rows = -(-len(names) // columns)
    figure, axes = make_grid(rows, columns, 1.2, gap=0.55, used=len(names))
    figure.subplots_adjust(hspace=0.5)  # the numbers below each panel need room
    for j, ax in enumerate(axes.ravel()[: len(names)]):
        edges = np.concatenate([[0.0], left.speeds[j]])
        ax.stairs(left.by_speed[j], edges, fill=True, color=_BLUE, alpha=0.3)
        ax.axhline(left.bound[j], color=PREDICTED, lw=1.1)
        ax.set_title(f"{names[j]} [{units[j]}]")
        ax.set_ylim(bottom=0.0)
        ax.yaxis.set_major_locator(MaxNLocator(3))
        ax.xaxis.set_major_locator(MaxNLocator(4))
        if j + columns >= len(names):
            ax.set_xlabel("speed [rad/s or m/s]")
    return figure


@report_of.register
def bounds_report(result: ControllerBounds) -> str:
    """The report of ``bounds``: an HTML page with all figures inside."""
    known, region, w = result.known, result.region, result.workspace
    robot, wrench = known.problem.experiment.robot, known.problem.channel == "wrench"
    unseen = "A wrench sensor under the base or at the wrist cannot know them: forces inside a joint act on both of its sides "
    rotors = (
        " For geared arms the reflected inertia of the rotors, gear ratio² × rotor inertia, is often the largest term of the "
        "mass matrix: identify it from joint torques, or add the data sheet's value."
    )
    inside = (
        f"**Not in the bounds above:** the {result.inside.unknown} of usual size in the last columns. "
        f"{f'{unseen}and cancel. ' * wrench}Their usual sizes are guesses from the effort limits."
        f"{rotors * ('rotor_inertia' in result.inside.lacking)}"
    )
    drawn = f", and {result.urdfs} files `sampled-….urdf` links drawn within the uncertainty" if result.urdfs else ""
    sections = [
        ShownSection("Parameters of the joint torques, all at once", [
            "The torques that move the links are linear in these parameters, whatever sensor they were identified with. Three "
            "sets hold all of them at once with probability 95 %:",
            bullets([
                f"the box: every parameter within {number(region.factor, 3)} of its standard deviations (by Bonferroni's "
                f"inequality {number(region.bonferroni, 3)});",
                f"the ellipsoid: (b − b̂)′ V⁻¹ (b − b̂) ≤ rho_V², rho_V = {number(region.ellipsoid, 4)};",
                f"the ball: ‖b − b̂‖ ≤ rho = {number(region.rho, 3)}, for Spong's term u = −rho Y′r / ‖Y′r‖. It takes "
                f"{number(result.effort_ratio, 2)} times the torque of the ellipsoid's term u = −rho_V V Y′r / √(r′Y V Y′r), "
                "median over states.",
            ]),
            figure(svg(parameter_figure(result), "region"),
                   "The parameters whose uncertainty makes most torque: bars are half the box, circles the value itself, each "
                   "times what one unit of it moves."),
            _parameters(result),
        ], "Parameters"),
        ShownSection("Mass matrix, Coriolis terms and gravity over the workspace", [
            "Bounds hold at all configurations at once, with probability 95 % each. Draws are robots of bodies that can exist.",
            _workspace(w, matrix_units(robot.prismatic)),
        ], "Workspace"),
        ShownSection("Joint by joint", [
            "Inertia is the diagonal element of the mass matrix, its error relative; gravity and its error are the largest "
            "torques over the workspace, the errors of all joints at once.",
            joints(result), "" if result.inside.complete else inside,
        ], "Joints"),
        ShownSection("Other uncertainty", _remainder(result)),
        ShownSection("Trajectories", [
            *(_trajectory(t, k) for k, t in enumerate(result.trajectories)),
            "" if result.trajectories else "No trajectory was given, and no motion of the experiment moves.",
            note("A band holds what is uncertain of the parameters and what no parameter explains, once each. A standard "
                 f"deviation more than {number(FAR, 2)} times the largest in the fitted motions says that the trajectory asks "
                 "for something they hardly show."),
        ]),
        ShownSection("What it rests on", [bullets(result.assumptions)]),
        how(*_how(result), seconds=result.seconds, packages=("numpy", "scipy"), after=(
            "All numbers are in `bounds.json`, arrays in `bounds.mat`; `identified.urdf` is the robot that "
            f"`{call('identify')}` writes, friction included; what a URDF has no place for, such as rotor inertia, stands in "
            f"its comments and under `identified_urdf`{drawn}.")),
    ]  # fmt: skip
    name, source = known.problem.experiment.name, f"{known.source} ({known.method})"
    of = channel_text(known.problem.channel, known.problem.fitted)
    fine = "No warnings: the data determine what a controller needs, and unseen motions are predicted down to the noise."
    opening = [warnings(result.warnings, fine), lead(_lead(result)), cards(_cards(result))]
    kicker = f"What a controller of {robot.name} may rely on, from the {source} of the {of}"
    return page(name, kicker, opening, sections, f"{name}: bounds for controllers")


def _lead(result: ControllerBounds) -> str:
    region, w = result.region, result.workspace
    driven = int(region.prior_driven.sum())
    text = (
        f"{result.headline} All {len(region.values)} parameters of the joint torques are in one ellipsoid of rho_V = "
        f"{number(region.ellipsoid, 3)}; the model's mass matrix is {number(w.ratio[0], 3)} to {number(w.ratio[1], 3)} times "
        f"the true one over the workspace. All {len(result.links)} robots drawn within the uncertainty can exist, and their "
        "mass matrices are positive definite. "
    )
    sums = int(region.undetermined.sum())
    text += f"{driven} of the parameters are driven by the prior. " if driven else ""
    text += f"Of {sums} parameters the data tell sums only, which is all that torques take of them. " if sums else ""
    text += "The data determine all of the parameters. " if not driven and not sums else ""
    unknown = f"What is inside the joints, {result.inside.unknown}, is not in these bounds."
    return text + unknown * (not result.inside.complete)


def _cards(result: ControllerBounds) -> list[tuple[str, str, str]]:
    w, region = result.workspace, result.region
    mood = "good" if w.alpha < 0.5 else "fair" if w.alpha < 1 else "bad"
    large = [
        (number(region.rho, 3), "rho, radius of the ball (SI units)", ""),
        (number(region.ellipsoid, 3), "rho_V, radius of the ellipsoid", ""),
        (number(w.alpha, 3), "alpha of computed torque, to be below 1", mood),
    ]
    if result.trajectories:
        name, t = result.trajectories[0].name, result.trajectories[0].torque
        widest = float(t.pointwise_half_width.mean() / max(float(np.abs(t.values).mean()), 1e-300))
        large.append((percent(widest, 2), f"mean half width of the pointwise 95 % band, of the torques of ‘{name}’", ""))
    if result.remainder is not None:
        large.append((percent(float(result.remainder.share.max()), 2), "of the worst joint’s torque is not explained", ""))
    return large


def _parameters(result: ControllerBounds) -> ShownTable:
    r, rows = result.region, []
    for k, (value, std) in enumerate(zip(r.values, r.std, strict=True)):
        kind = r.determined_by[k]
        cells = [str(k + 1), r.labels[k], *with_half(value, std), r.units[k], ends(r.low[k], r.high[k])]
        rows.append([*cells, (kind, "dim" if kind == "prior" else "")])
    return ShownTable(
        ["#", "parameter", "value", "± std", "unit", "all at once, 95 %", "determined by"], rows, "nd w nb n ku n -"
    )


def _workspace(w: Workspace, units: MatrixUnits) -> ShownTable:
    rows = [
        ["eigenvalues of the model’s mass matrix relative to the true",
         f"{number(w.ratio[0], 3)} … {number(w.ratio[1], 3)}", "", ""],
        ["alpha = ‖1 − M⁻¹ M̂‖ in the norm of M", number(w.alpha, 3), "", "below 1 for computed torque"],
        ["eigenvalues of the mass matrix", f"{number(w.eigenvalues[0], 3)} … {number(w.eigenvalues[1], 3)}", units.mass,
         "for the tracking bound"],
        ["smallest eigenvalue of any draw", number(w.smallest_drawn, 3), units.mass, "above 0: positive definite"],
        ["‖C(q, v) v‖ / ‖v‖² of the model", number(w.coriolis, 3), units.coriolis, ""],
        ["its error", number(w.coriolis_error, 2), units.coriolis, ""],
        ["‖M⁻¹ (ĝ − g)‖", number(w.acceleration_from_gravity, 2), units.acceleration, "what computed torque leaves at rest"],
        ["‖M⁻¹ (Ĉ − C) v‖ / ‖v‖²", number(w.acceleration_from_coriolis, 2), units.bent, "and in motion"],
    ]  # fmt: skip
    return ShownTable(["quantity", "bound", "unit", "meaning"], rows, "- nb k -", "narrow")


def _remainder(result: ControllerBounds) -> list[Part]:
    """What the model leaves of measured torques."""
    left = result.remainder
    if left is None:
        unread = f"{result.unread[0].upper()}{result.unread[1:]}"
        return [f"**Unknown.** {unread}, so nothing tells how large friction, rotors and flexibility are."]
    names = result.known.problem.experiment.robot.joint_names
    units = result.torque_model.channels.units
    rows = [[n, number(b, 3), u, percent(s, 2)] for n, b, u, s in zip(names, left.bound, units, left.share, strict=True)]
    return [
        f"What the model leaves of the measured torques of {', '.join(left.motions)}, below 10 Hz. It is not parametric: a "
        "controller needs a term of its own for it [Liu and Goldenberg 1996]."
        + ("" if left.held_out else " **These motions were fitted**, which hides some of it."),
        ShownTable(["joint", "99 % of the samples within", "unit", "rms, of the torque"], rows, "k nb k n", "narrow"),
        figure(svg(remainder_figure(left, names, units), "left"),
               "99 % of what is left in five classes of speed, and over all of them (line). Where it grows with speed, "
               "friction is missing."),
    ]  # fmt: skip


def _trajectory(t: TrajectoryBands, index: int) -> Part:
    parts: list[Part] = []
    for k, (title, b) in enumerate((("Joint torques", t.torque), ("Wrench on the sensor", t.wrench))):
        if b is not None:
            parts += [
                f"**{title}**: {bands_of(b)}",
                figure(svg(band_figure(b), f"band-{index}-{k}"),
                       "Predicted readings with both bands; below each, half their widths."),
                band_table(b),
            ]  # fmt: skip
    given = "" if t.given else f" (a motion of the experiment; give another with {argument('trajectories')})"
    return below(f"{t.name}{given}", *parts)


def _how(result: ControllerBounds) -> list[tuple[str, str]]:
    known, w = result.known, result.workspace
    ranges = ", ".join(f"{number(a, 3)} … {number(b, 3)}" for a, b in zip(w.lower, w.upper, strict=True))
    return [
        ("From", f"the {known.source} ({known.method})"),
        ("Covariance", f"{number(known.dispersion * known.held_out_scale, 3)} times that of noise alone"),
        ("Law of the parameters", "normal" if result.region.draws is None else f"{len(result.region.draws)} draws"),
        ("Workspace", f"{w.configurations} points of a Sobol sequence in joint ranges {ranges} rad (or m); {w.draws} draws; "
         f"seed {result.seed}"),
    ]  # fmt: skip


@figures_of.register
def _(_: ControllerBounds) -> Figures:
    return {"band": band_figure}
