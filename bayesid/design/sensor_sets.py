"""Sets of sensors that an experiment may be read with."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class SensorSet:
    """What is read, and what becomes of the constant offset of the force/torque sensor.

    Attributes
    ----------
    name
        Key in results.
    title
        The same in words.
    channel
        ``wrench``, ``torque`` or ``both``.
    offset
        ``static run``: a run at rest in the same positions is subtracted, which takes gravity along (equation 21 of
        [Liu1998]_); ``fitted``: estimated along; ``known``: there is none, or it has been measured.
    """

    name: str
    title: str
    channel: str
    offset: str = "known"

    @property
    def gravity(self) -> bool:
        """Whether gravity is in the readings."""
        return self.offset != "static run"


#: All of them, in the order in which they are shown.
SENSOR_SETS = {
    s.name: s
    for s in (
        SensorSet("wrench-static", "wrench less its static run", "wrench", "static run"),
        SensorSet("wrench-offset", "wrench, offsets fitted", "wrench", "fitted"),
        SensorSet("wrench", "wrench, offsets known", "wrench"),
        SensorSet("torque", "joint torques", "torque"),
        SensorSet("both-offset", "wrench and torques, offsets fitted", "both", "fitted"),
        SensorSet("both", "wrench and torques, offsets known", "both"),
    )
}
