"""The case study's tables and figures."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

import bayesid.design.bounds.bands as bands

sys.path.append(str(Path(__file__).parents[2]))
from tests.studies.page import BLUE, GREEN, GREY, ORANGE, STYLE, table
from tests.studies.page import fill as fill
from tests.studies.page import plain as plain

COLOURS = {
    "computed torque, drawing": ORANGE, "computed torque, identified": GREY, "robust, ellipsoid": BLUE, "robust, ball": GREEN,
}  # fmt: skip


def tables(r: dict[str, Any]) -> dict[str, str]:
    """The README's parts, by the name of their marker."""
    p, e, b, w = r["plan"], r["estimate"], r["bounds"], r["workspace"]
    sets = [
        f"| {s['readings']} | {s['rank']} | {s['better_than_size']} | {_shown(s['condition_number'])} |" for s in p["sensor_sets"]
    ]
    rows = [
        f"| {j + 1} | {largest:.1f} | {half:.2g} | {far:.2g} | {error if error > 1e-9 else 0:.2g} |"
        for j, (largest, half, far, error) in enumerate(
            zip(b["largest_torque"], b["half_band"], b["extrapolation"], w["gravity_error"], strict=True)
        )
    ]
    control = [
        f"| {name} | {1e3 * c['largest_error']:.3g} | {1e3 * c['rms_error']:.3g} | "
        + (f"{1e3 * min(c['bound']):.3g} … {1e3 * max(c['bound']):.3g} | {'yes' if c['kept'] else 'no'} "
           f"({100 * c['largest_share_of_bound']:.2g} % of it) |" if c["bound"] else "– | – |")
        for name, c in r["control"].items()
    ]  # fmt: skip
    missing = [
        f"| {m['effect']} ({m['where']}) | {m['largest_sigmas']:.0f} | {100 * m['prediction']:.2g} % |"
        for m in r["susceptibility"]
    ]
    sentences = {
        "plan": [
            f"The optimal motion keeps all limits: {'yes' if p['within_limits'] else 'no'}. Expected standard deviations are",
            f"{p['gain_over_random']:.2g} times smaller than with the best of 20 random motions within the same limits; their",
            f"median is {p['median_std_ratio']:.2g} times smaller than with one random motion.",
        ],
        "estimate": [
            f"Of {e['base_parameters']} base parameters {100 * e['within_95']:.0f} % are within their 95 % interval, with a root",
            f"mean square error of {e['rms_z']:.2f} standard deviations; of {e['drives']} numbers inside the joints",
            f"{100 * e['drives_within_95']:.0f} %. The motion that was not fitted is predicted to {e['validation_whitened']:.3f}",
            f"times the noise ({e['validation_expected']:.3f} expected).",
        ],
        "sets-of-parameters": [
            f"All {b['parameters']} parameters of the joint torques at once, {b['prior_driven'] or 'none'} of them driven by the",
            "prior:",
            f"rho_V = {b['rho_V']:.2f}, and the truth is at {b['distance']:.2f}; rho = {b['rho']:.2g}, and the truth is at",
            f"{b['norm']:.2g}; the truth is {'in' if b['in_box'] else 'outside'} the box. The ball's term takes",
            f"{b['effort_ratio']:.2g} times the torque of the ellipsoid's.",
        ],
        "mass": [
            f"The model's mass matrix is {w['ratio'][0]:.3f} to {w['ratio'][1]:.3f} times the true one, alpha =",
            f"{w['alpha']:.3f}. At 200 other configurations it really is {w['true_ratio'][0]:.3f} to",
            f"{w['true_ratio'][1]:.3f} times, {w['true_alpha']:.3f} off. The smallest eigenvalue of any drawn mass matrix is",
            f"{w['smallest_eigenvalue_of_draws']:.3g} kg m².",
        ],
        "band": [
            f"The band of the task {'holds' if b['band_holds'] else 'does not hold'} the true torques of all",
            f"{len(b['half_band'])} joints at all times.",
        ],
    }
    return {name: "\n".join(lines) for name, lines in sentences.items()} | {
        "sets": table("readings | rank | known better than a link's size | condition number", sets),
        "missing": table("effect left out | largest bias [standard deviations] | error of predictions", missing),
        "torques": table(
            "joint | largest torque [N m] | half of the simultaneous band, largest [N m] | std over that of the fitted motion | "
            "gravity's error [N m]",
            rows,
        ),
        "control": table("controller | largest error [mrad] | rms [mrad] | bounds of the joints [mrad] | kept", control),
    }


def _shown(value: float | None) -> str:
    return "–" if value is None else f"{value:.3g}"


def torque_figure(band: bands.Band, true: np.ndarray, path: Path) -> None:
    """True torques of the task less those predicted, beside the band."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(9.0, 5.2), layout="constrained")
        axes = figure.subplots(2, 4, sharex=True).ravel()
        for j, ax in enumerate(axes[: len(band.names)]):
            half = band.factor * band.std[:, j]
            ax.fill_between(band.times, -half, half, color=BLUE, alpha=0.25, lw=0, label="95 %, whole motion")
            ax.plot(band.times, true[:, j] - band.values[:, j], color=ORANGE, lw=1.1, label="true less predicted")
            ax.set_title(f"joint {j + 1} [N m]", fontsize=9)
        for ax in axes[3:]:
            ax.set_xlabel("time [s]")
            ax.tick_params(labelbottom=True)
        axes[-1].axis("off")
        axes[-1].legend(*axes[0].get_legend_handles_labels(), loc="center", frameon=False)
        figure.savefig(path, dpi=110, facecolor="white", metadata={"Software": None})


def tracking_figure(curves: dict[str, np.ndarray], control: dict[str, Any], path: Path) -> None:
    """Largest error of all joints over time, and the bounds of the robust controllers."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(9.0, 4.0), layout="constrained")
        ax = figure.subplots()
        for name, colour in COLOURS.items():
            worst = np.maximum(1e3 * np.abs(curves[name]).max(axis=1), 1e-6)
            ax.semilogy(curves["times"][1:], worst[1:], color=colour, lw=1.3, label=name)
            if control[name]["bound"]:
                lowest = 1e3 * min(control[name]["bound"])
                ax.axhline(lowest, color=colour, lw=1.0, ls="--", label=f"{name}: smallest joint's bound")
        ax.set(xlabel="time [s]", ylabel="largest error of a joint [mrad]", ylim=(1e-4, None))
        figure.legend(loc="outside right upper", frameon=False, fontsize=8)
        figure.savefig(path, dpi=110, facecolor="white", metadata={"Software": None})
