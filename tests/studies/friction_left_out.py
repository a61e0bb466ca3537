"""What a diagnosis finds where friction is left out of the model, beside friction models put in by hand.

Run from the root of the repository, with the recordings where ``BAYESID_DATA`` says (default ``../shared``)::

    python -m tests.studies.friction_left_out [--only NAME] [--disturbed 3] [--shuffled 3] [--docs FOLDER]

Joint torques of real robots, ``[model] effects`` emptied. The error is that of `bayesid.identify` with the effects that were
found, or that were put in at all joints, on a motion that was not fitted (below 10 Hz, error norm over signal norm of all
channels). With ``--disturbed N`` the readings and positions are changed in the ninth digit and diagnosed again, N times, with
``--shuffled N`` the effects of the library, the joints that each is sought at and the motions come in another order: which names
stay? Writes docs/studies/friction-left-out.
"""

from __future__ import annotations

import argparse
import os
import time
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

import bayesid
from bayesid.effects import Effect, EffectLibrary
from bayesid.recordings.experiment import Experiment
from bayesid.validation.prediction import predict_elsewhere
from tests.studies.page import STUDIES, plain, table, write_numbers, write_page

DATA = Path(os.environ.get("BAYESID_DATA", "../shared")) / "data"
#: Recordings with a motion to predict of their own, and recordings of one robot, each judged on the next.
ALONE = ("kuka-lwr4", "tx40", "ur10")
SERIES = ("ur10e/before", "ur10e/feb05-20s-12h", "ur10e/feb05-20s-8h", "ur10e/feb06-20s-10h", "ur10e/feb06-20s-5h")
#: Friction models put in at all joints.
BY_HAND = {
    "viscous, Coulomb": ("viscous_friction", "coulomb_friction"),
    "and an offset": ("viscous_friction", "coulomb_friction", "torque_offset"),
    "viscous, Dahl, offset": ("viscous_friction", "dahl_friction", "torque_offset"),
    "viscous, Stribeck, offset": ("viscous_friction", "stribeck_friction", "torque_offset"),
}
#: The one of these that is stated, too, for `bayesid diagnose` to find what is missing beside it.
STATED = "and an offset"
#: How much positions and readings are changed, relative to their largest.
NINTH_DIGIT = 1e-9

PAGE = """# Friction left out

<!-- Written by tests/studies/friction_left_out.py. -->

Joint torques of real robots, with friction left out of the model: what `bayesid diagnose` finds by itself, beside four friction
models put in at all joints by hand. Error on a motion that was not fitted, by `identify` with those effects.

{{ errors }}

The diagnosed model predicts better than, or within 5 % of, the best of the four by hand in {{ good }} of {{ count }} recordings.

## And with friction stated?

A model that states viscous friction, Coulomb friction and an offset at all joints, and what `bayesid diagnose` finds beside them,
or in their place where something stays beside them and recordings held out in turn are predicted better so.

{{ beside }}
{% for digit, names in again %}

{% if digit %}
## Are the names the same for data changed in the ninth digit?

Positions and torques are changed at random by {{ digit }} of their largest, and diagnosed again. {% else %}
## Are the names the same in another order?

The effects of the library, the joints at which each is sought, and the recording's motions are put in another order at random,
and diagnosed again. {% endif %}A name stays if it comes in
every run; in brackets the share of the gap that opens again without it, of those that do not.

{{ names }}
{% endfor %}
"""


def cases() -> Iterator[tuple[str, Experiment, Experiment | None]]:
    """Name, recording without effects, and the recording that it is judged on, None for one of its own motions."""
    for name in ALONE:
        if (DATA / name).is_dir():
            yield name, _bare(name), None
    for name, judge in zip(SERIES, (*SERIES[1:], SERIES[0]), strict=True):
        if (DATA / name).is_dir() and (DATA / judge).is_dir():
            yield name, _bare(name), _bare(judge)


def _bare(name: str) -> Experiment:
    return replace(bayesid.load_experiment(DATA / name), effects=(), effect_values={})


def error(experiment: Experiment, judge: Experiment | None) -> float:
    """On motions that were not fitted, norms of error and signal of all of them together."""
    found = bayesid.identify(experiment, channel="torque", progress=None)
    judged = found.validation if judge is None else predict_elsewhere(found.problem, found.estimate, judge)
    return float(np.mean([p.relative_error for p in judged]))


def disturbed(experiment: Experiment, seed: int) -> Experiment:
    """The recording changed in the ninth digit."""
    rng = np.random.default_rng(seed)

    def changed(values: np.ndarray) -> np.ndarray:
        return values + NINTH_DIGIT * np.abs(values).max() * rng.normal(size=values.shape)

    return replace(
        experiment,
        motions=tuple(
            replace(m, table=replace(m.table, positions=changed(m.table.positions), torques=changed(m.table.torques)))
            for m in experiment.motions
        ),
    )


@dataclass(frozen=True)
class ShuffledLibrary(EffectLibrary):
    """The effects in another order, and the joints at which each is sought."""

    seed: int = 0

    @cached_property
    def classes(self) -> dict[str, type[Effect]]:
        """Every class by name."""
        return dict(_shuffled(list(super().classes.items()), self.seed))

    def places(self, name, joint_names, channels, gear_ratio=None) -> tuple[Effect, ...]:
        """All effects of one class."""
        return tuple(_shuffled(list(super().places(name, joint_names, channels, gear_ratio)), self.seed))


def _shuffled(things: list, seed: int) -> list:
    return [things[k] for k in np.random.default_rng(seed).permutation(len(things))]


def shuffled(experiment: Experiment, seed: int) -> Experiment:
    """The recording with effects, joints and motions in another order."""
    own = experiment.library
    library = ShuffledLibrary(own.own, own.sliding, seed=seed)
    return replace(experiment, library=library, motions=tuple(_shuffled(list(experiment.motions), seed)))


def diagnosed(experiment: Experiment, other: Experiment | None) -> tuple[bayesid.Diagnosis, dict[str, Any]]:
    """A diagnosis, with its verdict, its processor time, and the error with what it names in the model."""
    since = time.process_time()
    found = bayesid.diagnose(experiment, channel="torque", progress=None)
    seconds = time.process_time() - since
    effects, values = found.model
    after = error(replace(experiment, effects=effects, effect_values=values), other)
    return found, {"verdict": found.verdict, "seconds": seconds, "diagnosed": after}


def beside_stated(experiment: Experiment, other: Experiment | None) -> dict[str, Any]:
    """What is named beside friction that the model states."""
    found, told = diagnosed(replace(experiment, effects=BY_HAND[STATED]), other)
    return told | {"named": [f.term.effect.spec for f in found.found]}


def judge(experiment: Experiment, other: Experiment | None, digits: int, orders: int) -> dict[str, Any]:
    """Errors of the bare model, of those by hand and of the diagnosed one; what is named, also of disturbed data."""
    out: dict[str, Any] = {"bare": error(experiment, other)}
    out["by_hand"] = {name: error(replace(experiment, effects=effects), other) for name, effects in BY_HAND.items()}
    found, told = diagnosed(experiment, other)
    out.update(told, stated=beside_stated(experiment, other))
    shares = () if found.part is None else found.part.shares
    named = [f.term.effect.spec for f in found.found]
    out["named"] = {spec: shares[k].share if k < len(shares) else None for k, spec in enumerate(named)}
    changed = {
        "again": [disturbed(experiment, seed) for seed in range(digits)],
        "shuffled": [shuffled(experiment, seed) for seed in range(1, orders + 1)],
    }
    for kind, experiments in changed.items():
        said = [bayesid.diagnose(e, channel="torque", progress=None) for e in experiments]
        out[kind] = [sorted(f.term.effect.spec for f in d.found) for d in said]
    return out


def write(found: dict[str, dict[str, Any]], folder: Path) -> None:
    """The page and its numbers."""
    folder.mkdir(parents=True, exist_ok=True)
    found = write_numbers(found, folder / "results.json", 4)
    good, errors, beside = 0, [], []
    for name, f in found.items():
        best = min(f["by_hand"].values())
        good += f["diagnosed"] <= 1.05 * best
        cells = [f["bare"], *f["by_hand"].values(), f["diagnosed"]]
        numbers = " | ".join(f"{100 * c:.1f} %" for c in cells)
        errors.append(f"| {name} | {numbers} | {f['verdict'].replace('_', ' ')} | {len(f['named'])} | {f['seconds']:.0f} s |")
        own = f["stated"]
        numbers = " | ".join(f"{100 * c:.1f} %" for c in (f["by_hand"][STATED], own["diagnosed"], f["diagnosed"]))
        beside.append(f"| {name} | {own['verdict'].replace('_', ' ')} | {_listed(own['named'])} | {numbers} |")
    head = f"recording | no friction | {' | '.join(BY_HAND)} | diagnosed | verdict | effects | processor time"
    again = [(digit, _names(found, kind)) for digit, kind in ((NINTH_DIGIT, "again"), (None, "shuffled"))]
    write_page(
        PAGE, folder / "README.md", errors=table(head, errors), good=good, count=len(found),
        again=[(digit, names) for digit, names in again if names],
        beside=table("recording | verdict | named | stated | with what is named | left out, and diagnosed", beside),
    )  # fmt: skip


def _names(found: dict[str, dict[str, Any]], kind: str) -> str:
    """Table of the names that stay; empty where nothing was diagnosed again."""
    lines = []
    for name, f in found.items():
        if not f[kind]:
            continue
        every = set(f["named"]).intersection(*f[kind])
        lost = [
            spec if share is None else f"{spec} ({100 * share:.1f} %)" for spec, share in f["named"].items() if spec not in every
        ]
        new = sorted(set().union(*f[kind]) - set(f["named"]))
        lines.append(f"| {name} | {len(f[kind])} | {len(every)} of {len(f['named'])} | {_listed(lost)} | {_listed(new)} |")
    return table("recording | runs | names in all | not in all | only in others", lines) if lines else ""


def _listed(specs: list[str]) -> str:
    return ", ".join(specs) or "-"


def main() -> None:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="")
    parser.add_argument("--disturbed", type=int, default=0)
    parser.add_argument("--shuffled", type=int, default=0)
    parser.add_argument("--docs", type=Path, default=STUDIES / "friction-left-out")
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    chosen = [c for c in cases() if given.only in c[0]]
    if not chosen:
        parser.error(f"no recordings in {DATA}")
    found: dict[str, dict[str, Any]] = {}
    for name, experiment, other in tqdm(chosen):  # what is found of one recording is not lost when the next is interrupted
        found[name] = plain(judge(experiment, other, given.disturbed, given.shuffled))
        write(found, given.docs)


if __name__ == "__main__":
    main()
