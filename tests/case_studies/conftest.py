"""The module ``run`` of a case study, imported as its script imports its neighbours."""

from __future__ import annotations

import importlib
import sys

import pytest


@pytest.fixture(scope="module")
def study(request: pytest.FixtureRequest):
    """``run`` of the folder ``STUDY`` of a test module; ``MODULES`` are those that it has brought along, forgotten afterwards."""
    folder, modules = request.module.STUDY, request.module.MODULES
    before = list(sys.path)
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(folder))
        for name in modules:
            sys.modules.pop(name, None)
        yield importlib.import_module("run")
        for name in modules:
            sys.modules.pop(name, None)
    sys.path[:] = before
