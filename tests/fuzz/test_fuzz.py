"""Thousands of damaged inputs: no traceback, no crash, no hang, one line each, nothing left behind."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, Phase, given, seed, settings

from tests.fuzz.arena import Worker, complaints, fresh, write_arm
from tests.fuzz.cases import Case, cases

FEW, MANY = 25, 10_000
#: The many in so many parts, each of which can be run alone: they take hours.
PARTS = 50


@pytest.fixture(scope="module")
def worker() -> Iterator[Worker]:
    process = Worker()
    yield process
    process.close()


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_arm(tmp_path_factory.mktemp("fuzz"))


def hold(case: Case, worker: Worker, original: Path) -> None:
    """Run a case in a folder of its own and look at all that must hold."""
    place = original.parent / "place"
    arm = fresh(original, place)
    case.damage(arm)
    options = [option.format(arm=arm) if "{arm}" in option else option for option in case.options]
    arguments = [case.verb, str(arm), *options, *([] if "--out" in options else ["--out", str(place / "out")])]
    before = set(place.rglob("*"))
    run = worker.run(arguments, place)
    assert not complaints(run, before, place), (case, run)


#: Without shrinking: a case tells what was done to the folder, and some take seconds.
_FIXED = settings(
    phases=[Phase.explicit, Phase.generate],
    suppress_health_check=list(HealthCheck),
    deadline=None,
    derandomize=True,
    database=None,
)


def test_the_arm_itself_is_good(worker: Worker, original: Path) -> None:
    place = original.parent / "place"
    arm = fresh(original, place)
    run = worker.run(["check", str(arm), "--out", str(place / "out")], place)
    assert (run.status, run.err) == (0, "")


@settings(_FIXED, max_examples=FEW)
@given(case=cases())
def test_a_fixed_share(case: Case, worker: Worker, original: Path) -> None:
    hold(case, worker, original)


@pytest.mark.slow
def test_links_a_million_times_too_light_are_diagnosed(worker: Worker, original: Path) -> None:
    """Amplitudes that nothing determines divided by their standard deviations of zero once."""
    place = original.parent / "light"
    arm = fresh(original, place)
    urdf = arm / "robot.urdf"
    light = re.sub(r'((?:value|i[xyz][xyz])=")([^"]*)', lambda m: f"{m[1]}{1e-6 * float(m[2])!r}", urdf.read_text("utf-8"))
    urdf.write_text(light, "utf-8")
    run = worker.run(["diagnose", str(arm), "--out", str(place / "out")], place)
    assert (run.status, run.err) == (0, "")


@pytest.mark.slow
@pytest.mark.parametrize("part", range(PARTS))
def test_ten_thousand(part: int, worker: Worker, original: Path) -> None:
    @seed(part)
    @settings(_FIXED, derandomize=False, max_examples=MANY // PARTS)
    @given(case=cases())
    def all_hold(case: Case) -> None:
        hold(case, worker, original)

    all_hold()
