"""Motion segments and the results that are kept with them."""

from bayesid.dynamics.kinematics import link_states
from bayesid.effects import columns, readings, rigid_columns
from tests.effects.arms import both, moving, term


def test_states_are_made_once_a_segment(panda, monkeypatch):
    """Sensor-side and linear effects do not evaluate the dynamics again."""
    import bayesid.effects.model as module

    calls = []
    monkeypatch.setattr(module, "link_states", lambda *a: calls.append(1) or link_states(*a))
    segment, channels = moving(panda, 50), both(panda)
    terms = [term(panda, "payload@joint7"), term(panda, "sensor_gain@fx"), term(panda, "viscous_friction@joint1")]
    readings(panda, channels, segment, panda.nominal, terms)
    for t in terms:
        columns(panda, channels, segment, panda.nominal, terms, t.effect)
    rigid_columns(panda, channels, segment, 1.1 * panda.nominal, terms)
    assert len(calls) == 1
    readings(panda, channels, segment, panda.nominal, [*terms, term(panda, "encoder_offset@joint2")])
    assert len(calls) == 2
