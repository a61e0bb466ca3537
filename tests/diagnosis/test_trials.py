"""Values that are tried exactly, screened by what they change beside the user's model, against trying every one."""

from dataclasses import replace

import numpy as np
import pytest

from bayesid.diagnosis.candidates import Proposal, make_library
from bayesid.diagnosis.data import residual_rows
from bayesid.diagnosis.fit import fit, is_another
from bayesid.diagnosis.forward import _shortlist, exact_fits
from bayesid.diagnosis.prepare import prepare_data
from bayesid.diagnosis.projector import make_projector
from bayesid.diagnosis.search import _start
from bayesid.effects import Term, exact
from bayesid.effects.placement import MOUNT_RESONANCES
from bayesid.workflows.demo import PAPER_LOCKED
from tests.simulated import Motion, Sensor, experiment, fourier, puma2, recording

SENSOR = Sensor(translation=np.array([0.0, 0.0, -0.1]))
COMPLIANCE = 4e-4  # a resonance near 6 Hz under the second link [rad/(N m)]


@pytest.fixture(scope="module")
def stiff(tmp_path_factory):
    """A recording with nothing hidden."""
    robot = puma2(tmp_path_factory.mktemp("puma"))
    motion = fourier(robot, 1, duration=10.0, rate=100.0, speed=2.0)
    table = recording(robot, SENSOR, motion, force_std=0.3, torque_std=0.05, resolution=2e-5)
    return experiment(robot, [Motion("a", "identification", table)], SENSOR, inertia_rel_std=0.03, locked=PAPER_LOCKED)


def hidden(given, spec, *values):
    """The data of a recording with an effect that changes its wrench, and that effect."""
    data = prepare_data(given, "wrench", (), None, 0)
    effect = next(e for e in data.places(spec.split("@")[0]) if e.spec == spec)
    (trajectory,), (motion,), links = [s.trajectory for s in data.segments], given.motions, given.robot.nominal.ravel()
    change = [exact.readings(given.robot, data.channels, trajectory, links, terms) for terms in ((Term(effect, values),), ())]
    table = motion.table
    more = np.column_stack([np.interp(table.times, trajectory.times, x) for x in (change[0] - change[1]).T])
    with_it = replace(given, motions=(replace(motion, table=replace(table, wrench=table.wrench + more)),))
    return prepare_data(with_it, "wrench", (), None, 0), effect


@pytest.fixture(scope="module", params=["stiff", "flexible"])
def library(request, stiff):
    data = prepare_data(stiff, "wrench", (), None, 0)
    if request.param == "flexible":
        data, _ = hidden(stiff, "joint_flexibility@joint2", COMPLIANCE)
    effects = [e for name in ("joint_flexibility", "base_compliance") for e in data.places(name)]
    projector = make_projector(data, ())
    base = fit(projector, ())
    gain = next(e for e in data.places("sensor_gain") if e.where == "mx")
    beside = fit(projector, (Term(gain, (0.0,)),), base)
    return make_library(projector, base, None, effects), base, beside


def exhaustive(library, now, effect):
    """What each of the values gains, links and offset refitted."""
    projector, data = library.projector, library.projector.data
    prior = -projector.prior_residual(now.coordinates)

    def left(terms):
        rows = residual_rows(data, data.segments, now.links, now.offset, terms)
        return float(np.sum(projector.project_out(np.concatenate([rows, prior])) ** 2))

    return [left(now.terms) - left((*now.terms, Term(effect, tuple(v)))) for v in effect.trials(library.around)]


def test_the_best_value_is_found(library):
    made, base, beside = library
    for now in (base, beside):
        every = {**made._changes, **made._last_changes}
        found = {term.effect: (term, gain) for term, gain in made._tried(now, set(), every)}
        for effect in made.effects:
            gains = exhaustive(made, now, effect)
            if max(gains) <= 0.0:
                assert effect not in found or found[effect][1] == 0.0
                continue
            term, gain = found[effect]
            # Two values next to each other may gain alike; beside another effect the screen is not exact.
            assert gain == pytest.approx(max(gains), rel=1e-6 if now is base else 0.02)
            assert term.values == tuple(effect.trials(made.around)[int(np.argmax(gains))]) or now is beside


@pytest.mark.parametrize(("between", "damping"), [(0, 0.01), (2, 0.03), (3, 0.05), (4, 0.1)])
def test_a_resonance_between_two_that_are_tried_is_found(stiff, between, damping):
    """From the best of the values that are tried, wherever a mount resonates in the motion's band."""
    resonance = float(np.sqrt(MOUNT_RESONANCES[between] * MOUNT_RESONANCES[between + 1]))
    data, mount = hidden(stiff, "base_compliance@base", resonance, damping)
    projector = make_projector(data, ())
    base = fit(projector, ())
    made = make_library(projector, base, None, [mount])
    ((term, gain),) = made._tried(base, set(), made._changes)
    fitted = fit(projector, (term,), base)
    assert gain > 0.0 and fitted.terms[0].values == pytest.approx((resonance, damping), rel=0.05)
    assert fitted.chi2 < 1.1 * projector.rows


def test_what_is_tried_is_fitted_whatever_columns_promise(stiff):
    """A sharp resonance gains little as it is tried, beside what columns explain at most."""
    data, mount = hidden(stiff, "base_compliance@base", 4.0, 0.05)
    projector = make_projector(data, ())
    base = fit(projector, ())
    proposals = make_library(projector, base).propose(base)
    own = next(p for p in proposals if p.term.effect == mount)
    promised = [replace(p, gain=10.0 * own.gain) for p in proposals if p is not own]
    chosen = _shortlist([*promised, own], 1.0, data.settings, 2)
    assert own.tried and len(chosen) == 3 and chosen[-1] is own


@pytest.mark.parametrize(
    ("spec", "truth", "start", "spring"),
    [
        ("joint_flexibility@joint2", (COMPLIANCE / 4,), (0.02, 100.0), True),
        ("backlash@joint1", (0.002, 2.0), (0.001, 1.5), False),
    ],
)  # fmt: skip
def test_a_play_that_is_no_more_than_a_spring_has_no_score(stiff, spec, truth, start, spring):
    """Its gap grows with the torque at which teeth are firm, and nothing says how large both are."""
    data, own = hidden(stiff, spec, *truth)
    play = next(e for e in data.places("backlash") if e.where == own.where)
    fitted = fit(make_projector(data, ()), (Term(play, start),))
    assert is_another(fitted, 0) == spring == np.isneginf(fitted.score)
    # A search fits what it is instead.
    state = _start(make_projector(data, ()), (), 0)
    _, (found, *_) = exact_fits(state.models, state.base, (), [Proposal(Term(play, start), 1e6, 2)], 1.0)
    assert found.terms[0].effect == own and found.terms[0].values[0] == pytest.approx(truth[0], rel=0.1)
    # What the user states is what it is.
    stated = fit(make_projector(replace(data, terms=(Term(play, start),)), ()), (Term(play, start),))
    assert not is_another(stated, 0) and np.isfinite(stated.score)


def test_a_model_whose_links_columns_diverge_is_refused(library):
    made, _, beside = library
    lost = replace(made.projector, q=np.full_like(made.projector.q, np.nan), r=np.full_like(made.projector.r, np.nan))
    assert made.projector.finite and not lost.finite
    with np.errstate(invalid="ignore"):
        refused = fit(lost, beside.terms, beside)
    assert refused.score == -np.inf and refused.chi2 == np.inf
