"""The plant of the blind set against recordings of another engine, closed forms, and bayesid's own reading of its folders."""

import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import bayesid

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "case_studies" / "blind_naming"))
import arms
import cases
import make
import plant
import practice
from plant import Effect, Motion, Sensor, respond


@pytest.fixture(scope="module")
def ur5():
    """The arm, a sensor in a turned frame and a smooth motion."""
    kind = arms.kinds()["ur5"]
    arm = arms.load(kind.urdf, kind.joints, kind.locked)
    t = np.arange(0.0, 2.0, 0.001)[:, None]
    w, phase = np.array([1.0, 1.3, 1.7, 2.1, 2.5, 2.9]), np.arange(6)
    q, v, a = 0.5 * np.sin(w * t + phase), 0.5 * w * np.cos(w * t + phase), -0.5 * w**2 * np.sin(w * t + phase)
    sensor = Sensor(np.array([0.02, -0.03, -0.05]), np.array([np.pi, 0.0, 0.35]))
    return arm, sensor, Motion("m", "identification", t[:, 0], q, v, a, count=len(t))


def test_weight_of_a_resting_robot(ur5):
    arm, _, motion = ur5
    mass = sum(body.mass for body in arm.model.inertias)
    wrench = respond(arm, Sensor(), motion.still(), still=True).wrench
    np.testing.assert_allclose(wrench[:, 2], 9.81 * mass, rtol=1e-12)
    np.testing.assert_allclose(wrench[:, :2], 0.0, atol=1e-9)


@pytest.mark.parametrize("effect", [
    Effect("tether", "joint4", {"stiffness": 30.0, "rest_length": 0.2, "anchor_x": 0.3, "anchor_y": -0.8, "anchor_z": 1.2,
                              "point_x": 0.05}),
    Effect("fluid_drag", "robot", {"linear": 2.0, "quadratic": 1.0}),
    Effect("external_contact", "joint5", {"start": 0.3, "end": 1.5, "fx": 3.0, "fz": -2.0, "point_y": 0.1}),
])  # fmt: skip
def test_outside_forces_do_the_same_work_in_both_channels(ur5, effect):
    """Virtual work on the joints equals the force's own work: power of the torques' change, from positions alone."""
    arm, sensor, motion = ur5
    with_it, without = respond(arm, sensor, motion, (effect,)), respond(arm, sensor, motion)
    power = np.einsum("kj,kj->k", with_it.torques - without.torques, motion.v)
    assert np.abs(power).max() > 0.1
    if effect.name == "tether":  # what the joints do is stored in the spring
        where = arms.frames(arm, motion.q, motion.v)
        point = where.origin[:, 3] + where.rotation[:, 3] @ effect.vector("point_x", "point_y", "point_z")
        stretch = np.linalg.norm(effect.vector("anchor_x", "anchor_y", "anchor_z") - point, axis=1) - 0.2
        energy = 15.0 * np.maximum(stretch, 0.0) ** 2
        np.testing.assert_allclose(power[1:-1], np.gradient(energy, motion.t)[1:-1], atol=2e-4)
    elif effect.name == "fluid_drag":
        assert power.min() >= -1e-12  # drag only takes
    else:  # between its ramps a contact's force is constant: its power is that force along the point's velocity
        where = arms.frames(arm, motion.q, motion.v)
        point = where.origin[:, 4] + where.rotation[:, 4] @ effect.vector("point_x", "point_y", "point_z")
        whole = (motion.t > 0.55) & (motion.t < 1.25)
        own = np.gradient(point @ effect.vector("fx", "fy", "fz"), motion.t)
        np.testing.assert_allclose(power[whole], -own[whole], atol=2e-3)


def test_rotor_is_two_inertia_changes_in_the_wrench(ur5):
    arm, _, motion = ur5
    spin = 0.3
    rotor = respond(arm, Sensor(), motion, (Effect("rotor_momentum", "joint3", {"inertia": spin}),)).wrench
    where = arms.frames(arm, motion.q, motion.v)
    changes = []
    for j, sign in ((2, 1.0), (1, -1.0)):
        own = np.einsum("ab,a->b", where.rotation[0, j], where.axis[0, 2])
        about = sign * spin * np.outer(own, own)
        changes.append(Effect("inertia_error", f"joint{j + 1}", {
            "Ixx": about[0, 0], "Ixy": about[0, 1], "Iyy": about[1, 1], "Ixz": about[0, 2], "Iyz": about[1, 2],
            "Izz": about[2, 2],
        }))  # fmt: skip
    np.testing.assert_allclose(rotor, respond(arm, Sensor(), motion, tuple(changes)).wrench, atol=1e-9)


def test_stiff_mount_is_a_rigid_one(ur5):
    arm, sensor, motion = ur5
    still = replace(motion, q=0 * motion.q + motion.q[0], v=0 * motion.v, a=0 * motion.a)
    mount = Effect("base_compliance", "base", {"resonance": 40.0, "damping": 0.05})
    got, rigid = respond(arm, sensor, still, (mount,)), respond(arm, sensor, still)
    # at rest: the wrench turned by the tilt, to first order; moments about x and y hold the spring
    assert np.abs(got.wrench - rigid.wrench).max() < 0.5
    np.testing.assert_allclose(got.wrench, np.tile(got.wrench[0], (len(motion.t), 1)), atol=1e-6)


def test_mount_rings_at_its_resonance(ur5):
    """A step of the joints' acceleration sets it off; the period is that of the stated resonance at the home pose."""
    arm, _, motion = ur5
    q = 0 * motion.q + motion.q[0]
    kick = np.where((motion.t > 0.1) & (motion.t < 0.15), 20.0, 0.0)
    moved = replace(motion, q=q, v=0 * q, a=np.outer(kick, [0, 1, 0, 0, 0, 0]))
    *_, tilts = arms.rocked(arm, moved.t, moved.q, moved.v, moved.a, q[0], 8.0, 0.01)
    free = tilts[300:] - tilts[0]
    spectrum = np.abs(np.fft.rfft(free[:, 0] * np.hanning(len(free)), 2**15)) + np.abs(
        np.fft.rfft(free[:, 1] * np.hanning(len(free)), 2**15)
    )
    frequency = np.fft.rfftfreq(2**15, 0.001)[np.argmax(spectrum)]
    masses = np.array(arms.pin.crba(arm.model, arm.model.createData(), np.concatenate([[0, 0, 0, 0, 0, 0, 1], q[0]])))[3:5, 3:5]
    masses[1, 0] = masses[0, 1]
    stiffness = np.trace(masses) / 2 * (2 * np.pi * 8.0) ** 2
    modes = np.sqrt(stiffness / np.linalg.eigvalsh(masses)) / (2 * np.pi)
    assert np.abs(modes - frequency).min() < 0.5


# Cases whose answers state every parameter, the whole recording long: rms of the residual over the stated floor.
@pytest.mark.parametrize(("number", "limit"), [(4, 1.1), (5, 1.1), (9, 1.2), (10, 1.1), (11, 1.1), (13, 1.1)])
def test_conventions_are_those_of_the_practice_recordings(shared, number, limit):
    root = shared("practice")
    answer = json.loads((root / "answers" / f"practice-{number:02d}.json").read_text(encoding="utf-8"))
    sizes = practice.check(root / answer["case"], answer)
    assert sizes["validation after"] < limit
    assert sizes["identification after"] < 1.2
    assert max(sizes["validation before"], sizes["identification before"]) > 1.4


def test_case_without_effects_is_identified_to_the_noise(tmp_path):
    plan = cases.Plan("blind-0001", "none", (), None, "puma2", "wrench", False, 0.05)
    answer = cases.make_case(plan, [3, 1], tmp_path)
    result = bayesid.identify(bayesid.load_experiment(tmp_path / "blind-0001"))
    assert answer["verdict"] == "nothing_missing"
    assert result.validation
    assert all(0.85 < prediction.whitened_rms < 1.2 for prediction in result.validation)


def test_effect_has_the_size_that_is_asked_for(tmp_path):
    plan = cases.Plan("blind-0001", "single", ("sensor_delay",), "moderate", "puma2", "wrench", True, 0.0)
    answer = cases.make_case(plan, [4, 1], tmp_path)
    assert answer["ratio"] == pytest.approx(3.0, rel=0.1)
    assert answer["effects"][0]["name"] == "sensor_delay"
    assert "named" in answer["acceptable_verdicts"]
    # the recording holds it: explained with it, not without
    sizes = practice.check(tmp_path / "blind-0001", answer)
    assert sizes["validation before"] > 2.0
    assert sizes["validation after"] < 1.3


def test_plans_are_balanced_and_reproducible():
    one, other = (list(make.plans(200, 7, tuple(make.SHARES))) for _ in range(2))
    assert one == other
    count = {kind: sum(plan.kind == kind for plan in one) for kind in make.SHARES}
    assert count == {"single": 120, "none": 30, "pair": 30, "unlisted": 20}
    assert {name for plan in one if plan.kind == "single" for name in plan.names} == set(make.WRENCH + make.TORQUE)
    assert all(cases.allowed(name, plan.channel, plan.static) for plan in one for name in plan.names)
    assert plant.UNLISTED and all(plan.names[0] in plant.UNLISTED for plan in one if plan.kind == "unlisted")
