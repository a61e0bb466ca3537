"""What is certain about a recording, as opposed to what is doubted or guessed."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Finding:
    """Something in the data that is certain: it is told first.

    Attributes
    ----------
    text
        One line: which file and column, what it is, what was done or what to do about it.
    silences
        Channels, ``wrench`` or ``torque``, whose bad fit it explains: no mistake is guessed from their readings.
    """

    text: str
    silences: tuple[str, ...] = ()
