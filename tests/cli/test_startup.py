"""What starting costs: modules that are imported, counted in a fresh interpreter."""

import subprocess
import sys

import pytest

from tests.simulated import Motion, Sensor, experiment, fourier, puma2, recording

HEAVY = {"arviz", "clarabel", "cvxpy", "emcee", "matplotlib", "numba", "numpy", "pandas", "pinocchio", "pydantic", "scipy"}


def imported(code: str) -> set[str]:
    """Modules in a fresh interpreter after some code."""
    script = f"{code}\nimport sys\nprint()\nprint(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    return set(done.stdout.splitlines()[-1].split())


@pytest.mark.parametrize(
    "code",
    [
        "import bayesid",
        "from bayesid.cli import main; main(['--help'])",
        "from bayesid.cli import main; main(['--version'])",
    ],
)
def test_nothing_heavy_is_imported_before_it_is_needed(code):
    loaded = imported(code)
    assert "bayesid" in loaded
    assert not HEAVY & loaded
    assert len(loaded) < 400


def test_check_imports_no_sampler_no_modelling_language_and_nothing_to_draw_with(tmp_path):
    import bayesid

    robot = puma2(tmp_path)
    motion = Motion("a", "identification", recording(robot, Sensor(), fourier(robot, 0, duration=5.0), seed=0))
    folder = tmp_path / "arm"
    bayesid.write_experiment(experiment(robot, [motion], Sensor()), folder)
    arguments = ["check", str(folder), "--out", str(tmp_path / "out")]
    loaded = imported(f"from bayesid.cli import main; assert main({arguments!r}) == 0")
    assert "bayesid.report.check" in loaded
    slow = {"arviz", "cvxpy", "emcee", "matplotlib", "pandas"}
    assert not slow & loaded
