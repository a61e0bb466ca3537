"""Public logs as they are: nothing wrong is said of any, nothing that matters is passed over, and the remedy silences it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from bayesid.validation.mistakes.search import find_mistakes
from tests.studies.wild import ANSWERS, RIGHT, SILENT, judged

#: Recordings whose kind of mistake, finding or robot another one has as well, or `tests/validation/test_mistakes.py`, simulated.
SLOW = {
    "02-kinova-gen3-unwrapped/raw", "03-med7-real/exp", "04-tiago-motor-current/asrecorded", "04-tiago-motor-current/converted",
    "08-urdf-oddities/axis-not-unit", "08-urdf-oddities/continuous-with-limits", "08-urdf-oddities/gripper-2f85-as-is",
    "08-urdf-oddities/gripper-2f85-mimic", "08-urdf-oddities/negative-ixx", "08-urdf-oddities/rpy-tilted-world",
    "08-urdf-oddities/tool-behind-fixed", "09-log-oddities/duplicate-stamps", "09-log-oddities/gravity-subtracted",
    "09-log-oddities/nan-run-q3", "09-log-oddities/tau-late-70ms", "12-schunk-lwa4p-short/exp",
    "12-schunk-lwa4p-short/tau6-flipped",
}  # fmt: skip


@pytest.mark.parametrize("name", [pytest.param(name, marks=pytest.mark.slow if name in SLOW else ()) for name in ANSWERS])
def test_what_is_said_is_right(name: str, shared: Callable[[str], Path]) -> None:
    shared(f"wild/{name}")
    answer = ANSWERS[name]
    said, experiment = judged(name, answer)
    assert said["verdict"] in (RIGHT, SILENT), said
    if answer.remedy is not None:
        assert experiment is not None
        left = {(m.name, m.where) for m in find_mistakes(answer.remedy(experiment))}
        assert left <= {("gravity_removed", "tau1")}  # a lift's weight does not come back
