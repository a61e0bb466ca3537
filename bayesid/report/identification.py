"""The report of ``identify``: turns an `Identification` into what its template shows."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from markupsafe import Markup
from matplotlib.figure import Figure

from bayesid.dynamics.base_parameters import BaseParameters
from bayesid.estimators import Estimate
from bayesid.regression.regression import Regression
from bayesid.report.certificate import certificate_section
from bayesid.report.identification_figures import bandwidth_sensitivity, parameter_intervals
from bayesid.report.page import physical, render, run_times, svg, versions
from bayesid.report.prediction_figures import measured_against_predicted, residuals
from bayesid.results.identification import Identification
from bayesid.results.loaded import LoadedIdentification
from bayesid.results.section import as_html
from bayesid.results.text import DASH, HALF, chance, channel_text, ends, number, percent, with_interval
from bayesid.robot import inertia
from bayesid.robot.notation import notation
from bayesid.validation.headline import judged, still_predictable, worse_than_nothing
from bayesid.validation.prediction import BAND, TOLERATED, Prediction

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
        f"{'proved' if value['certified'] else 'not proved'}: relative gap {number(value['relative_gap'], 2)}, primal "
        f"violation {number(value['primal_violation'], 2)}, dual residual {number(value['dual_residual'], 2)}; at most "
        f"{number(value['largest_error_std'], 2)} standard deviations from the optimum. "
        f"Bodies on the edge of what can exist: {edge}. Bounds reached: {bounds}"
    )


def _physics(value: Mapping[str, Any]) -> str:
    if not value["tested"]:
        return "not tested: the body that fits best was not found"
    p = chance(value["probability_at_most"])
    said = "yes" if value["data_contradict_physics"] else "no"
    return f"{said}: data of a body that can exist lie so far from all of them with a chance of at most {p}"


def _prior_strength(value: Mapping[str, Any]) -> str:
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
    "trust": _prior_strength,
}


#: Figures of at most so many motions of each role are shown.
SHOWN_MOTIONS = 6
STATIC = {"motion": "subtracted sample by sample", "joint": "fitted along", "none": "none"}
#: Residuals up to so many times the noise count as good and as fair.
_GOOD, _FAIR = TOLERATED, 1.5
_MOODS = ("good", "fair", "bad")
#: What the text of an interval is made of.
_INTERVAL = ("value", "std", "low", "high")


def identification_report(result: Identification) -> str:
    """The report of ``identify``: an HTML page with all figures inside."""
    estimate, problem = result.estimate, result.problem
    validation, fitted = _most_telling(result.validation), _most_telling(result.fitted)
    tried = problem.bandwidths
    left_out = len(result.validation) + len(result.fitted) - len(validation) - len(fitted)
    return render(
        "identification.html",
        name=problem.experiment.name,
        robot=problem.experiment.robot.name,
        channel=channel_text(problem.channel),
        fitted=problem.fitted,
        method=estimate.method,
        warning_list=result.warnings,
        verdict=_verdict(result),
        unusable=result.unusable,
        links_usable=result.urdf.usable,
        links_mass=number(result.urdf.mass, 3),
        card_list=_cards(result),
        interval_reason=estimate.interval_reason if estimate.interval == "none" else "",
        intervals=svg(intervals_figure(problem.regression, estimate), "intervals"),
        bandwidths="" if tried is None else svg(bandwidth_sensitivity(tried, estimate.full_std), "bandwidths"),
        parameters=_parameters(problem.regression, estimate),
        effects=_effects(result.effects()),
        offset_note=_OFFSET_NOTE if result.offset is not None and problem.row_model.base.weight_in_offset else "",
        band=number(BAND, 2),
        validation=[_motion(p, "validation", k) for k, p in enumerate(validation)],
        fits=[_motion(p, "fitted", k) for k, p in enumerate(fitted)],
        omitted=f"Of {left_out} more motions only the numbers are shown below." if left_out else "",
        errors=[_errors(p, role) for role, ps in (("validation", result.validation), ("fitted", result.fitted)) for p in ps],
        unexcited=[label for label in result.unexcited if " " in label],
        unexcited_single=", ".join(label for label in result.unexcited if " " not in label),
        invisible=_by_body(estimate.base.invisible),
        invisible_count=len(estimate.base.invisible),
        gravity_free=problem.static == "motion",
        absorbed=_absorbed(estimate.base),
        links=_links(result),
        links_note=result.urdf.text(),
        links_unconstrained=result.unconstrained_urdf,
        agreements=[{**a.to_dict(), "rms": number(a.rms, 3), "probability": chance(a.probability)} for a in result.agreements],
        static=_both_ways(result),
        certificate=Markup(as_html(certificate_section(result.certificate, estimate.base))),
        how=_how(result),
    )


_OFFSET_NOTE = (
    "The sensor's offset is what is left of the estimated constant once the nominal weight that looks like one is taken off: "
    "it is only as good as the nominal masses, and has an interval only where the experiment says how far those are trusted."
)


def _most_telling(predictions: Sequence[Prediction]) -> list[Prediction]:
    """All motions, or those with the largest residuals where there are too many for a page."""
    worst = sorted(predictions, key=lambda p: -p.whitened_rms)[:SHOWN_MOTIONS]
    return [p for p in predictions if p in worst] if len(predictions) > SHOWN_MOTIONS else list(predictions)


def mood_of(white: float) -> str:
    """``good``, ``fair`` or ``bad`` for a residual in units of the noise."""
    return "good" if white <= _GOOD else "fair" if white <= _FAIR else "bad"


def _sizes(prediction: Prediction) -> str:
    """Errors in the channels' units, those of one unit together: ``0.4 N and 0.02 N m rms``."""
    units = np.array(prediction.channel_units)
    rms = {unit: np.sqrt(np.mean(prediction.rmse[units == unit] ** 2)) for unit in dict.fromkeys(prediction.channel_units)}
    return " and ".join(f"{number(r, 2)} {unit}" for unit, r in rms.items()) + " rms per channel"


def _verdict(result: Identification) -> str:
    """The result in a few plain sentences."""
    estimate, problem = result.estimate, result.problem
    poorly = sum(k in ("weak", "prior") for k in estimate.classes)
    rank = estimate.base.rank
    count = f"All {rank} base parameters were identified."
    if poorly:
        count = (
            f"Of {rank} base parameters, {rank - poorly} were identified; of the other {poorly} the data say no more than the "
            "size of the bodies does."
        )
    if not result.validation:
        return f"{count} There is no validation motion, so nothing shows yet how well they hold for a motion that was not fitted."
    worst = max(result.validation, key=lambda p: (_MOODS.index(judged(p).mood), p.relative_error))
    unseen = "the motion" if len(result.validation) == 1 else f"the worst of {len(result.validation)} motions"
    text = (
        f"{count} On {unseen} not used for the fit (‘{worst.motion}’), the {channel_text(problem.channel)} "
        f"{'are' if problem.channel != 'wrench' else 'is'} predicted with an error of {percent(worst.relative_error, 2)} of "
        f"the signal below {number(BAND, 2)} Hz ({_sizes(worst)}; {percent(worst.relative_error_raw, 2)} on raw samples); "
        f"{judged(worst).text}. {still_predictable(worst)}"
    ).rstrip()
    if worst.repeats:
        text += f" That motion repeats the fitted ‘{worst.repeats}’, however."
    return text


def _cards(result: Identification) -> list[dict[str, str]]:
    estimate, problem = result.estimate, result.problem
    total = problem.experiment.robot.nominal.size
    cards = [{"value": str(estimate.base.rank), "mood": "", "text": f"base parameters (rank), of {total} in the links"}]
    for p in _most_telling(result.validation)[:2]:
        mood = judged(p).mood
        cards += [
            {
                "value": percent(p.relative_error),
                "mood": mood,
                "text": f"error of the signal on ‘{p.motion}’, below {BAND:.2g} Hz",
            },
        ]
        if p.noise_known:
            text = f"the sensor's noise: the residual on ‘{p.motion}’"
            cards.append({"value": f"{number(p.times_noise, 3)} ×", "mood": mood, "text": text})
    moved = result.urdf.moved
    if moved is not None and moved.distance is not None:
        cards.append(
            {"value": f"{number(moved.distance, 2)} σ", "mood": "good" if moved.inside else "bad",
             "text": f"from the estimate to links that can exist; {number(moved.allowed, 2)} is the 95 % region's radius"}
        )  # fmt: skip
    return cards


def _reference(regression: Regression | LoadedIdentification, estimate: Estimate) -> tuple[np.ndarray, np.ndarray]:
    """Nominal base parameters (zero without a model) and their natural sizes (r,)."""
    rank = estimate.base.rank
    nominal = np.zeros(rank) if regression.nominal is None else regression.nominal
    half = np.nan_to_num(HALF * estimate.std)
    own = np.maximum(np.maximum(np.abs(estimate.values), np.abs(nominal)), np.maximum(half, 1e-9))
    scale = own if regression.nominal_scale is None else regression.nominal_scale
    return nominal, np.where(np.isfinite(scale) & (scale > 1e-9 * own), scale, own)


def intervals_figure(regression: Regression | LoadedIdentification, estimate: Estimate, ax: Any = None) -> Figure:
    """Base parameters against the nominal model, with their 95 % intervals."""
    nominal, scale = _reference(regression, estimate)
    names = [f"{name}  ({k + 1})" for k, name in enumerate(estimate.base.short_names)]
    between = np.array([estimate.low - nominal, estimate.high - nominal])
    return parameter_intervals(names, estimate.values - nominal, between, scale, estimate.classes, ax)


def _parameters(regression: Regression, estimate: Estimate) -> list[dict[str, Any]]:
    rows = []
    nominal = [DASH] * estimate.base.rank if regression.nominal is None else [number(v) for v in regression.nominal]
    found = estimate.parameters()
    for k in range(estimate.base.rank):
        low, high = found.low[k], found.high[k]
        value, spread = with_interval(found.values[k], found.std[k], low, high)
        rows.append(
            {
                "index": k + 1, "label": found.labels[k], "value": value, "half": spread, "unit": found.units[k],
                "kind": found.classes[k], "interval": ends(low, high), "nominal": nominal[k],
            }
        )  # fmt: skip
    return rows


def _effects(effects: list[dict[str, Any]]) -> list[dict[str, Any]]:
    rows = []
    for effect in effects:
        for k, (key, parameter) in enumerate(effect["parameters"].items()):
            value, half = with_interval(*(parameter[part] for part in _INTERVAL))
            name = effect["name"].replace("_", " ")
            rows.append(
                {"first": k == 0, "name": name if k == 0 else "", "where": effect["where"] if k == 0 else "",
                 "parameter": key, "value": value, "half": half, "unit": parameter["unit"]}
            )  # fmt: skip
    return rows


def _motion(prediction: Prediction, role: str, index: int) -> dict[str, Any]:
    title = f"{prediction.motion} ({'validation: not fitted' if role == 'validation' else 'fitted'})"
    what = "poses, numbered" if prediction.poses else f"motion of {number(prediction.times[-1] - prediction.times[0], 3)} s"
    text = (
        f"Error {percent(prediction.relative_error, 3)} of the signal below {number(BAND, 2)} Hz, {_sizes(prediction)} "
        f"({percent(prediction.relative_error_raw, 3)} on raw samples); {judged(prediction).text}. "
        f"{still_predictable(prediction)}"
    ).rstrip()
    if prediction.repeats:
        text += f" It repeats the fitted motion ‘{prediction.repeats}’ and so says little about other motions."
    lines = ("circles", "crosses") if prediction.poses else ("broad, pale", "thin, red")
    caption = f"{prediction.motion}: measured ({lines[0]}) and predicted ({lines[1]}); {what}."
    left = f"{prediction.motion}: measured less predicted, in time" + (
        "." if prediction.spectrum is None else " and as amplitude spectral density beside the noise model."
    )
    if prediction.spectrum is not None and prediction.spectrum.filtered:
        left += " The spectra are those behind the low-pass filters; readings in time have not passed them."
    return {
        "title": title,
        "text": text,
        "caption": caption,
        "residual_caption": left,
        "predicted": svg(measured_against_predicted(prediction), f"{role}-{index}-predicted"),
        "residuals": svg(residuals(prediction), f"{role}-{index}-residuals"),
    }


def _errors(p: Prediction, role: str) -> dict[str, Any]:
    channels = [
        {"name": name, "unit": unit, "rmse": number(a, 3), "nrmse": percent(b), "raw": number(c, 3), "nraw": percent(d),
         "white": number(w if p.noise_known else None, 3),
         "mood": "bad" if worse_than_nothing(b) else mood_of(w) if p.noise_known else ""}
        for name, unit, a, b, c, d, w in zip(
            p.channel_names, p.channel_units, p.rmse, p.nrmse, p.rmse_raw, p.nrmse_raw, p.whitened_rms_by_channel, strict=True
        )
    ]  # fmt: skip
    return {
        "title": f"{p.motion} ({'validation: not fitted' if role == 'validation' else 'fitted'})",
        "channels": channels,
        "relative": percent(p.relative_error),
        "relative_raw": percent(p.relative_error_raw),
        "white": number(p.times_noise, 3),
        "mood": judged(p).mood,
        "coverage": percent(p.coverage),
        "repeats": f"This motion repeats the fitted ‘{p.repeats}’." if p.repeats else "",
    }


def _by_body(names: Sequence[str]) -> list[str]:
    """``joint1.m, joint1.mcx`` as ``joint1: m, mcx``."""
    bodies: dict[str, list[str]] = {}
    for name in names:
        body, _, kind = name.rpartition(".")
        bodies.setdefault(body, []).append(kind)
    return [f"{body}: {', '.join(kinds)}" if body else ", ".join(kinds) for body, kinds in bodies.items()]


def _absorbed(base: BaseParameters) -> list[dict[str, str]]:
    """What an estimated offset contains besides the true one, axis by axis."""
    if base.absorbed is None:
        return []
    rows, names = [], notation(base.parameter_names)
    for axis, row in zip(("fx", "fy", "fz", "mx", "my", "mz"), base.absorbed, strict=False):
        parts = [f"{'-' if row[k] < 0 else '+'} {abs(row[k]):.4g} {names[k]}" for k in np.flatnonzero(row)]
        if parts:
            rows.append({"axis": axis, "text": re.sub(r"^- ", "-", " ".join(parts).removeprefix("+ "))})
    return rows


def _links(result: Identification) -> list[dict[str, Any]]:
    """Nominal and identified links, with how far the data alone determine each number."""
    robot, estimate = result.problem.experiment.robot, result.estimate
    bodies = result.link_parameters.reshape(-1, 10)
    seen = estimate.base.matrix[~estimate.undetermined[: estimate.base.rank]]
    length = np.linalg.norm(seen, axis=0)
    # The projector on what the data see: one on its diagonal means that a parameter is seen by itself.
    alone = (np.diag(np.linalg.pinv(seen) @ seen) > 1.0 - 1e-6).reshape(-1, 10) if len(seen) else np.zeros(bodies.shape, bool)
    moved = (length > 0).reshape(-1, 10)
    # The centre of mass takes the mass and its first moment; the inertia about it takes these, too.
    needs = [[0], [0, 1], [0, 2], [0, 3], *([0, 1, 2, 3, k] for k in range(4, 10))]
    rows = []
    for k, name in enumerate(robot.body_names):
        nominal, found = physical(robot.nominal[k]), physical(bodies[k])
        if max(np.abs(robot.nominal[k]).max(), np.abs(bodies[k]).max()) < 1e-9:
            continue
        kinds = ["sure" if alone[k, n].all() else "" if moved[k, n].any() else "dim" for n in needs]
        exist = inertia.is_physically_consistent(np.stack([robot.nominal[k], bodies[k]]))
        rows.append(
            {
                "number": k + 1,
                "name": name,
                "nominal": [number(v, 3) for v in nominal],
                "identified": [{"text": number(v, 3), "kind": kind} for v, kind in zip(found, kinds, strict=True)],
                "nominal_exists": bool(exist[0]),
                "exists": bool(exist[1]),
            }
        )
    return rows


def _both_ways(result: Identification) -> dict[str, Any] | None:
    """Subtracting the static run and fitting it along, side by side."""
    other = result.static_alternative
    if other is None:
        return None
    subtracted = result.problem.static == "motion"
    tables = []
    for estimate in (result.estimate, other):
        own = estimate.parameters().to_list()[: estimate.base.rank]
        tables.append({p["name"]: (*with_interval(*(p[k] for k in _INTERVAL)), p["label"], p["unit"]) for p in own})
    first, second = tables if subtracted else tables[::-1]
    rows = []
    for name in dict.fromkeys([*first, *second]):
        one, two = first.get(name), second.get(name)
        label, unit = (one or two or ("", "", "", ""))[2:]
        rows.append(
            {"label": label, "unit": unit, "one": one[0] if one else DASH, "one_half": one[1] if one else DASH,
             "other": two[0] if two else DASH, "other_half": two[1] if two else DASH}
        )  # fmt: skip
    return {"rows": rows, "subtracted": subtracted, "only": set(first) != set(second)}


def _how(result: Identification) -> list[tuple[str, str]]:
    """What was chosen and why, as pairs of a term and a text."""
    estimate, problem = result.estimate, result.problem
    filters, noise = problem.row_model.filters, estimate.noise
    orders = {group: model.order for group, model in noise.items()}
    names, units = problem.row_model.channels.names, problem.row_model.channels.units
    sizes = [
        f"{group}: " + ", ".join(f"{c} {number(s, 2)} {u}" for c, s, u in zip(names, model.std, units, strict=True))
        for group, model in noise.items()
    ]
    how = [
        ("Bandwidth of the motion", f"{number(problem.smoother.bandwidth, 3)} Hz; {problem.smoother.reason}"),
        ("Accelerations", "from a spline through the positions, without delay" if filters is None else
         f"none: low-pass filters on both sides, l = {number(filters.l, 3)} and d = {number(filters.d, 3)} rad/s"),
        ("Rows", f"{estimate.rows} numbers, {number(1.0 / problem.row_model.step, 3)} rows a second"),
        ("Static readings", STATIC[problem.static]),
        ("Noise", "autoregressive in time, correlated between channels; order "
         + ", ".join(f"{o} ({g})" for g, o in orders.items())),
        ("Noise of a sample", "; ".join(sizes)),
        ("Residual of the fit", f"{number(estimate.residual_rms, 3)} times the noise; largest autocorrelation of whitened "
         f"residuals {number(estimate.whiteness, 2)} standard errors"),
        ("Condition number", f"{number(estimate.condition_number, 3)}, with columns of unit length"),
        ("Intervals", estimate.interval if not estimate.interval_reason else f"{estimate.interval}: {estimate.interval_reason}"),
    ]  # fmt: skip
    if result.prior_check is not None:
        how.append(("Prior against data", result.prior_check.brief()))
    return [*how, *described(estimate.details.to_dict()), run_times(result.seconds), versions("numpy", "scipy", "pin")]
