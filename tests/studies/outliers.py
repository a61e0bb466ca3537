"""What hammer taps and a contact do to estimates, and whether robust estimators and their intervals hold.

``python -m tests.studies.outliers`` from the repository runs it and writes ``docs/studies/outliers``.

Recordings are those of `coverage_case`; each is fitted as it is and with what `disturb` adds to its readings.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from bayesid import estimators
from bayesid.recordings.experiment import Experiment
from bayesid.regression.options import FitOptions
from bayesid.regression.problem import prepare
from bayesid.tasks import cluster, map_tasks
from tests.studies.coverage_case import ARMS, DURATION, PAPER, record, setup
from tests.studies.interval_coverage import LEVEL, NAMES, band
from tests.studies.page import STUDIES, parsed, write_numbers, write_page

#: Seed of the recordings that judge; development used others.
SEED = 20_260_303
COUNT = 200
TAPS = 5
#: Fits: name -> whether the recording is disturbed, filters, method.
FITS = {
    "clean, wls": (False, None, "wls"),
    "clean, huber": (False, None, "huber"),
    "clean, student": (False, None, "student"),
    "disturbed, ols": (True, None, "ols"),
    "disturbed, wls": (True, None, "wls"),
    "disturbed, huber": (True, None, "huber"),
    "disturbed, student": (True, None, "student"),
    "disturbed, l = 1, d = 50, huber": (True, PAPER, "huber"),
    "disturbed, l = 1, d = 50, student": (True, PAPER, "student"),
}
ROBUST = ("huber", "student")


def disturb(experiment: Experiment, rng: np.random.Generator) -> tuple[Experiment, np.ndarray]:
    """The experiment with taps and a contact in its readings, and when something touches the arm.

    Each comes at a random time, from a random direction, at a random point within 0.5 m of (0, 0, 0.5) m: `TAPS` half sines
    of 100 to 300 N and 10 to 40 ms, and 1 s of 20 to 60 N with ramps of 0.2 s.
    """
    (motion,) = experiment.motions
    table = motion.table
    times, wrench, touched = table.times, np.array(table.wrench), []

    def touch(start: float, length: float, force: float, shape: np.ndarray) -> None:
        direction = rng.normal(size=3)
        direction /= np.linalg.norm(direction)
        point = np.array([0.0, 0.0, 0.5]) + rng.uniform(-0.5, 0.5, 3)
        wrench[:] += force * shape[:, None] * np.concatenate([direction, np.cross(point, direction)])
        touched.append((start, start + length))

    for _ in range(TAPS):
        start, length = rng.uniform(0.5, DURATION - 0.5), rng.uniform(0.01, 0.04)
        phase = np.clip((times - start) / length, 0.0, 1.0)
        touch(start, length, rng.uniform(100.0, 300.0), np.sin(np.pi * phase))
    start = rng.uniform(1.0, DURATION - 2.0)
    ramp = np.clip(np.minimum(times - start, start + 1.0 - times) / 0.2, 0.0, 1.0)
    touch(start, 1.0, rng.uniform(20.0, 60.0), ramp)
    return replace(experiment, motions=(replace(motion, table=replace(table, wrench=wrench)),)), np.array(touched)


def fit_all(name: str, seed: int, index: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Errors and standard deviations (fits, r), and what was rejected (fits, 2).

    Rejected: share of rows, and share of the touches whose middle lies in a rejected window.
    """
    case = setup(name)
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(list(ARMS).index(name), index)))
    clean = record(case, rng)
    disturbed, touched = disturb(clean, rng)
    problems: dict[Any, Any] = {}
    errors, stds, rejected = [], [], []
    for touch, filters, method in FITS.values():
        key = (touch, filters is not None)
        if key not in problems:
            problems[key] = prepare(disturbed if touch else clean, FitOptions(low_pass=filters))
        problem = problems[key]
        estimate = estimators.fit(problem.regression, method)
        errors.append(estimate.values - problem.row_model.base.matrix @ case.truth)
        stds.append(estimate.std)
        spans = [span for spans in estimate.details.to_dict().get("rejected_windows", {}).values() for span in spans]
        half = 0.5 * problem.row_model.step
        found = [any(a - half <= 0.5 * (start + end) <= b + half for a, b in spans) for start, end in touched]
        rejected.append([estimate.details.to_dict().get("rejected_share", 0.0), float(np.mean(found))])
    return np.array(errors), np.array(stds), np.array(rejected)


def _many(name: str, seed: int, indices: range) -> list[tuple[np.ndarray, ...]]:
    return [fit_all(name, seed, k) for k in indices]


def run(name: str, count: int, seed: int, processes: int = 2) -> tuple[np.ndarray, ...]:
    """`fit_all` of many recordings, stacked."""
    chunks = [range(k, min(k + 10, count)) for k in range(0, count, 10)]
    with cluster(processes):
        parts = list(map_tasks(partial(_many, name, seed), chunks))
    return tuple(np.array(column) for column in zip(*(one for part in parts for one in part), strict=True))


def summarise(results: tuple[np.ndarray, ...]) -> dict[str, Any]:
    """What the page shows of one robot.

    The error of a fit is the root mean square, over all recordings and base parameters, of errors in units of the standard
    deviation of `wls` on the same recording undisturbed.
    """
    error, std, rejected = results
    count, _, parameters = error.shape
    unit = std[:, :1]
    relative = np.sqrt(np.mean((error / unit) ** 2, axis=(0, 2)))
    each = np.sqrt(np.mean((error / unit) ** 2, axis=0))
    inside = np.mean(np.abs(error) <= 1.959964 * std, axis=0)
    shown = np.sqrt(np.mean((std / unit) ** 2, axis=(0, 2)))
    names = list(FITS)
    fits = {}
    for k, name in enumerate(names):
        method = name.split(", ")[-1]
        own = names.index(f"clean, {method}") if f"clean, {method}" in names else 0
        fits[name] = {
            "error": float(relative[k]),
            "error_over_clean": float(relative[k] / relative[own]),
            "largest_error_over_clean": float(np.max(each[k] / each[own])),
            "stated_std": float(shown[k]),
            "coverage": inside[k].tolist(),
            "rejected_share": float(rejected[:, k, 0].mean()),
            "touches_rejected": float(rejected[:, k, 1].mean()),
        }
    return {"recordings": count, "parameters": parameters, "band": band(count, parameters), "fits": fits}


PAGE = """\
# Taps and contacts

External forces disturb the recording: {{ taps }} hammer taps (half sines of 100 to 300 N, 10 to 40 ms) and one
contact (1 s, 20 to 60 N, ramps of 0.2 s) in 20 s, at random times, points and directions. {{ count }} simulated recordings of
each robot from seed {{ seed }}, each fitted undisturbed (*clean*) and *disturbed*. `python -m tests.studies.outliers`
made this page and [results.json](results.json). Motions, sensor and noise are those of [coverage](../coverage/README.md).

*Error* is the root mean square over all recordings and base parameters, in units of the standard deviation of `wls` on the
clean recording. *Over clean* divides it by the same method's error on clean recordings (`wls` for `ols`); *worst* is the
parameter with the largest such ratio. *Stated* is the standard deviation that the estimates state, in the same unit.
*Rejected* is the share of rows without weight, *found* the share of the taps and contacts that lie in a rejected window.
{% for name, arm in arms.items() %}

## {{ names[name] }}

{{ arm.parameters }} base parameters. If every interval were exact, all coverages at once would lie within
{{ pct(arm.band[0]) }} to {{ pct(arm.band[1]) }} % with probability 99 %.

| fit | error | over clean | worst | stated | coverage, lowest | mean | highest | rejected | found |
|---|---|---|---|---|---|---|---|---|---|
{% for fit, f in arm.fits.items() -%}
| {{ fit }} | {{ three(f.error) }} | {{ three(f.error_over_clean) }} | {{ three(f.largest_error_over_clean) }} | \
{{ three(f.stated_std) }} | {{ pct(f.coverage | min) }} | {{ pct(f.coverage | sum / f.coverage | length) }} | \
{{ pct(f.coverage | max) }} | {{ pct(f.rejected_share) }} % | \
{{ pct(f.touches_rejected) + " %" if "disturbed" in fit and f.rejected_share else "" }} |
{% endfor %}
{% endfor %}

## How to read it

Part of the recording is unusable, so no method can reach 1 on disturbed recordings: rejecting a share $r$ of the rows increases
the error by a factor of about $1/\\sqrt{1 - r}$, and more for parameters that mainly the rejected rows determine.

The intervals of `ols` and `wls` on disturbed recordings hold the truth nearly as often as they should, but only because they
are more than {{ wide }} times as wide: taps and contacts count as noise. After a low-pass of 1 rad/s a tap lasts for seconds;
`huber` and `student` invert the filter's known recursion before they search for it.

Not measured here: the weakest disturbance that is still found, and the effect of the disturbance on the motion; the controllers
are assumed to hold the joints. Disturbances that fill more than half of a recording cannot be distinguished from the robot.
"""


def write(study: dict[str, Any], folder: Path = STUDIES / "outliers") -> None:
    """Write the page and its numbers."""
    folder.mkdir(parents=True, exist_ok=True)
    rounded = write_numbers(study, folder / "results.json", digits=5)
    arms = rounded["arms"]
    widths = [arm["fits"][f"disturbed, {m}"]["stated_std"] for arm in arms.values() for m in ("ols", "wls")]
    write_page(
        PAGE, folder / "README.md", arms=arms, names=NAMES, seed=study["seed"], taps=TAPS,
        count=next(iter(arms.values()))["recordings"], wide=int(min(widths) // 10 * 10), three=lambda x: f"{x:.3g}",
    )  # fmt: skip


def study(count: int = COUNT, seed: int = SEED, processes: int = 2) -> dict[str, Any]:
    """Run everything."""
    return {"seed": seed, "level": LEVEL, "arms": {name: summarise(run(name, count, seed, processes)) for name in ARMS}}


def main(arguments: list[str]) -> None:
    """Run from the command line."""
    given = parsed(arguments, __doc__, docs="outliers", count=COUNT, of="robot", seed=SEED)
    write(study(given.count, given.seed, given.processes), given.docs)


if __name__ == "__main__":
    main(sys.argv[1:])
