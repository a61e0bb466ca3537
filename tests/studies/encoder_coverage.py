"""Coverage of intervals with encoder noise, on recordings of a plant that is not the estimator's model.

``python -m tests.studies.encoder_coverage`` from the repository runs it and writes ``docs/studies/encoder-coverage``.
Robots and sensor are those of `coverage_case`, its motions a few times faster, so that encoders matter; readings come from
Pinocchio's recursive Newton-Euler algorithm with a free-flyer under the base. Every recording is of another robot, whose links
are unlike the URDF's: intervals of an estimator that knows the URDF are to hold for robots like that, not for one of them.

One kind, ``servo``, is made as a real recording comes about: a controller makes joints with friction follow another motion each
time, so that accelerations jump a little wherever a joint reverses, faster than any encoder shows; each reading is the mean
over its sample's time; and there is no static run. ``MuJoCo`` is the same with arm, friction and sensor simulated by that engine.
"""

from __future__ import annotations

import json
import sys
import warnings
from dataclasses import replace
from functools import cache, partial
from typing import Any

import numpy as np
import pinocchio as pin
from scipy.stats import norm
from threadpoolctl import threadpool_limits

from bayesid import estimators
from bayesid.errors import BayesidWarning
from bayesid.posterior.model import PosteriorModel
from bayesid.posterior.run import choose_engine
from bayesid.recordings.experiment import Experiment, Motion, Sensor, Table
from bayesid.regression.options import FitOptions
from bayesid.regression.problem import prepare
from bayesid.tasks import cluster, map_tasks
from tests.studies.coverage_case import ARMS, DURATION, NOISE, OFFSET, RATE, Setup, links_unlike, setup
from tests.studies.interval_coverage import LEVEL, NAMES, band
from tests.studies.page import parsed, write_numbers, write_page

SEED = 20_261_122
COUNT = 200
#: Of an arm with so many parameters more, this share of the recordings.
SHARE = {"puma": 1.0, "ur5": 0.5}
#: How many times faster than those of `coverage_case` motions are; their speed stays, so they are as many times smaller.
FASTER = 4.0
#: Root mean square of the encoders' errors [rad].
STDS = (0.0, 5e-6, 2e-5, 1e-4)
METHODS = ("ols", "wls", "gls", "tls", "iv", "huber", "student", "sdp")
POSTERIOR = "posterior, flat prior"
DRAWS = 500
#: Robot, errors [rad], and whether they are white, counts, or white on a motion that is controlled.
CASES = {
    f"{arm}, {kind}, {std:g} rad": (arm, std, kind)
    for arm in ARMS
    for kind in ("white", "counts")
    for std in STDS
    if std > 0.0 or kind == "white"
} | {
    "puma, servo, 2e-05 rad": ("puma", 2e-5, "servo"),
    "puma, MuJoCo, 2e-05 rad": ("puma", 2e-5, "MuJoCo"),
    "ur5, MuJoCo, 2e-05 rad": ("ur5", 2e-5, "MuJoCo"),
}
#: Frequencies of a controlled motion, multiples of 0.05 Hz, and its largest acceleration [rad/s^2].
WAVES, FASTEST = np.arange(8, 23), 5.0
#: The controller's natural frequency [Hz] and damping ratio, Coulomb friction of each joint [N m] and the speed [rad/s] that it
#: reverses within.
CONTROL, DAMPING, COULOMB, REVERSAL = 12.0, 0.7, 1.5, 0.004
#: Steps of the simulation a sample: MuJoCo's are of first order.
STEPS = {"pinocchio": 8, "mujoco": 16}


@cache
def plant(arm: str) -> pin.Model:
    """Pinocchio's model of an arm on a free-flyer; `wrench` gives it the links of each recording's robot."""
    case = setup(arm)
    return _with_active_joints(case, pin.buildModelFromXML(case.arm.urdf(), pin.JointModelFreeFlyer()), 2)


def _with_active_joints(case: Setup, model: pin.Model, first: int) -> pin.Model:
    """The model, of which the arm's joints are those from the first one on, with the locked ones fixed."""
    active = case.arm.joints or tuple(model.names)[first:]
    still = [model.getJointId(name) for name in tuple(model.names)[first:] if name not in active]
    reference = pin.neutral(model)
    for name, angle in case.arm.locked.items():
        reference[model.joints[model.getJointId(name)].idx_q] = angle
    if still:
        model = pin.buildReducedModel(model, still, reference)
    model.gravity.linear = np.array([0.0, 0.0, -9.81])
    return model


def servo(arm: str, links: np.ndarray, rng: np.random.Generator, engine: str) -> tuple[np.ndarray, np.ndarray]:
    """Positions (N, n) of joints with friction that a controller moves, and the mean wrench over each sample's time (N, 6).

    The ``engine`` moves them and makes the wrench: ``pinocchio`` or ``mujoco``.
    """
    case = setup(arm)
    model = _with_active_joints(case, pin.buildModelFromXML(case.arm.urdf()), 1)
    for joint, link in enumerate(links.reshape(-1, 10)):
        model.inertias[joint + 1] = pin.Inertia.FromDynamicParameters(link)
    steps = STEPS[engine]
    data, step, n = model.createData(), 1.0 / RATE / steps, case.robot.n
    times = step * np.arange(round(RATE * DURATION) * steps)
    rate, phase = 2 * np.pi * 0.05 * WAVES, rng.uniform(0.0, 2 * np.pi, (len(WAVES), n))
    size, angle = rng.normal(size=(len(WAVES), n)), times[:, None, None] * rate[:, None] + phase
    wanted_a = np.sum(size * np.cos(angle), axis=1)
    scale = FASTEST / np.abs(wanted_a).max(axis=0)
    size = scale * size
    wanted = case.centre - np.sum(size / rate[:, None] ** 2 * np.cos(angle), axis=1)
    wanted_v, wanted_a = np.sum(size / rate[:, None] * np.sin(angle), axis=1), scale * wanted_a
    frequency = 2 * np.pi * CONTROL

    def torque(k: int, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """What the controller asks of the drives."""
        asked = wanted_a[k] + 2 * DAMPING * frequency * (wanted_v[k] - v) + frequency**2 * (wanted[k] - q)
        return pin.rnea(model, data, q, v, asked)

    q, v = wanted[0].copy(), wanted_v[0].copy()
    if engine == "mujoco":
        from tests.studies import mujoco_plant  # only here is MuJoCo needed

        moved, read = mujoco_plant.recorded(
            model, links, COULOMB, step, (q, v), (partial(torque, k) for k in range(len(times)))
        )  # fmt: skip
    else:
        states = np.empty((3, len(times), n))
        for k in range(len(times)):
            a = pin.aba(model, data, q, v, torque(k, q, v) - COULOMB * np.tanh(v / REVERSAL))
            states[:, k] = q, v + 0.5 * step * a, a  # the speed at the time of the position, as central differences have it
            v = v + step * a
            q = q + step * v
        moved, read = states[0], wrench(arm, links, *states)
    # A sample's position is that of the middle of its time, between two steps.
    middle = moved.reshape(-1, steps, n)[:, steps // 2 - 1 : steps // 2 + 1].mean(axis=1)
    return middle, read.reshape(-1, steps, 6).mean(axis=1)


def wrench(arm: str, links: np.ndarray, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
    """Force and moment of the ground on the base of a robot with such links (N, 6) [N, N m]."""
    model = plant(arm)
    for joint, link in enumerate(links.reshape(-1, 10)):
        model.inertias[joint + 2] = pin.Inertia.FromDynamicParameters(link)
    data, base = model.createData(), np.zeros((len(q), 6))
    place = np.concatenate([base, np.ones((len(q), 1)), q], axis=1)
    states = zip(place, np.concatenate([base, v], axis=1), np.concatenate([base, a], axis=1), strict=True)
    return np.array([pin.rnea(model, data, *state)[:6].copy() for state in states])


def record(name: str, rng: np.random.Generator) -> tuple[Experiment, np.ndarray]:
    """One recording of a case, and the links of its robot (10 n,)."""
    arm, std, kind = CASES[name]
    case = setup(arm)
    links = links_unlike(case.robot, rng)
    times = np.arange(round(RATE * DURATION)) / RATE
    if kind in ("servo", "MuJoCo"):
        q, read = servo(arm, links, rng, "pinocchio" if kind == "servo" else "mujoco")
        q, read = q + std * rng.normal(size=q.shape), read + NOISE * rng.normal(size=read.shape)
        motion = Motion("servo", "identification", Table(times, q, wrench=read))
        return Experiment(arm, case.robot, (motion,), Sensor()), links
    q, v, a = case.trajectory(FASTER * (times + rng.uniform(0.0, 1.0 / RATE)))
    q, a = case.centre + (q - case.centre) / FASTER, FASTER * a
    count = std * 12**0.5
    if kind == "counts":
        q = q + count * rng.uniform(-0.5, 0.5, case.robot.n)  # the same motion would be rounded in the same way every time
    constant = OFFSET * rng.uniform(-1.0, 1.0, 6)
    moving, still = (wrench(arm, links, q, k * v, k * a) + constant + NOISE * rng.normal(size=(len(q), 6)) for k in (1, 0))
    if kind == "white":
        bare = Experiment(arm, case.robot, (), Sensor(), position_std=std or None)
        q = q + std * rng.normal(size=q.shape)
    else:
        bare = Experiment(arm, case.robot, (), Sensor(), position_resolution=count)
        q = count * np.round(q / count)
    static = Table(times, q, wrench=still) if case.arm.static else None
    motion = Motion("fourier", "identification", Table(times, q, wrench=moving), static=static)
    return replace(bare, motions=(motion,)), links


def one(name: str, seed: int, k: int) -> tuple[np.ndarray, np.ndarray]:
    """Errors and standard deviations (fits, r) of recording k."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(list(CASES).index(name), k)))
    errors, stds = [], []
    with threadpool_limits(1, user_api="blas"), warnings.catch_warnings():
        warnings.simplefilter("ignore", BayesidWarning)  # counts of slow joints are not white, as tls says
        recorded, links = record(name, rng)
        problem = prepare(recorded, FitOptions())
        base = problem.row_model.base
        truth = base.matrix @ links
        for method in METHODS:
            estimate = estimators.fit(problem.regression, method)
            errors.append(estimate.values - truth)
            stds.append(estimate.std)
        model = PosteriorModel.of(problem.regression, None)
        engine = choose_engine(model, "hmc")
        draws = engine.advance(engine.start(rng), DRAWS, 2)[DRAWS // 5 :, 0]
        values = draws[:, : base.rank]
        errors.append(values.mean(axis=0) - truth)
        stds.append(values.std(axis=0, ddof=1))
    return np.array(errors), np.array(stds)


def summarise(errors: np.ndarray, stds: np.ndarray) -> dict[str, Any]:
    """Coverage and size of the errors of every fit; errors in units of those of `wls`, parameter by parameter."""
    count, _, parameters = errors.shape
    rms = np.sqrt(np.mean(errors**2, axis=0))
    stated = np.isfinite(stds).all(axis=2)
    held = np.abs(errors) <= norm.ppf(0.5 + LEVEL / 2) * stds
    fits = {}
    for k, fit in enumerate((*METHODS, POSTERIOR)):
        own = stated[:, k]
        inside, z = held[own, k].mean(axis=0), errors[own, k] / stds[own, k]
        fits[fit] = {
            "mean": float(inside.mean()), "lowest": float(inside.min()), "highest": float(inside.max()),
            "stated": float(own.mean()), "rms_z": float(np.sqrt(np.mean(z**2))),
            "error": float(np.median(rms[k] / rms[METHODS.index("wls")])),
        }  # fmt: skip
    return {"recordings": count, "parameters": parameters, "band": band(count, parameters), "fits": fits}


PAGE = """\
# Coverage with encoder noise

95 % intervals on recordings with encoder errors of known size, white or as counts (their root mean square is the count over
the root of 12), made by Pinocchio's recursive Newton-Euler algorithm, which is not the estimator's model. Robots and sensor noise
are those of [coverage](../coverage/README.md), motions {{ faster }} times faster. Everything at its defaults.
`python -m tests.studies.encoder_coverage` made this page and [results.json](results.json) from seed {{ seed }}.

In each cell: *coverage* in per cent of all parameters, in brackets that of the worst one, and the root mean square error in units
of the standard deviation that was stated, which should be 1; after a slash the share of recordings with an interval, where not
all have one. *Error* is the root mean square error in units of that of `wls`,
median of all parameters, least and most of these kinds. Every recording is of another robot, whose links are those of the URDF
stretched and sheared by a tenth, and displaced by about 0.1 m, which is a wrist's length. `sdp` knows the URDF alone.

*servo* is another kind of recording: a controller of {{ control }} Hz moves joints with {{ coulomb }} N m of friction along
another motion each time, so that accelerations jump a little wherever a joint reverses, faster than encoders show; readings are
means over a sample's time, there is no static run, and no error is stated. *MuJoCo* is the same, with the arm, its friction and
the sensor simulated by MuJoCo.
{% for arm, table in tables.items() %}

## {{ arm }}

{{ table.recordings }} recordings of each kind, {{ table.parameters }} base parameters. If every interval were exact, all
coverages of one kind would lie within {{ pct(table.band[0]) }} to {{ pct(table.band[1]) }} % with probability 99 %; *below* marks
a worst parameter that does not.

| {{ table.head | join(" | ") }} |
|{{ "---|" * (table.head | length) }}
{% for row in table.rows %}
| {{ row | join(" | ") }} |
{% endfor %}
{% endfor %}
"""


def tables(cases: dict[str, Any]) -> dict[str, Any]:
    """The page's tables, one for each robot: a row a fit, a column a kind of error."""
    out = {}
    for arm in ARMS:
        own = {name: case for name, case in cases.items() if CASES[name][0] == arm}
        one = next(iter(own.values()))
        kinds = [f"{CASES[n][2]}, {CASES[n][1]:g} rad" if CASES[n][1] else "none" for n in own]
        rows = []
        for fit in one["fits"]:
            each = [case["fits"][fit] for case in own.values()]
            below = ["**below** " if f["lowest"] < one["band"][0] else "" for f in each]
            cells = [
                f"{100 * f['mean']:.1f} ({b}{100 * f['lowest']:.0f}), {f['rms_z']:.2f}" + _share(f["stated"])
                for b, f in zip(below, each, strict=True)
            ]
            errors = [f["error"] for f in each]
            rows.append([f"`{fit}`" if fit in METHODS else fit, *cells, f"{min(errors):.2f} to {max(errors):.2f}"])
        same = {k: one[k] for k in ("recordings", "parameters", "band")}
        out[NAMES[arm]] = {**same, "head": ["fit", *kinds, "error"], "rows": rows}
    return out


def _share(stated: float) -> str:
    return "" if stated == 1.0 else f" / {100 * stated:.0f}"


def title(name: str) -> str:
    """What a case is called on the page."""
    arm, std, kind = CASES[name]
    return f"{NAMES[arm]}, " + (f"{kind}, {std:g} rad" if std else "no encoder noise")


def main(arguments: list[str]) -> None:
    """Run from the command line."""
    given = parsed(arguments, __doc__, docs="encoder-coverage", count=COUNT, of="case", seed=SEED)
    given.docs.mkdir(parents=True, exist_ok=True)
    # Cases that are done, of this seed and size: a run that was stopped goes on where it was.
    state = given.docs / f"encoder-coverage-{given.seed}-{given.count}.part"
    results = json.loads(state.read_text(encoding="utf-8")) if state.exists() else {}
    with cluster(given.processes):
        for name in (n for n in CASES if n not in results):
            count = round(SHARE[CASES[name][0]] * given.count)
            found = list(map_tasks(partial(one, name, given.seed), range(count)))
            results[name] = summarise(*(np.array(column) for column in zip(*found, strict=True)))
            print(title(name), {fit: round(f["mean"], 3) for fit, f in results[name]["fits"].items()}, flush=True)
            state.write_text(json.dumps(results), encoding="utf-8")
    results = {name: results[name] for name in CASES}
    rounded = write_numbers({"seed": given.seed, "cases": results}, given.docs / "results.json", digits=4)
    page = given.docs / "README.md"
    values = {"seed": given.seed, "faster": f"{FASTER:g}", "control": f"{CONTROL:g}", "coulomb": f"{COULOMB:g}"}
    write_page(PAGE, page, tables=tables(rounded["cases"]), **values)
    state.unlink()


if __name__ == "__main__":
    main(sys.argv[1:])
