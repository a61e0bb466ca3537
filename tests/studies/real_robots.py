"""What bayesid says of real recordings at its defaults, beside thirty lines of Pinocchio least squares.

Run from the root of the repository, with the recordings where ``BAYESID_DATA`` says (default ``../shared``)::

    python -m tests.studies.real_robots [--only NAME] [--methods wls,gls,...] [--no-sampling] [--out FILE] [--write | --from-json]

For every recording, with the effects that its ``experiment.toml`` states and, for joint torques without any, with friction, too:
bandwidth, error on a motion that was not fitted (below 10 Hz, error norm over signal norm of all channels), the same of least
squares in thirty lines, total mass, and how far estimates of the two halves of the motion, and of two motions of the same
robot, lie apart in their own standard deviations (root mean square over all parameters; 1 is right). ``--write`` makes
docs/studies/real-robots.
"""

from __future__ import annotations

import argparse
import json
import os
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from scipy.signal import butter, sosfiltfilt
from scipy.stats import chi2

import bayesid
from bayesid import estimators
from bayesid.estimators import Estimate
from bayesid.recordings.experiment import Experiment, Motion
from bayesid.recordings.table import Table
from bayesid.regression.options import FitOptions
from bayesid.regression.problem import prepare
from bayesid.validation.prediction import BAND, Prediction
from bayesid.workflows.sample import as_estimate
from tests.studies.page import STUDIES, plain, write_page

DATA = Path(os.environ.get("BAYESID_DATA", "../shared")) / "data"
METHODS = ("ols", "wls", "gls", "huber", "student", "tls", "iv", "sdp")
FRICTION = ("coulomb_friction", "viscous_friction", "torque_offset")
#: Recordings of one robot and load in folders of their own: each is judged on the next.
SERIES = (("ur10e/before", "ur10e/feb05-20s-12h", "ur10e/feb05-20s-8h", "ur10e/feb06-20s-10h", "ur10e/feb06-20s-5h"),)
#: Effects whose size is known, for a case of their own beside that without them.
KNOWN = {"tx40": ("with the wrist's coupling", {"coupled_transmission@joint5->joint6": {"coupling": 1.0, "fixed": True}})}
_WRIST = ("rotor_inertia@joint6.inertia", "viscous_friction@joint6.coefficient", "coulomb_friction@joint6.level")
#: What is published of a recording, or was found by others, and parameters of `wls` to stand beside it.
PUBLISHED: dict[str, tuple[str, tuple[str, ...]]] = {
    "kuka-lwr4, with friction": (
        "least squares with 43 base and 21 friction parameters predicts the unseen motion with 12.5 to 14 % error, no better "
        "than the CAD model (10 to 12 %) [Bethge2017]", (),
    ),
    "kuka-med-wrist": (
        "mass 0.932 kg; static poses alone give 0.9323 kg and a first moment of 0.04093 kg m along the axis", ("m3", "m3 r3z"),
    ),
    "tx40": (
        "joint 6 of the tables is the sum of joints 5 and 6: rotor inertia 0.00964 kg m^2, viscous friction 0.616 N m s/rad, "
        "Coulomb friction 1.95 N m; error of joints 5 and 6 on unseen parts 26 and 31 %",
        _WRIST,
    ),
    "tx40, with the wrist's coupling": (
        "error of joints 5 and 6 on unseen parts 135 and 67 % where the coupling was left out, 26 and 31 % with it", _WRIST,
    ),
    "ur10, with friction": ("least squares with friction (rank 58) predicts the last 40 % with 9.1 % error [Petrone2025]", ()),
    **{
        f"ur10e/{name}": ("least squares with friction predicts another unloaded motion with about 6 % error", ())
        for name in ("before", "feb05-20s-12h", "feb05-20s-8h", "feb06-20s-10h", "feb06-20s-5h")
    },
}  # fmt: skip
#: Torques inside joints that thirty lines know, per unit of their coefficient.
SIMPLE: dict[str, Callable[[np.ndarray, np.ndarray], np.ndarray]] = {
    "coulomb_friction": lambda v, a: np.sign(v), "viscous_friction": lambda v, a: v,
    "torque_offset": lambda v, a: np.ones_like(v), "rotor_inertia": lambda v, a: a,
}  # fmt: skip
#: Seconds at both ends of a motion that thirty lines leave out.
_ENDS = 0.5


@dataclass(frozen=True)
class Case:
    """A recording with the effects that its model has."""

    name: str
    experiment: Experiment
    effects: tuple[str, ...]

    @property
    def fitted(self) -> Motion:
        """The motion that is fitted."""
        return next(m for m in self.experiment.motions if m.role == "identification")

    @property
    def unseen(self) -> Motion | None:
        """The motion that judges."""
        return next((m for m in self.experiment.motions if m.role == "validation"), None)


def cases(only: str) -> Iterator[Case]:
    """Every recording, with what was not fitted beside it."""
    following = {name: series[(k + 1) % len(series)] for series in SERIES for k, name in enumerate(series)}
    for path in sorted(DATA.rglob("experiment.toml")):
        name = "/".join(path.parent.relative_to(DATA).parts)
        if only not in name:
            continue
        experiment = bayesid.load_experiment(path.parent)
        if name in following:
            other = bayesid.load_experiment(DATA / following[name]).identification[0]
            unseen = replace(other, name=f"of {following[name]}", role="validation")
            experiment = replace(experiment, motions=(*experiment.motions, unseen))
        stated = tuple(experiment.effects)
        yield Case(name, experiment, stated)
        if name in KNOWN:
            words, values = KNOWN[name]
            yield Case(f"{name}, {words}", replace(experiment, effect_values=values), (*stated, *values))
        if experiment.sensor is None and not stated:
            yield Case(f"{name}, with friction", experiment, FRICTION)


def thirty_lines(case: Case) -> float:
    """Error on the unseen motion of least squares as one would write it in a notebook: filter, difference, regress, predict."""
    robot = case.experiment.robot
    model = pin.buildModelFromUrdf(str(robot.urdf))
    model.gravity.linear = robot.gravity
    moving = [model.joints[model.getJointId(name)] for name in robot.joint_names]
    columns = [10 * (joint.id - 1) + k for joint in moving for k in range(10)]
    order = [joint.idx_v for joint in moving]

    def rows(motion: Motion) -> tuple[np.ndarray, np.ndarray]:
        table = motion.table
        step = float(np.median(np.diff(table.times)))
        low_pass = butter(4, BAND, fs=1.0 / step, output="sos")
        q = sosfiltfilt(low_pass, table.positions, axis=0)
        v = np.gradient(q, step, axis=0)
        a = np.gradient(v, step, axis=0)
        data, out = model.createData(), []
        for k in range(len(q)):
            full = np.zeros((3, model.nv))
            full[:, order] = q[k], v[k], a[k]
            rigid = pin.computeJointTorqueRegressor(model, data, *full)[np.ix_(order, columns)]
            out.append(np.hstack([rigid, *(np.diag(SIMPLE[name](v[k], a[k])) for name in case.effects)]))
        x = sosfiltfilt(low_pass, np.array(out), axis=0)
        assert table.torques is not None
        inside = slice(round(_ENDS / step), -round(_ENDS / step))
        return x[inside], sosfiltfilt(low_pass, table.torques, axis=0)[inside]

    assert case.unseen is not None
    (x, y), (x_unseen, y_unseen) = rows(case.fitted), rows(case.unseen)
    weight = np.ones(robot.n)
    for _ in range(2):
        found = np.linalg.lstsq((x * weight[:, None]).reshape(-1, x.shape[2]), (y * weight).ravel(), rcond=1e-8)[0]
        weight = 1.0 / np.std(y - x @ found, axis=0)
    return float(np.linalg.norm(y_unseen - x_unseen @ found) / np.linalg.norm(y_unseen))


def halves(motion: Motion) -> tuple[Motion, Motion]:
    """The first and the second half of a motion."""
    middle = len(motion.table) // 2

    def part(which: slice) -> Motion:
        t = motion.table
        arrays = {k: getattr(t, k) for k in ("times", "positions", "velocities", "commanded", "torques", "wrench")}
        return replace(motion, static=None, table=Table(**{k: None if a is None else a[which] for k, a in arrays.items()}))

    return part(slice(0, middle)), part(slice(middle, None))


def estimate(case: Case, motion: Motion, method: str, bandwidth: float) -> Estimate:
    """The estimate of one motion alone; ``sample`` gives the posterior of the default prior."""
    experiment = replace(case.experiment, motions=(replace(motion, role="identification"),))
    if method == "sample":
        posterior = bayesid.sample(
            experiment,
            draws=1000,
            prior="flat",
            effects=case.effects,
            bandwidth=bandwidth,
            keep_going=True,
            sampler=bayesid.Sampler(longest=8),
        )
        return as_estimate(posterior)
    return estimators.fit(prepare(experiment, FitOptions(effects=case.effects, bandwidth=bandwidth)).regression, method)


def apart(one: Estimate, other: Estimate) -> tuple[float, float, float] | None:
    """Difference of two estimates, parameter by parameter, in their own standard deviations.

    Returns
    -------
    rms, largest, usual
        Root mean square, largest, and what the former stays below in 19 of 20 if covariances are right (chi-square with the
        mean and variance of the sum of correlated squares [Satterthwaite1946]_); None without covariances.
    """
    if one.full_covariance is None or other.full_covariance is None or one.solution.shape != other.solution.shape:
        return None
    covariance, std = one.full_covariance + other.full_covariance, np.hypot(one.full_std, other.full_std)
    z = (one.solution - other.solution) / std
    known = np.isfinite(z)
    if not known.any():
        return None
    z, correlation = z[known], (covariance / np.outer(std, std))[np.ix_(known, known)]
    degrees = len(z) ** 2 / np.sum(correlation**2)
    return float(np.sqrt(np.mean(z**2))), float(np.max(np.abs(z))), float(np.sqrt(chi2.ppf(0.95, degrees) / degrees))


def judged(case: Case, methods: tuple[str, ...]) -> dict[str, Any]:
    """Figures of one case."""
    problem = prepare(case.experiment, FitOptions(effects=case.effects))
    bandwidth = problem.smoother.bandwidth
    out: dict[str, Any] = {
        "channel": problem.channel, "bandwidth": bandwidth, "chosen": problem.smoother.reason,
        "rank": problem.row_model.base.rank, "methods": {},
    }  # fmt: skip
    if case.unseen is not None and problem.channel == "torque" and SIMPLE.keys() >= set(case.effects):
        out["thirty_lines"] = thirty_lines(case)
    for method in methods:
        found: dict[str, Any] = {}
        out["methods"][method] = found
        try:
            if method != "sample":
                result = bayesid.identify(case.experiment, method=method, effects=case.effects)
                found |= told(result)
                if method == "wls" and case.name in PUBLISHED:
                    out |= beside(result, PUBLISHED[case.name][1])
            motions = [m for m in case.experiment.motions if m.kind != "poses" and m.name in problem.segments]
            if case.fitted in motions:
                first, second = (estimate(case, half, method, bandwidth) for half in halves(case.fitted))
                found["halves"] = apart(first, second)
                if len(motions) > 1:
                    found["motions"] = apart(*(estimate(case, m, method, bandwidth) for m in motions[:2]))
        except bayesid.BayesidError as error:
            found["error"] = str(error)
    return out


def told(result: bayesid.Identification) -> dict[str, Any]:
    """Errors on unseen motions, mass and warnings of an estimate."""
    unseen: tuple[Prediction, ...] = result.validation
    out: dict[str, Any] = {
        "mass": float(np.sum(result.link_parameters[::10])),
        "physical": bool(result.to_dict()["physically_consistent"]),
        "dispersion": result.estimate.details.dispersion,
        "model_complete": result.estimate.details.model_complete,
        "warnings": len(result.warnings),
    }
    if unseen:
        out |= {"unseen": unseen[0].relative_error, "over_noise": unseen[0].whitened_rms}
        if unseen[0].flexible is not None:
            out |= {"predictable": [unseen[0].flexible.removed, unseen[0].flexible.std]}
    return out


def beside(result: bayesid.Identification, names: tuple[str, ...]) -> dict[str, Any]:
    """Some parameters with standard deviations, and the error of each channel on the unseen motion."""
    estimate = result.estimate
    at = {name: k for k, name in enumerate((*estimate.base.labels, *estimate.effect_names))}
    units = (*estimate.base.units, *estimate.effect_units)
    found = [(n, float(estimate.solution[at[n]]), float(estimate.full_std[at[n]]), units[at[n]]) for n in names]
    return {"parameters": found, "channels": list(result.validation[0].nrmse) if result.validation else []}


def published(name: str, found: dict[str, Any]) -> str:
    """What is published of a recording, and what `wls` says."""
    if name not in PUBLISHED or "parameters" not in found:  # another estimator was asked for
        return ""
    here = [f"{n} = {value:.4g} ± {std:.2g} {unit}" for n, value, std, unit in found["parameters"]]
    unseen = f"{100 * found['methods']['wls']['unseen']:.3g} % error on the unseen motion"
    if here and found["channel"] == "torque":
        unseen += f", {', '.join(f'{100 * e:.3g}' for e in found['channels'])} % joint by joint"
    return f"Published: {PUBLISHED[name][0]}. Here, by `wls`: {'; '.join([*here, unseen])}."


def lines(name: str, found: dict[str, Any]) -> list[str]:
    """Rows of the table printed on a terminal."""
    out = [f"{name}: {found['channel']}, rank {found['rank']}, bandwidth {found['bandwidth']:.3g} Hz ({found['chosen']})"]
    reference = found.get("thirty_lines")
    if reference is not None:
        out.append(f"  {'thirty lines':<13} unseen {100 * reference:6.2f} %")
    for method, f in found["methods"].items():
        if "error" in f:
            out.append(f"  {method:<13} {f['error'][:110]}")
            continue
        unseen = f" unseen {100 * f['unseen']:6.2f} %, {f['over_noise']:6.3g} x noise" if "unseen" in f else " " * 34
        mass = f" {f['mass']:8.3g} kg {'possible  ' if f['physical'] else 'impossible'}" if "mass" in f else " " * 22
        both = [f"{k} {f[k][0]:5.2f} (of {f[k][2]:.2f}, max {f[k][1]:4.1f})" for k in ("halves", "motions") if f.get(k)]
        more = f" predictable {100 * f['predictable'][0]:5.1f} +- {100 * f['predictable'][1]:.1f} %" if "predictable" in f else ""
        wider = more + (f" dispersion {f['dispersion']:.2f}" if f.get("dispersion") else "")
        out.append(f"  {method:<13}{unseen}{mass} {'  '.join(both)}{wider}")
    return out


PAGE = """\
# Real robots

What bayesid says of real recordings at its defaults, beside least squares in thirty lines of Pinocchio (positions
low-passed at 10 Hz, differences, regressor, channel weights). *Unseen* is the error norm over the signal norm of all channels
below 10 Hz on a motion that was not fitted; *predictable* the share of it that a flexible model of position, speed and
acceleration would still remove, with its standard error. *Halves* and *motions* say how far estimates of the two halves of the
fitted motion, and of two motions, lie apart in their own standard deviations (root mean square over all parameters); 1 is right,
more means that intervals are too short for what a real robot does beyond any model. In brackets: what 19 of 20 stay below where
intervals are exact. Made by `python -m tests.studies.real_robots --write`.
{% for name, found in cases.items() %}

## {{ name }}

{{ found.channel }}, rank {{ found.rank }}, bandwidth {{ "%.3g" | format(found.bandwidth) }} Hz: {{ found.chosen }}.
{%- if 'thirty_lines' in found %} Thirty lines: {{ "%.2f" | format(100 * found.thirty_lines) }} %.{% endif %}

{% if published(name, found) %}

{{ published(name, found) }}
{% endif %}

| method | unseen | predictable | times the noise | mass | links possible | halves | motions | dispersion |
| --- | ---: | ---: | ---: | ---: | --- | ---: | ---: | ---: |
{% for method, f in found.methods.items() %}
{% if 'error' in f %}
| {{ method }} | {{ f.error }} | | | | | | | |
{% else %}
| {{ method }} | {{ cell(f, "unseen", "%.2f %%", 100) }} | {{ gap(f) }} | {{ cell(f, "over_noise", "%.3g") }} |
{{- " " + cell(f, "mass", "%.3g kg") }} |
{{- " " + possible(f) }} | {{ distance(f, "halves") }} | {{ distance(f, "motions") }} |
{{- " " + cell(f, "dispersion", "%.2f") }} |
{% endif %}
{% endfor %}
{% endfor %}
"""


def cell(figures: dict[str, Any], name: str, shape: str, times: float = 1.0) -> str:
    """A figure, or nothing where there is none."""
    value = figures.get(name)
    first = value[0] if isinstance(value, list) else value
    return "" if not isinstance(first, float) else shape % (times * first)


def distance(figures: dict[str, Any], name: str) -> str:
    """How far two estimates lie apart, and what exact ones mostly stay below."""
    found = figures.get(name)
    return f"{found[0]:.2f} ({found[2]:.2f})" if found else ""


def gap(figures: dict[str, Any]) -> str:
    """What a flexible model would still remove, with its standard error."""
    share, std = figures.get("predictable", (None, None))
    return "" if share is None or std is None else f"{100 * share:.1f} ± {100 * std:.1f} %"


def page(cases: dict[str, Any]) -> None:
    """Write docs/studies/real-robots."""
    words = {True: "yes", False: "no"}
    possible = {"possible": lambda f: words.get(f.get("physical"), "")}
    write_page(
        PAGE,
        STUDIES / "real-robots" / "README.md",
        cases=cases,
        cell=cell,
        gap=gap,
        distance=distance,
        published=published,
        **possible,
    )


def main() -> None:
    """Judge every case, print, and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="")
    parser.add_argument("--methods", default=",".join(METHODS))
    parser.add_argument("--no-sampling", action="store_true")
    parser.add_argument("--out", type=Path)
    parser.add_argument("--write", action="store_true")
    parser.add_argument("--from-json", action="store_true", help="write the page again from its numbers")
    options = parser.parse_args()
    if options.from_json:
        page(json.loads((STUDIES / "real-robots" / "results.json").read_text(encoding="utf-8")))
        return
    methods = (*options.methods.split(","), *(() if options.no_sampling else ("sample",)))
    out = {}
    warnings.simplefilter("ignore")
    for case in cases(options.only):
        out[case.name] = plain(judged(case, methods), 5)
        print("\n".join(lines(case.name, out[case.name])), flush=True)
    if options.out:
        options.out.write_text(json.dumps(out, indent=1) + "\n", encoding="utf-8")
    if options.write:
        (STUDIES / "real-robots" / "results.json").write_text(json.dumps(out, indent=1) + "\n", encoding="utf-8")
        page(out)


if __name__ == "__main__":
    main()
