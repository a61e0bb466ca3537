"""The report of ``check``."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from markupsafe import Markup

from bayesid.arguments import call
from bayesid.recordings.experiment import Motion
from bayesid.recordings.table import WRENCH_COLUMNS
from bayesid.report.charts import CYCLE, WIDTH, Group, Panel, chart, key, key_width, limits, recorded, text_width, write
from bayesid.report.page import below, bullets, cards, figure, fold, lead, note, page, terms, warnings
from bayesid.results.files import report_of
from bayesid.results.inspection import Inspection, MotionSummary
from bayesid.robot import inertia
from bayesid.rounding import DASH, counted, number, percent
from bayesid.section import Part, ShownSection, ShownTable
from bayesid.validation.own_fit import left_text
from bayesid.validation.prediction import judged, useless

_LONGEST_NAME = 40
_LINE = 14.0


def joint_ranges(
    names: Sequence[str],
    lower: np.ndarray,
    upper: np.ndarray,
    motions: Sequence[tuple[str, np.ndarray, np.ndarray]],
    units: Sequence[str],
) -> Markup:
    """How much of each joint's range (n,) each motion, with its name, lowest and highest positions (n,), uses."""
    names, count = [_cut(name) for name in names], len(names)
    places, lines = _legend([_cut(name) for name, _, _ in motions])
    left, top = 12.0 + max(map(text_width, names)), 8.0 + _LINE * lines
    height = 72.0 * count * (0.22 + 0.13 * len(motions))
    bounded = np.isfinite(lower) & np.isfinite(upper)
    ends = [lower[bounded], upper[bounded], *(end for _, *both in motions for end in both)]
    panel = Panel(left, top, WIDTH - 14.4 - left, height, limits(ends, 0.05), (count - 0.4, -0.6))
    parts = [panel.bar(lower[j], upper[j], j, 0.9, "#eef2f7") for j in np.flatnonzero(bounded).tolist()]
    parts.append(panel.frame("", "position [" + " or ".join(dict.fromkeys(units)) + "]", y_axis=False))
    for j, name in enumerate(names):
        parts.append(write(left - 6.0, float(panel.down(np.array(j))) + 3.2, name, 8.5, "#475569", "end"))
        if bounded[j]:
            parts += [panel.stroke(end, j, 0.9, "#94a3b8") for end in (lower[j], upper[j])]
    slot = 0.8 / max(len(motions), 1)
    thickness = min(0.8 * slot, 0.3)
    for k, (name, low, high) in enumerate(motions):
        colour = CYCLE[k % len(CYCLE)]
        for j in range(count):
            at = j - 0.4 + (k + 0.5) * slot
            still = high[j] - low[j] < 1e-9
            parts.append(
                panel.stroke(low[j], at, thickness, colour) if still else panel.bar(low[j], high[j], at, thickness, colour)
            )
        parts.append(key(*places[k], _cut(name), colour, 4.0))
    return chart(top + height + 33.0, parts)


def recording(times: np.ndarray, groups: Sequence[Group], gaps: Sequence[int] = (), poses: bool = False) -> Markup:
    """Groups of curves over time [s], or numbered poses, a panel a group; no line is drawn across ``gaps``, as by `recorded`."""
    left, right, top, gap = 50.4, 72.0, 18.0, 24.0
    height = max(108.0, _LINE * max(len(names) for _, names, _ in groups))  # names of all curves have room beside them
    x = np.arange(1.0, len(times) + 1) if poses else times
    x = np.insert(x, list(gaps), np.nan)
    across, parts = limits([x], 0.03 if poses else 0.01), []
    for p, (title, names, values) in enumerate(groups):
        values = np.insert(values, list(gaps), np.nan, axis=0)
        place = top + p * (height + gap)
        panel = Panel(left, place, WIDTH - left - right, height, across, limits([values], 0.05))
        last = p == len(groups) - 1
        label = ("pose" if poses else "time [s]") if last else ""
        parts.append(panel.frame(title, label, x_numbers=last, whole=poses))
        middle = place + height / 2 - _LINE * (len(names) - 1) / 2
        for k, name in enumerate(names):
            colour = CYCLE[k % len(CYCLE)]
            parts.append((panel.dots if poses else panel.curve)(x, values[:, k], colour))
            parts.append(key(WIDTH - right + 8.0, middle + _LINE * k, name, colour))
    return chart(top + len(groups) * height + (len(groups) - 1) * gap + 33.0, parts)


def _cut(name: str) -> str:
    return name if len(name) <= _LONGEST_NAME else name[: _LONGEST_NAME - 1] + "…"


def _legend(names: Sequence[str]) -> tuple[list[tuple[float, float]], int]:
    """Where the entries of a legend begin: lines from the right, as many as they need; and how many lines those are."""
    lines: list[list[str]] = [[]]
    for name in names:
        if lines[-1] and sum(map(key_width, [*lines[-1], name])) > WIDTH - 14.4:
            lines.append([])
        lines[-1].append(name)
    places = []
    for row, line in enumerate(lines):
        x = WIDTH - 4.0 - sum(map(key_width, line))
        for name in line:
            places.append((x, 10.0 + _LINE * row))
            x += key_width(name)
    return places, len(lines)


_SHOWN_MOTIONS = 8
#: So many of them without a click.
_OPEN_MOTIONS = 2
_PLOTTED = 1500


@report_of.register
def check_report(check: Inspection) -> str:
    """The report of ``check``: an HTML page with all figures inside."""
    robot, experiment = check.experiment.robot, check.experiment
    units = ["m" if slides else "rad" for slides in robot.prismatic]
    shown = check.motions[:_SHOWN_MOTIONS]
    more = len(check.motions) - len(shown)
    ranges = joint_ranges(
        [f"q{j + 1}  {name}" for j, name in enumerate(robot.joint_names)], robot.lower, robot.upper,
        [(m.motion.name, m.lowest, m.highest) for m in shown], units,
    )  # fmt: skip
    drawn = [(f"{m.motion.name} ({m.motion.role})", figure(_figure(m.motion, robot.prismatic), "")) for m in shown]
    sections = [
        ShownSection("Robot", [
            terms(_robot(check)), _joints(check, units),
            note("Joints in the order of the tables' columns; a dash: the URDF states no limit."), _bodies(check),
            note("Nominal bodies as the URDF has them, links beyond fixed and locked joints merged; centre of mass in the "
                 "joint's frame."),
        ]),
        ShownSection("Motions", [
            "Motions of role identification are fitted; those of role validation are never fitted: their prediction tests the "
            "estimate.",
            ShownTable(
                ["motion", "role", "kind", "samples", "duration", "rate", "gaps", "columns", "static readings", "also"],
                [_row(m) for m in check.motions], "b - - n n n n - - -",
            ),
        ]),
        ShownSection("How far and how fast joints move", [
            figure(ranges, "Bars: positions that each motion reaches; grey: what the URDF allows. A joint that hardly moves "
                           "shows little of the links beyond it."),
            _reach(check),
            note("Range in the joint's unit, share of the range between its limits, and largest speed (99.9 % of samples are "
                 "slower), from the smoothed positions."),
        ], "Joint ranges"),
        ShownSection("Noise and bandwidth", _noise(check), "Noise"),
        ShownSection("What each set of readings can see", [
            f"How many combinations of the {robot.nominal.size} inertial parameters the richest motion could ever determine: "
            f"the rank. Which of them the recorded motions do determine, and how well, is for `{call('identify')}`.",
            ShownTable(["readings", "rank", "invisible", "in this folder"], [
                [s.name, str(s.base.rank), str(len(s.base.invisible)), "yes" if s.available else "no"] for s in check.sensor_sets
            ], "w nb n -"),
            *(fold(f"The {s.base.rank} base parameters of {s.name}", ShownTable(["#", "base parameter"], [
                [str(k + 1), label] for k, label in enumerate(s.base.labels)
            ], "nd w")) for s in check.sensor_sets),
        ], "What can be seen"),
        ShownSection("Recordings", [
            *(below(*each) for each in drawn[:_OPEN_MOTIONS]), *(fold(*each) for each in drawn[_OPEN_MOTIONS:]),
            note(f"{more} more recordings are not drawn." if more else ""),
        ]),
    ]  # fmt: skip
    rank = max((s.base.rank for s in check.sensor_sets if s.available), default=0)
    large = [
        (str(robot.n), "joint that moves" if robot.n == 1 else "joints that move", ""),
        (f"{number(float(robot.nominal[:, 0].sum()), 4)} kg", "nominal mass of the moving links", ""),
        (str(len(check.motions)), f"motion{'s' * (len(check.motions) != 1)}, {len(experiment.identification)} to be fitted", ""),
        (str(rank), "base parameters that the recorded readings could show at most", ""),
    ]
    opening = [warnings(check.warnings, _fine(check)), lead(_lead(check)), cards(large)]
    kicker = "What the experiment folder contains, and what a fit would leave of it"
    return page(check.name, kicker, opening, sections, f"{check.name}: what is in the folder")


def _fine(check: Inspection) -> str:
    """What stands in the place of warnings: that nothing looks doubtful only where a fit leaves nothing but noise."""
    off = [p for p in check.left if judged(p).mood != "good"]
    if not off:
        return "No warnings: the folder reads well and nothing in it looks doubtful."
    worst = max(off, key=lambda p: p.relative_error)
    return f"No warnings of the recordings; a fit of the model as it is would leave of ‘{worst.motion}’: {left_text(worst)}."


def _lead(check: Inspection) -> str:
    fitted, unfitted = len(check.experiment.identification), len(check.experiment.validation)
    best = next((s for s in check.sensor_sets if s.available), None)
    reading = "sensor’s wrench" if check.channel == "wrench" else "joint torques"
    opening = "Something seems to be wrong with the data" if check.mistakes else "The folder reads well"
    if not check.mistakes and useless([p for p in check.left if not p.fitted] or check.left):
        opening = "The folder can be read, but the model as it is predicts its readings poorly"
    text = (
        f"{opening}: {check.experiment.robot.n} moving joints, {fitted} motion{'s' if fitted != 1 else ''} to fit "
        f"and {unfitted} to validate on. By default the {reading} will be fitted"
    )
    return text + (f", which can show at most {best.base.rank} base parameters." if best else ".")


def _robot(check: Inspection) -> list[tuple[str, str]]:
    experiment, robot = check.experiment, check.experiment.robot
    rel_std = experiment.inertia_rel_std
    rows = [
        ("Model", f"{robot.name} ({robot.urdf.name})"),
        ("Gravity", f"({', '.join(number(g, 5) for g in robot.gravity)}) m/s² in the base frame"),
        ("Prior relative standard deviation of the inertias",
         "none stated: every rigid parameter is free" if rel_std is None else
         "exact" if rel_std == 0 else f"{percent(rel_std, 2)} (1 sigma)"),
    ]  # fmt: skip
    if experiment.locked:
        rows.append(("Locked joints", ", ".join(f"{n} at {number(v)}" for n, v in experiment.locked.items())))
    sensor = experiment.sensor
    if sensor is None:
        rows.append(("Force/torque sensor", "none"))
    else:
        place = "between the world and the base" if sensor.joint is None else f"in joint {sensor.joint}"
        frame = "base frame" if sensor.joint is None else "child link of that joint"
        carried = [n for n, c in zip(robot.body_names, robot.sensor_bodies, strict=True) if c]
        rows += [
            ("Force/torque sensor", f"{place}; it carries the bodies of {', '.join(carried)}"),
            ("Its pose in the " + frame, f"origin ({', '.join(number(v) for v in sensor.translation)}) m, "
             f"roll pitch yaw ({', '.join(number(v) for v in sensor.rpy)}) rad"),
        ]  # fmt: skip
    stated = {"one count is": experiment.position_resolution, "random noise": experiment.position_std}
    encoder = [f"{label} {number(value, 3)}" for label, value in stated.items() if value]
    rows.append(("Encoders", ", ".join(encoder) + " rad (or m)" if encoder else "nothing stated"))
    rows.append(("Effects in the model", ", ".join(experiment.effects) or "none"))
    return rows


def _bandwidth(check: Inspection) -> str:
    if check.bandwidth is None:
        return "The bandwidth of the joint motion could not be chosen: " + check.bandwidth_reason + "."
    text = f"Joint motion is kept up to {number(check.bandwidth, 3)} Hz ({check.bandwidth_reason})."
    if np.isfinite(check.position_std).all() and check.position_std.any():
        scatter = ", ".join(number(s, 2) for s in check.position_std)
        text += f" Positions scatter around it by {scatter} rad (or m), joint by joint."
    if any("v" in m.columns for m in check.motions):
        text += " Velocities are those of the smoothed positions; columns v are only compared with them."
    return text


def _joints(check: Inspection, units: Sequence[str]) -> ShownTable:
    robot, rows = check.experiment.robot, []
    for j, name in enumerate(robot.joint_names):
        low, high, speed, effort = (number(x[j]) for x in (robot.lower, robot.upper, robot.velocity_limit, robot.effort_limit))
        kind, torque = "sliding" if robot.prismatic[j] else "turning", _unit(f"tau{j + 1}", robot.prismatic)
        rows.append([f"q{j + 1}", name, kind, low, high, units[j], speed, f"{units[j]}/s", effort, torque])
    head = ["", "joint", "type", "lowest", "highest", "unit", "speed limit", "unit", "effort limit", "unit"]
    return ShownTable(head, rows, "- - - n n - n - n -")


def _bodies(check: Inspection) -> ShownTable:
    robot, rows = check.experiment.robot, []
    for k, (name, body) in enumerate(zip(robot.body_names, robot.nominal, strict=True)):
        exists = ("yes", "good") if inertia.is_physically_consistent(body[None])[0] else ("no", "bad")
        cells = [number(body[0], 4), DASH, DASH]
        if abs(body[0]) >= 1e-9:
            _, com, about = inertia.to_mass_com_inertia(body)
            cells[1:] = [",  ".join(number(x, 3) for x in v) for v in (com, np.linalg.eigvalsh(about))]
        rows.append([f"{k + 1} {name}", *cells, exists])
    head = ["body of", "nominal mass [kg]", "centre of mass [m]", "principal inertias [kg m²]", "can exist"]
    return ShownTable(head, rows, "- n n n -")


def _row(m: MotionSummary) -> list[str]:
    motion, poses = m.motion, m.motion.kind == "poses"
    also = [f"period {number(motion.period, 4)} s"] if motion.period else []
    also += [f"parked {number(sum(b - a for a, b in motion.parked), 3)} s"] if motion.parked else []
    if m.timing and m.timing.dropped:
        also.append(f"{counted(m.timing.dropped, 'sample')} missing")
    if m.timing and m.timing.jitter > 0.01 / m.rate:
        also.append(f"stamps jitter by {number(1e3 * m.timing.jitter, 2)} ms rms")
    static = {"none": "none", "stop-and-go": "stop-and-go run", "poses": f"{len(motion.static or ())} poses"}[m.static]
    return [
        motion.name, motion.role, motion.kind, str(len(motion.table)), DASH if poses else f"{number(motion.table.duration, 4)} s",
        DASH if np.isnan(m.rate) else f"{number(m.rate, 4)} Hz", DASH if poses else str(len(m.gaps)), ", ".join(m.columns),
        static, ", ".join(also) or DASH,
    ]  # fmt: skip


def _fixed(value: float) -> str:
    """A number to a thousandth: positions and speeds of joints side by side."""
    return f"{round(value, 3) + 0.0:.3f}".replace("-", "−") if np.isfinite(value) else DASH


def _reach(check: Inspection) -> ShownTable:
    robot, rows, marks = check.experiment.robot, [], {}
    room = robot.upper - robot.lower
    for m in check.motions:
        bounded = np.isfinite(room) & (room > 0)
        share = np.where(bounded, (m.highest - m.lowest) / np.where(bounded, room, 1.0), np.nan)
        marks[len(rows)] = "rule"
        ranges = (f"{_fixed(a)} … {_fixed(b)}" for a, b in zip(m.lowest, m.highest, strict=True))
        rows.append([m.motion.name, "range", *ranges])
        rows.append(["", "share of limits", *(f"{100 * s:.0f} %" if np.isfinite(s) else DASH for s in share)])
        if np.isfinite(m.speed).any():
            rows.append(["", "largest speed", *map(_fixed, m.speed)])
    return ShownTable(["motion", "", *(f"q{j + 1}" for j in range(robot.n))], rows, f"- k{' n' * robot.n}", marks=marks)


def _noise(check: Inspection) -> list[Part]:
    parts: list[Part] = [_bandwidth(check)]
    channels = [c for c in dict.fromkeys(c for m in check.motions for c in m.noise)]
    rows = [[m.motion.name, *(number(m.noise.get(c, np.nan), 3) for c in channels)] for m in check.motions if m.noise]
    if rows:
        marks, sensor = {}, check.experiment.sensor
        if sensor is not None and (sensor.force_std is not None or sensor.torque_std is not None):
            stated = {c: sensor.force_std if c.startswith("f") else sensor.torque_std for c in WRENCH_COLUMNS}
            marks = {len(rows): "rule"}
            rows.append(["stated", *(number(stated.get(c), 3) for c in channels)])
        head = ["motion", *(f"{c} [{_unit(c, check.experiment.robot.prismatic)}]" for c in channels)]
        parts += [
            "Noise of one sample, estimated from third differences by their median, so that neither the motion nor single "
            "outliers count. Slow noise and vibration escape this number; where positions of a motion are only poses, it "
            "cannot be had.",
            ShownTable(head, rows, f"-{' n' * len(channels)}", marks=marks),
        ]
    if check.left:
        left = [f"{p.motion}{'' if p.fitted else ', not fitted'}: {left_text(p)}" for p in check.left]
        said = f"What a fit of the model as it is would leave of each motion below 10 Hz, as `{call('identify')}` says it:"
        parts += [said, bullets(left)]
    return parts


def _unit(channel: str, prismatic: np.ndarray) -> str:
    if channel.startswith("tau"):
        return "N" if prismatic[int(channel[3:]) - 1] else "N m"
    return "N" if channel.startswith("f") else "N m"


def _figure(motion: Motion, prismatic: np.ndarray) -> Markup:
    """The recording as it is, thinned to what a page can show."""
    position, torque = ("m", "N") if prismatic.all() else ("rad or m", "N m or N") if prismatic.any() else ("rad", "N m")
    times, groups, gaps = recorded(motion, _PLOTTED, position, torque)
    return recording(times, groups, gaps, motion.kind == "poses")
