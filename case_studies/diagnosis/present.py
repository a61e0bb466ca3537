"""The case study's tables and figures."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

sys.path.append(str(Path(__file__).parents[2]))
from tests.studies.page import BLUE, GREEN, GREY, ORANGE, STYLE, table
from tests.studies.page import fill as fill
from tests.studies.page import plain as plain

ROBOTS = {"kuka-lwr4": "KUKA LWR4+", "ur10": "UR10"}
MODELS = {"rigid": "rigid bodies", "friction": "friction and offsets stated"}
COLOURS = {"named": ORANGE, "ambiguous": "#f59f00", "unknown": BLUE, "nothing_missing": GREY, "named_in_part": GREEN}


def tables(results: dict[str, Any]) -> dict[str, str]:
    """The README's parts, by the name of their marker; those that have results."""
    out: dict[str, str] = {}
    if "hose" in results:
        out |= _hose(results["hose"])
    if "robot" in results:
        out |= _robot(results["robot"])
    if "wrist" in results:
        out |= _wrist(results["wrist"])
    if "failure" in results:
        out |= _failure(results["failure"])
    return out


def verdict(case: dict[str, Any]) -> str:
    return f"`{case['verdict']}`"


def gap(case: dict[str, Any]) -> str:
    g = case["gap"]
    return f"{g['before']:.3g} | {g['after']:.3g} | {g['floor']:.3g}"


def counted(case: dict[str, Any]) -> str:
    """Effects tried, by name with the joints or axes they are at."""
    places: dict[str, list[str]] = {}
    for t in case["tried"]:
        name, where = t["effect"].split("@")
        places.setdefault(name, []).append(where)
    lines = []
    for name, at in places.items():
        joints = [x.removeprefix("joint") for x in at]
        if all(x.isdigit() for x in joints):
            lines.append(f"{name} at joint{'s' if len(at) > 1 else ''} {', '.join(sorted(joints))}")
        else:
            lines.append(name if at == ["sensor"] else f"{name} at {', '.join(at)}")
    return "; ".join(lines) or "nothing"


def _hose(h: dict[str, Any]) -> dict[str, str]:
    before, after = h["base_before"], h.get("base_after")
    worst = max(before, key=lambda r: abs(r["sigmas"]))
    moved = sum(abs(r["sigmas"]) > 3 for r in before)
    text = (
        f"Without the hose, {moved} of {len(before)} base parameters are wrong by more than three of their own standard "
        f"deviations, the worst (`{worst['name']}`) by {abs(worst['sigmas']):.0f}."
    )
    if after:
        text += (
            f" With the `model.toml` that `diagnose` wrote, the worst is off by {max(abs(r['sigmas']) for r in after):.1f}, and "
            f"{sum(abs(r['sigmas']) < 1.96 for r in after)} of {len(after)} 95 % intervals hold the truth."
        )
    rows = [
        f"| `{r['name']}` | {r['truth']:.4f} | {r['value']:.4f} | {r['sigmas']:+.1f} |"
        + (f" {after[k]['value']:.4f} | {after[k]['sigmas']:+.1f} |" if after else " | |")
        for k, r in enumerate(before)
    ]
    head = "base parameter | truth | without the hose | error / sigma | with `model.toml` | error / sigma"
    inside = sum(abs(p["value"] - p["truth"]) <= 1.96 * p["std"] for p in h["parameters"])
    said = (
        f"Verdict {verdict(h)}: `{', '.join(h['named'])}`. On the unseen motion the residual goes from "
        f"{h['gap']['before']:.3g} to {h['gap']['after']:.3g} times the noise; a complete model would leave "
        f"{h['gap']['floor']:.3g}. "
        f"{inside} of {len(h['parameters'])} intervals hold the truth."
    )
    values = [
        f"| {p['name']} | {p['unit']} | {p['truth']:g} | {p['value']:.4f} | "
        f"{p['value'] - 1.96 * p['std']:.4f} to {p['value'] + 1.96 * p['std']:.4f} |"
        for p in h["parameters"]
    ]
    return {
        "hose-base": text + "\n\n" + table(head, rows),
        "hose-said": said + "\n\n" + table("parameter | unit | truth | found | 95 % interval", values),
    }


def _robot(robots: dict[str, Any]) -> dict[str, str]:
    rows, places = [], []
    for name, cases in robots.items():
        for model, c in cases.items():
            share = 1 - (c["gap"]["after"] / c["gap"]["before"]) ** 2
            rows.append(
                f"| {ROBOTS[name]} | {MODELS[model]} | {verdict(c)} | {counted(c)} | {c['fitted']['before']:.3g} | "
                f"{c['fitted']['after']:.3g} | {gap(c)} | {c['floor_source']} | {100 * share:.0f} % |"
            )  # fmt: skip
            channels = c["gap"]["channels"]
            places.append(
                f"| {ROBOTS[name]} | {MODELS[model]} | " + " | ".join(f"{b:.3g}, {a:.3g}" for b, a in channels.values())
                + " |" * (8 - len(channels))
            )  # fmt: skip
    head = "arm | model | verdict | named, or best attempt | fitted motion before | after | unseen before | after | floor"
    head += " | floor from | squared residual gone"
    return {
        "robot": table(head, rows),
        **_sentences(robots),
        "robot-joints": table("arm | model | " + " | ".join(f"joint {j}" for j in range(1, 8)), [r.rstrip() for r in places]),
    }


def _sentences(robots: dict[str, Any]) -> dict[str, str]:
    """Numbers of the text beside the table."""
    kuka, ur10 = robots["kuka-lwr4"]["rigid"], robots["ur10"]["rigid"]
    left = {name.removeprefix("tau"): after for name, (_, after) in kuka["gap"]["channels"].items()}
    worst = sorted(sorted(left, key=left.__getitem__)[-2:])
    return {
        "kuka-unseen": f"{kuka['gap']['before']:.1f}",
        "kuka-after": f"{kuka['gap']['after']:.1f}",
        "kuka-fitted": f"{kuka['fitted']['after']:.1f}",
        "kuka-joints": " and ".join(worst),
        "ur10-share": f"{100 * (1 - (ur10['gap']['after'] / ur10['gap']['before']) ** 2):.0f} %",
        "ur10-fitted": f"{ur10['fitted']['after']:.1f}",
        "ur10-unseen": f"{ur10['gap']['after']:.1f}",
    }


def _wrist(wrist: dict[str, Any]) -> dict[str, str]:
    rows, lines = [], []
    for motion, w in wrist.items():
        for key, label in (("nothing_known", "nothing"), ("offset_known", "`sensor_offset`")):
            c = w[key]
            rows.append(f"| {motion} | {label} | {verdict(c)} | {counted(c)} | {c['fitted']['after']:.3g} | {gap(c)} |")
        spans = [f"{a:.2f} to {b:.2f} s" for windows in w["rejected"].values() for a, b in windows]
        jolt = np.argsort(w["jolts"])[::-1][:3]
        at = ", ".join(f"{w['jolt_starts'][k]:.2f} s ({w['jolts'][k]:.2g})" for k in jolt)
        below = [d for d in w["offset_known"]["where"] if d["looks_like"] is None]
        whole = sum(d["start"] < 0.5 and d["end"] > 5.5 for d in below)
        taps = ", ".join(f"{at:.2f} s" for at in w["events"]) or "none"
        lines.append(
            f"- `{motion}`: the accelerometer jolts most in the quarter seconds from {at}; `student` rejects "
            f"{', '.join(spans) or 'nothing'}; short events that `diagnose` finds: {taps}. Of {len(below)} places that it lists "
            f"in the compared band, {whole} are nearly the "
            f"whole recording. After the best attempt the residual of a window of one second is between {min(w['left']):.2g} and "
            f"{max(w['left']):.2g} times the noise, most from {w['window_starts'][int(np.argmax(w['left']))]:.1f} s."
        )  # fmt: skip
    head = "fitted | known | verdict | best attempt | left on the fitted motion | gap on the other before | after | floor"
    counts = {name: str(len(wrist[motion]["events"]) or "none") for name, motion in
              (("wrist-taps", "vibrations"), ("wrist-quiet", "baseline"))}  # fmt: skip
    return {"wrist": table(head, rows), "taps": "\n".join(lines), **counts}


def _failure(cases: list[dict[str, Any]]) -> dict[str, str]:
    rows = []
    for c in cases:
        top, seen = c["moments"]["identification"], c["moments"]["validation"]
        said = verdict(c) + (": " + ", ".join(_with_rivals(c)) if c["named"] else "")
        peak = c["size"] * top / c["torque_std"]
        rows.append(
            f"| {100 * c['size']:g} % ({peak:.2g}) | {c['validation']}, up to {seen:.0f} N m | {said} | {counted(c)} "
            f"| {c['fitted']['after']:.3g} | {gap(c)} | {100 * c['gap']['closed']:.0f} % |"
        )  # fmt: skip
    head = "size (over noise) | validation motion | verdict | best attempt | left on fitted | gap before | after | floor | closed"
    named = [c for c in cases if c["verdict"] in ("named", "ambiguous")]
    text = f"The fitted motions reach {cases[0]['moments']['identification']:.0f} N m."
    if named:
        text += f" A wrong name is given up to {100 * max(c['size'] for c in named):g} %."
    if part := [c for c in cases if c["verdict"] == "named_in_part"]:
        text += f" In part a wrong name is given up to {100 * max(c['size'] for c in part):g} %, the largest tried being "
        text += f"{100 * max(c['size'] for c in cases):g} %."
    same, wider = (next(c["moments"] for c in cases if c["validation"] == name) for name in ("same range", "wider"))
    more = f"{100 * (wider['validation'] / same['validation'] - 1):.0f} %"
    return {"failure": text + "\n\n" + table(head, rows), "wider": more}


def _with_rivals(c: dict[str, Any]) -> list[str]:
    return [f"{n} or {' or '.join(c['rivals'][n])}" if n in c["rivals"] else n for n in c["named"]]


def _draw_hose(h: dict[str, Any], path: Path) -> None:
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(9, 3.6), layout="constrained")
        left, right = figure.subplots(1, 2)
        rows = np.arange(len(h["base_before"]))[::-1]
        left.axvspan(-1.96, 1.96, color=GREY, alpha=0.2, lw=0, label="95 % of noise")
        for key, colour, label in (("base_before", ORANGE, "without the hose"), ("base_after", BLUE, "with it")):
            if key in h:
                left.plot([r["sigmas"] for r in h[key]], rows, "o", color=colour, ms=4, label=label)
        names = [r["name"] if len(r["name"]) < 26 else r["name"][:22] + " ..." for r in h["base_before"]]
        left.set_yticks(rows, names, fontsize=7)
        left.set(xscale="symlog", xlabel="error of a base parameter [its std]")
        left.set_xticks([-100, -10, -1, 0, 1, 10, 100], ["-100", "-10", "-1", "0", "1", "10", "100"])
        figure.legend(*left.get_legend_handles_labels(), fontsize=8, ncols=3, loc="outside upper center", frameon=False)
        for key, colour in (("residual_before", ORANGE), ("residual_after", BLUE)):
            if key in h:
                right.plot(h[key]["times"], h[key]["left"], color=colour, lw=1)
        right.set(xlabel="time on the unseen motion [s]", ylabel=f"residual of {h['residual_before']['channel']} [N m]")
        figure.savefig(path, dpi=130)


def _draw_robot(robots: dict[str, Any], path: Path) -> None:
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(9, 3.4), layout="constrained")
        for ax, (name, cases) in zip(figure.subplots(1, 2, sharey=True), robots.items(), strict=True):
            channels = np.arange(1, len(cases["rigid"]["gap"]["channels"]) + 1)
            for k, (colour, label) in enumerate(((ORANGE, "rigid bodies"), (BLUE, "and effects named"))):
                values = [pair[k] for pair in cases["rigid"]["gap"]["channels"].values()]
                ax.bar(channels + 0.4 * (k - 0.5), values, 0.36, color=colour, label=label)
            ax.axhline(1.0, color=GREY, lw=1, ls="--", label="noise, or what stands in for it")
            ax.set(yscale="log", xlabel="joint", title=ROBOTS[name], xticks=channels, ylim=(0.1, 200.0))
        ax = figure.axes[0]
        ax.set_ylabel("residual on unseen motion / noise")
        figure.legend(*ax.get_legend_handles_labels(), fontsize=8, ncols=5, loc="outside upper center", frameon=False)
        figure.savefig(path, dpi=130)


def _draw_wrist(wrist: dict[str, Any], path: Path) -> None:
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(9, 4), layout="constrained")
        grid = figure.subplots(2, 2, sharex=True, sharey="row")
        for (top, bottom), (motion, w) in zip(grid.T, wrist.items(), strict=True):
            top.step(w["jolt_starts"], w["jolts"], where="post", color=GREY, label="accelerometer")
            ends = [*w["window_starts"], 2 * w["window_starts"][-1] - w["window_starts"][-2]]
            left = [*w["left"], w["left"][-1]]
            bottom.step(ends, left, where="post", color=BLUE, label="diagnose: left by the best attempt")
            for windows in w["rejected"].values():
                for k, (a, b) in enumerate(windows):
                    for ax in (top, bottom):
                        label = "rejected by student" if k == 0 and ax is bottom else None
                        ax.axvspan(a, b, color=ORANGE, alpha=0.4, lw=0, label=label)
            for k, at in enumerate(w["events"]):
                for ax in (top, bottom):
                    label = "short event found by diagnose" if k == 0 and ax is bottom else None
                    ax.axvline(at, color=GREEN, lw=1.2, ls="--", label=label)
            top.set_title(motion)
            bottom.set(xlabel="time [s]", ylim=(0, None))
        grid[0, 0].set_ylabel("jolt of the accelerometer\n[its unit a sample]")
        grid[1, 0].set_ylabel("residual / noise,\nwindows of 1 s")
        marks = [dict(zip(*ax.get_legend_handles_labels()[::-1], strict=True)) for ax in (grid[0, 1], grid[1, 1])]
        both = marks[0] | marks[1]
        figure.legend(both.values(), both.keys(), fontsize=8, ncols=4, loc="outside upper center", frameon=False)
        figure.savefig(path, dpi=130)


def _draw_failure(cases: list[dict[str, Any]], path: Path) -> None:
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(9, 3.4), layout="constrained")
        for ax, label in zip(figure.subplots(1, 2, sharey=True), ("same range", "wider"), strict=True):
            mine = [c for c in cases if c["validation"] == label]
            sizes = [100 * c["size"] for c in mine]
            ax.plot(sizes, [c["gap"]["before"] for c in mine], color=GREY, lw=1, ls=":", label="unseen motion, before")
            ax.plot(sizes, [c["fitted"]["after"] for c in mine], color=GREY, lw=1, label="fitted motions, after")
            ax.plot(sizes, [c["gap"]["after"] for c in mine], color=BLUE, lw=1, label="unseen motion, after")
            for c in mine:
                ax.plot(100 * c["size"], c["gap"]["after"], "o", color=COLOURS[c["verdict"]], ms=7)
            ax.axhline(np.sqrt(1.45), color=GREEN, lw=1, ls="--", label="above: something stays")
            ax.set(xscale="log", yscale="log", xlabel="cubic part at the largest fitted moment [%]", title=f"validation: {label}")
            ax.set_xticks(sizes, [f"{s:g}" for s in sizes])
            ax.minorticks_off()
            ax.set_yticks([1, 2, 5, 10, 20, 50], ["1", "2", "5", "10", "20", "50"])
        ax = figure.axes[0]
        ax.set_ylabel("residual / noise")
        for name in dict.fromkeys(c["verdict"] for c in cases):
            ax.plot([], [], "o", color=COLOURS[name], label=name.replace("_", " "))
        figure.legend(*ax.get_legend_handles_labels(), fontsize=8, ncols=4, loc="outside upper center", frameon=False)
        figure.savefig(path, dpi=130)


FIGURES = {"hose": _draw_hose, "robot": _draw_robot, "wrist": _draw_wrist, "failure": _draw_failure}
