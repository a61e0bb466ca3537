"""What a mistake is."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite
from typing import Any


@dataclass(frozen=True)
class Mistake:
    """What seems to be wrong with the data, and what undoing it would bring.

    Attributes
    ----------
    name, where
        Which mistake, as `bayesid.validation.mistakes.candidates.Candidate` names it.
    text
        One line: what seems wrong, by how much the fit improves, what to do.
    channel
        ``wrench`` or ``torque``: in which readings it shows.
    evidence
        Log odds against the data as they are [nats]; infinite for readings of an impossible size.
    before, after
        Residual in each column, rms, as the data are and with the mistake undone (c,) [unit of the column].
    alternatives
        Name and place of other mistakes that would repair the fit as well.
    """

    name: str
    where: str
    text: str
    channel: str
    evidence: float
    before: tuple[float, ...] = ()
    after: tuple[float, ...] = ()
    alternatives: tuple[tuple[str, str], ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """An entry of ``mistakes`` in ``check.json``."""
        return {
            "name": self.name, "where": self.where, "text": self.text, "channel": self.channel,
            "evidence_nats": self.evidence if isfinite(self.evidence) else None,
            "residual_before": list(self.before), "residual_after": list(self.after),
            "alternatives": [{"name": name, "where": where} for name, where in self.alternatives],
        }  # fmt: skip
