"""Effects that held-out recordings prove although something stays, against rows fitted one by one and a truth that is known."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from scipy.signal import butter, sosfilt

from bayesid import diagnose, identify
from bayesid.diagnosis import in_part
from bayesid.diagnosis.candidates import make_library
from bayesid.diagnosis.choice import Choice
from bayesid.diagnosis.data import FAR, model_rows, residual_rows
from bayesid.diagnosis.fit import fit
from bayesid.diagnosis.forward import unrelated
from bayesid.diagnosis.held_out import HeldOutSums, held_out_sums, left_by, predicts_better, scaled
from bayesid.diagnosis.in_part import ChannelGroup, InPart, _alike, _exact
from bayesid.diagnosis.prepare import known_terms, prepare_data
from bayesid.diagnosis.projector import make_projector
from bayesid.diagnosis.remarks import held_out_text, remarks
from bayesid.diagnosis.search import Search, search
from bayesid.diagnosis.settings import DEFAULT
from bayesid.diagnosis.verdict import named_in_part
from bayesid.effects import EffectLibrary, MotionSegment, Term
from bayesid.effects.drives import Spring
from bayesid.effects.friction import CoulombFriction, StribeckFriction
from bayesid.effects.surroundings import moving
from bayesid.recordings.experiment import Experiment
from bayesid.report.diagnosis import diagnosis_report
from bayesid.robot.robot import Robot, load_robot
from bayesid.simulation.simulation import simulate
from bayesid.simulation.trajectories import fourier_trajectory
from bayesid.workflows import diagnose as workflow
from bayesid.workflows.demo import PAPER_LOCKED, puma_two_joint_urdf
from tests.robots import ur5, write

HIDDEN = {
    "coulomb_friction@joint1": {"level": 5.0},
    "coulomb_friction@joint2": {"level": 6.0},
    "viscous_friction@joint2": {"coefficient": 8.0},
}
#: What no effect of the library is: a torque that depends on both joints.
WOBBLE = {"wobble": {"tau2": "c * sin(5 * q2 + 3 * q1)", "parameters": {"c": {"unit": "N m"}}}}


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """A recording with friction, beside so much (N m) of something that the library lacks; its model has neither."""
    path = tmp_path_factory.mktemp("robot") / "robot.urdf"
    path.write_text(puma_two_joint_urdf(), encoding="utf-8")
    robot = load_robot(path, ["joint1", "joint2"], PAPER_LOCKED)
    library = EffectLibrary().with_expressions(WOBBLE, 2, "test")
    arm = Experiment("arm", robot, (), None, inertia_rel_std=0.05, position_resolution=1e-5, library=library)
    motions = [
        fourier_trajectory(robot, seed=1, duration=10.0, rate=100.0),
        fourier_trajectory(robot, "validation", "validation", seed=2, duration=8.0, rate=100.0),
    ]

    def made(wobble: float) -> Experiment:
        made = simulate(arm, motions, effects={**HIDDEN, "wobble": {"c": wobble}}, perturb=0.05, seed=3)
        return replace(made, library=EffectLibrary())

    return made


@pytest.fixture(scope="module")
def diagnosis(recorded):
    """Friction that the model lacks, beside something that the library lacks."""
    return diagnose(recorded(1.5))


def test_a_model_that_predicts_worse_is_not_handed_on(recorded, monkeypatch):
    """A tether was named with which `identify` predicted unseen motions of a public arm 23 times as badly as without."""
    monkeypatch.setattr("bayesid.workflows.diagnose.predicted_worse", lambda errors: any(e.after is not None for e in errors))
    found = diagnose(recorded(1.5))
    assert found.verdict == "unknown" and not found.found and found.model == ((), {})
    assert any("validation motions are predicted worse than without" in r for r in found.remarks)


def test_friction_is_named_in_part_and_the_rest_stays(diagnosis):
    """Names, values in their intervals, what each closes for certain, and the joint whose torque holds what stays."""
    assert diagnosis.verdict == "named_in_part"
    assert {f.term.effect.spec for f in diagnosis.found} == set(HIDDEN)
    for f in diagnosis.found:
        (truth,) = HIDDEN[f.term.effect.spec].values()
        assert abs(f.term.values[0] - truth) < 3.0 * f.std[0]
    said = diagnosis.to_dict()
    before, *_, after, floor = diagnosis.part.courses
    assert said["remainder"]["share"] == pytest.approx((after - floor) / (before - floor))
    assert all(0.0 < e["share_low"] < e["share"] for e in said["effects"])
    assert {w["channel"] for w in said["remainder"]["where"]} == {"tau2"}
    before, after, floor, closed = (said["gap"][k] for k in ("before", "after", "floor", "closed"))
    assert floor <= after < 0.2 * before
    assert closed == pytest.approx((before**2 - after**2) / (before**2 - floor**2)) and said["gap"]["closed_low"] <= closed <= 1.0


@pytest.mark.parametrize("alone", [False, True], ids=["validation", "alone"])
def test_stated_friction_is_left_out_where_something_stays_beside_it(recorded, alone):
    """What is named without it, if that predicts held-out recordings better; errors are those of both models by `identify`."""
    stated = replace(recorded(2.2), effects=("coulomb_friction",))
    stated = replace(stated, motions=stated.identification) if alone else stated
    found = diagnose(stated, progress=None)
    assert found.verdict == "named_in_part" and {f.term.effect.spec for f in found.found} == set(HIDDEN)
    effects, values = found.model
    assert set(effects) == set(HIDDEN) and "Beside the model's coulomb_friction something stays" in found.remarks[0]
    assert "Without its own coulomb_friction the model misses" in str(found) and found.to_dict()["left_out"] == [
        "coulomb_friction"
    ]
    assert "The model did not state viscous_friction@joint2." in found.remarks[0] and "not found" not in found.remarks[0]
    for model, side in ((stated, "before"), (replace(stated, effects=effects, effect_values=values), "after")):
        own = identify(model, progress=None)
        for told in found.errors:
            (same,) = own.fitted if told.fitted else own.validation
            assert getattr(told, side).relative_error == pytest.approx(same.relative_error, rel=1e-6)
    assert found.errors[0].after.relative_error < found.errors[0].before.relative_error


def test_stated_friction_stays_where_its_values_are_kept(recorded):
    """A user who knows the values is not asked again."""
    stated = replace(
        recorded(2.2), effects=("coulomb_friction",), effect_values={"coulomb_friction": {"level": 5.5, "fixed": True}}
    )
    kept = diagnose(stated, progress=None)
    assert {t.effect.name for t in kept.search.base.terms} == {"coulomb_friction"} and kept.verdict != "nothing_missing"


def test_which_model_predicts_better_is_a_question_to_recordings_left_out(diagnosis):
    """The model with the friction that is there against that without, and the other way about; and neither against itself."""
    s = diagnosis.search
    assert predicts_better(s.best, s.base, s.base, 0) and not predicts_better(s.base, s.best, s.base, 0)
    assert not predicts_better(s.best, s.best, s.base, 0)


def test_effects_are_proven_up_to_the_bandwidth_that_predicts_best(diagnosis, monkeypatch):
    """Where that lies within what was compared, and where what is found there predicts better than what was found before."""
    s, before, asked = diagnosis.search, diagnosis.part, []

    def prepared(below: float):
        asked.append(below)
        return prepare_data(s.projector.data.experiment, "torque", (), None, 0, frozenset(), DEFAULT, below)

    def found(bandwidth: float, tried: InPart | None) -> InPart:
        monkeypatch.setattr(workflow, "chosen_bandwidth", lambda experiment, options: bandwidth)
        part = workflow._where_it_predicts(s, tried, prepared, 0, lambda said: None)
        assert part is not None
        return part

    assert found(20.0, before) is before and asked == []
    assert found(5.0, before) is before and asked == [5.0]  # the same friction explains no more there
    alone = found(5.0, None)
    assert alone.names == set(HIDDEN) and alone.below == 5.0
    assert max(x.frequencies[-1] for x in alone.search.projector.data.segments) <= 4.0
    for f in alone.search.found:
        (truth,) = HIDDEN[f.term.effect.spec].values()
        assert abs(f.term.values[0] - truth) < 3.0 * f.std[0]
    little = replace(before, search=replace(before.search, best=before.search.base, found=()))
    assert found(5.0, little).names == set(HIDDEN)
    said = remarks(alone.search, diagnosis.gap, "named_in_part", "residual", (), alone)
    assert sum("was found up to 4 Hz" in x and "bandwidth of 5 Hz" in x for x in said) == 1


def test_the_gap_is_in_units_of_a_noise_that_is_alike_at_all_frequencies(diagnosis):
    """The residual's root mean square by channel over the noise's, by numpy; the noise's mean square is what was measured."""
    data = diagnosis.data
    measured = prepare_data(data.experiment, data.channel, (), None, 0, frozenset(), DEFAULT)
    level = np.mean([np.diagonal(s.covariance.mean(axis=0)) for s in measured.segments], axis=0)
    shown = data.segments[0].covariance
    np.testing.assert_allclose(shown, np.tile(np.diag(level), (len(shown), 1, 1)), rtol=0.01)  # as found models pass it on
    level = np.diag(shown[0])
    assert np.ptp(measured.segments[0].covariance[:, 0, 0]) > 0.0
    for model, told in ((diagnosis.search.base, diagnosis.gap.before), (diagnosis.search.best, diagnosis.gap.after)):
        left = [s.measured_readings - s.spectrum(data.predict(s, model.links, model.terms)) for s in data.unseen]
        assert np.sqrt(np.mean(np.concatenate(left) ** 2 / level)) == pytest.approx(told, rel=1e-6)


def test_a_search_ends_where_its_effects_are_too_many_to_be_named(diagnosis):
    """Neither the noise of such a model nor its rivals are worth the time: it is where what is proven in part starts from."""
    hidden = {
        "viscous_friction@joint1": {"coefficient": 9.0}, "coulomb_friction@joint2": {"level": 6.0},
        "torque_offset@joint1": {"offset": 3.0}, "spring@joint2": {"stiffness": 20.0, "rest": 0.5},
    }  # fmt: skip
    arm = replace(diagnosis.data.experiment, motions=())
    motions = [fourier_trajectory(arm.robot, seed=1, duration=10.0, rate=100.0)]
    recorded = simulate(arm, motions, effects=hidden, perturb=0.05, seed=3)
    data, phases = prepare_data(recorded, "torque", (), None, 0), []
    found = search(make_projector(data, ()), (), 0, phases.append)
    assert unrelated(found.best, 0) == DEFAULT.likely_effects + 1
    assert phases.count("naming what is missing") <= DEFAULT.likely_effects + 1
    assert "noise as the new model passes it on" not in phases
    assert not any(f.rivals for f in found.found)


def test_it_is_told_in_words_and_in_the_report(diagnosis):
    """Terminal, notebook and report say what is named, what it closes and what stays."""
    text = str(diagnosis)
    assert "named in part" in text
    assert "they close" in text and "is open again" in text
    assert "stays, most of it in tau2" in text
    report = diagnosis_report(diagnosis)
    assert "What stays" in report
    assert "the model as it was" in report and "what a complete model would leave" not in report  # there is no such line
    assert "more that stays unexplained" in diagnosis._repr_html_() and diagnosis.reason == "residual"
    assert ("<p>stays: " in diagnosis._repr_html_()) == bool(diagnosis.remainder)
    assert "<p>disagrees: " not in diagnosis._repr_html_()


def test_where_nothing_stays_the_reason_is_told_instead(diagnosis):
    """Three unrelated effects that leave the noise: said so, and not that more stays."""
    part = replace(diagnosis.part, courses=(*diagnosis.part.courses[:-1], diagnosis.part.courses[-2]))
    said = replace(diagnosis, part=part, reason="surrogates", remainder=())
    assert part.remainder == 0.0
    for text in (str(said), said._repr_html_(), diagnosis_report(said)):
        assert "stays unexplained:" not in text and "0 % stays" not in text and "all of the gap" in text
    # Another motion may show more.
    (unseen,) = [e for e in said.errors if not e.fitted]
    worse, good = (replace(unseen, after=replace(unseen.last, whitened_rms=left)) for left in (27.2, 1.0))
    assert "27.2 times the noise stays on ‘validation’" in str(replace(said, errors=(worse,)))
    assert "times the noise stays on" not in str(replace(said, errors=(good,)))
    s = diagnosis.search
    (why,) = [r for r in remarks(s, said.gap, "named_in_part", "surrogates", (), part) if "Named in part" in r]
    assert "unrelated effects" in why


def test_noise_that_the_readings_are_far_above_is_not_called_unknown(diagnosis):
    """The errors beside it are told in units of that noise."""
    counted = replace(diagnosis, part=replace(diagnosis.part, courses=(*diagnosis.part.courses[:-1], 0.0)))
    for source, said in ((FAR, "stays, the noise included"), ("richest model", "stays, the noise, which is not known, included")):
        assert said in str(replace(counted, data=replace(counted.data, floor_source=source)))


def test_parts_of_one_recording_are_called_that(diagnosis):
    data = diagnosis.data
    assert held_out_text(data, 9) == "parts of the recordings held out in turn"
    assert held_out_text(data, 2) == "motions held out in turn"
    assert held_out_text(replace(data, unseen=()), 8) == "parts of the recording held out in turn"


def test_model_with_the_names_keeps_the_smaller_gap(diagnosis, tmp_path):
    """``model.toml`` holds the effects at their values."""
    diagnosis.write(tmp_path / "out")
    text = (tmp_path / "out" / "model.toml").read_text(encoding="utf-8")
    assert all(spec in text for spec in HIDDEN)


def test_sums_give_what_a_fit_to_the_rows_gives(diagnosis):
    """Held-out errors and log evidence from inner products, against least squares on the rows themselves."""
    s = diagnosis.search
    left = left_by(s.projector.data, s.best)
    data = scaled(s.projector.data, left)
    sums = held_out_sums(data, s.projector.root, s.best, (), np.ones(len(left)))
    segments = (*data.segments, *data.unseen)
    links = np.vstack([x.white(data.link_columns(x, s.best.terms)) @ s.projector.root for x in segments])
    effects = model_rows(data, segments, s.best.links, s.best.terms)
    y = residual_rows(data, segments, s.best.links, s.best.offset, s.best.terms)
    size = sum(x.shape[0] * x.shape[1] for x in data.segments)
    unit = np.sqrt(sums.correlation)

    def fitted(rows, kept, target):
        """Coefficients and squared residual of least squares with rows for the links' prior beneath."""
        prior = np.hstack([np.eye(links.shape[1]), np.zeros((links.shape[1], len(kept)))])
        stacked = np.vstack([np.hstack([links, effects[:, kept]])[rows] / unit, prior])
        full = np.concatenate([target[rows] / unit, -s.best.coordinates[: links.shape[1]]])
        step = np.linalg.lstsq(stacked, full, rcond=None)[0]
        return step, np.sum((full - stacked @ step) ** 2)

    every, all_rows = list(range(effects.shape[1])), np.arange(len(y))
    step, _ = fitted(np.arange(size), every, y)
    expected = np.sum((y - np.hstack([links, effects]) @ step)[size:] ** 2)
    assert sums.squares(range(3))[sums.unseen].sum() == pytest.approx(expected, rel=1e-6)
    # The last effect is linear in its one parameter, so that what the prediction loses without it is a column.
    without = y + effects[:, -1] * s.best.terms[-1].values[0]
    gain = fitted(all_rows, every[:-1], without)[1] - fitted(all_rows, every, y)[1]
    assert sums.cost([0, 1]) - sums.cost([0, 1, 2]) == pytest.approx(gain, rel=1e-6)
    assert sums.evidence([0, 1], [2])[0] == pytest.approx(0.5 * gain - sums.prices[2], rel=1e-6)


@pytest.fixture(scope="module")
def searches() -> list[Search]:
    """What the searches of `beside_much` found."""
    return []


@pytest.fixture(scope="module")
def beside_much(tmp_path_factory, searches):
    """Friction in one joint, and in the other what no effect of the library is, ten times as loud.

    With half the friction the search ends in one of two models, and rounding decides in which.
    """
    path = tmp_path_factory.mktemp("robot") / "robot.urdf"
    path.write_text(puma_two_joint_urdf(), encoding="utf-8")
    robot = load_robot(path, ["joint1", "joint2"], PAPER_LOCKED)
    arm = Experiment("arm", robot, (), None, inertia_rel_std=0.05, position_resolution=1e-5)
    motions = [
        fourier_trajectory(robot, seed=1, duration=10.0, rate=100.0),
        fourier_trajectory(robot, "validation", "validation", seed=2, duration=8.0, rate=100.0),
    ]
    recorded = simulate(arm, motions, effects={"viscous_friction@joint2": {"coefficient": 16.0}}, perturb=0.05, seed=3)

    def louder(motion, seed):
        """Noise below 5 Hz in the first torque, another in every motion."""
        torques, rng = motion.table.torques.copy(), np.random.default_rng(seed)
        torques[:, 0] += 20.0 * sosfilt(butter(2, 5.0, fs=100.0, output="sos"), rng.normal(size=len(torques)))
        return replace(motion, table=replace(motion.table, torques=torques))

    def kept(*given):
        searches.append(search(*given))
        return searches[-1]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("bayesid.workflows.diagnose.search", kept)
        return diagnose(replace(recorded, motions=tuple(louder(m, k) for k, m in enumerate(recorded.motions))))


def test_what_another_joint_does_says_nothing_against_an_effect(beside_much):
    """Named by what it closes in the joint where it acts; in both joints together that is about half."""
    assert beside_much.verdict == "named_in_part"
    (found,) = beside_much.found
    assert found.term.effect.spec == "viscous_friction@joint2"
    assert abs(found.term.values[0] - 16.0) < 3.0 * found.std[0]
    assert 0.3 < beside_much.part.remainder < 0.7
    (group,) = beside_much.part.groups
    assert group.channels == ("tau2",)
    assert group.closed > 0.9
    assert "tau2: " in str(beside_much) and "most of it is closed in the channels" in str(beside_much)


def test_names_that_make_validation_worse_are_told_not_given(beside_much, searches, monkeypatch):
    """Held out in turn they are better, fitted to all fitted motions not: unknown, and the note says so."""
    data, s = beside_much.data, beside_much.search
    found = remarks(s, beside_much.gap, "unknown", "residual", (), beside_much.part, "denied")
    assert any("viscous_friction@joint2 would close" in r and "predict the validation motions no better" in r for r in found)
    assert data.unseen

    def grown(*args, complete=True, **kwargs):
        return replace(beside_much.gap, after=2.0 * beside_much.gap.before)

    again_found = iter(searches)  # the same search of the same data
    monkeypatch.setattr("bayesid.workflows.diagnose.search", lambda *_: next(again_found))
    monkeypatch.setattr("bayesid.workflows.diagnose.validate", grown)
    for later in ("_with_errors", "_with_description"):  # what comes after the verdict
        monkeypatch.setattr(f"bayesid.workflows.diagnose.{later}", lambda result, *_: result)
    again = diagnose(data.experiment, "torque")
    assert again.verdict == "unknown" and not again.found and again.part is None


def test_joints_that_move_in_some_motion():
    """Two places in two recordings are no motion, nor is a crawl."""
    robot = cast(Robot, SimpleNamespace(n=3))

    def trajectory(q):
        return cast(MotionSegment, SimpleNamespace(positions=q, still=False))

    t = np.linspace(0.0, 1.0, 50)
    first, second = np.column_stack([t, 0.0 * t, 1e-4 * t]), np.column_stack([0.0 * t, 0.0 * t + 1.0, 0.0 * t])
    assert moving(robot, [trajectory(first), trajectory(second)]).tolist() == [True, False, False]
    assert moving(robot, []).tolist() == [False] * 3


def test_effects_are_judged_with_those_that_act_in_the_same_channels():
    """One that acts in all of them, as a tether, keeps none of the others from being judged where it acts itself."""
    acting = np.array([[1, 0, 0, 0], [0, 1, 1, 0], [1, 1, 1, 1], [1, 0, 0, 0]], bool)
    groups = {tuple(members): tuple(map(int, np.flatnonzero(mask))) for members, mask in _alike(acting)}
    assert groups == {(0, 3): (0,), (1,): (1, 2), (2,): (0, 1, 2, 3)}


def test_an_imitation_that_leaves_much_is_not_named(diagnosis):
    """Effects that close less than the share asked for are told, not named."""
    assert diagnosis.part is not None
    assert named_in_part(diagnosis.part, DEFAULT)
    assert not named_in_part(diagnosis.part, replace(DEFAULT, most=1.0))
    # Of the whole gap or of that in their channels, but of all their channels.
    little = cast(InPart, SimpleNamespace(remainder=0.6, groups=()))
    groups = tuple(ChannelGroup(("a@joint1",), ("tau1",), closed) for closed in (0.9, 0.6))
    assert not named_in_part(little, DEFAULT)
    assert named_in_part(cast(InPart, SimpleNamespace(remainder=0.6, groups=groups[:1])), DEFAULT)
    assert not named_in_part(cast(InPart, SimpleNamespace(remainder=0.6, groups=groups)), DEFAULT)


@pytest.mark.parametrize(("each", "added"), [((8.0, 7.0, 6.0), [0, 1, 2]), ((4.0, 4.0, 3.0), []), ((8.0, 7.0, -1.0), [0, 1])])
def test_a_kind_of_friction_is_added_at_all_joints_that_show_it_if_they_are_demanded_together(each, added):
    """Each alone stands out too little of what the others leave; another kind does more at one joint, but alone."""
    gains = dict(enumerate((*each, 9.0)))
    effects = (*(CoulombFriction(f"joint{k + 1}", k) for k in range(3)), Spring("joint1", 0))
    sums = SimpleNamespace(
        evidence=lambda _, others: np.array([gains[k] for k in others]),
        cost=lambda kept: -2.0 * sum(gains[k] + 6.0 for k in kept),
        prices=np.full(9, 6.0),
        squares=lambda kept: np.array([-float(len(kept))]),
    )
    choice = _Told(cast(HeldOutSums, sums), effects, (), 0.0, DEFAULT, 0)
    assert sorted(choice.with_a_family([], range(4), lambda *_: True, np.zeros(1))) == added
    assert choice.with_a_family([], range(4), lambda _, k: k != 1, np.zeros(1)) == []
    # Those that are kept already speak for the kind, whatever order they came in.
    assert sorted(choice.with_a_family([0], range(1, 4), lambda *_: True, np.zeros(1))) == (added or [0])


COUPLED = tuple(
    EffectLibrary().parse(
        ["viscous_friction@joint1", "viscous_friction@joint2", "coulomb_friction@joint2", "coupled_friction@joint1->joint2"],
        ("joint1", "joint2"), ("tau1", "tau2"),
    )
)  # fmt: skip


@pytest.mark.parametrize(("kept", "gain", "confirmed", "then"), [
    ([0, 1, 2], 13.0, True, [0, 3]), ([0, 1, 2], 11.0, True, [0, 1, 2]), ([0, 1, 2], 13.0, False, [0, 1, 2]),
    ([0, 1], 13.0, True, [0, 3]), ([0], 30.0, True, [0]), ([0, 3], 30.0, True, [0, 3]),
])  # fmt: skip
def test_an_effect_takes_the_place_of_those_that_it_excludes(kept, gain, confirmed, then):
    """Coupled friction for all friction of the joint whose motor it is, if it adds what any effect must; not for nothing."""
    sums = SimpleNamespace(
        cost=lambda effects: -2.0 * (gain + 6.0 if 3 in effects else 6.0 * len(set(effects) & {1, 2})),
        prices=np.full(9, 6.0),
        squares=lambda effects: np.array([-float(confirmed and 3 in effects)]),
    )
    choice = _Told(cast(HeldOutSums, sums), COUPLED, (), 0.0, DEFAULT, 0)
    assert sorted(choice.with_one_instead(kept, [3], lambda *_: True, np.zeros(1))) == then
    assert choice.with_one_instead(kept, [3], lambda *_: False, np.zeros(1)) == kept


def test_an_effect_that_contains_others_is_neither_added_nor_exchanged_for_one_of_them():
    """Coupled friction explains more than viscous friction of its joint alone: Coulomb friction has to have its chance."""
    gains = {0: 0.0, 1: 60.0, 2: 15.0, 3: 83.0}
    sums = SimpleNamespace(
        evidence=lambda _, others: np.array([gains[k] for k in others]), squares=lambda kept: np.array([-float(len(kept))]),
        prices=np.zeros(9), cost=lambda kept: -2.0 * sum(gains[k] for k in kept),
    )  # fmt: skip
    choice = _Told(cast(HeldOutSums, sums), COUPLED, (), 0.0, DEFAULT, 0)
    assert choice.with_one_more([], range(4), lambda *_: True, np.zeros(1)) == [1]
    assert choice.replaced([1], [0, 2, 3], lambda *_: True, np.zeros(1)) == [1]
    beside_users = replace(choice, users=(1, 2))  # what the user's model has stays beside it
    assert beside_users.with_one_more([], [0, 3], lambda *_: True, np.zeros(1)) == [3]


def test_a_gear_is_found_exactly_where_there_is_one(diagnosis):
    """Of a motor that the first joint turns, too; none where friction is of each joint alone."""
    assert list(_exact(diagnosis.search)) == []
    arm = replace(diagnosis.data.experiment, motions=())
    values = {"coupling": 0.7, "viscous": 5.0, "coulomb": 3.0, "inertia": 0.1}
    motions = [fourier_trajectory(arm.robot, seed=1, duration=10.0, rate=100.0)]
    recorded = simulate(arm, motions, effects={"coupled_friction@joint1->joint2": values}, perturb=0.05, seed=3)
    found = diagnose(recorded).search
    ((term, about),) = _exact(replace(found, best=found.base))
    assert term.values[0] == pytest.approx(0.7, abs=0.05)
    np.testing.assert_allclose(about.to_values(np.array([9.0, 1.0, 2.0, 3.0])), [term.values[0], 1.0, 2.0, 3.0])


@pytest.mark.parametrize(("confirmed", "then"), [(True, [1]), (False, [0])])
def test_an_effect_is_exchanged_for_a_better_one_only_if_held_out_recordings_confirm_that(confirmed, then):
    """Spring instead of Coulomb friction, which explains more."""
    gains = {0: 20.0, 1: 30.0}
    sums = SimpleNamespace(
        evidence=lambda effects, others: np.array([gains[k] if not len(effects) else 0.0 for k in others]),
        squares=lambda effects: np.array([-float(confirmed and 1 in effects)]),
    )
    effects = (CoulombFriction("joint1", 0), Spring("joint1", 0))
    choice = _Told(cast(HeldOutSums, sums), effects, (), 0.0, DEFAULT, 0)
    assert choice.replaced([0], [1], lambda *_: True, np.zeros(1)) == then


@pytest.mark.parametrize(("velocity", "remainder", "then"), [(2.0, 0.02, "other"), (2.0, 0.04, "own"), (0.1, 0.02, "own")])
def test_an_effect_at_the_end_of_what_is_plausible_stands_in_for_another(velocity, remainder, then, monkeypatch):
    """It is left out unless more of the gap stays without it."""

    def part(velocity: float, remainder: float) -> SimpleNamespace:
        found = SimpleNamespace(term=Term(StribeckFriction("joint1", 0), (5.0, velocity)))
        return SimpleNamespace(search=SimpleNamespace(found=(found,)), remainder=remainder)

    parts = {frozenset(): part(velocity, 0.03), frozenset({"stribeck_friction@joint1"}): part(0.1, remainder)}
    monkeypatch.setattr(in_part, "_chosen", lambda _s, _seed, _among, _exact, banned: parts[banned])
    chosen = in_part._proven(cast(Search, None), 0, None)
    assert chosen is list(parts.values())[then == "other"]


@pytest.mark.parametrize("effects", [(), ("encoder_offset@joint1",)])
def test_a_derivative_that_is_but_rounding_is_no_direction(effects, tmp_path):
    """As that of a wrong zero of a joint whose axis is vertical: the richest model leaves the same of the same readings."""
    arm = Experiment("arm", load_robot(write(tmp_path, ur5())), (), None, inertia_rel_std=0.05, position_resolution=1e-5)
    recorded = simulate(arm, [fourier_trajectory(arm.robot, seed=1, duration=8.0, rate=100.0)], perturb=0.05, seed=3)
    left = []
    for seed in range(2):
        noise = 1.0 + 1e-14 * np.random.default_rng(seed).normal(size=recorded.motions[0].table.torques.shape)
        (motion,) = recorded.motions
        table = replace(motion.table, torques=motion.table.torques * noise)
        again = replace(recorded, motions=(replace(motion, table=table),), effects=effects)
        terms, held = known_terms(again, "torque", effects)
        data = prepare_data(again, "torque", terms, None, 0, held, DEFAULT)
        projector = make_projector(data, data.terms)
        base = fit(projector, data.terms)
        library = make_library(projector, base)
        rows, directions = library.unexplained(base)
        left.append(rows @ rows / (projector.rows - directions))
    assert left[0] == pytest.approx(left[1], rel=5e-5)


class _Told(Choice):
    """Held-out recordings are predicted better with whatever is added."""

    def share_low(self, worse, better, before):
        return float((worse - better).sum())
