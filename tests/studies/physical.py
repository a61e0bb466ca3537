"""Do the intervals of `sdp` cover, also where links are on the boundary of what can exist?

``python -m tests.studies.physical`` from the repository runs it and writes ``docs/studies/physical``.

Links are drawn about the nominal ones, torques have noise, encoders counts of 1e-5 rad. In the cases *truth on the boundary* the
true links lose extent (in turn a plate, a rod and a point mass), in *nominal on the boundary* the nominal ones do before
the true ones are drawn about them. Every run takes new links, a new motion and new noise; seeds are fixed.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from scipy.stats import binom

from bayesid.dynamics.base_parameters import nearest_links
from bayesid.estimators import Physical, fit
from bayesid.regression.options import FitOptions
from bayesid.regression.problem import prepare
from bayesid.robot.inertia import from_mass_com_inertia, is_physically_consistent
from bayesid.robot.robot import load_robot
from bayesid.simulation.simulation import perturbed_links
from bayesid.tasks import cluster, map_tasks
from tests.robots import ROBOTS, write
from tests.simulated import Motion, experiment, fourier, recording
from tests.studies import page

ROOT = Path(__file__).resolve().parents[2]

#: Arm, noise [N m], spread of the links about the nominal ones, which links have no extent.
CASES = (
    ("ur5", 0.1, 0.2, "none"), ("ur5", 5.0, 0.2, "none"), ("ur5", 5.0, 0.5, "none"), ("panda", 1.0, 0.2, "none"),
    ("ur5", 1.0, 0.2, "true"), ("panda", 1.0, 0.2, "true"), ("ur5", 1.0, 0.2, "nominal"), ("panda", 5.0, 0.2, "nominal"),
)  # fmt: skip
#: Development, and the choice of the largest trust that intervals take in, used 20260000 and following.
SEED = 30_261_000
RUNS = 200
LEVEL, SIMULTANEOUS = 0.95, 0.99


def flattened(links: np.ndarray) -> np.ndarray:
    """In turn without extent in one, two and three directions, mass and centre kept (b, 10)."""
    out = np.empty_like(links)
    for k, body in enumerate(links):
        com = body[1:4] / body[0]
        xx, xy, yy, xz, yz, zz = body[4:]
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        inertia -= body[0] * (com @ com * np.eye(3) - np.outer(com, com))
        values, vectors = np.linalg.eigh(0.5 * np.trace(inertia) * np.eye(3) - inertia)
        values = np.maximum(values, 0.0)
        values[: k % 3 + 1] = 0.0
        second = (vectors * values) @ vectors.T
        out[k] = from_mass_com_inertia(body[0], com, np.trace(second) * np.eye(3) - second)
    return out


def study(name: str, noise: float, spread: float, flat: str, runs: int, seed: int) -> dict[str, Any]:
    """Coverage and error for one case, of all runs and of those with a link on the boundary."""
    with tempfile.TemporaryDirectory() as folder:
        robot = load_robot(write(Path(folder), ROBOTS[name]()))
    if flat == "nominal":
        robot = replace(robot, nominal=flattened(robot.nominal))
    rows: dict[str, list[dict[str, Any]]] = {}
    impossible = []
    for run in range(seed, seed + runs):
        truth = perturbed_links(robot, spread, run)
        truth = (flattened(truth) if flat == "true" else truth).ravel()
        table = recording(robot, None, fourier(robot, run), torque_std=noise, resolution=1e-5, phi=truth, seed=run)
        for trust, label in ((spread, "sdp, trust stated"), (None, "sdp, trust found")):
            made = experiment(robot, [Motion("a", "identification", table)], inertia_rel_std=trust)
            regression = prepare(made, FitOptions("torque")).regression
            true = regression.base.matrix @ truth
            plain, ours = fit(regression, "wls"), fit(regression, Physical())
            if trust is not None:
                links = nearest_links(robot, regression.base, plain.values)
                impossible.append(not is_physically_consistent(links.reshape(-1, 10)).all())
                rows.setdefault("wls", []).append(_row(plain, true, plain.std))
            rows.setdefault(label, []).append(_row(ours, true, plain.std))
    result: dict[str, Any] = {
        "robot": name, "noise": noise, "spread": spread, "without_extent": flat, "runs": runs,
        "plain_links_impossible": float(np.mean(impossible)), "methods": {k: _summary(v) for k, v in rows.items()},
    }  # fmt: skip
    tail = (1.0 - SIMULTANEOUS) / len(true) / 2.0
    result["band"] = [float(q / runs) for q in binom.ppf([tail, 1.0 - tail], runs, LEVEL)]
    return result


def _row(estimate, true: np.ndarray, plain_std: np.ndarray) -> dict[str, Any]:
    certificate = getattr(estimate.details, "certificate", None)
    return {
        "z": (estimate.values - true) / estimate.std,
        "held": (estimate.low <= true) & (true <= estimate.high),
        "z_plain": (estimate.values - true) / plain_std,
        "interval": estimate.interval,
        "boundary": bool(certificate and (certificate.on_boundary or certificate.active_bounds)),
        "certified": certificate.certified if certificate else None,
        "alarm": estimate.details.physics.data_contradict_physics if certificate else None,
    }


def _summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Of one method."""

    def held(chosen: list[dict[str, Any]], key: str) -> dict[str, Any] | None:
        if not chosen:
            return None
        inside = np.mean([r["held"] if key == "z" else np.abs(r[key]) <= 1.96 for r in chosen], axis=0)
        return {"runs": len(chosen), "mean": float(inside.mean()), "lowest": float(inside.min()), "highest": float(inside.max())}

    given = [r for r in rows if r["interval"] != "none"]
    at, off = ([r for r in rows if r["boundary"] is b] for b in (True, False))
    return {
        "links_on_boundary": len(at) / len(rows),
        "intervals": {kind: sum(r["interval"] == kind for r in rows) for kind in sorted({r["interval"] for r in rows})},
        "coverage": held(given, "z"),
        "coverage_on_boundary": held([r for r in given if r["boundary"]], "z"),
        "coverage_inside": held([r for r in given if not r["boundary"]], "z"),
        # What the standard deviations of plain least squares would promise about these estimates.
        "coverage_of_plain_std_on_boundary": held(at, "z_plain"),
        "coverage_of_plain_std_inside": held(off, "z_plain"),
        "rms_error_in_wls_std": float(np.sqrt(np.mean([r["z_plain"] ** 2 for r in rows]))),
        "certified": float(np.mean([r["certified"] for r in rows])) if rows[0]["certified"] is not None else None,
        "false_contradictions": float(np.mean([r["alarm"] for r in rows])) if rows[0]["alarm"] is not None else None,
    }


PAGE = """\
# Intervals of `sdp`

A 95 % interval should hold the truth in 95 of 100 recordings, also when the estimate is held inside the bodies that can exist.
`python -m tests.studies.physical` made this page and [results.json](results.json): {{ runs }} simulated recordings a case,
seeds from {{ seed }}. *Spread* is the relative standard deviation of the true links about the nominal ones. It is stated as
the prior's (*prior stated*), or the prior's is estimated from the data (*prior found*). *Lowest* is that of the worst base
parameter; exact intervals stay within the band for all of them at once with 99 %. *On boundary*: runs in which a link ended on
the boundary of what can exist. *Error* is the root mean square in units of the standard deviation of `wls`.
*Given*: runs in which `sdp` states intervals at all.

| arm | noise [N m] | spread | without extent | method | on boundary | given | coverage | lowest | band | error |
|---|---|---|---|---|---|---|---|---|---|---|
{% for c in cases %}{% for name, m in c.methods.items() -%}
| {{ c.robot }} | {{ c.noise }} | {{ c.spread }} | {{ c.without_extent }} | \
{{ name | replace("trust", "prior") }} | {{ pct(m.links_on_boundary) }} % | \
{{ m.coverage.runs if m.coverage else 0 }} | {{ pct(m.coverage.mean) ~ " %" if m.coverage else "none" }} | \
{{ pct(m.coverage.lowest) ~ " %" if m.coverage else "none" }} | {{ pct(c.band[0]) }}-{{ pct(c.band[1]) }} % | \
{{ "%.2f" | format(m.rms_error_in_wls_std) }} |
{% endfor %}{% endfor %}

Near the boundary the estimate is no longer normally distributed about the truth. Coverage that the intervals of `wls`,
centred on it, would have there:

| arm | noise [N m] | spread | without extent | method | runs on boundary | coverage | lowest |
|---|---|---|---|---|---|---|---|
{% for c in cases %}{% for name, m in c.methods.items() if m.coverage_of_plain_std_on_boundary -%}
{% set held = m.coverage_of_plain_std_on_boundary -%}
| {{ c.robot }} | {{ c.noise }} | {{ c.spread }} | {{ c.without_extent }} | \
{{ name | replace("trust", "prior") }} | {{ held.runs }} | \
{{ pct(held.mean) }} % | {{ pct(held.lowest) }} % |
{% endfor %}{% endfor %}

Without extent: *true*: the true links are in turn plates, rods and point masses, the nominal ones are not; *nominal*: the nominal
ones are, and the true ones have the same shape. The share of runs in which data were wrongly said to contradict physics
was at most {{ pct(alarm) }} % (the test is at 1 %); certified were {{ pct(certified) }} % of all estimates.
"""


def write_page(out: dict[str, Any], docs: Path) -> None:
    """JSON and page."""
    rounded = page.write_numbers(out, docs / "results.json", digits=5)
    methods = [m for c in rounded["cases"] for m in c["methods"].values() if m["certified"] is not None]
    page.write_page(
        PAGE, docs / "README.md", **rounded, alarm=max(m["false_contradictions"] for m in methods),
        certified=float(np.mean([m["certified"] for m in methods])),
    )  # fmt: skip


def main(arguments: list[str]) -> None:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=RUNS)
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--docs", type=Path, default=ROOT / "docs" / "studies" / "physical", help="where the page is written")
    given = parser.parse_args(arguments)
    with cluster(given.processes):
        seeds = [given.seed + 10_000 * k for k in range(len(CASES))]
        cases = list(map_tasks(lambda job: study(*job[0], given.runs, job[1]), zip(CASES, seeds, strict=True)))
    given.docs.mkdir(parents=True, exist_ok=True)
    write_page({"seed": given.seed, "runs": given.runs, "cases": cases}, given.docs)


if __name__ == "__main__":
    main(sys.argv[1:])
