"""Values that are tried exactly, screened by what they change beside the user's model, against trying every one."""

from dataclasses import replace

import numpy as np
import pytest

from bayesid.diagnosis.candidates import make_library
from bayesid.diagnosis.data import residual_rows
from bayesid.diagnosis.fit import fit
from bayesid.diagnosis.prepare import prepare_data
from bayesid.diagnosis.projector import make_projector
from bayesid.effects import Term, exact
from bayesid.robot.examples import PAPER_LOCKED
from tests.simulated import Motion, Sensor, experiment, fourier, puma2, recording

SENSOR = Sensor(translation=np.array([0.0, 0.0, -0.1]))
COMPLIANCE = 4e-4  # a resonance near 6 Hz under the second link [rad/(N m)]


@pytest.fixture(scope="module", params=["stiff", "flexible"])
def library(request, tmp_path_factory):
    robot = puma2(tmp_path_factory.mktemp("puma"))
    motion = fourier(robot, 1, duration=10.0, rate=100.0, speed=2.0)
    table = recording(robot, SENSOR, motion, force_std=0.3, torque_std=0.05, resolution=2e-5)
    given = experiment(robot, [Motion("a", "identification", table)], SENSOR, inertia_rel_std=0.03, locked=PAPER_LOCKED)
    data = prepare_data(given, "wrench", (), None, 0)
    effects = [e for name in ("joint_flexibility", "base_compliance") for e in data.places(name)]
    if request.param == "flexible":
        (trajectory,) = [s.trajectory for s in data.segments]
        soft = Term(next(e for e in effects if e.where == "joint2"), (COMPLIANCE,))
        links = robot.nominal.ravel()
        change = [exact.readings(robot, data.channels, trajectory, links, terms) for terms in ((soft,), ())]
        more = np.column_stack([np.interp(table.times, trajectory.times, x) for x in (change[0] - change[1]).T])
        given = replace(given, motions=(replace(given.motions[0], table=replace(table, wrench=table.wrench + more)),))
        data = prepare_data(given, "wrench", (), None, 0)
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
