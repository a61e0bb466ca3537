"""An estimator's details as readable text."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from bayesid.results.text import DASH, chance, number, percent

#: So many entries of a list are shown.
_SHOWN = 8

_NAMES = {
    "agreement_of_gls_and_wls": "Chance of so large a gap of gls and wls",
    "certificate": "Proof of the optimum",
    "durbin_wu_hausman": "Durbin-Wu-Hausman test",
    "encoder_correlation": "Correlation of encoder noise from sample to sample, by joint",
    "encoder_std": "Encoder noise by joint [rad or m]",
    "first_stage": "First-stage statistic of the instruments",
    "largest_noise_share": "Largest share of encoder noise in a direction",
    "model_complete": "Model complete by that test",
    "nu": "Degrees of freedom of Student's t",
    "physics": "Do the data contradict physics?",
    "rejected_share": "Rows rejected as taps or contacts",
    "rejected_windows": "Rejected times",
    "shift_from_least_squares": "Largest shift from least squares, in its standard deviations",
    "trust": "Trust in the nominal model",
    "weights": "Rows weighted by",
}


def described(details: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Pairs of a term and a text; warnings are left out, as they stand on top of the report.

    Parameters
    ----------
    details
        Of an `Estimate`; entries of estimators that are not known here are written out as they are.
    """
    out = []
    for key, value in details.items():
        if key == "warnings":
            continue
        try:
            text = _WRITERS.get(key, _plain)(value)
        except (AttributeError, KeyError, TypeError, ValueError):  # another estimator's entry of the same name
            text = _plain(value)
        out.append((_NAMES.get(key, key.replace("_", " ").capitalize()), text))
    return out


def _plain(value: Any) -> str:
    if value is None:
        return DASH
    if isinstance(value, (bool, np.bool_)):
        return "yes" if value else "no"
    if isinstance(value, (float, np.floating)):
        return number(float(value), 3)
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, Mapping):
        return "; ".join(f"{str(key).replace('_', ' ')}: {_plain(inner)}" for key, inner in value.items()) or "none"
    if isinstance(value, Sequence) and not isinstance(value, str):
        return _listed([_plain(v) for v in value])
    return str(value)


def _listed(texts: Sequence[str]) -> str:
    more = f" and {len(texts) - _SHOWN} more" if len(texts) > _SHOWN else ""
    return (", ".join(texts[:_SHOWN]) + more) or "none"


def _windows(value: Mapping[str, Any]) -> str:
    """Times of rejected rows, recording by recording."""
    parts = []
    for motion, spans in value.items():
        parts.append(f"{motion}: " + _listed([f"{_time(a)} s" if a == b else f"{_time(a)} to {_time(b)} s" for a, b in spans]))
    return "; ".join(parts) or "none"


def _time(seconds: float) -> str:
    return f"{seconds:.2f}".replace("-", "−")


def _hausman(value: Mapping[str, Any]) -> str:
    return f"{value['verdict']}; statistic {number(value['statistic'], 3)} in {value['dof']} directions"


def _certificate(value: Mapping[str, Any]) -> str:
    edge, bounds = _listed(value["on_boundary"]), _listed(value["active_bounds"])
    return (
        f"{'proved' if value['certified'] else 'not proved'}: relative gap {number(value['relative_gap'], 2)}, primal violation "
        f"{number(value['primal_violation'], 2)}, dual residual {number(value['dual_residual'], 2)}; at most "
        f"{number(value['largest_error_std'], 2)} standard deviations from the optimum. "
        f"Bodies on the edge of what can exist: {edge}. Bounds reached: {bounds}"
    )


def _physics(value: Mapping[str, Any]) -> str:
    if not value["tested"]:
        return "not tested: the body that fits best was not found"
    p = chance(value["probability_at_most"])
    said = "yes" if value["data_contradict_physics"] else "no"
    return f"{said}: data of a body that can exist lie so far from all of them with a chance of at most {p}"


def _trust(value: Mapping[str, Any]) -> str:
    std = value["rel_std"]
    size = "" if std is None else f", relative standard deviation of masses {number(std, 3)}"
    return f"metric {value['metric']}{size} ({value['rule']})"


_WRITERS: dict[str, Callable[[Any], str]] = {
    "agreement_of_gls_and_wls": chance,
    "certificate": _certificate,
    "durbin_wu_hausman": _hausman,
    "efficiency_for_normal_noise": percent,
    "largest_noise_share": percent,
    "physics": _physics,
    "rejected_share": percent,
    "rejected_windows": _windows,
    "trust": _trust,
}
