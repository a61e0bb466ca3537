"""Public logs as they are: nothing wrong is said of any, nothing that matters is passed over, and the remedy silences it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from bayesid.validation.mistakes.search import find_mistakes
from tests.studies.wild import ANSWERS, RIGHT, SILENT, judged


@pytest.mark.parametrize("name", ANSWERS)
def test_what_is_said_is_right(name: str, shared: Callable[[str], Path]) -> None:
    shared(f"wild/{name}")
    answer = ANSWERS[name]
    said, experiment = judged(name, answer)
    assert said["verdict"] in (RIGHT, SILENT), said
    if answer.remedy is not None:
        assert experiment is not None
        left = {(m.name, m.where) for m in find_mistakes(answer.remedy(experiment))}
        assert left <= {("gravity_removed", "tau1")}  # a lift's weight does not come back
