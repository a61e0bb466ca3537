"""What the README and the documentation show works, and what they point at exists."""

from __future__ import annotations

import re
import runpy
import shlex
import tomllib
from dataclasses import fields
from pathlib import Path

import matplotlib
import numpy as np
import pandas as pd
import pytest

from bayesid import fourier_trajectory, load_bounds, write_experiment, write_trajectory
from bayesid.cli import main
from bayesid.effects import EffectLibrary
from bayesid.recordings import schema
from bayesid.results.export.simulators import mjcf
from bayesid.robot.urdf import JointDynamics
from bayesid.validation.prediction import TOLERATED
from bayesid.workflows.demo import PAPER_LOCKED
from tests.docs.notebook import Notebook
from tests.recordings.importing.logs import START, Bag
from tests.simulated import Motion, Sensor, experiment, fourier, puma2, recording

#: The README's command lines are of all verbs: their reports are drawn.
LOOKS_AT_FIGURES = True
ROOT = Path(__file__).parents[2]
README = ROOT / "README.md"
DOCS = ROOT / "docs"
PAGES = [README, *sorted(DOCS.rglob("*.md"))]
CASE_STUDIES = sorted(ROOT.glob("case_studies/*/README.md"))
BY_NAME = {page.relative_to(ROOT).as_posix(): page for page in PAGES}
_CODE = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
_LINK = re.compile(r"\[[^\]]*\]\(([^)]+)\)")
_CITED = re.compile(r"\[([A-Z]\w+\d{4}\w?)\]")


def snippets(page: Path, language: str) -> list[str]:
    """Code of one language on a page."""
    return [code for kind, code in _CODE.findall(page.read_text(encoding="utf-8")) if kind == language]


def pages_with(language: str) -> list[str]:
    """Names of the pages that have such code."""
    return [name for name, page in BY_NAME.items() if snippets(page, language)]


def tried(language: str) -> list:
    """The same, as parameters of a test."""
    return [pytest.param(name, marks=pytest.mark.slow if LONG.get(name) == language else ()) for name in pages_with(language)]


#: Pages that say the same in Python and as command lines, and the longer of the two.
LONG = {"docs/howto/accuracy.md": "python", "docs/howto/diagnose.md": "console", "docs/howto/large.md": "console"}


@pytest.fixture(scope="module")
def my_arm(tmp_path_factory) -> Path:
    """A folder that holds ``my-arm``, a small experiment with all that the pages use."""
    folder = tmp_path_factory.mktemp("readme")
    (folder / "model").mkdir()
    robot = puma2(folder / "model")
    sensor = Sensor(translation=[0.0, 0.0, -0.1])
    noise = dict(force_std=0.5, torque_std=0.05, resolution=1e-4)

    def motion(name: str, role, seed: int) -> Motion:
        path = fourier(robot, seed, duration=8.0)
        still = recording(robot, sensor, path, seed=seed + 10, static=True, **noise)
        return Motion(name, role, recording(robot, sensor, path, seed=seed, **noise), static=still)

    for code in (code for name in pages_with("python") for code in snippets(BY_NAME[name], "python")):
        if file := re.match(r"# (\w+\.py)\n", code):  # a file of the reader's
            (folder / file[1]).write_text(code, encoding="utf-8")
    motions = [motion("identification", "identification", 1), motion("validation", "validation", 2)]
    write_experiment(experiment(robot, motions, sensor, position_resolution=1e-4), folder / "my-arm")
    write_trajectory(fourier_trajectory(robot, duration=4.0, fundamental=0.25), folder / "move.csv")
    _write_logs(folder, motions)
    inside = JointDynamics({name: {"damping": 4.0, "friction": 5.0} for name in robot.joint_names})
    (folder / "my-arm.xml").write_text(mjcf(robot, PAPER_LOCKED, robot.nominal.ravel(), inside), encoding="utf-8")
    macros = robot.description.text.replace("<robot ", '<robot xmlns:xacro="http://www.ros.org/wiki/xacro" ', 1)
    macros = macros.replace(">", '><xacro:property name="turned" value="$(arg elbow)"/>', 1)
    (folder / "my-arm.urdf.xacro").write_text(macros, encoding="utf-8")
    return folder


def _write_logs(folder: Path, motions: list[Motion]) -> None:
    """The recordings as other tools would have written them: two bags, a table with other names and units, numbers alone."""
    names = ["joint1", "joint2"]
    for k, motion in enumerate(motions):
        table = motion.table
        assert table.wrench is not None and table.torques is not None
        with Bag(folder / f"run{k + 1}", "mcap") as bag:
            for row, ns in enumerate(START + np.round(table.times * 1e9).astype(int)):
                bag.joints(ns, names, table.positions[row], tau=table.torques[row], log=ns + 1_500_000)
                bag.wrench(ns, table.wrench[row], log=ns + 1_500_000)
    frame = motions[0].table.to_dataframe()
    columns = {"Zeit": 1e3 * frame["t"]} | {f"joint{k} ist": np.rad2deg(frame[f"q{k}"]) for k in (1, 2)}
    columns |= {"Strom 1": frame["tau1"] / 11.5, "Strom 2": frame["tau2"] / 9.25}
    pd.DataFrame(columns).to_csv(folder / "log.csv", index=False)
    np.savetxt(folder / "log.txt", frame[[f"{quantity}{k}" for quantity in ("q", "q", "tau") for k in (1, 2)]])
    still = motions[0].static
    assert still is not None and still.wrench is not None
    np.savetxt(folder / "poses.txt", np.hstack([np.rad2deg(still.positions), still.wrench])[::50])


@pytest.mark.parametrize("name", tried("python"))
def test_python_blocks_run_as_cells_of_a_notebook(name, my_arm, tmp_path, monkeypatch):
    """Each page's blocks run one after the other, and whatever they draw is in the notebook."""
    monkeypatch.chdir(my_arm)
    matplotlib.use("Agg")
    notebook = Notebook(tmp_path)
    for code in snippets(BY_NAME[name], "python"):
        notebook.run(code)
    notebook.write(tmp_path / "page.ipynb")
    assert any(cell["outputs"] for cell in notebook.cells)
    assert all(image.startswith(b"\x89PNG") for image in notebook.images)
    last_lines = {k: cell["source"].splitlines()[-1] for k, cell in enumerate(notebook.cells)}
    drawn = [notebook.cells[k] for k, line in last_lines.items() if re.match(r"[\w.]+\.plot\w*\(", line)]
    assert all(any("image/png" in output.get("data", {}) for output in cell["outputs"]) for cell in drawn)
    if name == "docs/howto/notebook.md":
        assert len(notebook.images) == len(drawn) >= 5
        assert "<Figure" not in "".join(output.get("text", "") for cell in notebook.cells for output in cell["outputs"])
    if name == "docs/howto/own-effect.md":
        _own_effect_was_found(notebook.scope, my_arm / "found")


@pytest.mark.parametrize("name", [name for name in BY_NAME if not name.startswith("docs/notebooks")])
def test_every_block_of_a_page_is_tried(name):
    """Python and command lines run (above and below), tables of settings are read, text is output that a test looks at, and a
    test of what the page is about compiles C++."""
    text = BY_NAME[name].read_text(encoding="utf-8")
    kinds, fences = [kind for kind, _ in _CODE.findall(text)], text.count("\n```") // 2
    assert len(kinds) == fences and set(kinds) <= {"python", "console", "toml", "text", "matlab", "cpp"}
    for code in snippets(BY_NAME[name], "toml"):
        assert tomllib.loads(code)


def _own_effect_was_found(scope: dict, written: Path) -> None:
    """The effect of the page is named with the values that were hidden, in the report and in model.toml."""
    diagnosis, (entry,) = scope["diagnosis"], scope["result"].to_dict()["effects"]
    (found,) = diagnosis.found
    assert diagnosis.verdict == "named" and found.term.effect.spec == "oval_shaft@joint2"
    np.testing.assert_allclose(found.term.values, [3.0, -2.0], atol=0.1)
    assert diagnosis.gap.before > 3.0 and diagnosis.gap.after < 1.2
    assert "friction that varies twice over a turn of the joint" in (written / "report.html").read_text(encoding="utf-8")
    model = tomllib.loads((written / "model.toml").read_text(encoding="utf-8"))["model"]
    assert model["effects"] == ["oval_shaft@joint2"] and set(model["values"]["oval_shaft@joint2"]) == {"a", "b"}
    for key, truth in (("a", 3.0), ("b", -2.0)):
        value, std = entry["parameters"][key]["value"], entry["parameters"][key]["std"]
        assert abs(value - truth) < 4.0 * std < 0.4
    assert "oval_shaft" not in EffectLibrary().classes  # the experiment's library knows it, nothing else


@pytest.fixture(scope="module")
def lines_run() -> set[str]:
    """Command lines that another page has run already, beside the same recording."""
    return set()


@pytest.mark.parametrize("name", tried("console"))
def test_command_lines_run(name, my_arm, lines_run, monkeypatch, capsys, request):
    """Each page's calls of bayesid end well; those of the README, which are of all verbs, with their figures."""
    monkeypatch.chdir(my_arm)
    if name != README.name:
        request.getfixturevalue("undrawn")
    lines = [line for code in snippets(BY_NAME[name], "console") for line in code.splitlines()]
    for line in lines:
        words = shlex.split(line.removeprefix("$ "))
        if line in lines_run:
            continue
        lines_run.add(line)
        if words[0] == "bayesid":
            assert main(words[1:]) == 0, f"{line}: {capsys.readouterr().err}"
        else:
            assert words[0] == "make" and f"\n{words[1]}:" in (ROOT / "Makefile").read_text(encoding="utf-8")


def test_readme_shows_what_the_demo_prints(tmp_path, monkeypatch, capsys, undrawn):
    """The output in the README is the demo's; last digits may differ from machine to machine."""
    monkeypatch.chdir(tmp_path)
    assert main(["demo"]) == 0
    printed = capsys.readouterr().out
    shown = snippets(README, "text")[0]

    def digits(text: str) -> list[float]:
        return [float(x) for x in re.findall(r"-?\d+\.\d+", text)]

    def words(text: str) -> list[str]:
        return re.sub(r"-?\d+(\.\d+)?", "#", text).split()

    assert words(printed) == words(shown)
    assert digits(printed) == pytest.approx(digits(shown), rel=1e-2, abs=2e-3)


@pytest.mark.parametrize("page", [*PAGES, *CASE_STUDIES], ids=lambda page: page.relative_to(ROOT).as_posix())
def test_links_point_at_files(page):
    """Relative links of the pages exist."""
    for target in _LINK.findall(page.read_text(encoding="utf-8")):
        path, _, anchor = target.partition("#")
        if "://" in path:
            continue
        file = (page.parent / path) if path else page
        assert file.exists(), f"{page.name}: {target}"
        if anchor:
            titles = re.findall(r"^#+ (.+)$", file.read_text(encoding="utf-8"), re.MULTILINE)
            known = {re.sub(r"[^\w -]", "", title.lower()).replace(" ", "-") for title in titles}  # as GitHub makes them
            assert anchor in known, f"{page.name}: {target}"


@pytest.mark.parametrize("folder", ["howto", "notebooks", "explanation", "reference", "studies"])
def test_every_page_is_in_the_index_of_its_folder(folder):
    """The site's order of pages follows from these links; a page without one would stop ``make docs``."""
    index = DOCS / folder / "index.md"
    linked = {(index.parent / target).resolve() for target in _LINK.findall(index.read_text(encoding="utf-8"))}
    assert set(index.parent.rglob("*.md")) - {index} <= linked


def test_every_cited_source_is_listed():
    """Keys that docstrings and pages cite stand in docs/reference/references.md."""
    text = (DOCS / "reference" / "references.md").read_text(encoding="utf-8")
    listed = set(re.findall(r"^\*\*\[(\w+)\]\*\*", text, re.MULTILINE))
    sources = [*(ROOT / "bayesid").rglob("*.py"), *(ROOT / "tests").rglob("*.py"), *PAGES]
    cited = {key for source in sources for key in _CITED.findall(source.read_text(encoding="utf-8"))}
    assert cited - {"Key"} <= listed
    assert {"Liu1998", "Gautier1990"} <= cited


def test_experiment_page_is_complete():
    """Every key that is read stands on the page."""
    text = (DOCS / "reference" / "experiment.md").read_text(encoding="utf-8")
    sections = (schema.ExperimentFile, schema.RobotSection, schema.SensorSection, schema.MotionSection, schema.ModelSection)
    keys = {key for section in sections for key in section.model_fields}
    assert not {key for key in keys if not re.search(rf"\b{key}\b", text)}


def test_bounds_page_is_complete_and_its_file_is_read(tmp_path):
    """Every key of bounds.toml stands on the page, and the file shown is taken as it is."""
    page = BY_NAME["docs/reference/bounds.md"]
    (shown,) = snippets(page, "toml")
    (tmp_path / "bounds.toml").write_text(shown, encoding="utf-8")
    known = load_bounds(tmp_path / "bounds.toml")
    for key in (f.name for f in fields(known)):
        assert getattr(known, key) and f"| `{key}` |" in page.read_text(encoding="utf-8")
    assert known.linear(("joint1", "joint2", "joint3"), tuple(tuple(range(k, k + 10)) for k in (0, 10, 20)), 30)


def test_method_page_names_modules_that_exist():
    """Modules in the headings, below bayesid/, and those of the diagnosis below its package."""
    text = (DOCS / "explanation" / "method.md").read_text(encoding="utf-8")
    headings = re.findall(r"`([^`]+)`", " ".join(re.findall(r"^#+ .*\((`.*`)\)$", text, re.MULTILINE)))
    bold = re.findall(r"`(\w+\.py)`", " ".join(re.findall(r"^\*\*[^*]+\*\* \(([^)]+)\)", text, re.MULTILINE)))
    assert len(headings) >= 12 and len(bold) >= 10
    for path in [*headings, *(f"diagnosis/{name}" for name in bold)]:
        assert (ROOT / "bayesid" / path).exists(), path


def test_changelog_sends_nobody_to_a_module_that_is_not_there():
    """Modules in the last column of the table of moves exist; ``.name`` continues the package before it."""
    text = (DOCS / "reference" / "changelog.md").read_text(encoding="utf-8")
    rows = [line.split("|")[2] for line in text.splitlines() if line.startswith("| `bayesid.")]
    assert len(rows) > 15
    for row in rows:
        package = ""
        for name in re.findall(r"`(bayesid[\w.]*|\.\w+)`", row):
            module = package + name if name.startswith(".") else name
            package = module.rpartition(".")[0]
            path = ROOT / module.replace(".", "/")
            assert path.is_dir() or path.with_suffix(".py").exists(), module


def test_method_page_states_the_limit_of_the_code():
    """A validation motion is warned about above the residual that the page says."""
    text = (DOCS / "explanation" / "method.md").read_text(encoding="utf-8")
    assert f"Above {TOLERATED} times that there is a warning" in " ".join(text.split())


def test_effects_page_is_made_from_the_classes():
    """effects.md is what effects_table.py makes of the classes, every effect included."""
    made = runpy.run_path(str(DOCS / "reference" / "effects_table.py"))["page"]()
    assert (DOCS / "reference" / "effects.md").read_text(encoding="utf-8") == made
    assert not {name for name in EffectLibrary().classes if f"| `{name}` |" not in made}


WHAT_GOES_WRONG = runpy.run_path(str(DOCS / "howto" / "what_goes_wrong.py"))
#: Sections of what-goes-wrong.md that take long to make; what they show, tests of `check` and `diagnose` show as well.
LONG_SECTIONS = ("Signs, orders, units and frames", "The model lacks something")


@pytest.fixture(scope="module")
def without_mistake(tmp_path_factory):
    """The recording that the mistakes of the page are made on."""
    return WHAT_GOES_WRONG["recorded"](tmp_path_factory.mktemp("right"))


@pytest.mark.parametrize(
    "title", [pytest.param(t, marks=pytest.mark.slow if t in LONG_SECTIONS else ()) for t in WHAT_GOES_WRONG["ROWS"]]
)
def test_mistakes_of_the_page_look_as_it_says(title, without_mistake, tmp_path, undrawn):
    """docs/howto/what-goes-wrong.md is what docs/howto/what_goes_wrong.py makes, but for digits: every mistake is made here."""

    def words(text: str) -> list[str]:
        return re.sub(r"[-−]?\d[\d.e+]*", "#", text).split()

    made = WHAT_GOES_WRONG["section"](title, without_mistake, tmp_path)
    page = BY_NAME["docs/howto/what-goes-wrong.md"].read_text(encoding="utf-8")
    (shown,) = re.findall(rf"^## {title}\n.*?(?=^## |\Z)", page, re.MULTILINE | re.DOTALL)
    assert words(made) == words(shown), "run python docs/howto/what_goes_wrong.py"


def test_the_page_of_mistakes_has_them_all():
    """Titles, symptoms, causes and remedies stand on it in the order of docs/howto/what_goes_wrong.py, below its introduction."""
    page = BY_NAME["docs/howto/what-goes-wrong.md"].read_text(encoding="utf-8")
    assert page.startswith(WHAT_GOES_WRONG["_HEAD"])
    assert re.findall(r"^## (.*)$", page, re.MULTILINE) == list(WHAT_GOES_WRONG["ROWS"])
    rows = [row for section in WHAT_GOES_WRONG["ROWS"].values() for row in section]
    begun = [f"**{row.symptom}.** {row.cause}. `bayesid {row.command.split()[0]}`:" for row in rows]
    assert re.findall(r"^\*\*.*$", page, re.MULTILINE) == begun
    assert re.findall(r"^Remedy: (.*)\.$", page, re.MULTILINE) == [row.remedy for row in rows]


def test_constraints_are_pins_without_addresses():
    """constraints.txt pins exact versions and names no place to get them from."""
    lines = [line for line in (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines() if not line.startswith("#")]
    assert lines
    for line in lines:
        assert re.fullmatch(r"[A-Za-z0-9_.-]+==[A-Za-z0-9.]+( ; .+)?", line), line
