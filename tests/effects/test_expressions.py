"""Formulas of the user's own: against NumPy, differences, simulations with known values, and what may not stand in one."""

import re
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import bayesid
from bayesid.effects import EffectLibrary, Term, columns, readings, rigid_columns
from bayesid.effects.formula import Formula
from bayesid.errors import InputError
from bayesid.workflows.demo import puma_setup
from tests.effects.arms import LIBRARY, both, moving

PAGE = Path(__file__).parents[2] / "docs" / "howto" / "own-effect.md"
COGGING = {"tau": "c * sin(3 * q)", "parameters": {"c": {"unit": "N m", "typical": 0.5}}}


def made(tables, joints=7):
    return LIBRARY.with_expressions(tables, joints, "model.toml")


def one(library, spec, robot, *values):
    (effect,) = library.parse([spec], robot.joint_names, both(robot).names)
    return Term(effect, values)


def test_a_formula_is_what_numpy_makes_of_it():
    x, y = np.linspace(-2, 2, 50), np.linspace(0.1, 3, 50)
    text = "-x**2 / (1 + y) + atan2(x, y) * max(x, 0.5) - 2e-1 * sqrt(abs(x)) * exp(-y) + pi"
    want = -(x**2) / (1 + y) + np.arctan2(x, y) * np.maximum(x, 0.5) - 0.2 * np.sqrt(np.abs(x)) * np.exp(-y) + np.pi
    formula = Formula.parse(text)
    assert formula.names == {"x", "y"}
    np.testing.assert_allclose(formula({"x": x, "y": y}), want, rtol=1e-14)
    assert np.isnan(Formula.parse("log(x)")({"x": -1.0}))


@pytest.mark.parametrize(
    "text",
    [
        "__import__('os').system('true')", "c.real", "q[0]", "(lambda: 1)()", "[x for x in (1,)]", "f'{x}'", "x if y else z",
        "x := 1", "x < 1", "True * x", "1j * x", "sin(*x)", "sin(x, y)", "open(x)", "x; y", "", "x +", "-" * 500 + "x",
        "(" * 300 + "x" + ")" * 300, "1" * 5000, "9" * 400, "x @ y", "x // 2", "~x", "sin(x=1)", "x\n+ import y", "\x00",
    ],
)  # fmt: skip
def test_nothing_else_may_stand_in_a_formula(text):
    with pytest.raises(InputError):
        Formula.parse(text)


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({"tau2": "c * q2"}, "'c' is not known; if it is a parameter, add parameters.c"),
        ({"tau2": "c * q", "parameters": {"c": {}}}, "of which joint is q"),
        ({"tau9": "c * q1", "parameters": {"c": {}}}, "no such reading; write tau, tau1 ... tau7"),
        ({"tau2": "c * q8", "parameters": {"c": {}}}, "the robot has 7 joints"),
        ({"tau2": "c * fx", "parameters": {"c": {}}}, "fx is not known there"),
        ({"fx": "c * tau2", "parameters": {"c": {}}}, "tau2 is not known there"),
        ({"tau2": "c * sinus(q2)", "parameters": {"c": {}}}, "'sinus' is no function"),
        ({"tau2": "c * q2", "parameters": {"c": {}, "d": {}}}, "d stands in no formula"),
        ({"tau2": "q2 * q2"}, "has no parameters"),
        ({"parameters": {"c": {}}}, "has no formula"),
        ({"tau": "c * q", "tau2": "c * q2", "parameters": {"c": {}}}, "tau stands for every joint"),
        ({"tau2": "q1 * q2", "parameters": {"q1": {}}}, "'q1' means something else"),
        ({"tau2": "sin(c * q2)", "parameters": {"c": {}}}, "not linear in it; give a start"),
        ({"tau2": "c * q2", "parameters": {"c": {"lower": 1.0}}}, "between lower and upper"),
        ({"tau2": "c * vel2", "parameters": {"c": {}}}, "'vel2' is not known"),
    ],
)
def test_what_cannot_be_is_said(table, message):
    with pytest.raises(InputError, match=re.escape(message)):
        made({"mine": table})


def test_parameters_that_a_formula_is_linear_in_are_recognised():
    parameters = {"a": {}, "b": {"start": 1.0}, "k": {"start": 2.0, "tried": [1.0, 2.0]}}
    library = made({"mine": {"tau2": "a * sin(k * q2) + a * b * v2", "parameters": parameters}})
    kind = library.classes["mine"]
    assert kind.shape == ("b", "k") and kind.starts == (0.0, 1.0, 2.0)
    grid = [about.at.tolist() for about in kind("joint2", 1).linearisations(None)]
    assert grid == [[1.0, 1.0, 1.0], [1.0, 1.0, 2.0]]


def test_the_formula_is_added_to_the_reading_and_its_columns_are_derivatives(panda):
    segment, channels = moving(panda), both(panda)
    tables = {
        "mine": {"tau2": "a * tau2**2 * cos(k * q1) + b * t", "parameters": {"a": {}, "k": {"start": 1.5}, "b": {}}},
        "cubic": {"mz": "c * mz**3 / 100", "parameters": {"c": {}}},
        "rough": {"tau": "l * dir * sin(q) + m * a", "parameters": {"l": {}, "m": {}}},
    }
    library = made(tables)
    terms = [
        one(library, "mine", panda, 0.02, 1.5, 0.3),
        one(library, "cubic", panda, 0.1),
        one(library, "rough@joint4", panda, 2.0, 0.1),
    ]
    assert [t.effect.spec for t in terms] == ["mine@joint2", "cubic@sensor", "rough@joint4"]
    true = readings(panda, channels, segment, panda.nominal)
    got = readings(panda, channels, segment, panda.nominal, terms) - true
    q, v, a = segment.positions, segment.velocities, segment.accelerations
    want = np.zeros_like(true)
    want[:, 5] = 0.1 * true[:, 5] ** 3 / 100
    want[:, 7] = 0.02 * true[:, 7] ** 2 * np.cos(1.5 * q[:, 0]) + 0.3 * segment.times
    want[:, 9] = 2.0 * np.clip(v[:, 3] / 1e-3, -1, 1) * np.sin(q[:, 3]) + 0.1 * a[:, 3]
    np.testing.assert_allclose(got, want, atol=1e-10)
    for t in terms:
        others = [x for x in terms if x is not t]
        found = columns(panda, channels, segment, panda.nominal, terms, t.effect)
        for k in range(len(t.values)):
            step = 1e-4 * np.eye(len(t.values))[k]
            ends = [
                readings(panda, channels, segment, panda.nominal, [*others, Term(t.effect, t.values + s * step)]) for s in (1, -1)
            ]
            np.testing.assert_allclose(found[:, :, k], (ends[0] - ends[1]) / 2e-4, atol=1e-5 * max(np.abs(found).max(), 1.0))
        if t.effect.from_motion_alone:
            np.testing.assert_allclose(t.effect.motion_columns(segment, channels.names), found, atol=1e-8)
    assert [t.effect.from_motion_alone for t in terms] == [False, False, True]
    # A change of the links goes through the formulas that have true readings in them.
    change = 1e-4 * np.random.default_rng(0).normal(size=panda.nominal.shape) * np.abs(panda.nominal)
    ends = [readings(panda, channels, segment, panda.nominal + s * change, terms) for s in (1, -1)]
    slope = rigid_columns(panda, channels, segment, panda.nominal, terms) @ change.ravel()
    np.testing.assert_allclose(slope, 0.5 * (ends[0] - ends[1]), atol=1e-6 * np.abs(slope).max())


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A simulated experiment whose model.toml has a formula, with cogging in both joints."""
    place = tmp_path_factory.mktemp("cogging")
    robot = puma_setup(place).robot
    library = EffectLibrary().with_expressions({"cogging": COGGING}, robot.n, "experiment.toml")
    setup = bayesid.Experiment("puma", robot, (), effects=("cogging",), library=library)
    motion = bayesid.fourier_trajectory(robot, duration=12.0, rate=100.0, seed=1)
    recording = bayesid.simulate(setup, [motion], effects={"cogging": {"c": 0.7}}, seed=2)
    bayesid.write_simulation(recording, place / "arm")
    return place / "arm"


def test_it_is_written_read_and_identified(folder):
    """The folder that a simulation writes has the formula, and its value is estimated within its interval."""
    section = tomllib.loads((folder / "experiment.toml").read_text(encoding="utf-8"))["model"]
    assert section["expressions"]["cogging"] == COGGING and section["effects"] == ["cogging"]
    result = bayesid.identify(folder, "torque")
    for entry in result.to_dict()["effects"]:
        c = entry["parameters"]["c"]
        assert entry["name"] == "cogging" and c["unit"] == "N m"
        assert abs(c["value"] - 0.7) < 4.0 * c["std"] < 0.3
    draws = bayesid.sample(folder, channel="torque", prior="flat", draws=400, chains=2)
    assert "cogging@joint1.c" in str(draws)


def test_a_model_file_brings_its_formulas(folder, tmp_path):
    """The page's example is read; a formula of the same name is replaced, a name of the library's refused."""
    (text,) = re.findall(r"```toml\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    text = text.replace("tau2", "tau1").replace("q2", "q1")
    (tmp_path / "model.toml").write_text(text, encoding="utf-8")
    experiment = bayesid.load_experiment(folder)
    other = experiment.with_model(tmp_path / "model.toml")
    assert other.library.classes["cogging"].parameters == ("c", "d")
    assert experiment.library.classes["cogging"].parameters == ("c",) and "cogging" not in EffectLibrary().classes
    (tmp_path / "model.toml").write_text(text.replace("cogging", "spring"), encoding="utf-8")
    with pytest.raises(InputError, match="an effect is called 'spring' already"):
        replace(experiment).with_model(tmp_path / "model.toml")


@pytest.mark.parametrize("start", [0.0, 1.0])
def test_a_formula_without_a_value_is_told(folder, start):
    """A root of a negative number: in one line, whether the formula starts at zero or not."""
    table = {"tau1": "c * sqrt(q1 - 10) + d * v1", "parameters": {"c": {"start": start}, "d": {}}}
    experiment = bayesid.load_experiment(folder)
    experiment = replace(experiment, library=experiment.library.with_expressions({"mine": table}, 2, "mine"), effects=("mine",))
    held = replace(experiment, effect_values={"mine": {"c": start, "fixed": True}})
    for verb in (bayesid.identify, bayesid.diagnose):
        with pytest.raises(InputError, match="not finite where mine@joint1 start"):
            verb(held, "torque")
    with pytest.raises(InputError, match="no finite value somewhere|not finite where"):
        bayesid.identify(experiment, "torque")
    with pytest.raises(InputError, match="not finite with mine@joint1"):
        bayesid.simulate(experiment, effects=["mine"])


def test_hysteresis_is_dahls_bristle():
    """Against the differential equation step by step, and what a static run has of it."""
    t = np.linspace(0.0, 10.0, 4000)
    x = np.sin(3.0 * t) + 0.5 * np.sin(7.3 * t)
    x[1000:1200] = x[1000]  # it rests for a while
    state, want = 0.0, [0.0]
    for step in np.diff(x):
        keep = np.exp(-abs(step) / 0.2)
        state = keep * state + (1.0 - keep) * np.sign(step)
        want.append(state)
    formula = Formula.parse("2 * hysteresis(x, 0.2)")
    np.testing.assert_allclose(formula({"x": x}), 2.0 * np.array(want), atol=1e-12)
    assert formula.remembers
    assert formula({"x": np.ones(1)}) == 0.0


def test_what_belongs_to_a_course_in_time_is_zero_at_poses_of_a_static_run():
    x = np.linspace(-1.0, 1.0, 5)
    formula = Formula.parse("c * x**3 - (x - hysteresis(x, 0.1)) + x * t - -x")
    np.testing.assert_allclose(formula({"c": 2.0, "x": x, "t": x}, course=False), 2.0 * x**3 - x + x)
    np.testing.assert_allclose(Formula.parse("exp(-t / 5)")({"t": x}, course=False), 0.0)
