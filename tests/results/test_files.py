"""Results appear whole or not at all, replace an earlier run's files, and never one of the user's own."""

from __future__ import annotations

import json
import os
import signal
from pathlib import Path

import pytest

import bayesid
from bayesid.errors import InputError
from bayesid.recordings import whole
from bayesid.recordings.whole import uninterrupted, whole_folder
from bayesid.results.files import check_output, write_results
from bayesid.results.fitted_model import fitted_model
from tests.simulated import experiment, puma2


def write(folder: Path, number: int) -> Path:
    document = {"schema": 1, "experiment": "arm", "number": number}
    text = f"[model] # {number}\n"
    files = {"model.toml": lambda p: p.write_text(text)}
    return write_results(folder, "diagnosis.json", document, files, f"<html>{number}</html>")


def contents(folder: Path) -> dict[str, str]:
    return {path.name: path.read_text() for path in folder.iterdir()}


def test_an_earlier_run_is_replaced_and_other_files_stay(tmp_path):
    write(tmp_path / "out", 1)
    (tmp_path / "out" / "notes.txt").write_text("mine")
    assert write(tmp_path / "out", 2).read_text() == "<html>2</html>"
    found = contents(tmp_path / "out")
    assert json.loads(found["diagnosis.json"])["number"] == 2 and found["notes.txt"] == "mine"
    assert sorted(found) == ["diagnosis.json", "model.toml", "notes.txt", "report.html"]
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_what_the_new_run_does_not_make_goes_unless_the_user_changed_it(tmp_path):
    """A draft of what an earlier run could not explain would pass for the new run's."""

    def run(*names: str) -> None:
        made = {name: lambda p, name=name: p.write_text(name) for name in names}
        write_results(tmp_path, "diagnosis.json", {"schema": 1, "experiment": "arm"}, made, "<html></html>")

    run("model.toml", "draft_effect.toml", "next_motion.csv")
    (tmp_path / "next_motion.csv").write_text("mine now")
    run("model.toml")
    assert sorted(contents(tmp_path)) == ["diagnosis.json", "model.toml", "next_motion.csv", "report.html"]
    run("model.toml", "draft_effect.toml")
    with pytest.warns(bayesid.BayesidWarning, match="^report.html of diagnosis.json in .* is replaced; give every verb a folder"):
        write_results(tmp_path, "estimate.json", {"schema": 1, "experiment": "arm"}, {}, "<html></html>")
    assert "draft_effect.toml" in contents(tmp_path)  # of another verb's run, which stays


@pytest.mark.parametrize("name", ["model.toml", "diagnosis.json", "report.html"])
def test_a_file_of_the_users_own_is_never_replaced(name, tmp_path):
    (tmp_path / name).write_text('{"schema": 1}')
    with pytest.raises(InputError, match="not as a run of bayesid wrote it"):
        write(tmp_path, 1)
    with pytest.raises(InputError, match="not as a run of bayesid wrote it"):
        check_output(tmp_path, "diagnose")
    assert contents(tmp_path) == {name: '{"schema": 1}'}


@pytest.mark.parametrize("name", ["identified.sdf", "sampled-001.xml", "sampled-012.urdf"])
def test_a_file_of_the_users_own_is_found_before_an_export_begins(name, tmp_path):
    (tmp_path / name).write_text("mine")
    with pytest.raises(InputError, match=f"{name} is there and is not as a run of bayesid wrote it"):
        check_output(tmp_path, "export")
    check_output(tmp_path / "new", "export")


def test_our_file_that_the_user_changed_is_the_users(tmp_path):
    write(tmp_path, 1)
    (tmp_path / "model.toml").write_text("[model] # better\n")
    with pytest.raises(InputError, match="model.toml"):
        write(tmp_path, 2)
    assert (tmp_path / "model.toml").read_text() == "[model] # better\n"


@pytest.mark.parametrize("existing", [False, True])
@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), KeyboardInterrupt()])
def test_a_failure_while_writing_leaves_all_as_it_was(existing, error, tmp_path):
    out = tmp_path / "new" / "out"
    if existing:
        write(out, 1)
    before = contents(out) if existing else None

    def fail(path: Path) -> None:
        path.write_text("half")
        raise error

    document = {"schema": 1, "experiment": "arm"}
    with pytest.raises((InputError, KeyboardInterrupt)):
        write_results(out, "diagnosis.json", document, {"model.toml": fail}, "<html>2</html>")
    if existing:
        assert contents(out) == before
    else:
        assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("at", range(6))
def test_a_failure_while_replacing_moves_all_back(at, tmp_path, monkeypatch):
    out = tmp_path / "out"
    write(out, 1)
    before, rename, calls = contents(out), Path.rename, []

    def failing(self: Path, target: Path) -> Path:
        calls.append(self)
        if len(calls) == at + 1:
            raise OSError(5, "Input/output error")
        return rename(self, target)

    monkeypatch.setattr(Path, "rename", failing)
    with pytest.raises(InputError, match="Input/output error"):
        write(out, 2)
    assert contents(out) == before


def test_a_signal_while_replacing_waits_for_the_last_file(tmp_path, monkeypatch):
    out = tmp_path / "out"
    write(out, 1)
    rename = Path.rename

    def interrupted(self: Path, target: Path) -> Path:
        signal.raise_signal(signal.SIGINT)
        return rename(self, target)

    monkeypatch.setattr(Path, "rename", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write(out, 2)
    found = contents(out)
    assert json.loads(found["diagnosis.json"])["number"] == 2 and found["report.html"] == "<html>2</html>"
    assert sorted(found) == ["diagnosis.json", "model.toml", "report.html"]


def test_signals_come_after_the_block():
    done = False
    with pytest.raises(KeyboardInterrupt):
        with uninterrupted():
            signal.raise_signal(signal.SIGINT)
            done = True
    assert done


@pytest.mark.skipif(os.name != "posix", reason="whether a process lives is asked for on POSIX only")
def test_what_a_killed_run_left_is_put_right(tmp_path, monkeypatch):
    out = tmp_path / "out"
    write(out, 1)
    before = contents(out)
    dead = os.fork()
    if dead == 0:
        os._exit(0)
    os.waitpid(dead, 0)
    mark = whole._mark().replace(str(os.getpid()), str(dead))
    for place in (tmp_path, out):
        (place / f"{mark}-abc" / "old").mkdir(parents=True)
    (out / f"{mark}-abc" / "old" / "report.html").write_text((out / "report.html").read_text())
    (out / "report.html").write_text("<html>of the killed run</html>")
    other = tmp_path / ".bayesid-00000000-1-abc"  # of another machine: not ours to judge
    other.mkdir()
    with whole_folder(out):
        pass
    assert contents(out) == before and other.exists()
    assert sorted(path.name for path in tmp_path.iterdir()) == [other.name, "out"]


def test_numbers_that_are_not_finite_are_refused(tmp_path):
    with pytest.raises(ValueError, match="JSON"):
        write_results(tmp_path / "out", "a.json", {"x": float("inf")}, {}, "")
    assert list(tmp_path.iterdir()) == []


def test_a_model_that_is_handed_on_lists_each_effect_once(tmp_path):
    """A whole kind stands for its joints, a joint has one name, and a formula that is not in the library stays."""
    arm = experiment(puma2(tmp_path), [])
    given = ["coulomb_friction@joint2", "viscous_friction", "viscous_friction@joint1", "viscous_friction@joint2"]
    given += ["coulomb_friction@joint2", "draft@joint1"]
    assert fitted_model(arm, given, ())[0] == ("coulomb_friction@joint2", "viscous_friction", "draft@joint1")
