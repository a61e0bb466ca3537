"""Effects by name and place, and what every class has to say of itself."""

import numpy as np
import pytest

from bayesid.effects import EffectLibrary, starting_point
from bayesid.errors import InputError
from tests.effects.arms import LIBRARY, both, moving


def test_effects_are_found_where_they_can_be(panda):
    names, channels = panda.joint_names, both(panda).names
    assert len(LIBRARY.places("sensor_crosstalk", names, channels)) == 30
    assert [e.where for e in LIBRARY.places("external_contact", names, channels)][-2:] == ["joint7", "robot"]
    assert LIBRARY.places("viscous_friction", names, channels[:6]) == ()
    assert LIBRARY.parse(["sensor_gain"], names, channels[6:]) == ()
    (cross,) = LIBRARY.parse(["sensor_crosstalk@fx->mz"], names, channels)
    assert cross.axes == (0, 5) and cross.units == ("N m per N",)
    (tether,) = LIBRARY.parse(["tether@panda_joint3"], names, channels)
    assert (tether.where, tether.joint) == ("joint3", 2)
    for spec, message in [
        ("sensor_gain@fq", "no axis 'fq'"), ("sensor_crosstalk@fx", "as in fx->mz"), ("tether@elbow", "no joint 'elbow'"),
        ("base_tilt@joint1", "acts at the base"), ("fluid_drags", "did you mean 'fluid_drag'"),
        ("fluid_drag@joint2", "whole robot"),
    ]:  # fmt: skip
        with pytest.raises(InputError, match=message):
            LIBRARY.parse([spec], names, channels)
    values, free = starting_point([tether, cross], {"tether@panda_joint3": {"stiffness": 40.0, "fixed": True}}, names)
    assert values[0] == 40.0 and list(free) == [False] * 8 + [True]
    with pytest.raises(InputError, match="no parameter 'length'"):
        starting_point([tether], {"tether": {"length": 1.0}}, names)


def test_a_place_goes_before_a_name_that_looks_like_one():
    """Of an arm whose first joint is held: effects are found again by what they are called, values stay with their joint."""
    names, channels = ("joint2", "joint3"), ("tau1", "tau2")
    every = LIBRARY.places("viscous_friction", names, channels)
    for effect in every:
        assert LIBRARY.parse([effect.spec], names, channels) == (effect,)
    assert LIBRARY.parse(["viscous_friction@joint3"], names, channels) == (every[1],)
    stated = {"viscous_friction@joint2": {"coefficient": 3.0, "fixed": True}}
    values, free = starting_point(every, stated, names)
    assert values.tolist() == [0.0, 3.0] and free.tolist() == [True, False]
    odd, wrench = ("base", "robot"), ("fx", "fy", "fz", "mx", "my", "mz", *channels)  # joints that are called as other places
    for name in ("base_tilt", "fluid_drag", "torque_delay", "external_contact", "sensor_offset"):
        for effect in LIBRARY.places(name, odd, wrench):
            assert LIBRARY.parse([effect.spec], odd, wrench) == (effect,)
    rotors = LIBRARY.places("rotor_momentum", names, channels, {"joint2": 50.0})
    assert [e.ratio for e in rotors] == [50.0, None]


def test_descriptions_of_one_thing_exclude_each_other(panda):
    def effects(*specs):
        return LIBRARY.parse(specs, panda.joint_names, both(panda).names)

    bristle, here, there = effects("dahl_friction@joint2", "coulomb_friction@joint2", "coulomb_friction@joint3")
    assert bristle.excludes(bristle) and bristle.excludes(here) and here.excludes(bristle)
    assert not bristle.excludes(there) and not there.excludes(bristle) and not here.excludes(there)
    one, other = effects("tether@joint2", "tether@joint5")
    assert one.single and one.excludes(other)


@pytest.mark.parametrize("name", LIBRARY.classes)
def test_every_class_is_complete(panda, name):
    kind = LIBRARY.classes[name]
    count = len(kind.parameters)
    assert [len(x) for x in (kind.quantities, kind.lower, kind.upper, kind.starts)] == [count] * 4
    assert kind.summary and kind.equation and kind.source
    assert set(kind.confusable_with) <= set(LIBRARY.classes)
    assert {kind.columns_of, kind.may_be} <= {None, *LIBRARY.classes}
    for effect in LIBRARY.places(name, panda.joint_names, both(panda).names):
        size = np.array(effect.typical(panda), float)
        assert np.all(size >= kind.lower) and np.all(size <= kind.upper) and np.isfinite(size).all() and size.any()
    assert np.all(np.array(kind.starts) >= kind.lower) and np.all(np.array(kind.starts) <= kind.upper)


def test_effects_that_are_always_the_same_have_columns_that_no_motion_changes(panda):
    channels, classes = both(panda).names, [c for c in LIBRARY.classes.values() if c.always_the_same]
    found = [e for c in classes for e in LIBRARY.places(c.name, panda.joint_names, channels)]
    assert {e.name for e in found} == {"sensor_offset", "torque_offset"}
    segment = moving(panda, 50)
    for effect in found:
        columns = effect.motion_columns(segment, channels)
        assert np.abs(columns).sum() > 0.0 and np.all(columns == columns[0])


def test_parameters_along_a_sliding_joint_have_its_units(slider):
    """Force for torque and metres for radians in what acts along the joint; a body on its link keeps its own units."""
    library = EffectLibrary().for_robot(slider.n, np.flatnonzero(slider.prismatic).tolist())
    channels = [f"tau{k + 1}" for k in range(slider.n)]

    def units(name):
        return [e.units for e in library.places(name, slider.joint_names, channels)]

    assert slider.prismatic.tolist() == [True, False, True, False]
    assert units("viscous_friction") == [("N s/m",), ("N m s/rad",)] * 2
    assert units("spring") == [("N/m", "m"), ("N m/rad", "rad")] * 2
    assert units("torque_ripple") == [("N", "1/m", "rad"), ("N m", "1/rad", "rad")] * 2
    assert units("joint_flexibility") == [("m/N",), ("rad/(N m)",)] * 2
    assert units("rotor_inertia") == [("kg",), ("kg m^2",)] * 2
    assert units("rotor_momentum") == [("kg m",), ("kg m^2",)] * 2  # a screw turns by the gear ratio a metre
    assert len(set(units("payload"))) == 1 and "kg m^2" in units("payload")[0]
    assert library.with_classes([], "test").sliding == (0, 2)
