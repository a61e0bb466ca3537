# What this package uses of clarabel, a compiled module without annotations.
from collections.abc import Sequence

import numpy as np
from scipy.sparse import csc_matrix

class SolverStatus:
    PrimalInfeasible: SolverStatus
    AlmostPrimalInfeasible: SolverStatus

class DefaultSettings:
    verbose: bool
    max_threads: int
    equilibrate_enable: bool
    tol_gap_abs: float
    tol_gap_rel: float
    tol_feas: float
    static_regularization_constant: float

class NonnegativeConeT:
    def __init__(self, dim: int) -> None: ...

class PSDTriangleConeT:
    def __init__(self, dim: int) -> None: ...

class DefaultSolution:
    x: Sequence[float]
    z: Sequence[float]
    status: SolverStatus
    iterations: int

class DefaultSolver:
    def __init__(
        self,
        P: csc_matrix,
        q: np.ndarray,
        A: csc_matrix,
        b: np.ndarray,
        cones: Sequence[NonnegativeConeT | PSDTriangleConeT],
        settings: DefaultSettings,
    ) -> None: ...
    def solve(self) -> DefaultSolution: ...
