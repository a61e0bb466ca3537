"""The verb ``export``: an identified robot for simulators, controllers and learning."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from bayesid.arguments import argument, call
from bayesid.effects.built_in import CLASSES
from bayesid.effects.families import SensorEffect
from bayesid.errors import InputError
from bayesid.posterior.result import moments
from bayesid.recordings.complaints import listed
from bayesid.results.export.identified import FoundEffect, IdentifiedRobot, draws_of, randomisation
from bayesid.results.export.inverse_dynamics import inverse_dynamics, source_code
from bayesid.results.export.simulators import HELD_BY_SDF, held_by_mujoco, joint_constants, mjcf, sdf
from bayesid.results.exported import Exported
from bayesid.results.fitted_model import robot_of
from bayesid.results.identification import Identification
from bayesid.results.loaded import Loaded, LoadedIdentification, LoadedPosterior, load
from bayesid.results.posterior import ExperimentPosterior
from bayesid.robot.robot import Robot
from bayesid.robot.urdf import JointDynamics, urdf_text
from bayesid.workflows.progress import SHOWN, Clock, Progress, shows_progress


@dataclass
class _Making:
    """Files as they are made."""

    texts: dict[str, str] = field(default_factory=dict)
    about: dict[str, str] = field(default_factory=dict)
    left_out: dict[str, dict[str, tuple[float, str]]] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)


@shows_progress
def export(
    result: Identification | ExperimentPosterior | Loaded | str | Path,
    to: str | Sequence[str] = "mjcf",
    out: str | Path | None = None,
    *,
    draws: int = 0,
    seed: int = 0,
    progress: Progress | None = SHOWN,
) -> Exported:
    """Hand an identified robot on.

    Parameters
    ----------
    result
        Of `bayesid.identify` or `bayesid.sample`, or the folder or file that it was written to.
    to
        ``mjcf``, ``urdf``, ``sdf``, ``cpp``, ``numpy``, ``ranges``, one or several, or several in one text, separated by commas.
    out
        Folder to write the files to; default: `Exported.write` does.
    draws
        How many draws of a posterior are written, each as a robot of its own in the forms ``mjcf`` and ``urdf``.
    seed
        Of which draws.
    progress
        Called with the name of every stage; default: shown where it takes over two seconds; None: never.

    Returns
    -------
    exported
        Texts of the files by name, and what they cannot hold.

    Raises
    ------
    InputError
        Bad input; the message says what to do. MuJoCo is missing, refuses the robot, or does not agree with Pinocchio.
    """
    forms = [part.strip() for part in to.split(",") if part.strip()] if isinstance(to, str) else list(to)
    unknown = [form for form in forms if form not in FORMS]
    if unknown or not forms:
        raise InputError(f"{argument('to', ', '.join(unknown))}: choose from {', '.join(FORMS)}")
    if draws < 0:
        raise InputError(f"{argument('draws', draws)}: give a number of draws, 0 for none")
    if draws and not {"mjcf", "urdf"} & {*forms}:
        raise InputError(f"{argument('draws', draws)}: is for {argument('to', 'mjcf')} or urdf; the others hold the uncertainty")
    clock = Clock(progress)
    clock("reading")
    found, notes = _found(result)
    made = _Making(warnings=list(notes))
    for form in dict.fromkeys(forms):
        clock(form)
        FORMS[form](found, made)
    if draws:
        clock("draws")
        _draw(found, forms, draws, seed, made)
    exported = Exported(
        found.name, found.method, found.channel, tuple(dict.fromkeys(forms)), made.texts, made.about, made.left_out,
        tuple(dict.fromkeys(made.warnings)),
    )  # fmt: skip
    if out is not None:
        exported.write(out)
    return exported


# ---- what was identified ------------------------------------------------------------------------------------------


def _found(result: Any) -> tuple[IdentifiedRobot, tuple[str, ...]]:
    """What is handed on, and what was warned of that makes it worth less."""
    if isinstance(result, (str, Path)):
        result = load(result)
    if isinstance(result, (ExperimentPosterior, LoadedPosterior)):
        return _of_draws(result), ()
    if not isinstance(result, (Identification, LoadedIdentification)):
        raise InputError(
            f"{getattr(result, 'kind', type(result).__name__)}: cannot be exported; give what `{call('identify')}` or "
            f"`{call('sample')}` found"
        )
    if isinstance(result, LoadedIdentification):
        usable, dynamics = result.document["identified_urdf"]["usable"], result.dynamics
    else:
        usable, dynamics = result.urdf.usable, result.urdf.dynamics
    e = result.estimate
    text = "The links of identified.urdf are no usable result, as the warnings of identify say: do not simulate with them."
    return IdentifiedRobot(
        **_about(result), method=e.method, base=e.base, effect_names=e.effect_names, solution=e.solution,
        covariance=e.full_covariance, undetermined=e.undetermined, links=result.link_parameters, dynamics=dynamics,
    ), () if usable else (text,)  # fmt: skip


def _about(result: Identification | ExperimentPosterior | LoadedIdentification | LoadedPosterior) -> dict[str, Any]:
    """What of an identified robot is the same however it was estimated, and whether just now or read from its files."""
    if isinstance(result, Loaded):
        d = result.document
        if "effects" not in d:
            raise InputError(f"{result.path}: does not list the effects of its model, as earlier versions did not; run it again")
        robot, locked = robot_of(d, result.path)
        name, channel, readings, effects = d["experiment"], d["channel"], tuple(d["fit"][0]["rmse"]), d["effects"]
    else:
        experiment, channel, effects = result.problem.experiment, result.problem.channel, result.effects()
        readings = result.problem.row_model.channels.names
        name, robot, locked = experiment.name, experiment.robot, dict(experiment.locked)
    found = tuple(
        FoundEffect(e["name"], e["where"], {key: (float(p["value"]), str(p["unit"])) for key, p in e["parameters"].items()})
        for e in effects
    )
    return {"name": name, "channel": channel, "readings": readings, "robot": robot, "locked": locked, "effects": found}


def _of_draws(result: ExperimentPosterior | LoadedPosterior) -> IdentifiedRobot:
    about, links = _about(result), result.link_draws
    if isinstance(result, ExperimentPosterior):
        names, physical = result.model.effect_names, result.model.physical
    else:
        names, physical = tuple(p["name"] for p in result.document["effect_parameters"]), result.physical
    columns, mean, covariance = moments(np.concatenate([result.base_draws, result.own_effect_draws], axis=-1))
    links = links.reshape(-1, links.shape[-1]) if links is not None and physical else None
    return IdentifiedRobot(
        **about, method="sample", base=result.base, effect_names=names, solution=mean,
        covariance=covariance, undetermined=np.zeros(len(mean), bool),
        links=None if links is None else links.mean(axis=0), dynamics=None, link_draws=links,
        effect_draws=None if links is None else columns[:, result.base.rank :],
    )  # fmt: skip


# ---- forms --------------------------------------------------------------------------------------------------------


def _add_model(
    form: str, file: str, what: str, written: Callable[[Robot, Mapping[str, float], np.ndarray, JointDynamics], str],
    holds: Callable[[], tuple[str, ...]], found: IdentifiedRobot, made: _Making,
) -> None:  # fmt: skip
    """The file of a form, and what it has no place for: negative constants, and effects beside it."""
    if found.links is None:
        raise InputError(f"{argument('to', form)}: needs links, and a posterior with a flat prior has none; take prior nominal")
    dynamics = found.joint_dynamics()
    made.texts[file], made.about[form] = written(found.robot, found.locked, found.links, dynamics), f"{file}{what}"
    constants = joint_constants(found.robot, dynamics, holds())
    made.left_out[form] = _of_robot(constants.beside)
    if not constants.left_out:
        return
    said = f"Negative and so not in {file}: {', '.join(constants.left_out)}. Simulators take none; look for a missing effect."
    if any(name.endswith(" armature") for name in constants.left_out):
        said += (
            f" The links of {file} go with a negative rotor inertia and have too much without it: identify with "
            f"{argument('method', 'sdp')}, whose rotors and links can exist together."
        )
    made.warnings.append(said)


def _urdf(robot: Robot, _: Mapping[str, float], links: np.ndarray, dynamics: JointDynamics) -> str:
    return urdf_text(robot, links, dynamics)


def _of_robot(values: Mapping[str, tuple[float, str]]) -> dict[str, tuple[float, str]]:
    """Values without those of the force/torque sensor, which nobody would look for in a model of the robot."""
    kinds = {kind.name: kind for kind in CLASSES}
    return {
        name: value for name, value in values.items()
        if (kind := kinds.get(name.partition("@")[0])) is None or not issubclass(kind, SensorEffect)
    }  # fmt: skip


def _add_code(form: str, file: str, what: str, found: IdentifiedRobot, made: _Making) -> None:
    model = inverse_dynamics(found)
    left_out = [effect for effect in found.effects if effect.spec in model.left_out]
    values = {f"{effect.spec}.{key}": given for effect in left_out for key, given in effect.parameters.items()}
    made.texts[file], made.left_out[form] = source_code(file, found, model), _of_robot(values)
    made.about[form] = f"{file}{what}: torques and their 95 % band"
    if model.foreign:
        made.warnings.append(
            f"These readings say nothing of {model.foreign} of {len(model.bodies[0])} base parameters of the joint torques: they "
            "are those of identified.urdf, near to the nominal links, and torques that take them have no band."
        )
    if found.channel == "wrench":
        made.warnings.append(
            "The sensor does not feel what acts inside the joints: friction is not in the torques of inverse_dynamics."
        )
    elif found.unread:
        made.warnings.append(
            f"No torque was read of {listed(found.unread)}: friction and what else acts inside are not in inverse_dynamics."
        )
    if model.covariance is None:
        made.warnings.append(
            f"{found.method} has no covariance, so the torques have no band; take wls, of more readings than parameters."
        )


def _ranges(found: IdentifiedRobot, made: _Making) -> None:
    made.texts["ranges.json"] = json.dumps(randomisation(found), indent=1, allow_nan=False) + "\n"
    made.about["ranges"] = "ranges.json: mean, std, 5 and 95 % of every link's and joint's constants"


#: What a robot can be exported as, and the function that does it.
FORMS: dict[str, Callable[[IdentifiedRobot, _Making], None]] = {
    "mjcf": partial(_add_model, "mjcf", "identified.xml", ", mass matrix and bias forces as Pinocchio's", mjcf, held_by_mujoco),
    "urdf": partial(_add_model, "urdf", "identified.urdf", "", _urdf, lambda: ()),
    "sdf": partial(_add_model, "sdf", "identified.sdf", ", version 1.9, fixed to the world", sdf, lambda: HELD_BY_SDF),
    "cpp": partial(_add_code, "cpp", "inverse_dynamics.hpp", ", C++17"),
    "numpy": partial(_add_code, "numpy", "inverse_dynamics.py", ""),
    "ranges": _ranges,
}


def _draw(found: IdentifiedRobot, forms: Sequence[str], count: int, seed: int, made: _Making) -> None:
    """Draws of the posterior, each as a robot of its own."""
    links, effects = draws_of(found)
    negative = 0
    if count > len(links):
        raise InputError(f"{argument('draws', count)}: the posterior has {len(links)}; ask for fewer")
    sampled = {form: drawn for form, drawn in {"mjcf": ("xml", mjcf), "urdf": ("urdf", _urdf)}.items() if form in forms}
    for k, draw in enumerate(np.random.default_rng(seed).choice(len(links), count, replace=False).tolist(), 1):
        dynamics = found.joint_dynamics(effects[draw])
        negative += bool(joint_constants(found.robot, dynamics, ("armature",)).left_out)
        for ending, written in sampled.values():
            made.texts[f"sampled-{k:03d}.{ending}"] = written(found.robot, found.locked, links[draw], dynamics)
    if negative:
        made.warnings.append(f"In {negative} of {count} draws friction or rotor inertia of a joint is negative, and left out.")
    for form, (ending, _) in sampled.items():
        made.about[form] += f"; {count} draws of the posterior, sampled-001.{ending} ..."
