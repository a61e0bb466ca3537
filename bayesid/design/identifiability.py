"""What motions show of every link parameter, alone, in a combination with others or not at all, for each sensor set side by side.

The rows ``X = X_b K`` see the parameters through the base parameters' matrix K, and these motions through the part of them that
the rows determine: with the factor R of the rows, effects projected out, the columns of ``R K`` are regrouped once more
(`bayesid.dynamics.base_parameters.regroup`). A parameter is identified alone where it is the only entry of a row of that map.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayesid.design.expected import Expected, expect
from bayesid.design.reading_noise import ReadingNoise, SensorSet
from bayesid.dynamics.base_parameters import BaseParameters, further, regroup, structural_base
from bayesid.dynamics.channels import Channels
from bayesid.effects.surroundings import STILL
from bayesid.posterior.result import PRIOR_DRIVEN
from bayesid.recordings.experiment import Experiment, Motion
from bayesid.regression.linalg import condition_number, determined_inverse, root_of, undetermined
from bayesid.regression.readings import has_readings, make_channels
from bayesid.robot import inertia
from bayesid.robot.prior import Prior, assumed_links, robot_prior, states_masses, with_sizes
from bayesid.robot.robot import Robot
from bayesid.simulation.trajectories import Trajectory

ALONE, COMBINATION, WEAK, EFFECT, UNEXCITED, NEVER = "alone", "combination", "weak", "effect", "not_excited", "never_visible"
#: What a class says of a link parameter.
WORDS = {
    ALONE: "identified alone",
    COMBINATION: "only in a combination",
    WEAK: "seen, but the expected error is larger than the body itself",
    EFFECT: "not told from an effect in the model",
    UNEXCITED: "not excited by this motion",
    NEVER: "never visible to this sensor",
}
#: A letter for each, for tables of many parameters.
LETTERS = {ALONE: "a", COMBINATION: "c", WEAK: "w", EFFECT: "e", UNEXCITED: "–", NEVER: "·"}
#: From what tells most to what tells least, by rank alone.
_ORDER = (ALONE, COMBINATION, EFFECT, UNEXCITED, NEVER)


@dataclass(frozen=True)
class BaseExpectation:
    """A combination that these motions show."""

    #: As of base parameters.
    name: str
    label: str
    unit: str
    std: float  # expected standard deviation
    #: How large it is when every body's mass distribution is uncertain by its own size; None where nothing is known of that.
    size: float | None
    kind: str  # ``alone``, ``combination``, or ``weak`` where the standard deviation exceeds the size
    #: Posterior over prior standard deviation with the nominal model as far as it is trusted; None without such a prior.
    prior_share: float | None = None


@dataclass(frozen=True)
class LinkExpectation:
    """What these motions show of one link parameter."""

    name: str  # of the link parameter
    kind: str  # a key of `WORDS`
    combinations: tuple[int, ...]  # which base parameters of the motions it is in, by number; where it tells most comes first
    #: ``alone``, ``combination`` or ``never_visible`` with the richest motion; None where that is not known.
    of_any_motion: str | None
    joints: tuple[str, ...] = ()  # joints that stood still, each of which would show more of it by moving
    sensor_sets: tuple[str, ...] = ()  # names of other sensor sets that would show more of it with some motion


@dataclass(frozen=True, eq=False)
class Shown:
    """The part of the base parameters that motions determine."""

    base: BaseParameters  # combinations that these motions show
    without_effects: BaseParameters  # the same if no effect were in the model but the sensor's offset
    factor: np.ndarray  # of the information about them, all effects projected out (r, r)
    condition: float  # condition number of the rows, effects that are determined included, with columns of unit length

    @property
    def covariance(self) -> np.ndarray:
        """Expected covariance of the combinations (r, r)."""
        inverse = determined_inverse(self.factor, undetermined(self.factor))
        return inverse @ inverse.T

    @property
    def std(self) -> np.ndarray:
        """Expected standard deviations (r,)."""
        return np.sqrt(np.diag(self.covariance))


def shown(expected: Expected) -> Shown:
    """The combinations that motions determine."""
    whole = expected.base
    # A fitted offset is part of the sensor set, and not of the user's model.
    effects = () if expected.row_model is None else expected.row_model.effects
    offset = [n for e in effects if e.estimated_without_static_run for n in e.column_names]
    own = np.array([n in offset for n in expected.effect_names], bool)
    base = _regrouped(expected, np.ones(len(own), bool))
    full = expected.base_factor @ whole.matrix[:, base.independent]
    beside = expected.weighted[:, whole.rank :][:, ~expected.hidden[whole.rank :]]
    rows = np.hstack([expected.weighted[:, : whole.rank] @ whole.matrix[:, base.independent], beside])
    bare = base if own.all() else _regrouped(expected, own)
    return Shown(base, bare, np.asarray(np.linalg.qr(full, mode="r")), condition_number(rows))


def _regrouped(expected: Expected, estimated: np.ndarray) -> BaseParameters:
    """Combinations that the rows determine beside some effects; those of the richest motion where they determine all of them."""
    base = expected.base
    names = base.parameter_names
    kinds = [n.rpartition(".")[2] for n in names]
    units = [inertia.UNITS[inertia.PARAMETERS.index(k)] if k in inertia.PARAMETERS else "" for k in kinds]
    for k, unit in zip(base.independent.tolist(), base.units, strict=True):
        units[k] = unit
    rows = expected.factor[:, : base.rank] @ base.matrix
    found = regroup(rows, names, units, expected.effect_basis(estimated)) if len(rows) else base
    return base if found.rank == base.rank else found


def kinds_of(base: BaseParameters) -> list[str]:
    """``alone``, ``combination`` or ``never_visible`` for every parameter behind (P,)."""
    entries = base.matrix != 0.0
    lonely = entries.sum(axis=1) == 1
    seen, alone = entries.any(axis=0), entries[lonely].any(axis=0)
    return [ALONE if a else COMBINATION if s else NEVER for a, s in zip(alone, seen, strict=True)]


def base_expectations(found: Shown, size: np.ndarray | None, prior: np.ndarray | None = None) -> tuple[BaseExpectation, ...]:
    """Expected standard deviations of combinations, and what they are worth, by their sizes (r,) and a prior of links (P, P)."""
    base, std = found.base, found.std
    share = None if prior is None else np.divide(*std_with_prior(found.factor, base.matrix @ prior @ base.matrix.T))
    out = []
    for k, row in enumerate(base.matrix):
        weak = size is not None and std[k] > size[k]
        kind = WEAK if weak else ALONE if np.count_nonzero(row) == 1 else COMBINATION
        own = None if size is None else float(size[k])
        driven = None if share is None else float(share[k])
        out.append(BaseExpectation(base.names[k], base.labels[k], base.units[k], float(std[k]), own, kind, driven))
    return tuple(out)


def std_with_prior(rows: np.ndarray, prior: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Standard deviations by information (r, p) and a prior (p, p), and by the prior alone (p,).

    With the prior's covariance ``C = L L'``, R the information's factor and ``G = R L`` the covariance is ``L (1 + G'G)^-1 L'``.
    """
    root = root_of(prior)
    _, s, vt = np.linalg.svd(rows @ root)
    share = np.ones(root.shape[1])
    share[: len(s)] = 1.0 / np.sqrt(1.0 + s**2)
    return np.linalg.norm(root @ vt.T * share, axis=1), np.sqrt(np.diag(prior))


def link_expectations(
    found: Shown, bases: Sequence[BaseExpectation], richest: BaseParameters | None, sizes: np.ndarray | None
) -> list[LinkExpectation]:
    """What motions show of every link parameter.

    ``richest`` are base parameters of the richest motion where it is known, ``sizes`` those of the link parameters (P,), for
    how much each has of a combination; None: by the factors alone.
    """
    kinds, best = kinds_of(found.base), None if richest is None else kinds_of(richest)
    bare = kinds_of(found.without_effects)
    scale = np.ones(len(kinds)) if sizes is None else sizes
    out = []
    for k, name in enumerate(found.base.parameter_names):
        column = np.abs(found.base.matrix[:, k])
        inside = np.flatnonzero(column)
        share = column[inside] * scale[k] / np.maximum(np.abs(found.base.matrix[inside]) @ scale, 1e-300)
        inside = inside[np.argsort(-share, kind="stable")].tolist()
        if kinds[k] == NEVER:
            excited = bare[k] != NEVER
            kind = EFFECT if excited else NEVER if best is not None and best[k] == NEVER else UNEXCITED
        else:
            kind = WEAK if all(bases[i].kind == WEAK for i in inside) else kinds[k]
        out.append(LinkExpectation(name, kind, tuple(inside), None if best is None else best[k]))
    return out


def shows_more(first: str, second: str) -> bool:
    """Whether a class tells more of a parameter than another one."""
    return _ORDER.index(first) < _ORDER.index(second)


def by_body(names: Sequence[str]) -> tuple[list[str], list[str]]:
    """Rows and columns of a table of parameters: bodies and their ten, or one row of all where they are no bodies'."""
    kinds = [n.rpartition(".")[2] for n in names]
    if names and kinds == list(inertia.PARAMETERS) * (len(names) // 10):
        return [n.rpartition(".")[0] for n in names[::10]], list(inertia.PARAMETERS)
    return [""], list(names)


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
    found = shown(expected)
    # Poses alone have base parameters of their own; what another motion would show is that of one that moves.
    channels = make_channels(experiment, sensor_set.channel)
    richest = richest_base(experiment.robot, channels, sensor_set)
    links = assumed_links(experiment.robot).ravel()
    spread = Prior.nominal(with_sizes(links), 2.0**0.5).covariance
    rel_std = experiment.inertia_rel_std
    prior = robot_prior(experiment.robot, rel_std).covariance if rel_std and states_masses(experiment.robot) else None
    used = {"wrench": ("wrench",), "torque": ("torque",), "both": ("wrench", "torque")}[sensor_set.channel]
    sources = {k: noise.sources[k] for k in used}
    std = dict(zip(channels.names, noise.of(sensor_set)["trajectory"].std.tolist(), strict=True))
    report = set_report(sensor_set, expected, found, sources, std, richest, spread, prior)
    return replace(report, recorded=is_recorded(plan, sensor_set))


def set_report(
    sensor_set: SensorSet, expected: Expected, found: Shown, noise: dict[str, str], noise_std: dict[str, float],
    richest: BaseParameters | None = None, spread: np.ndarray | None = None, prior: np.ndarray | None = None,
    sizes: np.ndarray | None = None,
) -> SetReport:  # fmt: skip
    """A report from what is expected, of recorded readings.

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
        sensor_set=sensor_set, recorded=True, noise=noise, noise_std=noise_std, richest=richest,
        condition_number=found.condition, parameters=tuple(links), base_parameters=bases,
        unexcited=() if richest is None else further(richest, found.without_effects), effects=tuple(effects),
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
            best = link.of_any_motion
            # By rank alone: ``weak`` is what it would be with less noise.
            own = link.kind if link.kind != WEAK else ALONE if best == ALONE else COMBINATION
            joints = tuple(j for j, kinds in moved.items() if shows_more(kinds[k], own))
            sets = tuple(n for n, kinds in by_set.items() if best and (kind := kinds[k]) and shows_more(kind, best))
            links.append(replace(link, joints=joints, sensor_sets=sets))
        out.append(replace(report, parameters=tuple(links)))
    return tuple(out)
