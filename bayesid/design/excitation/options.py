"""What a user may choose of an exciting trajectory, checked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from bayesid.argument_types import explains_types
from bayesid.arguments import argument, names
from bayesid.errors import InputError
from bayesid.robot.robot import Robot, motion_limits

_POSITIVE = ("duration", "period", "rate", "share", "torque_share", "sensor_share", "mount_frequency", "seconds")
_SHARES = ("share", "torque_share", "sensor_share")
_NOT_NEGATIVE = {
    "diagnosability": "a weight", "margin": "a distance in metres", "settle": "a time in seconds", "read": "a time in seconds",
}  # fmt: skip
_MOST_SAMPLES, _MOST_HARMONICS = 2_000_000, 50
#: Acceleration limit where none is given: full speed in this time [s]; assumed.
_TO_FULL_SPEED = 0.25
#: A motion's highest frequency stays below the mount's resonance by this factor (4 % of quasi-static amplification).
BELOW_RESONANCE = 5.0


@explains_types
@dataclass(frozen=True)
class ExcitationOptions:
    """What is asked for.

    Attributes
    ----------
    channel
        ``wrench``, ``torque`` or ``both``; None: the wrench where there is a sensor.
    static
        Whether a stop-and-go run will follow and be subtracted, as in the paper.
    criterion, quantities
        What counts, and quantities whose expected deviation is given, and which count for ``quantity``: see
        `bayesid.design.excitation.information`.
    kind
        ``fourier``, or ``liu1998`` for the paper's set-up.
    duration, period, harmonics, rate
        Length of the motion [s], after which it repeats [s] (None: half the length), multiples of the fundamental frequency,
        samples a second.
    joints
        Names of the joints that move; None: all.
    share, torque_share, sensor_share
        How much of the limits of joint motion, of effort, and of the sensor's range is used.
    acceleration
        Largest joint accelerations, one number or one a joint [rad/s^2 or m/s^2].
    sensor_range
        Largest readings of the sensor: force and moment, or six numbers [N], [N m]; None: no limit.
    mount_frequency
        Resonance of the sensor's mount [Hz].
    collisions, margin, ground
        Whether bodies are kept apart, by how much [m], and the height of the ground in the base frame [m].
    diagnosability
        Weight of the diagnosability in the choice among the motions found, see `bayesid.design.excitation.diagnosability`; 0: it
        is only reported; None: it is not computed.
    blocks
        Scripted blocks that are added, see `bayesid.design.excitation.blocks`.
    stops, settle, read
        Of the static run: how many stops in a period (None: at every sample, where a static run is subtracted), how long the
        robot waits before each reading, and how long it is read [s].
    starts, randoms, seconds
        Motions that are improved, random ones to choose them from, and time after which no other is begun [s].
    """

    channel: str | None = None
    static: bool = False
    criterion: str = "d"
    quantities: str | Sequence[str] = ()
    kind: str = "fourier"
    duration: float = 20.0
    period: float | None = None
    harmonics: int = 5
    rate: float = 125.0
    joints: str | Sequence[str] | None = None
    share: float = 0.9
    torque_share: float = 0.7
    sensor_share: float = 0.8
    acceleration: float | Sequence[float] | None = None
    sensor_range: Sequence[float] | None = None
    mount_frequency: float | None = None
    collisions: bool = True
    margin: float = 0.02
    ground: float | None = None
    diagnosability: float | None = None
    blocks: str | Sequence[str] = ()
    stops: int | None = None
    settle: float = 0.3
    read: float = 0.2
    starts: int = 3
    randoms: int = 40
    seconds: float = 60.0

    def __post_init__(self) -> None:
        """Take a string for one name; check every number by itself and against the others, with an `InputError`."""
        for name in ("quantities", "joints", "blocks"):
            object.__setattr__(self, name, names(getattr(self, name)))
        for name in _POSITIVE:
            value = getattr(self, name)
            if value is not None and not (np.isfinite(value) and value > 0):
                raise InputError(f"{argument(name, value)}: give a number above 0")
        for name in _SHARES:
            if getattr(self, name) > 1.0:
                raise InputError(f"{argument(name, getattr(self, name))}: give a share of the limits, up to 1")
        if self.kind not in ("fourier", "liu1998"):
            raise InputError(f"{argument('kind', self.kind)}: choose fourier or liu1998")
        if not 2 <= self.harmonics <= _MOST_HARMONICS:
            raise InputError(
                f"{argument('harmonics', self.harmonics)}: give 2 to {_MOST_HARMONICS}; one alone does not start at rest"
            )
        if self.starts < 1 or self.randoms < 1:
            raise InputError(
                f"{argument('starts', self.starts)} and {argument('randoms', self.randoms)}: give at least 1 of each"
            )
        for name, what in _NOT_NEGATIVE.items():
            value = getattr(self, name)
            if value is not None and not (np.isfinite(value) and value >= 0):
                raise InputError(f"{argument(name, value)}: give {what}, 0 or more")
        if self.ground is not None and not self.collisions:
            without = argument("collisions", False)
            raise InputError(f"{argument('ground', self.ground)} is not kept clear with {without}; leave one of them out")
        if self.periods < 1 or abs(self.periods * self.repeats_after - self.duration) > 1e-6 * self.duration:
            raise InputError(
                f"{argument('period', self.repeats_after)}: {argument('duration', self.duration)} is no multiple of it; "
                f"give {argument('duration', max(self.periods, 1) * self.repeats_after)}"
            )
        if self.duration * self.rate > _MOST_SAMPLES:
            raise InputError(
                f"{argument('duration', self.duration)} at {argument('rate', self.rate)}: give at most {_MOST_SAMPLES:,} samples"
            )
        samples = int(round(self.repeats_after * self.rate))
        if self.stops is not None and not 2 <= self.stops <= samples:
            raise InputError(f"{argument('stops', self.stops)}: give 2 to {samples}, the samples of a period")
        lowest = 10.0 * self.harmonics / self.repeats_after
        if self.rate < lowest:
            raise InputError(
                f"{argument('rate', self.rate)}: give at least {lowest:g}, ten samples in a period of the highest harmonic"
            )
        highest = self.harmonics / self.repeats_after
        if self.mount_frequency is not None and highest > self.mount_frequency / BELOW_RESONANCE * (1 + 1e-9):
            raise InputError(
                f"{argument('mount_frequency', self.mount_frequency)}: harmonics reach {highest:g} Hz, above a fifth of it; "
                f"give {argument('period', BELOW_RESONANCE * self.harmonics / self.mount_frequency)} or longer, or fewer "
                f"{argument('harmonics')}"
            )

    @property
    def repeats_after(self) -> float:
        """The period [s]."""
        if self.period is not None:
            return self.period
        return self.duration if self.kind == "liu1998" else 0.5 * self.duration

    @property
    def periods(self) -> int:
        """How often the motion is run through."""
        return round(self.duration / self.repeats_after)

    def to_dict(self) -> dict[str, object]:
        """Plain values by name."""
        return {item.name: getattr(self, item.name) for item in fields(self)}


def largest_accelerations(robot: Robot, given: float | Sequence[float] | None) -> np.ndarray:
    """Acceleration limit of every joint (n,) [per second squared]: as given, one or one a joint, else full speed in 0.25 s."""
    if given is None:
        return motion_limits(robot)[2] / _TO_FULL_SPEED
    return numbers("acceleration", given, robot.n)


def sensor_ranges(given: Sequence[float] | None) -> np.ndarray:
    """Largest readings (6,) [N, N m]: of six numbers, or of one for forces and one for moments; infinite without."""
    if given is None:
        return np.full(6, np.inf)
    if len(given) == 2:
        given = [given[0]] * 3 + [given[1]] * 3
    return numbers("sensor_range", given, 6, "two numbers, force and moment, or six")


def numbers(name: str, given: float | Sequence[float], count: int, several: str = "") -> np.ndarray:
    """So many numbers above 0; one stands for all. An `InputError` where there are others."""
    values = np.atleast_1d(np.array(given, float))
    if values.shape not in ((1,), (count,)) or not (np.isfinite(values) & (values > 0)).all():
        wanted = several or f"one number or {count}"
        raise InputError(f"{argument(name, values.ravel().tolist())}: give {wanted}, each above 0")
    return np.broadcast_to(values, (count,)).copy()
