"""What encoder noise of 1e-3 rad does to estimates, and which estimators undo it.

``python -m tests.studies.encoder_noise`` from the repository runs it and writes ``docs/studies/encoder-noise``.
Robots, motions, truth and sensor noise are those of `coverage_case`; the encoders differ: white noise instead of counts.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import norm
from threadpoolctl import threadpool_limits

from bayesid import estimators
from bayesid.dynamics.regressors import Kernel
from bayesid.recordings.experiment import Experiment, Motion, Sensor, Table
from bayesid.regression.options import FitOptions
from bayesid.regression.problem import prepare
from bayesid.regression.readings import make_channels
from bayesid.tasks import cluster, map_tasks
from tests.studies.coverage_case import DURATION, FUNDAMENTAL, NOISE, OFFSET, RATE, Setup, setup
from tests.studies.interval_coverage import LEVEL, NAMES, band
from tests.studies.page import STUDIES, parsed, write_numbers, write_page

SEED = 20_260_201
COUNT = 100
STD = 1e-3  # [rad]
#: How far the commanded trajectory is ahead of the robot, as with a drive that lags [s].
LEAD = 0.02
#: Share of the bias of `ols` that an estimator should remove.
ENOUGH = 0.8

#: Robot and bandwidth of the joint motion [Hz]; None: chosen from the data.
CASES: dict[str, tuple[str, float | None]] = {
    "puma, automatic": ("puma", None),
    "puma, 5 Hz": ("puma", 5.0),
    "ur5, automatic": ("ur5", None),
    "ur5, 5 Hz": ("ur5", 5.0),
}
#: Estimators, and what the recording tells beside positions and readings.
FITS: dict[str, tuple[str, str]] = {
    "ols": ("ols", ""),
    "wls (default)": ("wls", ""),
    "gls": ("gls", ""),
    "tls": ("tls", ""),
    "iv, commanded trajectory": ("iv", "commanded"),
    "iv, other period": ("iv", "period"),
    "iv, even and odd samples": ("iv", ""),
}


def record(case: Setup, rng: np.random.Generator) -> dict[str, Experiment]:
    """One simulated recording: bare, with the commanded trajectory, and with its period stated."""
    times = np.arange(round(RATE * DURATION)) / RATE
    start = rng.uniform(0.0, 1.0 / RATE)
    q, v, a = case.trajectory(times + start)
    bare = Experiment(case.arm.name, case.robot, (), Sensor(), position_std=STD)
    channels = make_channels(bare, "wrench")
    constant = channels.static_wrench + OFFSET * rng.uniform(-1.0, 1.0, 6)

    def reading(v, a):
        exact = Kernel.of(case.robot, channels).dynamics(q, v, a) @ case.truth
        return exact + constant + NOISE * rng.normal(size=exact.shape)

    # A static run's encoders are read anew; only the moving ones are used.
    noisy = q + STD * rng.normal(size=q.shape)
    table = Table(times, noisy, wrench=reading(v, a))
    still = Table(times, noisy, wrench=reading(0 * v, 0 * a)) if case.arm.static else None
    motion = Motion("fourier", "identification", table, static=still)
    commanded = replace(motion, table=replace(table, commanded=case.trajectory(times + start + LEAD)[0]))
    period = replace(motion, period=1.0 / FUNDAMENTAL)
    kinds = {"": motion, "commanded": commanded, "period": period}
    return {kind: replace(bare, motions=(m,)) for kind, m in kinds.items()}


def one(name: str, seed: int, k: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Errors and standard deviations (fits, r) of recording k, and p of the Durbin-Wu-Hausman tests (fits,)."""
    arm, bandwidth = CASES[name]
    case = setup(arm)
    experiments = record(case, np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(list(CASES).index(name), k))))
    errors, stds, tests = [], [], []
    with threadpool_limits(1, user_api="blas"):
        problems = {kind: prepare(e, FitOptions(bandwidth=bandwidth)) for kind, e in experiments.items()}
        for method, kind in FITS.values():
            problem = problems[kind]
            estimate = estimators.fit(problem.regression, method)
            errors.append(estimate.values - problem.row_model.base.matrix @ case.truth)
            stds.append(estimate.std)
            tests.append(estimate.details.to_dict().get("durbin_wu_hausman", {}).get("p", np.nan))
    return np.array(errors), np.array(stds), np.array(tests)


def chosen(name: str, seed: int) -> float:
    """Bandwidth of the joint motion in the first recording [Hz]."""
    arm, bandwidth = CASES[name]
    recording = record(setup(arm), np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(list(CASES).index(name), 0))))
    return float(prepare(recording[""], FitOptions(bandwidth=bandwidth)).smoother.bandwidth)


def summarise(errors: np.ndarray, stds: np.ndarray, tests: np.ndarray) -> dict[str, Any]:
    """Bias, scatter and coverage of every fit; the unit of a bias is the scatter of `wls`, parameter by parameter."""
    count, _, parameters = errors.shape
    unit = errors[:, 1].std(axis=0, ddof=1)
    fits: dict[str, Any] = {}
    for k, fit in enumerate(FITS):
        bias, scatter = errors[:, k].mean(axis=0) / unit, errors[:, k].std(axis=0, ddof=1) / unit
        inside = (np.abs(errors[:, k]) <= norm.ppf(0.5 + LEVEL / 2) * stds[:, k]).mean(axis=0)
        fits[fit] = {
            "bias": float(np.sqrt(np.mean(bias**2))), "chance": float(np.sqrt(np.mean(scatter**2) / count)),
            "rms_error": float(np.sqrt(np.mean(bias**2 + scatter**2))),
            "coverage": {"mean": float(inside.mean()), "lowest": float(inside.min()), "highest": float(inside.max())},
        }  # fmt: skip
        if np.isfinite(tests[:, k]).all():
            fits[fit]["encoder_noise_seen"] = float(np.mean(tests[:, k] < 0.01))
    for fit in fits.values():
        fit["removed_of_ols"] = 1.0 - fit["bias"] / fits["ols"]["bias"]
    return {"recordings": count, "parameters": parameters, "band": band(count, parameters), "fits": fits}


def study(count: int = COUNT, seed: int = SEED, processes: int = 2, cases: tuple[str, ...] = tuple(CASES)) -> dict[str, Any]:
    """Run everything."""
    out = {}
    for name in cases:
        with cluster(processes):
            results = list(map_tasks(partial(one, name, seed), range(count)))
        summary = summarise(*(np.array(column) for column in zip(*results, strict=True)))
        out[name] = {"bandwidth": chosen(name, seed), **summary}
    return {"seed": seed, "encoder_std": STD, "cases": out}


PAGE = """\
# Encoder noise

White encoder noise of {{ std }} rad on every sample, some fifty counts of a good encoder. Robots, motions (20 s, 125 Hz) and
sensor noise are those of [coverage](../coverage/README.md). `python -m tests.studies.encoder_noise` made this page and
[results.json](results.json) from seed {{ seed }}; `make test-slow` repeats a part of it.
{% for name, case in cases.items() %}

## {{ names[name.split(",")[0]] }}, {{ name.split(", ")[1] }} bandwidth

{{ case.recordings }} recordings, {{ case.parameters }} base parameters, {{ "%.3g" | format(case.bandwidth) }} Hz. If every
interval were exact, all coverages would lie within {{ pct(case.band[0]) }} to {{ pct(case.band[1]) }} % with probability 99 %.

| fit | bias | chance | bias of `ols` removed | rms error | coverage: mean | lowest | highest |
|---|---|---|---|---|---|---|---|
{% for fit, f in case.fits.items() -%}
| {{ fit }} | {{ "%.3f" | format(f.bias) }} | {{ "%.3f" | format(f.chance) }} | \
{{ pct(f.removed_of_ols) if seen(case.fits.ols) else "–" }} | \
{{ "%.2f" | format(f.rms_error) }} | {{ pct(f.coverage.mean) }} | {{ pct(f.coverage.lowest) }} | {{ pct(f.coverage.highest) }} |
{% endfor %}
{%- endfor %}

## How to read it

*Bias* is the root mean square, over the base parameters, of each one's mean error in units of the standard deviation of `wls`;
*chance* is what so many recordings would show without any bias. *rms error* has the same unit. Coverage is in per cent of 95 %
intervals; `removed` is in per cent, and left out where the bias of `ols` is not three times what chance would show.

The automatic bandwidth is what the motions need; 5 Hz is set by hand, as one would for a faster motion.

{% for case in summary %}
- {{ case.title }}: {{ case.bias }} {{ case.short }}
{% endfor %}

`tls` needs no more than the positions. `iv` is as good as its instruments: the commanded trajectory (here {{ lead }} ms ahead of
the robot) is free of noise; another period, and even and odd samples, bring noise of their own. `gls` gives little weight to the
frequencies that contain the noise. `ols`, `wls` and `gls` treat the regressor as exact; their intervals are
wider by the bias that encoder noise makes, as all intervals are by the scatter
([coverage](../encoder-coverage/README.md)). At 5
Hz and with so much noise they are wider than they need be.
"""


def seen(fit: dict[str, Any]) -> bool:
    """Whether a bias is more than chance would show."""
    return fit["bias"] > 3 * fit["chance"]


def summed_up(case: dict[str, Any]) -> dict[str, str]:
    """What the numbers of one case say, in two sentences."""
    fits = case["fits"]
    if seen(fits["ols"]):
        good = {fit: f["removed_of_ols"] for fit, f in fits.items() if f["removed_of_ols"] >= ENOUGH}
        removed = ", ".join(f"`{fit}` {100 * share:.0f} %" for fit, share in good.items()) or "none"
        bias = f"`ols` is biased. At least {100 * ENOUGH:.0f} % of that is removed by: {removed}."
    else:
        others = [f"`{fit}`" for fit, f in fits.items() if seen(f)]
        bias = "no bias of `ols` is seen." + (f" One is of {', '.join(others)}." if others else "")
    low = [f"`{fit}` ({100 * f['coverage']['lowest']:.0f} %)" for fit, f in fits.items()
           if f["coverage"]["lowest"] < case["band"][0]]  # fmt: skip
    short = f"Some intervals are too short, with the lowest coverage below its band: {', '.join(low)}." if low else ""
    return {"bias": bias, "short": short or "No coverage lies below its band."}


def write(result: dict[str, Any], folder: Path = STUDIES / "encoder-noise") -> None:
    """Write the page and its numbers."""
    folder.mkdir(parents=True, exist_ok=True)
    rounded = write_numbers(result, folder / "results.json", digits=4)
    write_page(
        PAGE, folder / "README.md", cases=rounded["cases"], names=NAMES, seed=rounded["seed"],
        std=rounded["encoder_std"], seen=seen, lead=round(1000 * LEAD),
        summary=[{"title": f"{NAMES[n.split(',')[0]]}, {n.split(', ')[1]}", **summed_up(c)} for n, c in rounded["cases"].items()],
    )  # fmt: skip


def main(arguments: list[str]) -> None:
    """Run from the command line."""
    given = parsed(arguments, __doc__, docs="encoder-noise", count=COUNT, of="case", seed=SEED)
    write(study(given.count, given.seed, given.processes), given.docs)


if __name__ == "__main__":
    main(sys.argv[1:])
