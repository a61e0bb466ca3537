"""Whether the twelve numbers that Liu et al. (1998) printed can belong to links that exist, and how light these can be.

    python case_studies/printed_estimate/run.py [--out DIR]

writes results.json, least_mass.png and README.md with its tables filled in; it takes seconds.
"""

from __future__ import annotations

import argparse
import json
import math
from fractions import Fraction
from itertools import product
from pathlib import Path

import numpy as np
from feasibility import (
    HALF_DIGIT,
    PRINTED,
    READINGS,
    Reading,
    base_parameters,
    least_mass,
    lightest,
    range_of_link_2,
    second_moments,
)
from present import figure, fill, plain, tables

from tests.example_robots import PAPER_ESTIMATE, PAPER_LABELS

HERE = Path(__file__).parent
PUMA_560_FROM_LINK_2 = 17.4 + 4.8 + 0.82 + 0.34 + 0.09  # kg, Armstrong et al. 1986; link 1 is not published
BALLS = tuple(Fraction(r) for r in ("1", "0.5", "0.4"))  # m
ERRORS = {"half the last digit": [HALF_DIGIT] * 12} | {
    f"{percent} %": [abs(p) * percent / 100 for p in PRINTED] for percent in (1, 5, 10)
}


def by_hand() -> float:
    """A bound that needs no programme [kg], for either sign of d2 and wherever I2 is about.

    The second parameter is the first moment of all moving mass along z1 from the shoulder, and the sixth holds its
    second moment and link 2's second moment along y2, which the tenth and twelfth give: Cauchy and Schwarz do the rest.
    """
    p = PAPER_ESTIMATE
    return p[1] ** 2 / (p[5] - (p[11] - p[9]) / 2)


def alone(d2: float) -> list[tuple[float | None, float | None]]:
    """Between which values each number may lie while the other eleven stay as printed (frame at joint 2)."""
    values, vectors = np.linalg.eigh(second_moments(np.array(PAPER_ESTIMATE), d2))
    root = vectors / np.sqrt(values)
    out = []
    for k, printed in enumerate(PAPER_ESTIMATE):
        # Q + t dQ >= 0 as long as 1 + t mu >= 0 for the eigenvalues mu of dQ in units of Q.
        mu = np.linalg.eigvalsh(root.T @ second_moments(np.eye(12)[k], d2) @ root)
        low = printed - 1 / mu[-1] if mu[-1] > 1e-9 else None
        high = printed - 1 / mu[0] if mu[0] < -1e-9 else None
        out.append((low, high))
    return out


def common_error(d2: float) -> float:
    """Largest share by which all numbers may be wrong in any combination and stay possible (frame at joint 2).

    The smallest eigenvalue of Q is concave in the numbers, so its minimum over a box lies at a corner.
    """
    printed = np.array(PAPER_ESTIMATE)
    used = [k for k in range(12) if np.any(second_moments(np.eye(12)[k], d2))]
    corners = np.zeros((2 ** len(used), 12))
    corners[:, used] = list(product((-1.0, 1.0), repeat=len(used)))
    low, high = 0.0, 1.0
    while high - low > 1e-6:
        share = 0.5 * (low + high)
        boxes = [second_moments(printed * (1 + share * corner), d2) for corner in corners]
        low, high = (share, high) if np.linalg.eigvalsh(boxes).min() >= 0 else (low, share)
    return low


def study(reading: Reading) -> dict:
    """Least masses of one reading."""
    best = least_mass(reading)
    bodies = best.bodies
    if list(base_parameters(reading, bodies)) != PRINTED:
        raise RuntimeError("the lightest bodies do not have the printed numbers")
    balls = {}
    for radius in BALLS:
        held = least_mass(reading, radius=radius)
        balls[str(float(radius))] = {"lower": _down(held.lower), "upper": _up(held.upper), "masses": held.masses}
    errors = {}
    for name, size in ERRORS.items():
        loose = least_mass(reading, errors=size)
        errors[name] = {"lower": _down(loose.lower), "upper": _up(loose.upper)}
    smallest, greatest = range_of_link_2(reading)
    return {
        "d2": float(reading.d2), "elbow": reading.elbow,
        "lower": _down(best.lower), "upper": _up(best.upper), "masses": best.masses,
        "prices": [float(y) for y in best.prices],
        "bodies": bodies.astype(float).tolist(),
        "balls": balls, "errors": errors, "link_2": [smallest, greatest],
        "with_puma_560_link_2": lightest(reading, second=PUMA_560_FROM_LINK_2),
    }  # fmt: skip


def _down(value: Fraction) -> float:
    return math.floor(value * 1000) / 1000


def _up(value: Fraction) -> float:
    return math.ceil(value * 1000) / 1000


def curves(points: int) -> dict:
    """What the figure shows; by the solver alone."""
    out: dict = {"trade": {}, "offset": {}, "ball": {}}
    for name, reading in READINGS.items():
        first, last = range_of_link_2(reading)
        assert first is not None
        # Near its limits link 2 is flat, which the solver does not like.
        seconds = np.linspace(first + 0.01, (last or 30.0) - 0.01, points)
        out["trade"][name] = _defined((m, lightest(reading, second=m), m) for m in seconds.tolist())
        radii = [Fraction(round(1000 * r), 1000) for r in np.geomspace(0.25, 2.0, points)]
        out["ball"][name] = _defined((float(r), lightest(reading, radius=r), 0.0) for r in radii)
    for elbow in (False, True):
        offsets = [Fraction(round(10000 * d), 10000) for d in np.linspace(-0.3, 0.3, points)]
        name = "elbow" if elbow else "joint 2"
        out["offset"][name] = _defined((float(d), lightest(Reading(d, elbow)), 0.0) for d in offsets)
    return out


def _defined(rows) -> list[tuple[float, float]]:
    return [(x, mass - less) for x, mass, less in rows if mass is not None]


def run(points: int = 40) -> dict:
    """All results."""
    cases = {name: study(reading) for name, reading in READINGS.items()}
    offsets = sorted({case["d2"] for case in cases.values()})
    return {
        "printed": dict(zip(PAPER_LABELS, PAPER_ESTIMATE, strict=True)),
        "puma_560_from_link_2": PUMA_560_FROM_LINK_2,
        "by_hand": by_hand(),
        "second_moments": {str(d2): np.linalg.eigvalsh(second_moments(np.array(PAPER_ESTIMATE), d2)).tolist() for d2 in offsets},
        "alone": {str(d2): alone(d2) for d2 in offsets},
        "common_error": {str(d2): common_error(d2) for d2 in offsets},
        "cases": cases,
        "curves": curves(points),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=HERE, help="folder for results.json, the figure and the filled README.md")
    out = parser.parse_args().out
    out.mkdir(parents=True, exist_ok=True)
    results = run()
    filled = fill((HERE / "README.md").read_text(encoding="utf-8"), tables(results))
    (out / "results.json").write_text(json.dumps(plain(results), indent=1) + "\n", encoding="utf-8")
    (out / "README.md").write_text(filled, encoding="utf-8")
    figure(results, out / "least_mass.png")
    print(filled)


if __name__ == "__main__":
    main()
