"""What is known of the links before the data: a nominal model and how far it is trusted."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayesid import inertia
from bayesid.errors import InputError


@dataclass(frozen=True, eq=False)
class Prior:
    """Link parameters ``phi ~ N(mean, precision^-1)``, restricted to bodies that can exist if ``physical``.

    Attributes
    ----------
    mean
        Nominal link parameters (P,).
    precision
        Inverse covariance (P, P); singular where nothing is known.
    bodies
        Which parameters are a body's ten, in `bayesid.inertia.PARAMETERS`' order.
    physical
        Whether every body's pseudo-inertia is known to be positive semidefinite.
    """

    mean: np.ndarray
    precision: np.ndarray
    bodies: tuple[tuple[int, ...], ...]
    physical: bool = True

    @classmethod
    def nominal(cls, links: np.ndarray, rel_std: float, *, physical: bool = True) -> Prior:
        """Bodies near nominal ones, by the constant pull-back metric [Lee2020]_.

        ``precision = 2 M / rel_std^2`` with M of `bayesid.inertia.pullback_metric`: with ``P0 = L L'`` the nominal
        pseudo-inertia, ``L^-1 (P - P0) L^-T`` is a symmetric matrix of independent normal numbers, with standard
        deviation ``rel_std`` on and ``rel_std / sqrt(2)`` off the diagonal. Mass and second moment about any
        plane then have that relative standard deviation, in any frame and unit.

        Parameters
        ----------
        links
            Nominal parameters, ten a body (b, 10) or (10 b,).
        rel_std
            Relative standard deviation, above 0.
        physical
            See the class.

        Raises
        ------
        InputError
            ``rel_std`` is not a positive number, or the links are not ten a body.
        """
        links = np.asarray(links, float)
        if links.size % 10:
            raise InputError(f"links have {links.size} numbers; give ten a body")
        if not (np.isfinite(rel_std) and rel_std > 0):
            raise InputError(f"rel_std = {rel_std}: give a positive number, such as 0.1")
        links = links.reshape(-1, 10)
        precision = np.zeros((links.size, links.size))
        for k, body in enumerate(links):
            part = slice(10 * k, 10 * k + 10)
            precision[part, part] = 2.0 / rel_std**2 * inertia.pullback_metric(body)
        bodies = tuple(tuple(range(10 * k, 10 * k + 10)) for k in range(len(links)))
        return cls(links.ravel(), precision, bodies, physical)

    @property
    def covariance(self) -> np.ndarray:
        """(P, P).

        Raises
        ------
        numpy.linalg.LinAlgError
            Nothing is known in some direction.
        """
        scale = np.sqrt(np.diag(self.precision))
        return np.linalg.inv(self.precision / np.outer(scale, scale)) / np.outer(scale, scale)
