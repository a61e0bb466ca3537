"""A hand that pushes a real tool: whether `diagnose` names it, when, where and with what force it pushed.

``python -m tests.studies.hand_on_tool`` from the repository runs it and writes ``docs/studies/hand-on-tool``; it needs the
recording ``kuka-med-wrist`` (`BAYESID_DATA`, by default `../shared`), which is not part of the repository: its source states no
licence.

Motion and readings are real, the push is added to the readings of one motion. All pushes are drawn before the first is
diagnosed, and the orientation of the sensor is made of the three rotations that the recording's source states, not by bayesid.
"""

from __future__ import annotations

import os
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

import bayesid
from bayesid.recordings.experiment import Experiment
from tests.studies.page import BLUE, GREEN, ORANGE, STYLE, parsed, write_numbers, write_page

FOLDER = Path(os.environ.get("BAYESID_DATA", "../shared")) / "data" / "kuka-med-wrist"
#: Seed of the pushes that judge; development used others.
SEED = 20_261_125
COUNT = 100
MOTIONS = ("baseline", "vibrations")
#: No push begins or ends closer to the recording's ends than this, where every reading fades [s]; and how long recordings are.
EDGE, LENGTH = 0.5, 6.25
#: Times are right to this [s].
TIMES = 0.2
#: Sensor axes in the world at joint positions zero: the URDF's fixed rotation.
_FIXED = Rotation.from_euler("xyz", [np.pi / 2, -np.pi / 2, 0.0])


@dataclass(frozen=True)
class Hand:
    """One push.

    Attributes
    ----------
    motion
        In which it is.
    start, end, ramp
        When, and how long it grows and fades [s].
    force, wavers
        Its steady part in base axes (3,) and what it wavers by at even times from start to end (m, 3) [N].
    point
        Where on the tool, in its frame (3,) [m].
    """

    motion: str
    start: float
    end: float
    ramp: float
    force: np.ndarray
    wavers: np.ndarray
    point: np.ndarray

    def course(self, times: np.ndarray) -> np.ndarray:
        """The force in base axes at some times (N, 3) [N]."""
        waver = CubicSpline(np.linspace(self.start, self.end, len(self.wavers)), self.wavers)
        grown = np.clip(np.minimum(times - self.start, self.end - times) / self.ramp, 0.0, 1.0)
        return (0.5 - 0.5 * np.cos(np.pi * grown))[:, None] * (self.force + waver(np.clip(times, self.start, self.end)))


def drawn(count: int, seed: int) -> list[Hand]:
    """All pushes, before anything is known of the answers."""
    rng, out = np.random.default_rng(seed), []
    for k in range(count):
        size, length = rng.uniform(5.0, 20.0), rng.uniform(1.0, 4.0)
        start = rng.uniform(EDGE, LENGTH - EDGE - length)
        direction = rng.normal(size=3)
        # A hand's force wavers by a third of its size, up to about two times a second.
        wavers = rng.normal(scale=size / 3.0 / np.sqrt(3.0), size=(max(round(length / 0.3), 3) + 1, 3))
        point = np.array([*rng.uniform(-0.03, 0.03, 2), rng.uniform(0.0, 0.15)])
        steady = size * direction / np.linalg.norm(direction)
        out.append(Hand(MOTIONS[k % 2], start, start + length, rng.uniform(0.1, 0.4), steady, wavers, point))
    return out


def pushed(experiment: Experiment, hand: Hand) -> Experiment:
    """The experiment with the push added to the readings of its motion: the sensor reads what it holds the tool with."""
    motions = []
    for m in experiment.motions:
        if m.name == hand.motion:
            turned = _FIXED * Rotation.from_euler("YXZ", m.table.positions)
            force = turned.inv().apply(hand.course(m.table.times))
            wrench = m.table.wrench - np.hstack([force, np.cross(hand.point, force)])
            m = replace(m, table=replace(m.table, wrench=wrench))
        motions.append(m)
    return replace(experiment, motions=tuple(motions))


def judge(hand: Hand | str) -> dict[str, Any]:
    """What is said of one recording, beside the truth; of a motion's name, of that motion as it was recorded."""
    experiment = bayesid.load_experiment(FOLDER)
    clean = isinstance(hand, str)
    motion, experiment = (hand, experiment) if clean else (hand.motion, pushed(experiment, hand))
    since = time.process_time()
    said = bayesid.diagnose(experiment, motions=[motion], progress=None).to_dict()
    seconds = time.process_time() - since
    names = [f"{e['name']}@{e['where']}" for e in said["effects"]]
    found = next((e for e in said["effects"] if e["name"] == "external_contact"), None)
    out = {"verdict": said["verdict"], "named": found is not None, "beside": names, "seconds": seconds}
    if clean:
        return out
    out |= {"size": float(np.linalg.norm(hand.force))}
    if found is None:
        return out
    course = found["course"]
    values = {key: p["value"] for key, p in found["parameters"].items()}
    if course is None:  # a contact of constant force
        times = np.arange(values["start"], values["end"], 0.05)
        force = np.tile([values["fx"], values["fy"], values["fz"]], (len(times), 1))
    else:
        times, force = np.array(course["t"]), np.column_stack([course[axis] for axis in ("fx", "fy", "fz")])
    true = hand.course(times)
    mean = true.mean(axis=0)
    off = np.array([values[f"point_{axis}"] for axis in "xyz"]) - hand.point
    truth = dict(zip(("fx", "fy", "fz", "point_x", "point_y", "point_z"), [*mean, *hand.point], strict=True))
    inside = [bool(found["parameters"][key]["low"] <= value <= found["parameters"][key]["high"]) for key, value in truth.items()]
    return out | {
        "place": found["where"], "course": course is not None,
        "start": values["start"] - hand.start, "end": values["end"] - hand.end,
        "force": float(np.sqrt(np.mean(np.sum((force - true) ** 2, axis=1)))),
        "point": float(np.linalg.norm(off)), "force_inside": inside[:3], "point_inside": inside[3:],
        "shown": {"t": times, "found": force, "true": true},
    }  # fmt: skip


def summarise(found: list[dict[str, Any]], clean: list[dict[str, Any]]) -> dict[str, Any]:
    """What the page shows."""
    named = [x for x in found if x["named"]]

    def of(key: str) -> np.ndarray:
        return np.array([x[key] for x in named])

    ends = np.abs(np.column_stack([of("start"), of("end")]))
    relative = of("force") / of("size")
    other = [name for x in found for name in x["beside"] if not name.startswith(("external_contact", "sensor_offset"))]
    return {
        "pushes": len(found), "named": len(named) / len(found), "courses": float(np.mean(of("course"))),
        "place": float(np.mean(of("place") == "joint3")), "timed": float(np.mean((ends <= TIMES).all(axis=1))),
        "start": _spread(ends[:, 0]), "end": _spread(ends[:, 1]), "force": _spread(of("force")), "relative": _spread(relative),
        "point": _spread(1e3 * of("point")), "force_inside": float(np.mean(of("force_inside"))),
        "point_inside": float(np.mean(of("point_inside"))), "others": {name: other.count(name) for name in sorted(set(other))},
        "verdicts": {v: sum(x["verdict"] == v for x in found) for v in sorted({x["verdict"] for x in found})},
        "missed": [x["size"] for x in found if not x["named"]], "seconds": float(np.median([x["seconds"] for x in found])),
        "clean": [{k: x[k] for k in ("verdict", "named", "beside")} for x in clean],
    }  # fmt: skip


def _spread(values: np.ndarray) -> dict[str, float]:
    return {"median": float(np.median(values)), "nine_in_ten": float(np.quantile(values, 0.9)), "most": float(values.max())}


def picture(shown: list[dict[str, Any]], path: Path) -> None:
    """The courses of some pushes beside what was added."""
    import matplotlib

    matplotlib.use("svg")
    import matplotlib.pyplot as plt

    with plt.rc_context(STYLE | {"svg.hashsalt": "bayesid"}):  # pyright: ignore[reportArgumentType]
        figure, axes = plt.subplots(1, len(shown), figsize=(10.5, 2.8), layout="constrained")
        for ax, x in zip(axes, shown, strict=True):
            for k, (axis, colour) in enumerate(zip(("fx", "fy", "fz"), (BLUE, ORANGE, GREEN), strict=True)):
                ax.plot(x["t"], x["true"][:, k], color=colour, lw=3.0, alpha=0.3)
                ax.plot(x["t"], x["found"][:, k], color=colour, lw=1.0, label=axis)
            ax.set_xlabel("time [s]")
        axes[0].set_ylabel("force in base axes [N]")
        figure.legend(*axes[-1].get_legend_handles_labels(), frameon=False, loc="outside upper right", ncols=3)
        figure.savefig(path, format="svg", metadata={"Date": None})
        plt.close(figure)


PAGE = """\
# A hand on the tool

{{ s.pushes }} pushes from seed {{ seed }}, all drawn before the first was diagnosed, on a real recording: a six-axis sensor in a
wrist that carries one rigid tool of 0.93 kg, turned by 180° in 6.3 s, twice (`baseline`, and `vibrations` with taps of a
hammer). A push is added to the readings of the motion that is fitted, by turns the one and the other; the other motion is clean
and not fitted.
The force is 5 to 20 N in any direction and wavers by a third of that, up to two times a second; it lasts 1 to 4 s with ramps of
0.1 to 0.4 s, at a point up to 0.15 m along the tool and 0.03 m beside its axis. No effect is stated: the offsets of the sensor,
which was not zeroed, are for `diagnose` to find as well. `python -m tests.studies.hand_on_tool` made this page and
[results.json](results.json); [diagnose](../../howto/diagnose.md#a-hand-on-the-robot) says how to use it.

| | |
|---|---|
| `external_contact` named | {{ p(s.named) }} |
| of these with its course | {{ p(s.courses) }} |
| at the tool | {{ p(s.place) }} |
| start and end both right to {{ times }} s | {{ p(s.timed) }} |
| named on the recordings as they are | {{ clean_named }} of {{ s.clean | length }} |

| error | median | nine in ten within | most |
|---|---|---|---|
| start [s] | {{ n(s.start) }} |
| end [s] | {{ n(s.end) }} |
| course of the force, root mean square over the push [N] | {{ n(s.force) }} |
| the same over the size of the force | {{ n(s.relative) }} |
| point [mm] | {{ n(s.point) }} |

![Courses of four pushes](courses.svg)

The first four pushes: wide and pale what was added, thin what was found.

Where times are wrong by more, it is in `vibrations`, whose tap at 4.2 s, near an end of the push, is taken in: the tool explains
it no more than the push.

95 % intervals hold {{ p(s.force_inside) }} of the components of the mean force and {{ p(s.point_inside) }} of those of the
point. The recording itself is off by 3 % of its signal for any rigid tool (the sensor's own acceleration was not published), and
that error follows the motion.

Verdicts: {% for v, c in s.verdicts.items() %}`{{ v }}` {{ c }}{{ ", " if not loop.last }}{% endfor %}; of the clean recordings
{% for c in s.clean %}`{{ c.verdict }}`{{ ", " if not loop.last }}{% endfor %}. Beside the contact and the sensor's offset were
named: \
{% for name, c in s.others.items() %}`{{ name }}` ({{ c }}){{ ", " if not loop.last }}{% else %}nothing{% endfor %}.
{% if s.missed %}Missed: pushes of {% for x in s.missed %}{{ "%.3g" % x }}{{ ", " if not loop.last }}{% endfor %} N,
where other effects, fitted
to the push, explain the recording as well.
{% endif %}A diagnosis takes {{ "%.2g" % s.seconds }} s of one processor in the median.

Here the tool is all that the sensor carries. For a sensor under the base the link that was pushed is found, too; that is tested
on simulated recordings (`tests/diagnosis/test_push.py`).
"""


def write(found: list[dict[str, Any]], clean: list[dict[str, Any]], seed: int, folder: Path) -> None:
    """Write the page, its numbers and its picture."""
    folder.mkdir(parents=True, exist_ok=True)
    picture([x["shown"] for x in found if x["named"]][:4], folder / "courses.svg")
    single = [{k: v for k, v in x.items() if k not in ("shown", "seconds", "beside")} for x in found]
    rounded = write_numbers({"seed": seed, **summarise(found, clean), "each": single}, folder / "results.json", digits=4)
    write_page(
        PAGE, folder / "README.md", s=rounded, seed=seed, times=TIMES, p=lambda x: f"{100 * x:.1f} %",
        n=lambda x: " | ".join(f"{x[k]:.2g}" for k in ("median", "nine_in_ten", "most")),
        clean_named=sum(x["named"] for x in clean),
    )  # fmt: skip


def main(arguments: list[str]) -> None:
    """Run from the command line."""
    given = parsed(arguments, __doc__, docs="hand-on-tool", count=COUNT, of="kind", seed=SEED)
    cases = [*MOTIONS, *drawn(given.count, given.seed)]
    if given.processes == 1:
        found = [judge(case) for case in cases]
    else:
        with ProcessPoolExecutor(given.processes, mp_context=get_context("spawn")) as pool:
            found = list(pool.map(judge, cases))
    write(found[len(MOTIONS) :], found[: len(MOTIONS)], given.seed, given.docs)


if __name__ == "__main__":
    main(sys.argv[1:])
