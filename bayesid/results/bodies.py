"""Which bodies of an estimate can exist."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayesid.robot import inertia

#: A frame without mass in the URDF, that no motion weighs, is no body: all its ten parameters are below this [SI].
_MASSLESS = 1e-9


def impossible_bodies(links: np.ndarray, names: Sequence[str]) -> tuple[str, ...]:
    """Names of the bodies that are not physically consistent.

    Parameters
    ----------
    links
        Inertial parameters (b, 10).
    names
        Of the bodies (b,).
    """
    massless = np.abs(links).max(axis=1) <= _MASSLESS
    exists = inertia.is_physically_consistent(links)
    return tuple(name for name, possible in zip(names, exists | massless, strict=True) if not possible)
