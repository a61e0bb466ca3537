"""How an experiment and a few choices become the regression that estimators take."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TypeVar

import numpy as np

from bayesid.arguments import argument
from bayesid.dynamics.base_parameters import BaseParameters, structural_base
from bayesid.dynamics.channels import Channels
from bayesid.effects import Effect, EffectLibrary, Point, middle_of, starting_point, stated_of, with_places
from bayesid.errors import InputError
from bayesid.recordings.experiment import Experiment, Motion, motions_named
from bayesid.regression.bandwidth import LOWEST, BandwidthChoice, choose_bandwidth
from bayesid.regression.blocks import Block
from bayesid.regression.encoder_noise import errors_of
from bayesid.regression.options import FitOptions
from bayesid.regression.parallel import in_order
from bayesid.regression.readings import (
    default_channel,
    has_readings,
    long_segments,
    make_channels,
    motion_segments,
    require_readings,
)
from bayesid.regression.regression import PriorKnowledge, Regression
from bayesid.regression.row_cache import PILOT_ROWS, PILOT_SEGMENTS, MotionRows, RowCache, row_count, row_parts
from bayesid.regression.row_model import RowModel
from bayesid.regression.rows import make_blocks
from bayesid.regression.segment import LongSegment, Segment
from bayesid.robot.prior import assumed_links, guessed_bodies
from bayesid.signals.filters import row_noise_poles
from bayesid.signals.projection import ROLL_OFF
from bayesid.signals.smoothing import Smoother, choose_smoother

_S = TypeVar("_S", Segment, LongSegment, Segment | LongSegment)

#: Rows a second, as a multiple of the bandwidth of the joint motion: kernels pass ``(1 + ROLL_OFF) / (2 step)`` and no more.
#: Above that bandwidth smoothed positions lack motion that readings hold, where joints with friction reverse above all.
ROWS_PER_BANDWIDTH = 2.0 / (1.0 + ROLL_OFF)
#: At least this many rows a second, so that the noise can be told from the motion.
LOWEST_ROW_RATE = 20.0
#: Bandwidth of a motion that makes something ring, at least [Hz], as in a diagnosis.
_RINGING = 12.0
#: Share of the band clear of encoder noise to which a load that is differentiated again, or rings, is smoothed.
_CLEAR_SHARE = 0.7
#: Samples that the bandwidth is chosen from, in pieces spread over a long recording: by positions, by predictions.
_PILOT_SAMPLES, _JUDGED_SAMPLES = 5_000, 12_000
_PIECES = 4
#: Length of a piece times the lowest bandwidth it is smoothed at, at least: without its ends, a dozen rows remain to judge by.
_SHORTEST_PIECE = 4.5


@dataclass(frozen=True, eq=False)
class Structure:
    """Effects and base parameters of a model."""

    specs: tuple[str, ...]  # the effects as they were named, ``name`` or ``name@where``; those nobody needs to name first
    effects: tuple[Effect, ...]  # those that act on the channels, at their places
    base: BaseParameters  # base parameters of the richest motion of this kind
    unseen: tuple[str, ...]  # those of ``specs`` that show in none of the channels
    point: Point | None  # where readings are linearised; None where effects are plain columns beside the rigid ones


def model_structure(
    experiment: Experiment, channels: Channels, specs: Sequence[str], segments: Sequence[Segment], source: str
) -> Structure:
    """What the model of some segments consists of, with effects that the user names.

    Segments tell whether gravity and constant offsets are in the readings, and whether anything moves; ``source`` says where
    the names come from, for messages. An `InputError` where an effect or a place of it does not exist.
    """
    offset = any(s.offset for s in segments)
    if offset:
        specs = [*_unstated(experiment.library, channels, specs), *specs]
    library, joints = experiment.library, experiment.robot.joint_names
    try:
        effects = library.parse(specs, joints, channels.names, experiment.gear_ratio)
    except InputError as error:
        raise type(error)(f"{source}: {error}") from None
    base = structural_base(
        experiment.robot,
        channels,
        gravity=any(s.gravity for s in segments),
        offset=offset and any(e.absorbs_weight and not _held(experiment, e) for e in effects),
        at_rest=all(s.poses for s in segments),
    )
    unseen = tuple(spec for spec in specs if not library.parse([spec], joints, channels.names, experiment.gear_ratio))
    return Structure(tuple(specs), effects, base, unseen, _point(experiment, base, effects, segments))


def _held(experiment: Experiment, effect: Effect) -> bool:
    """Whether an effect is kept as it is stated: where that is a sensor's offset, weight that looks like one is told from it."""
    return bool(stated_of(effect, experiment.effect_values, experiment.robot.joint_names).get("fixed", False))


def _unstated(library: EffectLibrary, channels: Channels, specs: Sequence[str]) -> list[str]:
    """Effects that every model of readings has from which no static run is subtracted, where the user names them or not."""
    stated = {spec.partition("@")[0] for spec in specs}
    classes = [c for c in library.classes.values() if c.estimated_without_static_run and c.name not in stated]
    return [c.name for c in classes if any(c.acts_on(name) for name in channels.names)]


def absorbed_offset(base: BaseParameters, links: np.ndarray) -> np.ndarray:
    """What of a sensor's estimated offset is weight (6,)."""
    return np.zeros(6) if base.absorbed is None else base.absorbed[:6] @ np.ravel(links)


def _point(experiment: Experiment, base: BaseParameters, effects: tuple[Effect, ...], fitted: Sequence[Segment]) -> Point | None:
    """Where to start from, for effects that are more than columns beside the rigid ones."""
    try:
        values, free = starting_point(effects, experiment.effect_values, experiment.robot.joint_names)
    except InputError as error:
        raise InputError(f"experiment.toml: {error}") from None
    if all(e.from_motion_alone for e in effects) and free.all():
        return None
    links = experiment.robot.nominal
    absorbed = absorbed_offset(base, links)
    for effect, places in with_places(effects):
        if effect.absorbs_weight:
            values[places] += absorbed
    middle = next((middle_of(s.positions) for s in fitted if not s.poses), None)  # of the first motion
    return Point(links, base.matrix @ links.ravel(), values, free, absorbed, middle)


@dataclass(frozen=True, repr=False)
class Problem:
    """An experiment made ready for estimation."""

    experiment: Experiment  # where it comes from
    channel: str  # ``wrench``, ``torque`` or ``both``
    smoother: Smoother  # the bandwidth of the joint motion and why
    bandwidths: BandwidthChoice | None  # the bandwidths that were tried; None where there was nothing to choose
    regression: Regression  # rows of the motions that are fitted
    #: Gap-free segments of every motion, by name; of one that is read in chunks, those of its excerpt.
    segments: dict[str, list[Segment]]
    rows: MotionRows  # the rows of every motion, whether it is read in chunks or not
    fitted: tuple[str, ...]  # names of the motions that are fitted
    static: str  # ``motion`` where a static run has been subtracted, ``joint`` where static readings are fitted along, ``none``
    subtracts: bool  # whether static runs are subtracted where motions have them
    #: The model's effects as they were named, ``name`` or ``name@where``; those nobody needs to name first.
    effects: tuple[str, ...] = ()
    #: Effects of `FitOptions.effects` that show in none of these readings, and so are not in the model.
    unseen: tuple[str, ...] = ()

    @property
    def row_model(self) -> RowModel:
        """How samples become rows."""
        return self.rows.row_model

    @property
    def fitted_segments(self) -> list[Segment]:
        """Segments of the motions that are fitted."""
        return [segment for name in self.fitted for segment in self.segments[name]]

    @property
    def options(self) -> FitOptions:
        """What makes a problem like it, at the bandwidth that was chosen."""
        static, bandwidth = "motion" if self.subtracts else "joint", self.smoother.bandwidth
        return FitOptions(self.channel, self.row_model.filters, self.fitted, self.effects, static, bandwidth)

    @property
    def at_rest(self) -> bool:
        """Whether poses at rest are all that is fitted."""
        return all(segment.poses for segment in self.fitted_segments)

    @property
    def judges(self) -> list[Motion]:
        """Motions that a fit is judged by: those of role ``validation`` with these readings that are not fitted."""
        others = [m for m in self.experiment.motions if m.name in self.segments and m.name not in self.fitted]
        return [motion for motion in others if motion.role == "validation"]


def prepare(experiment: Experiment, options: FitOptions | None = None) -> Problem:
    """Make an experiment ready: choose motions, smooth trajectories, find base parameters, lay out rows.

    Options are by default the experiment's own. An `InputError` where a motion, channel, effect or column is missing.
    """
    options = options or FitOptions()
    channel = options.channel or default_channel(experiment)
    channels = make_channels(experiment, channel)
    chosen = _choose(experiment, options.motions)
    for motion in chosen:
        require_readings(motion, channel)
    subtract = channel == "wrench" and options.static == "motion"
    specs = experiment.effects if options.effects is None else options.effects
    # Validation motions are read, too: the same rows are made from them later.
    readable = [m for m in experiment.motions if m in chosen or has_readings(m.table, channel)]
    if subtract and all(_run_takes_all(m) for m in chosen):  # gravity and the sensor's offset: other motions must lack them, too
        readable = [m for m in readable if _run_takes_all(m)]
    segments = {m.name: motion_segments(experiment, channels, m, k, channel, subtract) for k, m in enumerate(readable)}
    fitted = [r for m in chosen for r in segments[m.name]]
    where = "experiment.toml: [model] effects" if options.effects is None else argument("effects")
    structure = model_structure(experiment, channels, specs, fitted, where)
    base = structure.base
    # What is fitted of a recording that is read in chunks stays in its file; its excerpt stands for it everywhere else.
    sources: dict[str, list[Segment | LongSegment]] = {name: [*own] for name, own in segments.items()}
    for k, m in enumerate(readable):
        if m.stored is not None and m in chosen:
            at_rest = [s for s in segments[m.name] if s.poses]
            sources[m.name] = [*long_segments(experiment, channels, m, k, channel), *at_rest]
    segments, sources = _settling(segments, structure.effects), _settling(sources, structure.effects)
    fitted = [r for m in chosen for r in sources[m.name]]
    if not base.rank:
        raise InputError(
            f"{', '.join(m.table.source for m in chosen)}: these readings show no parameter of the robot; at rest its static "
            'readings take all away: remove [[motion]] static, or write kind = "trajectory"'
        )
    smoother = smoother_of(experiment, moving := _moving(sources), options.bandwidth)
    fastest = fastest_rate(moving)
    row_model = RowModel(
        experiment.robot, channels, base, structure.effects, smoother.bandwidth, row_step(smoother.bandwidth, fastest),
        options.low_pass, structure.point,
    )  # fmt: skip
    choice = None
    if row_model.rings and np.isfinite(fastest):
        if options.bandwidth is None:
            smoother = _ringing(smoother, fastest)
        clear = _CLEAR_SHARE * min(smoother.automatic, smoother.bandwidth)
        row_model = replace(_at_bandwidth(row_model, smoother.bandwidth, fastest), clear=clear)
    elif options.bandwidth is None and any(not r.poses for r in fitted):
        choice, smoother, row_model = _judged(row_model, fitted, smoother, fastest)
    for motion in readable:
        _require_length(motion, sources[motion.name], row_model)
    names = tuple(m.name for m in chosen)
    rows = MotionRows(row_model, sources, names)
    return Problem(
        experiment=experiment,
        channel=channel,
        smoother=smoother,
        bandwidths=choice,
        regression=_regression(rows, smoother, names, tuple(sources), experiment.inertia_rel_std),
        segments=segments,
        rows=rows,
        fitted=names,
        static=_static(chosen, fitted, channel),
        subtracts=subtract,
        effects=structure.specs,
        unseen=() if options.effects is None else structure.unseen,
    )


def _run_takes_all(motion: Motion) -> bool:
    """Whether a motion repeats its static run row by row, which takes gravity and the sensor's offset away."""
    return motion.stop_and_go and motion.static is not None and motion.static.wrench is not None


def _static(motions: Sequence[Motion], segments: Sequence[Segment | LongSegment], channel: str) -> str:
    """What has become of the static readings of motions: those that do not repeat a motion row by row are fitted along."""
    if any(not s.gravity for s in segments):
        return "motion"
    along = channel == "wrench" and any(m.static is not None and m.static.wrench is not None for m in motions)
    return "joint" if along else "none"


def row_step(bandwidth: float, fastest: float = np.inf) -> float:
    """Distance of rows [s] for a bandwidth of the joint motion [Hz], at most so many rows a second as samples."""
    return 1.0 / min(max(ROWS_PER_BANDWIDTH * bandwidth, LOWEST_ROW_RATE), fastest)


def _settling(segments: Mapping[str, list[_S]], effects: Sequence[Effect]) -> dict[str, list[_S]]:
    """The segments with the time that effects need to settle where these start in motion."""
    longest = max((effect.settling for effect in effects), default=0.0)
    return {name: [replace(r, settling=longest) for r in own] for name, own in segments.items()}


def _moving(segments: Mapping[str, Sequence[_S]]) -> list[_S]:
    return [r for rs in segments.values() for r in rs if not r.poses]


def fastest_rate(moving: Sequence[Segment | LongSegment]) -> float:
    """Samples a second of the slowest recording [Hz]; infinite without any."""
    return min((1.0 / r.step for r in moving), default=np.inf)


def _ringing(smoother: Smoother, fastest: float) -> Smoother:
    """The smoother of motions that make something ring: tails of the motion, that encoder noise hides, are seen in the ringing.

    Rows are weighted by the noise that the model makes of the encoders' errors (`bayesid.estimators.weights`), so that no
    bandwidth has to be low enough for them.
    """
    bandwidth = max(smoother.bandwidth, min(_RINGING, 0.2 * fastest))
    reason = "of a motion that makes something ring; encoder noise is weighed by frequency, not cut off"
    return smoother if bandwidth <= smoother.bandwidth else replace(smoother, bandwidth=float(bandwidth), reason=reason)


def _at_bandwidth(row_model: RowModel, bandwidth: float, fastest: float) -> RowModel:
    return replace(row_model, bandwidth=bandwidth, step=row_step(bandwidth, fastest))


def _judged(
    row_model: RowModel, fitted: Sequence[Segment | LongSegment], smoother: Smoother, fastest: float
) -> tuple[BandwidthChoice | None, Smoother, RowModel]:
    """What bandwidths from that of the positions downwards do to predictions of the model where it is linearised.

    With it, smoother and rows at the bandwidth that predicts best.
    """
    judges, plain = _judges(fitted, smoother.bandwidth), replace(row_model, filters=None)

    def rows(bandwidth: float) -> tuple[Block, ...]:
        return tuple(make_blocks(_at_bandwidth(plain, bandwidth, fastest), judges))

    choice = choose_bandwidth(rows, smoother.bandwidth, smoother.at_end)
    if choice is not None and choice.chosen == 0:
        smoother = replace(smoother, reason=f"{smoother.reason}; lower ones predict no better")
    elif choice is not None:
        reason = (
            f"of those from {choice.bandwidths[-1]:.2g} Hz up to the {choice.bandwidths[0]:.3g} Hz of the positions' own "
            "cross-validation, chosen by how well parts left out are predicted"
        )
        smoother = replace(smoother, bandwidth=float(choice.bandwidths[choice.chosen]), reason=reason)
    return choice, smoother, _at_bandwidth(row_model, smoother.bandwidth, fastest)


def chosen_again(problem: Problem) -> Problem:
    """The problem at the bandwidth that predicts best with the model where it is linearised now.

    The first choice is made where the effects start; what these leave unexplained there looks like motion that should be left
    out. A bandwidth that was given stays. An `InputError` where nothing is left of a motion where its trajectory has settled.
    """
    if problem.bandwidths is None:
        return problem
    sources = problem.rows.segments
    smoother = smoother_of(problem.experiment, moving := _moving(sources))
    fitted = [segment for name in problem.fitted for segment in sources[name]]
    choice, smoother, row_model = _judged(problem.row_model, fitted, smoother, fastest_rate(moving))
    for motion in problem.experiment.motions:
        _require_length(motion, sources.get(motion.name, []), row_model)
    return _remade(replace(problem, smoother=smoother, bandwidths=choice), row_model)


def restrict(problem: Problem, motions: Sequence[str], rows: MotionRows | None = None) -> Problem:
    """The same model fitted to other motions; ``rows`` are theirs, by default those that there are."""
    rows = problem.rows if rows is None else rows
    names, rel_std = problem.regression.motion_names, problem.experiment.inertia_rel_std
    regression = _regression(rows, problem.smoother, motions, names, rel_std)
    return replace(problem, regression=regression, rows=rows, fitted=tuple(motions))


def elsewhere(problem: Problem, other: Experiment) -> Problem:
    """The same model, fitted as it was, with the motions of another experiment of the same robot to be predicted.

    Robot and pose of the sensor stay. An `InputError` where joints differ, or no motion has the readings or is long enough.
    """
    own, row_model, recorded = problem.experiment.robot.joint_names, problem.row_model, problem.experiment
    if other.robot.joint_names != own:
        raise InputError(
            f"experiment {other.name} moves {', '.join(other.robot.joint_names)} and the estimate is of {', '.join(own)}: "
            "give recordings of the same joints"
        )
    needed = () if problem.channel == "wrench" else recorded.torque_joints
    readable = [m for m in other.motions if has_readings(m.table, problem.channel) and {*needed} <= {*m.table.torque_joints}]
    if not readable:
        raise InputError(f"experiment {other.name}: no motion has the readings that were fitted ({problem.channel})")
    channels, subtract = row_model.channels, problem.subtracts
    known = any(s.gravity for name in problem.fitted for s in problem.segments[name])  # gravity and the sensor's offset
    segments = {m.name: motion_segments(recorded, channels, m, k, problem.channel, subtract) for k, m in enumerate(readable)}
    segments = _settling(segments, row_model.effects)
    for motion in readable:
        if problem.static == "motion" and not known and any(s.gravity for s in segments[motion.name]):
            raise InputError(
                f"experiment {other.name}: motion '{motion.name}' has no static run, and the estimate knows neither gravity nor "
                f"the sensor's offset, which one took away; give it a run, or fit with {argument('static', 'joint')}"
            )
        _require_length(motion, segments[motion.name], row_model)
    return replace(problem, experiment=other, segments=segments, rows=MotionRows(row_model, segments))


def relinearised(problem: Problem, point: Point) -> Problem:
    """The same problem with its readings linearised at another point."""
    return _remade(problem, replace(problem.row_model, point=point))


def _remade(problem: Problem, row_model: RowModel) -> Problem:
    """The same problem with rows made otherwise."""
    return restrict(problem, problem.fitted, MotionRows(row_model, problem.rows.segments, problem.fitted))


def weight_columns(row_model: RowModel) -> list[int]:
    """Which of the estimated effect parameters hold, beside their own, weight that looks like them."""
    return np.flatnonzero(row_model.of_free(e.absorbs_weight for e in row_model.effects for _ in e.parameters)).tolist()


def _regression(
    rows: MotionRows, smoother: Smoother, motions: Sequence[str], names: tuple[str, ...], inertia_rel_std: float | None
) -> Regression:
    row_model, fitted = rows.row_model, [segment for name in motions for segment in rows.segments[name]]
    robot = row_model.robot
    law, instruments = errors_of(row_model, fitted, smoother)
    return Regression(
        base=row_model.base,
        effect_names=row_model.effect_names,
        effect_units=row_model.effect_units,
        channel_names=row_model.channels.names,
        channel_units=row_model.channels.units,
        motion_names=names,
        rows=RowCache(
            blocks=partial(rows.blocks, tuple(motions)),
            count=row_count(row_model, fitted),
            width=len(row_model.channels) * row_model.width,
            make_pilot=partial(_pilot, row_model, fitted),
            known_poles=_known_poles(row_model, fitted),
            parts=row_parts(row_model, fitted),
        ),
        knowledge=PriorKnowledge(
            nominal_links=robot.nominal.ravel(),
            assumed_links=assumed_links(robot).ravel(),
            guessed=tuple(guessed_bodies(robot).tolist()),
            inertia_rel_std=inertia_rel_std,
            bodies=tuple(tuple(range(10 * k, 10 * k + 10)) for k in range(len(robot.body_names))),
            effect_non_negative=row_model.of_free(sign for e in row_model.effects for sign in e.non_negative),
        ),
        regressor_noise=law,
        instruments=instruments,
    )


def _known_poles(row_model: RowModel, fitted: Sequence[Segment | LongSegment]) -> np.ndarray | None:
    """Poles of the noise of rows that went through low-passes; None without."""
    steps = [r.step for r in fitted if not r.poses]
    if row_model.filters is None or not steps:
        return None
    return row_noise_poles(row_model.filters, float(np.median(steps)), row_model.step)


def _pilot(row_model: RowModel, fitted: Sequence[Segment | LongSegment]) -> Iterator[Block]:
    """Rows of short pieces of long segments, evenly spread, about `PILOT_ROWS` together."""
    return make_blocks(row_model, list(pilot_pieces(row_model, fitted)))


def pilot_pieces(row_model: RowModel, segments: Sequence[Segment | LongSegment]) -> Iterator[Segment]:
    """Short pieces of segments, evenly spread, with about `PILOT_ROWS` rows together."""
    rows = PILOT_ROWS / PILOT_SEGMENTS * row_model.step
    whole = sum(r.ends[1] - r.ends[0] for r in segments if not r.poses)
    for r in segments:
        begin, end = r.ends
        duration, length = end - begin, rows + row_model.margin + max(row_model.margin, r.settling)
        count = 1 if r.poses else round(PILOT_SEGMENTS * duration / whole)
        starts = begin + max(duration - length, 0.0) * np.linspace(0.0, 1.0, max(count, 1))
        for start in starts:
            a = r.index(start)
            b = a + PILOT_ROWS if r.poses else r.index(start + length, "right")
            yield r.part(a, b)


def _choose(experiment: Experiment, motions: Sequence[str] | None) -> list[Motion]:
    if motions is None:
        return list(experiment.identification)
    chosen = motions_named(experiment.motions, motions)
    for name in motions:
        if list(motions).count(name) > 1:
            raise InputError(f"{argument('motions', name)}: is named twice, which would count its readings twice; name it once")
    return chosen


def _require_length(motion: Motion, segments: Sequence[Segment | LongSegment], row_model: RowModel) -> None:
    """Check that something of a motion is left where its trajectory has settled."""
    moving = [s for s in segments if not s.poses]
    if moving and not any(np.ptp(s.inner(row_model.margin)) >= 2 for s in moving):
        longest = max(s.ends[1] - s.ends[0] for s in moving)
        lost = max(s.lost(row_model.margin) for s in moving)
        raise InputError(
            f"no segment without a gap is longer than {longest:.3g} s, and up to {lost:.3g} s at both ends are lost where the "
            f"trajectory is loose (bandwidth {row_model.bandwidth:.3g} Hz) or something rings",
            file=motion.table.source, value=longest, remedy=f"record longer, or remove motion '{motion.name}'",
        )  # fmt: skip


def _judges(fitted: Sequence[Segment | LongSegment], bandwidth: float) -> list[Segment]:
    """Segments, or evenly spread pieces of long ones, that bandwidths up to this one are judged on."""
    moving, out = [r for r in fitted if not r.poses], [r for r in fitted if isinstance(r, Segment) and r.poses]
    total = sum(r.count for r in moving)
    for r in moving:
        share = min(_JUDGED_SAMPLES / total, 1.0)
        pieces = max(round(2 * _PIECES * r.count / total), 1) if share < 1.0 else 1
        shortest = _SHORTEST_PIECE / min(bandwidth, LOWEST) / r.step
        length = min(max(int(share * r.count / pieces), int(shortest)), r.count)
        pieces = min(pieces, r.count // length)
        out += [r.part(a, a + length) for a in np.linspace(0, r.count - length, pieces).astype(int).tolist()]
    return out


def smoother_of(experiment: Experiment, segments: Sequence[Segment | LongSegment], bandwidth: float | None = None) -> Smoother:
    """How the positions of moving segments are smoothed: at the bandwidth given [Hz], else by cross-validation."""
    if bandwidth is not None and not (np.isfinite(bandwidth) and bandwidth > 0):
        raise InputError(f"{argument('bandwidth', bandwidth)}: give a positive frequency in Hz")
    pieces = []
    for r in segments:
        starts, length = [0], r.count
        if length > _PILOT_SAMPLES:
            length = _PILOT_SAMPLES // _PIECES
            starts = np.linspace(0, r.count - length, _PIECES).astype(int).tolist()
        parts = [r.part(a, a + length) for a in starts if length >= 20]
        pieces += [(part.times, part.positions) for part in parts]
    if not pieces:
        return Smoother(bandwidth or 1.0, np.zeros(experiment.robot.n), "only poses at rest: nothing to smooth")
    chosen = choose_smoother(pieces, experiment.position_resolution, experiment.position_std, each=in_order)
    if bandwidth is not None:
        chosen = replace(chosen, bandwidth=bandwidth, reason="as given")
    return chosen
