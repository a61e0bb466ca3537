"""What motions can and cannot determine, for each sensor set side by side, and what would make the difference."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayesid.design.expected import Expected, expect
from bayesid.design.reading_noise import ReadingNoise, SensorSet
from bayesid.design.visibility import (
    BaseExpectation,
    LinkExpectation,
    Shown,
    base_expectations,
    kinds_of,
    link_expectations,
    of_rank,
    shown,
    shows_more,
)
from bayesid.dynamics.base_parameters import BaseParameters, structural_base, unseen
from bayesid.dynamics.channels import Channels
from bayesid.effects.surroundings import STILL
from bayesid.posterior.result import PRIOR_DRIVEN
from bayesid.recordings.experiment import Experiment, Motion
from bayesid.regression.readings import has_readings, make_channels
from bayesid.robot.prior import Prior
from bayesid.robot.robot import Robot
from bayesid.robot.typical import assumed_links, states_masses
from bayesid.simulation.trajectories import Trajectory


@dataclass(frozen=True)
class EffectExpectation:
    """What motions show of a parameter of an effect in the model."""

    #: Of the effect's parameter.
    name: str
    unit: str
    std: float | None  # expected standard deviation; None where these motions do not determine it beside the links


@dataclass(frozen=True, eq=False)
class SetReport:
    """What motions show to one sensor set."""

    sensor_set: SensorSet  # what is read
    recorded: bool  # whether the motions have these readings; otherwise this is what they would show
    noise: dict[str, str]  # where the noise of the readings comes from, by ``wrench`` and ``torque``
    #: Standard deviation of a row of each channel, by its name; of the difference of two where a static run is subtracted.
    noise_std: dict[str, float]
    richest: BaseParameters | None  # base parameters of the richest motion; None where it is not known
    condition_number: float  # of the rows of what is determined, columns at unit length
    parameters: tuple[LinkExpectation, ...]  # every link parameter
    base_parameters: tuple[BaseExpectation, ...]  # combinations that these motions show
    unexcited: tuple[str, ...]  # labels of combinations that another motion would show, effects aside
    effects: tuple[EffectExpectation, ...]  # in the model
    expected: Expected  # behind all this
    shown: Shown  # the part of it that the motions determine

    def __repr__(self) -> str:
        return f"<SetReport of {self.sensor_set.title}: rank {self.rank} of {self.rank_of_any_motion}>"

    @property
    def rank(self) -> int:
        """How many combinations these motions show."""
        return len(self.base_parameters)

    @property
    def rank_of_any_motion(self) -> int | None:
        """How many combinations the richest motion would show; None where that is not known."""
        return None if self.richest is None else self.richest.rank

    @property
    def well_known(self) -> int:
        """How many of them are expected to be known better than by the size of a body."""
        return sum(b.kind != "weak" for b in self.base_parameters)

    @property
    def prior_driven(self) -> tuple[BaseExpectation, ...]:
        """Combinations that keep most of the prior's standard deviation."""
        return tuple(b for b in self.base_parameters if b.prior_share is not None and b.prior_share > PRIOR_DRIVEN)


@dataclass(frozen=True, eq=False)
class PlannedMotions:
    """Motions that are asked about."""

    experiment: Experiment  # robot, sensor (an imagined one at the base where there is none) and model
    motions: tuple[Motion | Trajectory, ...]  # recorded or planned; joints that stand still do so exactly
    still: np.ndarray  # where joints stand that do not move in any motion (n,); nan for those that do

    @classmethod
    def of(cls, experiment: Experiment, motions: Sequence[Motion | Trajectory]) -> PlannedMotions:
        """Motions with joints that are held by a controller taken for still."""
        positions = np.concatenate([m.positions if isinstance(m, Trajectory) else m.table.positions for m in motions])
        still = np.where(np.ptp(positions, axis=0) <= STILL, np.median(positions, axis=0), np.nan)
        return cls(experiment, tuple(_held(m) for m in motions), still)


def _held(motion: Motion | Trajectory) -> Motion | Trajectory:
    """A motion whose joints that stand still do so exactly: what jitter excites is noise."""
    if isinstance(motion, Trajectory):
        return motion
    positions = motion.table.positions
    still = np.ptp(positions, axis=0) <= STILL
    if not still.any():
        return motion
    quiet = np.where(still, np.median(positions, axis=0), positions)
    return replace(motion, table=replace(motion.table, positions=quiet))


def report_of(plan: PlannedMotions, sensor_set: SensorSet, noise: ReadingNoise, *, bandwidth: float | None = None) -> SetReport:
    """What the motions of a plan show to a sensor set; ``bandwidth`` is that of recorded joint motion [Hz]."""
    experiment = plan.experiment
    expected = expect(experiment, sensor_set, noise, plan.motions, bandwidth=bandwidth)
    offsets = {n for n, c in experiment.library.classes.items() if c.estimated_without_static_run}
    found = shown(expected, [n for n in expected.effect_names if n.partition("@")[0] in offsets])
    # Poses alone have base parameters of their own; what another motion would show is that of one that moves.
    channels = make_channels(experiment, sensor_set.channel)
    richest = richest_base(experiment.robot, channels, sensor_set)
    links = assumed_links(experiment.robot).ravel()
    spread = Prior.nominal(links, 2.0**0.5).covariance
    rel_std = experiment.inertia_rel_std
    prior = Prior.warped(links, rel_std).covariance if rel_std and states_masses(experiment.robot) else None
    report = set_report(sensor_set, expected, found, richest, spread, prior)
    used = {"wrench": ("wrench",), "torque": ("torque",), "both": ("wrench", "torque")}[sensor_set.channel]
    std = noise.of(sensor_set)["trajectory"].std.tolist()
    return replace(
        report, recorded=is_recorded(plan, sensor_set), noise={k: noise.sources[k] for k in used},
        noise_std=dict(zip(channels.names, std, strict=True)),
    )  # fmt: skip


def set_report(
    sensor_set: SensorSet, expected: Expected, found: Shown, richest: BaseParameters | None,
    spread: np.ndarray | None, prior: np.ndarray | None, sizes: np.ndarray | None = None,
) -> SetReport:  # fmt: skip
    """A report from what is expected.

    ``richest`` are the base parameters of the richest motion where it is known; ``spread`` the covariance of link parameters,
    each body uncertain by its own size (P, P), or without it ``sizes`` of the combinations (r,); ``prior`` the prior covariance
    of link parameters (P, P).
    """
    matrix = found.base.matrix
    if spread is not None:
        sizes = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", matrix, spread, matrix), 0.0))
    bases = base_expectations(found, sizes, prior)
    links = link_expectations(found, bases, richest, None if spread is None else np.sqrt(np.diag(spread)))
    rank = expected.base.rank
    effects = [
        EffectExpectation(n, u, float(s) if np.isfinite(s) else None)
        for n, u, s in zip(expected.effect_names, expected.effect_units, expected.std[rank:], strict=True)
    ]
    return SetReport(
        sensor_set=sensor_set, recorded=True, noise={}, noise_std={}, richest=richest,
        condition_number=found.condition, parameters=tuple(links), base_parameters=bases,
        unexcited=() if richest is None else unseen(richest, found.without_effects), effects=tuple(effects),
        expected=expected, shown=found,
    )  # fmt: skip


def richest_base(
    robot: Robot, channels: Channels, sensor_set: SensorSet, *, held: np.ndarray | None = None, at_rest: bool = False
) -> BaseParameters:
    """Base parameters of the richest motion, or of one in which joints are held or the robot only stands."""
    offset = sensor_set.offset == "fitted"
    return structural_base(robot, channels, gravity=sensor_set.gravity, offset=offset, held=held, at_rest=at_rest)


def is_recorded(plan: PlannedMotions, sensor_set: SensorSet) -> bool:
    """Whether the motions have the readings of a sensor set, static runs included."""
    recorded = [m for m in plan.motions if isinstance(m, Motion) and has_readings(m.table, sensor_set.channel)]
    if len(recorded) < len(plan.motions) or sensor_set.offset == "known" and sensor_set.channel != "torque":
        return False
    if sensor_set.offset == "static run":
        return all(m.stop_and_go and m.static is not None and m.static.wrench is not None for m in recorded)
    return True


def with_differences(plan: PlannedMotions, reports: Sequence[SetReport]) -> tuple[SetReport, ...]:
    """Reports in which every link parameter knows the joints and sensor sets that would show more of it."""
    robot, out = plan.experiment.robot, []
    held = np.flatnonzero(np.isfinite(plan.still)).tolist()
    by_set = {r.sensor_set.name: [p.of_any_motion for p in r.parameters] for r in reports}
    for report in reports:
        channels = make_channels(plan.experiment, report.sensor_set.channel)
        moved = {}
        for j in held if report.rank_of_any_motion != report.rank else ():
            still = np.where(np.arange(robot.n) == j, np.nan, plan.still)
            moved[robot.joint_names[j]] = kinds_of(richest_base(robot, channels, report.sensor_set, held=still))
        links = []
        for k, link in enumerate(report.parameters):
            own, best = of_rank(link.kind, link), link.of_any_motion
            joints = tuple(j for j, kinds in moved.items() if shows_more(kinds[k], own))
            sets = tuple(n for n, kinds in by_set.items() if best and (kind := kinds[k]) and shows_more(kind, best))
            links.append(replace(link, joints=joints, sensor_sets=sets))
        out.append(replace(report, parameters=tuple(links)))
    return tuple(out)
