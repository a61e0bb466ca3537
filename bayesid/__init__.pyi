from . import datasets
from .design.excitation.options import ExcitationOptions
from .effects.library import EffectLibrary, load_effects
from .errors import BayesidError, BayesidWarning, EstimationError, InputError
from .estimators import DEFAULT_METHOD, METHODS, estimator, fit
from .estimators.conic.bounds import Bounds, load_bounds
from .estimators.conic.physical import Physical
from .estimators.errors_in_variables import InstrumentalVariables, TotalLeastSquares
from .estimators.estimator import CustomDetails, Estimate, Estimator
from .estimators.least_squares import LeastSquares, Ridge, TruncatedSVD
from .estimators.robust.m_estimators import Huber, Student
from .posterior.result import Posterior
from .posterior.run import ConvergenceError, Sampler
from .recordings.experiment import Experiment, Motion, Sensor, load_experiment
from .recordings.table import Table
from .recordings.writer import write_experiment
from .regression.options import FitOptions
from .regression.regression import Regression
from .results.accuracy import Accuracy
from .results.bounds import ControllerBounds
from .results.changes import Changes, Watch
from .results.comparison import Comparison
from .results.diagnosis import Diagnosis
from .results.excitation import DistinguishingMotion, Excitation
from .results.exported import Exported
from .results.identifiability import Identifiability
from .results.identification import Identification, summary
from .results.imported import Imported
from .results.inspection import Inspection
from .results.loaded import NeedsRecording, load
from .results.payload import Calibration, PayloadEstimate
from .results.posterior import ExperimentPosterior
from .robot.prior import Prior
from .robot.robot import Robot, load_robot
from .signals.filters import LowPass
from .simulation.simulation import Recorder, Simulation, simulate, write_simulation
from .simulation.trajectories import Trajectory, fourier_trajectory, read_trajectory, write_trajectory
from .workflows.accuracy import accuracy
from .workflows.bounds import bounds
from .workflows.calibrate import calibrate
from .workflows.check import check
from .workflows.compare import compare
from .workflows.demo import Demo, demo
from .workflows.diagnose import diagnose
from .workflows.excite import excite, tell
from .workflows.export import export
from .workflows.identifiability import identifiability
from .workflows.identify import identify
from .workflows.payload import payload
from .workflows.read_recording import read_recording
from .workflows.sample import sample
from .workflows.watch import watch

__version__: str

__all__ = [
    "DEFAULT_METHOD",
    "Demo",
    "METHODS",
    "Accuracy",
    "BayesidError",
    "BayesidWarning",
    "Bounds",
    "Calibration",
    "Changes",
    "Comparison",
    "ControllerBounds",
    "ConvergenceError",
    "Diagnosis",
    "EffectLibrary",
    "Estimate",
    "EstimationError",
    "Estimator",
    "Excitation",
    "ExcitationOptions",
    "Experiment",
    "ExperimentPosterior",
    "Exported",
    "FitOptions",
    "Huber",
    "Identifiability",
    "Identification",
    "Imported",
    "InputError",
    "Inspection",
    "InstrumentalVariables",
    "LeastSquares",
    "LowPass",
    "Motion",
    "NeedsRecording",
    "CustomDetails",
    "PayloadEstimate",
    "Physical",
    "Posterior",
    "Prior",
    "Recorder",
    "Regression",
    "Ridge",
    "Robot",
    "Sampler",
    "Sensor",
    "Simulation",
    "Student",
    "Table",
    "DistinguishingMotion",
    "TotalLeastSquares",
    "Trajectory",
    "TruncatedSVD",
    "Watch",
    "accuracy",
    "bounds",
    "calibrate",
    "check",
    "compare",
    "datasets",
    "demo",
    "diagnose",
    "estimator",
    "excite",
    "export",
    "fit",
    "fourier_trajectory",
    "identifiability",
    "identify",
    "load",
    "load_bounds",
    "load_effects",
    "load_experiment",
    "load_robot",
    "payload",
    "read_recording",
    "read_trajectory",
    "sample",
    "simulate",
    "summary",
    "tell",
    "watch",
    "write_experiment",
    "write_simulation",
    "write_trajectory",
]
