"""Inertial parameters of a robot from a force/torque sensor under its base and from its joint torques."""

from importlib.metadata import version

from bayesid.comparison import Comparison, compare
from bayesid.diagnosis import Diagnosis, diagnose
from bayesid.errors import BayesidError, BayesidWarning, EstimationError, InputError
from bayesid.estimators import (
    DEFAULT_METHOD,
    METHODS,
    Bounds,
    Estimate,
    LeastSquares,
    Physical,
    Ridge,
    TruncatedSVD,
    estimator,
    fit,
    load_bounds,
)
from bayesid.experiment import Experiment, Motion, Sensor, load_experiment, write_experiment
from bayesid.filters import LowPass
from bayesid.inspection import Inspection
from bayesid.inspection import inspect as check
from bayesid.posterior import ConvergenceError, Posterior
from bayesid.priors import Prior
from bayesid.regression import Regression
from bayesid.robot import Robot, load_robot
from bayesid.sampling import sample
from bayesid.simulation import Recorder, Simulation, simulate, write_simulation
from bayesid.tables import Table
from bayesid.trajectories import Trajectory, fourier_trajectory
from bayesid.workflow import Identification, identify, summary

__version__ = version("bayesid")

__all__ = [
    "DEFAULT_METHOD",
    "METHODS",
    "BayesidError",
    "BayesidWarning",
    "Bounds",
    "Comparison",
    "ConvergenceError",
    "Diagnosis",
    "Estimate",
    "EstimationError",
    "Experiment",
    "Identification",
    "InputError",
    "Inspection",
    "LeastSquares",
    "LowPass",
    "Motion",
    "Physical",
    "Posterior",
    "Prior",
    "Recorder",
    "Regression",
    "Ridge",
    "Robot",
    "Sensor",
    "Simulation",
    "Table",
    "Trajectory",
    "TruncatedSVD",
    "check",
    "compare",
    "diagnose",
    "estimator",
    "fit",
    "fourier_trajectory",
    "identify",
    "load_bounds",
    "load_experiment",
    "load_robot",
    "sample",
    "simulate",
    "summary",
    "write_experiment",
    "write_simulation",
]
