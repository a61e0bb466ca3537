"""Do formulae, predicted biases and certificates of `accuracy` agree with simulation?

``python -m tests.studies.accuracy`` from the repository runs it and writes ``docs/studies/accuracy``; finished twins of
the certificates are kept in a temporary folder, so that a run that was stopped goes on.

Two robots: the two-joint PUMA with a static run that is subtracted, and a UR5 whose offset is fitted; Fourier motions of 20 s at
125 Hz, links a tenth off the nominal ones, white noise of 0.5 N and 0.05 N m, counts of 1e-4 rad. Seeds are fixed.
"""

from __future__ import annotations

import sys
import tempfile
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from bayesid.design.accuracy.bench import Bench, make_bench, missing_effects, own_setting, twin
from bayesid.design.accuracy.certificate import certify
from bayesid.design.accuracy.fits import errors_of, fit_twin, learn, run_twin
from bayesid.design.accuracy.susceptibility import susceptibility
from bayesid.design.accuracy.sweeps import linear_errors
from bayesid.effects import Effect, Term
from bayesid.estimators import estimator
from bayesid.recordings.experiment import Experiment, Sensor
from bayesid.regression.options import FitOptions
from bayesid.regression.parallel import in_order
from bayesid.robot.robot import Robot, load_robot
from bayesid.simulation.simulation import Recorder, simulate
from bayesid.simulation.trajectories import new_trajectories
from tests.robots import ur5, write
from tests.simulated import puma2
from tests.studies.page import parsed, table, write_numbers, write_page

SEED, COUNT = 20_261_123, 200
#: Largest bias that effects are scaled to [standard deviations]; those with less than the other at usual size are left out.
LARGEST, LEAST = 2.0, 0.5
#: Twins that a bias is averaged over: weights change with an effect, and with them what noise makes of the estimate. So many
#: at first, then more until the mean's own error is below this share of the bias predicted, or there are as many as this.
AVERAGED, KNOWN, MOST = 4, 0.05, 400
NAMES = {"puma": "two-joint PUMA, static run subtracted", "ur5": "UR5, offset fitted"}
#: Effects that are smaller the larger their first parameter is.
_STIFF = ("base_compliance",)


def robot_of(name: str, folder: Path) -> Robot:
    """One of the two robots."""
    return puma2(folder) if name == "puma" else load_robot(write(folder, ur5()))


def bench_of(name: str, seed: int, folder: Path) -> Bench:
    """A simulated experiment as a bench."""
    robot = robot_of(name, folder)
    setup = Experiment(name, robot, (), Sensor(translation=np.array([0.0, 0.0, -0.1])), position_resolution=1e-4)
    recorder = Recorder(force_std=0.5, torque_std=0.05)
    motions = new_trajectories(robot, static=name == "puma", seed=seed)
    made = simulate(setup, motions, effects=["sensor_offset"], perturb=0.1, recorder=recorder, seed=seed)
    return make_bench(made, estimator("wls"), FitOptions())


def formula(bench: Bench, count: int, seed: int) -> dict[str, float]:
    """Standard deviations by formula and simulated ones."""
    own = own_setting(bench)
    known = learn(bench, own, seed)
    quiet, noisy = replace(own, noise=0.0), own
    found = [
        errors_of(bench, np.array(list(in_order(lambda k, s=s: run_twin(bench, s, seed + k, known), range(count)))))
        for s in (quiet, noisy)
    ]
    ratio = found[1].std / linear_errors(bench, found[0], seed).std(1.0, 1.0)
    return {"median": float(np.median(ratio)), "lowest": float(ratio.min()), "highest": float(ratio.max()),
            "error_of_one": float(1.0 / np.sqrt(2.0 * (count - 1)))}  # fmt: skip


def scaled(effect: Effect, robot: Robot, share: float) -> Term:
    """An effect of a share of its usual size."""
    values = np.array(effect.typical(robot), float)
    if effect.name in _STIFF:
        values[0] /= share**0.5
    else:
        linear = [k for k, p in enumerate(effect.quantities) if p.linear] or list(range(len(values)))
        values[linear] *= share
    return Term(effect, tuple(values))


def biases(bench: Bench, seed: int) -> list[dict[str, Any]]:
    """Bias by every effect alone, predicted and found by a fit of the same noise with and without it."""
    bench = replace(bench, options=replace(bench.options, bandwidth=bench.problem.smoother.bandwidth))
    own = replace(own_setting(bench), encoder=0.0)  # where encoders are shifted, rounding would not be the same noise
    robot, std = bench.experiment.robot, bench.estimate.std
    model = {"effects": bench.experiment.effects, "effect_values": bench.experiment.effect_values}
    start = lru_cache(maxsize=None)(lambda k: fit_twin(bench, own, twin(bench, own, k))[1].values)
    usual = {s.effect.spec: s for s in susceptibility(bench, std)}

    def compared(effect: Effect) -> dict[str, Any] | None:
        first = usual.get(effect.spec)
        if first is None or first.largest < LEAST:
            return None
        share, predicted, term = 1.0, first, Term(effect, first.values)
        while predicted.largest > 1.05 * LARGEST:  # a large effect is weighted down, so that its bias is not in proportion
            share *= LARGEST / predicted.largest
            term = scaled(effect, robot, share)
            (predicted,) = susceptibility(bench, std, (term,))
        plant = replace(bench, terms=(*bench.terms, term))
        whole, shifts, chance = float(np.linalg.norm(predicted.sigmas)), [], np.inf
        for k in range(seed, seed + MOST):
            made = fit_twin(bench, own, replace(twin(plant, own, k), **model))[1].values
            shifts.append((made - start(k)) / std)
            if len(shifts) >= AVERAGED:
                chance = float(np.sqrt(np.sum(np.var(shifts, axis=0, ddof=1)) / len(shifts))) / whole
                if chance < KNOWN:
                    break
        error = float(np.linalg.norm(np.mean(shifts, axis=0) - predicted.sigmas)) / whole
        return {"effect": effect.spec, "largest": predicted.largest, "error": error, "chance": chance, "twins": len(shifts)}

    found = in_order(compared, [t.effect for t in missing_effects(bench.experiment, bench.problem.row_model)])
    return [each for each in found if each is not None]


def study(count: int, seed: int, folder: Path) -> dict[str, Any]:
    """Both robots."""
    arms = {}
    for name in NAMES:
        with tempfile.TemporaryDirectory() as place, threadpool_limits(1, user_api="blas"):
            bench = bench_of(name, seed, Path(place))
            found = certify(bench, count, seed, lambda _: None, folder / f"accuracy-{name}-{seed}.npz", resume=True)
            arms[name] = {
                "parameters": bench.rank, "formula": formula(bench, count, seed), "biases": biases(bench, seed),
                "coverage": found.overall, "coverage_error": found.overall_error, "lowest": float(found.coverage.min()),
                "highest": float(found.coverage.max()), "band": found.band, "holds": found.holds,
            }  # fmt: skip
    return {"count": count, "seed": seed, "arms": arms}


PAGE = """\
# Accuracy: formulae, predicted biases and certificates against simulation

`python -m tests.studies.accuracy` made this page and [results.json](results.json): {{ count }} twins of each robot, seed
{{ seed }}. Links are a tenth off the nominal ones, noise is 0.5 N and 0.05 N m, counts are 1e-4 rad; `wls`, the default.
[Accuracy](../../howto/accuracy.md) says what the words mean.

## Standard deviations by formula

Simulated over those of `V_s + V_e`, over the base parameters; one simulated standard deviation is known to {{ pct(error) }} %.

{{ formulae }}

## Bias by effects left out

Every effect of the library at each place that at its usual size biases a base parameter by {{ least }} standard deviations
or more, one at a time, scaled so that its largest bias is at most {{ largest }}. Found: the mean of {{ averaged }} differences
or more of two fits of the same noise, perfect encoders, with and without the effect in the plant, weights learned anew: so
many that chance moves the mean by less than {{ known }} % of the bias, or {{ most }}. Error: norm of found less predicted over
the norm predicted, all base parameters in standard deviations.

{{ biases }}

{{ beyond }}
In brackets: the error, and how far the differences of single recordings scatter about their mean, over the same norm. A
prediction is of one recording. Where teeth with play cross changes with the motion's details, so that recordings of one
motion that begin a part of a sample later differ by as much, however little noise there is.

Not scaled, and not small, are effects whose bias stays below {{ largest }} at their usual size: cross-talk between
forces, for one, hardly biases, but moves the weights of its channels.

## Certificates

{{ certificates }}
"""


def write_study(result: dict[str, Any], docs: Path) -> None:
    """The page and its numbers."""
    rounded = write_numbers(result, docs / "results.json", 4)
    formulae, effects, covers, beyond = [], [], [], []
    for name, arm in rounded["arms"].items():
        f, errors = arm["formula"], np.array([b["error"] for b in arm["biases"]])
        formulae.append(f"| {NAMES[name]} | {arm['parameters']} | {f['median']:.3f} | {f['lowest']:.3f} | {f['highest']:.3f} |")
        effects.append(
            f"| {NAMES[name]} | {len(errors)} | {100 * np.median(errors):.1f} % | {100 * np.quantile(errors, 0.9):.1f} % | "
            f"{int(np.sum(errors <= 0.2))} |"
        )
        for b in arm["biases"]:
            if b["error"] > 0.2:
                scatter = b["chance"] * b["twins"] ** 0.5
                beyond.append(f"`{b['effect']}` on the {name} ({100 * b['error']:.0f} %; {100 * scatter:.0f} %)")
        covers.append(
            f"| {NAMES[name]} | {100 * arm['coverage']:.1f} ± {196 * arm['coverage_error']:.1f} % | "
            f"{100 * arm['lowest']:.1f} % | {100 * arm['highest']:.1f} % | "
            f"{100 * arm['band'][0]:.1f} … {100 * arm['band'][1]:.1f} % | "
            f"{'yes' if arm['holds'] else '**no**'} |"
        )
    write_page(
        PAGE, docs / "README.md", count=rounded["count"], seed=rounded["seed"], largest=f"{LARGEST:g}",
        least=f"{LEAST:g}", averaged=AVERAGED, known=f"{100 * KNOWN:g}", most=MOST,
        error=max(arm["formula"]["error_of_one"] for arm in rounded["arms"].values()),
        formulae=table("robot | base parameters | median | lowest | highest", formulae),
        biases=table("robot | effects | median error | 90 % of them below | within 20 %", effects),
        beyond="Beyond 20 %: " + (", ".join(beyond) or "none") + ".",
        certificates=table("robot | all 95 % intervals together | lowest | highest | band of exact intervals | within", covers),
    )  # fmt: skip


def main(arguments: list[str]) -> None:
    """Run from the command line."""
    given = parsed(arguments, __doc__, docs="accuracy", count=COUNT, of="robot", seed=SEED)
    write_study(study(given.count, given.seed, Path(tempfile.gettempdir())), given.docs)


if __name__ == "__main__":
    main(sys.argv[1:])
