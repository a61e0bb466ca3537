"""python tests/benchmarks/posterior_speed.py [--write]: effective samples a second, beside numpyro's NUTS, in one run.

One 40 s recording of a six-joint arm; the posterior without bounds (flat prior) and that of bodies that can exist
(nominal prior), the latter also for a small arm. Both sides take turns on the same machine with one thread. NUTS is
compiled before the clock starts, is given the posterior's covariance as its mass matrix, adapts its step beforehand, and is
not charged for that. Its rates are given both on the rows, as a user would write the model, and on bayesid's factors. The
smallest bulk effective sample size over base parameters, effects and scales is divided by seconds of the processor, which
other work on the machine does not change.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import statistics
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from textwrap import wrap

import numpy as np
from threadpoolctl import threadpool_limits

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import bayesid
from bayesid.posterior.ensemble import Ensemble
from bayesid.posterior.likelihood import Likelihood
from bayesid.posterior.model import PosteriorModel, to_log_cholesky
from bayesid.posterior.run import choose_engine, convergence
from bayesid.recordings.experiment import Motion, Sensor
from bayesid.regression.options import FitOptions
from bayesid.regression.problem import prepare
from bayesid.robot.prior import Prior
from bayesid.robot.robot import load_robot
from bayesid.simulation.simulation import perturbed_links

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent.parent
STUDY = ROOT / "docs" / "studies" / "posterior-speed"
NUMPYRO = ROOT / ".venv-numpyro" / "bin" / "python"
TRUST = 0.3
CHAINS, CHAINS_NUTS = 4, 2
#: Arm, NUTS's target of acceptance, and description of every posterior. Where nothing is curved, its default is best.
CASES = {
    "unconstrained": ("ur5", 0.8, "a 40 s recording of a UR5, wrench, {rows} rows of six channels, flat prior"),
    "physical": ("ur5", 0.9, "the same with the nominal prior (30 %) on bodies that can exist"),
    "physical, two joints": ("puma", 0.9, "the same for 4 s of a two-joint PUMA at 20 times the noise, {rows} rows"),
}
SHOWN = ("rate", "seconds", "warm_up_s", "ess", "r_hat", "draws")
#: Chains have met, and their effective draws can be counted, below this R-hat and from this number on.
MET, ENOUGH = 1.05, 100.0
#: Draws of each chain: enough for effective sizes to be known to a few per cent.
KEPT = {"unconstrained": 6000, "physical": 1500}


def recorded(folder: Path):
    """A 40 s recording of a UR5 with links off their nominal values, and a 20 s motion for validation."""
    from tests.robots import ur5, write
    from tests.simulated import experiment, fourier, recording

    robot = load_robot(write(folder, ur5()))
    links = perturbed_links(robot, TRUST, 1).ravel()
    sensor = Sensor()
    motions = [
        Motion(name, role, recording(
            robot, sensor, fourier(robot, seed, seconds), seed=seed, force_std=0.5, torque_std=0.05, resolution=2e-5, offset=3.0,
            phi=links))
        for name, role, seed, seconds in (("one", "identification", 1, 40.0), ("two", "validation", 2, 20.0))
    ]  # fmt: skip
    return experiment(robot, motions, sensor, inertia_rel_std=TRUST)


def small(folder: Path):
    """A short and noisy recording of the two-joint PUMA: the least that geometry can ask of NUTS."""
    from tests.simulated import experiment, fourier, puma2, recording

    robot, sensor = puma2(folder), Sensor()
    table = recording(
        robot, sensor, fourier(robot, 1, 4.0), seed=1, force_std=10.0, torque_std=1.0, resolution=2e-5, offset=3.0,
        phi=perturbed_links(robot, TRUST, 1).ravel(),
    )  # fmt: skip
    return experiment(robot, [Motion("one", "identification", table)], sensor, inertia_rel_std=TRUST)


def problem_file(model: PosteriorModel, path: Path, draws: np.ndarray) -> None:
    """Everything that NUTS needs, at coordinates of about unit size.

    It is given what no user has: draws of the posterior (n, names) to start from, one for each chain, and the covariance of
    all of them in its own coordinates as its mass matrix.
    """
    q = model.quadratic
    arrays = {
        "factors": model.likelihood.factors, "white": model.likelihood.white[0], "counts": model.likelihood.counts,
        "to_columns": model.to_columns, "bodies": np.array(model.bodies),
    }  # fmt: skip
    std = np.sqrt(np.diag(q.root @ q.root.T))
    linear, scales, _ = model.split(draws)
    if model.prior is None:
        arrays |= {"centre": q.centre, "scale": std}
        theta = (linear - q.centre) / std
    else:
        n = model.link_count
        size = np.sqrt(np.diag(model.prior.precision))
        root = np.linalg.cholesky(model.prior.precision / np.outer(size, size)).T * size
        bodies = to_log_cholesky((linear @ model.entries.T)[:, :n].reshape(len(draws), -1, 10))
        theta = np.concatenate([bodies.reshape(len(draws), -1), linear[:, n:] / std[n:]], axis=1)
        arrays |= {
            "from_entries": model.from_entries, "prior": root, "prior_mean": model.prior.mean, "effect_scale": std[n:],
        }  # fmt: skip
    mass = np.cov(np.concatenate([np.log(scales), theta], axis=1).T)
    first = np.linspace(0, len(draws) - 1, CHAINS_NUTS).astype(int)
    np.savez(path, **arrays, start=theta[first], start_scales=np.log(scales[first]), mass=mass)


def worst(model: PosteriorModel, draws: np.ndarray) -> dict[str, float]:
    """Smallest bulk effective sample size, largest R-hat: base parameters, effects and scales of (chains, n, names)."""
    linear, scales, _ = model.split(draws)
    numbers = np.concatenate([linear @ model.to_columns.T, scales], axis=-1)
    found = convergence(numbers, tuple(map(str, range(numbers.shape[-1]))))
    return {"ess": float(found.ess_bulk.min()), "r_hat": float(found.r_hat.max())}


def own(model: PosteriorModel, kept: int) -> dict[str, float]:
    """The engine that `bayesid.sample` takes, every step kept."""
    engine = choose_engine(model)
    if isinstance(engine, Ensemble):
        engine = replace(engine, thin=1)
    begin = time.process_time()
    states = [engine.start(np.random.default_rng(k)) for k in range(CHAINS)]
    warm = time.process_time() - begin
    count = max(kept * (5 if engine.walkers > 1 else 1) // engine.walkers, 2)
    begin = time.process_time()
    draws = np.stack([engine.advance(s, count, 1) for s in states])
    seconds = time.process_time() - begin
    flat = np.swapaxes(draws, 1, 2).reshape(CHAINS, -1, draws.shape[-1])
    found = worst(model, flat)
    return {"seconds": seconds, "warm_up_s": warm, "draws": flat.shape[0] * flat.shape[1], **found,
            "rate": found["ess"] / seconds, "engine": engine.name, "flat": flat}  # fmt: skip


def nuts(model: PosteriorModel, path: Path, options: argparse.Namespace, target: float, rows: bool) -> dict[str, float]:
    """NUTS in its own environment."""
    out = path.with_suffix(".draws.npz")
    one = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "XLA_FLAGS": one}
    command = [str(NUMPYRO), str(HERE / "nuts_posterior.py"), str(path), str(out), "--draws", str(options.draws),
               "--chains", str(CHAINS_NUTS), "--warm-up", str(options.warm_up), "--target", str(target),
               "--depth", str(options.depth)]  # fmt: skip
    done = subprocess.run(command + (["--rows"] if rows else []), capture_output=True, text=True, env=environment, check=False)
    if done.returncode:
        raise SystemExit(f"nuts_posterior.py failed:\n{done.stderr}")
    result = json.loads(done.stdout.strip().splitlines()[-1])
    flat = np.load(out)["draws"]
    result |= worst(model, flat) | {"draws": flat.shape[0] * flat.shape[1], "flat": flat}
    return result | {"rate": result["ess"] / result["seconds"]}


def agreement(model: PosteriorModel, one: np.ndarray, other: np.ndarray) -> float:
    """Largest difference of the two samplers' means of base parameters and effects, in standard deviations."""
    a, b = (model.split(x)[0] @ model.to_columns.T for x in (one, other))
    return float(np.max(np.abs(a.mean(axis=(0, 1)) - b.mean(axis=(0, 1))) / a.std(axis=(0, 1))))


def compare(regressions: dict, folder: Path, options: argparse.Namespace) -> dict:
    """All posteriors, in turns."""
    result = {}
    for name, (arm, target, _) in CASES.items():
        regression = regressions[arm]
        prior = None if name == "unconstrained" else Prior.nominal(regression.knowledge.nominal_links, TRUST)
        model = PosteriorModel.of(regression, prior)
        path = folder / f"{name}.npz"
        first = own(model, KEPT["physical"])["flat"]
        whole_model = replace(model, likelihood=Likelihood.of(regression, keep_rows=True))
        problem_file(whole_model, path, first.reshape(-1, first.shape[-1]))
        runs: dict[str, list[dict]] = {"bayesid": [], "nuts": [], "nuts_factors": []}
        apart = 0.0
        for _ in range(options.repeats if prior is None else 1):
            mine = own(model, KEPT["physical" if prior is not None else "unconstrained"])
            runs["bayesid"].append(mine)
            # In the cone a step on rows would take minutes a draw; NUTS gets the faster density.
            for key, rows in (("nuts", True), ("nuts_factors", False))[prior is not None :]:
                theirs = nuts(model, path, options, target, rows)
                apart = max(apart, agreement(model, mine["flat"], theirs["flat"]))
                runs[key].append(theirs)
        entry = {k: {m: statistics.median(r[m] for r in v) for m in SHOWN}
                 for k, v in runs.items() if v}  # fmt: skip
        entry["engine"] = runs["bayesid"][0]["engine"]
        entry |= {key: runs["nuts_factors"][0][key] for key in ("steps", "divergent", "acceptance")}
        entry |= {"rows": regression.rows.count, "target": target}
        entry["means_apart_in_std"] = apart
        for key in [k for k in ("nuts", "nuts_factors") if runs[k]]:
            pairs = [a["rate"] / b["rate"] for a, b in zip(runs["bayesid"], runs[key], strict=True)]
            entry[f"bayesid_over_{key}"] = [min(pairs), statistics.median(pairs), max(pairs)]
        result[name] = entry
        print(name, json.dumps(entry, indent=1), flush=True)
    result["versions"] = {k: runs["nuts_factors"][0][k] for k in ("numpyro", "jax")}
    return result


def _ratio(entry: dict, key: str) -> str:
    """A ratio of rates; chains that have not met seem to have more effective draws than they have."""
    theirs, ratio = entry[key], entry[f"bayesid_over_{key}"][1]
    if theirs["r_hat"] < MET and theirs["ess"] >= ENOUGH:
        return f"{ratio:,.0f}"
    return f"at least {float(f'{ratio:.2g}'):,.0f}: NUTS had not converged"


def _unfinished(name: str, entry: dict) -> list[str]:
    """What there is to say where NUTS did not converge."""
    theirs = entry["nuts_factors"]
    if theirs["r_hat"] < MET and theirs["ess"] >= ENOUGH:
        return []
    text = (
        f"- {name}: NUTS had not converged after {theirs['warm_up_s']:.0f} s of warm-up and {theirs['seconds']:.0f} s of drawing "
        f"(R-hat {theirs['r_hat']:.2f}, {theirs['ess']:.0f} effective of {theirs['draws']:.0f} draws, {entry['steps']:.0f} steps "
        "each). Its rate is what these draws seem to be worth; in truth it is lower, so the ratio is at least what is shown."
    )
    return wrap(text, 125, subsequent_indent="  ")


def page(result: dict) -> str:
    """The results as a page of the documentation."""
    versions = result["versions"]
    posteriors = "; ".join(f"*{name}*: {text.format(rows=result[name]['rows'])}" for name, (_, _, text) in CASES.items())
    how = (
        f"One thread, Python {result['python']}, numpyro {versions['numpyro']} on JAX {versions['jax']}. "
        f"{_times(result['repeats'])}; `make bench` repeats it, `python tests/benchmarks/posterior_speed.py --write` makes this "
        "page. Effective samples a second: the smallest bulk effective sample size over base parameters, effects and scales, "
        "over processor seconds. NUTS samples the same density, by log-Cholesky where only bodies that can exist count. It is "
        "compiled before its clock starts. It is given what no user has: draws of the posterior to start from, and the "
        "posterior's covariance in its own coordinates as dense mass matrix, which it otherwise has to adapt. It adapts "
        f"its step for {result['warm_up']} draws that are not charged (acceptance {result['unconstrained']['target']}, in "
        f"the cone {result['physical']['target']}; trees up to depth {result['depth']}) and makes {result['nuts_draws']} draws "
        f"in each of {CHAINS_NUTS} chains. On *rows* it evaluates every reading, as the model is usually written; on *factors* "
        "it is given bayesid's reduction."
    )
    lines = [
        "# Speed of the samplers",
        "",
        *wrap(f"{posteriors}.", 125),
        "",
        *wrap(how, 125),
        "",
        "| posterior | bayesid | NUTS on rows | ratio | NUTS on factors | ratio | means apart |",
        "|---|---|---|---|---|---|---|",
    ]
    for name in CASES:
        e = result[name]
        lines.append(
            f"| {name} ({e['engine']}) | {e['bayesid']['rate']:,.0f} /s | "
            + (f"{e['nuts']['rate']:,.1f} /s | {_ratio(e, 'nuts')} | " if "nuts" in e else "- | - | ")
            + f"{e['nuts_factors']['rate']:,.1f} /s | {_ratio(e, 'nuts_factors')} | {e['means_apart_in_std']:.2f} std |"
        )
    unfinished = [line for name in CASES for line in _unfinished(name, result[name])]
    lines += ["", *unfinished] if unfinished else []
    lines += ["", "`bayesid.sample` as a whole (reading rows, noise, 2,000 converged draws, predictions):", ""]
    lines += [f"- {k} prior: {v['seconds']:.1f} s, largest R-hat {v['r_hat']:.4f}" for k, v in result["whole"].items()]
    return "\n".join([*lines, ""])


def _times(repeats: int) -> str:
    return "One run" if repeats == 1 else f"Medians of {repeats} runs in turns (of bodies that can exist: one run)"


def whole(experiment) -> dict:
    """Seconds of the verb's call for both priors, converged."""
    out = {}
    for prior in ("flat", "nominal"):
        times = []
        for seed in range(3):
            begin = time.perf_counter()
            posterior = bayesid.sample(experiment, seed=seed, prior=prior)
            times.append(time.perf_counter() - begin)
        out[prior] = {"seconds": statistics.median(times), "r_hat": float(posterior.diagnosis.r_hat.max())}
    return out


def main() -> None:
    """Run all."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--draws", type=int, default=600, help="of each chain of NUTS")
    parser.add_argument("--warm-up", type=int, default=250, help="draws in which each chain of NUTS adapts")
    parser.add_argument("--depth", type=int, default=13, help="at most 2^depth steps a draw")
    parser.add_argument("--write", action="store_true", help="write docs/studies/posterior-speed")
    options = parser.parse_args()
    if not NUMPYRO.exists():
        raise SystemExit("numpyro is not installed: make .venv-numpyro/ready")
    with tempfile.TemporaryDirectory() as temporary, threadpool_limits(1):
        folder = Path(temporary)
        experiment = recorded(folder)
        recordings = {"ur5": experiment, "puma": small(folder)}
        regressions = {name: prepare(one, FitOptions("wrench")).regression for name, one in recordings.items()}
        result = compare(regressions, folder, options)
        result |= {"python": platform.python_version(), "repeats": options.repeats, "warm_up": options.warm_up,
                   "depth": options.depth, "nuts_draws": options.draws}  # fmt: skip
        result["whole"] = whole(experiment)
        print(json.dumps(result["whole"], indent=1))
    if options.write:
        (STUDY / "results.json").write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
        (STUDY / "README.md").write_text(page(result), encoding="utf-8")


if __name__ == "__main__":
    main()
