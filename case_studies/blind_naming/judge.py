"""Diagnose a blind set and say how often the truth was named: rates, coverage of the intervals, confusion matrix.

    python case_studies/blind_naming/judge.py SET ... [--jobs 2] [--seed 0] [--before SET ...] [--write]

A SET is what make.py wrote. Diagnoses go to SET/diagnoses; those that are there are not made again, so a run can be
interrupted. ``--before`` names copies of these sets that an older revision has diagnosed, to stand beside. ``--write`` puts
results.json, confusion.png, reliability.png and the table of README.md beside this script.
"""

from __future__ import annotations

import argparse
import json
from collections import Counter
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from scipy.stats import binomtest
from tqdm import tqdm

from bayesid.tasks import cluster, map_tasks

HERE = Path(__file__).parent
CLAIMS = ("named", "named_in_part", "ambiguous")
#: Edges of the probabilities that names are given with.
PROBABILITIES = (0.0, 0.5, 0.9, 1.0)
#: Counted with all others and again alone: how large they have to be to be seen is a question of trust in the links.
APART = ("payload", "inertia_error", "rotor_momentum")
#: In the wrench alone these can only be told from each other by what is thought possible (EXPERIMENT_FORMAT).
SAME = ({"payload", "inertia_error"},)


def diagnose_one(folder: Path, seed: int) -> None:
    """Diagnose one case and keep its JSON."""
    from bayesid import diagnose

    answer = json.loads((folder.parent / "answers" / f"{folder.name}.json").read_text())
    target = folder.parent / "diagnoses" / folder.name / "diagnosis.json"
    if not target.exists():
        result = diagnose(folder, answer["channel"], seed=seed).to_dict()
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_text(json.dumps(result, allow_nan=False))


def read(set_folder: Path) -> Iterator[tuple[dict, dict]]:
    """Answers with their diagnoses, as far as they have been made."""
    for path in sorted((set_folder / "answers").glob("*.json")):
        answer = json.loads(path.read_text())
        made = set_folder / "diagnoses" / answer["case"] / "diagnosis.json"
        if made.exists():
            yield answer, json.loads(made.read_text())


def within(truth: dict, alternatives: list, claim: dict) -> bool:
    """Whether the truth is the effect claimed, one that looks the same on these motions, or in the set of at most three."""
    names = {claim["name"], *(rival["name"] for rival in claim["ambiguous_with"])}
    few = len(names) <= 3
    for same in SAME:
        names |= same if names & same else set()
    return truth["name"] in names and few or any(claim["name"] == name for name, _ in alternatives)


def there(truth: dict, alternatives: list, claim: dict) -> bool:
    """Whether the place is right, or one of those declared as not told apart."""
    places = {(claim["name"], claim["where"]), *((rival["name"], rival["where"]) for rival in claim["ambiguous_with"])}
    return any(where == truth["where"] for _, where in places) or any((n, w) in places for n, w in alternatives)


def judge(pairs: list[tuple[dict, dict]]) -> dict:
    """All rates as (share, number of cases)."""
    counts: dict[str, list[bool]] = {}
    scores: list[float] = []
    gaps: list[float] = []
    seconds = [said["runtime_s"] for _, said in pairs]
    for answer, said in pairs:
        claims = said["effects"] if said["verdict"] in CLAIMS else []
        kind, level = answer["kind"], answer["level"]
        if kind == "none":
            counts.setdefault("nothing hidden: nothing named", []).append(said["verdict"] == "nothing_missing")
            counts.setdefault("nothing hidden: an effect named", []).append(bool(claims))
        elif kind == "unlisted":
            counts.setdefault(f"unlisted, {level}: unknown", []).append(said["verdict"] == "unknown")
            wrong = [c for c in claims if c["name"] not in answer["partly_right"]]
            counts.setdefault(f"unlisted, {level}: a name that is not even partly right", []).append(bool(wrong))
        elif kind == "pair":
            left, found = list(claims), 0
            for truth, alternatives in zip(answer["effects"], answer["alternatives"], strict=True):
                hit = next((c for c in left if within(truth, alternatives, c)), None)
                if hit is not None:
                    left.remove(hit)
                    found += 1
            counts.setdefault(f"pair, {level}: both and nothing else", []).append(found == 2 and not left)
        else:
            truth, alternatives = answer["effects"][0], answer["alternatives"][0]
            quiet = said["verdict"] == "nothing_missing" and "nothing_missing" in answer["acceptable_verdicts"]
            hits = [c for c in claims if within(truth, alternatives, c)]
            exact = len(claims) == 1 and claims[0]["name"] == truth["name"] and said["verdict"] == "named"
            no_other = answer["acceptable_verdicts"] == ["named"] and not alternatives
            group = "three times the floor or more" if level in ("clear", "moderate") else "smaller"
            # A rotor in the wrench alone is the same as a change of two links' inertia.
            groups = [group] if truth["name"] != "rotor_momentum" or answer["channel"] != "wrench" else []
            if truth["name"] in APART:
                groups.append(f"{group}, {truth['name']}")
            elif groups:
                groups.append(f"{group}, all but payload, inertia error, rotor")
            for group in groups:
                counts.setdefault(f"single, {group}: in the set", []).append(bool(hits) or quiet)
                counts.setdefault(f"single, {group}: outright", []).append(exact)
                if no_other:
                    counts.setdefault(f"single, {group}: outright, where no other answer is right", []).append(exact)
                if hits:
                    counts.setdefault(f"single, {group}: right place", []).append(there(truth, alternatives, hits[0]))
            if exact and claims[0]["where"] == truth["where"]:
                scores += deviations(truth, claims[0])
                if said["gap"] is not None and said["gap"]["after"] is not None:
                    gaps.append(said["gap"]["after"] / said["gap"]["floor"])
    rates = {key: [float(np.mean(v)), len(v)] for key, v in sorted(counts.items())}
    sizes = np.abs(scores)
    return {
        "cases": len(pairs),
        "rates": rates,
        "probability": reliability(pairs),
        "coverage_95": [float(np.mean(sizes < 1.96)), len(sizes)] if len(sizes) else None,
        "gap_after_within_1.1_of_floor": [float(np.mean(np.array(gaps) <= 1.1)), len(gaps)] if gaps else None,
        "seconds": {"median": float(np.median(seconds)), "largest": float(np.max(seconds))},
    }


def reliability(pairs: list[tuple[dict, dict]]) -> dict:
    """How often names given with some probability are right: the truth, or what looks the same on these motions.

    Of an ambiguous verdict's sets the truth should be in nearly all.
    """
    given, sets = [], []
    for answer, said in pairs:
        right = {e["name"] for e in answer["effects"]} | {n for a in answer["alternatives"] for n, _ in a}
        right |= set(answer.get("partly_right", ())) if answer["kind"] == "unlisted" else set()
        right |= next((same for same in SAME if same & right), set())
        for claim in said["effects"] if said["verdict"] in CLAIMS else []:
            given.append((claim["probability"], claim["name"] in right))
            if claim["ambiguous_with"]:
                sets.append(bool(right & {claim["name"], *(rival["name"] for rival in claim["ambiguous_with"])}))
    if not given:
        return {}
    p, hit = (np.array(x, float) for x in zip(*given, strict=True))
    place = np.clip(np.searchsorted(PROBABILITIES, p, side="right") - 1, 0, len(PROBABILITIES) - 2)
    bins = [
        {"from": PROBABILITIES[k], "to": PROBABILITIES[k + 1], "names": int(mine.sum()), "given": float(p[mine].mean()),
         "right": float(hit[mine].mean())}
        for k in range(len(PROBABILITIES) - 1) if (mine := place == k).any()
    ]  # fmt: skip
    return {"bins": bins, "brier": float(np.mean((p - hit) ** 2)), "sets": [float(np.mean(sets)), len(sets)] if sets else None}


def deviations(truth: dict, claim: dict) -> list[float]:
    """Deviations of the main parameters from the truth in their standard deviations."""
    out = []
    for key, item in truth["parameters"].items():
        got = claim["parameters"].get(key)
        if got and got["std"] and item.get("main", True):
            out.append((got["value"] - item["value"]) / got["std"])
    return out


def label(said: dict) -> str:
    """What a diagnosis said, as one word for the confusion matrix."""
    if said["verdict"] not in CLAIMS:
        return said["verdict"]
    return said["effects"][0]["name"] if len(said["effects"]) == 1 else "several"


def draw(pairs: list[tuple[dict, dict]], path: Path) -> None:
    """Confusion matrix of single, unlisted and no effects."""
    table = Counter(
        (answer["effects"][0]["name"] if answer["kind"] == "single" else answer["kind"], label(said))
        for answer, said in pairs
        if answer["kind"] != "pair"
    )
    order = sorted({a for a, _ in table} - {"none", "unlisted"})
    rows = [*order, "none", "unlisted"]
    columns = [*order, *sorted({b for _, b in table} - {*order, "nothing_missing", "unknown", "several"})]
    columns += ["several", "nothing_missing", "unknown"]
    shares = np.array([[table[a, b] for b in columns] for a in rows], float)
    totals = np.maximum(shares.sum(axis=1, keepdims=True), 1)
    figure, axes = plt.subplots(figsize=(11, 9.5), layout="constrained")
    axes.imshow(shares / totals, cmap="Blues", vmin=0, vmax=1, aspect="auto")
    for i, j in zip(*np.nonzero(shares), strict=True):
        dark = shares[i, j] / totals[i, 0] > 0.6
        axes.text(j, i, f"{int(shares[i, j])}", ha="center", va="center", fontsize=7, color="white" if dark else "black")
    axes.set_xticks(range(len(columns)), [c.replace("_", " ") for c in columns], rotation=60, ha="right", fontsize=8)
    axes.set_yticks(range(len(rows)), [r.replace("_", " ") for r in rows], fontsize=8)
    axes.set_xlabel("said")
    axes.set_ylabel("hidden")
    axes.set_title("Blind naming: number of recordings; shade: share of the row", fontsize=10)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def draw_reliability(bins: list[dict], path: Path) -> None:
    """Reliability diagram: the share of names that are right over the probability that they are given with."""
    figure, axes = plt.subplots(figsize=(4.6, 4.2), layout="constrained")
    axes.plot([0, 1], [0, 1], color="0.7", label="as stated")
    for k, one in enumerate(bins):
        low, high = binomtest(round(one["right"] * one["names"]), one["names"]).proportion_ci(method="wilson")
        axes.plot([one["given"]] * 2, [low, high], color="C0")
        axes.plot(one["given"], one["right"], "o", color="C0", label="right, with 95 % interval" if k == 0 else None)
        axes.annotate(f"{one['names']} names", (one["given"], low), (-4, 2), textcoords="offset points", ha="right", fontsize=8)
    axes.set(xlim=(0, 1.02), ylim=(0, 1.02), xlabel="probability given", ylabel="share that is right")
    axes.legend(fontsize=8, loc="lower right")
    figure.savefig(path, dpi=110)
    plt.close(figure)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sets", type=Path, nargs="+", metavar="SET")
    parser.add_argument("--only-count", action="store_true", help="make no diagnoses, count those that are there")
    parser.add_argument("--jobs", type=int, help="processes; default: this one")
    parser.add_argument("--scheduler", help="address of a Dask cluster that makes the diagnoses instead")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--before", type=Path, nargs="*", default=[], metavar="SET", help="the same with older diagnoses")
    parser.add_argument("--write", action="store_true", help="renew results.json, both pictures and README.md's table")
    options = parser.parse_args()
    folders = sorted(p.parent for chosen in options.sets for p in chosen.glob("*/experiment.toml"))
    if not options.only_count:
        with cluster(options.jobs, options.scheduler):
            work = map_tasks(partial(diagnose_one, seed=options.seed), folders)
            list(tqdm(work, total=len(folders), unit="case", disable=None))
    pairs = [pair for chosen in options.sets for pair in read(chosen)]
    results = judge(pairs)
    if options.before:
        older = {(k, answer["case"]): (answer, said) for k, chosen in enumerate(options.before) for answer, said in read(chosen)}
        if len(older) != len(pairs):
            raise SystemExit(f"--before has {len(older)} diagnoses of {len(pairs)}")
        results["before"] = judge(list(older.values()))
    print(json.dumps(results, indent=1))
    if options.write:
        (HERE / "results.json").write_text(json.dumps(results, indent=1) + "\n")
        draw(pairs, HERE / "confusion.png")
        draw_reliability(results["probability"]["bins"], HERE / "reliability.png")
        fill(HERE / "README.md", results)


def percentages(results: dict) -> dict[str, tuple[str, str]]:
    """Every share in per cent, and of how many, by what it is."""
    found = dict(results["rates"])
    for key, text in (
        ("coverage_95", "95 % intervals of named effects that hold the truth"),
        ("gap_after_within_1.1_of_floor", "gap on unseen motions at most 1.1 times the floor afterwards"),
    ):
        if results[key]:
            found[text] = results[key]
    for one in results["probability"].get("bins", ()):
        found[f"names given with a probability of {one['from']:g} to {one['to']:g} that are right"] = [one["right"], one["names"]]
    if results["probability"].get("sets"):
        found["sets that are not told apart and hold the truth"] = results["probability"]["sets"]
    return {text: (f"{100 * share:.1f} %", str(count)) for text, (share, count) in found.items()}


def fill(readme: Path, results: dict) -> None:
    """Put the table of rates between README.md's marks."""
    begin, end = "<!-- results -->", "<!-- end of results -->"
    now, old = percentages(results), percentages(results["before"]) if "before" in results else None
    head = ["", "share", "cases"] if old is None else ["", "share", "cases", "before", "cases"]
    lines = [f"| {' | '.join(head)} |", f"|{' --- |' * len(head)}"]
    for text in dict.fromkeys([*now, *(old or {})]):
        cells = [cell for one in (now, old) if one is not None for cell in one.get(text, ("", ""))]
        lines.append(f"| {' | '.join([text, *cells])} |")
    text = readme.read_text()
    before, rest = text.split(begin)
    readme.write_text(before + begin + "\n" + "\n".join(lines) + "\n" + end + rest.split(end)[1])


if __name__ == "__main__":
    main()
