"""How the command line ends: one line for every failure, whatever fails and whenever it is interrupted."""

from __future__ import annotations

import gc
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

import bayesid
from bayesid.cli import main
from bayesid.errors import BayesidError, InputError
from bayesid.recordings import experiment
from bayesid.signals import numba_cache
from tests.malformed import write_good

ROOT = Path(__file__).parents[2]
COMMAND = [sys.executable, "-m", "bayesid"]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return write_good(tmp_path / "arm")


@pytest.mark.parametrize(
    ("error", "status", "says"),
    [
        (InputError("no such", file="a.csv", key="column t", remedy="write it"), 2, "a.csv: column t: no such; write it"),
        (BayesidError("did not work"), 1, "did not work"),
        (RuntimeError("first\nsecond"), 1, "failed on these data (RuntimeError: first second)"),
        (RecursionError(), 1, "failed on these data (RecursionError)"),
        (MemoryError("Unable to allocate 931 GiB"), 1, "out of memory (Unable to allocate 931 GiB); fit fewer motions"),
        (OSError(28, "No space left on device", "x.json"), 1, "x.json: No space left on device; make room"),
        (KeyboardInterrupt(), 1, "interrupted; files of a run are written all or none"),
        (KeyboardInterrupt("add --resume"), 1, "interrupted; add --resume"),
    ],
)
def test_every_failure_is_one_line(error, status, says, folder, monkeypatch, capsys):
    def fail(*_, **__):
        raise error

    monkeypatch.setattr(experiment, "load_experiment", fail)
    assert main(["check", str(folder), "--out", str(folder.parent / "out")]) == status
    told = capsys.readouterr().err.splitlines()
    assert len(told) == 1 and told[0].startswith("bayesid: ") and says in told[0]


def test_an_interruption_in_the_text_of_an_exec_is_no_death_by_signal(tmp_path):
    """Python remembers it as one that nobody caught, and ``python -m`` ended with 130 for 1."""
    stop = "import sys\nimport bayesid.cli as cli\nfrom bayesid.cli import verbs\n"
    stop += 'verbs.run = lambda _: exec("raise KeyboardInterrupt")\nsys.exit(cli.main())\n'
    (tmp_path / "__main__.py").write_text(stop)
    command = [sys.executable, "-m", tmp_path.name]
    done = subprocess.run(
        command, capture_output=True, text=True, cwd=tmp_path.parent, env={**os.environ, "PYTHONPATH": str(ROOT)}
    )
    assert done.returncode == 1 and "interrupted" in done.stderr


def test_the_package_runs_as_the_command():
    done = subprocess.run([*COMMAND, "--version"], capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 0 and bayesid.__version__ in done.stdout and not done.stderr


def test_an_import_that_fails_is_one_line(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "bayesid.cli.verbs", None)
    assert main(["--help"]) == 1
    told = capsys.readouterr().err.splitlines()
    assert len(told) == 1 and "cannot start" in told[0]


@pytest.mark.parametrize("way", ["option", "variable"])
def test_the_traceback_is_shown_where_asked_for(way, tmp_path, monkeypatch, capsys):
    if way == "variable":
        monkeypatch.setenv("BAYESID_TRACEBACK", "1")
    assert main([*(["--traceback"] if way == "option" else []), "check", str(tmp_path / "nowhere")]) == 2
    told = capsys.readouterr().err
    assert "Traceback" in told and told.splitlines()[-1].startswith("bayesid: ")


def test_handlers_of_signals_are_put_back():
    before = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]
    assert main(["--version"]) == 0
    assert [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)] == before


@pytest.mark.parametrize("collecting", [True, False])
def test_the_search_for_cyclic_garbage_is_as_before(collecting, folder):
    """`check` turns it off for its own second."""
    (gc.enable if collecting else gc.disable)()
    try:
        assert main(["check", str(folder), "--out", str(folder.parent / "out")]) == 0
        assert gc.isenabled() == collecting
    finally:
        gc.enable()


def test_a_process_that_ends_does_not_search_for_cyclic_garbage():
    script = "import gc, sys; from bayesid.cli import main; sys.argv[1:] = ['--version']; main(); print(gc.get_freeze_count())"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert int(done.stdout.split()[-1]) > 10_000


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("verb", ["verbs", "check"])
def test_a_signal_during_imports_is_one_line(number, verb, folder):
    """The process is stopped at a known place: while it imports the verbs, or the verb."""
    trap = (
        "import importlib.abc, os, sys, time\n"
        "class Trap(importlib.abc.MetaPathFinder):\n"
        "    def find_spec(self, name, path, target=None):\n"
        f"        if name == 'bayesid.cli.{verb}':\n"
        "            print('here', flush=True); time.sleep(30)\n"
        "sys.meta_path.insert(0, Trap())\n"
        "from bayesid.cli import main\n"
        "sys.exit(main())\n"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", trap, "check", str(folder)], cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert process.stdout is not None and process.stdout.readline() == "here\n"
    process.send_signal(number)
    _, told = process.communicate(timeout=60)
    assert process.returncode == 1 and len(told.splitlines()) == 1 and "interrupted" in told


@pytest.mark.skipif(os.name != "posix", reason="pipes of POSIX")
def test_a_reader_that_has_enough_is_no_failure(folder, tmp_path):
    process = subprocess.Popen(
        [*COMMAND, "check", str(folder), "--out", str(tmp_path / "out")], cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    assert process.stdout is not None and process.stderr is not None
    process.stdout.close()
    with process.stderr:
        told = process.stderr.read()
    assert process.wait(60) == 0 and told == b""
    assert (tmp_path / "out" / "check.json").exists()


def test_numba_gets_a_folder_of_our_own_where_nothing_else_can_be_written(monkeypatch, tmp_path):
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    numba_cache.find_place()
    assert "NUMBA_CACHE_DIR" not in os.environ  # the checkout can be written
    monkeypatch.setattr(numba_cache.os, "access", lambda *_: False)
    monkeypatch.setenv("NUMBA_CACHE_DIR", "")
    numba_cache.find_place()
    place = Path(os.environ["NUMBA_CACHE_DIR"])
    assert place.parent == tmp_path and place.stat().st_mode & 0o077 == 0
    place.chmod(0o777)  # others could have put code there
    monkeypatch.setenv("NUMBA_CACHE_DIR", "")
    numba_cache.find_place()
    assert Path(os.environ["NUMBA_CACHE_DIR"]) != place


def test_refusals_come_before_the_work(folder, monkeypatch, capsys):
    monkeypatch.setattr(experiment, "load_experiment", lambda *_: pytest.fail("the work had begun"))
    (folder / "model.toml").write_text("[model]\n")
    since = time.perf_counter()
    for out in (folder / "robot.urdf" / "x", folder / ("x" * 300), folder):
        assert main(["diagnose", str(folder), "--out", str(out)]) == 2
        assert len(capsys.readouterr().err.splitlines()) == 1
    assert time.perf_counter() - since < 30 and (folder / "model.toml").read_text() == "[model]\n"


@pytest.mark.parametrize("verb", ["bounds", "excite"])
def test_a_default_folder_that_cannot_be_written_is_refused_before_the_work(verb, folder, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(bayesid, verb, lambda *_, **__: pytest.fail("the work had begun"))
    name = bayesid.load_experiment(folder).name
    (tmp_path / "bayesid-out").mkdir()
    (tmp_path / "bayesid-out" / f"{name}-{verb}").write_text("")
    assert main([verb, str(folder)]) == 2
    assert "is a file; name a folder" in capsys.readouterr().err
