"""Estimates without each part of a recording, against really fitting without it."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.fft import idct

import bayesid
from bayesid.diagnosis.data import Episode, residual_rows
from bayesid.diagnosis.fit import fit
from bayesid.diagnosis.prepare import prepare_data
from bayesid.diagnosis.projector import make_projector
from bayesid.diagnosis.remarks import moment_sentence
from bayesid.diagnosis.rivals import Found
from bayesid.diagnosis.settings import DEFAULT
from bayesid.diagnosis.stability import _grams, stability
from bayesid.effects import Term
from bayesid.workflows.demo import PAPER_LOCKED
from tests.simulated import Motion, Sensor, experiment, fourier, puma2, recording

SENSOR = Sensor(translation=np.array([0.0, 0.0, -0.1]))
NOISE = dict(force_std=0.3, torque_std=0.05, resolution=2e-5)
GAIN = 0.02

ACCEPT, BLOCKS = DEFAULT.accept, 10


def made(robot, gain, names=("identification",)):
    """An arm on a sensor whose axis mx reads ``1 + gain(t)`` times the truth."""
    motions = []
    for k, name in enumerate(names):
        table = recording(robot, SENSOR, fourier(robot, k + 1, duration=8.0, rate=100.0), seed=k + 1, **NOISE)
        wrench = table.wrench.copy()
        wrench[:, 3] *= 1.0 + gain(table.times)
        motions.append(Motion(name, name, replace(table, wrench=wrench)))
    return experiment(robot, motions, SENSOR, inertia_rel_std=0.03, locked=PAPER_LOCKED)


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    return puma2(tmp_path_factory.mktemp("puma"))


def fitted(robot, gain, *names):
    """The data with effects fitted, as the search would hand them on."""
    data = prepare_data(made(robot, gain), "wrench", (), None, 0)
    effects = [e for name, where in names for e in data.places(name) if e.where == where]
    projector = make_projector(data, ())
    best = fit(projector, [Term(e, tuple(0.0 for _ in e.parameters)) for e in effects])
    found = []
    for i, t in enumerate(best.terms):
        without = fit(projector, tuple(x for k, x in enumerate(best.terms) if k != i))
        found.append(Found(t, best.score - without.score, np.zeros(len(t.values))))
    return projector, best, found


def refitted(projector, terms, start, weight):
    """Links and effects fitted with weights of moments, by Gauss-Newton with numeric derivatives: values and chi2."""
    data = projector.data
    (s,) = data.segments
    sizes = [len(t.values) for t in terms]

    def rows(x):
        u, values = x[: projector.size], np.split(x[projector.size :], np.cumsum(sizes)[:-1])
        now = [replace(t, values=tuple(v)) for t, v in zip(terms, values, strict=True)]
        left = residual_rows(data, data.segments, data.links + projector.root @ u, np.zeros(6), now)
        course = idct(left.reshape(s.shape), axis=0, norm="ortho") * weight[:, None]
        return np.concatenate([course.ravel(), u])

    x = np.concatenate([start.coordinates, *[t.values for t in terms]])
    for _ in range(3):
        here = rows(x)
        steps = np.concatenate([np.full(projector.size, 1e-3), np.full(len(x) - projector.size, 1e-4)])
        slope = np.stack([(rows(x + h * e) - here) / h for h, e in zip(steps, np.eye(len(x)), strict=True)], axis=1)
        x = x - np.linalg.lstsq(slope, here, rcond=None)[0]
    left = rows(x)
    return x[projector.size :], float(left @ left)


def test_one_step_is_a_fit_without_the_block(robot):
    """Parameters and evidence without a part are those of an exact fit in which that part has no weight."""
    projector, best, found = fitted(robot, lambda t: GAIN, ("sensor_gain", "mx"), ("base_tilt", "base"))
    (s,) = projector.data.segments
    count = s.shape[0]
    edges = np.linspace(0, count, BLOCKS + 1).astype(int)
    estimates, evidence = [], []
    for a, b in ((edges[0], edges[1]), *zip(edges[3:5], edges[4:6], strict=True)):
        weight = np.ones(count)
        weight[a:b] = 0.0
        values, with_it = refitted(projector, best.terms, best, weight)
        _, without = refitted(projector, best.terms[1:], best, weight)
        estimates.append(values)
        evidence.append(0.5 * (without - with_it) - 0.5 * np.log(projector.rows))
    own, tilt = stability(projector, best, 0, found, 1.0)
    # The same three parts alone: the extremes over all parts hold them, and every one of them moves by its own step.
    grams, moments = _grams(projector, best, 0)
    assert len(moments) == own.blocks == BLOCKS and moments[0].start == pytest.approx(s.times[0])
    start = np.concatenate([t.values for t in best.terms])
    for k, values, log in zip((0, 3, 4), estimates, evidence, strict=True):
        gram = grams.whole - grams.blocks[k]
        step = grams.fitted(gram, [0, 1])[1]
        assert np.max(np.abs(start + step - values) / np.sqrt(np.diag(best.covariance))) < 0.03
        gain = 0.5 * (grams.cost([1], gram) - grams.cost([0, 1], gram))
        assert gain - 0.5 * np.log(projector.rows) == pytest.approx(log, rel=0.01)
        assert own.ranges[0][0] - 1e-5 <= values[0] <= own.ranges[0][1] + 1e-5
        assert tilt.ranges[1][0] - 1e-5 <= values[2] <= tilt.ranges[1][1] + 1e-5
    assert own.least <= min(evidence) * 1.01


def test_blocks_add_up_to_the_whole(robot):
    """Parseval: the blocks of time and the prior hold all inner products of the rows by frequency."""
    projector, best, _ = fitted(robot, lambda t: GAIN, ("sensor_gain", "mx"))
    grams, _ = _grams(projector, best, 0)
    whole = grams.whole + grams.prior
    assert whole[-1, -1] == pytest.approx(best.chi2, rel=1e-9)
    np.testing.assert_allclose(whole[: projector.size, : projector.size], np.eye(projector.size), atol=1e-9)


def test_a_steady_effect_rests_on_no_moment(robot):
    """And its estimate without any part is the same within its uncertainty."""
    projector, best, found = fitted(robot, lambda t: GAIN, ("sensor_gain", "mx"))
    (steady,) = stability(projector, best, 0, found, 1.0)
    std = float(np.sqrt(best.covariance[0, 0]))
    assert steady.rests_on is None and steady.least > ACCEPT
    assert 0.5 * found[0].gain < steady.least < found[0].gain
    low, high = steady.ranges[0]
    assert low <= best.terms[0].values[0] <= high and high - low < 4 * std


@pytest.mark.parametrize("size", [0.02, 0.4])
def test_an_effect_of_a_moment_rests_on_it(robot, size):
    """Something that reads too much for half a second is fitted by a gain, and little or nothing is left without that moment."""
    projector, best, found = fitted(robot, lambda t: size * np.exp(-(((t - 4.4) / 0.12) ** 2)), ("sensor_gain", "mx"))
    assert found[0].gain > ACCEPT
    (once,) = stability(projector, best, 0, found, 1.0)
    assert once.rests_on is not None and once.least < (ACCEPT if size < 0.1 else 0.1 * found[0].gain)
    assert once.rests_on.start < 4.4 < once.rests_on.end and once.rests_on.motion == "identification"
    assert once.to_dict()["rests_on"] == [once.rests_on.start, once.rests_on.end, "identification"]
    low, high = once.ranges[0]
    assert min(abs(low), abs(high)) < 0.5 * abs(best.terms[0].values[0])
    assert "rests on one moment" in moment_sentence(once, ACCEPT)


def test_contacts_and_nothing_are_left_out(robot):
    projector, best, found = fitted(robot, lambda t: GAIN, ("sensor_gain", "mx"))
    effect = projector.data.places("external_contact")[0]
    contact = Episode(effect, (1.0, 2.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0), "identification")
    assert stability(projector, best, 0, [replace(found[0], term=contact)], 1.0) == (None,)
    assert stability(projector, best, 0, [], 1.0) == ()


def test_the_diagnosis_says_it(robot):
    """In diagnosis.json of each effect, and as a remark only where it rests on a moment."""
    found = bayesid.diagnose(made(robot, lambda t: GAIN, ("identification", "validation")))
    (entry,) = found.to_dict()["effects"]
    assert entry["name"] == "sensor_gain"
    assert entry["stability"]["blocks"] >= 5 and entry["stability"]["rests_on"] is None
    assert ACCEPT < entry["stability"]["least_log_bayes_factor"] < entry["log_bayes_factor"]
    (pair,) = entry["stability"]["ranges"]
    assert pair[0] <= entry["parameters"]["gain"]["value"] <= pair[1]
    assert not any("rests on one moment" in r for r in found.remarks)
