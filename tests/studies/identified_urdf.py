"""Is `identified.urdf` a robot that can exist, and does it predict as well as the estimate?

``python -m tests.studies.identified_urdf`` from the repository runs it and writes ``docs/studies/identified-urdf``.
Real recordings are taken from where ``BAYESID_DATA`` says (default ``../shared``) and left out where there are none; MuJoCo is
asked where it is installed (``pip install mujoco``).

Simulated: links drawn about the nominal ones; in turn joint torques with friction and noise, the same with friction left out of
the model, so that it lacks something, and the wrench of a base sensor. Seeds are fixed.
"""

from __future__ import annotations

import importlib.util
import os
import sys
import tempfile
import time
import warnings
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from threadpoolctl import threadpool_limits

import bayesid
from bayesid.recordings.experiment import Experiment
from bayesid.recordings.experiment import Motion as Recorded
from bayesid.results.fitted_model import LARGEST_GROWTH
from bayesid.robot.inertia import is_physically_consistent
from bayesid.robot.robot import load_robot
from bayesid.robot.urdf import write_urdf
from bayesid.simulation.simulation import perturbed_links
from bayesid.workflows.urdf_links import urdf_links
from tests.robots import ROBOTS, write
from tests.simulated import Motion, Sensor, experiment, fourier, recording
from tests.studies.page import parsed, table, write_numbers, write_page

DATA = Path(os.environ.get("BAYESID_DATA", "../shared")) / "data"
SEED, COUNT, POSTURES = 20_261_122, 100, 1000
FRICTION = ["viscous_friction", "coulomb_friction", "torque_offset"]
ARMS = ("ur5", "panda", "puma560", "lwr4")
NOISES = (0.05, 0.5, 3.0)


def real() -> dict[str, tuple[Experiment, list[str] | None]]:
    """Recordings of real robots, as their folders state them, and with joint friction where they state no effects."""
    out: dict[str, tuple[Experiment, list[str] | None]] = {}
    for path in sorted(DATA.rglob("experiment.toml")):
        name = "/".join(path.parent.relative_to(DATA).parts)
        made = _with_siblings(bayesid.load_experiment(path.parent), path.parent)
        out[name] = (made, None)
        if not made.effects and made.sensor is None:
            out[f"{name}, friction"] = (made, FRICTION)
    return out


def _with_siblings(made: Experiment, folder: Path) -> Experiment:
    """A recording of one motion, with those of the folders beside it that have the same robot and load to validate on."""
    if len(made.motions) > 1 or "load" in folder.name:
        return made
    others: list[Recorded] = []
    for path in sorted(folder.parent.glob("*/experiment.toml")):
        if path.parent != folder and "load" not in path.parent.name:
            (motion,) = bayesid.load_experiment(path.parent).motions
            others.append(replace(motion, name=path.parent.name, role="validation"))
    return replace(made, motions=(*made.motions, *others))


def simulated(index: int, seed: int, folder: Path) -> tuple[str, Experiment, list[str] | None]:
    """One of the simulated recordings: its name, the recording, the effects of the model."""
    name, noise = ARMS[index % len(ARMS)], NOISES[index // len(ARMS) % len(NOISES)]
    kind = ("torque", "torque, friction left out", "wrench")[index % 3]
    robot = load_robot(write(folder, ROBOTS[name]()))
    rng = np.random.default_rng([seed, index])
    truth = perturbed_links(robot, 0.3, int(rng.integers(2**31))).ravel()
    sensor = Sensor() if kind == "wrench" else None
    drag = rng.uniform(0.2, 2.0, (2, robot.n))
    motions = []
    for role in ("identification", "validation"):
        motion = fourier(robot, int(rng.integers(2**31)))
        made = recording(robot, sensor, motion, force_std=noise, torque_std=noise, resolution=1e-5, phi=truth,
                         seed=int(rng.integers(2**31)))  # fmt: skip
        assert made.torques is not None
        friction = drag[0] * motion[2] + drag[1] * np.sign(motion[2])
        motions.append(Motion(role, role, replace(made, torques=made.torques + friction)))
    effects = {"torque": FRICTION, "wrench": None}.get(kind, [])
    return f"{name}, {kind}, {noise:g}", experiment(robot, motions, sensor, inertia_rel_std=0.3), effects


def judge(made: Experiment, effects: list[str] | None, method: str = bayesid.DEFAULT_METHOD) -> dict[str, Any]:
    """What one `identified.urdf` is like."""
    result = bayesid.identify(made, method=method, effects=effects)
    with threadpool_limits(1, user_api="blas"):
        since = time.perf_counter()
        urdf_links(result.problem, result.estimate)
        seconds = time.perf_counter() - since
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "identified.urdf"
        write_urdf(made.robot, result.urdf.links, path, result.urdf.dynamics)
        model = pin.buildModelFromUrdf(str(path))
        mujoco = loads_in_mujoco(path)
    data, least = model.createData(), np.inf
    pin.seed(0)
    turn = np.full(model.nq, np.pi)
    for _ in range(POSTURES):
        upper = pin.crba(model, data, pin.randomConfiguration(model, -turn, turn))
        values = np.linalg.eigvalsh(np.triu(upper) + np.triu(upper, 1).T)
        least = min(least, float(values[0]))
    moved = result.urdf.moved
    growth = {motion: urdf / estimate - 1.0 for motion, (estimate, urdf) in result.urdf.errors.items()}
    worst = max(growth, key=lambda m: growth[m])
    return {
        "method": method,
        "unconstrained_possible": bool(is_physically_consistent(result.urdf.unconstrained.reshape(-1, 10)).all()),
        "possible": bool(result.physically_consistent),
        "sigma": None if moved is None else moved.distance,
        "allowed": None if moved is None else moved.allowed,
        "inside": moved is None or moved.inside,
        "largest": None if moved is None or moved.largest is None else moved.largest[1],
        "mujoco": mujoco,
        "least_eigenvalue": least,
        "held_out": worst,
        "validated": bool(result.validation),
        "error_estimate": result.urdf.errors[worst][0],
        "error_urdf": result.urdf.errors[worst][1],
        "growth": growth[worst],
        "said": any("identified.urdf predicts" in w for w in result.warnings),
        "heaviest": float(result.link_parameters[::10].max()),
        "seconds": seconds,
    }


def loads_in_mujoco(path: Path) -> bool | None:
    """Whether MuJoCo compiles the links and joints; None where it is not installed. Shapes are left out: they are not ours."""
    if importlib.util.find_spec("mujoco") is None:
        return None
    import mujoco

    root = ET.parse(path).getroot()
    for link in root.findall("link"):
        for shape in (*link.findall("visual"), *link.findall("collision")):
            link.remove(shape)
    try:
        mujoco.MjModel.from_xml_string(ET.tostring(root, encoding="unicode"))
    except ValueError:
        return False
    return True


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Counts over recordings."""
    within = [r["growth"] <= LARGEST_GROWTH for r in rows]
    return {
        "recordings": len(rows),
        "unconstrained_possible": sum(r["unconstrained_possible"] for r in rows),
        "possible": sum(r["possible"] for r in rows),
        "mujoco": None if any(r["mujoco"] is None for r in rows) else sum(r["mujoco"] for r in rows),
        "positive_definite": sum(r["least_eigenvalue"] > 0 for r in rows),
        "inside": sum(r["inside"] for r in rows),
        "within": sum(within),
        "within_or_said": sum(w or r["said"] for w, r in zip(within, rows, strict=True)),
        "slowest_ms": 1e3 * max(r["seconds"] for r in rows),
        "median_ms": 1e3 * float(np.median([r["seconds"] for r in rows])),
    }


def row(name: str, r: dict[str, Any]) -> str:
    """A line of the table of real recordings."""
    away = "own links" if r["sigma"] is None else f"{r['sigma']:.3g} / {r['allowed']:.3g}"
    answer = {None: "not tried", True: "yes", False: "**no**"}[r["mujoco"]]
    held = "" if r["validated"] else " (fitted)"
    before = "yes" if r["unconstrained_possible"] else "no"
    cells = [name, r["method"], before, away, f"{r['largest'] or 0:.2g}", answer, f"{r['least_eigenvalue']:.2g}"]
    cells += [f"{100 * r['error_estimate']:.3g}", f"{100 * r['error_urdf']:.3g}{held}", f"{r['heaviest']:.3g}"]
    return f"| {' | '.join(cells)} | {1e3 * r['seconds']:.0f} |"


PAGE = """\
# `identified.urdf` on real and simulated recordings

Links of `identified.urdf` can exist and are the nearest to the nominal ones within the estimate's uncertainty
([method.md](../../explanation/method.md), section 9). `python -m tests.studies.identified_urdf` made this page and
[results.json](results.json): every real recording at hand by `wls` and `sdp`, and {{ simulated.recordings }}
simulated ones by `wls` (four arms, 0.05 to 3 N m of noise; joint torques with friction in the model, with friction left out
of it, or the wrench of a base sensor), seeds from {{ seed }}.

| | real | simulated |
| --- | --- | --- |
{% for key, label in lines %}| {{ label }} | {{ real[key] }} | {{ simulated[key] }} |
{% endfor %}| median time of the links [ms] | {{ "%.0f" | format(real.median_ms) }} | {{ "%.0f" | format(simulated.median_ms) }} |
| slowest [ms] | {{ "%.0f" | format(real.slowest_ms) }} | {{ "%.0f" | format(simulated.slowest_ms) }} |

## Real recordings

*Possible before*: whether the nearest links with exactly the estimated base parameters could exist. *Moved*: joint distance of
the base parameters from the estimate, and the radius of its 95 % ellipsoid [sigma]; *most* is the largest distance of one, in its
own standard deviations. *Least eigenvalue*: of the mass matrix in {{ postures }} random postures [SI].
*Errors*: relative, of the rows of the motion that was not fitted on which the URDF loses most against the estimate [%].
The UR10e's recordings validate each other, but for the loaded one.

{{ table }}
"""


def main(arguments: list[str]) -> None:
    """Run from the command line."""
    given = parsed(arguments, __doc__, docs="identified-urdf", count=COUNT, of="simulated kind together", seed=SEED)
    warnings.simplefilter("ignore")
    lines, found = [], {}
    for name, (made, effects) in real().items():
        for method in (bayesid.DEFAULT_METHOD, "sdp"):
            found[f"{name}, {method}"] = judge(made, effects, method)
            lines.append(row(name, found[f"{name}, {method}"]))
            print(lines[-1], flush=True)
    drawn = {}
    with tempfile.TemporaryDirectory() as folder:
        for index in range(given.count):
            name, made, effects = simulated(index, given.seed, Path(folder))
            drawn[f"{index} {name}"] = judge(made, effects)
            print(row(name, drawn[f"{index} {name}"]), flush=True)
    out = {"seed": given.seed, "real": found, "simulated": drawn}
    given.docs.mkdir(parents=True, exist_ok=True)
    rounded = write_numbers(out, given.docs / "results.json", digits=4)
    head = ("recording | method | possible before | moved / radius | most | MuJoCo | least eigenvalue | error of the estimate "
            "| error of the URDF | heaviest link [kg] | time [ms]")  # fmt: skip
    keys = {
        "recordings": "recordings", "unconstrained_possible": "links with exactly the estimated base parameters could exist",
        "possible": "links of `identified.urdf` can exist (it loads in Pinocchio)", "mujoco": "loads in MuJoCo",
        "positive_definite": f"mass matrix positive definite in all of {POSTURES} postures",
        "inside": "base parameters inside the 95 % ellipsoid", "within": "error at most 5 % above the estimate's",
        "within_or_said": "that, or a warning says by how much and why",
    }  # fmt: skip
    write_page(
        PAGE, given.docs / "README.md", seed=given.seed, postures=POSTURES, lines=list(keys.items()),
        real=summary(list(rounded["real"].values())) if found else dict.fromkeys([*keys, "median_ms", "slowest_ms"], 0),
        simulated=summary(list(rounded["simulated"].values())), table=table(head, lines),
    )  # fmt: skip


if __name__ == "__main__":
    main(sys.argv[1:])
