"""Diagnosis, on recordings of the independent plant of case_studies/blind_naming."""

from __future__ import annotations

import importlib
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import lsq_linear
from scipy.stats import chi2, multivariate_normal

from bayesid import diagnose, fourier_trajectory
from bayesid.diagnosis import (
    candidates,
    encoders,
    fit,
    forward,
    projector,
    rivals,
    search,
    spectra,
    validation,
)
from bayesid.diagnosis.contacts import is_excuse
from bayesid.diagnosis.data import Episode, active_terms, residual_rows, term_rows
from bayesid.diagnosis.fit import differs_from_zero, distance
from bayesid.diagnosis.noise import smoothed
from bayesid.diagnosis.noise_models import NoiseModels
from bayesid.diagnosis.prepare import prepare_data
from bayesid.diagnosis.remarks import remarks
from bayesid.diagnosis.search import certain
from bayesid.diagnosis.settings import DEFAULT
from bayesid.effects import EffectLibrary, Term, columns
from bayesid.effects.bodies import InertiaError, split_matrix
from bayesid.effects.families import needs_no_load
from bayesid.recordings.experiment import load_experiment
from bayesid.robot import inertia
from bayesid.robot.prior import Prior, typical_links
from bayesid.robot.robot import load_robot
from bayesid.signals.white_noise import quiet_noise
from bayesid.simulation.simulation import simulate
from tests.robots import ur5, wrist_sensor_arm, write

PLANT = Path(__file__).parents[2] / "case_studies" / "blind_naming"


@pytest.fixture(scope="module")
def plant():
    """The plant's cases module."""
    sys.path.insert(0, str(PLANT))
    try:
        yield importlib.import_module("cases")
    finally:
        sys.path.remove(str(PLANT))


@pytest.fixture(scope="module")
def record(plant, tmp_path_factory):
    """Makes a recording of the two-joint PUMA with hidden effects; returns its folder and answer."""
    out = tmp_path_factory.mktemp("blind")

    def make(name, kind, effects, channel, *, level="clear", static=False, trust=0.03, seed=1, robot="puma2"):
        plan = plant.Plan(name, kind, tuple(effects), level if effects else None, robot, channel, static, trust)
        for attempt in range(8):
            try:
                answer = plant.make_case(plan, [seed, 0, attempt], out)
                return out / name, answer
            except plant.ImplausibleError:
                continue
        raise AssertionError(f"no draw of {effects}")

    return make


@pytest.fixture(scope="module")
def tilted(record):
    """A diagnosed recording of the sensor's wrench with a tilted base, its folder and its answer."""
    folder, answer = record("tilted", "single", ["base_tilt"], "wrench", seed=9)
    return diagnose(folder, "wrench"), folder, answer


def made(folder, channel, seed=0):
    """The data and the nuisance of its links."""
    data = prepare_data(load_experiment(folder), channel, (), None, seed)
    return data, projector.make_projector(data, ())


@pytest.mark.parametrize(
    ("effect", "channel"),
    [
        pytest.param("sensor_delay", "wrench", marks=pytest.mark.slow),
        ("base_tilt", "wrench"),
        ("coulomb_friction", "torque"),
        pytest.param("torque_ripple", "torque", marks=pytest.mark.slow),
    ],
)
def test_one_hidden_effect_is_named_and_measured(record, request, effect, channel):
    """Name, place, values within four standard deviations, and the gap on the unseen motions is closed."""
    if effect == "base_tilt":
        found, _, answer = request.getfixturevalue("tilted")
    else:
        folder, answer = record(f"single-{effect}", "single", [effect], channel)
        found = diagnose(folder, channel)
    assert found.verdict == "named"
    assert [(f.term.effect.name, f.term.effect.where) for f in found.found] == [(effect, answer["effects"][0]["where"])]
    said = found.to_dict()["effects"][0]["parameters"]
    for key, truth in answer["effects"][0]["parameters"].items():
        if truth.get("main", True):
            assert abs(said[key]["value"] - truth["value"]) < 4 * said[key]["std"] + 0.01 * abs(truth["value"])
    assert found.gap is not None
    assert found.gap.before > 1.5 * found.gap.after
    assert found.gap.after < 1.2 * found.gap.floor
    assert found.gap.closed_low > 0.8


@pytest.mark.slow  # four of them: test_diagnosis_input.py
def test_two_hidden_effects_are_both_named(record):
    """A pair, one at the sensor and one in the gravity it sees."""
    folder, answer = record("pair", "pair", ["sensor_gain", "fluid_drag"], "wrench", seed=3)
    found = diagnose(folder, "wrench")
    assert {f.term.effect.spec for f in found.found} == {f"{e['name']}@{e['where']}" for e in answer["effects"]}


def test_what_nearly_complete_models_leave_is_no_third_effect(record):
    """Of three effects in a model one that explains next to nothing is dropped; three that all explain much stay."""
    for hidden, extra, dropped in (
        (["sensor_gain", "fluid_drag"], ["sensor_crosstalk@fx->mz"], ["sensor_crosstalk@fx->mz"]),
        (["sensor_gain", "fluid_drag", "base_tilt"], [], []),
    ):
        folder, answer = record(f"hidden-{len(hidden)}", "pair", hidden, "wrench", seed=3)
        comparison, nuisance = made(folder, "wrench")
        names = [f"{e['name']}@{e['where']}" for e in answer["effects"]] + extra
        robot, channels = comparison.robot, [*"fx fy fz mx my mz".split()]
        terms = [Term(e, e.starts) for e in EffectLibrary().parse(names, robot.joint_names, channels, None)]
        base, best = fit.fit(nuisance, ()), fit.fit(nuisance, terms)
        models = NoiseModels.of(0, (), candidates.make_library(nuisance, base))
        few, rest = rivals.essential(rivals.Pruned(forward.State(models, base, best, 1.0)))
        assert forward.is_surrogate_combination(best, 0)
        assert [t.effect.spec for t in rest] == dropped
        assert [t.effect.spec for t in few.state.best.terms] == [n for n in names if n not in dropped]


def test_the_evidence_of_an_effect_without_which_no_model_is_possible_is_that_of_its_estimate(record):
    """Play that makes up for a mount, too, is none: the fit without the mount had no score, diagnosis.json an infinite one."""
    folder, answer = record("no-model-without", "pair", ["sensor_gain", "fluid_drag"], "wrench", seed=3)
    comparison, nuisance = made(folder, "wrench")
    names = [f"{e['name']}@{e['where']}" for e in answer["effects"]]
    channels = [*"fx fy fz mx my mz".split()]
    terms = [Term(e, e.starts) for e in EffectLibrary().parse(names, comparison.robot.joint_names, channels, None)]
    base, best, without = (fit.fit(nuisance, x) for x in ((), terms, terms[1:]))
    state = forward.State(NoiseModels.of(0, (), candidates.make_library(nuisance, base)), base, best, 1.0)
    _, usual = rivals.with_rivals(rivals.Pruned(state))
    _, found = rivals.with_rivals(rivals.Pruned(state, {0: replace(without, score=-np.inf)}))
    assert found[0].gain == fit.wald_evidence(best, 0, 1.0) > 0.5 * usual[0].gain
    assert found[1].gain == usual[1].gain


def test_an_unmodelled_effect_is_unknown(record):
    """An effect that the library does not have is not given a name."""
    folder, _ = record("stranger", "unlisted", ["vibration"], "wrench")
    found = diagnose(folder, "wrench")
    assert found.verdict == "unknown"
    assert not found.found
    assert "no effect of the library" in " ".join(found.remarks)


@pytest.mark.parametrize("count", [2, pytest.param(4, marks=pytest.mark.slow)])
def test_nothing_is_named_where_nothing_is_hidden_but_a_naive_noise_names_often(record, monkeypatch, count):
    """Whitened residuals have unit size and nothing is named; without the encoders' share of the noise, names abound."""
    folders = [record(f"none-{k}", "none", [], "wrench", trust=0.0, seed=20 + k)[0] for k in range(count)]
    honest = [diagnose(f, "wrench") for f in folders]
    assert [d.verdict for d in honest] == ["nothing_missing"] * count
    for d in honest:
        assert d.search.base.chi2 / d.search.projector.rows == pytest.approx(1.0, abs=0.3)
    monkeypatch.setattr(encoders, "ROUNDINGS", 0)
    naive = [search.search(made(f, "wrench")[1], (), 0, lambda _: None) for f in folders]
    assert sum(s.base.chi2 / s.projector.rows > 1.5 or bool(s.found) for s in naive) >= count // 2


def test_a_placebo_explains_nothing(record):
    """Columns of the right effect, but of the motion run backwards, gain no more than chance."""
    folder, _ = record("placebo", "single", ["sensor_delay"], "wrench", seed=6)
    _, nuisance = made(folder, "wrench")
    base = fit.fit(nuisance, ())
    block = next(b for b in candidates.make_library(nuisance, base).blocks if b.effect.name == "sensor_delay")
    left = nuisance.project_out(np.concatenate([base.residual, -base.coordinates]))
    column = block.rows[:, 0] / np.linalg.norm(block.rows[:, 0])
    assert (column @ left) ** 2 > 1000
    backwards = nuisance.columns(column[: nuisance.rows][::-1])
    backwards /= np.linalg.norm(backwards)
    # The residual is mostly the true delay, so the placebo is judged against what is left once that is out.
    rest = left - column * (column @ left)
    assert (backwards @ rest) ** 2 < 25


def test_projecting_the_links_out_equals_fitting_them(record):
    """The chi-squared of the reduced problem is that of all columns over their prior at once."""
    folder, _ = record("links", "none", [], "torque", trust=0.05, seed=8)
    data, nuisance = made(folder, "torque")
    base = fit.fit(nuisance, ())
    measured = residual_rows(data, data.segments, data.links, np.zeros(2), ())
    columns = np.vstack([s.white(data.link_columns(s, ())) @ nuisance.root for s in data.segments])
    stacked, target = np.vstack([columns, np.eye(columns.shape[1])]), np.concatenate([measured, np.zeros(columns.shape[1])])
    u, left, *_ = np.linalg.lstsq(stacked, target, rcond=None)
    assert base.chi2 == pytest.approx(float(left[0]), rel=1e-8)
    np.testing.assert_allclose(base.links, data.links + nuisance.root @ u, rtol=1e-6, atol=1e-9)


def test_white_noise_becomes_unit_rows():
    """The spectrum of white noise has the stated variance at every frequency, whatever the taper."""
    rng = np.random.default_rng(0)
    times = np.arange(0, 20, 0.008)
    noise = rng.normal(size=(len(times), 2)) * [0.5, 0.02]
    trajectory = smoothed(times, np.sin(times)[:, None], times, 12.0, False, np.zeros(1))
    segment = spectra.SpectralSegment(
        "m", "identification", times, np.sin(times)[:, None], noise, trajectory, False, (), np.zeros(0)
    )
    np.testing.assert_allclose(quiet_noise([segment.readings]), [0.5, 0.02], rtol=0.12)
    zero = np.zeros(1)
    known = encoders.with_noise(
        segment, lambda s: np.zeros((len(s.trajectory.times), 2)), lambda s, _: s, np.array([0.5, 0.02]), zero, zero, rng
    )
    white = known.whiten(known.measured(noise))
    assert np.mean(white**2) == pytest.approx(1.0, abs=0.12)


@pytest.mark.parametrize("count", [1e-4, 2e-5])
def test_the_encoder_count_is_read_from_the_positions(count):
    """Positions rounded to counts and written with six decimals give the count; smooth ones give none."""
    motion = np.sin(np.arange(0, 10, 0.01))
    assert encoders.encoder_count(np.round(np.round(motion / count) * count, 6), DEFAULT) == pytest.approx(count, rel=1e-6)
    assert encoders.encoder_count(motion, DEFAULT) == 0.0


def test_a_contact_is_left_out_of_other_motions(record):
    """It happened once: neither the other motions nor the validation know it."""
    folder, _ = record("once", "none", [], "wrench", seed=9)
    data, _ = made(folder, "wrench")
    effect = data.places("external_contact")[0]
    once = Episode(effect, (1.0, 2.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0), data.segments[0].motion)
    assert active_terms(data.segments[0], [once])
    assert not any(active_terms(s, [once]) for s in data.unseen)
    assert not any(active_terms(s, [Term(effect, once.values)]) for s in data.unseen)


def test_a_value_inside_its_interval_is_not_named(tilted):
    """However much worse the fit without it."""
    found, folder, _ = tilted
    data, nuisance = made(folder, "wrench")
    best = fit.fit(nuisance, (Term(data.places("base_tilt")[0], (0.0, 0.0)),))
    squared = distance(best, 0)[0]
    assert squared == pytest.approx(
        np.array(best.terms[0].values) @ np.linalg.solve(best.covariance, np.array(best.terms[0].values)), rel=1e-6
    )
    interval = squared / chi2.ppf(DEFAULT.interval, 2)  # that much more dispersion, and the values stay inside
    assert differs_from_zero(best, 0, 0.99 * interval) and not differs_from_zero(best, 0, 1.01 * interval)
    found = found.search
    assert certain(found, 0) is found
    none = certain(replace(found, dispersion=1e3 * interval), 0)
    assert none.found == () and none.best is found.base
    said = remarks(none, None, "nothing_missing", "", ())
    assert any("base_tilt@base would fit what is left" in r and "not named" in r for r in said)
    assert not any("would fit what is left" in r for r in tilted[0].remarks)


def test_play_between_teeth_firmer_than_readings_show_differs_from_zero(tilted):
    """Beside a gap that is known it says nothing that nobody knows how firm they are; where no gap is known, either, it does."""
    _, folder, _ = tilted
    data, nuisance = made(folder, "wrench")
    play = fit.fit(nuisance, (Term(data.places("backlash")[1], (2e-3, 1e-3)),), None, 0)
    known = replace(play, determined=np.array([True, False]), covariance=np.diag([1e-4, 0.0]) ** 2)
    assert distance(known, 0) == (pytest.approx(20.0**2), 1) and differs_from_zero(known, 0)
    for determined in ([False, False], [False, True]):
        vague = replace(play, determined=np.array(determined), covariance=np.diag([1e-4, 1.0]) ** 2)
        assert not differs_from_zero(vague, 0)


def test_what_stays_without_a_soft_joint_is_judged_under_its_own_noise(tilted):
    """Louder noise, which a joint that gives way made of encoders' errors, hides nothing once that joint is not named."""
    found = tilted[0].search
    (tilt,), data = found.found, found.best.projector.data
    effects = (tilt.term, Term(data.places("joint_flexibility")[1], (1e-4,)))
    loud = replace(data, segments=tuple(s.with_noise(9.0 * s.covariance) for s in data.segments))
    soft = projector.make_projector(loud, effects)
    best = replace(fit.fit(soft, effects, found.best, 0), covariance=np.diag([1e-12, 1e-12, 1e6]))
    both = (tilt, replace(tilt, term=best.terms[1], rivals=()))
    sure = certain(replace(found, projector=soft, base=fit.fit(soft, (), found.base), best=best, found=both), 0)
    assert [f.term.effect for f in sure.found] == [tilt.term.effect]
    assert best.chi2 < 0.5 * found.best.chi2 and sure.best.chi2 == pytest.approx(found.best.chi2, rel=0.02)


def test_a_rival_that_differs_from_zero_takes_the_place_of_an_effect_that_does_not(tilted):
    """And the others of the model stay."""
    found = tilted[0].search
    (tilt,), data = found.found, found.best.projector.data
    gain = Term(next(e for e in data.places("sensor_gain") if e.where == "fz"), (0.0,))
    vague = fit.fit(found.best.projector, (gain,), found.base)
    assert not differs_from_zero(vague, 0, 1e3)
    own = replace(tilt, term=gain, rivals=((replace(tilt.term, values=(0.0, 0.0)), 1.2),))
    sure = certain(replace(found, best=replace(vague, covariance=1e6 * vague.covariance), found=(own,)), 0)
    assert [f.term.effect for f in sure.found] == [tilt.term.effect] and sure.found[0].rivals == ()
    np.testing.assert_allclose(sure.found[0].term.values, tilt.term.values, rtol=1e-3)
    assert sure.found[0].gain == pytest.approx(tilt.gain - 1.2)


def test_what_is_named_is_valued_beside_what_stays_unnamed(tilted):
    """An effect of unknown size may be there: left out of the fit it would bias the others, and their intervals not count it."""
    found = tilted[0].search
    (tilt,), data = found.found, found.best.projector.data
    gain = Term(next(e for e in data.places("sensor_gain") if e.where == "fz"), (0.0,))
    both = fit.fit(found.best.projector, (*found.best.terms, gain), found.best)
    wide = np.diag([2.0, 2.0, 1e6]) @ both.covariance @ np.diag([2.0, 2.0, 1e6])
    given = (tilt, replace(tilt, term=both.terms[1], rivals=()))
    sure = certain(replace(found, best=replace(both, covariance=wide), found=given), 0)
    assert [t.effect for t in sure.vague] == [gain.effect] and len(sure.best.terms) == 1
    assert sure.found[0].term.values == both.terms[0].values != sure.best.terms[0].values
    np.testing.assert_allclose(sure.found[0].std, 2.0 * both.std(0, found.dispersion))


@pytest.mark.parametrize(
    ("case", "verdict", "effects"),
    [
        pytest.param("15", "unknown", set(), marks=pytest.mark.slow),
        pytest.param("17", "named", {"base_compliance@base"}, marks=pytest.mark.slow),
        ("18", "named", {"rotor_inertia@joint2"}),
        pytest.param("19", "named", {"joint_flexibility@joint3"}, marks=pytest.mark.slow),
        pytest.param("20", "named", {"dahl_friction@joint2"}, marks=pytest.mark.slow),
        ("21", "nothing_missing", set()),
        pytest.param("22", "unknown", set(), marks=pytest.mark.slow),
    ],
)
def test_recordings_of_an_independent_engine_that_once_went_wrong(shared, case, verdict, effects):
    """Beside what is hidden they once had a gain in place of a clipped channel, one of a mount that rings; a rotor in part, no
    flexible joint; a contact of 0.1 +- 0.7 N, a payload of 1.3 +- 1.6 kg that only the links' prior spoke for, and a tether of
    0.07 +- 0.42 N/m."""
    found = diagnose(shared(f"practice/practice-{case}"))
    assert found.verdict == verdict and {f.term.effect.spec for f in found.found} == effects


def test_a_size_that_another_shape_would_do_with_is_none(record):
    """Of a spring the stiffness counts, not where it rests; where the two are not told apart it is not known at all."""
    folder, _ = record("sizes", "none", [], "torque", seed=9)
    data, nuisance = made(folder, "torque")
    best = fit.fit(nuisance, (Term(data.places("spring")[0], (0.0, 0.0)),))
    certain = np.diag([4.0, 1e-6])  # of stiffness and rest
    one = replace(best, terms=(Term(best.terms[0].effect, (6.0, 5.0)),), covariance=certain, determined=np.array([True, True]))
    assert one.free == ((0, 0), (0, 1)) and distance(one, 0) == (pytest.approx(9.0), 2)
    assert differs_from_zero(one, 0) and not differs_from_zero(replace(one, covariance=4.0 * certain), 0)
    assert not differs_from_zero(replace(one, determined=np.array([False, False])), 0)
    # Stiffness and rest make up for each other: there is a spring, of whatever stiffness.
    product = replace(one, covariance=np.array([[16.0, -9.9], [-9.9, 6.25]]))
    assert distance(product, 0) == (pytest.approx(36.0 / (16.0 - 9.9**2 / 6.25)), 2) and differs_from_zero(product, 0)
    tether = data.places("tether")[0]
    values = (2.0, 0.5, 1.0, 1.0, 9.0, 0.0, 0.0, 0.0)
    pulled = fit.fit(nuisance, (Term(tether, values),), steps=0)
    loose = np.diag([4.0, *[1e-4] * 7])
    loose[0, 4] = loose[4, 0] = -1.97
    loose[4, 4] = 1.0  # the anchor may be out of all bounds
    vague = replace(pulled, covariance=loose, determined=np.ones(8, bool))
    assert distance(vague, 0) == (pytest.approx(1.0), 1) and not differs_from_zero(vague, 0)
    nearer = replace(vague, terms=(Term(tether, (*values[:4], 2.0, *values[5:])),))
    assert distance(nearer, 0)[1] == 8 and differs_from_zero(nearer, 0)
    # Torques of two joints do not tell a contact's force from its arm: something pushes, unless at a point that no link has.
    contact, motion = data.places("external_contact")[0], data.segments[0].motion
    force = np.diag([1e-4, 1e-4, *[100.0] * 3, *[1.0] * 3])
    force[2, 5] = force[5, 2] = 9.99
    for point, named in ((0.1, True), (contact.upper[5], False)):
        push = fit.fit(nuisance, (Episode(contact, (2.0, 4.0, 3.0, 0.0, 0.0, point, 0.0, 0.0), motion),), steps=0)
        push = replace(push, covariance=force, determined=np.array([True, True, *[False] * 6]))
        assert differs_from_zero(push, 0) == named


def test_a_contact_is_no_excuse(record):
    """Its force differs from zero, it ends inside the recording, and lasts longer than it comes up, not most of it."""
    folder, _ = record("excuse", "none", [], "wrench", seed=9)
    data, nuisance = made(folder, "wrench")
    effect, moving = data.places("external_contact")[-1], data.segments[0]
    first, last = moving.times[0], moving.times[-1]
    window, far, push = (first + 2.0, first + 4.0), (0.0, 0.0, 0.0), (50.0, 0.0, 0.0)
    fitted = fit.fit(nuisance, (Episode(effect, (*window, 0.5, 0.0, 0.0, *far), moving.motion),))
    assert not differs_from_zero(fitted, 0)  # nothing pushed: what is found is noise, however well its window is known

    def judged(start, end, force, term=Episode):
        values = (start, end, *force, *far)
        terms = (Episode(effect, values, moving.motion) if term is Episode else Term(data.places("base_tilt")[0], (0.1, 0.1)),)
        return is_excuse(replace(fitted, terms=terms), 0)

    assert not judged(*window, push)
    assert judged(last - 2.0, last, push)
    assert judged(first + 0.5, first + 0.5 + 0.8 * (last - first), push)
    assert judged(first + 2.0, first + 2.08, push)  # beside Stribeck friction at a reversal one of 96 +- 236 N was named
    assert not judged(*window, push, Term)


def test_the_gap_needs_unseen_motions(record):
    """Without validation motions there is a name, no proof, and a remark that says so."""
    folder, _ = record("unproven", "single", ["viscous_friction"], "torque", seed=11)
    experiment = load_experiment(folder)
    every = [m.name for m in experiment.motions]
    found = diagnose(experiment, "torque", motions=every)
    assert found.gap is None
    assert found.to_dict()["gap"] is None
    assert any("validation is missing" in r for r in found.remarks)
    assert validation.validate(found.search.projector, found.search.base, found.search.best, 1.0, 0) is None


def test_a_diverged_model_is_refused(record, monkeypatch):
    """Where derivatives overflow, a model gets no score that anything could lose against."""
    folder, _ = record("away", "none", [], "torque", seed=9)
    data, nuisance = made(folder, "torque")
    [effect] = [e for e in data.places("joint_flexibility") if e.where == "joint2"]
    [body] = [e for e in data.places("inertia_error") if e.where == "joint2"]
    library = candidates.make_library(nuisance, base := fit.fit(nuisance, ()))
    proposals = [p for p in library.propose(base) if p.name == body.spec]

    def endless(*given):
        return np.full((nuisance.rows, len(given[-1].values)), np.inf)

    monkeypatch.setattr(fit, "term_rows", endless)
    for term in (Term(effect, (1e-4,)), Term(body, body.starts)):
        diverged = fit.fit(nuisance, (term,))
        assert diverged.score == -np.inf and diverged.chi2 == np.inf
        assert not diverged.covariance.any() and np.isfinite(diverged.residual).all()
        assert rivals.as_payload(diverged, 0, 1.0) == (diverged.terms[0], 0.0)
    models = NoiseModels.of(0, (), library)
    assert forward.exact_fits(models, base, (), [replace(p, gain=1e3) for p in proposals], 1.0)[1] == []


def changed_link(change: Term, covariance: np.ndarray, unshown: np.ndarray, data) -> SimpleNamespace:
    """As much of a fit of one changed link as its name needs."""
    return SimpleNamespace(
        terms=(change,), score=0.0, unbiased=lambda _: change, columns_of=lambda _: list(range(10)), covariance=covariance,
        unshown=unshown, projector=SimpleNamespace(data=data),
    )  # fmt: skip


def test_a_payload_is_as_rare_as_changes_of_what_a_sensor_weighs(tmp_path):
    """Where a sensor splits the link, a body hangs on the far part, and that part's changes are what it is told from."""
    robot = load_robot(write(tmp_path, wrist_sensor_arm()), sensor_joint="wrist_ft")
    library, names = EffectLibrary(), ("fx", "fy", "fz", "mx", "my", "mz")

    def places(name):
        return library.places(name, robot.joint_names, names)

    data = SimpleNamespace(robot=robot, links=robot.nominal.ravel(), places=places, settings=DEFAULT)
    change = Term(places("inertia_error")[-1], tuple(robot.nominal[-1]))
    term, bonus = rivals.as_payload(changed_link(change, 1e-8 * np.eye(10), np.zeros((10, 0)), data), 0, 1.0)
    assert term.effect.spec == "payload@joint6"
    assert bonus == rivals._rarity(robot.nominal[-1]) != rivals._rarity(robot.nominal[5])


def test_a_payload_is_one_whatever_combinations_are_not_shown(tmp_path):
    """Their values are those of least squares of least norm: far from a body's, and they say nothing against it."""
    robot = load_robot(write(tmp_path, ur5()))
    library = EffectLibrary()

    def places(name):
        return library.places(name, robot.joint_names, ("tau1", "tau2"))

    data = SimpleNamespace(robot=robot, links=robot.nominal.ravel(), places=places, settings=DEFAULT)
    body, size = np.array([10.0, 1.0, -0.5, 0.3, 0.4, 0.02, 0.6, -0.01, 0.03, 0.5]), np.full(10, 0.1)
    axes = np.linalg.qr(np.random.default_rng(4).normal(size=(10, 10)))[0]
    seen = axes[:, 2:] @ axes[:, 2:].T  # two combinations are not shown
    values = size * (seen @ (body / size))
    assert np.linalg.eigvalsh(inertia.pseudo_inertia(values))[0] < -1.0

    def told(of: np.ndarray) -> str:
        change = Term(next(e for e in places("inertia_error") if e.where == "joint2"), tuple(of))
        found = changed_link(change, seen * np.outer(size, size), size[:, None] * axes[:, :2], data)
        return rivals.as_payload(found, 0, 1.0)[0].effect.name

    assert told(values) == "payload"
    assert told(-values) == "inertia_error"  # nothing was taken off that the link does not have


def test_a_changed_link_is_priced_by_its_marginal_likelihood(record):
    """The score's gain is that of Gaussian densities with the link's columns under the prior of the best width."""
    folder, _ = record("heavier", "single", ["inertia_error"], "torque", trust=0.05, seed=11)
    data, nuisance = made(folder, "torque")
    base = fit.fit(nuisance, ())
    [effect] = [e for e in data.places("inertia_error") if e.where == "joint2"]
    changed = fit.fit(nuisance, (Term(effect, (0.0,) * 10),), base)
    zero = np.zeros(data.robot.n)
    measured = residual_rows(data, data.segments, data.links, zero, ())
    links = np.vstack([s.white(data.link_columns(s, ())) for s in data.segments])
    own = Prior.warped(data.links[10:20], 1.0).covariance
    plain = np.eye(len(measured)) + links @ nuisance.root @ (links @ nuisance.root).T
    change = links[:, 10:20] @ own @ links[:, 10:20].T

    def density(covariance: np.ndarray) -> float:
        """Log density, but for a constant; scipy's takes wide covariances for singular."""
        half = np.linalg.cholesky(covariance)
        return float(-0.5 * np.sum(np.linalg.solve(half, measured) ** 2) - np.log(np.diag(half)).sum())

    want = max(density(plain + w**2 * change) for w in fit.WIDTHS) - density(plain) - np.log(len(fit.WIDTHS))
    assert changed.score - base.score == pytest.approx(want, abs=1e-3 * abs(want) + 0.02)


@pytest.mark.parametrize("tool", [True, False])
def test_a_change_beyond_a_sensor_is_priced_by_what_is_there(tmp_path, tool):
    """By dense Gaussian densities of the estimate: the tool's, not the link's before the sensor; without one about a link's."""
    robot = load_robot(write(tmp_path, wrist_sensor_arm()), sensor_joint="wrist_ft")
    links = robot.nominal.copy()
    links[6] *= tool
    data, effect = SimpleNamespace(robot=robot, links=links.ravel()), InertiaError("joint6", 5)
    rng = np.random.default_rng(0)
    moved = split_matrix(robot, 6)
    change = 0.1 * moved @ robot.nominal[6]
    kept = rng.normal(size=(50, 10)) / np.abs(change).clip(1e-4)
    got = fit.price(data, 1000, [Term(effect, tuple(change))], [(0, k) for k in range(10)], kept)
    prior = moved @ Prior.warped(robot.nominal[6] if tool else typical_links(robot)[6], 1.0).covariance @ moved.T
    known = np.linalg.inv(kept.T @ kept)
    peak = multivariate_normal.logpdf(np.zeros(10), cov=known)
    wide = max(multivariate_normal.logpdf(change, cov=known + w**2 * prior) for w in fit.WIDTHS)
    assert got == pytest.approx(peak - wide + np.log(len(fit.WIDTHS)), rel=1e-6)


def test_a_payload_much_heavier_than_the_last_link_is_a_payload_of_that_link(tmp_path):
    """3 kg on the axis of a last link of 0.19 kg: nearly as much of a payload of the link before it, with a rotor beside that."""
    robot = load_robot(write(tmp_path, ur5()))
    body = inertia.from_pseudo_inertia(3.0 * np.block([[np.diag([0.002, 0.0163, 0.002]), np.array([[0.0], [0.12], [0.0]])],
                                                       [np.array([[0.0, 0.12, 0.0]]), np.ones((1, 1))]]))  # fmt: skip
    path = [fourier_trajectory(robot, duration=8.0, seed=1)]
    recorded = simulate(robot, path, effects={"payload@joint6": dict(zip(inertia.PARAMETERS, body, strict=True))}, perturb=0.05)
    found = diagnose(recorded, "wrench").found
    assert [f.term.effect.spec for f in found] == ["payload@joint6"]
    assert abs(found[0].term.values[0] - 3.0) < 4.0 * found[0].std[0]


@given(st.integers(0, 10_000), st.integers(2, 6))
def test_a_step_holds_what_would_pass_its_limit(seed, size):
    """The others change as in least squares without it; by scipy's bounded least squares."""
    rng = np.random.default_rng(seed)
    columns, target = rng.normal(size=(20, size)), rng.normal(size=20)
    lower = rng.uniform(size=size) < 0.5
    change = fit._changes(columns.T @ columns, columns.T @ target, np.ones(size, bool), (lower, np.zeros(size, bool)))(0.0)
    assert np.all(change[lower] >= 0.0)
    kept = change != 0.0
    np.testing.assert_allclose(change[kept], np.linalg.lstsq(columns[:, kept], target)[0], rtol=1e-6, atol=1e-9)
    least = lsq_linear(columns, target, (np.where(lower, 0.0, -np.inf), np.inf)).cost
    left = target - columns @ change
    assert least <= 0.5 * left @ left + 1e-9 <= 0.5 * target @ target + 1e-9


@pytest.mark.parametrize("other", [[], ["tether"]])
def test_readings_that_are_linear_in_the_links_are_not_predicted_anew(record, other):
    """The residual at any links and friction is what an exact prediction leaves, whatever else acts."""
    folder, _ = record(f"linear-{len(other)}", "single", ["viscous_friction"], "torque", seed=11)
    data, nuisance = made(folder, "torque")
    effects = [data.places(name)[1] for name in ("coulomb_friction", "dahl_friction", "torque_ripple", *other)]
    terms = tuple(Term(e, tuple(np.clip(e.typical(data.robot), e.lower, e.upper))) for e in effects)
    u = 0.01 * np.random.default_rng(3).normal(size=nuisance.size)
    links, offset = nuisance.split(u)
    exact = residual_rows(data, data.segments, links, offset, terms)
    np.testing.assert_allclose(nuisance.residual(u, terms), exact, rtol=0.0, atol=1e-7 * np.abs(exact).max())
    for t in terms[:3]:  # their columns are made at the joint alone, too
        assert needs_no_load(t.effect)
        own = term_rows(data, data.segments, links, (), t)
        full = np.vstack([
            s.white(columns(data.robot, data.channels, s.trajectory, links, terms, t.effect, t.values)) for s in data.segments
        ])  # fmt: skip
        np.testing.assert_allclose(own, full, rtol=0.0, atol=1e-9 * np.abs(full).max())


def test_derivatives_from_close_by_end_where_those_made_anew_do(record, monkeypatch):
    """The same values, score and covariance as with all derivatives made anew at every step, which takes more of them."""
    folder, _ = record("kept", "pair", ["dahl_friction", "torque_delay"], "torque", seed=12)
    _, nuisance = made(folder, "torque")
    data, count = nuisance.data, []
    names = ("dahl_friction", "torque_offset", "viscous_friction")
    effects = [*(e for name in names for e in data.places(name)), data.places("torque_delay")[0]]
    terms = tuple(Term(e, tuple(np.clip(e.typical(data.robot), e.lower, e.upper))) for e in effects)

    def counted(*given):
        count.append(1)
        return term_rows(*given)

    monkeypatch.setattr(fit, "term_rows", counted)

    def found():
        """Fitted without the last effect, then with it from there; and how many derivatives that took."""
        count.clear()
        start = fit.fit(nuisance, terms[:-1], steps=100)
        return fit.fit(nuisance, terms, start, steps=100), len(count)

    few, made_few = found()
    monkeypatch.setattr(fit.Derivatives, "changed_by", lambda self, term: np.inf)
    anew, made_anew = found()
    assert made_few < 0.9 * made_anew
    assert few.score == pytest.approx(anew.score, abs=0.05)
    one, other = (np.concatenate([t.values for t in f.terms]) for f in (few, anew))
    std, other_std = (np.sqrt(np.diag(f.covariance)) for f in (few, anew))
    shown = anew.determined & (np.abs(other) > 5.0 * other_std)
    assert np.count_nonzero(shown) >= 4  # level and distance of both that act
    # A fit has settled where chi2 changes by less than 0.02: a seventh of a standard deviation.
    assert np.all(np.abs(one - other)[shown] < np.sqrt(fit._SETTLED) * other_std[shown])
    np.testing.assert_allclose(std[shown], other_std[shown], rtol=0.02)
