"""What ``payload`` and ``calibrate`` found, and how it shows itself."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from bayesid.design.payload.body import BodyKnowledge, Quantity, about_centre
from bayesid.design.payload.poses import NextPoses
from bayesid.errors import InputError
from bayesid.estimators.parameters import joined, with_ends
from bayesid.results.controllers import FORMATS, Load
from bayesid.results.files import SCHEMA, Files, ShownResult, strict
from bayesid.results.identification import Identification
from bayesid.robot import inertia
from bayesid.robot.inertia import PARAMETERS, inertia_matrix
from bayesid.rounding import DASH, HALF, channel_text, ends, number, unit_text, with_half, with_interval
from bayesid.section import ShownTable

if TYPE_CHECKING:
    from pandas import DataFrame

#: The table of poses to record next.
NEXT_POSES = "next_poses.csv"
#: Where the payload is known from, in words.
SOURCES = {
    "sensor": "weighed by the sensor in {where}",
    "reference": "what changed since {where}",
    "nominal": "beside the nominal model, whose inertias are trusted to {where}",
}
_NAMES = {
    "m": "mass", "x": "centre of mass x", "y": "centre of mass y", "z": "centre of mass z",
    **{f"mc{k}": f"first moment mc{k}" for k in "xyz"},
}  # fmt: skip
#: Share of half an interval by which its middle may be off the value for the interval to be written as ±.
_SKEW = 0.05


@dataclass(frozen=True)
class EffectBeside:
    """Something beside the payload that the readings show."""

    #: As in the experiment format.
    name: str
    where: str
    values: Mapping[str, tuple[float, float, str]]  # value, standard deviation and unit of each parameter
    ambiguous_with: tuple[str, ...] = ()  # effects, ``name@where``, that explain the readings as well
    in_model: bool = True  # whether the payload's values are those beside it

    @property
    def spec(self) -> str:
        """The effect's name and place, ``name@where``."""
        return f"{self.name}@{self.where}"

    def __str__(self) -> str:
        """The effect with its values, and what explains the readings as well."""
        values = ", ".join(_value(k, *given) for k, given in self.values.items())
        rivals = f", or {' or '.join(self.ambiguous_with)}: these recordings do not tell" if self.ambiguous_with else ""
        return f"{self.spec} ({values}){rivals}"

    def to_dict(self) -> dict[str, Any]:
        """An entry of ``effects``."""
        return {
            "name": self.name, "where": self.where, "parameters": {k: with_ends(*v) for k, v in self.values.items()},
            "ambiguous_with": list(self.ambiguous_with), "in_model": self.in_model,
        }  # fmt: skip


def _value(name: str, value: float, std: float, unit: str) -> str:
    text, half = with_half(value, HALF * std)
    return f"{name} {joined(text, half)} {unit_text(unit)}".rstrip()


@dataclass(frozen=True, eq=False)
class PayloadEstimate(ShownResult):
    """What hangs at the flange: mass, centre of mass, inertia about it, and what the readings hold beside it.

    Attributes
    ----------
    name
        Of the experiment.
    channel
        ``wrench``, ``torque`` or ``both``.
    source
        ``sensor``, ``reference`` or ``nominal``: where the payload is known from.
    source_detail
        The sensor's joint, the reference's name, or the prior relative standard deviation of the links.
    carrier, frame
        The body that it hangs on, and the URDF link in whose frame it is given.
    body
        What the data say of its ten parameters, whether such a body can exist or not; all values below are of one that can.
    mass, centre, inertia
        Its quantities; intervals hold those of every model that the readings cannot tell from the best one.
    first_moment
        Mass times centre of mass, which readings may show where they do not show the mass.
    never_shown
        Which of its ten parameters no motion of this robot shows to these readings (10,).
    extent
        No part of it is farther from its centre of mass [m]; what bounds an inertia that is not shown rests on it.
    extent_assumed
        Whether nobody stated that.
    plain
        Mass and centre of mass without the effects that were found.
    effects
        What the readings hold beside it.
    verdict
        Of the diagnosis, as in ``diagnosis.json``; None where it was left out.
    offset
        Constant reading of the sensor that carries it, ``fx`` … ``mz`` (6,); empty without one.
    sensor_frame, sensor_mounted, centre_in_sensor
        Name of the link that the sensor is on; its frame there, as `bayesid.Sensor.mounted` (6,); and the centre of mass in that
        frame (3,) [m]; None without a sensor that carries it.
    world, gravity
        Name of the URDF's root link, and gravity in its frame (3,) [m/s^2].
    evidence
        Log evidence that something was attached since the reference; None without one.
    nominal_share
        Share of the mass's variance that the nominal model contributes; None where it has no part.
    more
        Poses that bring it to a stated accuracy; None where none was asked for, or nothing weighs it alone.
    sentences
        What it says in words, most important first.
    warnings
        What the user should know.
    seconds
        Run time by stage.
    """

    verb, report = "payload", "payload"
    name: str
    channel: str
    source: str
    source_detail: str
    carrier: str
    frame: str
    body: BodyKnowledge
    mass: Quantity
    centre: tuple[Quantity, ...]
    inertia: tuple[Quantity, ...]
    first_moment: tuple[Quantity, ...]
    never_shown: np.ndarray
    extent: float
    extent_assumed: bool
    plain: tuple[Quantity, ...]
    effects: tuple[EffectBeside, ...]
    verdict: str | None
    offset: tuple[Quantity, ...]
    sensor_frame: str | None
    sensor_mounted: np.ndarray | None
    centre_in_sensor: np.ndarray | None
    world: str
    gravity: np.ndarray
    evidence: float | None
    nominal_share: float | None
    more: NextPoses | None
    sentences: tuple[str, ...]
    warnings: tuple[str, ...]
    seconds: Mapping[str, float] = field(default_factory=dict)

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        """Mass, centre of mass, inertia about it (10,)."""
        return (self.mass, *self.centre, *self.inertia)

    @property
    def centre_of_mass(self) -> np.ndarray:
        """Centre of mass in the stated frame (3,) [m]; nan where it is not shown."""
        return np.array([q.value for q in self.centre])

    @property
    def inertia_about_centre(self) -> np.ndarray | None:
        """About the centre of mass, in the frame's axes (3, 3) [kg m^2]; None where it is not shown as a whole."""
        if not all(q.shown for q in self.inertia):
            return None
        return inertia_matrix(np.array([0.0] * 4 + [q.value for q in self.inertia]))

    @property
    def inertia_bound(self) -> float:
        """No moment of inertia about the centre of mass is larger, as nothing is farther from it than ``extent`` [kg m^2]."""
        return float(self.mass.high * self.extent**2)

    @property
    def physically_consistent(self) -> bool:
        """Whether a body with these values can exist; of an inertia that is not shown there always is one."""
        whole = self.inertia_about_centre
        if not self.mass.shown or whole is None:
            return self.mass.value >= 0.0
        made = inertia.from_mass_com_inertia(self.mass.value, self.centre_of_mass, whole)
        return bool(inertia.is_physically_consistent(made, 1e-6))

    def sample(self, draws: int = 2000, seed: int = 0) -> DataFrame:
        """Draws of mass, centre of mass and inertia about it, of bodies that can exist: the posterior under a flat prior.

        Parameters
        ----------
        draws, seed
            How many; the same seed gives the same draws.

        Returns
        -------
        DataFrame
            A row a draw with the columns ``m``, ``x``, ``y``, ``z``, ``Ixx`` … ``Izz`` [kg, m, kg m^2]; nan where nothing is
            known.
        """
        from pandas import DataFrame

        bodies = self.body.draws(draws, seed)
        with np.errstate(invalid="ignore"):
            centre = bodies[:, 1:4] / bodies[:, :1]
            about = np.array([about_centre(b)[0] for b in bodies])
        return DataFrame(np.column_stack([bodies[:, 0], centre, about]), columns=[q.name for q in self.quantities])

    @property
    def load(self) -> Load:
        """The load as robots' controllers take it.

        Raises
        ------
        InputError
            The data do not show mass and centre of mass.
        """
        missing = [_NAMES[q.name] for q in (self.mass, *self.centre) if not q.shown]
        if missing:
            helps = "no motion of this robot does" if self.never_shown[:4].any() else "record more poses that differ in tilt"
            raise InputError(f"export: these data do not show the {', '.join(missing)}; {helps}")
        return Load(
            self.mass.value, self.centre_of_mass, self.inertia_about_centre, self.frame, self.world, self.gravity,
            self.sensor_frame, self.centre_in_sensor,
            np.array([q.value for q in self.offset]) if self.offset and all(q.shown for q in self.offset) else None,
            self.sensor_mounted,
        )  # fmt: skip

    def exports(self) -> dict[str, str]:
        """The same in the form of every controller that can take it, by file name; none where too little is shown."""
        if not all(q.shown for q in (self.mass, *self.centre)):
            return {}
        load = self.load
        return {f.file: f.write(load) for f in FORMATS.values() if load.sensor is not None or not f.of_sensor}

    def _beside(self) -> Files:
        return self.exports() | (
            {} if self.more is None or not len(self.more.positions) else {NEXT_POSES: _poses(self.more.positions)}
        )

    def export(self, controller: str) -> str:
        """The numbers in the form that a controller takes.

        Parameters
        ----------
        controller
            ``ur``, ``franka``, ``kuka``, ``xarm``, ``ros``, ``ros2`` or ``admittance``, see `bayesid.results.controllers`.

        Raises
        ------
        InputError
            There is no such controller, mass and centre of mass are not shown, or it is for a sensor and none carries this.
        """
        if controller not in FORMATS:
            raise InputError(f"export: '{controller}' is no controller; choose one of {', '.join(FORMATS)}")
        return FORMATS[controller].write(self.load)

    def __repr__(self) -> str:
        return f"<PayloadEstimate of {self.name}: {number(self.mass.value)} kg in the frame of {self.frame}>"

    @property
    def table(self) -> ShownTable:
        """Every quantity with its interval, and whether it is shown; first moments where the mass is not."""
        instead = () if self.mass.shown else tuple(q for q in self.first_moment if q.shown)
        quantities = (self.mass, *instead, *self.centre, *self.inertia)
        rows = [[_NAMES.get(q.name, f"inertia {q.name}"), *cells(q), q.unit, "" if q.shown else "not shown"] for q in quantities]
        dim = {k: "dim" for k, q in enumerate(quantities) if not q.shown}
        return ShownTable(["", "value", "95 % interval", "unit", ""], rows, "k n n u -", "narrow", dim)

    def _parts(self) -> list[str | ShownTable]:
        lead = f"{self.name}: payload {SOURCES[self.source].format(where=self.source_detail)} ({channel_text(self.channel)})"
        frame = f"in the frame of {self.frame}, inertia about the centre of mass"
        return [lead, frame, self.table, *self.sentences, *(f"warning: {w}" for w in self.warnings)]

    def to_dict(self) -> dict[str, Any]:
        """What ``payload.json`` holds."""
        return strict({
            "schema": SCHEMA, "experiment": self.name, "channel": self.channel,
            "source": {"kind": self.source, "detail": self.source_detail},
            "carried_by": self.carrier, "frame": self.frame,
            "mass": self.mass.to_dict(),
            "centre_of_mass": _together(self.centre),
            "first_moment": _together(self.first_moment),
            "inertia": _together(self.inertia),
            "inertia_bound": {
                "value": self.inertia_bound, "unit": "kg m^2", "extent": self.extent, "assumed": self.extent_assumed,
            },
            "physically_consistent": self.physically_consistent,
            "parameters": {
                "names": list(PARAMETERS), "values": self.body.possible.mean.tolist(),
                "covariance": self.body.covariance.tolist(),
                "determined": self.body.shown.tolist(), "shown_by_no_motion": self.never_shown.tolist(),
            },
            "sensor_offset": {q.name: q.to_dict() for q in self.offset} or None,
            "centre_in_sensor": None if self.centre_in_sensor is None else self.centre_in_sensor.tolist(),
            "verdict": self.verdict, "effects": [e.to_dict() for e in self.effects],
            "without_effects": None if not self.effects else {q.name: q.to_dict() for q in self.plain},
            "next": None if self.more is None else {
                "file": NEXT_POSES, "poses": self.more.positions.tolist(), "reached": self.more.reached,
                "wanted": {"mass": self.more.wanted[0], "centre_of_mass": self.more.wanted[1]},
                "expected": {"mass": self.more.expected[0], "centre_of_mass": self.more.expected[1]},
            },
            "log_evidence": self.evidence, "nominal_share": self.nominal_share,
            "summary": list(self.sentences), "warnings": list(self.warnings), "runtime_s": dict(self.seconds),
        })  # fmt: skip


def cells(q: Quantity) -> tuple[str, str]:
    """Value and interval of a quantity as a table has them: ``± half`` where it is even, both ends otherwise, a dash without."""
    if not q.shown:
        return DASH, ends(q.low, q.high) if np.isfinite([q.low, q.high]).all() and q.low < q.high else DASH
    half = 0.5 * (q.high - q.low)
    if abs(q.low + half - q.value) < _SKEW * half:  # a ratio's interval is hardly ever quite even
        value, text = with_half(q.value, half)
        return value, f"± {text}"
    return with_interval(q.value, q.std, q.low, q.high)


def _together(quantities: tuple[Quantity, ...]) -> dict[str, Any]:
    """Quantities as lists, None where not all are shown, and each by its name."""
    shown = all(q.shown for q in quantities)
    lists = {k: [getattr(q, k) for q in quantities] if shown else None for k in ("value", "std", "low", "high")}
    each = {q.name: q.to_dict() for q in quantities}
    return {**lists, "order": list(each), "unit": quantities[0].unit, "shown": shown, **each}


def _poses(positions: np.ndarray) -> str:
    """Poses as a table of a motion of kind ``poses``."""
    rows = [",".join([str(k), *(f"{x:.6f}" for x in row)]) for k, row in enumerate(positions)]
    return "\n".join([",".join(["t", *(f"q{j + 1}" for j in range(positions.shape[1]))]), *rows]) + "\n"


#: Kinds of effects that a calibration tells of, and what they are.
KINDS = {
    "sensor_offset": "offset", "sensor_drift": "drift", "sensor_gain": "gain of an axis", "sensor_crosstalk": "cross-talk",
    "sensor_rotation": "orientation", "sensor_translation": "origin", "sensor_delay": "delay against the joints",
    "base_tilt": "tilt of the base",
}  # fmt: skip


@dataclass(frozen=True)
class HiddenEffect:
    """How large an effect of a kind may be without standing out."""

    kind: str  # a key of `KINDS`
    spec: str  # ``name@where``, of the places where it would stand out least
    #: The size of one of its parameters from which it is named half of the time; infinite where no plausible size is.
    parameter: str
    size: float
    unit: str


@dataclass(frozen=True, eq=False)
class Calibration(ShownResult):
    """What a force/torque sensor in place has: only as much as the recordings show.

    Attributes
    ----------
    fit
        The model with all that was found.
    sensor
        The joint that the sensor sits in, or ``base``.
    found
        Every effect of the model with its quantities, by ``name@where``.
    ambiguous
        What explains the readings as well, by ``name@where``.
    hidden
        Kinds that were not found, and how large they may be.
    mass, centre
        Of what the sensor carries; None where that is a whole arm.
    common_gain
        By which share all force axes read too much; None without a known mass.
    load
        What controllers take; None where mass and centre of mass are not known.
    verdict
        Of the diagnosis; None where it was refused.
    sentences
        What it says in words.
    warnings
        What the user should know.
    seconds
        Run time by stage.
    """

    verb, report = "calibrate", "payload"
    fit: Identification
    sensor: str
    found: Mapping[str, tuple[Quantity, ...]]
    ambiguous: Mapping[str, tuple[str, ...]]
    hidden: tuple[HiddenEffect, ...]
    mass: Quantity | None
    centre: tuple[Quantity, ...]
    common_gain: Quantity | None
    load: Load | None
    verdict: str | None
    sentences: tuple[str, ...]
    warnings: tuple[str, ...]
    seconds: Mapping[str, float] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """The experiment's name."""
        return self.fit.problem.experiment.name

    def compensate(self, positions: ArrayLike, wrench: ArrayLike, times: ArrayLike | None = None) -> np.ndarray:
        """Readings without what the sensor makes of weight at rest: offset, weight and the effects found are taken away.

        Parameters
        ----------
        positions
            Joint positions (N, n) or (n,) [rad or m].
        wrench
            Readings in the columns of the recording (N, 6) or (6,) [N, N m].
        times
            (N,) [s], where the model has a drift.

        Returns
        -------
        left
            What else the sensor applies to what it carries, (N, 6) or (6,) [N, N m]; the surroundings push with the opposite.

        Raises
        ------
        InputError
            Shapes do not fit, or times are missing.
        """
        q, read = np.asarray(positions, float), np.asarray(wrench, float)
        if read.shape != (*q.shape[:-1], 6):
            raise InputError(f"wrench has shape {read.shape}; give six readings for each of the positions {q.shape}")
        still = np.zeros_like(q)
        said = self.fit.predict(q, still, still, None if times is None else np.asarray(times, float)).values
        return read - said.reshape(read.shape)

    def exports(self) -> dict[str, str]:
        """Gravity compensation for ROS, by file name; none where mass and centre of mass are not known."""
        if self.load is None:
            return {}
        return {f.file: f.write(self.load) for f in FORMATS.values() if f.of_sensor}

    def _beside(self) -> Files:
        return self.exports()

    def __repr__(self) -> str:
        return f"<Calibration of {self.name}: {', '.join(self.found) or 'nothing found'}>"

    @property
    def table(self) -> ShownTable:
        """What was found and what was not, with intervals, and what explains the readings as well."""
        out = []
        for spec, quantities in self.found.items():
            rivals = self.ambiguous.get(spec, ())
            for k, q in enumerate(quantities):
                remark = f"or {', '.join(rivals)}" if rivals and k == 0 else ""
                out.append([f"{spec} {q.name}", *cells(q), q.unit, remark])
        for h in self.hidden:
            seen = np.isfinite(h.size)
            size = [f"< {number(h.size, 2)}", h.unit] if seen else ["any size", ""]
            out.append([KINDS[h.kind], "not found", *size, f"{h.spec} {h.parameter}"])
        for label, q in (("mass carried", self.mass), *((f"centre of mass {q.name}", q) for q in self.centre),
                         ("common gain of the forces", self.common_gain)):  # fmt: skip
            if q is not None:
                out.append([label, *cells(q), q.unit, "" if q.shown else "not shown"])
        return ShownTable(["", "value", "95 % interval", "unit", ""], out, "k n n u w", "narrow")

    def _parts(self) -> list[str | ShownTable]:
        lead = f"{self.name}: force/torque sensor in {self.sensor}"
        return [lead, self.table, *self.sentences, *(f"warning: {w}" for w in self.warnings)]

    def to_dict(self) -> dict[str, Any]:
        """What ``calibration.json`` holds."""
        return {
            "schema": SCHEMA, "experiment": self.name, "sensor": self.sensor, "motions": list(self.fit.problem.fitted),
            "verdict": self.verdict,
            "effects": [
                {"name": spec.partition("@")[0], "where": spec.partition("@")[2],
                 "parameters": {q.name: q.to_dict() for q in quantities}, "ambiguous_with": list(self.ambiguous.get(spec, ()))}
                for spec, quantities in self.found.items()
            ],
            "could_hide": [
                {"kind": h.kind, "least_visible": h.spec, "parameter": h.parameter, "unit": h.unit,
                 "size": h.size if np.isfinite(h.size) else None}
                for h in self.hidden
            ],
            "mass": None if self.mass is None else self.mass.to_dict(),
            "centre_of_mass": {q.name: q.to_dict() for q in self.centre} or None,
            "common_gain": None if self.common_gain is None else self.common_gain.to_dict(),
            "summary": list(self.sentences), "warnings": list(self.warnings), "runtime_s": dict(self.seconds),
        }  # fmt: skip
