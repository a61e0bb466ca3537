"""What a base sensor can and cannot tell, whatever the motion (structure of the columns)."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from bayesid.dynamics.channels import wrench_channels
from bayesid.effects import columns, readings, rigid_columns
from tests.effects.arms import LIBRARY, SHIFT, both, moving, term


def outside(column, span):
    """Share of a column that other columns do not reach."""
    left = column - span @ np.linalg.lstsq(span, column, rcond=None)[0]
    return np.linalg.norm(left) / np.linalg.norm(column)


@pytest.fixture(scope="module")
def rigid(panda):
    segment = moving(panda, 500)
    channels = wrench_channels(panda, np.eye(3), SHIFT * [0, 0, 1])
    constants = np.tile(np.eye(6), (500, 1))
    return segment, channels, rigid_columns(panda, channels, segment, panda.nominal).reshape(3000, -1), constants


@pytest.mark.parametrize("joint", range(1, 8))
def test_rotor_momentum_is_an_inertia_in_the_wrench(panda, rigid, joint):
    segment, channels, span, _ = rigid
    spin = term(panda, f"rotor_momentum@joint{joint}", 0.01)
    column = columns(panda, channels, segment, panda.nominal, [], spin.effect).ravel()
    # It is +c z z' on link i and -c z z' on link i - 1, of which the root has none to give.
    assert outside(column, span) < 1e-6
    # With the torques too, the rotor's reflected inertia is left over once the gear ratio is known.
    torques = both(panda)
    (effect,) = LIBRARY.parse([f"rotor_momentum@joint{joint}"], panda.joint_names, torques.names, {f"panda_joint{joint}": 50.0})
    full = rigid_columns(panda, torques, segment, panda.nominal)
    column = columns(panda, torques, segment, panda.nominal, [], effect)
    inertia = columns(panda, torques, segment, panda.nominal, [], term(panda, f"rotor_inertia@joint{joint}", 1.0).effect)
    flat = full.reshape(-1, full.shape[2])
    assert outside(column.ravel(), flat) > 0.1
    assert outside(column.ravel(), np.column_stack([flat, inertia.ravel()])) < 1e-6


def test_what_no_wrench_can_tell(panda, rigid):
    segment, channels, span, constants = rigid
    # The same gain on all axes is a scale of all links (and of the root, which is constant).
    axes = LIBRARY.places("sensor_gain", panda.joint_names, channels.names)
    gains = sum(columns(panda, channels, segment, panda.nominal, [], e) for e in axes)
    assert outside(gains.ravel(), np.hstack([span, constants])) < 1e-8
    one = columns(panda, channels, segment, panda.nominal, [], axes[3])
    assert outside(one.ravel(), np.hstack([span, constants])) > 0.01
    # A payload is its link's parameters.
    load = columns(panda, channels, segment, panda.nominal, [], term(panda, "payload@joint7").effect)
    np.testing.assert_allclose(load.reshape(3000, 10), span[:, 60:70], atol=1e-10)
    # A vertical offset is weight; the other five axes are not.
    left = [outside(constants[:, k], span) for k in range(6)]
    assert left[2] < 1e-6 and min(np.delete(left, 2)) > 0.01
    # The first encoder's zero turns the sensor about the vertical.
    angle = columns(panda, channels, segment, panda.nominal, [], term(panda, "encoder_offset@joint1").effect).ravel()
    yaw = columns(panda, channels, segment, panda.nominal, [], term(panda, "sensor_rotation").effect)[:, :, 2].ravel()
    # The root's own weight and moment turn along only with the sensor: constants.
    assert outside(angle, np.column_stack([yaw, constants])) < 1e-6
    np.testing.assert_allclose(np.linalg.lstsq(np.column_stack([yaw, constants]), angle, rcond=None)[0][0], 1.0, atol=1e-6)
    second = columns(panda, channels, segment, panda.nominal, [], term(panda, "encoder_offset@joint2").effect).ravel()
    assert outside(second, np.column_stack([yaw, constants])) > 0.5


def test_a_rotors_momentum_is_two_inertias_but_for_what_its_joint_turns(panda, rigid):
    """In all readings, to rounding; a rotor inertia of the joint makes up for the rest. A sliding joint's is none."""
    segment, channels, _, _ = rigid
    around, torques = SimpleNamespace(robot=panda, torques=True), both(panda)
    for joint in (1, 4, 7):
        spin = term(panda, f"rotor_momentum@joint{joint}", 0.02)
        rotor = term(panda, f"rotor_inertia@joint{joint}", -0.02)
        assert spin.effect.same_as(spin.values, around, ()) == ()
        twins = spin.effect.same_as(spin.values, around, (rotor.effect,))
        assert twins == spin.effect.same_as(spin.values, SimpleNamespace(robot=panda, torques=False), ())
        assert len(twins) == min(joint, 2)
        for read, others in ((channels, twins), (torques, (*twins, rotor))):
            own, same = (readings(panda, read, segment, panda.nominal, terms) for terms in ((spin,), others))
            np.testing.assert_allclose(own, same, atol=1e-9 * np.abs(own).max())
        assert replace(spin.effect, slides=True).same_as(spin.values, around, (rotor.effect,)) == ()
