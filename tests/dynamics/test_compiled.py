"""Compiled loops: the same numbers from the process that compiles them as from their cache."""

import os
import subprocess
import sys

import pytest

_SCRIPT = """
import sys
from pathlib import Path

import numpy as np

from bayesid.dynamics.channels import torque_channels
from bayesid.dynamics.regressors import Kernel
from bayesid.signals import autoregression
from tests.simulated import fourier, puma2

robot = puma2(Path(sys.argv[1]))
regressor = Kernel.of(robot, torque_channels(robot)).dynamics(*fourier(robot, 1, duration=4.0)[1:])
print(regressor.tobytes().hex())
polynomials, variances = autoregression.fit([regressor[:, :, 3]], 6)
print(polynomials.tobytes().hex(), variances.tobytes().hex())
"""


@pytest.mark.slow
def test_the_first_run_after_installation_rounds_as_all_others(tmp_path):
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache"), "PYTHONPATH": os.pathsep.join(sys.path)}
    runs = [
        subprocess.run(
            [sys.executable, "-c", _SCRIPT, str(tmp_path)], env=environment, check=True, capture_output=True, text=True
        )
        for _ in range(2)
    ]
    assert runs[0].stdout == runs[1].stdout
