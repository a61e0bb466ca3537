"""What an effect is: one class that says everything about it, whose instances are the effect at its places.

A class says by its attributes what the effect is called, where it can be, what parameters it has and how it is to be
treated, and by its methods how large it usually is and how a search proposes it. What it does to motion, wrench or torque is
a method of its family (`bayesid.effects.families`). Everything else asks the class; nothing knows an effect by its name.
"""

from __future__ import annotations

from abc import ABC
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import product
from math import inf
from typing import ClassVar, Literal

import numpy as np

from bayesid.dynamics.channels import WRENCH_NAMES
from bayesid.effects.segment import MotionSegment
from bayesid.robot.robot import Robot


@dataclass(frozen=True, eq=False)
class Surroundings:
    """What an effect may want to know of the recordings that it is sought in."""

    robot: Robot  # the nominal robot
    times: tuple[float, float]  # of the first and the last sample of the fitted motions [s]
    mean_places: np.ndarray  # mean position of each link's frame over the fitted motions, in the base frame (n, 3) [m]
    joint_inertia: np.ndarray  # mean inertia that each joint feels over the first fitted motion (n,) [kg m^2 or kg]
    moving: np.ndarray  # whether each joint moves in the fitted motions (n,)
    links_known: bool  # whether a prior standard deviation of the nominal links is stated
    both_channels: bool  # whether wrench and torques are compared together
    torques: bool  # whether joint torques are compared, with a wrench or alone
    static_run: bool  # whether static readings are among those compared, which remove a constant offset
    base_sensor: bool  # whether the readings of a sensor under the base are compared


@dataclass(frozen=True, eq=False)
class Linearisation:
    """Values at which an effect's derivatives are taken as columns, and what amplitudes of these columns mean."""

    at: np.ndarray  # the values (k,)
    to_values: Callable[[np.ndarray], np.ndarray]  # from amplitudes of the columns (k,) to values (k,), or several starts (m, k)
    to_amplitudes: Callable[[np.ndarray], np.ndarray]  # from values (k,) to amplitudes (k,)

    @classmethod
    def holding(cls, at: np.ndarray, held: np.ndarray, away: np.ndarray | float = 0.0) -> Linearisation:
        """Amplitudes are what values differ from ``away``, but for those that are held where the columns are taken."""
        return cls(at, partial(_values, at, held, away), partial(_amplitudes, held, away))


def _values(at: np.ndarray, held: np.ndarray, away: np.ndarray | float, amplitudes: np.ndarray) -> np.ndarray:
    return np.where(held, at, away + amplitudes)


def _amplitudes(held: np.ndarray, away: np.ndarray | float, values: np.ndarray) -> np.ndarray:
    return np.where(held, 0.0, values - away)


@dataclass(frozen=True)
class Parameter:
    """One parameter of an effect."""

    name: str  # as in the experiment format
    unit: str = "1"  # as there; for a turning joint, see `Effect.units`
    #: Range outside which a value is not plausible.
    lower: float = -inf
    upper: float = inf
    start: float = 0.0  # value from which an estimate starts and that stands where none is given
    #: A plausible size; on a robot and at a joint of it where it is a function of both.
    typical: float | Callable[[Robot, int | None], float] = 1.0
    linear: bool = True  # whether the readings are linear in it; otherwise it is called a shape parameter
    step: float = 1e-4  # of central differences; relative to the value where that is larger
    tried: tuple[float, ...] = ()  # values of a shape parameter that a search for effects tries; default the start
    sliding: str | None = None  # the unit for a sliding joint, where it is not that of `Effect.units`
    lasting: bool = False  # whether it is what a robot is built with, such as gears and rotors, and stays as it is
    #: Parameter of another effect at the same place, ``effect.parameter``, whose torque it takes away as the drive warms.
    fall_of: str = ""
    #: Whether no robot has a negative one, although readings may ask for it: those that lack what a drive compensates.
    never_negative: bool = False


#: Units along a sliding joint by those about a turning one.
_SLIDING = {
    "N m": "N", "N m/rad": "N/m", "N m s/rad": "N s/m", "N m/s": "N/s", "rad": "m", "rad/s": "m/s", "1/rad": "1/m",
    "rad/(N m)": "m/N", "kg m^2": "kg",
}  # fmt: skip
#: Name, value, standard deviation (not finite where it is not determined) and unit of a quantity that follows from parameters.
Derived = tuple[str, float, float, str]


@dataclass(frozen=True)
class Effect(ABC):
    """An effect at its place. To add one, derive a class from one of `bayesid.effects.families` and register it."""

    where: str  # as in the experiment format; joints as ``joint1`` ... ``jointn``
    joint: int | None = None  # index of the joint, None where it acts elsewhere
    axes: tuple[int, ...] = ()  # indices of the wrench axes: the one that reads, or source and reading axis
    ratio: float | None = None  # gear ratio of the joint, where it is known and the effect needs it
    driver: int | None = None  # index of the joint whose motion turns this one's motor, too, where the effect couples two
    slides: bool = False  # whether the joint slides

    name: ClassVar[str] = ""  # as in the experiment format
    channels: ClassVar[tuple[str, ...]] = ("wrench", "torque")  # both or one: what it changes
    #: Where it can be: ``sensor``, ``axis``, ``axis->axis``, ``base``, ``joint``, ``joint->joint``, ``robot`` or ``joint|robot``.
    at: ClassVar[str] = "robot"
    quantities: ClassVar[tuple[Parameter, ...]] = ()  # its parameters
    summary: ClassVar[str] = ""  # what it is, a few words
    equation: ClassVar[str] = ""  # for the documentation: what it reads or adds (Markdown with TeX)
    source: ClassVar[str] = "definition"  # where the equation comes from
    confusable_with: ClassVar[tuple[str, ...]] = ()  # names of effects that some motions cannot tell from it

    #: Whether a static run of the same positions takes it away, so that such rows do not show it.
    removed_by_static_run: ClassVar[bool] = False
    #: Whether it is in every model of readings that no static run is subtracted from.
    estimated_without_static_run: ClassVar[bool] = False
    absorbs_weight: ClassVar[bool] = False  # whether its estimate holds the weight that looks like it as well
    #: Whether `motion_columns` are the same at all times, whatever the motion; a class that inherits it must keep to it.
    always_the_same: ClassVar[bool] = False
    #: How its column is made where regressors are interpolated in time (`bayesid.regression.rows`): ``interpolated`` as they are,
    #: where rigid bodies' columns can add up to it; ``sampled`` where they cannot; empty where neither is known, and then nothing
    #: is interpolated. A class does not inherit it, for its column may be another.
    column_in_time: ClassVar[Literal["", "interpolated", "sampled"]] = ""
    zero_unless_stated: ClassVar[bool] = False  # whether parameters left out are zero once any is stated
    needs_gear_ratio: ClassVar[bool] = False  # whether it wants to know its joint's gear ratio
    #: Time that it is given at the start of a recording that does not start at rest to forget how it was set off [s].
    settling: ClassVar[float] = 0.0
    #: Whether it differentiates a load again; encoders' errors pass through it much enlarged.
    amplifies_encoder_errors: ClassVar[bool] = False
    reverses_at_once: ClassVar[bool] = False  # whether it jumps where the joint's motion reverses
    once: ClassVar[bool] = False  # whether it happens once, in one recording
    #: Whether only one of its kind is sought: with a place and a shape to find, two can imitate one that settled wrongly.
    single: ClassVar[bool] = False
    #: Names of effects beside which it is not sought at the same place, nor they beside it: descriptions of one thing.
    instead_of: ClassVar[tuple[str, ...]] = ()
    changes_link: ClassVar[bool] = False  # whether it is a change of a whole link
    columns_of: ClassVar[str | None] = None  # name of an effect that has the same columns, which is sought in its stead
    may_be: ClassVar[str | None] = None  # name of an effect that it is called where its values are possible for that
    only_joint: ClassVar[int | None] = None  # index of the one joint that it can be at, where it cannot be at all
    along_joint: ClassVar[bool] = False  # whether its parameters are in units of its joint's position and force
    #: Numbers of periods per radian or metre, where it is a sine of the joint's position; these are tried.
    harmonics: ClassVar[tuple[float, ...]] = ()
    #: Whether its values, but those of shapes and lasting ones, change from day to day, with temperature, load and grease,
    #: without anything having changed.
    wanders: ClassVar[bool] = False
    #: What it is a part of that may change as a whole, by one factor, such as all friction of a joint.
    part_of: ClassVar[str] = ""
    since_zero: ClassVar[bool] = False  # whether it grows from time zero of the tables on
    last_resort: ClassVar[bool] = False  # whether `trials` are made only where columns leave something unexplained
    #: Factors on its first value, from which a fit that leaves something unexplained is started again.
    restarts: ClassVar[tuple[float, ...]] = ()
    #: Attribute of a URDF joint's ``<dynamics>`` that its first parameter is, if there is one.
    urdf_dynamics: ClassVar[str | None] = None

    # Made from `quantities`, one entry a parameter.
    parameters: ClassVar[tuple[str, ...]] = ()
    lower: ClassVar[tuple[float, ...]] = ()
    upper: ClassVar[tuple[float, ...]] = ()
    starts: ClassVar[tuple[float, ...]] = ()
    shape: ClassVar[tuple[str, ...]] = ()

    def __init_subclass__(cls, **kwargs) -> None:
        super().__init_subclass__(**kwargs)
        cls.column_in_time = vars(cls).get("column_in_time", "")
        cls.parameters = tuple(p.name for p in cls.quantities)
        cls.lower = tuple(float(p.lower) for p in cls.quantities)
        cls.upper = tuple(float(p.upper) for p in cls.quantities)
        cls.starts = tuple(float(p.start) for p in cls.quantities)
        cls.shape = tuple(p.name for p in cls.quantities if not p.linear)

    # -- what a place adds

    @cached_property
    def spec(self) -> str:
        """The effect's name and place, ``name@where``."""
        return f"{self.name}@{self.where}"

    def excludes(self, other: Effect) -> bool:
        """Whether only one of the two can be in a model: the same, a second of a `single` kind, or one `instead_of` the other."""
        if self.spec == other.spec or (self.single and self.name == other.name):
            return True
        here = self.where == other.where or (self.joint is not None and self.joint == other.joint)
        return here and (other.name in self.instead_of or self.name in other.instead_of)

    @property
    def column_names(self) -> tuple[str, ...]:
        """One name a parameter, ``viscous_friction@joint1.coefficient``."""
        return tuple(f"{self.spec}.{p}" for p in self.parameters)

    @property
    def units(self) -> tuple[str, ...]:
        """One unit a parameter: of a sliding joint metres and newtons stand in place of radians and newton metres."""
        slides = self.slides and self.along_joint
        return tuple((p.sliding or _SLIDING.get(p.unit, p.unit)) if slides else p.unit for p in self.quantities)

    def derived(self, values: Sequence[float], covariance: np.ndarray) -> tuple[Derived, ...]:
        """What follows from parameters (k,) and is told beside them, with standard deviations by their covariance (k, k)."""
        return ()

    def caveat(self, values: Sequence[float], positions: np.ndarray) -> str:
        """What to know of such values (k,) where its joint was at some positions (N,) [rad or m]; empty where that is nothing."""
        return ""

    @property
    def non_negative(self) -> tuple[bool, ...]:
        """Whether a negative value is impossible, by parameter."""
        return tuple(p.never_negative or p.lower >= 0.0 for p in self.quantities)

    @classmethod
    def acts_on(cls, channel: str) -> bool:
        """Whether it changes a channel of this name (``fx`` ... ``mz``, ``tau1`` ...)."""
        return ("wrench" if channel in WRENCH_NAMES else "torque") in cls.channels

    def predictable(self, channels: Sequence[str]) -> bool:
        """Whether channels of these names hold all that it takes into any of them."""
        return True

    # -- sizes

    def typical(self, robot: Robot) -> Sequence[float]:
        """A plausible value of each parameter (k,) on a robot: its masses, lengths, and effort and velocity limits."""
        return [p.typical(robot, self.joint) if callable(p.typical) else p.typical for p in self.quantities]

    def reach(self, values: Sequence[float], bandwidth: float, step: float) -> float:
        """Time before and after a sample that its reading depends on [s], by bandwidth of the motion [Hz] and sample step [s]."""
        return 0.0

    def canonical(self, values: tuple[float, ...]) -> tuple[float, ...]:
        """The values (k,) that a reader expects, among those that mean the same."""
        return values

    # -- columns that the joint motion alone gives

    @property
    def from_motion_alone(self) -> bool:
        """Whether its columns are `motion_columns`, whatever the links and other effects are."""
        return False

    def motion_columns(self, segment: MotionSegment, channels: Sequence[str]) -> np.ndarray:
        """What one unit of each parameter adds to each channel (N, channels, k), for an effect that needs the motion only."""
        raise NotImplementedError(f"{self.spec} needs more than the motion")

    # -- how a search for effects proposes it

    def sought(self, around: Surroundings) -> bool:
        """Whether it can be told from the links in such recordings at all."""
        return True

    def linearisations(self, around: Surroundings) -> Sequence[Linearisation]:
        """Where columns are taken for what the effect could explain.

        Linear parameters alone have the same columns everywhere; beside a shape parameter their columns are taken at one unit
        of each, for every shape tried. Where all are shape parameters, columns are those of a small change of their start.
        """
        linear = np.array([p.linear for p in self.quantities])
        grids = [(float(not linear.all()),) if p.linear else p.tried or (p.start,) for p in self.quantities]
        out = []
        for point in product(*grids):
            at = np.array(point, float)
            away = at if not linear.any() else np.zeros(len(at))
            held = ~linear if linear.any() else np.zeros(len(at), bool)
            out.append(Linearisation.holding(at, held, away))
        return out

    def is_another(self, values: Sequence[float], doubt: Sequence[float], travel: float) -> bool:
        """Whether at these values (k,) it is no more than other effects are: a search then leaves the name to them.

        ``doubt`` (k,) is how far from zero each value has to be for its uncertainty to leave the odds that tell rivals apart;
        ``travel`` is how far its joint moves [rad or m], zero where it has none.
        """
        return False

    def as_another(self, values: Sequence[float]) -> Term | None:
        """The other effect that it is at such values (k,), with values of its own, where that is a single one."""
        return None

    def holds_below(self, values: Sequence[float], around: Surroundings) -> float:
        """Frequency [Hz] up to which encoders show enough of what it does for its equation to hold; most hold anywhere."""
        return inf

    def same_as(self, values: Sequence[float], around: Surroundings, beside: Sequence[Effect]) -> tuple[Term, ...]:
        """Other effects that together do the same, whatever the motion: nothing in what is compared tells it from them.

        ``beside`` are effects whose values are fitted in the same model, and may make up for some of it.
        """
        return ()

    def comes_after(self, other: Effect) -> bool:
        """Whether a search counts for it only what another effect leaves unexplained."""
        return False

    @property
    def tries_starts(self) -> bool:
        """Whether a fit may start elsewhere than at the usual values."""
        return type(self).starts_tried is not Effect.starts_tried

    @property
    def may_be_another(self) -> bool:
        """Whether there are such values."""
        return type(self).is_another is not Effect.is_another

    def trials(self, around: Surroundings) -> np.ndarray:
        """Values that are tried exactly, one after the other (m, k): of an effect that no small amplitude can stand for."""
        return np.zeros((0, len(self.parameters)))

    def starts_tried(self, around: Surroundings) -> np.ndarray:
        """Values from which a fit may start, beside the usual ones (m, k): where that leads to another minimum."""
        return np.zeros((0, len(self.parameters)))

    def from_harmonic(self, order: float, sine: float, cosine: float) -> tuple[float, ...]:
        """Values (k,) of ``sine sin(order q) + cosine cos(order q)``, where the effect has `harmonics`."""
        raise NotImplementedError(f"{self.spec} is no sine of the joint's position")


def with_places(effects: Iterable[Effect]) -> Iterator[tuple[Effect, slice]]:
    """Each effect, and where its parameters stand among those of all, one effect after the other."""
    first = 0
    for effect in effects:
        yield effect, slice(first, first := first + len(effect.parameters))


@dataclass(frozen=True)
class Term:
    """An effect with values of its parameters."""

    effect: Effect
    values: tuple[float, ...]  # one number a parameter, in the order of ``effect.parameters``

    def __post_init__(self):
        object.__setattr__(self, "values", tuple(float(v) for v in self.values))
        if len(self.values) != len(self.effect.parameters):
            raise ValueError(f"{self.effect.spec} has {len(self.effect.parameters)} parameters, not {len(self.values)}")

    def caveats(self, positions: np.ndarray) -> list[str]:
        """What to know of the values where the joints were at some positions (N, n) [rad or m], a sentence each."""
        said = "" if self.effect.joint is None else self.effect.caveat(self.values, positions[:, self.effect.joint])
        return [f"{self.effect.spec}: {said}"] if said else []

    def with_std(self, std: np.ndarray) -> list[Derived]:
        """Name, value, standard deviation, of these (k,), and unit of every parameter."""
        return list(zip(self.effect.parameters, self.values, map(float, std), self.effect.units, strict=True))
