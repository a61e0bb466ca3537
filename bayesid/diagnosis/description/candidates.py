"""Candidates: which shapes are tried in which readings."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

from bayesid.diagnosis.description.shapes import (
    Ranges,
    Shape,
    ShapeFactor,
    accelerations,
    loads,
    memories,
    oscillations,
    positions,
    ripples,
    settling,
    single,
    speeds,
    times,
    times_each,
)


@dataclass(frozen=True)
class CandidateTerm:
    """A shape in some readings, with an amplitude in each."""

    shape: Shape  # what it is
    channels: tuple[int, ...]  # indices of the readings

    @property
    def size(self) -> int:
        """Number of amplitudes."""
        return len(self.shape.products) * len(self.channels)

    @property
    def free(self) -> int:
        """Number of amplitudes and of numbers that may be adapted."""
        return self.size + len(self.shape.numbers)

    @property
    def sort(self) -> tuple[int, int]:
        """Factors and amplitudes: candidates of one sort are as likely as each other beforehand."""
        return self.shape.length, self.size


def candidates(names: Sequence[str], joints: Sequence[int], ranges: Ranges, band: float) -> list[CandidateTerm]:
    """All candidates, by channels' names, joints that move, ranges of variables in fitted motions and top frequency [Hz]."""
    wrench = tuple(k for k, name in enumerate(names) if not name.startswith("tau"))
    torques = tuple(k for k, name in enumerate(names) if name.startswith("tau"))
    steady, waves = [single(f) for f in (*times(ranges), *settling(ranges))], list(oscillations(ranges, band))
    # What shakes or warms a sensor shows in all of its axes, what does so to a drive in one torque.
    found = [
        CandidateTerm(shape, group) for group in [wrench] * bool(wrench) + [(k,) for k in torques] for shape in waves + steady
    ]
    found += [CandidateTerm(shape, (k,)) for shape in steady for k in wrench]
    for k in torques:
        joint = int(names[k][3:]) - 1
        if joint in joints:
            found += [CandidateTerm(shape, (k,)) for shape in _inside(joint, joints, names, ranges)]
    if wrench:
        outside = list(_outside(joints, ranges))
        found += [CandidateTerm(shape, wrench) for shape in outside]
        for k in wrench:
            read = _read(names[k], [names[i] for i in wrench], joints, ranges)
            found += [CandidateTerm(shape, (k,)) for shape in (*outside, *read)]
    unique = {(c.shape.texts, c.channels): c for c in found}
    return list(unique.values())


def _inside(joint: int, joints: Sequence[int], names: Sequence[str], ranges: Ranges) -> Iterator[Shape]:
    """Shapes for the torque of a joint: of its own state, of others', and of both."""
    q, v, a, tau = (f"{x}{joint + 1}" for x in ("q", "v", "a", "tau"))
    place, speed, rate, load = positions(q), speeds(v, ranges), accelerations(a), loads(tau, ranges)
    waves, drag = list(ripples(q, ranges)), memories(q, ranges)
    sense = ShapeFactor("{x}", f"dir{joint + 1}", "direction")
    linear = ShapeFactor("{x}", tau, "load", 1)
    courses = times(ranges)
    own = [*place, *speed, *rate, *load, *drag, *memories(tau, ranges)]
    yield from (single(f) for f in own)
    yield from waves
    few = [f for f in speed if f.number is None]
    yield from (times_each(w, f) for w in waves for f in (speed[0], sense, linear))
    yield from _products(place, [*few, *rate, *drag, linear, load[0]])
    yield from _products([linear, *load[:4]], [*few, *place])
    yield from _products(courses, [*few, *place, *drag, linear, load[0]])
    # What fades with speed, as Stribeck's friction does.
    widths = [share * ranges(v).size for share in (0.02, 0.06, 0.2)]
    fading = [ShapeFactor("exp(-({x} / {n})**2)", v, "speed", number=w, step=0.5 * w) for w in widths]
    yield from _products([sense], fading)
    yield from (single(x, f, sense) for x in (*place, *courses, load[0]) for f in (*fading, *place, load[0]) if x != f)
    yield from (single(x, drag_, load[0]) for x in courses for drag_ in drag)
    for other in joints:
        if other == joint:
            continue
        q2, v2, a2, tau2 = (f"{x}{other + 1}" for x in ("q", "v", "a", "tau"))
        theirs = [*positions(q2), *speeds(v2, ranges), *accelerations(a2)]
        if tau2 in names:
            theirs += [ShapeFactor("{x}", tau2, "load", 1), *loads(tau2, ranges)[:4]]
        yield from (single(f) for f in (*theirs, *memories(q2, ranges)[::2]))
        yield from _products([*place, *few, rate[0], linear, load[0]], [f for f in theirs if f.number is None])
    others = [j for j in joints if j != joint]
    yield from _pairs(others)


def _outside(joints: Sequence[int], ranges: Ranges) -> Iterator[Shape]:
    """Shapes of joints' states for a wrench."""
    for j in joints:
        q, v, a = (f"{x}{j + 1}" for x in ("q", "v", "a"))
        yield from (single(f) for f in (*positions(q), *speeds(v, ranges), *accelerations(a), *memories(q, ranges)[::2]))
        yield from (w for k, w in enumerate(ripples(q, ranges, 12.0)) if k % 2 == 0)
        few = [
            ShapeFactor("{x}", v, "speed", 1),
            ShapeFactor("{x}", f"dir{j + 1}", "direction"),
            ShapeFactor("{x} * abs({x})", v, "speed", 2),
        ]
        yield from _products(positions(q), few)
    yield from _pairs(joints)


def _read(own: str, wrench: Sequence[str], joints: Sequence[int], ranges: Ranges) -> Iterator[Shape]:
    """Shapes of the true readings for one axis of a wrench."""
    linear = ShapeFactor("{x}", own, "load", 1)
    yield from (single(f) for f in (*loads(own, ranges), *memories(own, ranges)))
    states = [f for j in joints for f in (*positions(f"q{j + 1}"), *speeds(f"v{j + 1}", ranges)[:2])]
    yield from _products([linear, ShapeFactor("abs({x})", own, "load", 1)], [*states, *times(ranges)])
    for other in wrench:
        if other != own:
            theirs = [ShapeFactor("{x}", other, "load", 1), *loads(other, ranges)]
            yield from (single(f) for f in theirs[1:])
            yield from _products([linear, ShapeFactor("abs({x})", own, "load", 1)], theirs[:2])
            yield from (single(f) for f in memories(other, ranges)[::2])
    yield from (single(ShapeFactor("{x}", x, "load", 1), ShapeFactor("{x}", y, "load", 1)) for x, y in combinations(wrench, 2))


def _pairs(joints: Sequence[int]) -> Iterator[Shape]:
    """Products of two joints' states."""
    for i, k in combinations(joints, 2):
        mine, theirs = (
            [*positions(f"q{j + 1}"), ShapeFactor("{x}", f"v{j + 1}", "speed", 1), ShapeFactor("{x}", f"dir{j + 1}", "direction")]
            for j in (i, k)
        )
        yield from _products(mine, theirs)


def _products(left: Iterable[ShapeFactor], right: Iterable[ShapeFactor]) -> Iterator[Shape]:
    second = list(right)
    return (single(x, y) for x in left for y in second)
