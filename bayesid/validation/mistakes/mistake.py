"""What a mistake is."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite
from typing import Any


@dataclass(frozen=True)
class Mistake:
    """What seems to be wrong with the data, and what undoing it would bring."""

    #: Which mistake, as `bayesid.validation.mistakes.candidates.Candidate` names it.
    name: str
    where: str
    text: str  # one line: what seems wrong, by how much the fit improves, what to do
    channel: str  # ``wrench`` or ``torque``: in which readings it shows
    evidence: float  # log odds against the data as they are [nats]; infinite for readings of an impossible size
    #: Residual in each column, rms, as the data are and with the mistake undone (c,) [unit of the column].
    before: tuple[float, ...] = ()
    after: tuple[float, ...] = ()
    alternatives: tuple[tuple[str, str], ...] = ()  # name and place of other mistakes that would repair the fit as well

    def to_dict(self) -> dict[str, Any]:
        """An entry of ``mistakes`` in ``check.json``."""
        return {
            "name": self.name, "where": self.where, "text": self.text, "channel": self.channel,
            "evidence_nats": self.evidence if isfinite(self.evidence) else None,
            "residual_before": list(self.before), "residual_after": list(self.after),
            "alternatives": [{"name": name, "where": where} for name, where in self.alternatives],
        }  # fmt: skip
