"""Effects in a user's own file or package: what is taken, what is refused, and that it goes to other processes."""

import pickle
import subprocess
import sys
from importlib.metadata import EntryPoint

import pytest

import bayesid
from bayesid.cli import main
from bayesid.effects import EffectLibrary, InstrumentEffect, JointTorqueEffect, Parameter, library
from bayesid.effects.friction import ViscousFriction
from bayesid.errors import InputError
from bayesid.simulation.trajectories import new_trajectories
from bayesid.workflows.demo import puma_setup

GOOD = """
import numpy as np
from bayesid.effects import JointTorqueEffect, Parameter

class Cubic(JointTorqueEffect):
    name = "cubic_spring"
    quantities = (Parameter("k", "N m/rad^3", typical=2.0),)

    def torque(self, motion, values):
        return values[0] * motion.position**3
"""


def test_a_file_adds_to_one_library_only(tmp_path):
    (path := tmp_path / "mine.py").write_text(GOOD)
    own = bayesid.load_effects(path)
    assert set(own.classes) == {*EffectLibrary().classes, "cubic_spring"}
    copied = pickle.loads(pickle.dumps(own))
    assert copied == own and copied.classes["cubic_spring"] is own.classes["cubic_spring"]
    code = "import pickle, sys; print(*pickle.loads(sys.stdin.buffer.read()).classes)"  # another process reads the file itself
    other = subprocess.run([sys.executable, "-c", code], input=pickle.dumps(own), capture_output=True, check=True)
    assert other.stdout.decode().split() == [*own.classes]
    with pytest.raises(InputError, match="mine.py: an effect is called 'cubic_spring' already"):
        bayesid.load_effects(path, own)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (None, "no such file"),
        ("x = 1", "holds no effect"),
        ("import nothing_of_that_name", "ModuleNotFoundError"),
        ("def f(:", "SyntaxError"),
        (GOOD.replace("cubic_spring", "spring"), "called 'spring' already"),
        (GOOD.replace("cubic_spring", "cubic@spring"), "write a name of letters"),
        (GOOD.replace("typical=2.0", "start=2.0, upper=1.0"), "k starts at 2, outside -inf ... 1"),
        (GOOD.replace('Parameter("k", "N m/rad^3", typical=2.0),', ""), "at least one Parameter"),
        (GOOD.replace('"k"', '"fixed"'), "not 'fixed'"),
        (GOOD.replace("name =", 'at = "elbow"\n    name ='), "at = 'elbow'; write one of sensor"),
        (GOOD.replace("name =", 'channels = ("force",)\n    name ='), "channels = ('force',)"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(tmp_path, text, message):
    path = tmp_path / "mine.py"
    if text is not None:
        path.write_text(text)
    with pytest.raises(InputError) as refused:
        bayesid.load_effects(path)
    assert message in str(refused.value) and "\n" not in str(refused.value)


def test_an_effect_that_takes_the_load_has_to_say_so(tmp_path):
    (path := tmp_path / "mine.py").write_text(GOOD.replace("motion.position**3", "motion.load"))
    setup = bayesid.Experiment("puma", puma_setup(tmp_path).robot, (), library=bayesid.load_effects(path))
    motions = new_trajectories(setup.robot, 4.0, 50.0)
    with pytest.raises(InputError, match="uses_load = True"):
        bayesid.simulate(setup, motions, effects=["cubic_spring"])
    path.write_text(GOOD.replace("motion.position**3", "motion.load").replace("name =", "uses_load = True\n    name ="))
    setup = bayesid.Experiment("puma", setup.robot, (), library=bayesid.load_effects(path))
    assert bayesid.simulate(setup, motions, effects=["cubic_spring"]).truth.effects["cubic_spring@joint1"] == {"k": 2.0}


@pytest.mark.parametrize(
    ("law", "message"),
    [
        ("np.exp(values[0]) * motion.position", "torque is not linear in k; declare each"),
        ("values[0] * motion.position + 1.0", "torque is not linear in k"),
        ("(values[0] * motion.position)[1:]", r"torque has shape \(.*\) for .* samples"),
        ("values[0] / (0.0 * motion.position)", "torque has no finite value somewhere"),
        ("values[1] * motion.position", "torque ends in IndexError: tuple index out of range"),
    ],
)
@pytest.mark.filterwarnings("ignore:divide by zero", "ignore:invalid value")
def test_a_law_that_is_none_is_refused_by_name(tmp_path, law, message):
    """One that is not linear gave numbers that meant nothing; the others were laid to the data."""
    (path := tmp_path / "mine.py").write_text(GOOD.replace("values[0] * motion.position**3", law))
    setup = puma_setup(tmp_path)
    recorded = bayesid.simulate(setup, new_trajectories(setup.robot, 4.0, 50.0))
    own = bayesid.Experiment("puma", setup.robot, recorded.motions, setup.sensor, library=bayesid.load_effects(path))
    with pytest.raises(InputError, match=f"effect 'cubic_spring': {message}"):
        bayesid.identify(own, "torque", effects=["cubic_spring"])


def test_a_library_is_none_by_its_name(tmp_path):
    with pytest.raises(InputError, match=r"library: is a str; give bayesid.load_effects\(...\)"):
        bayesid.load_experiment(tmp_path, "mine.py")


def test_every_verb_takes_the_file(tmp_path, capsys):
    (path := tmp_path / "mine.py").write_text(GOOD)
    (tmp_path / "puma").mkdir()
    setup = puma_setup(tmp_path / "puma")
    bayesid.write_simulation(bayesid.simulate(setup, new_trajectories(setup.robot, 6.0, 50.0)), tmp_path / "arm")
    own = ["--effects-from", str(path)]
    made = tmp_path / "made"
    assert main(["simulate", str(tmp_path / "arm"), *own, "--effects", "cubic_spring@joint2", "--out", str(made)]) == 0
    assert "cubic_spring@joint2: k 2" in capsys.readouterr().out
    toml = made / "experiment.toml"
    toml.write_text(toml.read_text() + '\n[model]\neffects = ["cubic_spring"]\n')
    assert main(["check", str(made), "--out", str(tmp_path / "checked")]) == 2
    assert "no effect is called 'cubic_spring'" in capsys.readouterr().err
    for verb in ("check", "identify", "compare"):
        more = ["--channel", "torque"] if verb != "check" else []
        assert main([verb, str(made), *own, *more, "--out", str(tmp_path / verb)]) == 0
    for verb in ("sample", "diagnose"):
        assert main([verb, "--help"]) == 0
        assert "--effects-from" in capsys.readouterr().out


class Rubbing(ViscousFriction):
    """What an installed package might register."""

    name = "rubbing"


def test_a_package_registers_its_effect(monkeypatch):
    """Under the group of entry points; what is no effect is refused by the entry's name."""
    here = f"{__name__}:"
    entries = [EntryPoint("rubbing", here + "Rubbing", library.ENTRY_POINTS)]
    monkeypatch.setattr(library, "entry_points", lambda group: entries if group == library.ENTRY_POINTS else [])
    library._installed.cache_clear()
    try:
        assert EffectLibrary().classes["rubbing"] is Rubbing
        entries.append(EntryPoint("wrong", here + "GOOD", library.ENTRY_POINTS))
        library._installed.cache_clear()
        with pytest.raises(InputError, match="entry point bayesid.effects:wrong: .* is no effect"):
            _ = EffectLibrary().classes
    finally:
        library._installed.cache_clear()


@pytest.mark.parametrize(
    "said, missing",
    [
        ({"base": JointTorqueEffect}, "torque"),
        ({"base": JointTorqueEffect, "torque": lambda self, motion, values: motion.q, "harmonics": (1.0,)}, "from_harmonic"),
        ({"base": InstrumentEffect, "from_motion_alone": property(lambda self: True), "at": "base"}, "motion_columns"),
    ],
)
def test_a_class_without_a_method_that_it_needs_is_refused_by_name(said, missing):
    """At once and in one line, not when the method is first called."""
    base = said.pop("base")
    lacking = type("Lacking", (base,), {"name": "lacking", "quantities": (Parameter("c", "N m"),), **said})
    with pytest.raises(InputError, match=f"mine.py: effect 'lacking': has no method {missing}"):
        EffectLibrary().with_classes([lacking], "mine.py")
