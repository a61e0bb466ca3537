"""The case study's tables and figure."""

from __future__ import annotations

import sys
from pathlib import Path

import matplotlib as mpl
from matplotlib.figure import Figure

sys.path.append(str(Path(__file__).parents[2]))
from tests.studies.page import BLUE, GREY, ORANGE, STYLE, table
from tests.studies.page import fill as fill
from tests.studies.page import plain as plain


def tables(results: dict) -> dict[str, str]:
    """The README's parts, by the name of their marker."""
    cases = results["cases"]
    rows = [
        f"| {_about(c)} | {c['d2']:+.4f} | yes | {c['lower']:.3f} to {c['upper']:.3f} "
        f"| {c['masses'][0]:.2f} and {c['masses'][1]:.2f} | {_range(c['link_2'])} |"
        for c in cases.values()
    ]
    # Bodies without positive pseudo-inertias or without the printed numbers would have stopped the script.
    out = {
        "masses": table(
            "I2 is about | d2 [m] | possible | least moving mass [kg], certified between | link 1 and link 2 there [kg] "
            "| any mass of link 2 [kg]",
            rows,
        ),
        "hand": f"That is {results['by_hand']:.2f} kg.",
    }
    # Of all readings with d2 < 0 the smallest bound, rounded down: a bound still. The reading with d2 > 0 that weighs most.
    least = min(c["lower"] for c in cases.values() if c["d2"] < 0), max(c["lower"] for c in cases.values())
    out["least"], out["least-positive"] = (f"{int(value)} kg" for value in least)
    radii = list(next(iter(cases.values()))["balls"])
    out["balls"] = table(
        "I2 is about | d2 [m] | anywhere | " + " | ".join(f"within {r} m" for r in radii),
        [
            f"| {_about(c)} | {c['d2']:+.4f} | {c['upper']:.2f} | "
            + " | ".join(f"{c['balls'][r]['upper']:.2f}" for r in radii) + " |"
            for c in cases.values()
        ],
    )  # fmt: skip
    errors = list(next(iter(cases.values()))["errors"])
    out["errors"] = table(
        "I2 is about | d2 [m] | as printed | " + " | ".join(f"within {e}" for e in errors),
        [
            f"| {_about(c)} | {c['d2']:+.4f} | {c['lower']:.2f} | "
            + " | ".join(f"{c['errors'][e]['lower']:.2f}" for e in errors) + " |"
            for c in cases.values()
        ],
    )  # fmt: skip
    offsets = list(results["alone"])
    out["alone"] = table(
        "parameter | printed | " + " | ".join(f"possible for d2 = {float(d):+.4f}" for d in offsets),
        [
            f"| {label} | {value:.4f} | " + " | ".join(_interval(results["alone"][d][k]) for d in offsets) + " |"
            for k, (label, value) in enumerate(results["printed"].items())
        ],
    )
    shares = results["common_error"]
    moments = results["second_moments"]
    out["margin"] = (
        "\n".join(
            f"For d2 = {float(d):+.4f} m the eigenvalues of Q are {', '.join(f'{v:.3f}' for v in moments[d])} kg m^2.\nAll "
            f"numbers may be wrong by {100 * shares[d]:.1f} % each, in any combination, and stay possible."
            for d in offsets
        )
        + f"\nRounding is at most {100 * 5e-5 / min(abs(v) for v in results['printed'].values()):.1g} % of any printed number."
    )
    first = next(iter(cases.values()))
    out["prices"] = table(
        "parameter | printed | price | printed times price [kg]",
        [
            f"| {label} | {value:.4f} | {price:.4f} | {value * price:.4f} |"
            for (label, value), price in zip(results["printed"].items(), first["prices"], strict=True)
        ]
        + [f"| sum | | | {sum(v * y for v, y in zip(results['printed'].values(), first['prices'], strict=True)):.4f} |"],
    )
    kept = [c["with_puma_560_link_2"] for c in cases.values()]
    mass = results["puma_560_from_link_2"]
    out["puma"] = "\n".join(
        [
            f"Links 2 to 6 of a PUMA 560 weigh {mass:.2f} kg [Armstrong1986]. If link 2 had that mass:",
            "",
            *(
                f"- I2 about {_about(c)}, d2 = {c['d2']:+.4f} m: "
                + (f"link 1 would weigh at least {k - mass:.2f} kg." if k is not None else "the twelve would be impossible.")
                for c, k in zip(cases.values(), kept, strict=True)
            ),
        ]
    )
    return out


def _about(case: dict) -> str:
    return "the elbow" if case["elbow"] else "joint 2"


def _range(limits) -> str:
    low, high = limits
    return f"{low:.2f} or more" if high is None else f"{low:.2f} to {high:.2f}"


def _interval(limits) -> str:
    low, high = limits
    if low is None and high is None:
        return "any"
    if low is None or high is None:
        return f"below {high:.4f}" if low is None else f"above {low:.4f}"
    return f"{low:.4f} to {high:.4f}"


def figure(results: dict, path: Path) -> None:
    """Draw what the least mass depends on."""
    curves = results["curves"]

    def look(name: str) -> dict:
        return {"color": BLUE if name.startswith("joint") else ORANGE, "ls": "--" if "= 0." in name else "-"}

    with mpl.rc_context(STYLE):
        picture = Figure(figsize=(9.5, 3.2), layout="constrained")
        left, middle, right = picture.subplots(1, 3)
        for name, rows in curves["trade"].items():
            left.plot(*zip(*rows, strict=True), **look(name), label=f"I2 about {name} m")
        left.axvline(results["puma_560_from_link_2"], color=GREY, lw=1, ls=":", label="links 2 to 6, PUMA 560")
        left.set(xlabel="mass of link 2 [kg]", ylabel="least mass of link 1 [kg]", xlim=(0, 30), ylim=(0, 70))
        for name, rows in curves["offset"].items():
            middle.plot(*zip(*rows, strict=True), color=BLUE if name == "joint 2" else ORANGE)
        for d2 in (-0.2435, 0.2435):
            middle.axvline(d2, color=GREY, lw=1, ls=":")
        middle.set(xlabel="d2 [m]", ylabel="least moving mass [kg]", ylim=(0, 90))
        for name, rows in curves["ball"].items():
            right.plot(*zip(*rows, strict=True), **look(name))
        right.set(xlabel="links' reach from their joints [m]", ylabel="least moving mass [kg]", ylim=(0, 90), xlim=(0.25, 2))
        picture.legend(*left.get_legend_handles_labels(), loc="outside lower center", ncols=3, frameon=False)
        picture.savefig(path, dpi=110, facecolor="white", metadata={"Software": None})
