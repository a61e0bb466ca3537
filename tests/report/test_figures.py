import itertools
import re
from types import SimpleNamespace

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from bayesid.report.changes import gap_figure, sizes_figure
from bayesid.report.figures import to_svg
from bayesid.report.fit_figures import measured_against_predicted, noise_in_band, parameter_intervals, residuals
from bayesid.validation.prediction import Prediction, ResidualSpectrum

WRENCH = ("fx", "fy", "fz", "mx", "my", "mz")


def prediction(channels=WRENCH, *, samples=800, poses=False, spectrum=True, gap=False, scale=1.0) -> Prediction:
    rng = np.random.default_rng(0)
    times = 0.008 * np.arange(samples)
    if gap:
        times[samples // 2 :] += 3.0
    count = len(channels)
    measured = scale * np.sin(times[:, None] * np.arange(1, count + 1))
    frequencies = np.arange(1, 129) * 0.1
    level = np.full((128, count), 0.05 * scale)
    ones = np.ones(count)
    return Prediction(
        motion="m", role="validation", channel_names=tuple(channels),
        channel_units=tuple("N" if c.startswith("f") else "N m" for c in channels), times=times, measured=measured,
        predicted=measured + 0.01 * scale * rng.normal(size=measured.shape), rmse=ones, rmse_raw=ones, nrmse=ones, nrmse_raw=ones,
        whitened_rms=1.0, whitened_rms_by_channel=ones, coverage=0.95, poses=poses,
        spectrum=ResidualSpectrum(frequencies, level * rng.uniform(0.5, 2.0, level.shape), level)
        if spectrum and not poses else None,
    )  # fmt: skip


def texts(figure):
    """Boxes of all texts that are drawn, with the figure's own."""
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    renderer = canvas.get_renderer()
    boxes = []
    for ax in figure.axes:
        if not ax.get_visible():
            continue
        labels = [
            *ax.get_xticklabels(),
            *ax.get_yticklabels(),
            ax.title,
            ax._left_title,
            ax.xaxis.label,
            ax.yaxis.label,
            *ax.texts,
        ]
        low, high = ax.get_window_extent().extents[:2] - 2.0, ax.get_window_extent().extents[2:] + 2.0
        for label in labels:
            if not (label.get_visible() and label.get_text()):
                continue
            box = label.get_window_extent(renderer)
            if label in labels[: -3 - len(ax.texts)] and not _inside(label, box, low, high, ax):
                continue
            boxes.append((label.get_text(), box))
    for legend in figure.legends:
        boxes += [(t.get_text(), t.get_window_extent(renderer)) for t in legend.get_texts()]
    return boxes, figure.bbox


def _inside(label, box, low, high, ax):
    """Whether a tick's label belongs to a tick within the limits, and so is drawn."""
    if label in (ax.title, ax._left_title):
        return True
    x, y = (box.x0 + box.x1) / 2, (box.y0 + box.y1) / 2
    return low[0] <= x <= high[0] or low[1] <= y <= high[1]


def assert_readable(figure):
    boxes, whole = texts(figure)
    assert boxes
    for text, box in boxes:
        assert whole.x0 - 1 <= box.x0 and box.x1 <= whole.x1 + 1 and whole.y0 - 1 <= box.y0 and box.y1 <= whole.y1 + 1, text
    for (one, a), (other, b) in itertools.combinations(boxes, 2):
        overlap = min(a.x1, b.x1) - max(a.x0, b.x0), min(a.y1, b.y1) - max(a.y0, b.y0)
        assert min(overlap) < 1.5, f"'{one}' and '{other}' overlap"


def around(values, half):
    """Ends of intervals (2, r)."""
    return np.array([values - half, values + half])


@pytest.mark.parametrize("count", [1, 4, 12, 60])
def test_intervals_of_few_and_many_parameters_are_readable(count):
    rng = np.random.default_rng(count)
    classes = [("alone", "combination", "weak", "prior")[k % 4] for k in range(count)]
    half = np.where(np.array(classes) == "prior", np.nan, 10.0 ** rng.uniform(-4, 1, count))
    names = [f"m{k} r{k}x … ({k + 1})" for k in range(count)]
    assert_readable(parameter_intervals(names, (change := rng.normal(size=count)), around(change, half), np.ones(count), classes))


def test_intervals_without_any_interval_say_so():
    figure = parameter_intervals(["a", "b"], np.array([0.1, -5.0]), np.full((2, 2), np.nan), np.ones(2), ["alone", "alone"])
    assert "no honest interval" in to_svg(figure, "x")


def test_weak_parameters_do_not_press_the_others_to_zero():
    change, half = np.array([0.02, -0.01, 400.0]), np.array([0.01, 0.01, 900.0])
    figure = parameter_intervals(["a", "b", "c"], change, around(change, half), np.ones(3), ["alone", "alone", "weak"])
    assert figure.axes[0].get_xlim()[1] < 0.05


def test_sizes_of_many_changes_are_readable():
    series = {f"viscous_friction@joint{j} coefficient": np.array([[np.nan, j], [np.nan, 0.3]]) for j in range(1, 8)}
    assert_readable(sizes_figure(series, 2, "Size of the changes named [N m s/rad]"))


_SEVEN, _BOTH = tuple(f"tau{k}" for k in range(1, 8)), WRENCH + ("tau1", "tau2", "tau3")


@pytest.mark.parametrize(
    ("channels", "scale"),
    [
        (WRENCH, 1e-4), (("tau1",), 1e-4), (("tau1",), 1.0), (_SEVEN, 3e4), (_BOTH, 1e-4),
        pytest.param(WRENCH, 3e4, marks=pytest.mark.slow), pytest.param(_BOTH, 1.0, marks=pytest.mark.slow),
    ],
    ids=lambda x: str(x) if isinstance(x, float) else f"{len(x)} channels",
)  # fmt: skip
def test_predictions_and_residuals_are_readable(channels, scale):
    for figure in (
        measured_against_predicted(prediction(channels, scale=scale)),
        residuals(prediction(channels, scale=scale)),
    ):
        assert_readable(figure)


def test_poses_and_motions_without_a_spectrum():
    for p in (prediction(samples=24, poses=True), prediction(samples=40, spectrum=False), prediction(samples=1, poses=True)):
        assert_readable(measured_against_predicted(p))
        assert_readable(residuals(p))


@pytest.mark.parametrize("count", [1, 6, 12, 200])
def test_series_of_few_and_many_recordings_are_readable(count):
    """Names below the picture where they have room, numbers where they are too many."""
    entries = [SimpleNamespace(name=f"2026-11-{k:03d}-night", changes=(), verdict="unknown", gap=1.0 + k) for k in range(count)]
    figure = gap_figure(SimpleNamespace(recordings=entries))
    assert_readable(figure)
    assert ("2026-11-000-night" in [text for text, _ in texts(figure)[0]]) == (count <= 6)


def test_lines_are_not_drawn_across_gaps():
    figure = measured_against_predicted(prediction(gap=True))
    x = figure.axes[0].lines[0].get_xdata()
    assert np.isnan(x).sum() == 1 and np.nanmax(np.diff(x)) < 0.1


def test_forces_stand_left_of_moments():
    figure = measured_against_predicted(prediction())
    place = {ax.get_title(loc="left"): ax.get_position().x0 for ax in figure.axes}
    assert place["fx [N]"] == place["fz [N]"] < place["mx [N m]"]


def test_noise_in_the_band_is_the_integral_of_its_density():
    frequencies = np.arange(1, 1001) * 0.02
    spectrum = ResidualSpectrum(frequencies, np.ones((1000, 1)), np.full((1000, 1), 0.3))
    np.testing.assert_allclose(noise_in_band(spectrum, 10.0), 0.3 * np.sqrt(10.0), rtol=1e-9)


def test_drawing_changes_no_global_style():
    before = dict(mpl.rcParams)
    to_svg(residuals(prediction()), "x")
    assert dict(mpl.rcParams) == before


def test_svg_is_reproducible_and_refers_only_to_itself():
    figures = [to_svg(residuals(prediction(samples=4000)), name) for name in ("a b", "a b", "c")]
    assert figures[0] == figures[1]
    one, other = (set(re.findall(r' id="([^"]+)"', f)) for f in (figures[0], figures[2]))
    assert one and not one & other
    for text in figures:
        assert "http" not in re.sub(r"base64,[\w+/=\s]*", "", text)
        used = set(re.findall(r'href="#([^"]+)"|url\(#([^)]+)\)', text))
        assert {a or b for a, b in used} <= set(re.findall(r' id="([^"]+)"', text))
        assert text.startswith("<svg") and text.rstrip().endswith("</svg>")


def test_a_dollar_in_a_name_begins_no_formula():
    """Half a formula is an error in matplotlib."""
    one, names = np.ones(2), ["$q_{1$", "$x_{1$"]
    figure = parameter_intervals(names, 0 * one, around(0 * one, one), one, ["alone", "alone"])
    svg = to_svg(figure, "one")
    assert "$q_{1$" in svg and "$x_{1$" in svg
