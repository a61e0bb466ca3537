"""Every malformed experiment ends with exit status 2 and one line that says what is wrong, and writes nothing."""

from __future__ import annotations

from pathlib import Path

import pytest

from bayesid import load_experiment
from bayesid.cli import main
from tests.malformed import CASES, Malformed, write_good


def test_the_good_folder_is_good(tmp_path: Path) -> None:
    experiment = load_experiment(write_good(tmp_path / "arm"))
    assert experiment.warnings == ()


def test_there_are_forty_cases() -> None:
    assert len({case.name for case in CASES}) == len(CASES) >= 40


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name.replace(" ", "-"))
def test_malformed(case: Malformed, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    folder, out = write_good(tmp_path / "arm"), tmp_path / "out"
    case.damage(folder)
    arguments = case.arguments(folder)
    if "--out" not in arguments:
        arguments += ["--out", str(out)]
    before = sorted(path.relative_to(tmp_path) for path in tmp_path.rglob("*"))

    status = main(arguments)

    printed = capfd.readouterr()
    complaint = printed.err.splitlines()
    assert status == 2, printed
    assert [line for line in complaint if line.strip()] == complaint, complaint
    assert len(complaint) == 1, complaint
    assert "Traceback" not in printed.err + printed.out
    for text in case.says:
        assert text in complaint[0], complaint[0]
    assert sorted(path.relative_to(tmp_path) for path in tmp_path.rglob("*")) == before
