"""A real KUKA LWR4+: what beats the CAD model on the faster motion.

    python case_studies/kuka_lwr4/run.py [--out DIR]

takes the recordings that `bayesid.datasets` finds or fetches; writes results.json, errors.png and README.md with its
tables filled in. It takes a minute or two.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from present import figure, fill, plain, tables

import bayesid
from bayesid.estimators.conic.physical import Physical
from bayesid.results.comparison import Entry
from bayesid.results.fitted_model import impossible_bodies
from bayesid.robot.prior import Prior
from bayesid.robot.robot import Robot

HERE = Path(__file__).parent
FRICTION = ("viscous_friction", "coulomb_friction", "torque_offset")
#: Registered estimators that take part, in the order of the tables.
NAMES = ("ols", "wls", "gls", "ridge", "tsvd", "iv", "tls", "huber", "student", "sdp")
BLOCK_S = 2.5  # s; longer than joint 1's slowest residual
DRAWS = 2000
FOLDS = 5


@dataclass(frozen=True)
class PriorOnly:
    """The nominal model as a prior, without physical consistency: ``wls`` and the prior weighted by their covariances."""

    name: str = "prior"

    def fit(self, regression: bayesid.Regression) -> bayesid.Estimate:
        """Combine two normal distributions of the base parameters; effects have no prior."""
        plain = bayesid.fit(regression, "wls")
        k, r = regression.base.matrix, regression.base.rank
        prior = Prior.warped(regression.knowledge.nominal_links, regression.knowledge.inertia_rel_std)
        precision = np.linalg.inv(plain.full_covariance)
        pull = np.zeros_like(precision)
        pull[:r, :r] = np.linalg.inv(k @ prior.covariance @ k.T)
        mean = np.append(k @ prior.mean, np.zeros(len(precision) - r))
        covariance = np.linalg.inv(precision + pull)
        solution = covariance @ (precision @ plain.solution + pull @ mean)
        return replace(plain, method=self.name, solution=solution, full_covariance=covariance, interval="credible")


@dataclass(frozen=True)
class Untold:
    """``sdp`` that is not told how far to trust the nominal model, but finds it from the fitted motion."""

    name: str = "sdp, trust from the data"

    def fit(self, regression: bayesid.Regression) -> bayesid.Estimate:
        """Fit without the stated trust."""
        return Physical(self.name).fit(replace(regression, knowledge=replace(regression.knowledge, inertia_rel_std=None)))


OWN = (PriorOnly(), Physical("sdp, hardly a prior", rel_std=30.0), Untold(), Physical("sdp, closest to CAD", closest=0.95))
TRUSTS = (0.03, 0.1, 0.3, 1.0, 3.0)


def methods() -> list:
    """Those of `NAMES` that this version of bayesid has, and those made here."""
    return [name for name in NAMES if name in bayesid.METHODS] + list(OWN)


def squares(entry: Entry) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Squared error and squared reading of the validation motion, all joints together, and times (k,)."""
    (p,) = entry.validation
    return np.sum((p.predicted - p.measured) ** 2, axis=1), np.sum(p.measured**2, axis=1), p.times


def relative(error: np.ndarray, signal: np.ndarray) -> np.ndarray:
    """Error norm over signal norm, along the last axis."""
    return np.sqrt(error.sum(axis=-1) / signal.sum(axis=-1))


@lru_cache(maxsize=6)  # the same draws for every estimator
def resample(count: int, length: int, draws: int, seed: int) -> np.ndarray:
    """How often each of `count` samples is in each draw of a circular block bootstrap (draws, count) [Politis1992]_."""
    rng = np.random.default_rng(seed)
    starts = rng.integers(0, count, (draws, -(-count // length)))
    marks = np.zeros((draws, count + 1))
    for block in starts.T:  # a block raises its samples' counts by one; running sums of its two ends say so
        end = block + length
        np.add.at(marks, (np.arange(draws), block), 1.0)
        wraps = end > count
        np.add.at(marks, (np.arange(draws), np.where(wraps, end - count, end)), -1.0)
        marks[wraps, 0] += 1.0
    return np.cumsum(marks, axis=1)[:, :count]


def differences(entry: Entry, other: Entry, block_s: float = BLOCK_S, seed: int = 0) -> np.ndarray:
    """Relative error less that of another, for samples of the motion drawn again in blocks (draws,)."""
    error, signal, times = squares(entry)
    step = float(np.median(np.diff(times)))
    weights = resample(len(times), min(round(block_s / step), len(times)), DRAWS, seed)
    below = weights @ signal
    return np.sqrt(weights @ error / below) - np.sqrt(weights @ squares(other)[0] / below)


def without(experiment: bayesid.Experiment, fold: int, folds: int) -> bayesid.Experiment:
    """The experiment with one of `folds` equal parts of the identification motion taken out."""
    out = []
    for motion in experiment.motions:
        table = motion.table
        if motion.role == "identification":
            keep = np.ones(len(table), bool)
            keep[fold * len(table) // folds : (fold + 1) * len(table) // folds] = False
            motion = replace(motion, table=table[keep])
        out.append(motion)
    return replace(experiment, motions=tuple(out))


def entries(experiment: bayesid.Experiment, effects: tuple[str, ...], chosen: list) -> dict[str, Entry]:
    """Baselines and estimators by name, those that refused included."""
    compared = bayesid.compare(experiment, chosen, effects=list(effects))
    return {entry.name: entry for entry in (*compared.baselines, *compared.entries)}


def impossible(entry: Entry, robot: Robot) -> tuple[str, ...]:
    """Bodies that cannot exist, of an estimate's own links; those that `compare` shows are the nearest that can."""
    if entry.urdf is None or (entry.estimate is not None and entry.estimate.links is not None):
        return entry.impossible or ()
    return impossible_bodies(entry.urdf.unconstrained.reshape(-1, 10), robot.body_names)


def judge(experiment: bayesid.Experiment, effects: tuple[str, ...], folds: int) -> dict:
    """Errors of everything on the validation motion, with intervals of their differences to CAD."""
    found = entries(experiment, effects, methods())
    cad, tuned = found["nominal"], found.get("nominal + effects")
    again: dict[str, list[float]] = {name: [] for name in found}
    for fold in range(folds):
        for name, entry in entries(without(experiment, fold, folds), effects, methods()).items():
            if entry.estimate is not None:
                again[name].append(float(relative(*squares(entry)[:2])))
    out: dict = {"validation": cad.validation[0].motion, "rows": {}, "refused": {}}
    for name, entry in found.items():
        if entry.estimate is None:
            out["refused"][name] = entry.refusal
            continue
        fit = entry.fitted[0]
        row = {
            "fit": float(relative(np.sum((fit.predicted - fit.measured) ** 2, axis=1), np.sum(fit.measured**2, axis=1))),
            "error": float(relative(*squares(entry)[:2])),
            "consistent": not impossible(entry, experiment.robot),
            "impossible": list(impossible(entry, experiment.robot)),
        }
        values = np.array(again[name])
        # Delete-a-block jackknife: how much the error depends on which part of the motion was fitted.
        row["refit_std"] = float(np.sqrt((len(values) - 1) * np.mean((values - values.mean()) ** 2))) if len(values) > 1 else None
        for key, other in (("cad", cad), ("tuned", tuned)):
            if other is None or entry is other:
                continue
            drawn = differences(entry, other)
            low, high = np.quantile(drawn, [0.025, 0.975])
            both = float(np.hypot(drawn.std(), row["refit_std"] or 0.0))
            row[key] = {
                "difference": row["error"] - float(relative(*squares(other)[:2])),
                "low": float(low), "high": float(high), "std_with_refit": both,
                "blocks": {str(b): np.quantile(differences(entry, other, b), [0.025, 0.975]).tolist() for b in (1.0, 5.0)},
            }  # fmt: skip
        out["rows"][name] = row
    return out


def run(folds: int = FOLDS) -> dict:
    """All results."""
    experiment = bayesid.datasets.load("kuka-lwr4")
    roles = {"identification": "validation", "validation": "identification"}
    swapped = replace(experiment, motions=tuple(replace(m, role=roles[m.role]) for m in experiment.motions))
    trusted = entries(experiment, FRICTION, [Physical(f"{s:g}", rel_std=s) for s in TRUSTS])
    untold = bayesid.compare(experiment, [Untold()], effects=list(FRICTION)).entries[0].estimate
    physics = trusted[f"{TRUSTS[-1]:g}"].estimate
    rates = {m.name: np.gradient(m.table.positions, m.table.times, axis=0) for m in experiment.motions}
    return {
        "stated_trust": experiment.inertia_rel_std,
        "speeds": {name: float(np.sqrt(np.mean(rate**2))) for name, rate in rates.items()},
        "seconds": {m.name: m.table.duration for m in experiment.motions},
        "block_s": BLOCK_S, "draws": DRAWS, "folds": folds,
        "friction": judge(experiment, FRICTION, folds),
        "rigid": judge(experiment, (), 0),
        "swapped": judge(swapped, FRICTION, 0),
        "trusts": {f"{s:g}": float(relative(*squares(trusted[f"{s:g}"])[:2])) for s in TRUSTS},
        "trust_from_data": None if untold is None else untold.details.prior.rel_std,
        "physics": None if physics is None else physics.details.to_dict()["physics"],
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=HERE, help="folder for results.json, the figure and the filled README.md")
    options = parser.parse_args()
    try:
        bayesid.datasets.fetch("kuka-lwr4")
    except bayesid.InputError as error:
        print(f"skipped: {error}")
        return
    options.out.mkdir(parents=True, exist_ok=True)
    results = run()
    filled = fill((HERE / "README.md").read_text(encoding="utf-8"), tables(results))
    (options.out / "results.json").write_text(json.dumps(plain(results), indent=1) + "\n", encoding="utf-8")
    (options.out / "README.md").write_text(filled, encoding="utf-8")
    figure(results, options.out / "errors.png")
    print(filled)


if __name__ == "__main__":
    main()
