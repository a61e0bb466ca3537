"""Recordings with known truth: a robot, its sensor and drives, simulated.

The true motion comes first, as arrays; then what the instruments make of it:

    wrench  = Y phi + static wrench + sensor effects + noise
    torques = Y_tau phi + friction and other effects of the drives + noise
    encoder = count * round((q + noise) / count)

With a static run, the robot is stopped at every sample (or at other poses) and all is read anew, which is the
stop-and-go run of [Liu1998]_.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.linalg import expm

from bayesid.argument_types import explains_types
from bayesid.arguments import argument
from bayesid.dynamics.channels import WRENCH_NAMES, Channels, torque_channels, wrench_channels
from bayesid.effects import REST_SPEED, Effect, EffectLibrary, EncoderEffect, MotionSegment, Term, TransmissionEffect, middle_of
from bayesid.effects.exact import reach_of, readings, stated_of
from bayesid.effects.sizes import ANY_EFFORT
from bayesid.effects.torque_chain import coupling_matrix
from bayesid.errors import InputError, require_seed
from bayesid.recordings.experiment import Experiment, Motion, Sensor, as_experiment
from bayesid.recordings.table import Table
from bayesid.recordings.toml_file import LARGEST
from bayesid.recordings.writer import write_experiment
from bayesid.robot import inertia
from bayesid.robot.robot import Robot
from bayesid.simulation.trajectories import Trajectory, new_trajectories, recorded_trajectories

Values = Mapping[str, float | bool]

_LARGEST_CHANGE = 10  # of links that are perturbed, as a relative standard deviation
_CHUNK = 8192  # samples whose readings are made at once
#: What is differentiated again on the way, a flexible joint's torque, is smooth up to this [Hz].
_BANDWIDTH = 20.0


@explains_types
@dataclass(frozen=True)
class Recorder:
    """The instruments. None: as the experiment states, else a common value.

    Attributes
    ----------
    resolution
        One encoder count, one number or one a joint [rad or m]; default 1e-4. 0: none.
    position_std
        Random encoder noise on top [rad or m]; default 0.
    velocity_std
        Noise of a velocity column [rad/s or m/s]; None: no such column.
    force_std, torque_std
        Noise of one sample of the force/torque sensor [N], [N m]; default 0.5 and 0.05, a strain-gauge platform.
    drive_std
        Noise of one sample of the joint torques, as a share of the effort limit; default 0.002 (assumed).
    """

    resolution: float | tuple[float, ...] | None = None
    position_std: float | None = None
    velocity_std: float | None = None
    force_std: float | None = None
    torque_std: float | None = None
    drive_std: float | None = None

    def __post_init__(self):
        for item in fields(self):
            value = getattr(self, item.name)
            if value is None:
                continue
            several = item.name == "resolution" and isinstance(value, (tuple, list, np.ndarray))
            numbers = value if several else [value]
            if not all(isinstance(x, (int, float, np.number)) and 0 <= x <= LARGEST for x in numbers):
                each = ", or one a joint" if item.name == "resolution" else ""
                raise InputError(f"{item.name} = {value}: give a number from 0 to {LARGEST:g}{each}")


@dataclass(frozen=True, eq=False)
class Truth:
    """What a simulated recording was made with."""

    links: np.ndarray  # ten parameters a body (b, 10)
    terms: tuple[Term, ...]  # the effects with their values
    recorder: Recorder  # the instruments, all values filled in
    seed: int  # of everything random

    @property
    def effects(self) -> dict[str, dict[str, float]]:
        """``name@where`` with the values of its parameters."""
        return {t.effect.spec: dict(zip(t.effect.parameters, t.values, strict=True)) for t in self.terms}

    def to_dict(self, robot: Robot) -> dict[str, Any]:
        """What ``truth.json`` holds."""
        effects = []
        for term in self.terms:
            e = term.effect
            listed = {k: {"value": v, "unit": unit} for k, v, unit in zip(e.parameters, term.values, e.units, strict=True)}
            effects.append({"name": e.name, "where": e.where, "parameters": listed})
        return {
            "schema": 1, "seed": self.seed, "effects": effects, "noise": asdict(self.recorder),
            "link_parameter_names": list(robot.parameter_names),
            "true_links": dict(zip(robot.body_names, self.links.tolist(), strict=True)),
            "nominal_links": dict(zip(robot.body_names, robot.nominal.tolist(), strict=True)),
        }  # fmt: skip


@dataclass(frozen=True, eq=False, repr=False)
class Simulation(Experiment):
    """An experiment whose truth is known; it can be used wherever an experiment can.

    Attributes
    ----------
    truth
        What it was made with.
    """

    truth: Truth = field(kw_only=True)


def perturbed_links(robot: Robot, rel_std: float, seed: int = 0) -> np.ndarray:
    """Bodies near the nominal ones that can exist, (b, 10).

    A pseudo-inertia ``P = L L'`` becomes ``L exp(s S) L'`` with a random symmetric S, which stays positive
    definite whatever s is, does not depend on frames or units, and changes masses and second moments by the
    relative standard deviation s [Lee2020]_. An `InputError` where a nominal body cannot exist.
    """
    possible = inertia.is_physically_consistent(robot.nominal)
    if not possible.all():
        name = robot.body_names[int(np.flatnonzero(~possible)[0])]
        raise InputError(f"{robot.urdf.name}: no body has the nominal inertia of '{name}', so it cannot be perturbed")
    rng = np.random.default_rng(seed)
    links = np.empty_like(robot.nominal)
    for k, body in enumerate(robot.nominal):
        values, vectors = np.linalg.eigh(inertia.pseudo_inertia(body))
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        s = rng.normal(size=(4, 4))
        links[k] = inertia.from_pseudo_inertia(root @ expm(rel_std * 0.5 * (s + s.T)) @ root.T)
    return links


@explains_types
def simulate(
    setup: Experiment | Robot | str | Path,
    trajectories: Sequence[Trajectory] | None = None,
    *,
    effects: Mapping[str, Values | None] | Sequence[str] | str = (),
    links: np.ndarray | None = None,
    perturb: float = 0.0,
    recorder: Recorder | None = None,
    seed: int = 0,
) -> Simulation:
    """Simulate what an experiment would record.

    Parameters
    ----------
    setup
        The robot, its sensor and what is known of both, an experiment or its folder; a bare robot gets a sensor under its base.
    trajectories
        True motions; default the experiment's own, or new ones.
    effects
        What the plant has beyond rigid bodies, ``name`` or ``name@where``, with values of its parameters
        (`default_values` where left out); a list of them, or one text with commas between.
    links
        True link parameters (b, 10); default nominal.
    perturb
        Changes them by this relative standard deviation, from 0 to 10, see `perturbed_links`.
    recorder
        The instruments.
    seed
        Of everything random.

    Returns
    -------
    simulation
        An experiment with the setup's nominal robot and model, and the truth; `write_simulation` writes both into a folder.

    Raises
    ------
    InputError
        Unknown effect, place or parameter; links, motions or instruments of another robot; a number that cannot be.
    """
    if isinstance(setup, Robot):
        setup = Experiment(setup.name, setup, (), Sensor(setup.sensor_joint))
    require_seed(seed)
    if not 0 <= perturb <= _LARGEST_CHANGE:
        raise InputError(f"{argument('perturb', perturb)}: give a share from 0 to {_LARGEST_CHANGE}, such as 0.1")
    setup = as_experiment(setup, "a Robot")
    robot = setup.robot
    streams = [int(s.generate_state(1)[0]) for s in np.random.SeedSequence(seed).spawn(3)]
    if trajectories is None:
        trajectories = recorded_trajectories(setup) if setup.motions else new_trajectories(robot, seed=streams[0])
    for motion in trajectories:
        if motion.positions.shape[1] != robot.n:
            joints = motion.positions.shape[1]
            raise InputError(f"trajectory '{motion.name}' moves {joints} joints, the robot has {robot.n}; plan it for this robot")
    true = np.array(robot.nominal if links is None else links, float)
    if true.shape != robot.nominal.shape:
        raise InputError(f"links have shape {true.shape}; give {robot.nominal.shape}, ten parameters a body")
    if perturb:
        true = perturbed_links(replace(robot, nominal=true), perturb, streams[1])
    plant = complete_effects(robot, effects, setup.effect_values, setup.library)
    recorder = _complete(recorder or Recorder(), setup)
    if np.size(recorder.resolution or 0.0) not in (1, robot.n):
        raise InputError(f"resolution = {recorder.resolution}: give one number, or one for each of {robot.n} joints")
    bench = _Bench(setup, true, plant, recorder, np.random.default_rng(streams[2]), _middle(trajectories))
    resolution = float(np.max(recorder.resolution or 0.0))
    return Simulation(
        name=setup.name, robot=robot, motions=tuple(bench.record(t) for t in trajectories),
        sensor=None if setup.sensor is None else replace(
            setup.sensor, force_std=recorder.force_std or None, torque_std=recorder.torque_std or None
        ),
        effects=setup.effects, effect_values=setup.effect_values, inertia_rel_std=perturb or setup.inertia_rel_std,
        position_resolution=resolution or None, position_std=recorder.position_std or None, gear_ratio=setup.gear_ratio,
        locked=setup.locked, library=setup.library, truth=Truth(true, bench.terms, recorder, seed),
    )  # fmt: skip


@explains_types
def write_simulation(simulation: Simulation, folder: str | Path) -> None:
    """Write the experiment folder with ``truth.json`` in it; see `bayesid.recordings.writer.write_experiment`."""
    truth = json.dumps(simulation.truth.to_dict(simulation.robot), indent=1, allow_nan=False)
    write_experiment(simulation, folder, {"truth.json": truth + "\n"})


def encoder_readings(
    positions: np.ndarray, resolution: float | Sequence[float] | np.ndarray, std: float | np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """``count * round((q + noise) / count)``, what encoders say of true positions q (N, n) [rad or m].

    Count, 0 for none, and random noise are one number, or one a joint (n,).
    """
    q = positions + std * rng.normal(size=positions.shape)
    count = np.broadcast_to(np.asarray(resolution, float), (positions.shape[1],))
    return np.where(count > 0, np.round(q / np.where(count > 0, count, 1.0)) * count, q)


def _middle(trajectories: Sequence[Trajectory]) -> np.ndarray | None:
    """Middle of the first motion that is fitted: a mount has one stiffness in all of them."""
    moving = [t for t in trajectories if t.kind != "poses"]
    moving = [t for t in moving if t.role == "identification"] or moving
    return middle_of(moving[0].positions) if moving else None


def _complete(recorder: Recorder, setup: Experiment) -> Recorder:
    """Fill in what the setup states, else a common value."""
    sensor = setup.sensor or Sensor()
    stated = {
        "resolution": (setup.position_resolution, 1e-4), "position_std": (setup.position_std, 0.0),
        "force_std": (sensor.force_std, 0.5), "torque_std": (sensor.torque_std, 0.05), "drive_std": (None, 0.002),
    }  # fmt: skip
    values = {k: known if known is not None else common for k, (known, common) in stated.items() if getattr(recorder, k) is None}
    return replace(recorder, **values)


class _Bench:
    """Turns true motions into recordings."""

    def __init__(
        self, setup: Experiment, links: np.ndarray, plant, recorder: Recorder, rng: np.random.Generator, middle: np.ndarray | None
    ):
        self.robot, self.links, self.recorder, self.rng = setup.robot, links, recorder, rng
        self.terms = tuple(
            Term(effect, tuple(values[key] for key in effect.parameters))
            for spec, values in plant.items()
            for effect in places_of(spec, setup.robot, setup.library, setup.gear_ratio)
        )
        self.middle = middle
        self.torque = torque_channels(self.robot)
        self.wrench = None
        if setup.sensor is not None:
            self.wrench = wrench_channels(self.robot, setup.sensor.rotation, setup.sensor.translation)
        effort = np.where(np.isfinite(self.robot.effort_limit), self.robot.effort_limit, ANY_EFFORT)
        self.drive_std = (recorder.drive_std or 0.0) * effort

    def record(self, motion: Trajectory) -> Motion:
        poses = motion.kind == "poses"
        moving = MotionSegment(
            motion.times, motion.positions, motion.velocities, motion.accelerations, still=poses, in_turn=poses
        )
        table = self._table(moving, motion.name)
        static = None
        if motion.static_positions is not None:
            q = motion.static_positions
            times = motion.times if len(q) == len(motion.times) else np.arange(float(len(q)))
            held = MotionSegment(times, q, np.zeros_like(q), np.zeros_like(q), still=True)
            static = self._table(held, f"{motion.name}_static")
        # What is simulated needs no check.
        return Motion(motion.name, motion.role, table, motion.kind, static, motion.period, motion.parked, examined=True)

    def _table(self, segment: MotionSegment, name: str) -> Table:
        """What is recorded of a motion, or of a static run."""
        rng, recorder = self.rng, self.recorder
        segment = replace(at_encoders(self.robot, segment, self.terms), middle=self.middle)
        q = encoder_readings(segment.positions, recorder.resolution or 0.0, recorder.position_std or 0.0, rng)
        velocities = None
        if recorder.velocity_std is not None:
            velocities = segment.velocities + recorder.velocity_std * rng.normal(size=q.shape)
        wrench = None
        if self.wrench is not None:
            std = np.repeat([recorder.force_std or 0.0, recorder.torque_std or 0.0], 3)
            wrench = plant_readings(self.robot, self.wrench, segment, self.links, self.terms)
            wrench += std * rng.normal(size=wrench.shape)
        if segment.still:
            # At rest friction holds whatever the drive happens to push with: partly mobilised, as in a slow creep.
            segment = replace(segment, velocities=REST_SPEED * rng.uniform(-1, 1, q.shape))
        torques = plant_readings(self.robot, self.torque, segment, self.links, self.terms)
        torques += self.drive_std * rng.normal(size=q.shape)
        return Table(segment.times, q, velocities, None, torques, wrench, source=f"{name}.csv")


def default_values(effect: Effect, robot: Robot) -> dict[str, float]:
    """Parameters of plausible size, see `bayesid.effects.Effect.typical`."""
    return {key: float(value) for key, value in zip(effect.parameters, effect.typical(robot), strict=True)}


def complete_effects(
    robot: Robot,
    effects: Mapping[str, Values | None] | Sequence[str] | str,
    stated: Mapping[str, Values],
    library: EffectLibrary | None = None,
) -> dict[str, dict[str, float]]:
    """Every effect, ``name`` or ``name@where``, at each of its places with all its values.

    Values that are not given are ``stated`` (``[model.values]``), else `default_values`, or zero for the axes of a sensor that
    are left out. An `InputError` where an effect, place or parameter is unknown.
    """
    if isinstance(effects, str):
        effects = [part.strip() for part in effects.split(",") if part.strip()]
    given = effects if isinstance(effects, Mapping) else dict.fromkeys(effects)
    out: dict[str, dict[str, float]] = {}
    for spec, own in given.items():
        for effect in places_of(spec, robot, library or EffectLibrary()):
            own_here = own
            if own is None:
                own_here = stated_of(effect, stated, robot.joint_names)
            values = default_values(effect, robot)
            known = {}
            for key, value in (own_here or {}).items():
                if key == "fixed":
                    continue
                if key not in values:
                    raise InputError(f"effect '{spec}': no parameter '{key}'; it has {', '.join(values)}")
                if not isinstance(value, (int, float, np.number)) or not np.isfinite(value):
                    raise InputError(f"effect '{spec}': {key} = {value!r} is no number")
                known[key] = float(value)
            if effect.zero_unless_stated and known:
                values = dict.fromkeys(values, 0.0)
            out[effect.spec] = values | known
    return out


def places_of(
    spec: str, robot: Robot, library: EffectLibrary, gear_ratio: Mapping[str, float] | None = None
) -> tuple[Effect, ...]:
    """An effect, ``name`` or ``name@where``, at each of its places; gear ratios are by the joint's name."""
    library.named(spec.partition("@")[0], spec, "'{}' cannot be simulated")
    channels = (*WRENCH_NAMES, *(f"tau{i + 1}" for i in range(robot.n)))
    return library.parse([spec], robot.joint_names, channels, gear_ratio)


def at_encoders(robot: Robot, segment: MotionSegment, terms: Sequence[Term]) -> MotionSegment:
    """What the encoders say of true joint motion, before noise: they know nothing of a joint that gives."""
    coupling = coupling_matrix(robot, [(t.effect, t.values) for t in terms if isinstance(t.effect, TransmissionEffect)])
    offset = np.zeros(robot.n)
    for term in terms:
        if isinstance(term.effect, EncoderEffect):
            offset[term.effect.joint] += term.effect.shift(term.values)
    q, v, a = (x @ coupling.T for x in (segment.positions, segment.velocities, segment.accelerations))
    return replace(segment, positions=q + offset, velocities=v, accelerations=a)


def plant_readings(
    robot: Robot, channels: Channels, segment: MotionSegment, links: np.ndarray, terms: Sequence[Term]
) -> np.ndarray:
    """What a plant's channels read (N, c), made piece by piece; an `InputError` where that is not finite."""
    times, size = segment.times, len(segment.times)
    margin = 0.0
    if not segment.still and size > 1:
        margin = reach_of(terms, _BANDWIDTH, float(np.median(np.diff(times))))
    middle = segment.middle_positions
    out = np.empty((size, len(channels)))
    for first in range(0, size, _CHUNK):
        last = min(first + _CHUNK, size)
        a, b = first, last
        if margin:
            a = int(np.searchsorted(times, times[first] - margin))
            b = int(np.searchsorted(times, times[last - 1] + margin, side="right"))
        part = slice(a, b)
        motion = (x[part] for x in (times, segment.positions, segment.velocities, segment.accelerations))
        piece = MotionSegment(*motion, still=segment.still, bandwidth=_BANDWIDTH, middle=middle, in_turn=segment.in_turn)
        with np.errstate(all="ignore"):  # what is not finite is reported below
            out[first:last] = readings(robot, channels, piece, links, terms)[first - a : last - a]
    if not np.isfinite(out).all():
        specs = ", ".join(t.effect.spec for t in terms)
        raise InputError(f"readings are not finite with {specs or 'these links'}; give smaller values, or mend the formula")
    return out
