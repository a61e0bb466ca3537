import json
import re
from dataclasses import dataclass, replace

import numpy as np
import pytest

import bayesid
from bayesid.recordings.table import Table
from bayesid.report.check import check_report
from bayesid.report.identification import described, identification_report
from bayesid.robot.robot import load_robot
from bayesid.rounding import number, percent, with_half
from bayesid.section import long
from bayesid.workflows.check import check, noise_at_rest, sample_noise
from tests.report_pages import read
from tests.robots import lwr4, prismatic_arm, wrist_sensor_arm, write
from tests.simulated import Motion, Sensor, experiment, fourier, puma2, recording

LOOKS_AT_FIGURES = True
NOISE = dict(force_std=0.5, torque_std=0.1, resolution=2e-5)
SENSOR = Sensor(translation=np.array([0.0, 0.0, -0.1]), force_std=0.5)


def motions(robot, sensor, names=("identification", "validation"), **options):
    speeds = {"identification": 1.5, "validation": 1.0}
    return [
        Motion(n, "validation" if n.startswith("validation") else "identification",
               recording(robot, sensor, fourier(robot, k + 1, speed=speeds.get(n, 1.2)), seed=k + 1, **options))
        for k, n in enumerate(names)
    ]  # fmt: skip


@pytest.fixture(scope="module")
def puma(tmp_path_factory):
    robot = puma2(tmp_path_factory.mktemp("puma"))
    return experiment(robot, motions(robot, SENSOR, offset=np.full(6, 3.0), **NOISE), SENSOR, inertia_rel_std=0.1)


@pytest.fixture(scope="module")
def result(puma):
    return bayesid.identify(puma)


@pytest.fixture(scope="module")
def html(result):
    return identification_report(result)


@pytest.fixture(scope="module")
def page(html):
    return read(html)


def test_report_says_what_was_found_and_how_well_it_holds(page, result):
    text = " ".join(page.text.split())
    for heading in (
        "What was identified", "Measured against predicted", "What is left over", "Errors in numbers",
        "What could not be identified", "Link parameters", "Do the data agree", "How this was done", "Conventions",
    ):  # fmt: skip
        assert heading in text
    assert f"All {result.base.rank} base parameters were identified" in text
    assert "‘validation’" in text and "what is left is the measurement noise" in text
    for label in result.base.labels:
        assert label[:30] in text
    for channel in result.problem.row_model.channels.names:
        assert channel in text


def test_report_puts_warnings_first(result, undrawn):
    loud = replace(result, warnings=("Look <here> first & foremost.",))
    html = identification_report(loud)
    assert "Look &lt;here&gt; first &amp; foremost." in html
    text = read(html).text
    assert text.index("Look <here> first") < text.index("base parameters were identified")
    assert "No warnings" in read(identification_report(replace(result, warnings=()))).text


@dataclass(frozen=True)
class Doubtful:
    """Least squares with something to say."""

    name: str = "doubtful"

    def fit(self, regression):
        estimate = bayesid.fit(regression, "wls")
        details = bayesid.CustomDetails(warnings=("Weak <somewhere>.",), entries={"physics": "my own word"})
        return replace(estimate, details=details)


def test_what_an_estimator_warns_of_stands_on_top_once(puma, undrawn):
    found = bayesid.identify(puma, method=Doubtful())
    assert found.warnings.count("Weak <somewhere>.") == 1
    html = identification_report(found)
    assert html.count("Weak &lt;somewhere&gt;.") == 1 and "my own word" in html


def test_details_are_words(puma):
    said = dict(described({
        "rejected_windows": {"one": [[1.0, 1.25], [3.5, 3.5]], "two": [[0.2, 0.304]]},
        "rejected_share": 0.0312, "model_complete": np.True_, "lost": None, "at": np.arange(11), "mine": {"so_far": 0.5},
    }))  # fmt: skip
    assert said["Rejected times"] == "one: 1.00 to 1.25 s, 3.50 s; two: 0.20 to 0.30 s"
    assert said["Rows rejected as taps or contacts"] == "3.12 %" and said["Model complete"] == "yes"
    assert said["Lost"] == "–" and said["At"].endswith("7 and 3 more") and said["Mine"] == "so far: 0.500"
    assert dict(described({"rejected_windows": {}})) == {"Rejected times": "none"}
    for method in ("huber", "iv", "tls", "sdp"):
        for term, text in described(bayesid.identify(puma, method=method).estimate.details.to_dict()):
            assert not set("_{}[]'") & set(text.replace("link_", "")), (method, term, text)


def test_names_are_escaped(puma):
    bad = experiment(puma.robot, [replace(m, name=f"<b>{m.name}</b>") for m in puma.motions], puma.sensor)
    html = identification_report(bayesid.identify(bad))
    assert "<b>identification" not in html and "&lt;b&gt;identification" in html
    read(html)
    html = check_report(check(bad))
    assert "<b>identification" not in html
    read(html)


def test_offset_cost_and_links_are_told(page, result):
    text = " ".join(page.text.split())
    assert "What the unknown sensor offset costs" in text and "9.81 m1" in text
    nominal = result.problem.experiment.robot.nominal[1]
    assert number(nominal[0], 3) in text and number(nominal[1] / nominal[0], 3) in text


def test_report_is_the_same_every_time(html, result):
    assert identification_report(result) == html


def test_methods_without_intervals_say_why(puma):
    text = read(identification_report(bayesid.identify(puma, method="ridge"))).text
    assert "No intervals:" in text and "biased" in text and "no honest interval" in text


def test_without_validation_the_report_shows_the_fit_and_says_that_it_proves_little(puma, undrawn):
    lonely = experiment(puma.robot, puma.motions[:1], puma.sensor)
    html = identification_report(bayesid.identify(lonely, low_pass=bayesid.LowPass(2.0, 50.0)))
    text = " ".join(read(html).text.split())
    assert "There is no validation motion" in text and "<details open>" in html
    assert "behind the low-pass filters" in text and "l = 2.00 and d = 50.0" in text


def test_static_run_stands_both_ways(tmp_path, undrawn):
    robot = puma2(tmp_path)
    made = motions(robot, SENSOR, offset=np.full(6, 3.0), **NOISE)
    # At rest at the same positions: the readings of infinitely slow motion.
    resting = []
    for motion in made:
        times, q = motion.table.times, motion.table.positions
        still = (times, q, np.zeros_like(q), np.zeros_like(q))
        resting.append(replace(motion, static=recording(robot, SENSOR, still, seed=9, offset=np.full(6, 3.0), **NOISE)))
    run = experiment(robot, resting, SENSOR)
    text = " ".join(read(identification_report(bayesid.identify(run))).text.split())
    assert "The static run, used both ways" in text and "The estimate of this report subtracts them" in text
    found = check(run)
    assert [m.static for m in found.motions] == ["stop-and-go"] * 2
    assert any("subtracted" in s.name and s.available for s in found.sensor_sets)


def test_torques_of_seven_joints_with_effects(tmp_path):
    robot = load_robot(write(tmp_path, lwr4()))
    torque = experiment(robot, motions(robot, None, torque_std=0.1))
    html = identification_report(bayesid.identify(torque, effects=["viscous_friction", "torque_offset"]))
    text = " ".join(read(html).text.split())
    assert "viscous friction" in text and "tau7" in text and "joint torques" in text
    found = check(torque)
    assert found.channel == "torque" and [s.name for s in found.sensor_sets] == ["the joint torques"]
    read(check_report(found))


def test_poses_of_a_wrist_sensor(tmp_path):
    robot = load_robot(write(tmp_path, wrist_sensor_arm()), sensor_joint="wrist_ft")
    sensor = Sensor(joint="wrist_ft")
    q = np.random.default_rng(3).uniform(-1.5, 1.5, (30, robot.n))
    table = recording(robot, sensor, (np.arange(30.0), q, np.zeros_like(q), np.zeros_like(q)), force_std=0.02, torque_std=0.002)
    poses = experiment(robot, [Motion("poses", "identification", table, kind="poses")], sensor, inertia_rel_std=0.3)
    text = " ".join(read(identification_report(bayesid.identify(poses))).text.split())
    assert "poses, numbered" in text
    found = check(poses)
    assert np.isnan(found.motions[0].rate) and not found.motions[0].noise
    assert found.sensor_sets[0].available and "poses at rest" in found.sensor_sets[0].name
    assert found.sensor_sets[0].base.rank == bayesid.identify(poses).base.rank
    assert "wrist_ft" in read(check_report(found)).text


def test_check_tells_limits_of_a_joint_in_its_own_units(tmp_path, undrawn):
    robot = load_robot(write(tmp_path, prismatic_arm()))
    moved = Motion("identification", "identification", recording(robot, None, fourier(robot, 5, 4.0, speed=0.5)))
    html = check_report(check(experiment(robot, [moved])))
    words = " ".join(re.sub("<[^>]+>", " ", html).split())
    assert re.search(r"rail sliding \S+ \S+ m 1\S* m/s 800\S* N q2", words)
    assert re.search(r"swing turning \S+ \S+ rad 2.5\S* rad/s 150\S* N m q3", words)


def test_check_says_what_is_in_the_folder(puma, tmp_path):
    stages = []
    found = check(puma, stages.append)
    assert stages and found.name == puma.name
    document = json.loads(json.dumps(found.to_dict(), allow_nan=False))
    assert document["motions"][0]["columns"] == ["q", "tau", "wrench"] and document["motions"][0]["samples"] == 2500
    assert abs(document["motions"][0]["rate_hz"] - 125.0) < 1e-6
    assert document["robot"]["masses"] == pytest.approx(puma.robot.nominal[:, 0].tolist())
    assert document["sensor_sets"][0]["rank"] == 12
    text = str(found)
    assert "rank 12" in text and "'validation'" in text and "&lt;" not in text
    report = found.write(tmp_path / "out")
    assert json.loads((tmp_path / "out" / "check.json").read_text())["experiment"] == puma.name
    text = " ".join(read(report.read_text()).text.split())
    for heading in (
        "Robot",
        "Motions",
        "How far and how fast",
        "Noise and bandwidth",
        "What each set of readings can see",
        "Recordings",
    ):
        assert heading in text
    assert "<p>test: 2 joints, 2 bodies, 2 motions</p>" in found._repr_html_()


def test_check_puts_warnings_first_and_names_what_identify_will_refuse(puma):
    silent = replace(puma.motions[0], table=replace(puma.motions[0].table, wrench=None, torques=None))
    doubtful = replace(puma, warnings=("table.csv: doubtful",), motions=(silent,))
    found = check(doubtful)
    assert "identify will refuse" in found.warnings[0] and found.warnings[-1] == "table.csv: doubtful"
    assert str(found).index("doubtful") < str(found).index("samples")
    text = read(check_report(found)).text
    assert text.index("doubtful") < text.index("Gravity")


def test_gaps_are_found(puma):
    table = puma.motions[0].table
    keep = np.abs(table.times - 8.0) > 0.5
    holed = replace(table, times=table.times[keep], positions=table.positions[keep], wrench=table.wrench[keep], torques=None)
    found = check(experiment(puma.robot, [replace(puma.motions[0], table=holed)], puma.sensor))
    (gap,) = found.motions[0].gaps
    assert gap[0] == pytest.approx(7.5, abs=0.01) and gap[1] == pytest.approx(8.5, abs=0.01)
    assert "1 gap" in str(found) and "1 gaps" not in str(found) and "1 motions" not in str(found)
    read(check_report(found))


def test_noise_of_a_sample_is_found_beneath_the_motion_and_outliers(puma):
    noise = sample_noise(puma.motions[0].table)
    np.testing.assert_allclose([noise[c] for c in ("fx", "fy", "fz")], 0.5, rtol=0.12)
    np.testing.assert_allclose([noise[c] for c in ("mx", "my", "mz")], 0.1, rtol=0.12)
    wrench = puma.motions[0].table.wrench.copy()
    wrench[::100] += 50.0
    assert sample_noise(replace(puma.motions[0].table, wrench=wrench))["fx"] == pytest.approx(0.5, rel=0.2)
    # Coarse digits that hardly change: the median of differences is zero, their size is not.
    coarse = np.zeros((400, 6))
    coarse[::7] = 0.1
    assert sample_noise(replace(bayesid.Table(np.arange(400.0), np.zeros((400, 2))), wrench=coarse))["fx"] > 0.01


def test_spectrum_of_white_noise_has_the_level_of_the_sensor(result):
    spectrum = result.validation[0].spectrum
    expected = np.array([0.5] * 3 + [0.1] * 3) * np.sqrt(2.0 / 125.0)
    middle = (spectrum.frequencies > 1.0) & (spectrum.frequencies < 8.0)
    np.testing.assert_allclose(np.sqrt(np.mean(spectrum.residual[middle] ** 2, axis=0)), expected, rtol=0.25)
    np.testing.assert_allclose(np.sqrt(np.mean(spectrum.noise[middle] ** 2, axis=0)), expected, rtol=0.25)


@pytest.mark.parametrize(
    ("value", "digits", "text"),
    [
        (0, 4, "0"),
        (np.nan, 4, "–"),
        (np.inf, 4, "–"),
        (None, 4, "–"),
        (9.99996, 4, "10.00"),
        (-0.0123456, 3, "−0.0123"),
        (123456.0, 3, "123456"),
        (1.5e-7, 2, "1.5·10⁻⁷"),
        (-2.5e9, 2, "−2.5·10⁹"),
    ],
)
def test_numbers_have_sensible_digits(value, digits, text):
    assert number(value, digits) == text


@pytest.mark.parametrize(
    ("value", "half", "texts"),
    [
        (1.23456, 0.0123, ("1.235", "0.012")),
        (-0.0001, 17.2, ("0", "17")),
        (5.0, np.nan, ("5.000", "–")),
        (5.0, None, ("5.000", "–")),
        (-1.5e-6, 2.1e-7, ("−1.50·10⁻⁶", "0.21·10⁻⁶")),
        (0.3, 0.0, ("0.3000", "–")),
        (1234.5, 120.0, ("1234", "120")),
    ],
)
def test_values_go_to_the_second_digit_of_their_interval(value, half, texts):
    assert with_half(value, half) == texts


def test_long_sums_are_shortened_between_terms():
    text = " + ".join(f"0.1234 m{k} r{k}x" for k in range(20))
    head, more = re.fullmatch(
        r"<details><summary>(.*) … <small>\((\d+) more terms\)</small></summary>.*</details>", long(text)
    ).groups()
    assert text.startswith(head) and len(head) < 90 and text[len(head) :].count(" + ") == int(more)
    assert long("m1 + m2") == "m1 + m2"
    assert percent(0.12345) == "12.3 %" and percent(np.nan) == "–"


def test_noise_at_rest_is_that_of_the_parked_intervals_about_their_own_means():
    rng = np.random.default_rng(0)
    times = np.arange(0.0, 40.0, 0.01)
    wrench = rng.normal(size=(len(times), 6)) * np.arange(1.0, 7.0) + np.where(times < 20.0, 50.0, -50.0)[:, None]
    moving = (times > 10.0) & (times < 30.0)
    wrench[moving] += 30.0 * np.sin(times[moving])[:, None]
    table = Table(times, np.zeros((len(times), 2)), wrench=wrench)
    found = noise_at_rest(Motion("a", "identification", table, parked=((0.0, 10.0), (30.0, 40.0))))
    np.testing.assert_allclose(list(found.values()), np.arange(1.0, 7.0), rtol=4.0 / np.sqrt(2 * 2000))
    assert noise_at_rest(Motion("a", "identification", table)) == {}
