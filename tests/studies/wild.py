"""Public logs as they are: what `check` and `identify` say of each, beside the right answer; with the remedy applied, the fit.

    python -m tests.studies.wild

needs the recordings (`BAYESID_DATA`, by default `../shared`), which are not part of the repository: several of their sources have
no licence. The right answers below are facts about them, found without bayesid (thirty lines of Pinocchio and least squares, and
what their sources say).
"""

from __future__ import annotations

import argparse
import json
import os
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

import bayesid
from bayesid.dynamics.channels import torque_channels
from bayesid.dynamics.regressors import Kernel
from bayesid.recordings.experiment import Experiment
from bayesid.recordings.table import Table
from bayesid.validation.mistakes.candidates import base_axes
from tests.studies.mistakes import changed, times
from tests.studies.page import STUDIES, table, write_numbers, write_page

WILD = Path(os.environ.get("BAYESID_DATA", "../shared")) / "wild"
#: What is said is one line of these.
SILENT, RIGHT, PART, WRONG, MISSED = "rightly nothing", "right", "right in part", "wrong", "nothing, though it should"


@dataclass(frozen=True)
class Answer:
    """What is right of a recording.

    Attributes
    ----------
    says
        In words.
    mistakes
        Names and places that `check` must name, each of them; what else it names is wrong.
    words
        What a warning or the refusal must hold, each of them.
    remedy
        The recording with the remedy applied; None: there is none, or none that the data hold.
    """

    says: str
    mistakes: tuple[tuple[str, str], ...] = ()
    words: tuple[str, ...] = ()
    remedy: Callable[[Experiment], Experiment] | None = None


def torques_times(*factors: float) -> Callable[[Experiment], Experiment]:
    """Each column of torques times a factor; one for all."""
    return lambda e: changed(e, times(np.diag(np.resize(factors, e.robot.n)), "torques"))


def ordered(*columns: int, arrays: tuple[str, ...]) -> Callable[[Experiment], Experiment]:
    """Columns in another order, from 0."""
    return lambda e: changed(e, times(np.eye(e.robot.n)[list(columns)], *arrays))


def wrench_negated(e: Experiment) -> Experiment:
    """The wrench of the sensor on the robot."""
    return changed(e, times(-np.eye(6), "wrench"))


def wrench_in_sensor(e: Experiment) -> Experiment:
    """A wrench in base axes turned into the sensor's, and its sign changed."""

    def turned(t: Table) -> Table:
        assert e.sensor is not None and t.wrench is not None
        rotation = base_axes(e.robot, e.sensor, t.positions)
        return replace(t, wrench=-np.einsum("nji,nkj->nki", rotation, t.wrench.reshape(-1, 2, 3)).reshape(-1, 6))

    return changed(e, turned)


def weight_added(e: Experiment) -> Experiment:
    """The gravity torques of the URDF's masses added to the torques."""

    def heavier(t: Table) -> Table:
        still = np.zeros_like(t.positions)
        weight = Kernel.of(e.robot, torque_channels(e.robot)).readings(t.positions, still, still, e.robot.nominal.ravel())
        return replace(t, torques=None if t.torques is None else t.torques + weight)

    return changed(e, heavier)


def upside_up(e: Experiment) -> Experiment:
    """Gravity the other way."""
    return replace(e, robot=replace(e.robot, gravity=-e.robot.gravity))


_MOTION = ("positions", "velocities", "commanded")
_CARRIED = ("gravity_removed", "tau1")
ANSWERS = {
    "02-kinova-gen3-unwrapped/raw": Answer("all torques have the opposite sign", (("torque_signs", ""),), (), torques_times(-1)),
    "03-med7-real/exp": Answer("all torques have the opposite sign", (("torque_signs", ""),), (), torques_times(-1)),
    "03-med7-real/flipped": Answer("nothing is wrong"),
    "04-tiago-motor-current/asrecorded": Answer(
        "amperes; the torso's weight is taken out; arm 3 and 4 have the opposite sign",
        (("torque_units", ""), ("torque_signs", "tau4,tau5"), _CARRIED), ("currents",),
        torques_times(1, 13.6, 13.6, -8.7, -8.7, -20.6, -20.6, -20.6),
    ),
    "04-tiago-motor-current/converted": Answer("the torso's weight is taken out", (_CARRIED,)),
    "04-tiago-motor-current/no-wrist-torque": Answer(
        "torques of five joints only; the torso's weight is taken out", (_CARRIED,), ("tau6",)
    ),
    "06-ati-orientation-only/as-given": Answer(
        "base axes, and the opposite sign", (("wrench_frame", "base, opposite"),), (), wrench_in_sensor
    ),
    "06-ati-orientation-only/rotated": Answer("the opposite sign", (("wrench_sign", ""),), (), wrench_negated),
    "06-ati-orientation-only/rotated-negated": Answer("nothing is wrong"),
    "07-ur-joint-states-order/control": Answer("nothing is wrong"),
    "07-ur-joint-states-order/alphabetical-declared": Answer("nothing is wrong"),
    "07-ur-joint-states-order/all-alphabetical": Answer(
        "columns 1 and 3 are exchanged", (("joint_order", "q1,q3"),), (), ordered(2, 1, 0, 3, 4, 5, arrays=(*_MOTION, "torques"))
    ),
    "07-ur-joint-states-order/effort-alphabetical": Answer(
        "torque columns 1 and 3 are exchanged", (("torque_order", "tau1,tau3"),), (),
        ordered(2, 1, 0, 3, 4, 5, arrays=("torques",)),
    ),
    "08-urdf-oddities/axis-not-unit": Answer("nothing is wrong"),
    "08-urdf-oddities/continuous-with-limits": Answer("nothing is wrong"),
    "08-urdf-oddities/gripper-2f85-as-is": Answer("nothing is wrong"),
    "08-urdf-oddities/gripper-2f85-mimic": Answer("mimicking joints do not follow", (), ("mimics",)),
    "08-urdf-oddities/joint-typo": Answer("a joint's name is misspelt", (), ("did you mean 'joint_7'",)),
    "08-urdf-oddities/negative-ixx": Answer("an inertia is impossible", (), ("no body can have", "forearm_link")),
    "08-urdf-oddities/negative-mass": Answer("a mass is negative", (), ("mass -0.9302 kg",)),
    "08-urdf-oddities/no-inertial-forearm": Answer("a link has no inertial", (), ("forearm_link", "inertial")),
    "08-urdf-oddities/rpy-tilted-world": Answer("the base is upside down", (("gravity_direction", "+z"),), (), upside_up),
    "08-urdf-oddities/tool-behind-fixed": Answer("nothing is wrong"),
    "09-log-oddities/control": Answer("nothing is wrong"),
    "09-log-oddities/duplicate-stamps": Answer("28 stamps are doubled", (), ("28 rows at the time of the row before",)),
    "09-log-oddities/gravity-subtracted": Answer(
        "the URDF's gravity torques are taken out", (("gravity_removed", "nominal"),), (), weight_added
    ),
    "09-log-oddities/nan-run-q3": Answer("a run of q3 is missing", (), ("q3",)),
    "09-log-oddities/t-nanoseconds": Answer("time is in nanoseconds", (), ("nanoseconds",)),
    "09-log-oddities/tau-held-8Hz": Answer("torques are held for 12 samples", (), ("held",)),
    "09-log-oddities/tau4-held-8Hz": Answer("tau4 is held for 12 samples", (), ("held", "tau4")),
    "09-log-oddities/tau-late-70ms": Answer(
        "torques are 70 ms late", (("torque_delay", ""),), (),
    ),
    "11-log-1kHz-position-40Hz/q-held": Answer("positions are held for 24 ms", (), ("held", "q1")),
    "11-log-1kHz-position-40Hz/q-and-v-held": Answer("positions and velocities are held for 24 ms", (), ("held", "q1")),
    "12-schunk-lwa4p-short/exp": Answer("nothing that the data tell is wrong"),
    "12-schunk-lwa4p-short/tau6-flipped": Answer("nothing that the data tell is wrong"),
}  # fmt: skip


def judged(name: str, answer: Answer) -> tuple[dict[str, Any], Experiment | None]:
    """What is said of a recording beside the right answer, and the recording where it is not refused."""
    start = time.process_time()
    try:
        experiment = bayesid.load_experiment(WILD / name)
        checked = bayesid.check(experiment)
    except bayesid.InputError as error:
        right = bool(answer.words) and all(word in str(error) for word in answer.words)
        return {"right": answer.says, "said": [str(error)], "verdict": RIGHT if right else WRONG}, None
    named = [(m.name, m.where) for m in checked.mistakes]
    told = [w for w in checked.warnings if any(word in w for word in answer.words)]
    there = sum(pair in named for pair in answer.mistakes)
    there += sum(any(word in line for line in checked.warnings) for word in answer.words)
    wanted = len(answer.mistakes) + len(answer.words)
    if set(named) - set(answer.mistakes):
        verdict = WRONG
    elif there == wanted:
        verdict = RIGHT if wanted else SILENT
    else:
        verdict = PART if there else MISSED
    said = [m.text for m in checked.mistakes] or told
    return {"right": answer.says, "said": said, "verdict": verdict, "seconds": time.process_time() - start}, experiment


def tried(name: str, answer: Answer) -> dict[str, Any]:
    """What is said of a recording, and the errors on its held-out motion as it is and with the remedy applied."""
    out, experiment = judged(name, answer)
    if experiment is not None:
        out["before"] = error_of(experiment)
        out["after"] = None if answer.remedy is None else error_of(answer.remedy(experiment))
    return out


def error_of(experiment: Experiment) -> float | None:
    """Largest error of `identify` on a motion that was not fitted; friction, offsets and rotors are fitted along with torques."""
    torque = experiment.sensor is None
    effects = ["viscous_friction", "coulomb_friction", "torque_offset", "rotor_inertia"] if torque else None
    result = bayesid.identify(experiment, effects=effects)
    return max((p.relative_error for p in result.validation), default=None)


def rows(results: dict[str, Any]) -> list[str]:
    """A row a recording."""
    out = []
    for name, r in results.items():
        said = " ".join(r["said"]).replace("|", "\\|") or "nothing"
        said = said if len(said) < 500 else said[:497] + "..."
        before, after = (f"{100 * v:.3g} %" if v is not None else "" for v in (r.get("before"), r.get("after")))
        out.append(f"| {name} | {r['right']} | {r['verdict']} | {said} | {before} | {after} |")
    return out


TEMPLATE = """# Public logs as they are

What `bayesid check` says of recordings that other people made and published, and of a few that were made after their questions,
beside the right answer; by `python -m tests.studies.wild`. The recordings are not part of the repository. How a
mistake is found stands in [method.md](../../explanation/method.md#mistakes); [mistakes](../mistakes/README.md) has mistakes
made on purpose.

Of {{ count }} recordings, {{ right }} are told rightly or rightly not commented upon, {{ part }} in part, {{ wrong }} wrongly and
{{ missed }} pass in silence though something is wrong.

{{ rows }}

*Error*: that of `identify` (default method; with torques, friction, offset and rotor inertia of every joint) on the worst motion
that was not fitted, relative to its readings below 10 Hz, as the recording is and with the remedy applied. All signs turned
round, or all of gravity, leave the error as it was, for least squares takes negative masses for it: what a robot that can exist
leaves of the readings before and after stands in the words of `check`.
"""


def page(results: dict[str, Any], docs: Path) -> None:
    """Write the page from its numbers."""
    verdicts = [r["verdict"] for r in results.values()]
    write_page(
        TEMPLATE, docs / "README.md", count=len(verdicts), right=verdicts.count(RIGHT) + verdicts.count(SILENT),
        part=verdicts.count(PART), wrong=verdicts.count(WRONG), missed=verdicts.count(MISSED),
        rows=table("recording | right answer | said | in words | error | with the remedy", rows(results)),
    )  # fmt: skip


def main() -> None:
    """Ask of every recording, print what is said, write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", help="recordings whose name holds this; no page is written")
    parser.add_argument("--from-json", action="store_true", help="write the page again from its numbers")
    parser.add_argument("--docs", type=Path, default=STUDIES / "wild")
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    if options.from_json:
        page(json.loads((options.docs / "results.json").read_text()), options.docs)
        return
    unknown = {str(f.parent.relative_to(WILD)) for f in WILD.glob("*/*/experiment.toml")} - set(ANSWERS)
    if unknown:
        print(f"no right answer is known of {', '.join(sorted(unknown))}")
    results = {}
    for name, answer in ANSWERS.items():
        if (options.only and options.only not in name) or not (WILD / name).is_dir():
            continue
        results[name] = tried(name, answer)
        print(rows({name: results[name]})[0], flush=True)
    if not options.only:
        page(write_numbers(results, options.docs / "results.json", 4), options.docs)


if __name__ == "__main__":
    main()
