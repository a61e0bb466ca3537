"""Names of parameters as the labels write them: ``joint2.mcx`` is ``m2 r2x``."""

from __future__ import annotations

from collections.abc import Sequence

from bayesid.robot import inertia


def notation(names: Sequence[str]) -> list[str]:
    """The notation of the labels: ``joint2.mcx`` is ``m2 r2x``; other names stay."""
    bodies = list(dict.fromkeys(n.rpartition(".")[0] for n in names))
    out = []
    for name in names:
        body, _, kind = name.rpartition(".")
        place = bodies.index(body) + 1
        short = f"m{place}" if kind == "m" else f"m{place} r{place}{kind[2:]}" if kind.startswith("mc") else f"I{place}{kind[1:]}"
        out.append(short if body and kind in inertia.PARAMETERS else name)
    return out
