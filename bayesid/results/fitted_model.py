"""The ``[model]`` of an experiment with the values that were found: what ``model.toml`` holds."""

from __future__ import annotations

from collections.abc import Iterable

from bayesid.effects import Term
from bayesid.recordings.experiment import Experiment
from bayesid.recordings.schema import EffectParameters


def fitted_model(
    experiment: Experiment, effects: Iterable[str], terms: Iterable[Term]
) -> tuple[tuple[str, ...], EffectParameters]:
    """Effects and their values, as `bayesid.recordings.schema.write_model` takes them.

    Effects that act on other channels stay as the experiment has them, values included; all others get the values of
    ``terms``, from which a fit that is given the file starts. What is fixed stays fixed.

    Parameters
    ----------
    experiment
        Whose model it is.
    effects
        ``name`` or ``name@where``, as in ``[model] effects``.
    terms
        The effects that were fitted, with their values.
    """
    values: EffectParameters = {spec: dict(given) for spec, given in experiment.effect_values.items()}
    for term in terms:
        effect = term.effect
        keys = [effect.spec, effect.name]
        if effect.joint is not None:
            keys.insert(1, f"{effect.name}@{experiment.robot.joint_names[effect.joint]}")
        stated = next((experiment.effect_values[key] for key in keys if key in experiment.effect_values), {})
        found = {key: float(value) for key, value in zip(effect.parameters, term.values, strict=True)}
        values[effect.spec] = {**found, "fixed": True} if stated.get("fixed", False) else dict(found)
    return tuple(dict.fromkeys(effects)), values
