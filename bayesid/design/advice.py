"""Which motion or sensor would make the difference, in words that say what to do."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayesid.arguments import call
from bayesid.design.identifiability import WEAK, PlannedMotions, SetReport, report_of, richest_base
from bayesid.design.reading_noise import ReadingNoise
from bayesid.dynamics.base_parameters import BaseParameters, further
from bayesid.recordings.experiment import Motion
from bayesid.recordings.table import GAP
from bayesid.regression.readings import make_channels
from bayesid.simulation.trajectories import Trajectory, fourier_trajectory

#: The motion for comparison: random, within this share of the limits, made with so many samples a second, no longer than so many
#: seconds.
_SHARE, _RATE, _LONGEST = 0.8, 100.0, 60.0
#: Standard deviations that differ by less than this factor count as alike.
_ALIKE = 1.3
#: Beyond this factor a fit leaves more than the data sheet's noise.
_LACKING = 2.0
_NAMED, _LONG = 3, 40


@dataclass(frozen=True)
class Advice:
    """One thing that would make a difference, or a reason why none would."""

    about: str  # ``motion``, ``joint``, ``sensor``, ``effect``, ``noise`` or ``prior``
    text: str  # what to do, or what need not be done
    gain: int = 0  # how many more combinations would be shown, or better known


def advise(
    plan: PlannedMotions, reports: Sequence[SetReport], main: SetReport, noise: ReadingNoise, sheet: ReadingNoise | None = None
) -> tuple[Advice, ...]:
    """What would make a difference for the readings that an estimate would use, most important first.

    ``main`` is the report of these readings among those of every sensor set; ``sheet`` is the noise as the sensor's data sheet
    has it, where ``noise`` is what a fit leaves of recorded readings.
    """
    of_noise = [] if sheet is None else _noise(plan, main, sheet)
    parts = (
        _motion(plan, main), _effects(reports, main), _sensors(reports, main), _sizes(plan, main, noise), of_noise,
        _prior(plan, main),
    )  # fmt: skip
    return tuple(a for part in parts for a in part)


def listed(labels: Sequence[str]) -> str:
    """The first few labels, long sums cut short, and how many more there are."""
    more = f" and {len(labels) - _NAMED} more" if len(labels) > _NAMED else ""
    return "; ".join(map(brief, labels[:_NAMED])) + more


def brief(label: str) -> str:
    """A sum's first two terms, where it is a long one."""
    terms = re.split(r"(?= [+-] )", label)
    return label if len(label) <= _LONG else "".join(terms[:2]) + " + …"


def _motion(plan: PlannedMotions, main: SetReport) -> list[Advice]:
    """What other motions would show."""
    title, most = main.sensor_set.title, main.rank_of_any_motion or 0
    found = main.shown.without_effects  # what effects take is stated apart
    if found.rank == most:
        return [
            Advice("motion", f"These motions show all {most} combinations that any motion can show ({title}); another motion can "
                   "only make them surer.")
        ]  # fmt: skip
    robot = plan.experiment.robot
    channels = make_channels(plan.experiment, main.sensor_set.channel)
    out = []
    if all(m.kind == "poses" for m in plan.motions):
        rest = richest_base(robot, channels, main.sensor_set, at_rest=True)
        if rest.rank > found.rank:
            more = rest.rank - found.rank
            text = f"More poses, each joint in several places, would show {more} more: {listed(further(rest, found))}."
            out.append(Advice("motion", text, more))
        more = most - max(rest.rank, found.rank)
        text = f"The robot only stands while it is read; moving it would show {more} more, above all inertias."
        return [*out, Advice("motion", text, more)]

    def reachable(still: np.ndarray) -> BaseParameters:
        return richest_base(robot, channels, main.sensor_set, held=still)

    held = reachable(plan.still)
    moved = []
    for j in np.flatnonzero(np.isfinite(plan.still)).tolist():
        freed = reachable(np.where(np.arange(robot.n) == j, np.nan, plan.still))
        moved.append((freed.rank - held.rank, robot.joint_names[j], further(freed, held)))
    for gain, joint, labels in sorted(moved, key=lambda m: -m[0]):
        if gain:
            out.append(Advice("joint", f"{joint} stood still; moving it would show {gain} more: {listed(labels)}.", gain))
    if held.rank > found.rank:
        more = held.rank - found.rank
        text = (
            f"The joints that move could show {more} more if they moved independently: {listed(further(held, found))}. "
            "Give each its own course, with several frequencies and fast reversals."
        )
        out.append(Advice("motion", text, more))
    return out


def _effects(reports: Sequence[SetReport], main: SetReport) -> list[Advice]:
    """What effects in the model take, and which other sensors tell them from the links."""
    hidden = [e.name for e in main.effects if e.std is None]
    lost = main.shown.without_effects.rank - main.rank
    out = []
    if lost:
        labels = listed(further(main.shown.without_effects, main.shown.base))
        text = (
            f"Effects in the model look like {lost} combination{'s' if lost > 1 else ''} of the links: {labels}. "
            "State their values with fixed = true, or leave out those that are not needed."
        )
        out.append(Advice("effect", text, lost))
    if hidden:
        text = f"Not determined beside the links: {listed(hidden)}. Only a prior on the links, or a stated value, decides them"
        known = {r.sensor_set.title: {e.name for e in r.effects if e.std is not None} for r in reports}
        better = next((title for title, names in known.items() if names.issuperset(hidden)), None)
        out.append(Advice("effect", text + ("." if better is None else f"; {better} would tell them from the links.")))
    return out


def _sensors(reports: Sequence[SetReport], main: SetReport) -> list[Advice]:
    """What other sensors would show with the richest motion, each gain once."""
    own = main.richest
    out, gains = [], {0}
    for r in reports:
        if own is None or r.richest is None:
            continue
        gain = int(np.linalg.matrix_rank(np.vstack([own.matrix, r.richest.matrix]), tol=1e-6)) - own.rank
        if gain not in gains:
            gains.add(gain)
            there = "" if r.recorded else ", if read,"
            text = f"{_sentence(r.sensor_set.title)}{there} would show {gain} more: {listed(further(r.richest, own))}."
            out.append(Advice("sensor", text, gain))
    torque = next((r.richest for r in reports if r.sensor_set.channel == "torque"), None)
    if own is not None and torque is not None and main.sensor_set.channel == "wrench" and not further(torque, own):
        text = "Joint torques show no further combination of link parameters; they would tell of friction and rotors."
        out.append(Advice("sensor", text))
    return out


def _sizes(plan: PlannedMotions, main: SetReport, noise: ReadingNoise) -> list[Advice]:
    """What is known too little, and what a random motion would make of it."""
    out = []
    weak = [b.label for b in main.base_parameters if b.kind == WEAK]
    if weak:
        text = f"The expected error is larger than the body itself for {len(weak)} of {main.rank}: {listed(weak)}."
        out.append(Advice("noise", text, len(weak)))
    whole = sum(duration(m) for m in plan.motions)
    if whole <= 0:
        return out
    robot = plan.experiment.robot
    length = float(np.clip(whole, 1.0, _LONGEST))
    motion = fourier_trajectory(robot, duration=length, rate=_RATE, share=_SHARE, fundamental=max(0.1, 1.0 / length))
    other = report_of(PlannedMotions.of(plan.experiment, [motion]), main.sensor_set, noise)
    samples = sum(len(m.times if isinstance(m, Trajectory) else m.table.times) for m in plan.motions if m.kind != "poses")
    theirs = {b.name: b.std * np.sqrt(_RATE * length / samples) for b in other.base_parameters}  # sampled as often as these
    ratios = {b.label: b.std / theirs[b.name] for b in main.base_parameters if b.name in theirs}
    if not ratios:
        return out
    middle, worst = float(np.median(list(ratios.values()))), max(ratios, key=lambda k: ratios[k])
    beside = f"a random motion within {100 * _SHARE:.0f} % of the limits, as long as these ({whole:.3g} s),"
    if middle > _ALIKE:
        text = (
            f"{_sentence(beside)} would make standard deviations {middle:.2g} times smaller in the middle, at most "
            f"{ratios[worst]:.2g} times ({brief(worst)}): move faster and further, or let `{call('excite')}` find the motion."
        )
        out.append(Advice("motion", text))
    elif middle * _ALIKE < 1.0:
        text = f"These motions tell more than {beside} whose standard deviations would be {1 / middle:.2g} times as large."
        out.append(Advice("motion", text))
    return out


def _noise(plan: PlannedMotions, main: SetReport, sheet: ReadingNoise) -> list[Advice]:
    """What a model that leaves nothing but the sensor's noise would know."""
    best = report_of(plan, main.sensor_set, sheet)
    pairs = zip(main.base_parameters, best.base_parameters, strict=True) if best.rank == main.rank else ()
    ratio = float(np.median([ours.std / theirs.std for ours, theirs in pairs] or [1.0]))
    if ratio < _LACKING:
        return []
    text = (
        "A fit leaves more of the readings than the sensor's noise: with the data sheet's alone, standard deviations would be "
        f"{ratio:.2g} times smaller in the middle, and {best.well_known} of {best.rank} smaller than the size of a body. "
        f"The model lacks something: `{call('diagnose')}` looks for it."
    )
    return [Advice("noise", text, best.well_known - main.well_known)]


def _prior(plan: PlannedMotions, main: SetReport) -> list[Advice]:
    """What the nominal model would decide."""
    driven = [b.label for b in main.prior_driven]
    if not driven:
        return []
    rel_std = plan.experiment.inertia_rel_std or 0.0
    text = (
        f"With the nominal links trusted to {100 * rel_std:.3g} %, the data would hardly narrow {len(driven)} of {main.rank}: "
        f"{listed(driven)}."
    )
    return [Advice("prior", text, len(driven))]


def duration(motion: Motion | Trajectory) -> float:
    """Time that a motion is read in, gaps left out [s]; none of poses."""
    if motion.kind == "poses":
        return 0.0
    times = motion.times if isinstance(motion, Trajectory) else motion.table.times
    steps = np.diff(times)
    return float(steps[steps <= GAP * np.median(steps)].sum())


def _sentence(text: str) -> str:
    return text[0].upper() + text[1:]
