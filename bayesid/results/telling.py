"""A motion that tells rivals apart: what ``excite --tell`` found, in words, as a dictionary and as a table of samples."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

from bayesid.design.tell.choose import RivalPair, Telling
from bayesid.results.files import SCHEMA, Files, ShownResult
from bayesid.rounding import number, percent
from bayesid.section import ShownTable
from bayesid.simulation.trajectories import write_trajectory

#: The file that it is written into beside a diagnosis.
NEXT_MOTION = "next_motion.csv"
#: Pairs that a sentence names.
_NAMED = 2
#: The motion's file.
TRAJECTORY = "trajectory.csv"


def telling_sentence(telling: Telling, file: str) -> str:
    """What to record and what that will settle, or that no motion does."""
    t = telling
    text = f"Record {file} ({duration(t)}, {t.label}) and fit it together with these motions: "
    text += f"it decides between {listed_names(t.rivals)} with probability {chance(t.probability)}"
    text += "" if t.estimated else ", each at its usual size"
    return f"{text}.{_hopeless(t)}"


def _hopeless(t: Telling) -> str:
    """Which rivals no motion tells apart; nothing where there are none."""
    return (
        f" Of {t.tried} motions within the limits none tells {listed_pairs(t.hopeless)}: another sensor or channel may."
        if t.hopeless
        else ""
    )


def duration(telling: Telling) -> str:
    """How long the motion takes."""
    return f"{number(float(telling.trajectory.times[-1] - telling.trajectory.times[0]), 3)} s"


def listed_names(names: tuple[str, ...]) -> str:
    """Rivals in a sentence; semicolons where a rival is several effects."""
    comma = "; " if any(", " in name for name in names) else ", "
    return f"{comma.join(names[:-1])} and {names[-1]}"


def listed_pairs(pairs: tuple[RivalPair, ...]) -> str:
    """``a from b``, where a is the true one; a few of them."""
    shown = "; ".join(f"{p.true} from {p.other}" for p in pairs[:_NAMED])
    return shown + (f" and {len(pairs) - _NAMED} more" if len(pairs) > _NAMED else "")


def chance(probability: float) -> str:
    """A probability from draws as per cent, never quite certain."""
    return "over 99 %" if probability > 0.99 else "under 1 %" if probability < 0.01 else percent(probability, 2)


def pair_table(telling: Telling) -> ShownTable:
    """Each rival as the true one, and each other that it rules out."""
    rows = [
        [p.true, p.other, number(p.noncentrality, 3), f"{number(p.gain, 3)} ± {number(p.std, 2)}", chance(p.probability)]
        for p in telling.pairs
    ]
    return ShownTable(["if true", "rules out", "noncentrality", "log evidence", "probability"], rows, "k k n n nb")


def telling_dict(telling: Telling, file: str) -> dict[str, Any]:
    """For the JSON file: the motion's file, the probabilities, and every pair."""
    t = telling
    return {
        "file": file,
        "motion": t.label,
        "duration": float(t.trajectory.times[-1] - t.trajectory.times[0]),
        "probability": t.probability,
        "wrong": t.wrong,
        "sizes": "estimated" if t.estimated else "usual",
        "rivals": [{"effects": name, "probability": w} for name, w in zip(t.rivals, t.weights, strict=True)],
        "pairs": [
            {
                "true": p.true, "other": p.other, "noncentrality": p.noncentrality, "log_bayes_factor": p.gain,
                "log_bayes_factor_std": p.std, "probability": p.probability,
            }
            for p in t.pairs
        ],
        "tried": t.tried,
        "notes": list(t.notes),
    }  # fmt: skip


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

    verb, report = "excite", "excitation"
    name: str
    channel: str
    recordings: tuple[str, ...]
    telling: Telling
    seconds: dict[str, float]

    def _beside(self) -> Files:
        return {TRAJECTORY: partial(write_trajectory, self.telling.trajectory)}

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
        return text + _hopeless(t)

    def _parts(self) -> list[str | ShownTable]:
        return [f"{self.name}: {self.lead}", pair_table(self.telling)]

    def to_dict(self) -> dict[str, Any]:
        """What ``excitation.json`` holds."""
        return {
            "schema": SCHEMA, "experiment": self.name, "channel": self.channel, "recordings": list(self.recordings),
            "tell": telling_dict(self.telling, TRAJECTORY), "runtime_s": dict(self.seconds),
        }  # fmt: skip
