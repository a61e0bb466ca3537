"""What ``excite --tell`` found, and how it shows itself."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from bayesid.design.tell.choose import Telling
from bayesid.results.files import ShownResult
from bayesid.results.telling import chance, duration, listed_names, listed_pairs, pair_table, telling_dict
from bayesid.section import ShownTable

SCHEMA = 1
#: The motion's file.
TRAJECTORY = "trajectory.csv"


@dataclass(frozen=True, eq=False, repr=False)
class DistinguishingMotion(ShownResult):
    """The motion that best tells effects apart.

    Attributes
    ----------
    name
        The experiment's name.
    channel
        ``wrench``, ``torque`` or ``both``.
    recordings
        Motions that count, in the order of the experiment; none where nothing is recorded yet.
    telling
        The motion, and what it will tell.
    seconds
        Run time of every stage.
    """

    verb = "tell"
    name: str
    channel: str
    recordings: tuple[str, ...]
    telling: Telling
    seconds: dict[str, float]

    def __repr__(self) -> str:
        t = self.telling
        return f"<DistinguishingMotion of {self.name}: {listed_names(t.rivals)}, {chance(t.probability)}>"

    @property
    def lead(self) -> str:
        """What the motion is and what it decides, in a sentence or two."""
        t = self.telling
        together = f" together with {', '.join(self.recordings)}" if self.recordings else ""
        sizes = "as large as estimated" if t.estimated else "each at its usual size"
        text = f"A motion of {duration(t)}, {t.label}, tells {listed_names(t.rivals)}{together}, {sizes}, "
        text += f"with probability {chance(t.probability)}."
        if t.hopeless:
            text += (
                f" Of {t.tried} motions within the limits none tells {listed_pairs(t.hopeless)}: another sensor or channel may."
            )
        return text

    def _parts(self) -> list[str | ShownTable]:
        return [f"{self.name}: {self.lead}", pair_table(self.telling)]

    def to_dict(self) -> dict[str, Any]:
        """What ``excitation.json`` holds."""
        return {
            "schema": SCHEMA, "experiment": self.name, "channel": self.channel, "recordings": list(self.recordings),
            "tell": telling_dict(self.telling, TRAJECTORY), "runtime_s": dict(self.seconds),
        }  # fmt: skip
