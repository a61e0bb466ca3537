"""Scripts that are run by hand (benchmarks, studies, case studies, page writers) import what exists."""

import ast
import importlib.util
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SCRIPTS = sorted(p.relative_to(ROOT) for folder in ("docs", "case_studies", "tests") for p in (ROOT / folder).rglob("*.py"))


def imported(script: Path) -> list[tuple[str, str]]:
    """Modules of this repository and the names taken from them, wherever in the file."""
    found = []
    for node in ast.walk(ast.parse((ROOT / script).read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module and not node.level:
            found += [(node.module, alias.name) for alias in node.names]
        elif isinstance(node, ast.Import):
            found += [(alias.name, "") for alias in node.names]
    return [(module, name) for module, name in found if module.split(".")[0] in ("bayesid", "tests")]


@cache
def words(path: Path) -> set[str]:
    """What a module defines, assigns or imports."""
    nodes = ast.walk(ast.parse(path.read_text(encoding="utf-8")))
    return {getattr(node, "name", None) or getattr(node, "id", None) for node in nodes}


def exists(module: str, name: str) -> bool:
    """Whether a module of the package has the name, or a test module of that name stands in the repository."""
    if module.startswith("tests"):
        path = ROOT / module.replace(".", "/")
        if path.is_dir():
            return not name or any((path / name).with_suffix(s).exists() for s in ("", ".py"))
        return not name or name in words(path.with_suffix(".py"))
    if not name or hasattr(importlib.import_module(module), name):
        return True
    return importlib.util.find_spec(f"{module}.{name}") is not None


@pytest.mark.parametrize("script", SCRIPTS, ids=str)
def test_a_script_imports_what_exists(script):
    for module, name in imported(script):
        assert exists(module, name), f"{script}: from {module} import {name}"


@pytest.mark.parametrize("script", ["run", "identify", "posterior_speed", "diagnosis", "startup", "beside"])
def test_what_make_bench_runs_starts_from_anywhere(script, tmp_path):
    path = ROOT / "tests" / "benchmarks" / f"{script}.py"
    done = subprocess.run([sys.executable, str(path), "--help"], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0 and "usage" in done.stdout, done.stderr
