"""A motion that tells rivals apart: in words, as a dictionary and as a table of samples."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from bayesid.design.tell.choose import Pair, Telling
from bayesid.recordings.table import Table, write_table
from bayesid.results.text import number, percent

#: The file that it is written into beside a diagnosis.
NEXT_MOTION = "next_motion.csv"
#: Pairs that a sentence names.
_NAMED = 2


def telling_sentence(telling: Telling, file: str) -> str:
    """What to record and what that will settle, or that no motion does."""
    t = telling
    names = " and ".join([", ".join(t.rivals[:-1]), t.rivals[-1]])
    seconds = f"{number(float(t.trajectory.times[-1] - t.trajectory.times[0]), 3)} s"
    text = f"Record {file} ({seconds}, {t.label}) and fit it together with these motions: "
    text += f"it decides between {names} with probability {chance(t.probability)}"
    text += "" if t.estimated else ", each at its usual size"
    if t.hopeless:
        never = listed_pairs(t.hopeless)
        text += f". Of {t.tried} motions within the joints' limits none tells {never}: another sensor or channel may"
    return f"{text}. Look out for collisions: of limits, only those of position, speed and effort are kept."


def listed_pairs(pairs: tuple[Pair, ...]) -> str:
    """``a from b``, where a is the true one; a few of them."""
    shown = "; ".join(f"{p.true} from {p.other}" for p in pairs[:_NAMED])
    return shown + (f" and {len(pairs) - _NAMED} more" if len(pairs) > _NAMED else "")


def chance(probability: float) -> str:
    """A probability from draws as per cent, never quite certain."""
    return "over 99 %" if probability > 0.99 else "under 1 %" if probability < 0.01 else percent(round(probability, 2))


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
    }  # fmt: skip


def write_motion(telling: Telling, path: Path) -> None:
    """The motion as a table: times, positions and velocities."""
    t = telling.trajectory
    write_table(Table(t.times, t.positions, velocities=t.velocities, source=path.name), path)
