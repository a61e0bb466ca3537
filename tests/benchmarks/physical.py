"""python tests/benchmarks/physical.py [--write]: the physically consistent estimate, directly and as one would write it in cvxpy.

The same problem in the same process, turn by turn: a 7-joint arm, torques of 40 s, links partly on the boundary.
``direct`` is triangular factor to certified solution; ``direct with compression`` starts from the raw rows, as
``cvxpy on raw rows`` does; ``cvxpy on the factor`` shows what compression alone buys.
"""

from __future__ import annotations

import argparse
import json
import statistics
import sys
import tempfile
import time
import warnings
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from bayesid.estimators.conic.bounds import Bounds
from bayesid.estimators.conic.links import LinkData, conic, link_prior
from bayesid.estimators.conic.physical import evidence_of
from bayesid.estimators.conic.problem import solve_conic
from bayesid.regression.linalg import undetermined
from tests.estimators.test_physical import by_cvxpy
from tests.physical_cases import arm, flat_bodies

ROOT = Path(__file__).resolve().parents[2]


def clock(work):
    """Seconds and result."""
    begin = time.perf_counter()
    result = work()
    return time.perf_counter() - begin, result


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--write", action="store_true")
    options = parser.parse_args()
    threadpool_limits(1, user_api="blas")  # two would wait for each other in matrices as small as these
    with tempfile.TemporaryDirectory() as folder:
        made = arm(Path(folder), "panda")
    rng = np.random.default_rng(1)
    regression, robot = made.problem.regression, made.robot
    truth = flat_bodies(robot, rng, 4).ravel()
    rows = made.matrix
    readings = rows @ (regression.base.matrix @ truth) + rng.normal(size=len(rows))

    def problem(matrix, target):
        data = LinkData.of(regression, matrix, target, None)
        evidence = evidence_of(matrix, target, undetermined(matrix), regression.base.rank)
        return data, link_prior(regression, data, evidence, None, "warped", 0.3)

    def compressed():
        r = np.linalg.qr(np.column_stack([rows, readings]), mode="r")
        return problem(r[: rows.shape[1], : rows.shape[1]], r[: rows.shape[1], -1])

    raw, factor = problem(rows, readings), compressed()
    units = conic(*factor).units
    times: dict[str, list[float]] = {}
    for _ in range(options.repeats):
        seconds, ours = clock(lambda: solve_conic(conic(*factor)))
        times.setdefault("direct", []).append(seconds)
        times.setdefault("direct with compression", []).append(clock(lambda: solve_conic(conic(*compressed())))[0])
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            seconds, theirs = clock(lambda: by_cvxpy(*raw, Bounds(), units))
            times.setdefault("cvxpy on raw rows", []).append(seconds)
            seconds, again = clock(lambda: by_cvxpy(*factor, Bounds(), units))
            times.setdefault("cvxpy on the factor", []).append(seconds)

    def ratio(name: str) -> list[float]:
        each = [slow / fast for slow, fast in zip(times["cvxpy on raw rows"], times[name], strict=True)]
        return [min(each), statistics.median(each), max(each)]

    whole = conic(*factor)

    def excess(x: np.ndarray) -> float:
        """Of the objective over the proved lower bound, relative."""
        away = whole.factor @ (x - whole.centre)
        return float((0.5 * away @ away - ours.bound) / (1.0 + ours.objective))

    others = {"cvxpy on raw rows": theirs, "cvxpy on the factor": again}
    result = {
        "rows": len(rows), "repeats": options.repeats,
        "milliseconds": {name: 1e3 * statistics.median(each) for name, each in times.items()},
        "times_faster_than_raw": ratio("direct"), "times_faster_with_compression": ratio("direct with compression"),
        "relative_gap": ours.gap, "links_on_boundary": int(np.count_nonzero(ours.ranks < 4)),
        "largest_difference_in_units": {name: float(np.abs((ours.x - x) / units).max()) for name, x in others.items()},
        "relative_excess_over_the_lower_bound": {name: excess(x) for name, x in {"direct": ours.x, **others}.items()},
    }  # fmt: skip
    text = json.dumps(result, indent=2)
    print(text)
    if options.write:
        (ROOT / "docs" / "studies" / "physical" / "speed.json").write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
