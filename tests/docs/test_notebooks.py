"""docs/notebooks run, cell by cell, and show what their text says."""

import re
import shutil
from pathlib import Path

import matplotlib
import pytest

import bayesid
from tests.docs.notebook import Notebook

FOLDER = Path(__file__).parents[2] / "docs" / "notebooks"
_CELL = re.compile(r"^```\{code-cell\} python\n(.*?)^```$", re.MULTILINE | re.DOTALL)


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    """The demo's folder, which every page begins with."""
    folder = tmp_path_factory.mktemp("made") / "demo"
    bayesid.demo(folder)
    return folder


@pytest.fixture
def run(demo, tmp_path, monkeypatch):
    """Run a page; its names."""

    def names(page: str) -> dict:
        monkeypatch.chdir(tmp_path)
        monkeypatch.setattr(bayesid, "demo", lambda out: shutil.copytree(demo, out))
        matplotlib.use("Agg")
        notebook = Notebook(tmp_path)
        for code in _CELL.findall((FOLDER / f"{page}.md").read_text(encoding="utf-8")):
            cell = notebook.run(code)
            if re.match(r"[\w.]+\.plot\w*\(", code.splitlines()[-1]):
                assert any("image/png" in output.get("data", {}) for output in cell["outputs"]), code
        assert notebook.images
        return notebook.scope

    return names


def test_recorded_data(run):
    (prediction,) = run("recorded-data")["result"].validation
    assert 0.9 < prediction.whitened_rms < 1.1


def test_comparing_estimators(run):
    rows = {row["estimator"]: float(row["error"].rstrip("%")) for row in run("comparing-estimators")["rows"]}
    assert min(rows["ols"], rows["wls"]) > 1.0 > 0.2 > max(rows["huber"], rows["student"])


def test_for_the_controller(run, tmp_path):
    assert run("for-the-controller")["bounds"].workspace.alpha < 0.1
    assert (tmp_path / "for-the-controller" / "bounds.mat").exists() and (tmp_path / "code" / "inverse_dynamics.hpp").exists()


@pytest.mark.slow  # tests/diagnosis finds hidden friction as well
def test_missing_effect(run):
    scope = run("missing-effect")
    hidden = {f"{name}@joint{k}" for name in ("stribeck_friction", "load_friction") for k in (1, 2)}
    assert {found.term.effect.spec for found in scope["diagnosis"].found} == hidden
    assert scope["before"].whitened_rms > 5.0 and scope["after"].whitened_rms < 1.1
    truth, complete, r = scope["truth"], scope["complete"], scope["r"]
    assert (abs(complete.values[:r] - truth) < abs(scope["plain"].values[:r] - truth)).mean() > 0.5


def test_before_and_after(run):
    scope = run("before-and-after")
    assert scope["change"].verdict == "named" and "payload@joint2" in str(scope["change"])
    assert [entry["verdict"] for entry in scope["week"].to_dict()["recordings"]] == ["named", "named", *["nothing_missing"] * 2]


def test_wrist_tool(run):
    weighed = run("wrist-tool")["weighed"]
    for quantity, truth in zip((weighed.mass, *weighed.centre), (0.85, 0.01, -0.005, 0.07), strict=True):
        assert abs(quantity.value - truth) < 4.0 * quantity.std < 0.01


def test_every_notebook_is_run():
    written = {page.stem for page in FOLDER.glob("*.md")} - {"index"}
    tests = Path(__file__).read_text(encoding="utf-8")
    assert {re.sub("_", "-", name) for name in re.findall(r"^def test_(\w+)\(run", tests, re.MULTILINE)} == written
    assert all(_CELL.search((FOLDER / f"{page}.md").read_text(encoding="utf-8")) for page in written)
