"""Motions that tell rivals apart: the closed form against least squares and exact fits, the motions against their limits."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from bayesid.cli import main
from bayesid.design.excitation.options import ExcitationOptions
from bayesid.design.excitation.plan import make_task
from bayesid.design.excitation.series import FourierSeries
from bayesid.design.tell.choose import (
    Planned,
    SeenInstruments,
    checked,
    contest,
    contest_on,
    paces,
    pool,
    prolonged,
    tell,
    tell_effects,
    tell_search,
    unrecorded,
    varied,
    within_limits,
)
from bayesid.design.tell.rivals import Case, PredictedRows, from_effects, from_search, parse_effects, supposed
from bayesid.diagnosis.fit import fit
from bayesid.diagnosis.prepare import prepare_data
from bayesid.diagnosis.projector import make_projector
from bayesid.dynamics.channels import torque_channels
from bayesid.effects import MotionSegment, readings
from bayesid.errors import InputError
from bayesid.recordings.experiment import Experiment, Sensor
from bayesid.results.excitation import DistinguishingMotion, telling_sentence
from bayesid.robot.robot import motion_limits
from bayesid.simulation.simulation import Recorder, simulate, write_simulation
from bayesid.simulation.trajectories import fourier_trajectory, read_trajectory
from bayesid.workflows.diagnose import diagnose
from bayesid.workflows.excite import tell as tell_verb
from tests.simulated import puma2


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    return puma2(tmp_path_factory.mktemp("robot"))


@pytest.fixture(scope="module")
def recorded(robot):
    """Small, slow motions with a weak hose at the second joint, which the first could hold as well."""
    setup = Experiment("arm", robot, (), Sensor(), inertia_rel_std=0.05, position_resolution=1e-4)
    options = {"duration": 8.0, "fundamental": 0.125, "harmonics": 2, "rate": 100.0, "share": 0.15}
    motions = [
        fourier_trajectory(robot, seed=13, **options),
        fourier_trajectory(robot, "validation", "validation", seed=1003, **options),
    ]
    hose = {
        "stiffness": 4.0, "rest_length": 0.073, "anchor_x": 0.0974, "anchor_y": -0.1218, "anchor_z": 0.3652,
        "point_x": 0.05, "point_y": 0.03, "point_z": 0.08,
    }  # fmt: skip
    return simulate(setup, motions, effects={"tether@joint2": hose}, perturb=0.05, seed=5)


@pytest.fixture(scope="module")
def diagnosis(recorded):
    found = diagnose(recorded)
    assert found.verdict == "ambiguous"
    return found


@pytest.fixture(scope="module")
def case(diagnosis):
    return from_search(diagnosis.search)


@pytest.fixture(scope="module")
def bench(case):
    return SeenInstruments.of(case.rivals[0].fit)


@pytest.fixture(scope="module")
def limits(robot):
    return make_task(Experiment("arm", robot, (), Sensor()), ExcitationOptions())[0].limits


@pytest.fixture(scope="module")
def planned(limits):
    return next(iter(pool(limits, 8.0, 1, seed=4)))


# ---- the closed form -------------------------------------------------------------------------------------------------


def test_the_new_evidence_is_that_of_a_joint_least_squares_fit(case, bench, planned):
    """Draws of old knowledge and new readings; each rival fitted to both at once by least squares."""
    c = contest(case, bench, planned)
    rng = np.random.default_rng(0)
    true, other = c.rivals[0], c.rivals[1]
    draws = 3000
    estimates = np.linalg.solve(true.factor, rng.normal(size=(len(true.factor), draws)))
    y = c.rows.readings[0][:, None] + c.rows.columns[0] @ estimates + rng.normal(size=(c.rows.readings.shape[1], draws))
    chi2 = []
    for rival, j, m in zip(c.rivals, c.rows.columns, c.rows.readings, strict=True):
        matrix = np.vstack([rival.factor, j])
        target = np.vstack([np.zeros((len(rival.factor), draws)), y - m[:, None]])
        chi2.append(np.sum((target - matrix @ np.linalg.lstsq(matrix, target, rcond=None)[0]) ** 2, axis=0))
    gain = 0.5 * (chi2[1] - chi2[0]) + c.constant[0] - c.constant[1]
    mean, std = c.moments
    assert abs(gain.mean() - mean[0, 1]) < 4 * std[0, 1] / np.sqrt(draws)
    assert gain.std() == pytest.approx(std[0, 1], rel=0.08)
    # And the joint draws of the reduced problem know how often that is enough.
    right, wrong = c.decided(np.array([1.0, 0.0]))
    assert right == pytest.approx(np.mean(gain > c.needed), abs=0.03)
    assert c.chances(0)[1] == pytest.approx(right, abs=1e-12)
    assert wrong == pytest.approx(np.mean(gain < -c.needed), abs=0.03)
    assert other.evidence < true.evidence


def test_the_noncentrality_is_what_the_best_fit_of_the_other_leaves(case, bench, planned):
    """By least squares on the rows of the motion over what is known, not reduced."""
    c = contest(case, bench, planned)
    for i, j in ((0, 1), (1, 0)):
        matrix = np.vstack([c.rivals[j].factor, c.rows.columns[j]])
        target = np.concatenate([np.zeros(len(c.rivals[j].factor)), c.rows.readings[i] - c.rows.readings[j]])
        left = target - matrix @ np.linalg.lstsq(matrix, target, rcond=None)[0]
        assert c.noncentrality[i, j] == pytest.approx(left @ left, rel=1e-6)


def test_settled_knowledge_leaves_the_textbook_law(case, bench, planned):
    """With all parameters known the log evidence is N(lambda / 2, lambda), lambda the squared distance of the readings."""
    known = tuple(replace(r, factor=1e9 * np.eye(len(r.factor)), evidence=0.0) for r in case.rivals)
    c = contest(replace(case, rivals=known), bench, planned)
    distance = float(np.sum((c.rows.readings[0] - c.rows.readings[1]) ** 2))
    mean, std = c.moments
    assert mean[0, 1] - (c.constant[0] - c.constant[1]) == pytest.approx(0.5 * distance, rel=1e-6)
    assert std[0, 1] == pytest.approx(np.sqrt(distance), rel=1e-6)


def test_rows_are_reduced_without_loss():
    rng = np.random.default_rng(2)
    own, means = [rng.normal(size=(50, k)) for k in (4, 5)], rng.normal(size=(2, 50))
    rows = PredictedRows.of(own, list(means), 50)
    for whole, j in zip(own, rows.columns, strict=True):
        assert np.allclose(j.T @ j, whole.T @ whole)
        assert np.allclose(j.T @ rows.readings[1], whole.T @ (means[1] - means[0]))
    assert np.sum(rows.readings[1] ** 2) == pytest.approx(np.sum((means[1] - means[0]) ** 2))


def test_what_is_the_same_is_never_told_apart(case, bench, planned):
    twins = Case((case.rivals[0], case.rivals[0]), np.array([0.5, 0.5]))
    c = contest(twins, bench, planned)
    assert c.noncentrality[0, 1] == pytest.approx(0.0, abs=1e-9)
    assert c.decided(twins.weights) == (0.0, 0.0)
    told = tell([twins], effort=(4, 2, 1))
    assert told is not None and told.probability < 0.01 and len(told.hopeless) == 2


# ---- motions ---------------------------------------------------------------------------------------------------------


def torque_of(robot, motion, *, still=False):
    rates = (0.0 * motion.velocities,) * 2 if still else (motion.velocities, motion.accelerations)
    trajectory = MotionSegment(motion.times, motion.positions, *rates)
    return np.abs(readings(robot, torque_channels(robot), trajectory, robot.nominal))


def test_motions_stay_within_the_limits_at_a_finer_sampling_and_rest_at_both_ends(robot, limits):
    lower, upper, fastest = motion_limits(robot)
    rng = np.random.default_rng(0)
    motions = list(pool(limits, 9.0, 16, seed=1))
    motions += [m for m in (varied(m, limits, 0.4, rng) for m in motions[:6]) if m is not None]
    assert len(motions) > 12 and len({m.pace.label for m in motions}) == 4
    for m in motions:
        t = m.trajectory("x", 500.0)
        assert (t.positions >= lower).all() and (t.positions <= upper).all()
        assert (np.abs(t.velocities) <= fastest).all()
        assert (torque_of(robot, t) <= robot.effort_limit).all()
        assert (np.abs(t.accelerations) <= limits.acceleration).all()
        assert np.allclose(t.velocities[[0, -1]], 0.0, atol=1e-9) and np.allclose(t.accelerations[[0, -1]], 0.0, atol=1e-9)
        for low, high in ((t.positions, t.velocities), (t.velocities, t.accelerations)):
            slope = np.gradient(low, t.times, axis=0)[2:-2]
            assert np.abs(slope - high[2:-2]).max() < 2e-3 * max(np.abs(high).max(), 1.0)


def test_a_motion_that_takes_too_much_torque_is_slowed_down(robot, limits):
    motion = Planned(FourierSeries(1.0 / 0.7, np.zeros(2), np.full((1, 2), 0.3), np.zeros((1, 2))), paces(10.0)[0], 10.0)
    free = replace(limits, loads=(), acceleration=np.full(2, np.inf))
    strong = within_limits(motion, free)
    assert strong is not None
    at = strong.trajectory("x", 100.0)
    full, held = (torque_of(robot, at, still=still).max(axis=0) for still in (False, True))
    most = 1.4 * held + 0.3 * full
    assert (full > most).any()
    slowed = within_limits(motion, replace(free, loads=(replace(limits.loads[0], most=most),)))
    assert slowed is not None
    assert strong.path.period == 1.0 / 0.7 and slowed.path.period > 1.0 / 0.7
    assert (torque_of(robot, slowed.trajectory("x", 500.0)) <= most).all()
    assert within_limits(motion, replace(free, loads=(replace(limits.loads[0], most=np.full(2, 1e-3)),))) is None


def test_bodies_are_kept_apart_and_joints_that_rest_stay(limits):
    class Wall:
        """Bodies that meet where joint 1 turns beyond 0.4 rad."""

        def ratios(self, positions):
            return 2.5 * positions[:, :1]

    narrow = replace(limits, clearance=Wall(), moving=np.array([0]))
    motions = list(pool(narrow, 8.0, 24, seed=3))
    assert len(motions) > 3
    for m in motions:
        positions = m.trajectory("x", 50.0).positions
        assert positions[:, 0].max() <= 0.4 and np.ptp(positions[:, 1]) == 0.0
        assert positions[0, 1] == pytest.approx(limits.middle[1])


# ---- the choice ------------------------------------------------------------------------------------------------------


def test_the_chosen_motion_is_the_best_of_all_tried_and_settles_the_case(limits, recorded, diagnosis, case, bench):
    told = tell_search(diagnosis.search, effort=(12, 8, 1), options=ExcitationOptions(duration=8.0), seed=1)
    assert told is not None and told.probability > 0.9
    assert {p.true for p in told.pairs} == set(told.rivals) == {"tether@joint1", "tether@joint2"}
    tried = [contest(case, bench, m).decided(case.weights)[0] for m in pool(limits, 8.0, 12, seed=1)]
    assert told.probability >= max(tried) - 0.01
    more = simulate(recorded, [told.trajectory], effects=recorded.truth.effects, links=recorded.truth.links, seed=9)
    after = diagnose(replace(recorded, motions=(*recorded.motions, *more.motions)))
    assert after.verdict == "named" and [f.term.effect.spec for f in after.found] == ["tether@joint2"]


def test_effects_by_name_at_usual_sizes(robot):
    """A recording that shows neither: the case of each effect, and the noncentrality by an exact fit of the other."""
    setup = Experiment("arm", robot, (), Sensor(), inertia_rel_std=0.05, position_resolution=1e-4)
    slow = fourier_trajectory(robot, duration=8.0, fundamental=0.125, harmonics=2, rate=100.0, share=0.15, seed=3)
    data = prepare_data(simulate(setup, [slow], seed=1), "wrench", (), None, 0)
    told = tell_effects(data, ["base_tilt", "sensor_rotation"], effort=(6, 2, 1))
    assert told is not None and not told.estimated and told.weights == (0.5, 0.5)
    assert [(p.true, p.other) for p in told.pairs] == [told.rivals, told.rivals[::-1]]
    assert told.probability > 0.9


@pytest.mark.parametrize(
    ("specs", "complaint"),
    [
        (["base_tilt"], "at least two different effects"),
        (["base_tilt", "base_tilt@base"], "at least two different effects"),
        (["base_tilt", "tether"], "could be at 2 places; name one, as in tether@joint1"),
        (["base_tilt", "coulomb_friction@joint1"], 'acts on no reading of channel="wrench"'),
        (["base_tilt", "tether@joint9"], "joint9"),
    ],
)
def test_names_that_will_not_do(diagnosis, specs, complaint):
    with pytest.raises(InputError, match=complaint):
        parse_effects(diagnosis.data, specs)


def test_a_named_diagnosis_asks_for_no_motion(diagnosis):
    settled = replace(diagnosis.search, found=tuple(replace(f, rivals=()) for f in diagnosis.search.found))
    assert from_search(settled) is None and tell_search(settled) is None


# ---- files -----------------------------------------------------------------------------------------------------------


def test_an_ambiguous_diagnosis_comes_with_a_motion_that_is_ready_to_run(diagnosis, robot, tmp_path):
    from bayesid.recordings.table_reader import read_table

    report = diagnosis.write(tmp_path / "out")
    table, _ = read_table(report.parent / "next_motion.csv", "next_motion.csv", robot.n, False)
    assert np.allclose(table.positions, diagnosis.telling.trajectory.positions, atol=1e-8)
    d = diagnosis.to_dict()
    assert "next_motion.csv" in d["next_experiment"] and "next_motion.csv" in report.read_text(encoding="utf-8")
    assert d["next_motion"]["probability"] == diagnosis.telling.probability > 0.5
    assert {p["true"] for p in d["next_motion"]["pairs"]} == {"tether@joint1", "tether@joint2"}


@pytest.mark.slow
def test_predicted_evidence_against_exact_fits_of_simulated_recordings(robot):
    """Old and new recordings fitted together, exactly, at draws of all that the old ones leave open."""
    setup = Experiment("arm", robot, (), Sensor(), inertia_rel_std=0.05, position_resolution=1e-4)
    slow = fourier_trajectory(robot, duration=8.0, fundamental=0.125, harmonics=2, rate=100.0, share=0.15, seed=3)
    recorded = simulate(setup, [slow], effects={"sensor_crosstalk@fz->my": {"coefficient": 0.002}}, perturb=0.05, seed=1)
    data = prepare_data(recorded, "wrench", (), None, 0)
    (case,) = from_effects(data, parse_effects(data, ["sensor_crosstalk@fz->my", "base_tilt"]))
    limits = make_task(recorded, ExcitationOptions())[0].limits
    planned = next(iter(pool(limits, 8.0, 1, seed=4)))
    c = contest(case, SeenInstruments.of(case.rivals[0].fit), planned)
    first = case.rivals[0].fit
    empty = SeenInstruments.of(first).segment(planned, first)
    times, trajectory = empty.times, empty.trajectory
    at_samples = MotionSegment(
        times, *planned.at(times), still=False, bandwidth=trajectory.bandwidth, middle=trajectory.middle, clear=trajectory.clear
    )
    there = replace(empty, trajectory=at_samples, instant=True)
    root, size = np.linalg.cholesky(empty.covariance), first.projector.size
    rng = np.random.default_rng(3)
    gains = []
    for _ in range(40):
        estimate = np.linalg.solve(case.rivals[0].factor, rng.normal(size=len(case.rivals[0].factor)))
        (term,) = first.terms
        true = replace(term, values=tuple(np.array(term.values) + estimate[size:]))
        exact = data.predict(there, first.links + first.projector.root @ estimate[:size], [true])
        noise = there.samples(np.einsum("kab,kb->ka", root, rng.normal(size=empty.shape)))
        both = replace(data, segments=(*data.segments, replace(there, readings=exact + noise)))
        projector = make_projector(both, first.terms)
        scores = [fit(projector, r.fit.terms).score for r in case.rivals]
        gains.append((scores[0] - scores[1]) / case.rivals[0].dispersion)
    mean, std = c.moments
    assert np.mean(gains) == pytest.approx(mean[0, 1], abs=3 * std[0, 1] / np.sqrt(40) + 0.02 * mean[0, 1])
    assert np.std(gains) == pytest.approx(std[0, 1], rel=0.35)


def test_exact_fits_only_ever_lower_the_expectation(case, bench, planned):
    """What a rival that is free to move far away explains better than the closed form says is taken back."""
    c = contest(case, bench, planned)
    exact = checked(c, case, bench, planned)
    assert (exact.moments[0] <= c.moments[0] + 1e-6).all() and (exact.noncentrality <= c.noncentrality + 1e-6).all()
    assert exact.decided(case.weights)[0] <= c.decided(case.weights)[0] + 0.02
    lower = replace(c, shares=np.zeros((2, 2)), lost=np.full((2, 2), 7.0))
    assert lower.noncentrality[0, 1] == 0.0
    gone = c.moments[0][0, 1] - lower.moments[0][0, 1]
    assert gone == pytest.approx(0.5 * c.noncentrality[0, 1] + 7.0)
    assert c.merit(case.weights) < 0


@pytest.mark.slow
def test_what_given_motions_tell_is_what_a_fit_of_the_other_leaves(robot):
    """Two motions, whatever they read: the noncentrality against chi2 of exact fits to readings without noise."""
    setup = Experiment("arm", robot, (), Sensor(), inertia_rel_std=0.05, position_resolution=1e-4)
    options = {"duration": 8.0, "fundamental": 0.125, "harmonics": 2, "rate": 100.0}
    motions = [fourier_trajectory(robot, f"m{k}", seed=k, share=s, **options) for k, s in ((3, 0.15), (4, 0.3))]
    noisy = Recorder(force_std=30.0, torque_std=5.0)
    data = prepare_data(simulate(setup, motions, recorder=noisy, seed=1), "wrench", (), None, 0)
    effects = parse_effects(data, ["base_tilt", "sensor_rotation"])
    for k, (case, fitted) in enumerate(zip(unrecorded(data, effects), supposed(data, effects), strict=True)):
        c = contest_on(case, fitted.rivals[0].fit.projector.data.segments)
        assert c.noncentrality[k, 1 - k] == pytest.approx(fitted.rivals[1 - k].fit.chi2, rel=0.02)


def test_what_excite_tell_says_and_writes(diagnosis, robot, tmp_path):
    told = DistinguishingMotion("arm", "wrench", ("identification",), diagnosis.telling, {"search": 1.0})
    text = str(told)
    assert "tells tether@joint1 and tether@joint2 together with identification, as large as estimated" in text
    assert text.count("tether@joint1") == 3 and "noncentrality" in text and "arm" in repr(told)
    report = told.write(tmp_path / "out")
    found = json.loads((report.parent / "excitation.json").read_text(encoding="utf-8"))
    assert found["tell"]["file"] == "trajectory.csv" and found["tell"]["probability"] == diagnosis.telling.probability
    again = read_trajectory(report.parent / "trajectory.csv", robot)
    assert np.allclose(again.accelerations, diagnosis.telling.trajectory.accelerations, atol=1e-6)
    hopeless = replace(diagnosis.telling, pairs=tuple(replace(p, probability=0.0) for p in diagnosis.telling.pairs))
    assert "none tells tether@joint1 from tether@joint2" in str(replace(told, telling=hopeless))
    assert "another sensor or channel may" in telling_sentence(hopeless)


def test_limits_that_leave_no_room_cost_the_motion_and_not_the_diagnosis(diagnosis, monkeypatch):
    def refuse(*_, **__):
        raise InputError("no pose keeps the torque within its limit")

    from bayesid.workflows import diagnose as verb

    monkeypatch.setattr(verb, "tell_search", refuse)
    bare = replace(diagnosis, telling=None, next_experiment="Move other joints.")
    found = verb._with_next_motion(bare, None, 0, lambda _: None)
    assert found.verdict == "ambiguous" and found.telling is None
    assert found.next_experiment == "Move other joints. No motion was planned: no pose keeps the torque within its limit."
    assert "next_motion" not in found.next_experiment and found.to_dict()["next_motion"] is None


def test_diagnose_tells_effects_apart_that_are_named(diagnosis, recorded):
    """Whatever the verdict: here of two that nothing in it speaks of."""
    from bayesid.workflows import diagnose as verb

    settled = replace(diagnosis, verdict="nothing_missing", telling=None)
    found = verb._with_next_motion(settled, ["base_tilt", "sensor_rotation"], 0, lambda _: None)
    assert found.telling is not None and found.telling.rivals == ("base_tilt@base", "sensor_rotation@sensor")
    assert "it decides between base_tilt@base and sensor_rotation@sensor" in found.next_experiment
    for wrong, complaint in ((["base_tilt"], "two"), (["base_tilt", "rust"], "rust")):
        with pytest.raises(InputError, match=complaint):
            diagnose(recorded, tell=wrong)
    with pytest.raises(InputError, match="tell and reference are both given"):
        diagnose(recorded, reference=recorded, tell=["base_tilt", "sensor_rotation"])


@pytest.mark.slow
def test_the_command_line(recorded, tmp_path):
    write_simulation(recorded, tmp_path / "arm")
    out = tmp_path / "out"
    asked = ["--tell", "base_tilt,sensor_rotation", "--duration", "6"]
    assert main(["excite", str(tmp_path / "arm"), *asked, "--out", str(out)]) == 0
    found = json.loads((out / "excitation.json").read_text(encoding="utf-8"))
    assert found["recordings"] == ["identification"] and found["tell"]["duration"] == pytest.approx(6.0)
    assert {p["true"] for p in found["tell"]["pairs"]} == {"base_tilt@base", "sensor_rotation@sensor"}
    out = tmp_path / "told"
    assert main(["diagnose", str(tmp_path / "arm"), *asked[:2], "--out", str(out)]) == 0
    found = json.loads((out / "diagnosis.json").read_text(encoding="utf-8"))
    assert {p["true"] for p in found["next_motion"]["pairs"]} == {"base_tilt@base", "sensor_rotation@sensor"}
    assert (out / found["next_motion"]["file"]).is_file()


def test_nothing_recorded_yet(robot):
    """Noise as stated, priors of the links, and usual sizes: a louder sensor tells less."""
    told = []
    for factor in (1.0, 10.0):
        sensor = Sensor(force_std=2.0 * factor, torque_std=0.2 * factor)
        setup = Experiment("arm", robot, (), sensor, inertia_rel_std=0.05, position_resolution=1e-4)
        motion = fourier_trajectory(robot, duration=6.0, rate=100.0, share=0.5, seed=1)
        data = prepare_data(simulate(setup, [motion], seed=0), "wrench", (), None, 0)
        cases = unrecorded(data, parse_effects(data, ["sensor_gain@fx", "sensor_gain@fy"]))
        assert all(r.rows == 0 and r.evidence == 0.0 for case in cases for r in case.rivals)
        found = tell(cases, effort=(3, 0, 0), options=ExcitationOptions(duration=6.0))
        assert found is not None
        told.append(found)
    assert all(w.noncentrality < g.noncentrality for w, g in zip(told[1].pairs, told[0].pairs, strict=True))


def test_a_prolonged_motion_is_the_same_path_for_longer(planned):
    twice = prolonged(planned)
    assert twice.duration == 16.0 and twice.label == planned.label
    times = np.linspace(2.0, 6.0, 9)
    if planned.pace.label == "at one speed":  # beyond the first ramp, which takes longer
        shift = 0.5 * (twice.pace.ramp - planned.pace.ramp)
        assert np.allclose(twice.at(times + shift)[0], planned.at(times)[0])
    assert np.allclose(twice.at(np.array([0.0, 16.0]))[1], 0.0, atol=1e-12)


@pytest.mark.parametrize("options", [{"duration": -1.0}, {"joints": ("joint7",)}])
def test_options_that_will_not_do(recorded, options):
    with pytest.raises(InputError):
        tell_verb(recorded, ["base_tilt", "sensor_rotation"], **options)


def test_a_motion_without_recordings_before_it_is_sampled_as_asked(tmp_path):
    bare = Experiment("bare", puma2(tmp_path), (), Sensor())
    told = tell_verb(bare, ["sensor_delay", "base_tilt"], rate=50.0, duration=6.0)
    np.testing.assert_allclose(np.diff(told.telling.trajectory.times), 0.02)
