"""What motions would tell of the parameters, recorded or only planned, before any reading counts.

With the rows ``y = X b + e``, ``cov e = Sigma``, an estimate will have the covariance ``(X' Sigma^-1 X)^-1``, whatever
is read: X follows from the motion alone. Rows are those that a fit would use (`bayesid.regression.rows`), reduced block by
block to the triangular factor R of ``Sigma^(-1/2) X``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bayesid.design.reading_noise import ReadingNoise, SensorSet
from bayesid.diagnosis.projector import orthonormal
from bayesid.dynamics.base_parameters import BaseParameters
from bayesid.estimators.factor import gram_rows, reduce_rows, reduce_whitened
from bayesid.recordings.experiment import Experiment, Motion
from bayesid.regression.blocks import Block
from bayesid.regression.linalg import correlations, determined_inverse, undetermined
from bayesid.regression.problem import fastest_rate, model_structure, row_step, smoother_of
from bayesid.regression.readings import make_channels
from bayesid.regression.row_model import RowModel
from bayesid.regression.rows import make_blocks
from bayesid.regression.segment import Segment
from bayesid.signals.noise import NoiseModel
from bayesid.simulation.trajectories import Trajectory


@dataclass(frozen=True, repr=False, eq=False)
class Expected:
    """What an estimate of base and effect parameters would know."""

    base: BaseParameters  # base parameters of the richest motion: the first ``base.rank`` columns
    #: The remaining columns.
    effect_names: tuple[str, ...]
    effect_units: tuple[str, ...]
    factor: np.ndarray  # R (p, p), upper triangular: ``R'R`` is the information of all columns
    weighted: np.ndarray  # factor of the rows as a fit weights them (p, p): the same for white noise
    row_model: RowModel | None = None  # how samples become rows; None where the rows were given

    def __repr__(self) -> str:
        return f"<Expected: {self.base.rank} base and {len(self.effect_names)} effect parameters>"

    @cached_property
    def hidden(self) -> np.ndarray:
        """Columns that these motions do not determine (p,)."""
        return undetermined(self.factor)

    @cached_property
    def inverse(self) -> np.ndarray:
        """L (p, p) with covariance ``L L'``; zero in hidden columns."""
        return determined_inverse(self.factor, self.hidden)

    @property
    def std(self) -> np.ndarray:
        """Standard deviations (p,); infinite in hidden columns."""
        return np.where(self.hidden, np.inf, np.linalg.norm(self.inverse, axis=1))

    @cached_property
    def base_factor(self) -> np.ndarray:
        """Factor of the base parameters alone, effects projected out (r, r)."""
        rest, q = self.factor[:, : self.base.rank], self.effect_basis()
        for _ in range(2):  # twice is enough for orthogonality to rounding
            rest = rest - q @ (q.T @ rest)
        return np.asarray(np.linalg.qr(rest, mode="r"))

    def effect_basis(self, estimated: np.ndarray | None = None) -> np.ndarray:
        """Orthonormal basis of what effects take of the rows (p, at most e); ``estimated`` (e,): of which, default all."""
        effects = self.factor[:, self.base.rank :]
        there = np.linalg.norm(effects, axis=0) > 1e-13 * np.linalg.norm(self.factor, axis=0).max(initial=0.0)
        return orthonormal(effects[:, there if estimated is None else there & estimated])


def expect(
    experiment: Experiment,
    sensor_set: SensorSet,
    noise: ReadingNoise,
    motions: Sequence[Motion | Trajectory],
    bandwidth: float | None = None,
) -> Expected:
    """What motions would tell if they were read by a sensor set.

    No readings of the experiment are looked at, and its motions need not be those that are asked about. Recorded motions are
    smoothed as for a fit, with ``bandwidth`` [Hz] or one by cross-validation; planned ones have exact states. Static readings
    count where a motion has them, and a static run of the motion's own positions is taken for granted where one is subtracted.
    An `InputError` where there is no sensor that the set needs, or an effect of the model does not exist.
    """
    model, segments = rows_of(experiment, sensor_set, motions, bandwidth=bandwidth)
    factor = weighted = np.zeros((model.base.rank + model.extra_columns,) * 2)
    if segments:
        factor, weighted = expected_factors(lambda: make_blocks(model, segments), noise.of(sensor_set))
    return Expected(model.base, model.effect_names, model.effect_units, factor, weighted, model)


def rows_of(
    experiment: Experiment,
    sensor_set: SensorSet,
    motions: Sequence[Motion | Trajectory],
    *,
    effects: Sequence[str] | None = None,
    bandwidth: float | None = None,
) -> tuple[RowModel, list[Segment]]:
    """How samples would become rows, and the segments that count; as in `expect`, with the experiment's effects or others."""
    channels = make_channels(experiment, sensor_set.channel)
    segments = [s for k, m in enumerate(motions) for s in _segments(m, sensor_set, len(channels), k)]
    moving = [s for s in segments if not s.poses]
    specs = list(experiment.effects if effects is None else effects)
    if sensor_set.offset != "fitted":  # nothing is left of what a static run removes, or of a known offset
        gone = {n for n, c in experiment.library.classes.items() if c.removed_by_static_run}
        specs = [s for s in specs if s.partition("@")[0] not in gone]
    # Poses less their readings at rest leave nothing: such a set of segments still has the structure of a motion.
    still = np.zeros((1, experiment.robot.n))
    nothing = Segment(np.zeros(1), still, np.zeros((1, 0)), np.zeros(0), 0, gravity=False, offset=False)
    structure = model_structure(experiment, channels, specs, segments or [nothing], "effects")
    chosen = smoother_of(experiment, moving, bandwidth).bandwidth
    step = row_step(chosen, fastest_rate(moving))
    model = RowModel(experiment.robot, channels, structure.base, structure.effects, chosen, step, None, structure.point)
    # Segments that are too short for the smoothed trajectory to settle say nothing.
    return model, [s for s in segments if s.poses or np.ptp(s.inner(model.margin)) >= 2]


def _segments(motion: Motion | Trajectory, sensor_set: SensorSet, channels: int, index: int) -> list[Segment]:
    """Segments of a motion that nobody has read yet, and poses at rest that are read beside it."""
    gravity, offset = sensor_set.gravity, sensor_set.offset == "fitted"

    def segment(times: np.ndarray, positions: np.ndarray, poses: bool, **more) -> Segment:
        unread = np.broadcast_to(0.0, (len(times), channels))  # without memory of their own
        return Segment(times, positions, unread, np.zeros(channels), index, gravity, offset, poses, **more)

    if isinstance(motion, Trajectory):
        rates = np.stack([motion.velocities, motion.accelerations])
        moving = [segment(motion.times, motion.positions, motion.kind == "poses", rates=rates)]
        rest = motion.static_positions
    else:
        table, poses = motion.table, motion.kind == "poses"
        whole = segment(table.times, table.positions, poses, period=motion.period)
        moving = [whole] if poses else [whole.part(p.start, p.stop) for p in table.segments()]
        rest = None if motion.static is None else motion.static.positions
    if not gravity:
        return [s for s in moving if not s.poses]  # poses less their readings at rest leave nothing
    if rest is None or sensor_set.channel != "wrench":  # torques are not read at rest, see `prepare`
        return moving
    return [*moving, segment(np.arange(float(len(rest))), rest, True)]


def expected_factors(blocks: Callable[[], Iterable[Block]], noise: Mapping[str, NoiseModel]) -> tuple[np.ndarray, np.ndarray]:
    """Triangular factor R (p, p) of the information that a fit takes from rows, and that of the rows as they are weighted.

    For white noise, independent from channel to channel, ``R'R = X' Sigma^-1 X``. With any other noise rows keep the weights of
    ``wls``, the default method, and ``R'R`` is the inverse of its covariance ``(X'WX)^-1 (X'W Sigma WX) (X'WX)^-1``. ``noise``
    is by group of rows.
    """
    if all(m.order == 0 and np.count_nonzero(m.innovation) == len(m.innovation) for m in noise.values()):
        white = _triangular(reduce_whitened(blocks(), dict(noise)).matrix)
        return white, white
    weight = {group: 1.0 / m.std[:, None] for group, m in noise.items()}
    r = reduce_rows(blocks(), lambda b: b.rows * weight[b.group]).matrix
    middle = gram_rows(blocks(), lambda b: noise[b.group].colour_transposed(b.matrix * weight[b.group] ** 2))
    # With M the middle, R'R M^-1 R'R has the factor M^(-1/2) R'R.
    length, values, vectors = correlations(middle, 1e-13)
    whole = np.zeros_like(r)
    whole[: len(values)] = (vectors / np.sqrt(values) / length[:, None]).T @ r.T @ r
    return _triangular(whole), _triangular(r)


def _triangular(matrix: np.ndarray) -> np.ndarray:
    return np.asarray(np.linalg.qr(matrix, mode="r"))
