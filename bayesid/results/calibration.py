"""What ``calibrate`` found, and how it shows itself."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from bayesid.design.payload.body import Quantity
from bayesid.errors import InputError
from bayesid.results.controllers import FORMATS, Load
from bayesid.results.files import SCHEMA, Files, ShownResult
from bayesid.results.identification import Identification
from bayesid.results.payload import cells
from bayesid.rounding import number
from bayesid.section import ShownTable

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
    #: The size of its first parameter that stands out by five standard deviations.
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
            out.append([KINDS[h.kind], "not found", f"< {number(h.size, 2)}", h.unit, f"{h.spec} {h.parameter}"])
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
                {"kind": h.kind, "least_visible": h.spec, "parameter": h.parameter, "size": h.size, "unit": h.unit}
                for h in self.hidden
            ],
            "mass": None if self.mass is None else self.mass.to_dict(),
            "centre_of_mass": {q.name: q.to_dict() for q in self.centre} or None,
            "common_gain": None if self.common_gain is None else self.common_gain.to_dict(),
            "summary": list(self.sentences), "warnings": list(self.warnings), "runtime_s": dict(self.seconds),
        }  # fmt: skip
