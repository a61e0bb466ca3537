"""What missing effects had done to the parameters."""

from __future__ import annotations

import numpy as np

from bayesid.diagnosis.search import Search
from bayesid.dynamics.base_parameters import structural_base


def base_shifts(search: Search) -> tuple[tuple[str, float, float, float], ...]:
    """Base parameters that the effects found had moved by more than three standard deviations, most first.

    Each as its label, its values before and after, and by how many standard deviations it had moved.
    """
    data = search.projector.data
    if data.prior is None:
        return ()
    base = structural_base(data.robot, data.channels, gravity=True, offset=data.channel != "torque", at_rest=False)
    inverse = np.linalg.inv(search.projector.r)[: search.projector.root.shape[1]]
    spread = base.matrix @ search.projector.root @ inverse
    std = np.sqrt(search.dispersion * np.sum(spread**2, axis=1))
    before, after = base.matrix @ search.base.links, base.matrix @ search.best.links
    sigmas = (before - after) / np.maximum(std, 1e-300)
    order = np.argsort(-np.abs(sigmas))
    return tuple((base.labels[k], float(before[k]), float(after[k]), float(sigmas[k])) for k in order if abs(sigmas[k]) > 3)
