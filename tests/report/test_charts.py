import itertools
import re
import xml.etree.ElementTree as ET

import numpy as np
import pytest
from matplotlib.font_manager import FontProperties
from matplotlib.textpath import TextPath

from bayesid.report.charts import Panel, tick_labels
from bayesid.report.charts import ticks as find_ticks
from bayesid.report.check import joint_ranges, recording

NAMES = ["q1 shoulder_pan", "q2 b", "q3 c"]
LIMITS = np.array([-3.0, -np.inf, -1.0]), np.array([3.0, np.inf, 1.0])
LOW, HIGH = np.array([-1.0, 0.2, 0.0]), np.array([1.0, 0.9, 0.0])


def read(svg):
    """The root element and, of every text, what it says and its box as DejaVu Sans draws it."""
    root = ET.fromstring(svg)
    boxes = []
    for text in root.iter("text"):
        size, anchor = float(text.get("font-size")), text.get("text-anchor")
        font = FontProperties(family="DejaVu Sans", weight=text.get("font-weight") or "normal")
        width = TextPath((0, 0), text.text, size=size, prop=font).get_extents().width
        left = float(text.get("x")) - {"start": 0.0, "middle": 0.5, "end": 1.0}[anchor] * width
        bottom = float(text.get("y"))
        boxes.append((text.text, left, bottom - 0.75 * size, left + width, bottom))
    return root, boxes


def assert_readable(svg):
    root, boxes = read(svg)
    _, _, width, height = map(float, root.get("viewBox").split())
    assert boxes
    for text, left, top, right, bottom in boxes:
        assert 0 <= left and right <= width and 0 <= top and bottom + 2 <= height, text
    for one, other in itertools.combinations(boxes, 2):
        apart = one[3] <= other[1] or other[3] <= one[1] or one[4] <= other[2] or other[4] <= one[2]
        assert apart, (one, other)


@pytest.mark.parametrize("count", [1, 3, 8])
@pytest.mark.parametrize("name", ["motion {}", "a very long name of a motion that somebody chose, number {}"])
def test_joint_ranges_are_readable(count, name):
    motions = [(name.format(k), LOW, HIGH) for k in range(count)]
    assert_readable(joint_ranges(NAMES, *LIMITS, motions, ["rad", "rad", "m"]))


@pytest.mark.parametrize("start", [0.0, 1.7e9])
@pytest.mark.parametrize(("scale", "middle"), [(1.0, 0.0), (1e-4, 0.0), (3e4, 0.0), (1e8, 0.0), (1e-9, 12.345678), (0.0, -0.3)])
def test_recordings_are_readable(start, scale, middle):
    times = start + np.arange(0, 100, 0.01)
    values = middle + scale * np.column_stack([np.sin(times), np.cos(times)])
    panels = [(title, ["q1", "q2"], values) for title in ("positions [rad]", "forces [N]")]
    assert_readable(recording(times, panels, [500], False))
    few = [(title, names, v[:9]) for title, names, v in panels]
    assert_readable(recording(times[:9], few, [], True))


@pytest.mark.parametrize("count", [7, 16])
def test_recordings_of_many_joints_are_readable(count):
    times = np.arange(0.0, 10.0, 0.1)
    values = np.sin(times[:, None] * np.arange(1, count + 1))
    svg = recording(times, [(name, [f"{name}{j + 1}" for j in range(count)], values) for name in ("q", "tau")])
    assert_readable(svg)
    assert len(set(re.findall(r'<path[^>]* fill="none" stroke="(#\w+)"', svg))) == count


def test_one_pose_is_drawn():
    svg = recording(np.zeros(1), [("positions [rad]", ["q1"], np.ones((1, 1)))], [], True)
    assert svg.count("<circle") == 1


def test_bars_end_where_the_motion_does():
    root, boxes = read(joint_ranges(["q1"], -3 * np.ones(1), 3 * np.ones(1), [("m", -np.ones(1), 2 * np.ones(1))], ["rad"]))
    ticks = [(text, (left + right) / 2) for text, left, _, right, _ in boxes if re.fullmatch(r"−?\d", text)]
    numbers = {float(text.replace("−", "-")): place for text, place in ticks}
    unit = (numbers[3.0] - numbers[-3.0]) / 6
    bar = [r for r in root.iter("rect") if r.get("fill") == "#1d4ed8"][0]
    assert float(bar.get("width")) == pytest.approx(3 * unit, rel=0.02)
    assert float(bar.get("x")) == pytest.approx(numbers[-1.0], abs=2.0)


def drawn(path):
    """Points of a curve and the numbers of points of its parts."""
    parts = []
    for part in path.split("M")[1:]:
        start, _, steps = part.partition("l")
        points = np.array([start.split(), *(s.split() for s in re.findall(r"-?[\d.]+ -?[\d.]+", steps))], float)
        parts.append(np.cumsum(points, axis=0))
    return parts


def test_curves_are_drawn_where_they_are_and_not_across_gaps():
    panel = Panel(50.0, 20.0, 600.0, 100.0, (0.0, 10.0), (-1.0, 1.0))
    x = np.linspace(0.0, 10.0, 1501)
    y = np.sin(3 * x) * np.cos(11 * x)
    x[700], y[900] = np.nan, np.nan
    path = re.search(r' d="([^"]+)"', " " + panel.curve(x, y, "red"))[1]
    parts = drawn(path)
    assert len(parts) == 3 and sum(map(len, parts)) < 1200
    for points, where in zip(parts, (slice(0, 700), slice(701, 900), slice(901, None)), strict=True):
        places = panel.across(x[where])
        np.testing.assert_allclose(np.interp(places, *points.T), panel.down(y[where]), atol=0.6)


def test_spikes_of_one_sample_are_drawn():
    panel = Panel(0.0, 0.0, 600.0, 100.0, (0.0, 1.0), (0.0, 1.0))
    y = np.zeros(1501)
    y[777] = 0.5
    (line,) = drawn(re.search(r' d="([^"]+)"', panel.curve(np.linspace(0, 1, 1501), y, "red"))[1])
    assert line[:, 1].min() == pytest.approx(50.0, abs=0.1)


@pytest.mark.parametrize("low", [-1e8, -2.5, 0.0, 1e-7, 1234.5])
@pytest.mark.parametrize("span", [1e-6, 0.03, 1.0, 7.7, 2e5])
def test_numbers_on_an_axis_tell_where_they_stand(low, span):
    values = find_ticks(low, low + span, 5)
    assert 2 <= len(values) <= 7 and values.min() >= low - 1e-6 * span and values.max() <= low + 1.000001 * span
    labels, added = tick_labels(values)
    base = float(added.replace("−", "-").replace(" ", "").strip("()")) if added else 0.0
    said = [float(text.replace("−", "-")) for _, text in labels]
    step = values[1] - values[0]
    np.testing.assert_allclose(np.array(said) + base, values, rtol=0.0, atol=0.01 * step + 1e-14 * abs(low))


def test_names_are_escaped():
    one = np.ones(1)
    svg = joint_ranges(["<q1>"], -one, one, [("a & <b>", -one, one)], ["rad"])
    _, boxes = read(svg)
    assert {"<q1>", "a & <b>"} <= {text for text, *_ in boxes}
