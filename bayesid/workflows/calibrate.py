"""The verb ``calibrate``: what a force/torque sensor in place has."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from bayesid.arguments import argument
from bayesid.design.payload.body import BodyKnowledge, Quantity
from bayesid.design.payload.knowledge import from_sensor, weighed_alone
from bayesid.diagnosis.settings import Settings
from bayesid.errors import InputError
from bayesid.recordings.experiment import Experiment, as_experiment
from bayesid.regression.options import FitOptions, some_options
from bayesid.results.controllers import Load
from bayesid.results.identification import Identification
from bayesid.results.payload import KINDS, Calibration, HiddenEffect
from bayesid.rounding import HALF, number, percent
from bayesid.workflows.explained import Explained, explain, joined, offset_of
from bayesid.workflows.progress import SHOWN, Clock, Progress, shows_progress
from bayesid.workflows.warnings import contradictions, impossible_signs, of_recordings

#: A mass that people have, and would hang on [kg].
_USUAL = 1.0
#: Gains are a few per cent; by a factor like this numbers are off that are of another unit.
_ANOTHER_UNIT = 2.0


@shows_progress
def calibrate(
    experiment: Experiment | str | Path,
    *,
    reference: Experiment | str | Path | None = None,
    mass: float | None = None,
    mass_std: float = 0.0,
    options: FitOptions | None = None,
    motions: str | Sequence[str] | None = None,
    effects: str | Sequence[str] | None = None,
    seed: int = 0,
    settings: Settings | None = None,
    progress: Progress | None = SHOWN,
) -> Calibration:
    """Offset, drift, gain, cross-talk, orientation, origin and delay of a force/torque sensor in place, and the tilt of its base.

    Only as many of them are named as the recordings show, each with its interval; of the others how large they may be without
    standing out. A gain that all axes share looks like a heavier load: a known mass tells it.

    Parameters
    ----------
    experiment
        Poses or motions with the sensor's readings; loaded, or its folder.
    reference
        The same sensor without the known mass, which was hung on for ``experiment``.
    mass, mass_std
        The known mass and its standard deviation [kg]: of all that the sensor carries, or with ``reference`` of what was hung on.
    options
        ``motions`` and ``effects`` at once; those that are given beside it stand in its place.
    motions
        Names of those to fit; default those with role ``identification``.
    effects
        Replaces ``[model] effects``.
    seed
        Of everything random in the diagnosis.
    settings
        Thresholds of the diagnosis other than the usual ones.
    progress
        Called with the name of every stage; default: shown where it takes over two seconds; None: never.

    Returns
    -------
    calibration
        With `Calibration.compensate`, which takes weight and offset out of readings.

    Raises
    ------
    InputError
        There is no sensor, a mass that cannot be used, or a reference that carries more.
    """
    chosen = some_options("calibrate", options, motions=motions, effects=effects)
    clock = Clock(progress)
    clock("reading")
    experiment = as_experiment(experiment)
    sensor = experiment.sensor
    if sensor is None:
        raise InputError(f"experiment {experiment.name}: has no force/torque sensor; add [sensor] to experiment.toml")
    if mass is not None and not (np.isfinite(mass) and mass > 0.0):
        raise InputError(f"{argument('mass', mass)}: give the known mass in kilograms, above 0")
    if not (np.isfinite(mass_std) and mass_std >= 0.0):
        raise InputError(f"{argument('mass_std', mass_std)}: give a standard deviation in kilograms, 0 or more")
    if mass is None and mass_std:
        raise InputError(f"{argument('mass_std', mass_std)}: is of a known mass; give that with {argument('mass')}")
    if reference is not None and mass is None:
        raise InputError(f"{argument('reference')}: says how much was hung on only with that mass; add {argument('mass', 1.0)}")
    asked = FitOptions(channel="wrench", motions=chosen.motions)
    body = weighed_alone(experiment, "wrench")
    if body is None and mass is not None:
        raise InputError(f"{argument('mass', mass)}: is of use where the sensor carries one body; this one carries the arm")

    def look(recorded: Experiment) -> Explained:
        free = recorded if body is None else replace(recorded, inertia_rel_std=None)
        if chosen.effects is not None:
            free = replace(free, effects=tuple(chosen.effects))
        return explain(free, asked, lambda _: False, lambda _: False, True, seed, settings, clock)

    found = look(experiment)
    best, known, others = found.best, None, []
    if body is not None:
        known, *others = (from_sensor(fit.problem, fit.estimate, body) for fit in (best, *found.rivals))
    gain, weighings = None, [known] if known is not None and mass is not None and known.mass.shown else []
    if weighings and reference is not None:
        clock("reference")
        other = look(as_experiment(reference)).best
        weighings.append(from_sensor(other.problem, other.estimate, body or 0))
    if mass is not None and weighings and all(w.shown[0] for w in weighings):
        weighed = weighings[0].mean[0] - sum(w.mean[0] for w in weighings[1:])
        variance = sum(w.covariance[0, 0] for w in weighings)
        if weighed + HALF * np.sqrt(variance) < 0.0:
            raise InputError(
                f"{argument('reference')}: the sensor carries {number(-weighed, 3)} kg more there than in {experiment.name}; "
                "name the recording with the known mass first, and the one without it as reference"
            )
        std = float(np.sqrt(variance + (weighed / mass * mass_std) ** 2)) / mass
        gain = Quantity.of("gain", "1", weighed / mass - 1.0, std)
    clock("result")
    return Calibration(
        fit=best, sensor=sensor.joint or "base", found=_quantities(best),
        ambiguous={e.spec: e.ambiguous_with for e in found.effects if e.in_model and e.ambiguous_with},
        hidden=() if found.diagnosis is None else _hidden(found, body is not None),
        mass=None if known is None else known.mass.joined(tuple(k.mass for k in others)),
        centre=() if known is None else joined(known.centre, [k.centre for k in others]), common_gain=gain,
        load=_load(best, experiment, known),
        verdict=found.verdict, sentences=tuple(_sentences(known, gain, mass, reference is not None)),
        warnings=of_recordings(
            experiment,
            [*impossible_signs(best.estimate, best.problem), *found.warnings, *contradictions(found.first.agreements)],
            [e.name for e in found.effects],
        ),
        seconds=clock.stop(),
    )  # fmt: skip


def _quantities(fit: Identification) -> dict[str, tuple[Quantity, ...]]:
    """Every effect of the model on the wrench with its parameters, and the offset."""
    out = {}
    for effect in fit.effects():
        spec = f"{effect['name']}@{effect['where']}"
        out[spec] = tuple(
            Quantity(name, p["unit"], p["value"], p["std"], p["low"], p["high"], True)
            if p["std"] is not None and p["low"] is not None else Quantity.unknown(name, p["unit"])
            for name, p in effect["parameters"].items()
        )  # fmt: skip
    if offset := offset_of(fit):
        out["sensor_offset@sensor"] = offset
    return out


def _hidden(explained: Explained, alone: bool) -> tuple[HiddenEffect, ...]:
    """Kinds that neither the model has nor another name for what it has, each parameter where it would stand out least."""
    found = explained.diagnosis
    assert found is not None
    rivals = [spec for effect in explained.effects if effect.in_model for spec in effect.ambiguous_with]
    there = {name.partition("@")[0] for name in (*_quantities(explained.best), *rivals)}
    out: dict[tuple[str, str, str], HiddenEffect] = {}
    for p in found.search.proposals:
        effect, sizes = p.term.effect, found.least_visible(p)
        if effect.name not in KINDS or effect.name in there or not sizes:
            continue
        if alone and effect.name == "sensor_translation":  # it is another centre of mass
            continue
        for name, unit, least, most in zip(effect.parameters, effect.units, effect.lower, effect.upper, strict=True):
            size = sizes.get(name, np.inf)
            size = size if size <= max(-least, most) else np.inf  # no plausible size is seen
            key = effect.name, name, unit  # cross-talk from forces to moments is a length
            if key not in out or size > out[key].size:
                out[key] = HiddenEffect(effect.name, effect.spec, name, size, unit)
    return tuple(h for kind in KINDS for h in out.values() if h.kind == kind)


def _load(fit: Identification, experiment: Experiment, known: BodyKnowledge | None) -> Load | None:
    """What controllers need to know of what the sensor carries."""
    if known is None or fit.offset is None or experiment.sensor is None or not all(q.shown for q in (known.mass, *known.centre)):
        return None
    sensor, urdf = experiment.sensor, experiment.robot.description
    centre = np.array([q.value for q in known.centre])
    frame = urdf.joints[str(sensor.joint)].child
    return Load(
        known.mass.value, centre, None, frame, urdf.root_link, experiment.robot.gravity, frame,
        sensor.rotation.T @ (centre - sensor.translation), np.asarray(fit.offset[0]), sensor.mounted,
    )  # fmt: skip


def _sentences(known: BodyKnowledge | None, gain: Quantity | None, mass: float | None, hung_on: bool) -> list[str]:
    if known is None:
        return ["The sensor carries the whole arm: a gain that all its axes share cannot be told from heavier links."]
    if gain is not None:
        what = "what was hung on" if hung_on else "all that it carries"
        verdict = "differs from none" if gain.low * gain.high > 0.0 else "may be none"
        if not 1.0 / _ANOTHER_UNIT < 1.0 + gain.value < _ANOTHER_UNIT:
            verdict += f". No sensor has such a gain: {argument('mass')} is in kilograms, forces are in newtons"
        return [
            f"Against {number(mass)} kg of {what} the forces read {percent(gain.value, 2)} too much (± "
            f"{percent(gain.high - gain.value, 2)}): the common gain {verdict}."
        ]
    if not known.mass.shown or mass is not None:  # nor does a reference that leaves its own open
        return ["These recordings do not show the mass that the sensor carries: turn it through more attitudes."]
    # Two weighings, each as sure as this one.
    share = np.sqrt(2.0) * HALF * known.mass.std / _USUAL
    return [
        "A gain that all force axes share cannot be told from another mass: state the mass that it carries "
        f"({argument('mass')}), or hang a known one on and name this recording as {argument('reference')}. "
        f"{number(_USUAL, 1)} kg would tell it to ± {percent(share, 2)}.",
        "A gain that all moment axes share, and another origin of the sensor, cannot be told from another centre of mass.",
    ]
