"""The case study's tables and figures."""

from __future__ import annotations

import sys
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

sys.path.append(str(Path(__file__).parents[2]))
from tests.studies.page import BLUE, GREY, ORANGE, STYLE, table
from tests.studies.page import fill as fill
from tests.studies.page import plain as plain


def tables(results: dict) -> dict[str, str]:
    """The README's tables, by the name of their marker."""
    out = {}
    rows = [
        f"| {r['label']} | {r['truth']:.4f} | {r['value']:.4f} | {r['low']:.4f} to {r['high']:.4f} | {r['sigmas']:+.1f} "
        f"| {r['paper']:.4f} |"
        for r in results["twelve"]
    ]
    out["twelve"] = table("parameter | truth | estimate | 95 % interval | error / sigma | printed 1998, other arm", rows)
    rows = [
        f"| {name} | {v:.3g} | {100 * results['verification']['nrmse'][name]:.2g} % |"
        for name, v in results["verification"]["rmse"].items()
    ]
    out["verification"] = table("channel | error rms [N, N m] | relative error", rows)
    rows = [
        f"| {drives} | {name} | {100 * r['torque_error']:.2g} % | {100 * r['relative_error']:.2g} % "
        f"| {r['rms_sigmas']:.3g} | {r['worst_sigmas']:.3g} |"
        for drives, ways in results["claim"].items() for name, r in ways.items()
    ]  # fmt: skip
    out["claim"] = table(
        "drives have | estimated from | error of frictionless torque | error of parameters | rms error / sigma | worst / sigma",
        rows,
    )
    rows = [
        f"| {name} | {r['rms_sigmas']:.3g} | {r['worst_sigmas']:.3g} | {r['covered']} of 12 "
        f"| {100 * r['force_error']:.2g} % | {100 * r['moment_error']:.2g} % | {100 * r['bias']:.2g} % |"
        for name, r in results["recipes"].items()
    ]
    out["recipes"] = table(
        "row_model | rms error / sigma | worst / sigma | own 95 % intervals that hold the truth | force error | moment error "
        "| moment error without noise",
        rows,
    )
    printed = results["printed"]
    out["printed"] = f"No links that can exist were found in {printed['projections']} projections; not repeated."
    if printed["found"]:
        rows = [
            f"| {r['label']} | {r['truth']:.4f} | {r['value']:.4f} | {r['low']:.4f} to {r['high']:.4f} | {r['sigmas']:+.1f} |"
            for r in printed["twelve"]
        ]
        inside = sum(abs(r["sigmas"]) <= 1.96 for r in printed["twelve"])
        out["printed"] = (
            "The links nearest to the PUMA 560's with these twelve numbers "
            f"{'cannot' if printed['projections'] else 'can'} exist; "
            f"after {printed['projections']} projection(s)\nonto bodies that can, links of {printed['masses'][0]:.1f} kg and "
            f"{printed['masses'][1]:.1f} kg have them exactly. {inside} of 12 intervals hold the truth.\n\n"
            + table("parameter | truth: printed 1998 | estimate | 95 % interval | error / sigma", rows)
        )
    if results["repeats"]:
        again = results["repeats"]
        worst = again["worst_sigmas"]
        rows = [f"| {name} | {100 * e:.2g} % | {worst[name]:.3g} |" for name, e in again["torque_error"].items()]
        out["repeats"] = (
            f"{again['count']} repeats with fresh noise: {100 * again['coverage']:.3g} % of the wrench's 95 % intervals "
            "hold the truth.\n\n"
            + table("estimated from | median error of frictionless torque | worst error / sigma of all", rows) + "\n\n"
            + table(
                "row_model | rms error / sigma | own 95 % intervals that hold the truth",
                [f"| {name} | {r['rms_sigmas']:.3g} | {100 * r['coverage']:.3g} % |" for name, r in again["recipes"].items()],
            )
        )  # fmt: skip
    count = results["machine"]["encoder_count_rad"]
    out["machine"] = (
        f"One encoder count is {count[0]:.4g} rad at joint 1 and {count[1]:.4g} rad at joint 2. "
        f"The motions last {results['machine']['seconds'][0]:.0f} s and {results['machine']['seconds'][1]:.1f} s."
    )
    step, offset = results["machine"]["step_s"], results["machine"]["offset"]
    largest = [max(abs(offset[f"{kind}{axis}"]) for axis in "xyz") for kind in "fm"]
    out |= {"step": f"{1000 * step:g} ms", "half-step": f"{500 * step:g} ms"}
    out["offset"] = f"{largest[0]:g} N and {largest[1]:g} N m"
    return out


def figures(results: dict, parts: dict, folder: Path) -> None:
    """Draw the motions, the paper's figure 5 and the torques that the estimates predict."""
    setting = parts["setting"]
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(8, 2.5), layout="constrained")
        axes = figure.subplots(1, 2, sharey=True)
        for ax, motion in zip(axes, setting.motions, strict=True):
            for j, colour in enumerate((BLUE, ORANGE)):
                ax.plot(motion.times, motion.positions[:, j], color=colour, label=f"q{j + 1}")
            ax.set(xlabel="time [s]", title=motion.name)
        axes[0].set_ylabel("joint angle [rad]")
        figure.legend(*axes[0].get_legend_handles_labels(), loc="outside right center", frameon=False)
        _save(figure, folder / "motions.png")

        prediction = parts["prediction"]
        figure = Figure(figsize=(8, 5.6), layout="constrained")
        axes = figure.subplots(3, 2, sharex=True)
        for k, ax in enumerate(axes.T.ravel()):
            ax.plot(prediction.times, prediction.measured[:, k], color=GREY, lw=1.0, label="measured")
            ax.plot(prediction.times, prediction.predicted[:, k], color=BLUE, lw=1.0, ls="--", label="predicted")
            ax.set_ylabel(f"{prediction.channel_names[k]} [{prediction.channel_units[k]}]")
        for ax in axes[-1]:
            ax.set_xlabel("time [s]")
        figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=2, frameon=False)
        _save(figure, folder / "figure5.png")

        figure = Figure(figsize=(8, 4.2), layout="constrained")
        axes = figure.subplots(2, 1, sharex=True)
        truth = setting.torque(setting.torque_base.matrix @ setting.setup.robot.nominal.ravel())
        times = setting.motions[1].times
        shown = {"torques, no friction model": ORANGE, "base wrench": BLUE}
        for j, ax in enumerate(axes):
            ax.plot(times, truth[:, j], color=GREY, lw=2.5, alpha=0.6, label="truth")
            for name, colour in shown.items():
                values = np.asarray(results["claim"]["friction"][name]["values"])
                ax.plot(times, setting.torque(values)[:, j], color=colour, lw=1.0, label=f"estimated from {name}")
            ax.set_ylabel(f"joint {j + 1} [N m]")
        axes[-1].set_xlabel("time [s]")
        figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=3, frameon=False)
        _save(figure, folder / "torques.png")


def _save(figure, path: Path) -> None:
    figure.savefig(path, dpi=110, metadata={"Software": None})
