"""What becomes of diagnoses when each threshold is moved by 30 % either way, on fresh simulated recordings.

    python -m tests.studies.diagnosis_settings --work DIR [--count 20] [--seed 77] [--jobs 1] [--only NAME,...] [--quick]
        [--docs DIR]

Recordings come from the independent plant of case_studies/blind_naming, made in DIR. What came of a recording is kept in
results.json beside the page as soon as all its diagnoses are made, and none is made twice, also not in another DIR on another
day: a few minutes a recording and core. The page tells of the recordings that are finished. Results of other thresholds, or of
others' values, are thrown away. A threshold changes a diagnosis only from where a comparison comes out differently (`Compared`):
there a copy of the process goes on with it moved (POSIX). What limits computing and is no threshold (`LIMITS`) is moved likewise
once the thresholds are done.
``--quick`` takes two recordings and four thresholds, to see that the script works. That and ``--only`` write to DIR/docs, all
else to docs/studies/diagnosis-settings, unless ``--docs`` says another folder.
"""

from __future__ import annotations

import argparse
import concurrent.futures
import contextlib
import json
import multiprocessing
import os
import sys
import tempfile
import traceback
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, fields
from importlib import import_module
from pathlib import Path
from typing import Any

sys.path.append(str(Path(__file__).resolve().parents[2] / "case_studies" / "blind_naming"))

import numpy as np
from judge import CLAIMS, within
from make import ROBOTS, make
from tqdm import tqdm

import bayesid
from bayesid.diagnosis.settings import DEFAULT, Settings
from bayesid.regression import parallel
from tests.studies.page import STUDIES, write_page

_VERB = import_module("bayesid.workflows.diagnose")
_WITH_DESCRIPTION = _VERB._with_description

MOVED = 0.3
QUICK = ("accept", "unexplained", "nearly_all", "most")
#: Thresholds that are used in sums, products and comparisons; others, such as a time or a band, change what is computed.
COMPARED = (
    "accept", "rival", "likely_effects", "nearly_all", "unexplained", "hopeless", "coloured_ratio", "enough", "short_step",
    "level", "detected", "outside_library", "shortest_segment",
)  # fmt: skip
#: What limits computing, ``module.NAME`` of bayesid.diagnosis: steps, rounds, draws, rows listed, and how exact a number is made.
LIMITS = (
    "fit.STEPS", "fit.FEW_STEPS", "fit.SWEEPS", "fit._SETTLED", "forward._FITTED", "forward._ALIKE", "forward._FAMILIES",
    "forward._BEHIND", "forward._AHEAD", "rivals._CERTAIN", "encoders.ROUNDINGS", "prepare._RATE", "prepare._FRICTION_RATE",
    "prepare._UNKNOWN_REL_STD", "noise_spectrum._LEAST", "gap._DRAWS", "locate.LISTED",
    "locate._PARTS", "impulse_events._SAMPLES", "description.choose._TERMS", "description.choose._ADAPTED",
    "description.choose._COMPARED",
)  # fmt: skip
PAGE = """\
# Thresholds of a diagnosis, moved

The {{ count }} thresholds of `bayesid.diagnosis.settings.Settings`, where the reason of each stands, moved by 30 % down and up
(whole numbers by one at least, shares at most half-way to one), the others held, on fresh recordings of the plant of
[blind naming](../../../case_studies/blind_naming/README.md). "Right" counts recordings whose hidden effects are named and
nothing else; nothing, where nothing is hidden; and `unknown`, where what is hidden is not in the library. "Changed" counts
recordings with another verdict or other names than with the thresholds as they stand. Recordings of few channels come first.
Made by `python -m tests.studies.diagnosis_settings`.

{{ limits }} other numbers limit computing and are no thresholds: steps, rounds, draws, rows listed, each a constant beside the
function that uses it (`LIMITS` in the script). They are moved likewise once the thresholds are done.
{% for part in parts %}

{{ part.head }}, {{ part.count }} recordings; as it stands {{ part.right }} of {{ part.count }} are right.

| {{ part.what }} | value | right at -30 % | changed | right at +30 % | changed |
| --- | ---: | ---: | ---: | ---: | ---: |
{% for row in part.rows %}
| `{{ row.name }}` | {{ row.value }} | {{ row.down.right }} | {{ row.down.changed }} | {{ row.up.right }} | {{ row.up.changed }} |
{% endfor %}
{% endfor %}
"""


def moved(value: float, way: int) -> float:
    """A number moved down (-1) or up (1)."""
    if isinstance(value, int):
        return max(value + way * max(round(MOVED * value), 1), 0)
    share = 1.0 + way * MOVED
    # Quantiles and shares stay below one.
    return min(value * share, 0.5 * (1.0 + value)) if value < 1.0 else value * share


def limit(name: str) -> float:
    """A limit of computing as it stands."""
    module, _, own = name.rpartition(".")
    return getattr(import_module(f"bayesid.diagnosis.{module}"), own)


@contextlib.contextmanager
def limited(name: str, way: int) -> Iterator[None]:
    """With one limit of computing moved, in all modules that know it."""
    value, own = limit(name), name.rpartition(".")[2]
    home = f"bayesid.diagnosis.{name.rpartition('.')[0]}"
    knowing = [
        m for key, m in sys.modules.items()
        if key == home or (key.startswith("bayesid.diagnosis") and not own.startswith("_") and hasattr(m, own))
    ]  # fmt: skip
    for module in knowing:
        setattr(module, own, moved(value, way))
    try:
        yield
    finally:
        for module in knowing:
            setattr(module, own, value)


def is_right(answer: dict[str, Any], said: dict[str, Any]) -> bool:
    """Whether a diagnosis says what is hidden, and nothing else."""
    if answer["kind"] == "none":
        return said["verdict"] == "nothing_missing"
    if answer["kind"] == "unlisted":
        return said["verdict"] == "unknown"
    if said["verdict"] not in CLAIMS:
        return said["verdict"] in answer["acceptable_verdicts"] and answer["kind"] == "single"
    left = list(said["effects"])
    for truth, alternatives in zip(answer["effects"], answer["alternatives"], strict=True):
        hit = next((claim for claim in left if within(truth, alternatives, claim)), None)
        if hit is None:
            return False
        left.remove(hit)
    return not left


class Branches:
    """A process for every threshold and way, from where it first matters in a diagnosis; all share what came before."""

    def __init__(self) -> None:
        self.taken: tuple[str, int] | None = None  # what is moved in this process
        self.names: Sequence[str] = ()  # thresholds that may be
        self.started: set[tuple[str, int]] = set()
        self.folder = Path()

    def begin(self, names: Sequence[str], folder: Path) -> None:
        """Before a diagnosis; what comes of its branches is written to a folder."""
        self.taken, self.names, self.folder = None, names, folder
        self.started.clear()

    def at(self, name: str, way: int) -> None:
        """Here a threshold matters that is moved that way; the process that does not move it waits for the one that does."""
        if self.taken or name not in self.names or (name, way) in self.started:
            return
        self.started.add((name, way))
        if child := os.fork():
            _, status = os.waitpid(child, 0)
            if status:
                raise RuntimeError(f"{name} {way:+d} failed")
        else:
            self.taken = name, way

    def end(self, said: dict[str, Any]) -> None:
        """What a branch says; its process ends with it."""
        if self.taken:
            name, way = self.taken
            (self.folder / f"{name} {way:+d}").write_text(json.dumps(said), encoding="utf-8")
            os._exit(0)

    def failed(self) -> None:
        """A branch that fails ends with its process, which the one that waits for it says."""
        if self.taken:
            traceback.print_exc()
            os._exit(1)


branches = Branches()


_COMPARISONS = (np.less, np.less_equal, np.greater, np.greater_equal)


@dataclass(frozen=True, eq=False)
class Compared:
    """A threshold, or what follows from it, with what it would be if the threshold were moved; notes where that matters.

    Comparisons that come out alike change nothing. Where one does not, or where the number is used in any other way than in sums,
    products and comparisons, the threshold moved that way is tried (`Branches`).

    Attributes
    ----------
    name
        Of the threshold.
    value
        As it stands.
    moved
        By way.
    """

    name: str
    value: Any
    moved: dict[int, Any]

    @property
    def here(self) -> Any:
        """As it is in this process."""
        name, way = branches.taken or ("", 0)
        return self.moved[way] if name == self.name else self.value

    def _with(self, operation: Callable[[Any], Any]) -> Compared:
        return Compared(self.name, operation(self.value), {way: operation(x) for way, x in self.moved.items()})

    def _asked(self, comparison: Callable[[Any], Any]) -> Any:
        said = comparison(self.value)
        self._note(way for way, x in self.moved.items() if np.any(comparison(x) != said))
        return comparison(self.here)

    def _note(self, ways: Iterable[int]) -> None:
        for way in ways:
            branches.at(self.name, way)

    def _left(self) -> Any:
        self._note(self.moved)
        return self.here

    def __array_ufunc__(self, function: np.ufunc, method: str, *inputs: Any, **options: Any) -> Any:
        """A function of numpy's."""

        def operation(own: Any) -> Any:
            return getattr(function, method)(*(own if x is self else x for x in inputs), **options)

        return (self._asked if function in _COMPARISONS else self._with)(operation)

    def __add__(self, other: Any) -> Compared:
        return self._with(lambda x: x + other)

    def __mul__(self, other: Any) -> Compared:
        return self._with(lambda x: x * other)

    def __sub__(self, other: Any) -> Compared:
        return self._with(lambda x: x - other)

    def __rsub__(self, other: Any) -> Compared:
        return self._with(lambda x: other - x)

    def __truediv__(self, other: Any) -> Compared:
        return self._with(lambda x: x / other)

    def __rtruediv__(self, other: Any) -> Compared:
        return self._with(lambda x: other / x)

    def __pow__(self, other: Any) -> Compared:
        return self._with(lambda x: x**other)

    def __neg__(self) -> Compared:
        return self._with(lambda x: -x)

    def __lt__(self, other: Any) -> Any:
        return self._asked(lambda x: x < other)

    def __le__(self, other: Any) -> Any:
        return self._asked(lambda x: x <= other)

    def __gt__(self, other: Any) -> Any:
        return self._asked(lambda x: x > other)

    def __ge__(self, other: Any) -> Any:
        return self._asked(lambda x: x >= other)

    def __getitem__(self, key: Any) -> Compared:
        return self._with(lambda x: x[key])

    def __float__(self) -> float:
        return float(self._left())

    def __index__(self) -> int:
        return self._left()

    def __round__(self) -> int:
        return self._asked(round)

    def __format__(self, form: str) -> str:
        return format(self.here, form)

    __radd__, __rmul__ = __add__, __mul__


class Watched(Settings):
    """Thresholds that note where moving them would matter."""

    def __getattribute__(self, name: str) -> Any:
        """Any threshold, compared."""
        value = super().__getattribute__(name)
        if name not in Settings.__dataclass_fields__ or isinstance(value, Compared):
            return value
        own = Compared(name, value, {way: moved(value, way) for way in (-1, 1)})
        return own.here if branches.taken else own if name in COMPARED else own._left()


def diagnosed(folder: Path, channel: str, settings: Settings = DEFAULT) -> dict[str, Any]:
    """Verdict and effects with their rivals; a refusal as verdict ``refused``."""
    warnings.simplefilter("ignore")
    parts = []

    def described(result: Any, *rest: Any) -> Any:
        # A draft can take the place of effects that are named in part, and of no others.
        if result.part is not None:
            parts.append(result.part)
        return _WITH_DESCRIPTION(result, *rest) if parts else result

    # What else comes after the verdict changes no name.
    quick = {n: lambda result, *_: result for n in ("_with_errors", "_with_next_motion")}
    for later, instead in (quick | {"_places": lambda *_: (), "_with_description": described}).items():
        setattr(_VERB, later, instead)
    parallel._MOST = 1  # a process that branches has one thread
    try:
        said = bayesid.diagnose(folder, channel, settings=settings, progress=None).to_dict()
        effects = [{key: e[key] for key in ("name", "where", "ambiguous_with")} for e in said["effects"]]
        out: dict[str, Any] = {"verdict": said["verdict"], "effects": effects}
    except bayesid.BayesidError as error:
        out = {"verdict": "refused", "effects": [], "error": str(error)}
    except BaseException:
        branches.failed()
        raise
    branches.end(out)
    return out


def answers(work: Path, count: int, seed: int, quick: bool) -> list[dict[str, Any]]:
    """The recordings' answers; they are made unless they are there."""
    folder = work / "recordings"
    if not (folder / "answers").exists():
        make(folder, count, seed, *((("single", "none"), ("viscous_friction",)) if quick else ()))
    return [json.loads(path.read_text(encoding="utf-8")) for path in sorted((folder / "answers").glob("*.json"))]


def table(kept: dict[str, Any]) -> dict[str, Any]:
    """Of the recordings that are finished: how many are right, and a row for each number moved."""
    recordings = kept["recordings"].values()

    def side(name: str, way: int) -> dict[str, int]:
        said = [(r["right"], r["changed"].get(f"{name} {way:+d}")) for r in recordings]
        return {
            "right": sum(plain if other is None else other for plain, other in said),
            "changed": sum(other is not None for _, other in said),
        }

    rows = [{"name": n, "value": f"{v:g}", "down": side(n, -1), "up": side(n, 1)} for n, v in kept["values"].items()]
    return {"count": len(recordings), "right": sum(r["right"] for r in recordings), "rows": rows}


def written(kept: dict[str, dict[str, Any]], docs: Path) -> None:
    """Numbers and page, from the recordings that are finished."""
    docs.mkdir(parents=True, exist_ok=True)
    part = docs / "results.part"
    part.write_text(json.dumps(kept, indent=1) + "\n", encoding="utf-8")
    part.replace(docs / "results.json")
    heads = (("threshold", "Thresholds", "thresholds"), ("limit", "Limits of computing", "limits"))
    parts = [table(kept[own]) | {"what": what, "head": head} for what, head, own in heads]
    write_page(PAGE, docs / "README.md", count=len(fields(DEFAULT)), limits=len(LIMITS), parts=[p for p in parts if p["count"]])


def main(arguments: list[str] | None = None) -> None:
    """Make what is missing of the diagnoses, and the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--work", type=Path, required=True, help="where recordings and diagnoses are kept")
    parser.add_argument("--count", type=int, default=20)
    parser.add_argument("--seed", type=int, default=77)
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--only", default="", help="thresholds to move, separated by commas; default all")
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--docs", type=Path)
    options = parser.parse_args(arguments)
    chosen = options.only.split(",") if options.only else list(QUICK) if options.quick else None
    docs = options.docs or (STUDIES / "diagnosis-settings" if chosen is None else options.work / "docs")
    cases = answers(options.work, 2 if options.quick else options.count, options.seed, options.quick)
    store = docs / "results.json"
    found = json.loads(store.read_text(encoding="utf-8")) if store.exists() else {}
    kept = {}
    for part, numbers in (("thresholds", {f.name: getattr(DEFAULT, f.name) for f in fields(DEFAULT)}),
                          ("limits", {name: limit(name) for name in LIMITS})):  # fmt: skip
        values = {name: float(v) for name, v in numbers.items() if chosen is None or name in chosen}
        own = found.get(part, {})
        kept[part] = own if own.get("values") == values else {"values": values, "recordings": {}}
    fresh = multiprocessing.get_context("spawn")
    for part in kept.values():
        with concurrent.futures.ProcessPoolExecutor(options.jobs, mp_context=fresh) as pool:
            open_ = [c for c in cases if part["values"] and f"{options.seed}/{c['case']}" not in part["recordings"]]
            # Those of few channels take a minute, those of many up to an hour.
            open_.sort(key=lambda c: (c["channel"] == "both", ROBOTS.index(c["robot"])))
            runs = {pool.submit(of_recording, options.work / "recordings", c, list(part["values"])): c["case"] for c in open_}
            try:
                for run in tqdm(concurrent.futures.as_completed(runs), total=len(runs), mininterval=10.0):
                    part["recordings"][f"{options.seed}/{runs[run]}"] = run.result()
                    written(kept, docs)
            except BaseException:
                pool.shutdown(cancel_futures=True)  # else all others are diagnosed first, and nobody writes down what comes of it
                raise
    written(kept, docs)


def of_recording(folder: Path, case: dict[str, Any], names: Sequence[str]) -> dict[str, Any]:
    """Whether its diagnosis is right, and for each number and way that change what is named whether that is right then."""
    recording, channel = folder / case["case"], case["channel"]
    with tempfile.TemporaryDirectory() as kept:
        branches.begin(names, Path(kept))
        plain = diagnosed(recording, channel, Watched())
        moved_ = {path.name: json.loads(path.read_text(encoding="utf-8")) for path in Path(kept).iterdir()}
    branches.begin((), Path())
    for name in set(names) & set(LIMITS):
        for way in (-1, 1):
            with limited(name, way):
                moved_[f"{name} {way:+d}"] = diagnosed(recording, channel)
    changed = {own: is_right(case, said) for own, said in moved_.items() if named(said) != named(plain)}
    return {"right": is_right(case, plain), "changed": changed}


def named(said: dict[str, Any]) -> tuple[str, list[tuple[str, str]]]:
    """Verdict and names."""
    return said["verdict"], sorted((e["name"], e["where"]) for e in said["effects"])


if __name__ == "__main__":
    main()
