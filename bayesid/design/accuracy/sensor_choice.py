"""What candidate sensors would tell of the user's own motion, before anything is bought.

Rows ``y = X b + e`` of the channels that a sensor reads, weighted by its noise, are reduced to the factor R of the information.
Intervals of link parameters need a prior, as no sensor determines them all: with C0 the covariance of the nominal links,
``(K'R'R K + C0^-1)^-1``. An effect of usual size with the trace z, base and effect parameters projected out, stands out by its
length, so that ``5 / |z|`` of that size is the smallest that would be seen. Load cells under a rigid plate share its wrench w
as ``G^+ w``, G their map to the wrench, which counts what they do not measure as not measured.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pinocchio as pin

from bayesid.design.accuracy.bench import Bench
from bayesid.design.accuracy.sensor_file import CandidateSensor
from bayesid.design.expected import Expected, rows_of
from bayesid.design.sensor_sets import SENSOR_SETS
from bayesid.design.visibility import Shown, shown
from bayesid.diagnosis.settings import DEFAULT
from bayesid.effects import Effect, MotionSegment, Term
from bayesid.errors import InputError
from bayesid.estimators.factor import reduce_rows
from bayesid.recordings.experiment import Experiment, Sensor
from bayesid.recordings.table import usual_step
from bayesid.regression.blocks import Block
from bayesid.regression.parallel import in_order
from bayesid.regression.row_model import RowModel
from bayesid.regression.rows import make_blocks
from bayesid.regression.segment import Segment
from bayesid.robot.prior import Prior
from bayesid.robot.robot import load_robot
from bayesid.robot.typical import states_masses, typical_links
from bayesid.simulation.plant import plant_readings

#: Prior relative standard deviation of nominal links where the experiment does not say.
USUAL_REL_STD = 0.3
#: An effect that is seen only from so many times its usual size is not seen; rounding leaves as much.
_ABSURD = 100.0


@dataclass(frozen=True, eq=False)
class Outlook:
    """What one candidate would tell.

    Attributes
    ----------
    candidate
        The sensor.
    determined
        The combinations of link parameters that it determines, with their expected standard deviations.
    names
        Of the link parameters (P,).
    link_std, prior_std
        Their standard deviations with these readings and without, both with the nominal links as far as they are trusted (P,).
    effects
        By ``name@where`` the smallest share of an effect of usual size that would be seen; None: no plausible size is.
    peak
        Largest magnitude of every reading in these motions, weight included (m,).
    """

    candidate: CandidateSensor
    determined: Shown
    names: tuple[str, ...]
    link_std: np.ndarray
    prior_std: np.ndarray
    effects: dict[str, float | None]
    peak: np.ndarray

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
        """By body: root mean square, over its ten parameters, of the share of prior uncertainty that is left."""
        share = (self.link_std / self.prior_std) ** 2
        bodies = [n.rpartition(".")[0] for n in self.names]
        return {b: float(np.sqrt(np.mean([s for s, own in zip(share, bodies, strict=True) if own == b]))) for b in bodies}


@dataclass(frozen=True)
class SensorChoice:
    """Candidates side by side.

    Attributes
    ----------
    outlooks
        One a candidate, in the order of the file.
    rel_std
        Relative standard deviation of the nominal links that intervals count with.
    assumed
        Whether the experiment did not state it.
    """

    outlooks: tuple[Outlook, ...]
    rel_std: float
    assumed: bool


def choose_sensor(
    bench: Bench, candidates: Sequence[CandidateSensor], tell: Callable[[str], object] = lambda _: None
) -> SensorChoice:
    """What each candidate would tell of the fitted motions.

    Parameters
    ----------
    bench
        The user's own experiment.
    candidates
        The sensors.
    tell
        Called with what is going on.

    Raises
    ------
    InputError
        A wrist sensor's joint does not exist.
    """
    stated = bench.experiment.inertia_rel_std
    rel_std = stated or USUAL_REL_STD
    outlooks = []
    for candidate in candidates:
        tell(f"sensor {candidate.name}")
        outlooks.append(_outlook(bench, candidate, rel_std))
    return SensorChoice(tuple(outlooks), rel_std, not stated)


def _equipped(bench: Bench, candidate: CandidateSensor) -> tuple[Experiment, np.ndarray]:
    """The experiment with the candidate in place, and its true links (b, 10)."""
    own, robot = bench.experiment, bench.experiment.robot
    if candidate.kind == "torque":
        return own, bench.links
    rpy = pin.rpy.matrixToRpy(candidate.rotation)
    if candidate.joint is not None or robot.sensor_parent >= 0 or len(robot.body_names) != robot.n:
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
    weigh = _weighting(bench, candidate, len(model.channels))
    factor = reduce_rows(make_blocks(model, segments), lambda b: _combined(weigh, b)[:, :, :-1]).r
    names = tuple(n for e in model.effects for n in e.column_names)
    units = tuple(u for e in model.effects for u in e.units)
    free = np.flatnonzero(model.free).tolist()
    expected = Expected(
        model.base, tuple(names[k] for k in free), tuple(units[k] for k in free), factor, factor, model, tuple(segments)
    )  # fmt: skip
    determined = shown(expected, [n for e in model.effects if e.estimated_without_static_run for n in e.column_names])
    nominal = experiment.robot.nominal if states_masses(experiment.robot) else typical_links(experiment.robot)
    link_std, prior_std = _with_prior(determined, Prior.nominal(nominal, rel_std).covariance)
    terms = tuple(t for t in bench.terms if any(t.effect.acts_on(c) for c in model.channels.names))
    motions = [(s, _motion(model, s, bench)) for s in segments]
    plain = [plant_readings(experiment.robot, model.channels, states, links, terms) for _, states in motions]
    peak = np.max([np.abs(r @ candidate_map(candidate, r.shape[1]).T).max(axis=0) for r in plain], axis=0)
    if model.point is not None:  # columns are those of this very plant
        links, terms = model.point.links, model.point.terms(model.effects)
    return Outlook(
        candidate, determined, model.base.parameter_names, link_std, prior_std,
        _effects(experiment, model, motions, links, terms, weigh), peak,
    )  # fmt: skip


def candidate_map(candidate: CandidateSensor, channels: int) -> np.ndarray:
    """From the channels of its kind to the candidate's readings (m, c)."""
    return np.eye(channels)[list(candidate.drives)] if candidate.kind == "torque" else candidate.reading_map


def _weighting(bench: Bench, candidate: CandidateSensor, channels: int) -> np.ndarray:
    """From the channels to white readings of unit variance at the recording's rate (m, c)."""
    rate = 1.0 / min(usual_step(m.motion.table.times) for m in bench.motions if m.pieces)
    # Faster samples are averaged over the time of one sample of the recording.
    averaged = np.sqrt(rate / candidate.rate) if candidate.rate else 1.0
    return candidate_map(candidate, channels) / (averaged * candidate.std[:, None])


def _combined(weigh: np.ndarray, block: Block) -> np.ndarray:
    """Rows of a block as a sensor reads them (k, m, p + 1)."""
    return np.einsum("mc,kcp->kmp", weigh, block.rows)


def _motion(model: RowModel, segment: Segment, bench: Bench) -> MotionSegment:
    state = model.state(segment, 0, len(segment.times))
    return replace(state, still=segment.poses, bandwidth=model.bandwidth, middle=bench.middle)


def _with_prior(found: Shown, prior: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Standard deviations of the link parameters after and before (P,).

    With ``C0 = L L'`` and ``G = R K L`` the covariance is ``L (1 + G'G)^-1 L'``.
    """
    size = np.sqrt(np.diag(prior))
    values, vectors = np.linalg.eigh(prior / np.outer(size, size))
    root = size[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
    if not found.base.rank:
        return size, size
    _, s, vt = np.linalg.svd(found.factor @ found.base.matrix @ root)
    share = np.ones(len(size))
    share[: len(s)] = 1.0 / np.sqrt(1.0 + s**2)
    return np.linalg.norm(root @ vt.T * share, axis=1), size


def _effects(
    experiment: Experiment, model: RowModel, motions: Sequence[tuple[Segment, MotionSegment]], links: np.ndarray,
    terms: tuple[Term, ...], weigh: np.ndarray,
) -> dict[str, float | None]:  # fmt: skip
    """Smallest share of each effect of usual size that would stand out by five standard deviations."""
    robot, known = experiment.robot, {e.spec for e in model.effects}
    absent = [
        effect
        for name in experiment.library.classes
        for effect in experiment.library.places(name, robot.joint_names, model.channels.names, experiment.gear_ratio)
        if effect.spec not in known
    ]

    def length(effect: Effect) -> float:
        term = Term(effect, tuple(effect.typical(robot)))
        try:
            with np.errstate(all="ignore"):
                made = [plant_readings(robot, model.channels, states, links, (*terms, term)) for _, states in motions]
        except InputError:
            return 0.0
        read = [replace(s, readings=r) for (s, _), r in zip(motions, made, strict=True)]
        # The columns explain the plant itself: what they leave is the effect's.
        return float(abs(reduce_rows(make_blocks(model, read), lambda b: _combined(weigh, b)).r[-1, -1]))

    lengths = zip(absent, in_order(length, absent), strict=True)
    return {e.spec: DEFAULT.detected / size if size > DEFAULT.detected / _ABSURD else None for e, size in lengths}
