"""Whether `calibrate` names what a force/torque sensor has, and whether its intervals hold it.

``python -m tests.studies.calibrate`` from the repository runs it and writes ``docs/studies/calibrate-coverage``.

Recordings are those of `tests.studies.payload`, from another seed and with the faults of a sensor alone. The mass that each
carries is told, so that a gain that all force axes share has an interval, too. Nothing in bayesid was chosen on them.
"""

from __future__ import annotations

import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

import bayesid
from tests.studies.page import STUDIES, parsed, write_numbers, write_page
from tests.studies.payload import FAULTS, TIMES, Faults, draw

#: Seed of the recordings that judge; development used others.
SEED = 20_261_130
COUNT = 200
#: A delay shows in motions alone, which are one in five: there it is drawn as often as all else together.
SENSOR: Faults = {
    **{k: v for k, v in FAULTS.items() if "tether" not in k},
    "sensor_translation@sensor": ({"x": 0.002, "y": -0.002, "z": 0.002}, 20.0),
    "sensor_delay@sensor": ({"delay": 0.0005}, 60.0),
}
#: What another centre of mass reads like: it cannot be told, and must not be named.
UNTOLD = "sensor_translation"


def judge(index: int, seed: int) -> dict[str, Any]:
    """What is said of one sensor, beside its truth."""
    with tempfile.TemporaryDirectory() as folder:
        case = draw(index, seed, Path(folder), SENSOR)
        mass = float(case.body[0])
        result = bayesid.calibrate(case.simulation, mass=mass, progress=None)
    found, gain = result.found, result.common_gain
    named = sorted(s for s in found if s != "sensor_offset@sensor")
    assert result.mass is not None
    return {
        "kind": case.kind, "fault": case.fault, "times": case.times, "named": named,
        "told": case.fault in {*named, *(s for n in named for s in result.ambiguous.get(n, ()))},
        "inside": [bool(q.low <= case.values[q.name] <= q.high) for q in found.get(case.fault, ())],
        "offset_inside": [bool(q.low <= t <= q.high) for q, t in zip(found["sensor_offset@sensor"], case.offset, strict=True)],
        "mass_inside": bool(result.mass.low <= mass <= result.mass.high),
        "gain_inside": None if gain is None else bool(gain.low <= 0.0 <= gain.high),
        "gain_half": None if gain is None else float(0.5 * (gain.high - gain.low)),
    }  # fmt: skip


def run(count: int, seed: int, processes: int) -> list[dict[str, Any]]:
    """`judge` of many sensors."""
    if processes == 1:
        return [judge(k, seed) for k in range(count)]
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool:
        return list(pool.map(judge, range(count), [seed] * count, chunksize=4))


def summarise(found: list[dict[str, Any]]) -> dict[str, Any]:
    """What the page shows: names and coverage by fault; offset, mass and common gain over all."""

    def of(own: list[dict[str, Any]]) -> dict[str, Any]:
        return {
            "recordings": len(own),
            "told": _mean([x["told"] for x in own]),
            "alone": _mean([x["named"] == [x["fault"]] for x in own]),
            "coverage": _mean([i for x in own for i in x["inside"]]),
            "offset": _mean([i for x in own for i in x["offset_inside"]]),
            "mass": _mean([x["mass_inside"] for x in own]),
            "gain": _mean([x["gain_inside"] for x in own if x["gain_inside"] is not None]),
        }

    clean = [x for x in found if not x["fault"]]
    large = [x for x in found if x["fault"] and x["times"] > TIMES - 0.01 and not x["fault"].startswith(UNTOLD)]
    faults = {}
    for name in dict.fromkeys(p.partition("@")[0] for p in SENSOR):
        own = [x for x in large if x["fault"].startswith(name)]
        if own:
            faults[name] = of(own)
    origin = [x for x in found if x["fault"].startswith(UNTOLD)]
    halves = [x["gain_half"] for x in found if x["gain_half"] is not None]
    return {
        "recordings": len(found), "without": {**of(clean), "named": _mean([bool(x["named"]) for x in clean])}, "faults": faults,
        "all": of(large), "origin": {"recordings": len(origin), "named": _mean([bool(x["named"]) for x in origin])},
        "smaller": sum(bool(x["fault"]) and x["times"] <= TIMES - 0.01 for x in found if not x["fault"].startswith(UNTOLD)),
        "gain_half": float(np.median(halves)) if halves else None,
    }  # fmt: skip


def _mean(values: list) -> float | None:
    return float(np.mean(values)) if values else None


PAGE = """\
# Calibration: is what a sensor has named, do intervals hold it?

{{ s.recordings }} simulated sensors from seed {{ seed }}, in the wrist of a UR5-like arm with a tool of 0.1 to 5 kg each:
12 to 40 poses at rest, or, of one in five, a motion of 12 s. Noise (0.02 to 0.3 N of one reading) is not stated, offsets are up
to 20 N. Every other one hides a fault, three times as large as the smallest that could be told from noise and no larger than what
is missed by eye. The mass carried is told. `python -m tests.studies.calibrate` made this page and [results.json](results.json);
[Is the force sensor right?](../../howto/calibrate.md) says how to use the verb.

*Named* counts a fault that is told, alone or among names that the recording cannot tell apart, *alone* one that is all that is
named. *Coverage* is that of the 95 % intervals of the fault's own parameters, where it is in the model; of the six offsets; of
the mass carried, without use of what it is known to be; and of the gain that all force axes share, which is none here.

| hidden | sensors | named | alone | coverage | offset | mass | common gain |
|---|---|---|---|---|---|---|---|
| nothing | {{ s.without.recordings }} | {{ p(s.without.named) }} (anything) | | | {{ p(s.without.offset) }} | \
{{ p(s.without.mass) }} | {{ p(s.without.gain) }} |
{% for name, g in s.faults.items() -%}
| `{{ name }}` | {{ g.recordings }} | {{ p(g.told) }} | {{ p(g.alone) }} | {{ p(g.coverage) }} | {{ p(g.offset) }} | \
{{ p(g.mass) }} | {{ p(g.gain) }} |
{% endfor -%}
| all of these | {{ s.all.recordings }} | {{ p(s.all.told) }} | {{ p(s.all.alone) }} | {{ p(s.all.coverage) }} | \
{{ p(s.all.offset) }} | {{ p(s.all.mass) }} | {{ p(s.all.gain) }} |

The common gain is known to ± {{ p(s.gain_half) }} in the median. Without a known mass it cannot be told from a heavier tool, and
nothing here names it. Another origin of the sensor reads like another centre of mass: with it hidden in
{{ s.origin.recordings }} sensors something is named in {{ p(s.origin.named) }}. Smaller faults, {{ s.smaller }} here, are not in
the table.
"""


def write(study: dict[str, Any], folder: Path = STUDIES / "calibrate-coverage") -> None:
    """Write the page and its numbers."""
    folder.mkdir(parents=True, exist_ok=True)
    rounded = write_numbers(study, folder / "results.json", digits=4)
    write_page(PAGE, folder / "README.md", s=rounded, seed=rounded["seed"], p=lambda x: "–" if x is None else f"{100 * x:.1f} %")


def main(arguments: list[str]) -> None:
    """Run from the command line."""
    given = parsed(arguments, __doc__, docs="calibrate-coverage", count=COUNT, of="kind", seed=SEED)
    write({"seed": given.seed, **summarise(run(given.count, given.seed, given.processes))}, given.docs)


if __name__ == "__main__":
    main(sys.argv[1:])
