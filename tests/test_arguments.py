"""Public functions show what they take, take a string for one name, and speak the language of who calls them."""

import ast
import inspect
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import bayesid
from bayesid import cli
from bayesid.argument_types import explains_types
from bayesid.arguments import argument, call, names, on_command_line, with_given
from bayesid.design.excitation.options import ExcitationOptions
from tests.simulated import Motion, Sensor, experiment, fourier, puma2, recording

PUBLIC = [name for name in bayesid.__all__ if inspect.isfunction(getattr(bayesid, name))]
SENSOR = Sensor(translation=np.array([0.0, 0.0, -0.1]))
VERBS = ["accuracy", "bounds", "calibrate", "check", "compare", "diagnose", "excite", "export", "identifiability", "identify",
         "payload", "sample", "tell", "watch"]  # fmt: skip


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    """A two-joint robot whose torques hold friction that no model states, recorded in two motions."""
    robot = puma2(tmp_path_factory.mktemp("puma"))
    motions = []
    for k, name in enumerate(("identification", "validation")):
        table = recording(robot, SENSOR, fourier(robot, k + 1), seed=k, force_std=0.5, torque_std=0.1, resolution=2e-5)
        velocity = np.gradient(table.positions, table.times, axis=0)
        motions.append(Motion(name, name, replace(table, torques=table.torques + 5.0 * np.tanh(velocity / 0.05))))
    return experiment(robot, motions, SENSOR)


@pytest.mark.parametrize("name", PUBLIC)
def test_a_public_function_shows_what_it_takes(name):
    function = getattr(bayesid, name)
    parameters = inspect.signature(function).parameters
    assert [p for p in parameters.values() if p.kind is p.VAR_KEYWORD] == []
    assert [n for n, p in parameters.items() if len(repr(p.default)) > 80] == []
    if name in VERBS:
        assert [n for n in parameters if n not in function.__doc__] == []


def test_every_part_of_a_motion_that_is_asked_for_is_a_keyword():
    assert set(inspect.signature(ExcitationOptions).parameters) < set(inspect.signature(bayesid.excite).parameters)


def test_an_argument_is_named_as_it_is_written():
    said = [argument("prior_std", 0.3), argument("methods"), argument("motions", ["a", "b"]), argument("channel", "torque"),
            argument("collisions", False), argument("certificate", 7), argument("longest", 64), call("diagnose")]  # fmt: skip
    assert said == ["prior_std=0.3", "methods", 'motions=["a", "b"]', 'channel="torque"', "collisions=False", "certificate=7",
                    "sampler=Sampler(longest=64)", "bayesid.diagnose"]  # fmt: skip
    with on_command_line():
        said = [argument("prior_std", 0.3), argument("methods"), argument("motions", ["a", "b"]), argument("channel", "torque"),
                argument("collisions", False), argument("certificate", 7), argument("longest", 64), call("diagnose")]  # fmt: skip
    assert said == ["--prior-std 0.3", "--methods", "--motions a,b", "--channel torque", "--no-collisions", "--twins 7",
                    "--longest 64", "bayesid diagnose"]  # fmt: skip
    assert argument("runs", 2) == "runs=2"


def test_a_message_speaks_the_language_of_who_calls(arm, tmp_path, capsys):
    folder = str(tmp_path / "arm")
    bayesid.write_experiment(arm, folder)
    with pytest.raises(bayesid.InputError, match="^runs=2: give at least 5"):
        bayesid.accuracy(folder, runs=2)
    assert cli.main(["accuracy", folder, "--runs", "2", "--out", str(tmp_path / "out")]) == 2
    assert "--runs 2: give at least 5" in capsys.readouterr().err
    with pytest.raises(bayesid.InputError, match='^channel="torques": choose one of'):
        bayesid.identify(folder, channel="torques")
    result = bayesid.identify(folder, "torque")  # without its friction: something is missing
    assert "`bayesid.diagnose`" in " ".join(result.warnings) and "`bayesid diagnose`" not in " ".join(result.warnings)
    assert cli.main(["identify", folder, "--channel", "torque", "--out", str(tmp_path / "out")]) == 0
    assert "`bayesid diagnose`" in capsys.readouterr().out


def test_options_go_in_one_by_one_or_as_one_object(arm):
    options = bayesid.FitOptions(channel="torque", effects="viscous_friction", motions="identification")
    assert (options.effects, options.motions) == (("viscous_friction",), ("identification",))
    one = bayesid.identify(arm, options=options)
    each = bayesid.identify(arm, channel="torque", effects="viscous_friction", motions="identification")
    assert one.estimate.effect_names == ("viscous_friction@joint1.coefficient", "viscous_friction@joint2.coefficient")
    np.testing.assert_array_equal(one.estimate.solution, each.estimate.solution)
    beside = bayesid.identify(arm, options=options, effects=())  # what is given beside it stands in its place
    assert beside.estimate.effect_names == () and beside.problem.channel == "torque"
    assert [e.name for e in bayesid.compare(arm, "ols", options=options).entries] == ["ols"]
    with pytest.raises(bayesid.InputError, match="diagnose takes no bandwidth; of FitOptions it has channel, motions, effects"):
        bayesid.diagnose(arm, options=replace(options, bandwidth=5.0))
    with pytest.raises(bayesid.InputError, match='static="both": choose one of motion, joint'):
        bayesid.FitOptions(static="both")


def test_names_and_options():
    assert names(None) is None and names("wls") == ("wls",) and names(["a", "b"]) == ("a", "b") and names(()) == ()
    options = ExcitationOptions(joints="joint1", duration=10.0)
    assert options.joints == ("joint1",)
    assert with_given(options, duration=None, rate=50.0) == replace(options, rate=50.0)
    with pytest.raises(bayesid.InputError, match="ground=0 is not kept clear with collisions=False; leave one of them out"):
        ExcitationOptions(ground=0.0, collisions=False)


class Nameless:
    def fit(self, regression):
        return bayesid.fit(regression, "wls")


class Returns:
    name = "mine"

    def __init__(self, change):
        self.change = change

    def fit(self, regression):
        return self.change(bayesid.fit(regression, "wls"))


@pytest.mark.parametrize(
    ("method", "said"),
    [
        (Nameless(), "method Nameless is no estimator: it lacks a name"),
        (object(), "lacks a name: .* and fit\\(regression\\)"),
        (bayesid.Ridge, "method Ridge is a class: pass one of it, Ridge\\(...\\)"),
        (Returns(lambda e: e.solution), "method 'mine': fit returned a ndarray, not a bayesid.Estimate"),
        (Returns(lambda e: None), "fit returned a NoneType"),
        (Returns(lambda e: replace(e, solution=e.solution[:3])), "gave a solution of shape \\(3,\\); it needs 4 finite numbers"),
        (Returns(lambda e: replace(e, solution=np.nan * e.solution)), "gave a solution that is not finite"),
    ],
)
def test_an_estimator_of_ones_own_is_told_what_it_lacks(method, said):
    rng = np.random.default_rng(1)
    regression = bayesid.Regression.from_arrays(rng.normal(size=(50, 2, 4)), rng.normal(size=(50, 2)))
    with pytest.raises(bayesid.BayesidError, match=said):
        bayesid.fit(regression, method)


#: Option names written out where a message, whoever reads it, is about the command line: a draft's own comment and use.
ABOUT_THE_COMMAND_LINE = {"described.py", "arguments.py"}


def test_no_message_of_the_library_names_options_or_commands():
    """`argument` and `call` write them for whoever calls; the command line's own modules may."""
    package, found = Path(bayesid.__file__).parent, []
    for path in package.rglob("*.py"):
        if path.relative_to(package).parts[0] == "cli" or path.name in ABOUT_THE_COMMAND_LINE:
            continue
        source, named = path.read_text(encoding="utf-8"), r"--[a-z]{2}|`bayesid [a-z]"
        if not re.search(named, source):
            continue
        tree = ast.parse(source)
        documented = (ast.Module, ast.ClassDef, ast.FunctionDef)
        docstrings = {ast.get_docstring(n, clean=False) for n in ast.walk(tree) if isinstance(n, documented)}
        texts = [n.value for n in ast.walk(tree) if isinstance(n, ast.Constant) and isinstance(n.value, str)]
        found += [(path.name, t) for t in texts if t not in docstrings and re.search(named, t)]
    assert found == []


OF_A_WRONG_TYPE = {
    "a number as a text": (lambda arm: bayesid.identify(arm, bandwidth="8"), "identify: bandwidth = '8': give a number"),
    "numbers for names": (lambda arm: bayesid.identify(arm, effects=[1, 2]), r"effects = \[1, 2\]: give a text or a list"),
    "a field of options": (
        lambda arm: bayesid.identify(arm, options=bayesid.FitOptions(bandwidth="8")), "FitOptions bandwidth = '8': give a number"
    ),
    "a field of an estimator": (
        lambda arm: bayesid.identify(arm, method=bayesid.Huber(constant="x")), "Huber constant = 'x': give a number"
    ),
    "an array for a text": (
        lambda arm: bayesid.identify(arm, channel=np.zeros((3, 2))), r"channel = an array of shape \(3, 2\): give a text"
    ),
    "an array for a number": (lambda arm: bayesid.LowPass(np.ones(2), 50.0), r"LowPass: l = an array of shape \(2,\): give a n"),
    "a text for an array": (lambda arm: bayesid.Sensor(translation="x"), "Sensor: translation = 'x': give an array of numbers"),
    "nothing for a path": (lambda arm: bayesid.load(None), "load: path = None: give a text or a path"),
    "a number for a robot": (lambda arm: bayesid.fourier_trajectory(3), "robot = 3: give a bayesid.Robot"),
    "a text for a regression": (lambda arm: bayesid.Regression.from_arrays("a", "b"), "matrix = 'a': give an array of numbers"),
    "numbers for pairs": (lambda arm: bayesid.Bounds(box={"a": 1}), "give a dict that holds a list of 2 lists of numbers"),
    "a channel that is none": (lambda arm: bayesid.tell(arm, ["payload@joint2", "base_tilt"], channel="x"), "choose one of w"),
    "seeds": (lambda arm: bayesid.sample(arm, seed=np.arange(2)), "give a whole number of at least 0"),
}  # fmt: skip


@pytest.mark.parametrize("given", OF_A_WRONG_TYPE)
def test_an_argument_of_a_wrong_type_is_named_in_a_line(given, arm):
    """These ended in errors of Python deep inside, of which no one could tell what was wrong."""
    call_it, said = OF_A_WRONG_TYPE[given]
    with pytest.raises(bayesid.InputError, match=said) as raised:
        call_it(arm)
    assert "\n" not in str(raised.value)


def test_errors_that_no_argument_explains_stay_what_they_are():
    @explains_types
    def broken(count: int, names: Sequence[str] = (), points: Sequence[Sequence[float]] | np.ndarray = ()) -> float:
        return {}[count]

    for given in ((3,), (np.int64(3), ["a"]), (3, ("a",), np.zeros((2, 2))), (3, ["a"], [[1, 2.0]])):
        with pytest.raises(KeyError):
            broken(*given)
    with pytest.raises(TypeError, match="missing 1 required"):
        broken()
