"""docs/explanation/architecture.md and its picture are those of the code; the code keeps to what the page promises."""

import ast
import re
import runpy
from contextlib import suppress
from importlib import import_module
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "docs" / "explanation"
PAGE = (FOLDER / "architecture.md").read_text(encoding="utf-8")
RENEW = "run python docs/explanation/structure.py"
_CONTAINERS = r"default_factory=(list|dict|set|deque|defaultdict)\b"


@pytest.fixture(scope="module")
def script():
    return runpy.run_path(str(FOLDER / "structure.py"))


@pytest.fixture(scope="module")
def found(script):
    return script["read_structure"]()


def test_every_package_is_on_the_page_with_what_it_imports(script, found):
    assert script["tables"](found)["packages"] in PAGE, RENEW


def test_the_picture_shows_every_package_and_arrow(script, found):
    drawn = (FOLDER / "structure.svg").read_text(encoding="utf-8")
    assert script["in_words"](found).replace(">", "&gt;") in drawn, RENEW
    assert {name for name in found.packages if f">{name}</text>" in drawn} == set(found.packages), RENEW


def test_every_package_has_a_layer_and_no_import_goes_up(found):
    there = {p.stem for p in (ROOT / "bayesid").iterdir() if (p / "__init__.py").exists() or p.suffix == ".py"} - {"__init__"}
    assert set(found.packages) == there
    assert sum((ROOT / "bayesid" / name).is_dir() for name in there) <= 16
    level = {name: k for k, layer in enumerate(found.layers) for name in layer}
    assert [pair for pair in found.imports if level[pair[0]] <= level[pair[1]]] == []


def test_modules_import_each_other_in_no_circle(found):
    assert found.circles == ()


def test_modules_are_short(found):
    assert {path: lines for path, lines in found.lines.items() if lines > 600} == {}


def test_no_frozen_class_changes_a_container_of_its_own_making():
    """A list or dictionary that a frozen class makes for itself and fills later is hidden state, shared by its copies."""
    found = []
    for path in (ROOT / "bayesid").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ClassDef) and any("frozen=True" in ast.unparse(d) for d in node.decorator_list):
                own = [ast.unparse(n) for n in node.body if isinstance(n, ast.AnnAssign)]
                found += [f"{path.name}: {n}" for n in own if re.search(r"init=False|^_", n) and re.search(_CONTAINERS, n)]
    assert found == []


def test_a_circle_is_seen(script):
    edges = [("a", "b"), ("b", "c"), ("c", "a"), ("c", "d")]
    assert script["_circles"](["a", "b", "c", "d"], edges) == (("a", "b", "c"),)


def test_functions_that_a_recording_passes_exist():
    """Every dotted name in "How data flow" is a function, a method or a package of bayesid."""
    flow = PAGE.split("## How data flow")[1].split("\n## ")[0]
    names = set(re.findall(r"`([a-z_]+(?:\.\w+)+)`", flow))
    assert len(names) > 40
    for name in names:
        where, part = import_module("bayesid"), name.split(".")
        for k, word in enumerate(part):
            with suppress(ModuleNotFoundError):
                where = import_module("bayesid." + ".".join(part[: k + 1]))
                continue
            where = getattr(where, word)


@pytest.mark.parametrize("row", [line for line in PAGE.splitlines() if line.startswith("| a") and line.count("|") == 4])
def test_files_and_names_of_a_change_exist(row):
    """Paths of the table of changes exist, and what is to be registered stands in the file that follows its name."""
    _, _, where, registered, _ = row.split("|")
    quoted = re.findall(r"`([^`<]+)`", where + registered)
    assert all((ROOT / path).exists() for path in quoted if path.startswith("bayesid/"))
    for name, path in re.findall(r"`(\w+)` in `(bayesid/[^`]+)`", registered):
        defined = rf"^(def |class )?{name}\b( =|:|\()"
        assert re.search(defined, (ROOT / path).read_text(encoding="utf-8"), re.M), (name, path)


@pytest.mark.parametrize("place", re.findall(r"^\| [^|]+[.?] \| `([^`]+)` \|$", PAGE, re.M))
def test_places_found_by_name_exist(place):
    assert (ROOT / "bayesid" / place).exists()
