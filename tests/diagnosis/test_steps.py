"""Steps of exact fits, against equations solved one by one."""

import numpy as np
import pytest

from bayesid.diagnosis.fit import _changes


@pytest.mark.parametrize("damping", [0.0, 0.5])
def test_changes_at_limits_are_found_without_what_would_pass_them(damping):
    rng = np.random.default_rng(3)
    for _ in range(20):
        root, pull, alive = rng.normal(size=(12, 7)), rng.normal(size=7), rng.random(7) < 0.8
        lower, upper = rng.random((2, 7)) < 0.4
        changed = _changes(root.T @ root, pull, alive, (lower, upper))
        changed(1.0)  # what another damping took is not in the way
        got = changed(damping)
        free = got != 0.0
        expected = np.linalg.solve((root.T @ root)[np.ix_(free, free)] + damping * np.eye(free.sum()), pull[free])
        np.testing.assert_allclose(got[free], expected, rtol=1e-9)
        assert not (free & ~alive).any() and not (lower & (got < 0.0)).any() and not (upper & (got > 0.0)).any()
        assert (lower | upper)[alive & ~free].all()
