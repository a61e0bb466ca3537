"""What `diagnose` writes: files, words and pictures; the numbers themselves are tested elsewhere."""

import json
import tomllib
from dataclasses import replace
from html import unescape

import numpy as np
import pytest

import bayesid
from bayesid.cli import main
from bayesid.diagnosis.candidates import least_visible
from bayesid.diagnosis.data import Episode
from bayesid.diagnosis.locate import BANDS, by_band, by_window
from bayesid.diagnosis.remarks import next_experiment
from bayesid.diagnosis.rivals import Found
from bayesid.diagnosis.validation import residual_spectra
from bayesid.effects import EffectLibrary, Term
from bayesid.recordings.schema import read_model
from bayesid.report import diagnosis as report
from bayesid.report.diagnosis_figures import diagnosis_views, noise_parts
from bayesid.results import diagnosis
from bayesid.rounding import percent
from bayesid.workflows.demo import PAPER_LOCKED
from tests.report_pages import read
from tests.simulated import Motion, Sensor, experiment, fourier, puma2, recording

NOISE = dict(force_std=0.3, torque_std=0.05, resolution=2e-5)
SENSOR = Sensor(translation=np.array([0.0, 0.0, -0.1]))
GAIN = 0.1


def made(robot, gain, names=("identification", "validation"), inertia_rel_std=0.03, **options):
    """An arm on a sensor one axis of which reads too much."""
    motions = []
    for k, name in enumerate(names):
        table = recording(robot, SENSOR, fourier(robot, k + 1, duration=8.0, rate=100.0), seed=k + 1, **NOISE)
        wrench = table.wrench * np.array([1, 1, 1, 1 + gain, 1, 1])
        motions.append(Motion(name, name, replace(table, wrench=wrench)))
    return experiment(robot, motions, SENSOR, inertia_rel_std=inertia_rel_std, locked=PAPER_LOCKED, **options)


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    return puma2(tmp_path_factory.mktemp("puma"))


@pytest.fixture(scope="module")
def folder(robot, tmp_path_factory):
    path = tmp_path_factory.mktemp("arm") / "arm"
    bayesid.write_experiment(made(robot, GAIN), path)
    return path


@pytest.fixture(scope="module")
def named(robot):
    return bayesid.diagnose(made(robot, GAIN))


@pytest.fixture(scope="module")
def clean(robot):
    return bayesid.diagnose(made(robot, 0.0))


@pytest.fixture(scope="module")
def written(named, tmp_path_factory):
    return named.write(tmp_path_factory.mktemp("out") / "out").parent


def effect(diagnosis, spec):
    data = diagnosis.data
    return EffectLibrary().parse([spec], data.robot.joint_names, data.channels.names)[0]


def ambiguous(diagnosis):
    rival = Term(effect(diagnosis, "sensor_crosstalk@my->mx"), (0.02,))
    found = replace(diagnosis.found[0], rivals=((rival, 1.5),))
    return replace(diagnosis, verdict="ambiguous", found=(found,), next_experiment="Move faster.")


def unknown(diagnosis):
    remark = "Something is missing that no effect of the library explains: residuals stay."
    return replace(diagnosis, verdict="unknown", found=(), shifts=(), remarks=(remark, "The floor is a guess."))


def page_of(diagnosis, folder):
    path = diagnosis.write(folder)
    return read(path.read_text(encoding="utf-8"))


def text_of(page):
    return " ".join(page.text.split())


# ---- files -----------------------------------------------------------------------------------------------------------


def test_the_json_is_as_promised(named, written):
    def refuse(word):
        raise AssertionError(word)

    found = json.loads((written / "diagnosis.json").read_text(encoding="utf-8"), parse_constant=refuse)
    assert {"schema", "channel", "verdict", "effects", "where", "gap", "candidates", "next_experiment"} <= set(found)
    assert (found["schema"], found["channel"], found["verdict"]) == (1, "wrench", "named")
    (one,) = found["effects"]
    assert (one["name"], one["where"], one["ambiguous_with"]) == ("sensor_gain", "mx", [])
    assert set(one["parameters"]["gain"]) == {"value", "std", "low", "high", "unit"} and one["probability"] == pytest.approx(0.96)
    assert abs(one["parameters"]["gain"]["value"] - GAIN) < 5 * one["parameters"]["gain"]["std"]
    assert {"channel", "motion", "start", "end", "joint", "band_hz"} <= set(found["where"][0])
    assert {"metric", "before", "after", "floor", "closed", "closed_low"} <= set(found["gap"])
    assert found["gap"]["before"] > 10 * found["gap"]["after"]
    assert {"name", "where", "log_bayes_factor", "minimum_detectable"} <= set(found["candidates"][0])


def test_sizes_that_stand_out_count_what_no_effect_explains(clean):
    dispersions = clean.search.dispersion, 9.0 * clean.search.dispersion
    louder = replace(clean, search=replace(clean.search, dispersion=dispersions[1]))
    low, high = (least_visible(clean.data.settings, 1, clean.search.projector.rows, x) for x in dispersions)
    sizes, larger = (
        [c["minimum_detectable"] for c in d.to_dict()["candidates"] if c["name"] == "sensor_gain"] for d in (clean, louder)
    )
    assert len(sizes) == 6 and larger == pytest.approx([high / low * size for size in sizes])
    seen, later = ([v.smallest for v in diagnosis_views(d).visible if v.effect.name == "sensor_gain"] for d in (clean, louder))
    assert len(seen) == 6 and later == pytest.approx([high / low * x for x in seen])
    assert 2.5 * low < high < 3.0 * low  # what parameters cost does not grow with the noise


@pytest.mark.parametrize("spec", ["sensor_gain@fx", "base_tilt@base", "sensor_rotation@sensor", "sensor_drift@sensor"])
@pytest.mark.parametrize("dispersion", [1.0, 1.4])
def test_an_effect_of_the_size_stated_is_named_half_of_the_time(clean, spec, dispersion):
    """Each parameter of it alone, by noise drawn onto the effect's own columns and the odds that a search asks for."""
    search = replace(clean.search, dispersion=dispersion)
    rows, rng = search.projector.rows, np.random.default_rng(1)
    proposal = next(p for p in search.proposals if p.name == spec)
    block = next(b for b in search.library.blocks if b.effect.spec == spec)
    basis = np.linalg.qr(block.rows)[0]
    sizes = replace(clean, search=search).least_visible(proposal)
    assert tuple(sizes) == block.effect.parameters
    for column, size in zip(block.rows.T, sizes.values(), strict=True):
        seen = basis.T @ column * size + np.sqrt(dispersion) * rng.normal(size=(4000, basis.shape[1]))
        gain = 0.5 * np.sum(seen**2, axis=1) - 0.5 * basis.shape[1] * np.log(rows)
        assert np.mean(gain >= clean.data.settings.accept * dispersion) == pytest.approx(0.5, abs=0.03)


def test_numbers_that_are_not_finite_become_null(named, tmp_path):
    gap = replace(named.gap, closed=np.nan, closed_low=-np.inf)
    odd = replace(named, gap=gap, found=(replace(named.found[0], std=np.array([np.inf])),))
    page = page_of(odd, tmp_path / "out")
    found = json.loads((tmp_path / "out" / "diagnosis.json").read_text(encoding="utf-8"))
    assert found["gap"]["closed"] is None and found["gap"]["closed_low"] is None
    assert found["effects"][0]["parameters"]["gain"]["std"] is None
    assert "of the gap to the floor is closed" not in text_of(page)


def test_a_failed_report_leaves_nothing(named, tmp_path, monkeypatch):
    def fail(*_):
        raise RuntimeError("no page")

    monkeypatch.setattr(report, "page", fail)
    with pytest.raises(RuntimeError, match="no page"):
        named.write(tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


def test_the_model_holds_what_was_found(named, written):
    effects, values, _ = read_model(written / "model.toml")
    assert effects == ("sensor_gain@mx",)
    assert values == {"sensor_gain@mx": {"gain": named.found[0].term.values[0]}}


def test_the_model_keeps_what_was_there(named):
    """Effects of other channels, what was fixed, and effects named without a place stay as they were."""
    kept = {"viscous_friction@joint1": {"coefficient": 2.0}, "sensor_delay": {"delay": 0.001, "fixed": True}}
    data = replace(named.data.experiment, effects=("viscous_friction", "sensor_delay"), effect_values=kept)
    delay = Term(effect(named, "sensor_delay"), (0.001,))
    base = replace(named.search.base, terms=(delay,))
    best = replace(named.search.best, terms=(delay, *named.search.best.terms))
    changed = replace(named, data=replace(named.data, experiment=data), search=replace(named.search, base=base, best=best))
    effects, values = changed.model
    assert effects == ("viscous_friction", "sensor_delay", "sensor_gain@mx")
    assert values["viscous_friction@joint1"] == {"coefficient": 2.0}
    assert values["sensor_delay@sensor"] == {"delay": 0.001, "fixed": True}
    assert values["sensor_gain@mx"]["gain"] == pytest.approx(GAIN, rel=0.1)


def test_with_the_model_nothing_is_missing(named, written, robot):
    """And effects that are given replace those of the experiment, in the next model.toml, too."""
    effects, values, _ = read_model(written / "model.toml")
    again = bayesid.diagnose(made(robot, GAIN, effects=("sensor_delay",), effect_values=values), effects=effects)
    assert again.verdict == "nothing_missing"
    assert again.gap.before == pytest.approx(named.gap.after, rel=1e-3)
    assert again.model[0] == effects


# ---- command line ----------------------------------------------------------------------------------------------------


def test_the_command_and_identify_with_its_model(folder, tmp_path, capsys):
    assert main(["diagnose", str(folder), "--out", str(tmp_path / "out")]) == 0
    printed = capsys.readouterr()
    assert printed.err == ""
    assert "The model misses one effect: sensor_gain at mx" in printed.out
    assert printed.out.rstrip().splitlines()[-1] == f"report: {tmp_path / 'out' / 'report.html'}"
    assert {p.name for p in (tmp_path / "out").iterdir()} == {"diagnosis.json", "model.toml", "report.html"}
    whitened = {}
    for name, more in (("plain", []), ("with", ["--model", str(tmp_path / "out" / "model.toml")])):
        assert main(["identify", str(folder), "--out", str(tmp_path / name), *more]) == 0
        estimate = json.loads((tmp_path / name / "estimate.json").read_text(encoding="utf-8"))
        whitened[name] = estimate["validation"][0]["rmse"]["mx"]
    assert whitened["with"] < 0.2 * whitened["plain"]
    gains = [e["parameters"]["gain"]["value"] for e in estimate["effects"] if e["name"] == "sensor_gain"]
    assert gains == [pytest.approx(GAIN, rel=0.02)]


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--motions", "nod"], "--motions nod"),
        (["--effects", "sensor_gian"], "did you mean 'sensor_gain'"),
        (["--channel", "torques"], "torques"),
        (["--model", "absent.toml"], "absent.toml: no such file"),
    ],
)
def test_bad_input_ends_with_2_and_one_line(folder, tmp_path, capsys, options, says):
    assert main(["diagnose", str(folder), "--out", str(tmp_path / "out"), *options]) == 2
    printed = capsys.readouterr()
    assert says in printed.err and printed.err.count("\n") == 1 and "Traceback" not in printed.err
    assert not (tmp_path / "out").exists()


# ---- words -----------------------------------------------------------------------------------------------------------


def test_the_summary_of_each_verdict(named, clean):
    assert named.verdict == "named" and clean.verdict == "nothing_missing"
    text = str(named)
    assert text.startswith("test: named (sensor's wrench of identification)\n")
    assert EffectLibrary().classes["sensor_gain"].summary in text
    assert "sensor_gain@mx: gain 0.09" in text or "sensor_gain@mx: gain 0.1" in text
    unseen = named.errors[0]
    assert f"{unseen.before.whitened_rms:.3g} -> {unseen.after.whitened_rms:.3g} x noise" in text and "disagrees: mx in" in text
    assert "Nothing is missing" in str(clean) and "disagrees" not in str(clean)
    assert "either sensor_gain at mx" in str(ambiguous(named)) and "or sensor_crosstalk at my->mx" in str(ambiguous(named))
    text = str(unknown(named))
    assert "no effect of the library explains it" in text and "best attempt: sensor_gain@mx" in text
    assert "note: The floor is a guess." in text and "note: Something" not in text


def test_nothing_found_beside_a_noise_that_is_not_known_is_not_said_to_be_all(clean):
    """What the richest model leaves stood in for the noise: a residual many times the sensor's noise may be under it."""
    guessed = str(replace(clean, data=replace(clean.data, floor_known=False)))
    assert "down to" not in guessed and "the noise is not known" in guessed
    asked = next_experiment("nothing_missing", (), floor_known=False)
    assert "at rest" in asked and "Nothing is left" not in asked
    assert "Nothing is left" in next_experiment("nothing_missing", ())


def test_two_effects_and_a_contact(named):
    where = effect(named, "external_contact@joint2")
    contact = Episode(where, (1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 0.0, 0.0), "identification")
    both = replace(named, found=(*named.found, Found(contact, 90.0, np.full(8, 0.1))))
    assert "The model misses two effects: sensor_gain at mx" in str(both)
    assert "external_contact at joint2" in str(both)
    assert "here in ‘identification’, so other motions cannot confirm it" in diagnosis.validation_sentence(both)


def test_shares_are_not_rounded_up_to_all(named):
    assert diagnosis.known_share(0.9999994) == "99.999 %"
    assert diagnosis.known_share(1.0) == "100 %"
    assert diagnosis.known_share(0.5) == "50.0 %"


def test_a_notebook_escapes(named):
    html = ambiguous(named)._repr_html_()
    assert "my-&gt;mx" in html and "<table>" in html and "sensor_gain@mx" in html


# ---- the page --------------------------------------------------------------------------------------------------------


def test_the_page_of_a_named_effect(named, written):
    text = text_of(read((written / "report.html").read_text(encoding="utf-8")))
    for part in (
        "The model misses one effect: sensor_gain at mx", "What disagrees, and where", "What it is",
        "Why that, and not something else", "What it did to the parameters", "Before and after on unseen motions",
        "What these motions could show at all", "Where the noise floor comes from",
        "One axis reads (1 + gain) times the truth.", "The line is what a complete model would leave",
        "as identify leaves it with either model",
        "No other effect in its place comes near",
    ):  # fmt: skip
        assert part in text, part
    assert "Know this before" not in text


def test_the_page_of_nothing(clean, tmp_path):
    text = text_of(page_of(clean, tmp_path / "out"))
    for part in ("Nothing is missing", "What was tried", "Anything smaller may be there unseen", "What is left on unseen"):
        assert part in text, part
    assert "What it is" not in text and "What it did" not in text and "with either model" not in text


def test_the_page_of_two_names(named, tmp_path):
    text = text_of(page_of(ambiguous(named), tmp_path / "out"))
    assert "Or, just as well: sensor_crosstalk@my->mx" in text and "loses only 1.5: too little to decide" in text
    assert "Move faster." in text
    given = json.loads((tmp_path / "out" / "diagnosis.json").read_text(encoding="utf-8"))["effects"][0]["ambiguous_with"]
    assert given == [{"name": "sensor_crosstalk", "where": "my->mx"}]


def test_the_page_of_a_stranger(named, tmp_path):
    text = text_of(page_of(unknown(named), tmp_path / "out"))
    for part in ("Something is missing, and no effect of the library explains it", "the best attempt was sensor_gain@mx",
                 "The floor is a guess."):  # fmt: skip
        assert part in text, part
    assert "What it is" not in text
    assert tomllib.loads((tmp_path / "out" / "model.toml").read_text(encoding="utf-8")) == {"model": {"effects": []}}


def test_the_page_without_validation(robot, tmp_path):
    diagnosis = bayesid.diagnose(made(robot, GAIN, ["identification"]))
    assert diagnosis.gap is None
    text = text_of(page_of(diagnosis, tmp_path / "out"))
    assert "There is no validation motion" in text and "No motion that took no part in the fit was compared" in text
    assert "No motion that took no part" in str(diagnosis)


# ---- the numbers behind the pictures ---------------------------------------------------------------------------------


def test_windows_and_bands_hold_all_of_the_residual(named):
    data = named.data
    (segment,) = data.unseen
    (white,) = residual_spectra(data, data.unseen, named.search.base)
    energy = by_window(segment, white, 1.0, 1)[1]
    np.testing.assert_allclose(energy.sum(axis=0), np.sum(white**2, axis=0), rtol=1e-10)
    counts = [np.sum((segment.frequencies >= low) & (segment.frequencies < high)) for low, high in BANDS]
    assert sum(counts) == len(white)
    np.testing.assert_allclose(np.array(counts) @ by_band(segment, white) ** 2, np.sum(white**2, axis=0), rtol=1e-10)


def test_pictures_show_what_the_gap_says(named):
    seen = diagnosis_views(named)
    assert [p.unseen for p in seen.panels] == [False, True]
    marked = np.concatenate([m for p in seen.panels for _, _, m in p.pieces])
    mx = named.data.channels.names.index("mx")
    assert marked[:, mx, 0].mean() > 0.8 and marked[..., 1].mean() < 0.1
    assert seen.signals[0].motion == "validation" and "mx" in [s.channel for s in seen.signals]
    for s in seen.signals:
        assert np.sqrt(np.mean(s.values[:, 1] ** 2)) < 2.0 * s.noise
    worst = next(s for s in seen.signals if s.channel == "mx")
    assert np.sqrt(np.mean(worst.values[:, 0] ** 2)) > 5.0 * worst.noise


def test_the_noise_band_is_that_of_drawn_noise(named):
    """Coefficients drawn from their covariance and made into signals spread as far as the band says."""
    (segment,) = named.data.unseen
    rng = np.random.default_rng(0)
    root = np.linalg.cholesky(segment.covariance)
    for s in diagnosis_views(named).signals:
        c = named.data.channels.names.index(s.channel)
        drawn = np.einsum("kcd,kdn->kcn", root, rng.normal(size=(*segment.shape, 200)))[:, c]
        drawn[segment.frequencies > s.below] = 0.0
        assert np.std(segment.samples(drawn)) == pytest.approx(s.noise, rel=0.05)


def test_noise_is_what_was_put_in(named):
    sample, sensor, _ = noise_parts(named.data)
    units = named.data.channels.units
    assert {*units} == {"N", "N m"}
    assert sample == pytest.approx([NOISE["force_std"] if u == "N" else NOISE["torque_std"] for u in units], rel=0.2)
    assert np.all((0 < sensor) & (sensor < sample))


def test_shares_of_look_alikes_are_those_of_least_squares(named):
    library = named.search.library
    by_name = {v.effect.spec: v for v in diagnosis_views(named).visible}
    columns = {b.effect.spec: b.rows for b in library.blocks}
    assert np.isfinite(by_name["sensor_gain@mx"].named)
    for spec in ("sensor_gain@mx", "sensor_delay@sensor", "encoder_offset@joint2"):
        found, z = by_name[spec], columns[spec][:, 0]

        def explained(other, z=z):
            rows = columns[other] / np.maximum(np.linalg.norm(columns[other], axis=0), 1e-300)
            left = z - rows @ np.linalg.lstsq(rows, z, rcond=1e-6)[0]
            return 1.0 - left @ left / (z @ z)

        best = max((o for o in columns if o != spec), key=explained)
        assert found.share == pytest.approx(explained(best), abs=1e-6)
        least = least_visible(named.data.settings, 1, named.search.projector.rows, named.search.dispersion)
        assert found.smallest == pytest.approx(least / np.linalg.norm(z))
        assert np.isinf(found.named) == (found.share > 1 - 1e-6)  # what is the same in these readings has no other size
        if np.isfinite(found.named):
            assert found.named == pytest.approx(found.smallest / np.sqrt(1.0 - found.share), rel=1e-3)


def test_the_same_seed_gives_the_same(named, robot):
    """Everything random comes from the seed."""
    again, first = bayesid.diagnose(made(robot, GAIN)).to_dict(), named.to_dict()
    assert {**again, "runtime_s": 0.0} == {**first, "runtime_s": 0.0}


def test_how_much_better_in_units_per_cent_and_noise_motion_by_motion(named):
    """As `identify` says it, with the model as it was and with the one that was found."""
    experiment, (effects, values) = named.data.experiment, named.model
    unseen, fitted = named.to_dict()["errors"]
    assert (unseen["motion"], unseen["fitted"]) == ("validation", False) and fitted["fitted"]
    for side, model in (("before", experiment), ("after", replace(experiment, effects=effects, effect_values=values))):
        result = bayesid.identify(model)
        (mine,) = result.validation
        assert unseen[f"times_noise_{side}"] == pytest.approx(mine.whitened_rms, rel=1e-9)
        assert unseen[f"relative_{side}"] == pytest.approx(mine.relative_error, rel=1e-9)
        assert [c[side] for c in unseen["channels"].values()] == pytest.approx(mine.rmse, rel=1e-9)
        assert fitted[f"times_noise_{side}"] == pytest.approx(result.fitted[0].whitened_rms, rel=1e-9)
    assert unseen["times_noise_after"] < 1.1 < unseen["times_noise_before"] and unseen["channels"]["mx"]["unit"] == "N m"
    assert f"{percent(unseen['relative_before'])} -> " in str(named) and "N m" in str(named)
    page = report.diagnosis_report(named)
    assert "In their own units, motion by motion" in page and "validation, not fitted" in page


def test_what_the_data_leave_open_has_no_value(named):
    """Neither a number nor an interval, in print, report and JSON."""
    open_ = replace(named, found=(replace(named.found[0], std=np.array([np.inf])),))
    (row,) = diagnosis.parameter_rows(open_, 0)
    assert row[1] == diagnosis.NOT_DETERMINED and diagnosis.NOT_DETERMINED in str(open_)
    assert open_.to_dict()["effects"][0]["parameters"]["gain"]["std"] is None


@pytest.mark.parametrize("count", [1, 4])
def test_what_explains_as_much_stands_beside_every_effect(named, count):
    """In terminal and notebook, once beside each effect, also where the sentence counts them by kind."""
    one = ambiguous(named)
    several = replace(one, verdict="named_in_part", found=one.found * count)
    for text in (str(several), unescape(several._repr_html_())):
        assert text.count("sensor_gain@mx or sensor_crosstalk@my->mx") == count
    assert " or " not in str(replace(several, found=named.found * count)).split("error of")[0]


def test_motions_that_hardly_depend_on_what_is_named_say_nothing_of_it(named):
    """A gap that stays as it was is no confirmation."""
    blind = replace(named, gap=replace(named.gap, after=named.gap.before, difference=1.0))
    assert "neither confirm nor deny it" in diagnosis.validation_sentence(blind)
    assert "neither confirms nor denies" in str(blind) and "neither" not in str(named)
