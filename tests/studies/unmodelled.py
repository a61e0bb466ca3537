"""Intervals where the model lacks an effect: of parameters that the effect cannot touch, and of the others.

    python -m tests.studies.unmodelled --work DIR [--count 2000] [--before FILE] [--write]

Recordings with one hidden effect of 1, 3 or 10 times the floor come from the plant of case_studies/blind_naming and are
identified without that effect. Recordings and fits are kept in DIR: a run that was stopped goes on where it was. ``--write``
makes docs/studies/unmodelled; ``--before`` takes DIR/fits.json of the same recordings by another revision of bayesid, which
this script makes when it is run with that revision on the path (only public functions are used to fit).
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import warnings
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from rich.progress import track
from scipy.stats import norm

import bayesid
from bayesid.tasks import cluster, map_tasks

ROOT = Path(__file__).resolve().parents[2]
# At the end: another revision of bayesid on the path stays before this one, in the processes started, too.
sys.path += [str(ROOT / "case_studies" / "blind_naming"), str(ROOT)]

SEED = 20_261_123
COUNT = 2000
METHODS = ("ols", "wls", "gls", "huber", "sdp")
#: Changes of links: a free rigid body takes them up, so that nothing is missing in the model.
OF_LINKS = ("payload", "inertia_error", "rotor_momentum")
#: Its plant takes ten minutes a recording.
SLOW = ("base_compliance",)
#: An effect touches a parameter if leaving it out moves the parameter by more than this, in standard deviations of `wls`.
TOUCHED = 0.25
PAGE = """\
# Intervals under an effect that the model lacks

{{ cases }} recordings with one hidden effect, 1, 3 or 10 times the floor of a perfect model, by the plant of
[blind naming](../../../case_studies/blind_naming/README.md) (`{{ slow }}` left out, for its plant is slow), identified without
the effect. How often 95 % intervals hold the truth, in per cent of all base parameters: of those that the effect cannot touch
(leaving it out moves them by at most {{ touched }} of about the standard deviation of noise alone), and of the others.
Made by `python -m tests.studies.unmodelled`, seed {{ seed }}.
{% if before %}*Before*: {{ before }} of these recordings with revision {{ revision }}.
{% endif %}

| {{ head | join(" | ") }} |
|{{ "---|" * (head | length) }}
{% for row in rows %}
| {{ row | join(" | ") }} |
{% endfor %}

*z* is what nine tenths of all errors stay below, in stated standard deviations; it should be 1.64. An effect that follows the
motion in the same way from beginning to end biases all parts of a recording alike; no interval that is learned from their
disagreement can hold that ([limits](../../explanation/limits.md)). {{ counts }}
"""


def recordings(work: Path, count: int) -> list[dict[str, Any]]:
    """The answers of the set; what is not there yet is made."""
    if len(list((work / "answers").glob("*.json"))) < 0.9 * count:  # some plans no draw can fill
        from make import make, plans

        every = dict.fromkeys(n for p in plans(500, SEED, ("single",)) for n in p.names)
        names = tuple(n for n in every if n not in OF_LINKS + SLOW)
        make(work, count, SEED, ("single",), names, resume=True)
    return [json.loads(path.read_text(encoding="utf-8")) for path in sorted((work / "answers").glob("*.json"))]


def _fits(experiment: Any, channel: str) -> Callable[[str, Sequence[str] | None], Any]:
    """From method and effects (None: those of the experiment): the estimate that ``bayesid.identify`` gives.

    Without its validation, which takes most of its time; earlier revisions, whose modules have other names, are asked for all.
    """
    try:
        from bayesid.estimators.nonlinear import solve
        from bayesid.regression.options import FitOptions
        from bayesid.regression.problem import prepare
    except ImportError:
        return lambda method, effects: bayesid.identify(experiment, channel, method, effects=effects).estimate
    problem = prepare(experiment, FitOptions(channel))
    return lambda method, effects: solve(
        problem if effects is None else prepare(experiment, FitOptions(channel, effects=effects)), method
    )[1]


def fitted(work: Path, answer: dict[str, Any]) -> dict[str, Any] | None:
    """Errors and standard deviations of one recording, and how far leaving the effect out moves every parameter of `wls`."""
    experiment = bayesid.load_experiment(work / answer["case"])
    (effect,) = answer["effects"]
    links = np.concatenate(list(answer["true_links_with_effect"].values()))
    out: dict[str, Any] = {"level": answer["level"], "name": effect["name"], "fits": {}}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        fits = _fits(experiment, answer["channel"])
        for method in METHODS:
            estimate = fits(method, None)
            if estimate.interval == "none":
                continue
            error = estimate.values - estimate.base.matrix @ links
            out["fits"][method] = {"error": error.tolist(), "std": np.asarray(estimate.std).tolist()}
            out["labels"] = list(estimate.base.labels)
            if method == "wls":
                plain = estimate
        try:
            spec = f"{effect['name']}@{effect['where']}" if effect["where"] else effect["name"]
            whole = fits("wls", [spec])
        except (bayesid.BayesidError, np.linalg.LinAlgError):  # the latter by revisions before an effect that ran away was told
            return None
    if list(whole.base.labels) != out["labels"]:
        return None
    dispersion = getattr(plain.details, "dispersion", 1.0)
    out["moved"] = (np.abs(whole.values - plain.values) / np.maximum(plain.std, 1e-300) * dispersion**0.5).tolist()
    return out


def shares(
    found: list[dict[str, Any]], method: str, level: str, moved: list[list[float]]
) -> tuple[float, float, float, int, int]:
    """Coverage of untouched and of touched parameters, what nine tenths of the latter's errors stay below, numbers of both."""
    limit, inside, z, touched = norm.ppf(0.975), [], [], []
    for case, move in zip(found, moved, strict=True):
        if case["level"] == level and method in case["fits"]:
            ratio = np.abs(np.array(case["fits"][method]["error"])) / np.maximum(case["fits"][method]["std"], 1e-300)
            inside.append(ratio <= limit)
            z.append(ratio)
            touched.append(np.array(move) > TOUCHED)
    ins, zs, hit = (np.concatenate(x) if x else np.zeros(0, bool) for x in (inside, z, touched))

    def mean(x):
        return float(np.mean(x)) if len(x) else float("nan")

    most = float(np.quantile(zs[hit], 0.9)) if hit.any() else float("nan")
    return mean(ins[~hit]), mean(ins[hit]), most, int(np.sum(~hit)), int(np.sum(hit))


def write(work: Path, before: Path | None, revision: str, docs: Path) -> None:
    """The page and its numbers."""
    from tests.studies.page import write_numbers, write_page

    found = json.loads((work / "fits.json").read_text(encoding="utf-8"))
    old = None if before is None else json.loads(before.read_text(encoding="utf-8"))
    cases = sorted(k for k, v in found.items() if v is not None)
    both = [k for k in cases if old is not None and old.get(k) is not None]
    new, earlier = [found[k] for k in cases], None if old is None else [old[k] for k in both]
    moved, rows, numbers, counts = [case["moved"] for case in new], [], {}, ""
    # Which parameters an effect touches is the same for both revisions.
    moved_before = [found[k]["moved"] for k in both]
    for method in METHODS:
        for level, times in (("small", "1.2"), ("moderate", "3"), ("clear", "10")):
            one = shares(new, method, level, moved)
            two = None if earlier is None else shares(earlier, method, level, moved_before)
            pairs = [(one[k], None if two is None else two[k]) for k in range(3)]
            text = [[f"{100 * x:.1f}" if k < 2 else f"{x:.2f}" for x in p if x is not None] for k, p in enumerate(pairs)]
            rows.append([f"`{method}`", f"{times} times the floor", *(cell for p in text for cell in p)])
            numbers[f"{method}, {times}"] = dict(zip(("untouched", "touched", "z"), one, strict=False)) | (
                {} if two is None else dict(zip(("untouched_before", "touched_before", "z_before"), two, strict=False))
            )
            if method == "wls":
                counts += f" At {times} times the floor {one[3]} parameters are not touched and {one[4]} are."
    told = {"seed": SEED, "cases": len(cases), "cases_before": len(both), "fits": numbers}
    write_numbers(told, docs / "results.json", digits=4)
    write_page(
        PAGE, docs / "README.md", cases=len(cases), touched=TOUCHED, slow=", ".join(SLOW), seed=SEED,
        before=len(both), revision=revision,
        head=["estimator", "size", *(cell for name in ("not touched", "touched", "z of touched") for cell in (name, "before")
                                     if cell == name or old is not None)],
        rows=rows, counts=counts.strip(),
    )  # fmt: skip


def main() -> None:
    """Make what is missing, and the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--store", type=Path, help="where fits are kept, default DIR/fits.json")
    parser.add_argument("--count", type=int, default=COUNT)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--before", type=Path)
    parser.add_argument("--revision", default="679f174")
    parser.add_argument("--write", action="store_true")
    parser.add_argument("--docs", type=Path, default=ROOT / "docs" / "studies" / "unmodelled")
    options = parser.parse_args()
    os.environ["OMP_NUM_THREADS"] = "1"
    answers = recordings(options.work, options.count)
    store = options.store or options.work / "fits.json"
    made = json.loads(store.read_text(encoding="utf-8")) if store.exists() else {}
    todo = [a for a in answers[: options.count] if a["case"] not in made]
    with cluster(options.processes):
        fits = track(map_tasks(partial(fitted, options.work), todo), "fits", len(todo))
        for done, (answer, found) in enumerate(zip(todo, fits, strict=True), 1):
            made[answer["case"]] = found
            if done % 10 == 0 or done == len(todo):
                draft = store.with_suffix(".part")
                draft.write_text(json.dumps(made), encoding="utf-8")
                draft.replace(store)
    if options.write:
        write(options.work, options.before, options.revision, options.docs)


if __name__ == "__main__":
    main()
