"""A class's name says which one it is, wherever it is met."""

import re
from collections import Counter
from pathlib import Path

import bayesid

_CLASS = re.compile(r"^ *class (\w+)[(:]", re.MULTILINE)


def test_no_two_modules_define_a_class_of_the_same_name():
    files = sorted(Path(bayesid.__file__).parent.rglob("*.py"))
    texts = [file.read_text(encoding="utf-8") for file in files]
    counts = Counter(name for text in texts for name in _CLASS.findall(text))
    assert len(counts) > 300
    assert not {name for name, count in counts.items() if count > 1}
