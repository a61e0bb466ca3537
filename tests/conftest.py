"""Recordings that are not part of the repository are found through BAYESID_DATA."""

import gc
import os
import signal
from pathlib import Path

import pytest
from hypothesis import settings

from tests.report_pages import undraw

# The same examples on every run, and no time limit: machines are noisy.
settings.register_profile("bayesid", derandomize=True, deadline=None)
settings.load_profile("bayesid")


# A shell ignores Ctrl-C for what it runs in the background, and children inherit that; here it is tested.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


#: Modules that take longest, by their processor time. `make test` gives modules to two processes one by one; begun first, these
#: leave none of them alone with a long one at the end.
LONGEST = (
    "test_readme.py", "test_diagnosis.py", "test_mistakes.py", "test_kept.py", "test_notebooks.py", "test_changes.py",
    "test_tasks.py", "test_posterior.py", "test_in_part.py", "test_physical.py", "test_robust.py", "test_outputs.py",
    "test_regression.py", "test_real_recordings.py", "test_report.py", "test_own_fit.py", "test_wild.py", "test_export.py",
    "test_diagnosis_input.py", "test_long_segment.py", "test_fuzz.py", "test_numbers.py", "test_payload.py",
    "test_posterior_sampling.py", "test_estimators.py", "test_errors_in_variables.py", "test_mounts.py", "test_figures.py",
    "test_accuracy.py", "test_flexible.py", "test_experiment.py", "test_excitation.py", "test_tell.py", "test_coverage.py",
    "test_nonlinear.py", "test_residual_floor.py", "test_certificate.py", "test_encoder_noise.py", "test_newcomers.py",
    "test_identify.py",
)  # fmt: skip


def pytest_collection_modifyitems(items):
    """The longest modules first, the others and all tests of a module in their order."""
    place = {name: k for k, name in enumerate(LONGEST)}
    items.sort(key=lambda item: place.get(item.path.name, len(place)))


def pytest_collection_finish():
    """What collecting has made stays to the end: garbage collections need not look at it each time."""
    gc.freeze()


@pytest.fixture(scope="session")
def shared():
    """Path of a file or folder below BAYESID_DATA; skips where it is absent."""
    root = Path(os.environ.get("BAYESID_DATA", Path(__file__).resolve().parents[2] / "shared"))

    def find(name: str) -> Path:
        path = root / name
        if not path.exists():
            pytest.skip(f"{name} not found; set BAYESID_DATA to the folder that holds it")
        return path

    return find


@pytest.fixture(scope="module", autouse=True)
def undrawn_unless_looked_at(request):
    """Figures of reports are not drawn in a module that does not say ``LOOKS_AT_FIGURES = True``."""
    with pytest.MonkeyPatch.context() as patch:
        if not getattr(request.module, "LOOKS_AT_FIGURES", False):
            undraw(patch)
        yield


@pytest.fixture
def undrawn(monkeypatch):
    """For a test, in a module that looks at figures."""
    undraw(monkeypatch)
