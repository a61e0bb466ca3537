"""Whether intervals of a payload hold the truth, and whether a hidden fault of the sensor or the mount is named.

``python -m tests.studies.payload`` from the repository runs it and writes ``docs/studies/payload-coverage``.

Each recording is of another tool (0.1 to 5 kg) on another sensor (noise, offset) in the wrist of a UR5-like arm: poses at rest,
or a motion. Every other one hides a fault, three times as large as the smallest that could be told from noise: `size_of`.
Nothing in bayesid was chosen on these recordings.
"""

from __future__ import annotations

import sys
import tempfile
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

import bayesid
from bayesid.diagnosis.settings import DEFAULT
from bayesid.dynamics.channels import WRENCH_NAMES, wrench_channels
from bayesid.dynamics.regressors import Kernel
from bayesid.recordings.experiment import Experiment, Sensor
from bayesid.robot import inertia
from bayesid.simulation.trajectories import Trajectory
from bayesid.tasks import cluster, map_tasks
from tests import robots
from tests.studies.page import STUDIES, parsed, write_numbers, write_page

#: Seed of the recordings that judge; development used others.
SEED = 20_261_127
COUNT = 500
#: How many times as large a fault is as the smallest that could be told.
TIMES = 3.0
Faults = dict[str, tuple[dict[str, float], float]]
#: Faults at a small size, and how many times that is the most that a fault may be: larger ones are seen by eye.
FAULTS: Faults = {
    "sensor_gain@{axis}": ({"gain": 0.01}, 30.0),
    "sensor_crosstalk@{axis}->{other}": ({"coefficient": 0.002}, 100.0),
    "sensor_rotation@sensor": ({"rx": 0.006, "ry": -0.005, "rz": 0.007}, 30.0),
    "base_tilt@base": ({"x": 0.008, "y": -0.006}, 30.0),
    "sensor_drift@sensor": (dict(zip(WRENCH_NAMES, (0.001, -0.0008, 0.0012, 5e-5, -4e-5, 3e-5), strict=True)), 1000.0),
    "tether@joint6": (
        {"stiffness": 1.0, "rest_length": 0.2, "anchor_x": 0.3, "anchor_y": -0.4, "anchor_z": 1.2,
         "point_x": 0.02, "point_y": 0.08, "point_z": 0.05}, 100.0,
    ),
}  # fmt: skip
POSE = Sensor("wrist_ft", np.array([0.0, 0.0, 0.0]), np.array([0.0, 0.0, 0.0]))


@dataclass(frozen=True, eq=False)
class Case:
    """A recording and its truth.

    Attributes
    ----------
    simulation
        The recording.
    body
        Ten parameters of what the sensor carries, in its frame.
    offset
        Of the sensor (6,).
    kind
        ``poses`` or ``motion``.
    fault, times, values
        ``name@where``, empty without one, its size in smallest visible ones, and its parameters.
    """

    simulation: Experiment
    body: np.ndarray
    offset: np.ndarray
    kind: str
    fault: str
    times: float
    values: dict[str, float]


def draw(index: int, seed: int, folder: Path, faults: Faults = FAULTS) -> Case:
    """The recording of a number, with one of some faults where the number is odd."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(index,)))
    robot = bayesid.load_robot(robots.write(folder, robots.wrist_sensor_arm()), sensor_joint="wrist_ft")
    body = tool(rng)
    links = robot.nominal.copy()
    links[6] = body
    force = 10.0 ** rng.uniform(np.log10(0.02), np.log10(0.3))
    recorder = bayesid.Recorder(force_std=force, torque_std=force * rng.uniform(0.02, 0.08), resolution=1e-5)
    offset = np.concatenate([rng.uniform(-20.0, 20.0, 3), rng.uniform(-1.0, 1.0, 3)])
    kind = "motion" if index % 5 == 4 else "poses"
    if kind == "poses":
        q = rng.uniform(-2.5, 2.5, (rng.integers(12, 41), robot.n))
        path = Trajectory("poses", "identification", np.arange(float(len(q))), q, 0.0 * q, 0.0 * q, kind="poses")
    else:
        path = bayesid.fourier_trajectory(robot, duration=12.0, seed=int(rng.integers(1 << 30)))
    setup = Experiment(name=f"tool{index}", robot=robot, motions=(), sensor=POSE)
    effects: dict[str, dict[str, float]] = {"sensor_offset": dict(zip(WRENCH_NAMES, offset.tolist(), strict=True))}
    fault, times = "", 0.0
    if index % 2:
        fault, values, times = _fault(rng, faults, setup, links, path, recorder)
        effects[fault] = values
    made = bayesid.simulate(setup, [path], effects=effects, links=links, recorder=recorder, seed=int(rng.integers(1 << 30)))
    assert made.sensor is not None  # what a data sheet says is not told
    return Case(
        replace(made, sensor=replace(made.sensor, force_std=None, torque_std=None)),
        body,
        offset,
        kind,
        fault,
        times,
        effects.get(fault, {}),
    )


def tool(rng: np.random.Generator) -> np.ndarray:
    """A body of 0.1 to 5 kg, larger the heavier it is, with a random inertia, its middle up to 0.2 m off."""
    mass = 10.0 ** rng.uniform(-1.0, np.log10(5.0))
    radius = 0.08 * mass ** (1.0 / 3.0) * rng.uniform(0.7, 1.4)
    second = np.diag(mass * (radius * rng.uniform(0.2, 0.7, 3)) ** 2)
    turn = pin.exp3(rng.normal(size=3))
    second = turn @ second @ turn.T
    centre = np.array([*rng.uniform(-0.05, 0.05, 2), rng.uniform(0.02, 0.2)])
    return inertia.from_mass_com_inertia(mass, centre, np.trace(second) * np.eye(3) - second)


def _fault(rng, faults, setup, links, path, recorder) -> tuple[str, dict[str, float], float]:
    """A fault with its values, and how many times as large as the smallest visible one it is."""
    kinds = [f for f in faults if path.kind != "poses" or "delay" not in f]
    pattern = kinds[int(rng.integers(len(kinds)))]
    axis, other = rng.choice(6, 2, replace=False)
    spec = pattern.format(axis=WRENCH_NAMES[axis], other=WRENCH_NAMES[other])
    values, most = faults[pattern]
    one = size_of(spec, values, setup, links, path, recorder)
    times = TIMES / max(one, 1e-9)
    scale = min(times, most)
    held = {"rest_length", "anchor_x", "anchor_y", "anchor_z", "point_x", "point_y", "point_z"}
    return spec, {k: v if k in held else scale * v for k, v in values.items()}, one * scale


def size_of(spec, values, setup, links, path, recorder) -> float:
    """How many times as large a fault is as the smallest that brings the evidence that the diagnosis asks for.

    What it adds to the readings, in standard deviations and less what ten parameters of a body and six offsets can take up, is a
    vector s. A fault of k parameters brings ``|s|^2 / 2 - k / 2 log N`` in log evidence on average.
    """
    silent = bayesid.Recorder(force_std=0.0, torque_std=0.0, resolution=0.0)
    with_it, without = (
        bayesid.simulate(setup, [path], effects=e, links=links, recorder=silent, seed=1).motions[0].table
        for e in ({spec: values}, {})
    )
    channels = wrench_channels(setup.robot, np.eye(3), np.zeros(3))
    columns = Kernel.of(setup.robot, channels).dynamics(path.positions, path.velocities, path.accelerations)[:, :, 60:70]
    columns = np.concatenate([columns, np.tile(np.eye(6), (len(columns), 1, 1))], axis=2)
    weight = 1.0 / np.repeat([recorder.force_std, recorder.torque_std], 3)
    x = (columns * weight[:, None]).reshape(-1, 16)
    s = ((with_it.wrench - without.wrench) * weight).ravel()
    s = s - x @ np.linalg.lstsq(x, s, rcond=1e-10)[0]
    needed = 2.0 * (DEFAULT.accept + 0.5 * len(values) * np.log(len(s)))
    return float(np.sqrt(s @ s / needed))


def judge(index: int, seed: int) -> dict[str, Any]:
    """What is said of one recording, beside its truth."""
    with tempfile.TemporaryDirectory() as folder:
        case = draw(index, seed, Path(folder))
        result = bayesid.payload(case.simulation, progress=None)
    mass, centre, about = inertia.to_mass_com_inertia(case.body)
    truth = [mass, *centre, *about[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]]
    plain, offset = result.plain, result.offset
    told = {s for e in result.effects for s in (e.spec, *e.ambiguous_with)}
    return {
        "kind": case.kind, "fault": case.fault, "times": case.times, "mass": mass, "verdict": result.verdict,
        "named": sorted(e.spec for e in result.effects), "told": case.fault in told,
        "shown": [q.shown for q in result.quantities],
        "inside": [bool(q.low <= t <= q.high) for q, t in zip(result.quantities, truth, strict=True)],
        "plain_inside": [bool(q.low <= t <= q.high) for q, t in zip(plain, truth[:4], strict=True)],
        "offset_inside": [bool(q.low <= t <= q.high) for q, t in zip(offset, case.offset, strict=True)],
        "error": float(result.mass.value - mass) if result.mass.shown else None,
        "plain_error": float(plain[0].value - mass) if plain[0].shown else None,
        "half": float(0.5 * (result.mass.high - result.mass.low)),
        "warned": any("unexplained" in w or "leaves the payload open" in w for w in result.warnings),
    }  # fmt: skip


def run(count: int, seed: int, processes: int) -> list[dict[str, Any]]:
    """`judge` of many recordings."""
    with cluster(processes):
        return list(map_tasks(partial(judge, seed=seed), range(count)))


def summarise(found: list[dict[str, Any]]) -> dict[str, Any]:
    """What the page shows: coverage, names and errors, without a fault and with one, by kind of recording and of fault."""
    out: dict[str, Any] = {"recordings": len(found), "groups": {}, "faults": {}}
    for name, faulty, kind in (
        ("poses", False, "poses"), ("poses, a fault hidden", True, "poses"),
        ("motion", False, "motion"), ("motion, a fault hidden", True, "motion"),
    ):  # fmt: skip
        own = [x for x in found if bool(x["fault"]) == faulty and x["kind"] == kind]
        out["groups"][name] = _group(own)
    for pattern in FAULTS:
        effect = pattern.partition("@")[0]
        own = [x for x in found if x["fault"].startswith(effect) and x["times"] > TIMES - 0.01]
        small = [x for x in found if x["fault"].startswith(effect) and x["times"] <= TIMES - 0.01]
        if own:
            out["faults"][effect] = {**_group(own), "told": _mean(own, "told"), "smaller": len(small)}
    clean, faulty = ([x for x in found if bool(x["fault"]) == f and (not f or x["times"] > TIMES - 0.01)] for f in (False, True))
    out["named_without"] = float(np.mean([bool(x["named"]) for x in clean]))
    out["told"] = _mean(faulty, "told")
    return out


def _group(own: list[dict[str, Any]]) -> dict[str, Any]:
    shown = np.array([x["shown"] for x in own])
    inside = np.array([x["inside"] for x in own])
    size = [abs(x["error"]) / x["mass"] for x in own if x["error"] is not None]
    plain = [abs(x["plain_error"]) / x["mass"] for x in own if x["plain_error"] is not None]
    return {
        "recordings": len(own), "coverage": inside[:, :4].mean(axis=0).tolist(), "coverage_mean": float(inside[:, :4].mean()),
        "plain_coverage_mean": _mean(own, "plain_inside"), "offset_coverage_mean": _mean(own, "offset_inside"),
        "inertia_coverage_mean": float(inside[:, 4:][shown[:, 4:]].mean()) if shown[:, 4:].any() else None,
        "shown": float(shown[:, :4].mean()), "inertia_shown": float(shown[:, 4:].mean()),
        "mass_error_median": float(np.median(size)) if size else None,
        "plain_mass_error_median": float(np.median(plain)) if plain else None,
    }  # fmt: skip


def _mean(own: list[dict[str, Any]], key: str) -> float:
    return float(np.mean([np.mean(x[key]) for x in own]))


PAGE = """\
# Payload: do intervals hold, are faults named?

{{ count }} simulated recordings from seed {{ seed }}, each of another tool (0.1 to 5 kg, its centre of mass up to 0.2 m off) on
another force/torque sensor (noise 0.02 to 0.3 N of one reading, offsets up to 20 N) in the wrist of a UR5-like arm: 12 to 40
poses at rest, or a motion of 12 s. The noise is not stated. Every other recording hides a fault, three times as large as the
smallest that could be told from noise, and no larger than what is missed by eye: a gain or cross-talk of an axis, a turned
sensor, a tilted base, drift (from pose to pose, or in motions), a cable at the tool.
`python -m tests.studies.payload` made this page and
[results.json](results.json); [What hangs at the flange](../../howto/payload.md) says how to use the verb.

*Coverage* is that of 95 % intervals of mass and of the three coordinates of the centre of mass, all four together; *plain* is
that of the same fit without what the diagnosis named. Where a number is not *shown*, its interval is what the readings exclude.
*Error* is the median error of the mass.

| recordings | count | coverage | plain | shown | sensor offset | inertia, where shown | error | plain |
|---|---|---|---|---|---|---|---|---|
{% for name, g in groups.items() -%}
| {{ name }} | {{ g.recordings }} | {{ pct(g.coverage_mean) }} % | {{ pct(g.plain_coverage_mean) }} % | \
{{ pct(g.shown) }} % | {{ pct(g.offset_coverage_mean) }} % | \
{{ pct(g.inertia_coverage_mean) + " %" if g.inertia_coverage_mean else "" }} | \
{{ pct2(g.mass_error_median) }} % | {{ pct2(g.plain_mass_error_median) }} % |
{% endfor %}

With no fault hidden something is named in {{ pct(named_without) }} % of the recordings. Of the faults of that size
{{ pct(told) }} % are named, alone or among names that the recording cannot tell apart.

| fault hidden | count | named | coverage | plain | shown |
|---|---|---|---|---|---|
{% for name, g in faults.items() -%}
| `{{ name }}` | {{ g.recordings }} | {{ pct(g.told) }} % | {{ pct(g.coverage_mean) }} % | \
{{ pct(g.plain_coverage_mean) }} % | {{ pct(g.shown) }} % |
{% endfor %}

A cable pulls much as weight does: with it in the model the interval is that of the profile likelihood, as wide as poses leave it.
Faults smaller than that size, {{ smaller }} here, count in the first table alone.
"""


def write(study: dict[str, Any], folder: Path = STUDIES / "payload-coverage") -> None:
    """Write the page and its numbers."""
    folder.mkdir(parents=True, exist_ok=True)
    rounded = write_numbers(study, folder / "results.json", digits=4)
    write_page(
        PAGE, folder / "README.md", count=rounded["recordings"], seed=rounded["seed"], groups=rounded["groups"],
        faults=rounded["faults"], named_without=rounded["named_without"], told=rounded["told"],
        smaller=sum(g["smaller"] for g in rounded["faults"].values()), pct2=lambda x: f"{100 * x:.2f}",
    )  # fmt: skip


def main(arguments: list[str]) -> None:
    """Run from the command line."""
    given = parsed(arguments, __doc__, docs="payload-coverage", count=COUNT, of="kind", seed=SEED)
    write({"seed": given.seed, **summarise(run(given.count, given.seed, given.processes))}, given.docs)


if __name__ == "__main__":
    main(sys.argv[1:])
