"""Pushes of any course in time: found, with the force's course, the point and the link; and refused."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

import bayesid
from bayesid.diagnosis.fit import fit
from bayesid.diagnosis.prepare import prepare_data
from bayesid.diagnosis.projector import make_projector
from bayesid.diagnosis.push import find_push, less_push, without_push
from bayesid.effects import EffectLibrary, Term
from bayesid.recordings.experiment import WRENCH_COLUMNS
from bayesid.results.diagnosis import validation_sentence
from bayesid.workflows.demo import PAPER_LOCKED, puma_two_joint_urdf
from tests.simulated import Motion, Sensor, experiment, fourier, puma2, recording

#: When, and where on the second link [m].
START, END, POINT = 3.2, 6.9, np.array([0.12, -0.05, 0.08])
NOISE = {"force_std": 0.2, "torque_std": 0.02}


def course(times):
    """A force in base axes (N, 3) that wavers by a third; nothing outside its time."""
    grown = np.clip(np.minimum(times - START, END - times) / 0.3, 0.0, 1.0)
    wavers = np.stack([np.sin(2 * np.pi * f * times + k) for k, f in enumerate((0.9, 0.5, 1.3))], axis=1)
    return (np.sin(0.5 * np.pi * grown) ** 2)[:, None] * (np.array([8.0, -6.0, 7.0]) + 3.0 * wavers)


def carried(folder, times, positions, force):
    """What a base sensor reads of a force (N, 3) at the point of the second link, by Pinocchio."""
    model = pin.buildModelFromUrdf(str(folder / "robot.urdf"))
    data, out = model.createData(), np.zeros((len(times), 6))
    for k, (q, f) in enumerate(zip(positions, force, strict=True)):
        pin.forwardKinematics(model, data, np.array([*q, *PAPER_LOCKED.values()]))
        placement = data.oMi[model.getJointId("joint2")]
        out[k] = -np.concatenate([f, np.cross(placement.act(POINT), f)])
    return out


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """Makes an experiment of two motions with something added to their readings, of a sensor under the base."""
    folder = tmp_path_factory.mktemp("push")
    robot = puma2(folder)
    assert (folder / "robot.urdf").read_text(encoding="utf-8") == puma_two_joint_urdf()

    def make(fitted=None, unseen=None, motions=2):
        made = []
        roles = (("one", "identification", fitted), ("two", "validation", unseen))[:motions]
        for k, (name, role, add) in enumerate(roles):
            moved = fourier(robot, 40 + k, duration=10.0, rate=100.0)  # one period
            table = recording(robot, Sensor(), moved, seed=k, **NOISE)
            if add is not None:
                table = replace(table, wrench=table.wrench + add(folder, moved[0], moved[1]))
            made.append(Motion(name, role, table))
        return experiment(robot, made, Sensor(), inertia_rel_std=0.05)

    return make


def pushed(folder, times, positions):
    """A hand on the second link."""
    return carried(folder, times, positions, course(times))


def sought(made):
    """What `find_push` says beside the robot as it is."""
    data = prepare_data(made, "wrench", (), None, 0)
    base = fit(make_projector(data, ()), ())
    return data, find_push(base, base)


def test_a_hand_is_found_with_its_link_its_times_its_force_and_its_point(recorded):
    data, push = sought(recorded(pushed))
    assert push is not None and push.effect.spec == "external_contact@joint2" and push.motion == "one"
    start, end, *_ = push.values
    assert start == pytest.approx(START, abs=0.2) and end == pytest.approx(END, abs=0.2)
    np.testing.assert_allclose(push.values[5:], POINT, atol=0.01)
    assert np.abs(np.array(push.values[5:]) - POINT) == pytest.approx(0.0, abs=4.0 * push.std[5:].max())
    error = push.force - course(push.times)
    assert np.sqrt(np.mean(error**2)) < 0.25  # of 12 N: what noise of 0.2 N a sample leaves of five samples a moment, and more
    assert np.mean(np.abs(error) < 1.96 * push.force_std) > 0.85
    np.testing.assert_allclose(push.values[2:5], push.force.mean(axis=0))


@pytest.mark.parametrize(("start", "end"), [(1.2, 8.1), (1.7, 8.7), (1.5, 8.8)])
def test_a_push_of_most_of_the_motion_is_not_taken_for_one_the_other_way_in_the_rest(recorded, monkeypatch, start, end):
    """Beside an offset of its own motion, all but its wavering is a constant force in the time without it."""
    monkeypatch.setattr(f"{__name__}.START", start)
    monkeypatch.setattr(f"{__name__}.END", end)
    _, push = sought(recorded(pushed))
    assert push is not None and push.effect.spec == "external_contact@joint2"
    assert push.values[:2] == pytest.approx((start, end), abs=0.2)


def test_its_time_has_no_weight_for_the_rest(recorded):
    """What is left is as if nothing had pushed."""
    data, push = sought(recorded(pushed))
    rest, clean = without_push(data, push, 0), sought(recorded())[0]
    fits = [fit(make_projector(d, ()), ()) for d in (data, rest, clean)]
    square = [f.chi2 / f.projector.rows for f in fits]
    assert square[0] > 100.0 and square[1] < 1.3 and square[2] < 1.3
    (s,) = rest.segments
    assert not s.weight(np.linspace(push.values[0], push.values[1], 50)).any()
    assert s.weight(np.array([push.values[0] - 0.3, push.values[1] + 0.3])).all()


def test_readings_less_the_push_are_those_without_it(recorded):
    """Up to what the force's course is off by."""
    made = recorded(pushed)
    _, push = sought(made)
    tables = [m.table for m in (*less_push(made, push).motions, *recorded().motions)]
    error, added = ((a.wrench - tables[2].wrench)[:, :3] for a in (tables[0], made.motions[0].table))
    assert np.sqrt(np.mean(error**2)) < 0.03 * np.sqrt(np.mean(added**2))
    np.testing.assert_array_equal(tables[1].wrench, tables[3].wrench)


def test_a_push_is_taken_from_readings_as_a_faulty_sensor_reads_it(recorded):
    """A sensor that is known to be turned and to read one axis too large."""
    made = recorded(pushed)
    _, push = sought(made)
    effects = EffectLibrary().parse(["sensor_rotation", "sensor_gain@fy"], made.robot.joint_names, WRENCH_COLUMNS)
    terms = [Term(effects[0], (0.1, -0.2, 0.3)), Term(effects[1], (0.25,))]
    mixed = np.kron(np.eye(2), pin.exp3(np.array([0.1, -0.2, 0.3])).T)
    mixed[1] *= 1.25
    table, less = made.motions[0].table, less_push(made, push).motions[0].table
    (faulty, _) = less_push(made, push, terms).motions
    np.testing.assert_allclose(table.wrench - faulty.table.wrench, (table.wrench - less.wrench) @ mixed.T, atol=1e-9)


def no_point(folder, times, positions):
    """Forces and moments of an interval that no point explains."""
    return np.hstack([-course(times), -0.4 * course(times + 0.01)[:, [1, 2, 0]]])


def whole(folder, times, positions):
    """A push that lasts for all of a motion."""
    wavers = np.stack([np.sin(times * f) for f in (4.0, 5.0, 6.0)], axis=1)
    return carried(folder, times, positions, np.array([8.0, -6.0, 7.0]) + 3.0 * wavers)


def turning(folder, times, positions):
    """As much forth as back within a third of a second, as play knocks where a joint turns."""
    inside = np.clip((times - START) / 0.32, 0.0, 1.0)
    return carried(folder, times, positions, np.sin(2.0 * np.pi * inside)[:, None] * np.array([8.0, -6.0, 7.0]))


@pytest.mark.parametrize(
    "options",
    [
        {}, {"fitted": no_point}, {"fitted": whole}, {"fitted": whole, "unseen": whole}, {"fitted": pushed, "motions": 1},
        {"fitted": turning},
    ],
    ids=["nothing", "no point", "all the time", "in every motion", "no other motion", "forth and back"],
)  # fmt: skip
def test_what_is_no_push_is_refused(recorded, options):
    """Nothing; what no point on a link explains; no interval; no motion without it that speaks for it; no force in the mean."""
    assert sought(recorded(**options))[1] is None


def test_it_is_named_and_shown(recorded, tmp_path):
    """Its course is in the file and the report; in the model its mean force stands."""
    found = bayesid.diagnose(recorded(pushed), progress=None)
    assert found.verdict == "named" and [f.term.effect.spec for f in found.found] == ["external_contact@joint2"]
    said = found.to_dict()["effects"][0]
    times = np.array(said["course"]["t"])
    assert said["course"]["motion"] == "one" and said["course"]["unit"] == "N" and said["stability"] is None
    force = np.column_stack([said["course"][axis] for axis in ("fx", "fy", "fz")])
    assert np.sqrt(np.mean((force - course(times)) ** 2)) < 0.25
    assert said["parameters"]["fx"]["value"] == pytest.approx(force[:, 0].mean())
    assert "in ‘one’ alone" in validation_sentence(found)
    found.write(tmp_path)
    assert "in base axes, with its 95 % band" in (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "external_contact@joint2" in (tmp_path / "model.toml").read_text(encoding="utf-8")


@pytest.mark.parametrize("shift", [0.0, 5.0])
def test_a_hand_in_one_of_two_periods_is_no_noise(recorded, shift):
    """Whether in the first or across both, it fills most of what is compared; the noise is then read without it."""
    made = recorded()
    robot = made.robot
    moved = fourier(robot, 40, duration=20.0, rate=100.0)
    table = recording(robot, Sensor(), moved, seed=0, **NOISE)
    hand = carried(robot.urdf.parent, moved[0], moved[1], 4.0 * course(moved[0] - shift))
    pushed_one = Motion("one", "identification", replace(table, wrench=table.wrench + hand))
    diagnosis = bayesid.diagnose(replace(made, motions=(pushed_one, made.motions[1])), progress=None)
    assert diagnosis.verdict == "named" and diagnosis.data.floor_source == "white noise above the band"
    (found,) = diagnosis.found
    assert found.term.effect.spec == "external_contact@joint2"
    np.testing.assert_allclose(found.term.values[5:], POINT, atol=0.01)
