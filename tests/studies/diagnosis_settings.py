"""What becomes of diagnoses when each threshold is moved by 30 % either way, on fresh simulated recordings.

    python -m tests.studies.diagnosis_settings --work DIR [--count 20] [--seed 77] [--jobs 1] [--only NAME,...] [--quick]
        [--docs DIR]

Recordings come from the independent plant of case_studies/blind_naming. The diagnoses of a recording are kept in
DIR/diagnoses.json as soon as all are made, and none is made twice: the run can be interrupted and taken up again. The page tells
of the recordings that are finished. A threshold changes a diagnosis only where a comparison comes out differently; where none
does, that one is not made again (`Compared`). What limits computing and is no threshold (`LIMITS`) is moved likewise once the
thresholds are done.
``--quick`` takes two recordings and four thresholds, to see that the script works. Writes docs/studies/diagnosis-settings from
what there is.
"""

from __future__ import annotations

import argparse
import concurrent.futures
import contextlib
import json
import multiprocessing
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from importlib import import_module
from pathlib import Path
from typing import Any, ClassVar

sys.path.append(str(Path(__file__).resolve().parents[2] / "case_studies" / "blind_naming"))

import numpy as np
from judge import CLAIMS, within
from tqdm import tqdm

import bayesid
from bayesid.diagnosis.settings import DEFAULT, Settings
from tests.studies.page import STUDIES, write_page

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
    "forward._BEHIND", "rivals._CERTAIN", "encoders.ROUNDINGS", "prepare._RATE", "prepare._FRICTION_RATE",
    "prepare._UNKNOWN_REL_STD", "noise_spectrum._LEAST", "gap._DRAWS", "locate.LISTED",
    "locate._PARTS", "impulse_events._SAMPLES", "remarks._LATE", "description.choose._TERMS", "description.choose._ADAPTED",
    "description.choose._COMPARED",
)  # fmt: skip
PAGE = """\
# Thresholds of a diagnosis, moved

The {{ count }} thresholds of `bayesid.diagnosis.settings.Settings`, where the reason of each stands, moved by 30 % down and up
(whole numbers by one at least, shares at most half-way to one), the others held, on fresh recordings of the plant of
[blind naming](../../../case_studies/blind_naming/README.md). "Right" counts recordings whose hidden effects are named and
nothing else; nothing, where nothing is hidden; and `unknown`, where what is hidden is not in the library. "Changed" counts
recordings with another verdict or other names than with the thresholds as they stand. Made by
`python -m tests.studies.diagnosis_settings`.

{{ limits }} other numbers limit computing and are no thresholds: steps, rounds, draws, rows listed, each a constant beside the
function that uses it (`LIMITS` in the script). They are moved likewise once the thresholds are done.
{% for part in parts %}

{{ part.head }}, {{ part.cases }} recordings; as it stands {{ part.right }} of {{ part.cases }} are right.

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


@dataclass(frozen=True, eq=False)
class Compared:
    """A threshold, or what follows from it, with what it would be if the threshold were moved; notes where that matters.

    Comparisons that come out alike change nothing. Where one does not, or where the number is used in any other way than in sums,
    products and comparisons, the threshold moved that way has to be tried.

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
    #: Thresholds and ways that have to be tried.
    open: ClassVar[set[tuple[str, int]]] = set()
    __array_ufunc__ = None  # arrays leave operators to this class

    def _with(self, operation: Callable[[Any], Any]) -> Compared:
        return Compared(self.name, operation(self.value), {way: operation(x) for way, x in self.moved.items()})

    def _asked(self, comparison: Callable[[Any], Any]) -> Any:
        said = comparison(self.value)
        self._note(way for way, x in self.moved.items() if np.any(comparison(x) != said))
        return said

    def _note(self, ways: Iterable[int]) -> None:
        Compared.open.update((self.name, way) for way in ways)

    def _left(self) -> Any:
        self._note(self.moved)
        return self.value

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

    def __float__(self) -> float:
        return float(self._left())

    def __index__(self) -> int:
        return self._left()

    def __round__(self) -> int:
        return self._asked(round)

    def __format__(self, form: str) -> str:
        return format(self.value, form)

    __radd__, __rmul__ = __add__, __mul__


class Watched(Settings):
    """Thresholds that note where moving them would matter."""

    def __getattribute__(self, name: str) -> Any:
        """Any threshold, compared."""
        value = super().__getattribute__(name)
        if name not in Settings.__dataclass_fields__ or isinstance(value, Compared):
            return value
        own = Compared(name, value, {way: moved(value, way) for way in (-1, 1)})
        return own if name in COMPARED else own._left()


def diagnosed(folder: Path, channel: str, name: str | None, way: int) -> dict[str, Any]:
    """Verdict and effects with their rivals; a refusal as verdict ``refused``. With no threshold moved: which are to be tried."""
    warnings.simplefilter("ignore")
    verb = import_module("bayesid.workflows.diagnose")
    # What comes after the verdict changes no name.
    quick = {n: lambda result, *_: result for n in ("_with_errors", "_with_next_motion", "_with_description")}
    for later, instead in (quick | {"_places": lambda *_: ()}).items():
        setattr(verb, later, instead)
    settings, held = DEFAULT, contextlib.nullcontext()
    if name is None:
        settings = Watched()
    elif name in LIMITS:
        held = limited(name, way)
    else:
        settings = replace(DEFAULT, **{name: moved(getattr(DEFAULT, name), way)})
    Compared.open.clear()
    try:
        with held:
            result = bayesid.diagnose(folder, channel, settings=settings, progress=None)
        open_ = sorted(f"{own} {side:+d}" for own, side in Compared.open)  # what is written beside names is none of it
        said = result.to_dict()
        effects = [{key: e[key] for key in ("name", "where", "ambiguous_with")} for e in said["effects"]]
        out: dict[str, Any] = {"verdict": said["verdict"], "effects": effects}
    except bayesid.BayesidError as error:
        open_ = sorted(f"{own} {side:+d}" for own, side in Compared.open)
        out = {"verdict": "refused", "effects": [], "error": str(error)}
    return out if name else out | {"open": open_}


def answers(work: Path, count: int, seed: int, quick: bool) -> list[dict[str, Any]]:
    """The recordings' answers; they are made unless they are there."""
    from make import make

    folder = work / "recordings"
    if not (folder / "answers").exists():
        make(folder, count, seed, *((("single", "none"), ("viscous_friction",)) if quick else ()))
    return [json.loads(path.read_text(encoding="utf-8")) for path in sorted((folder / "answers").glob("*.json"))]


def table(made: dict[str, Any], names: list[str], every: list[dict[str, Any]]) -> dict[str, Any]:
    """Of the recordings of which all diagnoses have been made: how many are right, and a row for each number moved."""
    cases = [c for c in every if all(f"{c['case']} {name} {way:+d}" in made for name in names for way in (-1, 1))]
    plain = {c["case"]: made[f"{c['case']} as it stands"] for c in cases}

    def named(said: dict[str, Any]) -> tuple[str, list[tuple[str, str]]]:
        return said["verdict"], sorted((e["name"], e["where"]) for e in said["effects"])

    def side(name: str, way: int) -> dict[str, int]:
        said = [made[f"{c['case']} {name} {way:+d}"] for c in cases]
        return {
            "right": sum(is_right(c, x) for c, x in zip(cases, said, strict=True)),
            "changed": sum(named(x) != named(plain[c["case"]]) for c, x in zip(cases, said, strict=True)),
        }

    rows = [
        {"name": n, "value": f"{limit(n) if n in LIMITS else getattr(DEFAULT, n):g}", "down": side(n, -1), "up": side(n, 1)}
        for n in names
    ]
    return {"cases": len(cases), "right": sum(is_right(c, plain[c["case"]]) for c in cases), "rows": rows}


def written(made: dict[str, Any], names: list[str], limits: list[str], cases: list[dict[str, Any]], docs: Path) -> None:
    """The page, from the recordings of which everything has been made."""
    heads = (("threshold", "Thresholds", names), ("limit", "Limits of computing", limits))
    docs.mkdir(parents=True, exist_ok=True)
    parts = [table(made, own, cases) | {"what": what, "head": head} for what, head, own in heads if own]
    write_page(PAGE, docs / "README.md", count=len(fields(DEFAULT)), limits=len(LIMITS), parts=[p for p in parts if p["cases"]])


def main(arguments: list[str] | None = None) -> None:
    """Make what is missing of the diagnoses, and the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--work", type=Path, required=True, help="where recordings and diagnoses are kept")
    parser.add_argument("--count", type=int, default=20)
    parser.add_argument("--seed", type=int, default=77)
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--only", default="", help="thresholds to move, separated by commas; default all")
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--docs", type=Path, default=STUDIES / "diagnosis-settings")
    options = parser.parse_args(arguments)
    names = [f.name for f in fields(DEFAULT)]
    chosen = options.only.split(",") if options.only else list(QUICK) if options.quick else [*names, *LIMITS]
    names, limits = [n for n in chosen if n in names], [n for n in chosen if n in LIMITS]
    cases = answers(options.work, 2 if options.quick else options.count, options.seed, options.quick)
    store = options.work / "diagnoses.json"
    made = json.loads(store.read_text(encoding="utf-8")) if store.exists() else {}

    def keep() -> None:
        kept = store.with_suffix(".part")
        kept.write_text(json.dumps(made, indent=1), encoding="utf-8")
        kept.replace(store)
        written(made, names, limits, cases, options.docs)

    fresh = multiprocessing.get_context("spawn")
    for some in (names, limits):
        with concurrent.futures.ProcessPoolExecutor(options.jobs, mp_context=fresh) as pool:
            folder = options.work / "recordings"
            open_ = [c for c in cases if not all(key in made for key in _keys(c["case"], some))]
            runs = [pool.submit(of_recording, folder / c["case"], c["channel"], c["case"], some, made) for c in open_]
            for run in tqdm(concurrent.futures.as_completed(runs), total=len(runs), mininterval=10.0):
                made.update(run.result())
                keep()
    keep()


def _keys(case: str, some: Sequence[str]) -> dict[str, tuple[str, int]]:
    """Of every number moved both ways: the name of its diagnosis."""
    return {f"{case} {name} {way:+d}": (name, way) for name in some for way in (-1, 1)}


def of_recording(folder: Path, channel: str, case: str, some: Sequence[str], made: dict[str, Any]) -> dict[str, Any]:
    """The diagnoses of one recording that have not been made."""
    first = f"{case} as it stands"
    plain = made.get(first) or diagnosed(folder, channel, None, 0)
    alike = {name for name in some if name not in LIMITS}
    return {first: plain} | {
        key: plain if name in alike and f"{name} {way:+d}" not in plain["open"] else diagnosed(folder, channel, name, way)
        for key, (name, way) in _keys(case, some).items()
        if key not in made
    }


if __name__ == "__main__":
    main()
