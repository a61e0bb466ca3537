"""Make a blind set: experiment folders with hidden effects, and their answers.

    python case_studies/blind_naming/make.py --out DIR --seed S --count N [--kinds single,pair,none,unlisted] [--effects NAME,...]

DIR/blind-0001 and so on are experiment folders; DIR/answers/blind-0001.json says what is hidden.
"""

from __future__ import annotations

import argparse
import itertools
import json
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from cases import LEVELS, ImplausibleError, Plan, allowed, make_case
from draws import TORQUE, UNLISTED, WRENCH
from tqdm import tqdm

SHARES = {"single": 0.6, "none": 0.15, "pair": 0.15, "unlisted": 0.1}
ROBOTS = ("puma2", "puma560", "ur5", "panda")
LOWER = {"clear": "moderate", "moderate": "small"}
TRUST = (0.0, 0.01, 0.03, 0.05, 0.1)


def plans(count: int, seed: int, kinds: tuple[str, ...], effects: tuple[str, ...] = ()) -> Iterator[Plan]:
    """Balanced plans: kinds by their shares, single effects in turn through names, channels and levels."""
    rng = np.random.default_rng([seed, 0])
    shares = np.array([SHARES[kind] for kind in kinds])
    due = np.zeros(len(kinds))
    pairs = [(name, channel) for channel, names in (("wrench", WRENCH), ("torque", TORQUE)) for name in names]
    pairs += [(name, "both") for name in dict.fromkeys(WRENCH + TORQUE)]
    outside = [(name, channel) for channel in ("wrench", "torque") for name in UNLISTED[channel]]
    if effects:
        pairs = [pair for pair in pairs if pair[0] in effects]
        outside = [pair for pair in outside if pair[0] in effects] or outside
    # alone in wrench or torque: twice as often as with both
    order = [pairs[k] for k in rng.permutation(len(pairs))]
    singles = itertools.cycle(
        [(pair, level) for turn in range(3) for k, pair in enumerate(order) for level in [list(LEVELS)[(turn + k) % 3]]]
    )
    unlisted = itertools.cycle(
        [(pair, level) for turn in range(2) for k, pair in enumerate(outside) for level in [list(LEVELS)[(turn + k) % 2]]]
    )
    for index in range(1, count + 1):
        due += shares / shares.sum()
        kind = kinds[int(np.argmax(due))]
        due[kinds.index(kind)] -= 1
        level: str | None = None
        names: tuple[str, ...] = ()
        channel = str(rng.choice(["wrench", "torque", "both"], p=[0.5, 0.3, 0.2]))
        if kind == "single":
            (name, channel), level = next(singles)
            names = (name,)
        elif kind == "unlisted":
            (name, channel), level = next(unlisted)
            names = (name,)
        elif kind == "pair":
            pool = [name for name in dict.fromkeys(WRENCH + TORQUE) if allowed(name, channel, False) and name != "rotor_momentum"]
            names = tuple(str(name) for name in rng.choice(pool, size=2, replace=False))
            level = str(rng.choice(["clear", "moderate"]))
        static = channel == "wrench" and rng.random() < 0.4 and all(allowed(name, channel, True) for name in names)
        robot = str(rng.choice(ROBOTS))
        yield Plan(f"blind-{index:04d}", kind, names, level, robot, channel, bool(static), float(rng.choice(TRUST)))


def make(
    out: Path, count: int, seed: int, kinds: tuple[str, ...] = tuple(SHARES), effects: tuple[str, ...] = (), resume: bool = False
) -> list[dict]:
    """Make the set; a plan that no draw can fill is drawn anew with another robot.

    With ``resume`` the cases of ``out`` whose answers are there, from the same seed and plans, are kept. Returns the answers.
    """
    answers = []
    for index, plan in enumerate(tqdm(list(plans(count, seed, kinds, effects)), unit="case", disable=None), 1):
        if resume:
            done = out / "answers" / f"{plan.case}.json"
            if done.exists():
                answers.append(json.loads(done.read_text(encoding="utf-8")))
                continue
            shutil.rmtree(out / plan.case, ignore_errors=True)  # what was not finished
        for attempt in range(12):
            try:
                answers.append(make_case(plan, [seed, index, attempt], out))
                break
            except ImplausibleError:
                rng = np.random.default_rng([seed, index, attempt, 1])
                plan = replace(plan, robot=str(rng.choice(ROBOTS)), rel_std=float(rng.choice(TRUST)))
                if attempt % 4 == 3 and plan.level in LOWER:  # not in any arm that could exist
                    plan = replace(plan, level=LOWER[plan.level])
        else:
            tqdm.write(f"{plan.case}: no draw of {plan.names} at level {plan.level} in {plan.channel}; left out")
    return answers


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--kinds", default=",".join(SHARES), help="kinds of case, by commas")
    parser.add_argument("--effects", default="", help="only these effects in cases of one, by commas")
    options = parser.parse_args()
    kinds = tuple(kind for kind in options.kinds.split(",") if kind)
    effects = tuple(name for name in options.effects.split(",") if name)
    make(options.out, options.count, options.seed, kinds, effects)


if __name__ == "__main__":
    main()
