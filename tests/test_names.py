"""A class's name says which one it is, wherever it is met."""

import ast
from collections import Counter
from pathlib import Path

import bayesid


def test_no_two_modules_define_a_class_of_the_same_name():
    files = sorted(Path(bayesid.__file__).parent.rglob("*.py"))
    trees = [ast.parse(file.read_text(encoding="utf-8")) for file in files]
    counts = Counter(node.name for tree in trees for node in ast.walk(tree) if isinstance(node, ast.ClassDef))
    assert len(counts) > 300
    assert not {name for name, count in counts.items() if count > 1}
