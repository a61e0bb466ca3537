"""The case study's page and figures, from results.json."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

sys.path.append(str(Path(__file__).parents[2]))
from tests.studies.page import BLUE, GREEN, GREY, ORANGE, STYLE, table
from tests.studies.page import fill as fill
from tests.studies.page import plain as plain

TRUTH = 2.805  # kg, weighed by those who recorded it
FLANGE = 0.11655  # from the last joint to the flange of a UR10e [m]


def tables(r: dict[str, Any]) -> dict[str, str]:
    """The README's parts, by the name of their marker."""
    out = {name: f"```text\n{text.rstrip()}\n```" for name, text in r["printed"].items()}
    out |= {"friction": _friction(r), "payload": _payload(r), "series": _series(r)}
    gap, error, used = r["changed"]["gap"], r["unloaded"]["error"], r["used"]
    minutes = sum(r["seconds"].values()) / 60.0
    seconds = r["seconds"]
    out["seconds"] = table(
        "command | processor time [s]",
        [f"| `{r['printed'][name].splitlines()[0][2:]}` | {value:.0f} |" for name, value in seconds.items()],
    )
    out |= {
        "minutes": f"{minutes:.0f}", "source": "the clone" if r["clone"] else "ready folders",
        "error": f"{100 * error:.1f} %", "base": str(r["unloaded"]["base_parameters"]),
        "alone-verdict": f"`{r['changed']['alone']['verdict']}`", "alone-named": _names(r["changed"]["alone"]["effects"]),
        "gap-before": f"{gap['before']:.2f}", "gap-after": f"{gap['after']:.2f}", "gap-floor": f"{gap['floor']:.2f}",
        "centre": _centre(r), "needed": f"{r['series']['needed']:.1f}", "hide": _hide(r),
        "simulated": f"{100 * used['error']['with']:.0f} %", "simulated-without": f"{100 * used['error']['without']:.0f} %",
        "expected": f"{100 * r['changed']['curves']['error']['before']:.0f} %", "simulated-on": f"`{used['recording']}`",
        "apart": f"{used['apart']['with']:.1f}", "apart-without": f"{used['apart']['without']:.1f}",
    }  # fmt: skip
    out["again"] = out.get("again", "Not run: ready folders hold one loaded recording only.")
    return out


def _names(effects: list[str]) -> str:
    return ", ".join(f"`{e}`" for e in effects) or "nothing"


def _friction(r: dict[str, Any]) -> str:
    def cell(value: list[float]) -> str:
        return f"{value[0]:.2f} ± {0.5 * (value[2] - value[1]):.2f}"

    rows = [
        f"| {where} | {cell(v['coulomb_friction'])} | {cell(v['viscous_friction'])} |"
        for where, v in r["unloaded"]["friction"].items()
    ]
    return table("joint | Coulomb friction [N m] | viscous friction [N m s/rad]", rows)


def _payload(r: dict[str, Any]) -> str:
    """Every recording in which a payload is named."""
    rows = []
    for w in r["series"]["recordings"]:
        if (p := w["payload"]) is None:
            continue
        inside = "yes" if abs(p["mass"] - TRUTH) <= p["half"] else "no"
        centre = " | ".join(f"{100 * c:.1f} ± {100 * h:.1f}" for c, h in zip(p["centre"], p["centre_half"], strict=True))
        rival = f"{p['rival']['name']}@{p['rival']['where']}, {p['rival']['behind']:.0f} behind"
        rows.append(f"| {w['name']} | {p['mass']:.2f} ± {p['half']:.2f} | {inside} | {centre} | {p['evidence']:.0f} | {rival} |")
    head = "recording | mass [kg] | holds 2.805 kg | centre x [cm] | y [cm] | z [cm] | log evidence | next best"
    return table(head, rows)


def _centre(r: dict[str, Any]) -> str:
    """Distance of the payload's centre from the flange's axis and its plane."""
    found = [(w["name"], w["payload"]["centre"]) for w in r["series"]["recordings"] if w["payload"] is not None]
    return ", ".join(
        f"`{name}` {100 * np.hypot(x, y):.0f} cm and {100 * (z - FLANGE):.0f} cm" for name, (x, y, z) in found
    )  # fmt: skip


def _series(r: dict[str, Any]) -> str:
    rows = [
        f"| {w['name']} | {'yes' if w['loaded'] else 'no'} | {w['verdict'].replace('_', ' ')} | {_names(w['effects'])} | "
        f"{w['evidence']:.1f} | {w['gap']:.2f} | {w['left']:.2f} |"
        for w in r["series"]["recordings"]
    ]
    return table("recording | payload on | verdict | named | largest log evidence | gap | left", rows)


def _hide(r: dict[str, Any]) -> str:
    found = [(where.partition("@")[2], v) for where, v in r["series"]["hide"].items() if v is not None]
    return ", ".join(f"{f'{v:.0f}' if v >= 100.0 else f'{v:.2g}'} kg at {where}" for where, v in sorted(found))


def draw(r: dict[str, Any], folder: Path) -> None:
    """All figures."""
    with mpl.rc_context(STYLE):
        for name, figure in (("torques", _torques(r)), ("closed", _closed(r)), ("watch", _watch(r))):
            figure.savefig(folder / f"{name}.png", dpi=110, facecolor="white", metadata={"Software": None})


def _torques(r: dict[str, Any]) -> Figure:
    """What the unloaded arm's model leaves of the loaded recording's torques, before and after."""
    c = r["changed"]["curves"]
    figure = Figure(figsize=(9.0, 5.6), layout="constrained")
    axes = figure.subplots(3, 2, sharex=True).T.ravel()
    for j, ax in enumerate(axes):
        for name, colour, label in (("before", ORANGE, "the unloaded arm's model"), ("after", BLUE, "with the payload named")):
            ax.plot(c["times"], c[name][j], color=colour, lw=0.9, label=label)
        ax.set_title(f"joint {j + 1}: {c['rms']['before'][j]:.2g} N m rms, then {c['rms']['after'][j]:.2g}", fontsize=9)
        ax.set_ylabel("N m")
    for ax in axes[[2, 5]]:
        ax.set_xlabel("time [s]")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=2, frameon=False,
                  title="recorded torque less what is predicted by")  # fmt: skip
    return figure


def _closed(r: dict[str, Any]) -> Figure:
    """Two panels: what each change closes of the gap, and the evidence of every candidate."""
    gap, scores = r["changed"]["gap"], r["changed"]["scores"]
    figure = Figure(figsize=(9.0, 3.0), layout="constrained")
    left, right = figure.subplots(1, 2)
    steps = [("unloaded arm's model", gap["before"]), *((f"+ {s['name']}", s["after"]) for s in gap["steps"])]
    steps += [("+ friction, gains\nwithin tolerance", gap["after"]), ("own fit (floor)", gap["floor"])]
    squares = np.square([v for _, v in steps])
    places = np.arange(len(steps))
    left.barh(places[0], squares[0], color=ORANGE)
    left.barh(places[-1], squares[-1], color=GREY)
    for k in places[1:-1]:
        low, high = sorted((squares[k - 1], squares[k]))
        left.barh(k, low, color="#e5e7eb")
        left.barh(k, high - low, left=low, color=GREEN if squares[k] <= squares[k - 1] else ORANGE)
    for k, (_, value) in enumerate(steps):
        end = squares[k] if k in (0, len(steps) - 1) else max(squares[k - 1], squares[k])
        left.text(end + 0.01 * squares[0], k, f"{value:.2f}", va="center", fontsize=8)
    left.set_yticks(places, [name for name, _ in steps])
    left.set(xlabel="mean square on held-out parts; rms beside bars", xlim=(0.0, 1.12 * squares.max()))
    left.set_title("gap, and what closes it", fontsize=9)
    places = np.arange(len(scores))
    named = set(r["changed"]["effects"])
    right.barh(places, [v for _, v in scores], color=[GREEN if name in named else GREY for name, _ in scores])
    right.set_yticks(places, [name for name, _ in scores])
    right.set_xlabel("log evidence of each change on its own")
    right.set_title("candidates", fontsize=9)
    for ax in (left, right):
        ax.invert_yaxis()
        ax.grid(False, axis="y")
    return figure


def _watch(r: dict[str, Any]) -> Figure:
    """The series over time."""
    rows = r["series"]["recordings"]
    x = np.arange(len(rows))
    colours = [ORANGE if w["loaded"] else BLUE for w in rows]
    figure = Figure(figsize=(9.0, 5.0), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True)
    evidence = [max(w["evidence"], 0.02) for w in rows]
    upper.vlines(x, 0.01, evidence, color=colours, lw=1.2)
    upper.scatter(x, evidence, c=colours, s=28, zorder=3)
    needed = r["series"]["needed"]
    upper.axhline(needed, color=GREY, ls="--", lw=1.0)
    upper.text(0.3, 1.15 * needed, "needed to be named", va="bottom", fontsize=8, color=GREY)
    upper.set_yscale("log")
    upper.set(ylabel="largest log evidence\nof a change", ylim=(0.01, None))
    for k, w in enumerate(rows):
        p = w["payload"]
        if p is None:
            lower.plot(k, 0.0, "o", ms=5, mfc="white", color=colours[k])
        else:
            lower.errorbar(k, p["mass"], p["half"], fmt="o", ms=5, capsize=3, color=colours[k])
    lower.axhline(TRUTH, color=GREY, ls="--", lw=1.0)
    lower.text(0.3, TRUTH + 0.06, f"weighed: {TRUTH} kg", va="bottom", fontsize=8, color=GREY)
    lower.set(ylabel="payload named [kg]", ylim=(-0.3, 3.6))
    lower.set_xticks(x, [w["name"] for w in rows], rotation=30, ha="right")
    for ax in (upper, lower):
        ax.grid(False, axis="x")
    handles = [Line2D([], [], marker="o", ls="", color=c) for c in (ORANGE, BLUE)]
    figure.legend(handles, ["payload on", "no payload"], loc="outside upper center", ncols=2, frameon=False)
    return figure
