"""One body's ten inertial parameters, their equivalent forms, and physical consistency.

Order everywhere (Pinocchio's): ``m, mcx, mcy, mcz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz`` with the first moment
``mc`` [kg m] and the inertia [kg m^2] about the frame's origin, not the centre of mass.
"""

from __future__ import annotations

import numpy as np

PARAMETERS = ("m", "mcx", "mcy", "mcz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
UNITS = ("kg", "kg m", "kg m", "kg m") + ("kg m^2",) * 6

#: Where the ten parameters sit in the 3x3 inertia: I[row, column] = phi[4 + position].
ROW = np.array([0, 0, 1, 0, 1, 2])
COLUMN = np.array([0, 1, 1, 2, 2, 2])
#: Places of URDF's entries in it.
ENTRIES = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}


def inertia_matrix(parameters: np.ndarray) -> np.ndarray:
    """Inertia about the frame origin, (..., 3, 3) [kg m^2], of parameters (..., 10)."""
    parameters = np.asarray(parameters, float)
    matrix = np.zeros(parameters.shape[:-1] + (3, 3))
    matrix[..., ROW, COLUMN] = parameters[..., 4:]
    matrix[..., COLUMN, ROW] = parameters[..., 4:]
    return matrix


def from_mass_com_inertia(mass: float, com: np.ndarray, inertia_at_com: np.ndarray) -> np.ndarray:
    """Ten parameters of a body from its mass [kg], centre of mass (3,) [m] and inertia about it, in the frame's axes [kg m^2]."""
    com = np.asarray(com, float)
    # Parallel axes: I_o = I_c + m (c'c 1 - c c').
    inertia = np.asarray(inertia_at_com, float) + mass * (com @ com * np.eye(3) - np.outer(com, com))
    return np.concatenate([[mass], mass * com, inertia[ROW, COLUMN]])


def to_mass_com_inertia(parameters: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Mass [kg], centre of mass (3,) [m] and inertia about it (3, 3); the inverse of the above.

    A body of zero mass has its centre of mass put at the frame origin.
    """
    mass = float(parameters[0])
    com = np.asarray(parameters[1:4], float) / mass if mass else np.zeros(3)
    return mass, com, inertia_matrix(parameters) - mass * (com @ com * np.eye(3) - np.outer(com, com))


def pseudo_inertia(parameters: np.ndarray) -> np.ndarray:
    """Pseudo-inertia (..., 4, 4), the second moment of the mass in homogeneous coordinates [Wensing2018]_.

    ``P = [[tr(I)/2 1 - I, mc], [mc', m]]``; a body of positive density exists exactly when P is positive
    semidefinite.
    """
    parameters = np.asarray(parameters, float)
    inertia = inertia_matrix(parameters)
    pseudo = np.zeros(parameters.shape[:-1] + (4, 4))
    half_trace = 0.5 * np.trace(inertia, axis1=-2, axis2=-1)
    pseudo[..., :3, :3] = half_trace[..., None, None] * np.eye(3) - inertia
    pseudo[..., :3, 3] = pseudo[..., 3, :3] = parameters[..., 1:4]
    pseudo[..., 3, 3] = parameters[..., 0]
    return pseudo


def from_pseudo_inertia(pseudo: np.ndarray) -> np.ndarray:
    """Ten parameters (10,) of a pseudo-inertia (4, 4); the inverse of the above."""
    second = pseudo[:3, :3]
    inertia = np.trace(second) * np.eye(3) - second
    return np.concatenate([[pseudo[3, 3]], pseudo[:3, 3], inertia[ROW, COLUMN]])


#: The pseudo-inertia is linear in the parameters: P = sum_k phi_k BASIS[k]; (10, 4, 4).
BASIS = pseudo_inertia(np.eye(10))


def is_physically_consistent(parameters: np.ndarray, tolerance: float = 1e-9) -> np.ndarray:
    """Whether bodies (..., 10) can exist: their pseudo-inertia is positive semidefinite.

    ``tolerance`` is the smallest eigenvalue allowed, relative to the largest; it lets a point mass pass.
    """
    eigenvalues = np.linalg.eigvalsh(pseudo_inertia(parameters))
    return eigenvalues[..., 0] >= -tolerance * np.maximum(np.abs(eigenvalues[..., -1]), 1e-30)


def transform(parameters: np.ndarray, rotation: np.ndarray, translation: np.ndarray) -> np.ndarray:
    """Express a body given in frame B in frame A, where B sits in A at ``rotation``, ``translation``.

    Works on the pseudo-inertia, ``P_A = T P_B T'`` with the homogeneous T = [[R, p], [0, 1]].
    """
    homogeneous = np.eye(4)
    homogeneous[:3, :3], homogeneous[:3, 3] = rotation, translation
    return from_pseudo_inertia(homogeneous @ pseudo_inertia(parameters) @ homogeneous.T)


def solid(parameters: np.ndarray) -> np.ndarray:
    """Pseudo-inertia (4, 4) of a body near this one that has mass and extent in every direction.

    A body flatter than about 3 % of its length is thickened to that, one smaller than a sphere of 1 cm to that,
    and one without mass becomes such a sphere of 1 g.
    """
    parameters = np.asarray(parameters, float)
    pseudo = pseudo_inertia(parameters)
    mass = max(parameters[0], 1e-3)
    com = parameters[1:4] / mass if parameters[0] > 0 else np.zeros(3)
    # Second moment about the centre of mass, floored at a radius of gyration of 1 cm.
    second = pseudo[:3, :3] - mass * np.outer(com, com)
    values, vectors = np.linalg.eigh(0.5 * (second + second.T))
    floor = mass * 0.01**2 if values[-1] <= mass * 0.01**2 else 1e-3 * values[-1]
    second = (vectors * np.maximum(values, floor)) @ vectors.T
    return np.block([[second + mass * np.outer(com, com), mass * com[:, None]], [mass * com[None], np.array([[mass]])]])


def pullback_metric(parameters: np.ndarray) -> np.ndarray:
    """Constant pull-back metric of one body (10,), (10, 10): relative change of its mass distribution [Lee2020]_.

    ``M_kl = 1/2 tr(P^-1 B_k P^-1 B_l)``: ``d' M d`` does not depend on units or frames. On the boundary of
    the physical bodies (a point, a rod, a placeholder without extent) the metric is singular, so it is that of the
    body's `solid` neighbour.
    """
    product = np.linalg.inv(solid(parameters)) @ BASIS  # (10, 4, 4)
    return 0.5 * np.einsum("kij,lji->kl", product, product)
