"""Do the bands of ``bounds`` hold the torques of recordings that nobody has shown to it, of other motions and other days?

``python -m tests.studies.band_coverage --write`` from the repository measures every case on the recordings below ``BAYESID_DATA``
and writes ``docs/studies/band-coverage``.

Recordings are read with numpy, low-passed and differentiated with SciPy; nothing of the fit but its bands is used.
"""

from __future__ import annotations

import argparse
import os
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.signal import butter, sosfiltfilt

import bayesid
from tests.studies.page import STUDIES, table, write_numbers, write_page

DATA = Path(os.environ.get("BAYESID_DATA", Path(__file__).resolve().parents[3] / "shared")) / "data"
DRIVES = ("viscous_friction", "coulomb_friction", "torque_offset", "rotor_inertia")
#: Of torques and positions [Hz], as bands are compared with torques everywhere; seconds at both ends that filters spoil.
BAND, ENDS = 10.0, 0.5


@dataclass(frozen=True)
class Case:
    """What is fitted, what is held out for bounds to see, and what judges: folder and table of each recording."""

    robot: str
    fitted: tuple[str, ...]
    held_out: tuple[str, ...]
    judges: tuple[str, ...]
    effects: tuple[str, ...] | None = None


_UR = {
    "31 January": "before/unload.csv", "5 February, 8": "feb05-20s-8h/motion.csv", "5 February, 12": "feb05-20s-12h/motion.csv",
    "6 February, 10": "feb06-20s-10h/motion.csv", "6 February, 5": "feb06-20s-5h/motion.csv",
}  # fmt: skip
UR10E = tuple(f"ur10e/{name}" for name in _UR.values())
JANUARY, EIGHT, TWELVE, TEN, FIVE = UR10E
KUKA = ("kuka-lwr4/measurements_1.csv", "kuka-lwr4/measurements_3.csv")
UR10, TX40 = ("ur10/first.csv", "ur10/last.csv"), ("tx40/identification.csv", "tx40/validation.csv")
CASES = (
    Case("UR10e", (JANUARY, EIGHT), (TEN,), (FIVE, TWELVE), DRIVES),
    Case("UR10e", (EIGHT,), (TEN,), (JANUARY, FIVE, TWELVE), DRIVES),
    Case("UR10e", (JANUARY,), (FIVE,), (EIGHT, TEN, TWELVE), DRIVES),
    Case("UR10e, no rotor inertia", (JANUARY,), (), (EIGHT, TEN, FIVE, TWELVE)),
    Case("UR10e", (JANUARY,), (), (EIGHT, TEN, FIVE, TWELVE), DRIVES),
    Case("UR10e", (EIGHT,), (), (JANUARY, TEN, FIVE, TWELVE), DRIVES),
    Case("UR10e", (TEN,), (), (JANUARY, EIGHT, FIVE, TWELVE), DRIVES),
    *(Case("KUKA LWR 4", (a,), (), (b,)) for a, b in (KUKA, KUKA[::-1])),
    *(Case("UR10", (a,), (), (b,)) for a, b in (UR10, UR10[::-1])),
    *(Case("TX40", (a,), (), (b,)) for a, b in (TX40, TX40[::-1])),
)  # fmt: skip


def experiment_of(case: Case) -> bayesid.Experiment:
    """The recordings that are fitted and held out, as one experiment."""
    motions = []
    for path, role in [*((p, "identification") for p in case.fitted), *((p, "validation") for p in case.held_out)]:
        folder, name = (DATA / path).parent, Path(path).stem
        source = bayesid.load_experiment(folder)
        motion = next(m for m in source.motions if Path(str(m.table.source)).stem == name)
        motions.append((source, replace(motion, role=role, name=f"{folder.name}-{name}")))
    first = motions[0][0]
    return replace(
        first, motions=tuple(m for _, m in motions), warnings=(),
        **({} if case.effects is None else {"effects": case.effects, "effect_values": {}}),
    )  # fmt: skip


def states(path: str) -> tuple[np.ndarray, ...]:
    """Times (N,), positions, velocities, accelerations and torques of a recording below 10 Hz, (N, n) each."""
    with (DATA / path).open(encoding="utf-8") as file:
        head = file.readline().strip().split(",")
    values = np.loadtxt(DATA / path, delimiter=",", skiprows=1)
    t = values[:, head.index("t")]
    q, tau = (values[:, [k for k, name in enumerate(head) if name.strip("0123456789") == kind]] for kind in ("q", "tau"))
    step = float(np.median(np.diff(t)))
    q, tau = (sosfiltfilt(butter(2, BAND, fs=1.0 / step, output="sos"), x, axis=0) for x in (q, tau))
    v = np.gradient(q, step, axis=0)
    inner = slice(round(ENDS / step), -round(ENDS / step))
    return tuple(x[inner] for x in (t, q, v, np.gradient(v, step, axis=0), tau))


def measured(case: Case) -> dict[str, Any]:
    """Shares inside and relative widths of one case, by judging recording and joint."""
    fit = bayesid.identify(experiment_of(case), channel="torque")
    bounds = bayesid.bounds(fit, configurations=8)
    inside, width, error = [], [], []
    for path in case.judges:
        t, q, v, a, torque = states(path)
        band = bounds.torque(q, v, a, t)
        inside.append(np.mean((torque >= band.pointwise_low) & (torque <= band.pointwise_high), axis=0))
        need = np.quantile(np.abs(torque - band.values), 0.95, axis=0)
        width.append(np.mean(band.pointwise_high - band.pointwise_low, axis=0) / 2 / need)
        error.append(np.linalg.norm(torque - band.values) / np.linalg.norm(torque))
    return {"inside": np.array(inside), "width": np.array(width), "error": np.array(error)}


def title(case: Case) -> dict[str, str]:
    """How a case is told in the table."""
    days = {f"ur10e/{path}": f"{day} h" if "," in day else day for day, path in _UR.items()}

    def told(paths: tuple[str, ...]) -> str:
        return "; ".join(days.get(p, Path(p).stem.replace("_", " ")) for p in paths) or "none"

    return {"robot": case.robot, "fitted": told(case.fitted), "held_out": told(case.held_out), "judges": told(case.judges)}


PAGE = """\
# Bands on other days

Bands of [`bounds`](../../howto/controller.md), held against recordings that were neither fitted nor held out: positions and
torques below 10 Hz, read and differentiated with NumPy and SciPy alone. Each row fits some recordings, shows others to
`bounds` as validation motions, and judges on the rest. 95 % of the samples should be inside the pointwise bands. The width is
half a band over what the residuals need, the 95 % quantile of their size: bands that follow speed and posture can be below 1
and still hold 95 %. `python -m tests.studies.band_coverage --write` made this page and [results.json](results.json).

{{ rows }}

Shares and widths are means over recordings and joints; in brackets the least and the largest of a joint in a recording. The error
is that of the centre of the band, the estimate's, over the torques, all joints together.

A band is worth what the recordings show of the model's error. With a motion held out it is measured there; without one it is that
of the fitted motion, enlarged by what the fit took of it, and the headline of `bounds` says that nothing shows another motion or
day. The KUKA is the example of why: its third recording is gentler than the first, and so are the bands that it gives alone.
Where parts of one recording contradict each other, as those of the UR10 and of the KUKA's first do, the covariance is
multiplied for it; other recordings of these robots show that this is too careful, and bands without a held-out motion are wide.

On simulated robots whose model is complete nothing is added: [bounds held against the truth](../controller-bounds/README.md).
"""


def write(result: dict[str, Any], folder: Path = STUDIES / "band-coverage") -> None:
    """Page and JSON."""
    rounded = write_numbers(result, folder / "results.json", digits=4)
    head = "robot | fitted | held out | judged on | inside, % | width | error, %"
    rows = []
    for case, found in zip(CASES, rounded["cases"], strict=True):
        shares, widths = 100.0 * np.array(found["inside"]), np.array(found["width"])
        cells = [f"{x.mean():.{d}f} ({x.min():.{d}f} … {x.max():.{d}f})" for x, d in ((shares, 1), (widths, 2))]
        cells.append(f"{100 * np.mean(found['error']):.2f}")
        rows.append("| " + " | ".join([*title(case).values(), *cells]) + " |")
    write_page(PAGE, folder / "README.md", rows=table(head, rows))


def main(arguments: list[str]) -> None:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", action="store_true")
    given = parser.parse_args(arguments)
    cases = []
    for case in CASES:
        cases.append(measured(case))
        shown = (np.round(100 * cases[-1][k].mean(), 1) for k in ("inside", "width", "error"))
        print(*title(case).values(), *shown, sep=" | ", flush=True)
    if given.write:
        write({"cases": cases})


if __name__ == "__main__":
    main(sys.argv[1:])
