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

ANSWERS = {
    "nominal": "the CAD model as it is",
    "nominal + effects": "the CAD model with friction fitted",
    "wls": "plain least squares, weighted",
    "huber": "robust (Huber)",
    "student": "robust (Student)",
    "prior": "a prior alone (the CAD model, with the stated standard deviation)",
    "sdp, hardly a prior": "physical consistency with a very wide prior",
    "sdp": "both, `sdp` as it comes",
}
NAMES = {
    "nominal": "CAD",
    "nominal + effects": "CAD, friction fitted",
    "sdp, hardly a prior": "sdp, wide prior",
    "sdp, trust from the data": "sdp, prior from the data",
}


def tables(results: dict) -> dict[str, str]:
    """The README's parts, by the name of their marker."""
    out = {name: _errors(results[name]) for name in ("friction", "rigid", "swapped")}
    speeds, seconds = results["speeds"], results["seconds"]
    out["motions"] = "\n".join(
        f"- `{name}`: {seconds[name]:.1f} s, joint speed {speed:.2f} rad/s rms." for name, speed in speeds.items()
    )
    trusts = results["trusts"]
    out["trusts"] = table(
        "prior relative standard deviation | " + " | ".join(trusts),
        ["| error | " + " | ".join(f"{100 * e:.1f} %" for e in trusts.values()) + " |"],
    )
    if results["trust_from_data"] is not None:
        found = results["trust_from_data"]
        out["trusts"] += f"\n\nThe fitted motion alone is most probable with a prior relative standard deviation of {found:.2g}."
    rows = results["friction"]["rows"]
    out["fit"] = f"{100 * rows['wls']['fit']:.0f} %"
    out["stated"], out["stated-number"] = f"{100 * results['stated_trust']:.0f} %", f"{results['stated_trust']:g}"
    out["block"] = f"{results['block_s']:g} s"
    out["answer"] = "\n".join(_answer(name, rows[name]) for name in ANSWERS if name in rows)
    return out


def _answer(name: str, row: dict) -> str:
    text = f"- {ANSWERS[name]}: {100 * row['error']:.1f} %"
    return text + (f", {_interval(row['cad'])} points against CAD" if "cad" in row else "") + "."


def _errors(judged: dict) -> str:
    tuned = "nominal + effects" in judged["rows"]
    head = "estimator | fitted motion | other motion | against CAD [points], 95 % interval"
    head += " | against CAD, friction fitted" if tuned else ""
    refitted = any(r["refit_std"] is not None for r in judged["rows"].values())
    head += (" | refit s.d. [points]" if refitted else "") + " | links can exist"
    rows = []
    for name, r in judged["rows"].items():
        cells = [NAMES.get(name, name), f"{100 * r['fit']:.1f} %", f"{100 * r['error']:.1f} %"]
        cells += [_interval(r[key]) if key in r else "" for key in (("cad", "tuned") if tuned else ("cad",))]
        if refitted:
            cells.append("" if r["refit_std"] is None or name == "nominal" else f"{100 * r['refit_std']:.1f}")
        cells.append("yes" if r["consistent"] else f"no: {len(r['impossible'])} cannot")
        rows.append("| " + " | ".join(cells) + " |")
    text = table(head, rows)
    return text + "".join(f"\n\n`{name}` refused: {why}." for name, why in judged["refused"].items())


def _interval(row: dict) -> str:
    return f"{100 * row['difference']:+.1f} ({100 * row['low']:+.1f} to {100 * row['high']:+.1f})"


def figure(results: dict, path: Path) -> None:
    """Draw the difference to CAD on the other motion, in both directions."""
    with mpl.rc_context(STYLE):
        picture = Figure(figsize=(8.5, 3.8), layout="constrained")
        axes = picture.subplots(1, 2, sharey=True)
        shown = (("friction", "fitted: the slower motion"), ("swapped", "fitted: the faster motion"))
        for ax, (key, title) in zip(axes, shown, strict=True):
            rows = {n: r for n, r in results[key]["rows"].items() if "cad" in r}
            for k, r in enumerate(rows.values()):
                colour = BLUE if r["consistent"] else ORANGE
                ax.plot([100 * r["cad"]["low"], 100 * r["cad"]["high"]], [k, k], color=colour, lw=2)
                ax.plot(100 * r["cad"]["difference"], k, "o", color=colour, ms=5)
            ax.axvline(0, color=GREY, lw=1)
            ax.set_yticks(range(len(rows)), [NAMES.get(n, n) for n in rows])
            ax.set(xlabel="error less CAD's on the other motion [points]", title=title)
        axes[0].invert_yaxis()
        for colour, label in ((BLUE, "links can exist"), (ORANGE, "links cannot exist")):
            axes[1].plot([], [], "o-", color=colour, label=label)
        picture.legend(*axes[1].get_legend_handles_labels(), loc="outside lower center", ncols=2, frameon=False)
        picture.savefig(path, dpi=110, facecolor="white", metadata={"Software": None})
