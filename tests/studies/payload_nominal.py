"""Whether intervals of a payload hold the truth that joint torques tell beside a nominal model of a stated trust.

``python -m tests.studies.payload_nominal`` from the repository runs it and writes ``docs/studies/payload-nominal``.

Each recording is of a Puma 560 whose links are a draw of the prior that the trust states, so that the URDF is off by as much as
it says, with friction in every joint and another tool at the flange. No diagnosis is made: the effects are known. Nothing in
bayesid was chosen on them.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

import bayesid
from bayesid.robot import inertia
from bayesid.robot.prior import Prior
from tests.physical_cases import possible_draw
from tests.robots import puma560, write
from tests.simulated import experiment
from tests.studies.page import parsed, write_numbers, write_page
from tests.studies.payload import tool

#: Seed of the recordings that judge; development used others.
SEED = 20_261_129
COUNT = 200
TRUSTS = (0.02, 0.05, 0.1)


def judge(index: int, seed: int) -> dict[str, Any]:
    """What is said of one recording, beside its truth."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(index,)))
    trust = TRUSTS[index % len(TRUSTS)]
    with tempfile.TemporaryDirectory() as folder:
        robot = bayesid.load_robot(write(Path(folder), puma560()))
        links = possible_draw(Prior.warped(robot.nominal, trust), rng).reshape(-1, 10)
        body = tool(rng)
        links[-1] += body
        friction = {}
        for j in range(robot.n):
            friction[f"viscous_friction@joint{j + 1}"] = {"coefficient": float(rng.uniform(0.5, 3.0))}
            friction[f"coulomb_friction@joint{j + 1}"] = {"level": float(rng.uniform(0.3, 3.0))}
        setup = experiment(robot, [], inertia_rel_std=trust, effects=("viscous_friction", "coulomb_friction"))
        path = [bayesid.fourier_trajectory(robot, duration=12.0, seed=int(rng.integers(1 << 30)))]
        recorder = bayesid.Recorder(drive_std=0.005, resolution=1e-5)
        made = bayesid.simulate(setup, path, effects=friction, links=links, recorder=recorder, seed=int(rng.integers(1 << 30)))
        result = bayesid.payload(made, channel="torque", diagnosis=False, progress=None)
    mass, centre, _ = inertia.to_mass_com_inertia(body)
    four = list(zip(result.quantities[:4], [mass, *centre], strict=True))
    return {
        "trust": trust, "mass": float(mass), "shown": [q.shown for q, _ in four],
        "inside": [bool(q.low <= t <= q.high) for q, t in four],
        "half": float(0.5 * (result.mass.high - result.mass.low)), "share": result.nominal_share,
    }  # fmt: skip


def summarise(found: list[dict[str, Any]]) -> dict[str, Any]:
    """What the page shows, by trust."""
    rows = []
    for trust in TRUSTS:
        own = [x for x in found if x["trust"] == trust]
        shown, inside = np.array([x["shown"] for x in own]), np.array([x["inside"] for x in own])
        rows.append({
            "trust": trust, "recordings": len(own), "mass": float(inside[:, 0].mean()), "centre": float(inside[:, 1:].mean()),
            "shown": float(shown[:, 0].mean()), "shown_coverage": float(inside[shown].mean()),
            "half": float(np.median([x["half"] for x in own])), "share": float(np.median([x["share"] for x in own])),
        })  # fmt: skip
    return {"recordings": len(found), "coverage": float(np.mean([x["inside"] for x in found])), "rows": rows}


PAGE = """\
# Payload from joint torques beside a nominal model: do intervals hold?

{{ s.recordings }} simulated recordings from seed {{ seed }}: a Puma 560 moved for 12 s with a tool of 0.1 to 5 kg at the flange, viscous and Coulomb
friction in every joint, no recording without the tool. The true links are a draw of what `inertia_rel_std` states of the URDF's. Effects are
known, no diagnosis is made. `python -m tests.studies.payload_nominal` made this page and [results.json](results.json);
[What hangs at the flange](../../howto/payload.md) says how to use the verb.

| trust in the URDF | recordings | mass covered | centre of mass covered | mass shown | covered where shown | ± of the mass | nominal model's share of its variance |
|---|---|---|---|---|---|---|---|
{% for r in s.rows -%}
| {{ pct(r.trust) }} % | {{ r.recordings }} | {{ pct(r.mass) }} % | {{ pct(r.centre) }} % | {{ pct(r.shown) }} % | {{ pct(r.shown_coverage) }} % | {{ "%.2f" % r.half }} kg | {{ pct(r.share) }} % |
{% endfor %}

In all 95 % intervals hold {{ pct(s.coverage) }} % of masses and centres. Half the interval of the mass is the median. A mass that is not shown has the interval of
what the readings exclude, from zero; its centre of mass then is not bounded, and counts as covered.
"""  # noqa: E501


def write_study(study: dict[str, Any], folder: Path) -> None:
    """Write the page and its numbers."""
    folder.mkdir(parents=True, exist_ok=True)
    rounded = write_numbers(study, folder / "results.json", digits=4)
    write_page(PAGE, folder / "README.md", s=rounded, seed=rounded["seed"])


def main(arguments: list[str]) -> None:
    """Run from the command line."""
    given = parsed(arguments, __doc__, docs="payload-nominal", count=COUNT, of="kind", seed=SEED)
    write_study({"seed": given.seed, **summarise([judge(k, given.seed) for k in range(given.count)])}, given.docs)


if __name__ == "__main__":
    main(sys.argv[1:])
