"""Sets of sensors that an experiment may be read with, and the noise of their single readings.

Noise is as given, as a data sheet says, as recordings show, or assumed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag

from bayesid.dynamics.channels import WRENCH_NAMES
from bayesid.errors import InputError
from bayesid.estimators.nonlinear import settled
from bayesid.estimators.weights import learn_weights
from bayesid.recordings.experiment import Experiment, Sensor
from bayesid.regression.options import FitOptions
from bayesid.regression.problem import Problem, prepare
from bayesid.regression.readings import has_readings
from bayesid.robot.robot import Robot
from bayesid.signals.noise import NoiseModel, noise_of_group

#: White noise of one sample of a good base force/torque sensor, where nothing else is known [N], [N m]; assumed.
ASSUMED_FORCE, ASSUMED_MOMENT = 0.5, 0.05
#: The same of a drive's torque, as a share of its effort limit, and where the URDF states no limit [N m or N]; assumed.
_DRIVE_SHARE, _DRIVE_NOISE = 0.005, 0.5
_KINDS = ("force", "moment", "torque")


@dataclass(frozen=True)
class SensorSet:
    """What is read, and what becomes of the constant offset of the force/torque sensor."""

    name: str  # key in results
    title: str  # the same in words
    channel: str  # ``wrench``, ``torque`` or ``both``
    #: ``static run``: a run at rest in the same positions is subtracted, which takes gravity along (equation 21 of [Liu1998]_);
    #: ``fitted``: estimated along; ``known``: there is none, or it has been measured.
    offset: str = "known"

    @property
    def gravity(self) -> bool:
        """Whether gravity is in the readings."""
        return self.offset != "static run"


#: All of them, in the order in which they are shown.
SENSOR_SETS = {
    s.name: s
    for s in (
        SensorSet("wrench-static", "wrench less its static run", "wrench", "static run"),
        SensorSet("wrench-offset", "wrench, offsets fitted", "wrench", "fitted"),
        SensorSet("wrench", "wrench, offsets known", "wrench"),
        SensorSet("torque", "joint torques", "torque"),
        SensorSet("both-offset", "wrench and torques, offsets fitted", "both", "fitted"),
        SensorSet("both", "wrench and torques, offsets known", "both"),
    )
}


@dataclass(frozen=True)
class ReadingNoise:
    """Noise of single readings, by group of rows (``trajectory``, ``poses``)."""

    #: Noise models of six and of n channels, by group; a missing group has the other's size without its colour.
    wrench: Mapping[str, NoiseModel]
    torque: Mapping[str, NoiseModel]
    #: Where each comes from, by ``wrench`` and ``torque``: ``given``, ``data sheet``, ``readings`` or ``assumed``.
    sources: Mapping[str, str]
    given: frozenset[str] = frozenset()  # names of the channels whose noise is given

    def of(self, sensor_set: SensorSet) -> dict[str, NoiseModel]:
        """Noise of the rows of a sensor set: the difference of two readings where a static run is subtracted."""
        parts = {"wrench": [self.wrench], "torque": [self.torque], "both": [self.wrench, self.torque]}[sensor_set.channel]
        readings = 2.0 if sensor_set.offset == "static run" else 1.0
        return {group: _stacked([noise_of_group(p, group) for p in parts], readings) for group in ("trajectory", "poses")}


def white_noise(
    robot: Robot, sensor: Sensor | None = None, given: Mapping[str, float] | None = None, joints: Sequence[int] | None = None
) -> ReadingNoise:
    """White noise of one sample of every channel: as given, else of the sensor's data sheet, else an assumed one.

    ``given`` are standard deviations by ``force`` [N], ``moment`` [N m], ``torque`` [N m or N] for a kind, or by the channel's
    name, ``fx`` ... ``mz``, ``tau1`` ...; ``joints`` are those whose torques are read, default all. An `InputError` where a name
    is no channel's, or a number is not above zero.
    """
    given = dict(given or {})
    drives = tuple(f"tau{k + 1}" for k in range(robot.n))
    for name, std in given.items():
        if name not in (*_KINDS, *WRENCH_NAMES, *drives):
            raise InputError(f"noise '{name}': no such readings; write force, moment, torque, or a channel such as fx or tau1")
        if not (np.isfinite(std) and std > 0):
            raise InputError(f"noise {name} = {std}: give a standard deviation above zero, in the channel's unit")
    effort = np.where(np.isfinite(robot.effort_limit) & (robot.effort_limit > 0), _DRIVE_SHARE * robot.effort_limit, _DRIVE_NOISE)
    sheet = (None, None) if sensor is None else (sensor.force_std, sensor.torque_std)
    forces = sheet[0] or ASSUMED_FORCE, sheet[1] or ASSUMED_MOMENT
    wrench = [given.get(n, given.get(_KINDS[k // 3], forces[k // 3])) for k, n in enumerate(WRENCH_NAMES)]
    read = range(robot.n) if joints is None else joints
    torque = [given.get(drives[k], given.get("torque", float(effort[k]))) for k in read]
    kinds = dict(zip((*WRENCH_NAMES, *drives), (*(_KINDS[k // 3] for k in range(6)), *("torque",) * robot.n), strict=True))
    known = frozenset(n for n, kind in kinds.items() if n in given or kind in given)
    sources = {
        "wrench": "given" if known.issuperset(WRENCH_NAMES) else "data sheet" if all(sheet) else "assumed",
        "torque": "given" if known.issuperset(drives[k] for k in read) else "assumed",
    }
    return ReadingNoise(_white(wrench), _white(torque), sources, known)


def recorded_noise(
    experiment: Experiment, otherwise: ReadingNoise, options: FitOptions | None = None
) -> tuple[ReadingNoise, dict[str, Problem]]:
    """Noise as a fit leaves it of the readings that there are, and what was fitted, by ``wrench`` and ``torque``.

    That is what `identify` bases its intervals on: colour included, and whatever the model lacks, also by what the fit scatters
    between parts of a recording beyond noise. Channels without readings, and those that are ``given``, keep the noise of
    ``otherwise``. The channel of ``options`` does not matter.
    """
    options = options or FitOptions()
    motions = [m for m in experiment.motions if m.name in options.motions] if options.motions else experiment.identification
    models, sources = {"wrench": otherwise.wrench, "torque": otherwise.torque}, dict(otherwise.sources)
    problems = {}
    for kind in models:
        recorded = bool(motions) and all(has_readings(m.table, kind) for m in motions)
        if (kind == "wrench" and experiment.sensor is None) or not recorded:
            continue
        problem = problems[kind] = settled(prepare(experiment, replace(options, channel=kind)))
        if sources[kind] == "given":
            continue
        weights = learn_weights(problem.regression)
        readings = 2.0 if problem.static == "motion" else 1.0
        learned = {g: m.scaled(1.0 / (readings if g == "trajectory" else 1.0)) for g, m in weights.dispersed().items()}
        given = np.array([n in otherwise.given for n in problem.row_model.channels.names])
        models[kind] = {g: _with_given(m, noise_of_group(models[kind], g), given) for g, m in learned.items()}
        sources[kind] = "readings"
    return replace(otherwise, wrench=models["wrench"], torque=models["torque"], sources=sources), problems


def _white(std) -> dict[str, NoiseModel]:
    model = NoiseModel.stated(np.asarray(std, float))
    return {"trajectory": model, "poses": model}


def _with_given(model: NoiseModel, white: NoiseModel, given: np.ndarray) -> NoiseModel:
    """The noise with some channels (c,) as white as given."""
    coefficients = np.where(given[:, None], np.eye(1, model.order + 1), model.coefficients)
    innovation = np.where(given[:, None] | given, white.innovation, model.innovation)
    return replace(model, coefficients=coefficients, innovation=innovation)


def _stacked(parts: list[NoiseModel], readings: float) -> NoiseModel:
    """Independent channels side by side, each the sum of so many readings."""
    order = max(p.order for p in parts)
    coefficients = np.vstack([np.pad(p.coefficients, ((0, 0), (0, order - p.order))) for p in parts])
    return NoiseModel(coefficients, readings * np.asarray(block_diag(*(p.innovation for p in parts))))
