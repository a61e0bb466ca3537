"""What candidate sensors would tell of the user's own motion, before anything is bought.

``sensors.toml`` lists the candidates: where each is, its noise, range and resolution.

Rows ``y = X b + e`` of the channels that a sensor reads, weighted by its noise, are reduced to the factor R of the information.
Intervals of link parameters need a prior, as no sensor determines them all: with C0 the covariance of the nominal links,
``(K'R'R K + C0^-1)^-1``. An effect of usual size with the trace z, base and effect parameters projected out, stands out by its
length, so that ``5 / |z|`` of that size is the smallest that would be seen. Load cells under a rigid plate share its wrench w
as ``G^+ w``, G their map to the wrench, which counts what they do not measure as not measured.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import pinocchio as pin
from pydantic import Field

from bayesid.design.accuracy.bench import Bench, missing_effects
from bayesid.design.expected import Expected, rows_of
from bayesid.design.identifiability import Shown, shown, std_with_prior
from bayesid.design.reading_noise import SENSOR_SETS
from bayesid.diagnosis.detectability import IMPLAUSIBLE
from bayesid.diagnosis.settings import DEFAULT
from bayesid.dynamics.channels import WRENCH_NAMES
from bayesid.effects import MotionSegment, Term
from bayesid.errors import InputError
from bayesid.estimators.factor import reduce_rows
from bayesid.recordings.experiment import Experiment, Sensor
from bayesid.recordings.table import usual_step
from bayesid.recordings.toml_file import Name, NonNegative, Positive, Section, Vector3, read_toml
from bayesid.regression.blocks import Block
from bayesid.regression.parallel import in_order
from bayesid.regression.row_model import RowModel
from bayesid.regression.rows import make_blocks
from bayesid.regression.segment import Segment
from bayesid.robot.prior import robot_prior
from bayesid.robot.robot import Robot, load_robot
from bayesid.simulation.simulation import plant_readings

KINDS = {
    "base": "force/torque sensor under the base",
    "wrist": "force/torque sensor in a joint",
    "plate": "load cells under a plate",
    "torque": "joint torque sensors",
}
_AXES = {"x": 0, "y": 1, "z": 2}
#: Prior relative standard deviation of nominal links where the experiment does not say.
USUAL_REL_STD = 0.3


class _Listed(Section):
    """A section ``[[sensor]]`` of the file: a sensor to choose from."""

    name: Name
    kind: Literal["base", "wrist", "plate", "torque"]
    noise: Annotated[list[Positive], Field(min_length=1)]
    range: list[Positive] = []
    resolution: list[NonNegative] = []
    rate: Positive | None = None
    joint: str | None = None
    translation: Vector3 | None = None
    rpy: Vector3 | None = None
    cells: list[Vector3] | None = None
    axes: Literal["z", "xyz"] | None = None
    joints: list[str] | None = None


class _File(Section):
    """The file that lists sensors."""

    format: Literal[1] = 1
    sensor: Annotated[list[_Listed], Field(min_length=1)]


@dataclass(frozen=True, eq=False)
class CandidateSensor:
    """A sensor that might be bought."""

    #: What it is called, and a key of `KINDS`.
    name: str
    kind: str
    #: Names and units of what it measures (m,).
    readings: tuple[str, ...]
    units: tuple[str, ...]
    std: np.ndarray  # standard deviation of one sample of each, rounding to its resolution included (m,)
    limit: np.ndarray  # largest magnitude that each can read (m,); infinite where none is stated
    rate: float | None  # samples a second; None: those of the recording
    joint: str | None  # joint that a wrist sensor sits in
    #: Pose of its frame in the base frame, or in that joint's child link (3, 3), (3,) [m].
    rotation: np.ndarray
    translation: np.ndarray
    #: From readings to the wrench in that frame (6, m): of load cells; None: the readings are the channels.
    load_map: np.ndarray | None = None
    drives: tuple[int, ...] = ()  # indices of the joints that torque sensors are in

    def reading_map(self, channels: int) -> np.ndarray:
        """Map from its kind's channels to the readings (m, c); load cells of equal stiffness share a wrench as `pinv` does."""
        if self.load_map is not None:
            return np.linalg.pinv(self.load_map)
        return np.eye(channels)[list(self.drives)] if self.kind == "torque" else np.eye(channels)


def read_sensors(path: str | Path, robot: Robot) -> tuple[CandidateSensor, ...]:
    """Read a list of candidate sensors, refused with an `InputError` where a key or value is wrong."""
    path = Path(path)
    keys = {("sensor",): _Listed.model_fields}
    file = read_toml(path, _File, keys, "a sensors.toml, which holds [[sensor]] tables")
    names = [s.name for s in file.sensor]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f'{path.name}: two sensors are named "{name}"; name them apart')
    return tuple(_candidate(s, path.name, robot) for s in file.sensor)


def _candidate(given: _Listed, source: str, robot: Robot) -> CandidateSensor:
    place = f'{source}: sensor "{given.name}"'
    allowed = {
        "base": ("translation", "rpy"), "wrist": ("joint", "translation", "rpy"), "plate": ("cells", "axes"),
        "torque": ("joints",),
    }[given.kind]  # fmt: skip
    for key in ("joint", "translation", "rpy", "cells", "axes", "joints"):
        if getattr(given, key) is not None and key not in allowed:
            raise InputError(f"{place}: {key} is not for kind {given.kind}; remove it, or write another kind")
    rotation, translation = np.eye(3), np.zeros(3)
    load_map, drives, units = None, (), ("N",) * 3 + ("N m",) * 3
    readings: tuple[str, ...] = WRENCH_NAMES
    if given.kind in ("base", "wrist"):
        if given.kind == "wrist" and given.joint is None:
            raise InputError(f"{place}: joint is missing; name the URDF joint that it sits in")
        rotation = pin.rpy.rpyToMatrix(*map(float, given.rpy or (0.0, 0.0, 0.0)))
        translation = np.array(given.translation or (0.0, 0.0, 0.0))
    elif given.kind == "plate":
        readings, translation, load_map = _cells(given, place)
        units = ("N",) * len(readings)
    else:
        names = given.joints or list(robot.joint_names)
        for name in names:
            if name not in robot.joint_names:
                raise InputError(f"{place}: joint '{name}' is none of {', '.join(robot.joint_names)}")
        drives = tuple(robot.joint_names.index(name) for name in names)
        readings = tuple(f"tau{k + 1}" for k in drives)
        units = tuple("N" if robot.prismatic[k] else "N m" for k in drives)
    kinds = 2 if given.kind in ("base", "wrist") else 1
    noise = _each(given.noise, "noise", len(readings), kinds, place)
    steps = _each(given.resolution, "resolution", len(readings), kinds, place, 0.0)
    return CandidateSensor(
        given.name, given.kind, readings, units, np.sqrt(noise**2 + steps**2 / 12.0),
        _each(given.range, "range", len(readings), kinds, place, np.inf), given.rate, given.joint, rotation, translation,
        load_map, drives,
    )  # fmt: skip


def _cells(given: _Listed, place: str) -> tuple[tuple[str, ...], np.ndarray, np.ndarray]:
    """Names of the cells' readings, the middle of the cells, and the map from readings to the wrench about it (6, m)."""
    cells = np.array(given.cells or [])
    if len(cells) < 3:
        raise InputError(f"{place}: cells has {len(cells)} places; give at least three, [[x, y, z], ...] in the base frame [m]")
    middle = cells.mean(axis=0)
    readings, columns = [], []
    for k, cell in enumerate(cells):
        for axis in given.axes or "z":
            force = np.eye(3)[_AXES[axis]]
            readings.append(f"cell{k + 1}{axis if given.axes == 'xyz' else ''}")
            columns.append(np.concatenate([force, np.cross(cell - middle, force)]))
    load_map = np.array(columns).T
    if np.linalg.matrix_rank(load_map, 1e-9) < (6 if given.axes == "xyz" else 3):
        raise InputError(f"{place}: the cells stand in one line, so that moments about it are not measured; move one aside")
    return tuple(readings), middle, load_map


def _each(values: list[float], key: str, count: int, kinds: int, place: str, otherwise: float | None = None) -> np.ndarray:
    """One number a reading (m,), from one for all, or one for forces and one for moments."""
    if not values and otherwise is not None:
        return np.full(count, otherwise)
    if len(values) == count:
        return np.array(values, float)
    if len(values) == kinds:
        return np.repeat(np.array(values, float), count // kinds)
    some = "one number for forces and one for moments" if kinds == 2 else "one number for all"
    raise InputError(f"{place}: {key} has {len(values)} numbers; give {some}, or {count}, one a reading")


@dataclass(frozen=True, eq=False)
class Outlook:
    """What one candidate would tell."""

    candidate: CandidateSensor  # the sensor
    determined: Shown  # the combinations of link parameters that it determines, with their expected standard deviations
    names: tuple[str, ...]  # of the link parameters (P,)
    #: Their standard deviations with these readings and without, both with the nominal links as far as they are trusted (P,).
    link_std: np.ndarray
    prior_std: np.ndarray
    #: By ``name@where`` the smallest share of an effect of usual size that would be seen; None: no plausible size is.
    effects: dict[str, float | None]
    peak: np.ndarray  # largest magnitude of every reading in these motions, weight included (m,)

    @property
    def load(self) -> float:
        """Largest share of a range that is used; above 1 the motion exceeds it, 0 where no range is stated."""
        return float(np.max(self.peak / self.candidate.limit, initial=0.0))

    @property
    def better_than_prior(self) -> int:
        """How many of the combinations it determines better than they are known beforehand, each parameter by itself."""
        prior = np.sqrt(self.determined.base.matrix**2 @ self.prior_std**2)
        return int(np.sum(self.determined.std < prior))

    def to_dict(self) -> dict[str, Any]:
        """An entry of ``sensors`` in ``accuracy.json``."""
        c, base = self.candidate, self.determined.base
        return {
            "name": c.name, "kind": c.kind, "rank": base.rank, "better_than_prior": self.better_than_prior,
            "base_parameters": [
                {"name": n, "label": label, "unit": u, "std": s}
                for n, label, u, s in zip(base.names, base.labels, base.units, self.determined.std, strict=True)
            ],
            "link_parameters": [
                {"name": n, "std": s, "prior_std": p} for n, s, p in zip(self.names, self.link_std, self.prior_std, strict=True)
            ],
            "uncertainty_left": self.left,
            "readings": [
                {"name": n, "unit": u, "peak": p, "range": r, "noise": s}
                for n, u, p, r, s in zip(c.readings, c.units, self.peak, c.limit, c.std, strict=True)
            ],
            "largest_share_of_range": self.load, "exceeds_range": self.load > 1.0,
            "smallest_effects": [{"effect": spec, "share_of_usual_size": share} for spec, share in self.effects.items()],
        }  # fmt: skip

    @property
    def left(self) -> dict[str, float]:
        """Share of prior uncertainty that is left, by body: root mean square over its ten parameters."""
        share = (self.link_std / self.prior_std) ** 2
        bodies = [n.rpartition(".")[0] for n in self.names]
        return {b: float(np.sqrt(np.mean([s for s, own in zip(share, bodies, strict=True) if own == b]))) for b in bodies}


@dataclass(frozen=True)
class SensorChoice:
    """Candidates side by side."""

    outlooks: tuple[Outlook, ...]  # one a candidate, in the order of the file
    rel_std: float  # relative standard deviation of the nominal links that intervals count with
    assumed: bool  # whether the experiment did not state it


def choose_sensor(
    bench: Bench, candidates: Sequence[CandidateSensor], tell: Callable[[str], object] = lambda _: None
) -> SensorChoice:
    """What each candidate would tell of the fitted motions; an `InputError` where a wrist sensor's joint does not exist."""
    stated = bench.experiment.inertia_rel_std
    rel_std = stated or USUAL_REL_STD
    outlooks = []
    for candidate in candidates:
        tell(f"sensor {candidate.name}")
        outlooks.append(_outlook(bench, candidate, rel_std))
    return SensorChoice(tuple(outlooks), rel_std, not stated)


def _equipped(bench: Bench, candidate: CandidateSensor) -> tuple[Experiment, np.ndarray]:
    """The experiment with the candidate in place, and its true links (b, 10)."""
    own, robot = replace(bench.experiment, motions=()), bench.experiment.robot  # whatever torques were recorded: all are read
    if candidate.kind == "torque":
        return own, bench.links
    rpy = pin.rpy.matrixToRpy(candidate.rotation)
    if candidate.joint != robot.sensor_joint:
        try:
            robot = load_robot(robot.description, robot.joint_names, own.locked, robot.gravity.tolist(), candidate.joint)
        except InputError as error:
            raise InputError(f'sensor "{candidate.name}": {error}') from None
    links = bench.links if robot.body_names == own.robot.body_names else robot.nominal
    sensor = Sensor(joint=candidate.joint, translation=candidate.translation, rpy=rpy)
    return replace(own, robot=robot, sensor=sensor), links


def _outlook(bench: Bench, candidate: CandidateSensor, rel_std: float) -> Outlook:
    experiment, links = _equipped(bench, candidate)
    sensor_set = SENSOR_SETS["torque" if candidate.kind == "torque" else "wrench-offset"]
    motions = [replace(m.motion, static=None) for m in bench.motions]
    bandwidth = bench.problem.smoother.bandwidth
    model, segments = rows_of(experiment, sensor_set, motions, effects=bench.options.effects, bandwidth=bandwidth)
    rate = 1.0 / min(usual_step(m.motion.table.times) for m in bench.motions if m.pieces)
    # Faster samples are averaged over the time of one sample of the recording.
    averaged = np.sqrt(rate / candidate.rate) if candidate.rate else 1.0
    # From the channels to white readings of unit variance at the recording's rate (m, c).
    weigh = candidate.reading_map(len(model.channels)) / (averaged * candidate.std[:, None])
    factor = reduce_rows(make_blocks(model, segments), lambda b: _combined(weigh, b)[:, :, :-1]).r
    expected = Expected(model.base, model.effect_names, model.effect_units, factor, factor, model)
    determined = shown(expected)
    prior = robot_prior(experiment.robot, rel_std).covariance
    link_std, prior_std = std_with_prior(determined.factor @ determined.base.matrix, prior)
    terms = tuple(t for t in bench.terms if any(t.effect.acts_on(c) for c in model.channels.names))
    motions = [(s, bench.smoothed(s, model)) for s in segments]
    plain = [plant_readings(experiment.robot, model.channels, states, links, terms) for _, states in motions]
    peak = np.max([np.abs(r @ candidate.reading_map(r.shape[1]).T).max(axis=0) for r in plain], axis=0)
    if model.point is not None:  # columns are those of this very plant
        links, terms = model.point.links, model.point.terms(model.effects)
    return Outlook(
        candidate, determined, model.base.parameter_names, link_std, prior_std,
        _effects(experiment, model, motions, links, terms, weigh), peak,
    )  # fmt: skip


def _combined(weigh: np.ndarray, block: Block) -> np.ndarray:
    """Rows of a block as a sensor reads them (k, m, p + 1)."""
    return np.einsum("mc,kcp->kmp", weigh, block.rows)


def _effects(
    experiment: Experiment, model: RowModel, motions: Sequence[tuple[Segment, MotionSegment]], links: np.ndarray,
    terms: tuple[Term, ...], weigh: np.ndarray,
) -> dict[str, float | None]:  # fmt: skip
    """Smallest share of each effect of usual size that would stand out by five standard deviations."""

    def length(term: Term) -> float:
        try:
            with np.errstate(all="ignore"):
                made = [plant_readings(experiment.robot, model.channels, states, links, (*terms, term)) for _, states in motions]
        except InputError:
            return 0.0
        read = [replace(s, readings=r) for (s, _), r in zip(motions, made, strict=True)]
        # The columns explain the plant itself: what they leave is the effect's.
        return float(abs(reduce_rows(make_blocks(model, read), lambda b: _combined(weigh, b)).r[-1, -1]))

    absent = missing_effects(experiment, model)
    lengths = zip(absent, in_order(length, absent), strict=True)
    return {t.effect.spec: DEFAULT.detected / size if size > DEFAULT.detected / IMPLAUSIBLE else None for t, size in lengths}
