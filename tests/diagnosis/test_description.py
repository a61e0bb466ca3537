"""Descriptions: shapes and their columns against brute force, hidden curves found again, and nothing found in noise."""

import json
from dataclasses import replace

import numpy as np
import pytest

import bayesid
from bayesid.cli import main
from bayesid.diagnosis.description.candidates import CandidateTerm, candidates
from bayesid.diagnosis.description.choose import adapted, closed
from bayesid.diagnosis.description.columns import halves, ranges_of
from bayesid.diagnosis.description.describe import describe, draft_table, may_be
from bayesid.diagnosis.description.shapes import Shape, ShapeFactor, single
from bayesid.diagnosis.fit import fit
from bayesid.diagnosis.prepare import prepare_data
from bayesid.diagnosis.projector import make_projector
from bayesid.recordings.schema import read_model
from tests.report_pages import read
from tests.simulated import Motion, experiment, fourier, puma2, recording

LEVEL, WIDTH = 0.6, 0.12


def bristle(x):
    """Dahl's friction over its level, step by step."""
    state, out = 0.0, [0.0]
    for step in np.diff(x):
        keep = np.exp(-abs(step) / WIDTH)
        state = keep * state + (1.0 - keep) * np.sign(step)
        out.append(state)
    return np.array(out)


def made(robot, hidden, names=("one", "two", "validation"), seed=0):
    """Torques of the two-joint arm, with something hidden in the second one, a function of all positions and speeds."""
    motions = []
    for k, name in enumerate(names):
        motion = fourier(robot, 10 * seed + k + 1, duration=7.0, rate=100.0)
        table = recording(robot, None, motion, seed=10 * seed + k + 1, torque_std=0.1, resolution=2e-5)
        torques = table.torques.copy()
        torques[:, 1] += hidden(*motion[1:3])
        role = "validation" if name == "validation" else "identification"
        motions.append(Motion(name, role, replace(table, torques=torques)))
    return experiment(robot, motions, inertia_rel_std=0.03)


def nothing(q, v):
    return np.zeros(len(q))


def fitted(recorded):
    """The user's model of a recording."""
    data = prepare_data(recorded, "torque", (), None, 0)
    return fit(make_projector(data, ()), ())


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    return puma2(tmp_path_factory.mktemp("puma"))


@pytest.fixture(scope="module")
def found(robot):
    """A hose that the first joint drags along pulls at the second."""
    return bayesid.diagnose(made(robot, lambda q, v: LEVEL * bristle(q[:, 0])))


def test_what_no_effect_explains_is_described(found):
    """The curve that was hidden, its size and its width, on motions that were neither fitted nor chosen on."""
    assert found.verdict == "unknown"
    assert not found.found
    d = found.description
    (term,) = d.terms
    (factor,) = term.candidate.shape.products[0]
    assert (factor.form.split("(")[0], factor.variable, term.candidate.channels) == ("hysteresis", "q1", (1,))
    assert factor.number == pytest.approx(WIDTH, rel=0.15)
    assert d.term.values[0] == pytest.approx(LEVEL, abs=max(4.0 * d.std[0], 0.03))
    assert d.gap.closed > 0.9
    assert d.gap.closed_low > 0.8
    assert "hose" in d.causes[0][0]


def test_the_draft_closes_the_gap_that_it_promises_when_identify_uses_it(found, tmp_path):
    """The file beside the report goes into ``--effects-from`` and ``--model``; unseen motions are then predicted to the noise."""
    folder, out = tmp_path / "arm", tmp_path / "diagnosed"
    bayesid.write_experiment(found.data.experiment, folder)
    page = read(found.write(out).read_text(encoding="utf-8")).text
    assert "Described, not named" in page and "cannot be told from nothing" not in page
    said = json.loads((out / "diagnosis.json").read_text(encoding="utf-8"))["description"]
    assert said["formulas"].keys() == {"tau2"}
    draft = out / "draft_effect.toml"
    effects, values, formulas = read_model(draft)
    assert effects == ("draft@joint2",)
    assert values["draft@joint2"]["c1"] == pytest.approx(found.description.term.values[0])
    assert list(formulas) == ["draft"]

    def left(*options):
        result = tmp_path / f"fit-{len(list(tmp_path.iterdir()))}"
        command = ["identify", str(folder), "--channel", "torque", *options, "--out", str(result)]
        assert main(command) == 0
        return json.loads((result / "estimate.json").read_text())["validation"][0]["whitened_rms_by_channel"]["tau2"]

    plain = left()
    assert plain > 4.0
    for options in (["--effects-from", str(draft), "--effects", "draft@joint2"], ["--model", str(draft)]):
        assert left(*options) < 1.15


CUBE = 1e-4


@pytest.mark.slow
def test_effects_of_which_nothing_is_left_beside_a_description_are_not_named(robot):
    """A drive's torque that reads too little the larger it is: a gain and an offset imitate most of it, and are none."""
    recorded = made(robot, nothing)
    motions = []
    for m in recorded.motions:
        torques = m.table.torques.copy()
        torques[:, 1] -= CUBE * torques[:, 1] ** 3
        motions.append(replace(m, table=replace(m.table, torques=torques)))
    found = bayesid.diagnose(replace(recorded, motions=tuple(motions)))
    assert (found.verdict, found.found, found.part) == ("unknown", (), None)
    assert any("torque_gain@joint2" in r and "not named" in r for r in found.remarks)
    (term,) = found.description.terms
    assert term.candidate.shape.texts == ("tau2**3",)
    assert found.description.term.values[0] == pytest.approx(-CUBE, abs=3.0 * found.description.std[0])
    assert found.description.gap.closed > 0.9


@pytest.mark.parametrize("seed", [1, 2])
def test_noise_is_not_described(robot, seed):
    """Thousands of candidates, nothing hidden, and no verdict in the way."""
    base = fitted(made(robot, nothing, seed=seed))
    assert describe(base, [base], None) is None


def test_what_happens_in_one_motion_only_is_not_described(robot):
    """A curve that unseen motions do not have is no draft, however plain it is in the fitted ones."""
    with_it, without = (made(robot, curve) for curve in (lambda q, v: 2.0 * v[:, 1] ** 3, nothing))
    base = fitted(replace(with_it, motions=(*with_it.motions[:2], without.motions[2])))
    assert describe(base, [base], None) is None


def test_gains_are_those_of_least_squares(robot):
    """Fast gains of all candidates against an explicit regression on a few, in halves by motion and by time."""
    rng = np.random.default_rng(0)
    for names in (("one", "two", "validation"), ("one", "validation")):
        base = fitted(made(robot, lambda q, v: v[:, 1] ** 2, names))
        first, second = halves(base)
        ranges = ranges_of(first.parts + second.parts)
        pool = candidates(("tau1", "tau2"), [0, 1], ranges, 10.0)
        pool = [pool[k] for k in rng.choice(len(pool), 40, replace=False)]
        for half in (first, second):
            fast = half.gains(pool)
            for gain, candidate in zip(fast, pool, strict=True):
                left = half.columns(candidate)
                expected = np.sum(half.residual**2) - np.linalg.lstsq(left, half.residual)[1].sum()
                assert gain == pytest.approx(expected, rel=1e-6, abs=1e-6) or gain == 0.0
            assert np.count_nonzero(fast) > 20


def test_numbers_are_adapted(robot):
    """A rate that lies between those tried is found to a hundredth."""
    base = fitted(made(robot, lambda q, v: 0.8 * np.sin(5.3 * q[:, 1] + 0.4)))
    waves = tuple((ShapeFactor(f"{w}({{n}} * {{x}})", "q2", "ripple", number=5.0, step=0.4),) for w in ("sin", "cos"))
    first, second = halves(base)
    best, _ = adapted(first, CandidateTerm(Shape(waves), (1,)))
    assert best.shape.numbers[0][1] == pytest.approx(5.3, rel=0.01)
    left = second.columns(best)
    after = second.residual - left @ np.linalg.lstsq(left, second.residual)[0]
    share, low = closed(second, second.residual, after, base.projector.data.settings, 0)
    assert 0.9 < low < share < 1.05


def test_units_are_those_of_the_joint():
    both = single(ShapeFactor("{x}", "q2", "position", 2), ShapeFactor("{x}", "v1", "speed", 1))
    for sliding, unit in (((), "N m per (rad)^2 per rad/s"), ((1,), "N per (m)^2 per rad/s"), ((0,), "N m per (rad)^2 per m/s")):
        table = draft_table([CandidateTerm(both, (1,))], ("tau1", "tau2"), sliding)
        assert table["parameters"]["c1"]["unit"] == unit
    assert draft_table([CandidateTerm(both, (0,))], ("my",), (0, 1))["parameters"]["c1"]["unit"] == "N m per (m)^2 per m/s"


def test_what_a_form_may_be():
    names = ("tau1", "tau2")
    own = ShapeFactor("{x}", "v2", "speed", 1)
    warm = single(ShapeFactor("exp(-{x} / {n})", "t", "time", number=20.0), ShapeFactor("{x}", "dir2", "direction"))
    assert "friction" in may_be(CandidateTerm(single(own), (1,)), names)[0]
    rubs = single(ShapeFactor("sin({n} * {x})", "q2", "ripple", number=2.0), ShapeFactor("{x}", "dir2", "direction"))
    assert may_be(CandidateTerm(rubs, (1,)), names)[0].startswith("friction that varies over a turn")
    assert "another joint" in may_be(CandidateTerm(single(own), (0,)), names)[0]
    assert "warms up" in may_be(CandidateTerm(warm, (1,)), names)[0]
    assert may_be(CandidateTerm(single(ShapeFactor("abs({x})", "fx", "load", 1)), (0,)), ("fx",))[0].startswith("a sensor")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('[model]\neffects = ["viscous_friction"]\n', "holds no effect; write its formulas into [model.expressions.NAME]"),
        ('[model.expressions.draft]\ntau9 = "c * q9"\nparameters.c = {}\n', "tau9: no such reading; write tau, tau1 ... tau2"),
    ],
)
def test_a_draft_that_cannot_be_is_one_line(found, tmp_path, capsys, text, message):
    bayesid.write_experiment(found.data.experiment, tmp_path / "arm")
    (tmp_path / "bad.toml").write_text(text)
    assert main(["identify", str(tmp_path / "arm"), "--effects-from", str(tmp_path / "bad.toml")]) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert message in line
