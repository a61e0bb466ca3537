"""How often 95 % intervals hold the truth, and how close estimates come to the Cramér-Rao bound.

``python -m tests.studies.interval_coverage`` from the repository runs it and writes ``docs/studies/coverage``.
A run that was stopped goes on where it was. `coverage_case` says what is simulated.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
import tempfile
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from jinja2 import Environment, StrictUndefined
from matplotlib.figure import Figure
from rich.console import Console
from rich.progress import track
from scipy.stats import binom, norm

import bayesid
from bayesid.tasks import cluster, map_tasks
from tests.studies import coverage_case
from tests.studies.coverage_case import ARMS, FITS, WHITE, bound, fit_all, setup

#: Seed of the recordings that judge; development used others.
SEED = 20_260_101
COUNT = 2000
LEVEL, SIMULTANEOUS = 0.95, 0.99
CHUNK = 20
FOLDER = Path(__file__).parents[2] / "docs" / "studies" / "coverage"
NAMES = {"puma": "two-joint PUMA, static run", "ur5": "UR5, no static run"}


def _sources() -> str:
    """Fingerprint of the code that the results depend on, so that a stale run is not gone on with."""
    package = Path(bayesid.__file__).parent
    parts = ("robot", "signals", "dynamics", "regression", "effects", "estimators")
    files = [file for part in parts for file in sorted((package / part).rglob("*.py"))]
    digest = hashlib.sha256()
    for file in [*files, Path(coverage_case.__file__), Path(coverage_case.__file__).parents[1] / "robots.py"]:
        digest.update(file.read_bytes())
    return digest.hexdigest()[:12]


def _chunk(name: str, seed: int, first: int, last: int) -> tuple[np.ndarray, ...]:
    """Recordings first ... last - 1: errors, standard deviations, joint statistics."""
    # Recording k has the same draws however many recordings there are and whichever process makes it.
    sequences = [np.random.SeedSequence(seed, spawn_key=(list(ARMS).index(name), k)) for k in range(first, last)]
    return tuple(np.array(part) for part in zip(*(fit_all(setup(name), s) for s in sequences), strict=True))


def run(name: str, count: int, seed: int, folder: Path | None = None, processes: int = 2) -> tuple[np.ndarray, ...]:
    """Errors and standard deviations (count, fits, r) and joint statistics (count, fits, 2) of many recordings.

    Parameters
    ----------
    name
        One of `ARMS`.
    count, seed
        How many recordings, drawn from what.
    folder
        Where finished chunks are kept; None: nowhere.
    processes
        How many work at once; with one, this process does.
    """
    parts: dict[int, tuple[np.ndarray, ...]] = {}

    def path(first: int) -> Path:
        assert folder is not None
        return folder / f"{name}-{seed}-{first}-{min(first + CHUNK, count)}.npz"

    def keep(first: int, part: tuple[np.ndarray, ...]) -> None:
        parts[first] = part
        if folder is not None:
            draft = path(first).with_suffix(".part.npz")
            np.savez(draft, *part)
            draft.replace(path(first))

    for first in range(0, count, CHUNK) if folder is not None else ():
        if path(first).exists():
            with np.load(path(first)) as stored:
                parts[first] = tuple(stored[key] for key in stored.files)
    todo = [first for first in range(0, count, CHUNK) if first not in parts]
    console = Console(stderr=True)
    show = {"description": name, "total": len(todo), "console": console, "disable": not console.is_terminal}
    with cluster(processes):
        made = map_tasks(lambda first: _chunk(name, seed, first, min(first + CHUNK, count)), todo)
        for first, part in zip(todo, track(made, **show), strict=True):
            keep(first, part)
    return tuple(np.concatenate(column) for column in zip(*(parts[k] for k in sorted(parts)), strict=True))


def band(count: int, parameters: int) -> tuple[float, float]:
    """Coverage that exact intervals keep to with 99 % for all parameters at once (Bonferroni, binomial)."""
    tail = (1.0 - SIMULTANEOUS) / parameters / 2.0
    return float(binom.ppf(tail, count, LEVEL) / count), float(binom.ppf(1.0 - tail, count, LEVEL) / count)


def summarise(name: str, results: tuple[np.ndarray, ...]) -> dict[str, Any]:
    """What the page shows of one arm, ready for JSON."""
    error, std, joint = results
    count, _, parameters = error.shape
    bounds = bound(name)
    z = error / std
    inside = np.abs(z) <= norm.ppf(0.5 + LEVEL / 2)
    rms = np.sqrt(np.mean(error**2, axis=0))
    fits = {}
    for k, fit in enumerate([*FITS, *WHITE]):
        fits[fit] = {
            "coverage": inside[:, k].mean(axis=0).tolist(),
            "z_mean": z[:, k].mean(axis=0).tolist(),
            "z_std": z[:, k].std(axis=0).tolist(),
            "rms_over_sensor_bound": (rms[k] / bounds.sensor).tolist(),
            "rms_over_encoder_bound": (rms[k] / bounds.encoder).tolist(),
        }
        if k < len(FITS):
            fits[fit] |= {
                "mean_chi2_per_parameter": float(joint[:, k, 0].mean() / parameters),
                "called_complete": float(joint[:, k, 1].mean()),
            }
    return {
        "recordings": count,
        "parameters": list(coverage_case.base(name).labels),
        "band": band(count, parameters),
        "bound_of_both_runs_over_sensor_bound": (bounds.both_runs / bounds.sensor).tolist(),
        "fits": fits,
    }


def draw(study: dict[str, Any]) -> Figure:
    """Coverage of every parameter beside the band; white-noise intervals below."""
    figure = Figure(figsize=(9.0, 6.4), layout="constrained")
    rows = figure.subplots(2, len(study["arms"]), height_ratios=(3, 2), squeeze=False)
    marks = {"default": ("o", "C0"), "l = 1, d = 50, default": ("s", "C1"), "l = 1, d = 50, ols": ("^", "C2")}
    for column, (name, arm) in enumerate(study["arms"].items()):
        top, bottom = rows[:, column]
        at = np.arange(1, len(arm["parameters"]) + 1)
        top.axhspan(*(100 * edge for edge in arm["band"]), color="0.9", label="99 % band, all parameters at once")
        top.axhline(100 * LEVEL, color="0.4", lw=0.8)
        for fit, (mark, colour) in marks.items():
            top.plot(at, 100 * np.array(arm["fits"][fit]["coverage"]), mark, color=colour, ms=4, label=fit)
        for fit, colour in zip(WHITE, ("C0", "C3"), strict=True):
            bottom.plot(at, 100 * np.array(arm["fits"][fit]["coverage"]), "x", color=colour, ms=5, label=fit)
        bottom.axhline(100 * LEVEL, color="0.4", lw=0.8)
        top.set(title=NAMES[name], ylim=(92, 98))
        bottom.set(ylim=(0, 103), xlabel="base parameter")
    top, bottom = rows[:, 0]
    top.set_ylabel("coverage of 95 % intervals [%]")
    bottom.set_ylabel("the same for\nwhite-noise intervals [%]")
    handles = [pair for axes in (top, bottom) for pair in zip(*axes.get_legend_handles_labels(), strict=True)]
    figure.legend(*zip(*handles, strict=True), loc="outside lower center", ncols=3, fontsize=9)
    return figure


PAGE = """\
# Coverage

A 95 % interval should hold the truth in 95 of 100 recordings. Here the truth is known: {{ count }} simulated recordings of
each robot, all from seed {{ seed }}. `python -m tests.studies.interval_coverage` made this page, its figure and
[results.json](results.json); `make test-slow` repeats the study and holds it against them.

![Coverage of each base parameter](coverage.svg)
{% for name, arm in arms.items() %}

## {{ names[name] }}

{{ arm.parameters | length }} base parameters. If every interval were exact, all coverages at once would lie within
**{{ pct(arm.band[0]) }} to {{ pct(arm.band[1]) }} %** with probability 99 %.

| fit | lowest | mean | highest | within the band | error / deviation | error / bound, median | highest |
|---|---|---|---|---|---|---|---|
{% for fit, f in arm.fits.items() -%}
| {{ fit }} | {{ pct(f.coverage | min) }} | {{ pct(f.coverage | sum / f.coverage | length) }} | {{ pct(f.coverage | max) }} | \
{{ "**below**" if f.coverage | min < arm.band[0] else "above" if f.coverage | max > arm.band[1] else "yes" }} | \
{{ "%.2f" | format(f.z_std | sum / f.z_std | length) }} | \
{{ "%.3f" | format(median(f.rms_over_sensor_bound)) }} | {{ "%.3f" | format(f.rms_over_sensor_bound | max) }} |
{% endfor %}

Largest mean of the standardised errors: {{ "%.3f" | format(bias(arm)) }} at the default
(1 would be a bias of a whole standard deviation; chance alone gives about {{ "%.2f" | format(3 / count ** 0.5) }}).
{% endfor %}

## How to read it

`default` is what `bayesid identify` does by itself. `l = 1, d = 50` adds the paper's two low-passes, in front of the default
method, of plain (`ols`) and of generalised least squares (`gls`). Coverage is in per cent, *error* is the root mean square
over all recordings, and the *bound* is Cramér and Rao's: no unbiased estimate can have a smaller error. *Error / deviation* is
the scatter of the errors in units of the standard deviations that were stated, mean of all parameters: 1 where these are exact.

**Behind the paper's low-pass intervals are up to an eighth wider than need be.** They count how far the estimate scatters
between parts of the recording where that is more than the noise says, as it is on real robots. Of a complete model every other
recording shows a little more by chance, and noise that a low-pass carries from one part to the next seems to be such scatter.

**White-noise intervals** are the textbook's `s² (X'X)⁻¹` on every sample's row. Without a low-pass the noise of the rows is
white and they are right; behind l = 1 rad/s neighbouring rows share most of their noise, and intervals that ignore it
are several times too short.

**The bound** takes the true trajectory as known and counts the sensor's noise on all {{ samples }} samples, also those at both
ends that the smoothing leaves out. Mapping the encoder's noise to the wrench as well raises it by less than
{{ "%.0e" | format(encoder) }}: rounding to {{ resolution }} rad matters little at these speeds. For that the trajectory is
unknown within its family, mean and five harmonics a joint, the counts are taken as white noise of variance count²/12, and
what the wrench inherits through its derivatives by position, velocity and acceleration is added to the sensor's covariance.

**The PUMA's bound is that of the motion wrench,** moving less static readings, as in the paper: gravity and offset go, the noise
of two readings stays. Gravity tells much about first moments, and subtracting throws that away. Fitting both runs
together (`static="joint"`) has a bound between {{ "%.2f" | format(both | min) }} and {{ "%.2f" | format(both | max) }} times
as large.

## What is simulated

Motions of 0.1 Hz with five harmonics, 20 s, 125 Hz, one for each robot, scaled to 0.9 of the joints' limits or 2 rad/s.
Sensor: white noise of 0.5 N and 0.1 N m and a constant offset, both new in each recording; the static run has noise of its
own. Encoder: counts of 2e-5 rad, no velocities. The same motion would be rounded in the same way each time, so every
recording starts a random part of a sample later and runs a random part of a count beside the others. The truth differs from
the nominal robot by about a tenth of every body's size. Models are complete: what happens when an effect is missing is not
shown here. `tests/studies/coverage_case.py` is all of it.
"""


def write(study: dict[str, Any], folder: Path) -> None:
    """Write the page, its numbers and its figure."""
    folder.mkdir(parents=True, exist_ok=True)
    rounded = json.loads(json.dumps(study), parse_float=lambda text: float(f"{float(text):.5g}"))
    (folder / "results.json").write_text(json.dumps(rounded, indent=1) + "\n", encoding="utf-8")
    environment = Environment(undefined=StrictUndefined, trim_blocks=True, keep_trailing_newline=True, autoescape=False)
    first = next(iter(rounded["arms"].values()))
    ratios = [
        np.array(f["rms_over_sensor_bound"]) / f["rms_over_encoder_bound"] - 1
        for arm in study["arms"].values()
        for f in arm["fits"].values()
    ]
    text = environment.from_string(PAGE).render(
        arms=rounded["arms"], names=NAMES, seed=study["seed"], count=first["recordings"],
        samples=round(coverage_case.RATE * coverage_case.DURATION), resolution="2e-5",
        encoder=10.0 ** np.ceil(np.log10(max(r.max() for r in ratios))),
        both=rounded["arms"]["puma"]["bound_of_both_runs_over_sensor_bound"],
        pct=lambda x: f"{100 * x:.1f}", median=lambda values: float(np.median(values)),
        bias=lambda arm: float(np.abs(arm["fits"]["default"]["z_mean"]).max()),
    )  # fmt: skip
    (folder / "README.md").write_text(text, encoding="utf-8")
    with matplotlib.rc_context({"svg.hashsalt": "coverage"}):
        draw(rounded).savefig(folder / "coverage.svg", metadata={"Date": None})


def study(count: int = COUNT, seed: int = SEED, folder: Path | None = None, processes: int = 2) -> dict[str, Any]:
    """Run everything."""
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
    return {"seed": seed, "arms": {name: summarise(name, run(name, count, seed, folder, processes)) for name in ARMS}}


def kept() -> Path:
    """Where finished chunks of this very code are kept."""
    return Path(tempfile.gettempdir()) / f"bayesid-coverage-{_sources()}"


def main(arguments: list[str]) -> None:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=COUNT, help="recordings of each robot")
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--out", type=Path, default=None, help="where finished chunks are kept (a temporary folder)")
    parser.add_argument("--docs", type=Path, default=FOLDER, help="where the page is written")
    given = parser.parse_args(arguments)
    write(study(given.count, given.seed, given.out or kept(), given.processes), given.docs)


if __name__ == "__main__":
    main(sys.argv[1:])
