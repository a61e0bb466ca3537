"""Motion segments and the results that are kept with them."""

import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np

from bayesid.dynamics.kinematics import link_states
from bayesid.effects import Model, columns, readings, rigid_columns
from bayesid.effects.segment import Results
from tests.effects.arms import both, load, moving, term


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


def test_threads_share_a_segment(panda):
    """Many threads, more models than results are kept, threads switched every microsecond: each gets its own model's readings."""
    segment, channels = moving(panda, 30), both(panda)
    models = [[term(panda, f"encoder_offset@joint{1 + k % 7}", 0.01 * (k + 1))] for k in range(24)]
    alone = [readings(panda, channels, moving(panda, 30), panda.nominal, terms, gravity=False) for terms in models]

    def work(seed):
        order = np.random.default_rng(seed).permutation(len(models))
        return [(k, readings(panda, channels, segment, panda.nominal, models[k], gravity=False)) for k in order]

    usual = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        with ThreadPoolExecutor(8) as pool:
            found = [pair for pairs in pool.map(work, range(40)) for pair in pairs]
    finally:
        sys.setswitchinterval(usual)
    for k, got in found:
        np.testing.assert_array_equal(got, alone[k])


def test_results_are_kept_by_what_they_hold(panda, tmp_path):
    """A robot and channels made anew, equal to the first, find its results; a change of either does not."""
    segment, channels = moving(panda, 30), both(panda)
    first = Model.of(panda, channels, segment, panda.nominal, ()).true
    twin = load(tmp_path, "panda")
    twin = replace(twin, description=panda.description)
    assert Model.of(twin, both(twin), segment, twin.nominal, ()).true is first
    longer = replace(panda, translation=1.1 * panda.translation)
    assert not np.allclose(Model.of(longer, both(longer), segment, longer.nominal, ()).true, first)


def test_a_few_results_are_kept():
    """The one that was longest not asked for goes first; what is there is not made again."""
    results, made = Results(2), []
    for key in ("a", "b", "a", "c", "a", "b"):
        results.get(key, lambda key=key: made.append(key) or key)
    assert made == ["a", "b", "c", "b"]
