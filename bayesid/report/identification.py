"""The report of ``identify``."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from bayesid.drawing import Figures, figures_of
from bayesid.dynamics.base_parameters import BaseParameters, combination, notation
from bayesid.dynamics.channels import WRENCH_NAMES
from bayesid.recordings.complaints import listed
from bayesid.regression.problem import Problem
from bayesid.report.accuracy import certificate_section
from bayesid.report.fit_figures import bandwidth_sensitivity, intervals_figure, measured_against_predicted, residuals
from bayesid.report.page import below, bullets, cards, figure, fold, how, lead, mood_of, note, page, physical, svg, warnings
from bayesid.results.files import report_of
from bayesid.results.identification import Identification
from bayesid.robot import inertia
from bayesid.rounding import DASH, chance, channel_text, ends, number, percent, with_interval
from bayesid.section import Cell, Html, Part, ShownSection, ShownTable, tag
from bayesid.validation.prediction import BAND, Prediction, judged, of_signal, still_predictable, worse_than_nothing

#: So many entries of a list are shown.
_SHOWN = 8


def described(details: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Pairs of a term and a text; warnings are left out, as they stand on top of the report.

    Entries of an estimator that is not known here are written out as they are.
    """
    out = []
    for key, value in details.items():
        if key == "warnings":
            continue
        name, write = _DETAILS.get(key, (key.replace("_", " ").capitalize(), _plain))
        try:
            text = write(value)
        except (AttributeError, KeyError, TypeError, ValueError):  # another estimator's entry of the same name
            text = _plain(value)
        out.append((name, text))
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
    return listed(texts, _SHOWN) or "none"


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
    if not (value["tested"] or value["data_contradict_physics"]):
        return "not tested: the body that fits best was not found"
    p = chance(value["probability_at_most"])
    said = "yes" if value["data_contradict_physics"] else "no"
    return f"{said}: data of a body that can exist lie so far from all of them with a chance of at most {p}"


def _prior_strength(value: Mapping[str, Any]) -> str:
    std = value["rel_std"]
    size = "" if std is None else f", relative standard deviation of masses {number(std, 3)}"
    return f"metric {value['metric']}{size} ({value['rule']})"


#: Name of each detail of an estimate, and what writes its value.
_DETAILS: dict[str, tuple[str, Callable[[Any], str]]] = {
    "agreement_of_gls_and_wls": ("Chance of so large a gap of gls and wls", chance),
    "certificate": ("Certificate of the optimum", _certificate),
    "durbin_wu_hausman": ("Durbin-Wu-Hausman test", _hausman),
    "efficiency_for_normal_noise": ("Efficiency for normal noise", percent),
    "encoder_correlation": ("Correlation of encoder noise from sample to sample, by joint", _plain),
    "encoder_std": ("Encoder noise by joint [rad or m]", _plain),
    "first_stage": ("First-stage statistic of the instruments", _plain),
    "largest_noise_share": ("Largest share of encoder noise in a direction", percent),
    "model_complete": ("Model complete", _plain),
    "nu": ("Degrees of freedom of Student's t", _plain),
    "physics": ("Do the data contradict physics?", _physics),
    "rows_per_stretch": ("Rows per segment", _plain),
    "rejected_share": ("Rows rejected as taps or contacts", percent),
    "rejected_windows": ("Rejected times", _windows),
    "shift_from_least_squares": ("Largest shift from least squares, in its standard deviations", _plain),
    "trust": ("Prior of the nominal model", _prior_strength),
    "weights": ("Rows weighted by", _plain),
}


#: Figures of at most so many motions of each role are shown.
SHOWN_MOTIONS = 6
_STATIC = {"motion": "subtracted sample by sample", "joint": "fitted along", "none": "none"}
_MOODS = ("good", "fair", "bad")
#: What the text of an interval is made of.
_INTERVAL = ("value", "std", "low", "high")


@report_of.register
def identification_report(result: Identification) -> str:
    """The report of ``identify``: an HTML page with all figures inside."""
    estimate, problem = result.estimate, result.problem
    validation, fitted = _most_telling(result.validation), _most_telling(result.fitted)
    motions = [(p, f"validation-{k}") for k, p in enumerate(validation)] + [(p, f"fitted-{k}") for k, p in enumerate(fitted)]
    left_out = len(result.validation) + len(result.fitted) - len(motions)
    omitted = f" Of {left_out} more motions only the numbers are shown below." if left_out else ""
    tried = problem.bandwidths
    sections: list[Part] = [
        _identified(result),
        ShownSection("Measured against predicted", [
            f"Both in the band up to {number(BAND, 2)} Hz, by one filter without delay. Motions for validation took no part in "
            f"the fit: how well they are predicted is the test of the estimate.{omitted}",
            "" if validation else
            "**There is no validation motion**, so the figures below show the fit only, which says little about other motions. "
            "Add a motion with role validation.",
            *_motions(motions, lambda p, name: (
                _said(p), figure(svg(measured_against_predicted(p), f"{name}-predicted"), _caption(p)),
            )),
        ]),
        ShownSection("What is left over", [
            "Measured less predicted. If the model is complete, what is left looks like the noise: it keeps inside the green "
            "band (where noise alone would be 95 % of the time), and its spectrum follows the noise model on which the "
            "intervals rest. Where it sticks out, in time or at some frequency, something is at work that is not in the model.",
            *_motions(motions, lambda p, name: (figure(svg(residuals(p), f"{name}-residuals"), _residual_caption(p)),)),
        ], "Residuals"),
        _errors(result),
        limits_section(result),
        _links(result),
        _agreement(result),
        *_both_ways(result),
        *certificate_section(result.certificate, estimate.base),
        ShownSection("How this was done", [
            *how(*_how(result), seconds=result.seconds).parts,
            "" if tried is None else below("The bandwidth of the motion", figure(
                svg(bandwidth_sensitivity(tried, estimate.full_std), "bandwidths"),
                "Bandwidths that were tried. Left: error on segments of the fitted motions that were left out, in one and the "
                "same band. Right: how far the estimate moves from the chosen one's, in its standard deviations.")),
            below("Conventions", note(
                "SI units. Ten parameters a body in Pinocchio's order, m, mcx, mcy, mcz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz, about "
                "the origin of its joint's frame. Force before moment. A wrench is the one that the sensor applies to the "
                "robot, in the sensor's frame, moments about its origin: at rest on an upright sensor fz = +m g. Intervals are "
                "central and hold 95 %.")),
        ], "How"),
    ]  # fmt: skip
    name, robot = problem.experiment.name, problem.experiment.robot.name
    fine = "No warnings: validation motions are predicted down to the noise and the data agree with themselves."
    opening = [
        warnings(result.warnings, fine), *(lead(f"**{text}**", "bad") for text in result.unusable), lead(_verdict(result)),
        cards(_cards(result)),
    ]  # fmt: skip
    kicker = f"Inertial parameters of {robot}, identified from the {channel_text(problem.channel, problem.fitted)}"
    return page(name, f"{kicker} by {estimate.method}", opening, sections, f"{name}: identification")


def _most_telling(predictions: Sequence[Prediction]) -> list[Prediction]:
    """All motions, or those with the largest residuals where there are too many for a page."""
    worst = sorted(predictions, key=lambda p: -p.whitened_rms)[:SHOWN_MOTIONS]
    return [p for p in predictions if p in worst] if len(predictions) > SHOWN_MOTIONS else list(predictions)


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
        f"{of_signal(worst)} ({_sizes(worst)}; {percent(worst.relative_error_raw, 2)} on raw samples); "
        f"{judged(worst).text}. {still_predictable(worst)}"
    ).rstrip()
    if worst.repeats:
        text += f" That motion repeats the fitted ‘{worst.repeats}’, however."
    return text


def _cards(result: Identification) -> list[tuple[str, str, str]]:
    estimate, problem = result.estimate, result.problem
    total = problem.experiment.robot.nominal.size
    large = [(str(estimate.base.rank), f"base parameters (rank), of {total} in the links", "")]
    for p in _most_telling(result.validation)[:2]:
        mood = judged(p).mood
        large.append((percent(p.relative_error), f"error of the signal on ‘{p.motion}’, below {BAND:.2g} Hz", mood))
        if p.noise_known:
            large.append((f"{number(p.times_noise, 3)} ×", f"the measurement noise: the residual on ‘{p.motion}’", mood))
    moved = result.urdf.moved
    if moved is not None and moved.distance is not None:
        text = f"from the estimate to links that can exist; {number(moved.allowed, 2)} is the 95 % region's radius"
        large.append((f"{number(moved.distance, 2)} σ", text, "good" if moved.inside else "bad"))
    return large


def _identified(result: Identification) -> ShownSection:
    """Base parameters and effects with their intervals."""
    estimate, regression = result.estimate, result.problem.regression
    found, rank = estimate.parameters(), estimate.base.rank
    nominal = [DASH] * rank if regression.nominal is None else [number(v) for v in regression.nominal]
    rows = []
    for k in range(rank):
        low, high = found.low[k], found.high[k]
        value, half = with_interval(found.values[k], found.std[k], low, high)
        rows.append([str(k + 1), found.labels[k], value, half, found.units[k], ends(low, high), nominal[k], found.classes[k]])
    head = ["#", "base parameter", "value", "± 95 %", "unit", "interval", "nominal", "class"]
    return ShownSection("What was identified, and how sure it is", [
        "These readings show links' masses, first moments (mass times centre of mass) and inertias in certain combinations "
        "only: the base parameters. Every prediction of these readings follows from them. In a label, m2 is the mass of body "
        "2, m2 r2x its first moment along x and I2xy an inertia about the origin of its joint's frame; bodies are counted in "
        "the order of the table of links below.",
        f"**No intervals:** {estimate.interval_reason}." if estimate.interval == "none" and estimate.interval_reason else "",
        figure(svg(intervals_figure(regression, estimate), "intervals"),
               "Each base parameter's change against the nominal model (dot) with its central 95 % interval (bar), in units of "
               "its natural size: what the parameter would change by if every body that is in it were as uncertain as it is "
               "large. Right: half the interval, in per cent of that size; from 196 % on, a dashed line, it is weak. Triangles "
               "lie outside the picture. Numbers as in the table."),
        ShownTable(head, rows, "nd w nb n ku n n t"),
        Html(f'<p class="note">{tag("alone")} one parameter of one link; {tag("combination")} a sum that only as a whole can be '
             f"seen; {tag('weak')} known no better than the size of the body; {tag('prior')} the data say next to nothing: the "
             "value is the nominal one, moved only where what the data do say goes together with it.</p>"),
        *_effects(result),
    ], "Parameters")  # fmt: skip


_OFFSET_NOTE = (
    "The sensor's offset is what is left of the estimated constant once the nominal weight that looks like one is taken off: "
    "it is only as good as the nominal masses, and has an interval only where the experiment says how far those are trusted."
)


def _effects(result: Identification) -> list[Html]:
    rows, marks = [], {}
    together = {spec for specs in result.not_shown.effects.values() for spec in specs}
    for effect in result.effects():
        marks[len(rows)] = "rule"
        said = "not told from links" if f"{effect['name']}@{effect['where']}" in together else ""
        for k, (key, parameter) in enumerate(effect["parameters"].items()):
            where = [effect["name"].replace("_", " "), effect["where"]] if k == 0 else ["", ""]
            rows.append([*where, key, *with_interval(*(parameter[part] for part in _INTERVAL)), parameter["unit"], said])
    if not rows:
        return []
    offset = result.offset is not None and result.problem.row_model.base.weight_in_offset
    text = f"Estimated together with the base parameters.{f' {_OFFSET_NOTE}' if offset else ''}"
    table = ShownTable(["effect", "where", "parameter", "value", "± 95 %", "unit", ""], rows, "k k - nb n ku -", "narrow", marks)
    return [below("Effects beyond rigid bodies", text, table)]


def _motions(motions: Sequence[tuple[Prediction, str]], shown: Callable[[Prediction, str], Sequence[Part]]) -> list[Html]:
    """Each motion under its title; fitted ones folded, the first opened where there is no other."""
    out = []
    for p, name in motions:
        title, parts = _title(p, name), shown(p, name)
        validation = name.startswith("validation")
        out.append(below(title, *parts) if validation else fold(title, *parts, opened=not out))
    return out


def _title(prediction: Prediction, role: str) -> str:
    return f"{prediction.motion} ({'validation: not fitted' if role.startswith('validation') else 'fitted'})"


def _said(p: Prediction) -> str:
    """How well a motion is predicted."""
    text = (
        f"Error {percent(p.relative_error, 3)} of {of_signal(p)}, {_sizes(p)} "
        f"({percent(p.relative_error_raw, 3)} on raw samples); {judged(p).text}. {still_predictable(p)}"
    ).rstrip()
    if p.repeats:
        text += f" It repeats the fitted motion ‘{p.repeats}’ and so says little about other motions."
    return text


def _caption(p: Prediction) -> str:
    what = "poses, numbered" if p.poses else f"motion of {number(p.times[-1] - p.times[0], 3)} s"
    lines = ("circles", "crosses") if p.poses else ("broad, pale", "thin, red")
    return f"{p.motion}: measured ({lines[0]}) and predicted ({lines[1]}); {what}."


def _residual_caption(p: Prediction) -> str:
    if p.spectrum is None:
        return f"{p.motion}: measured less predicted, in time."
    text = f"{p.motion}: measured less predicted, in time and as amplitude spectral density beside the noise model."
    filtered = " The spectra are those behind the low-pass filters; readings in time have not passed them."
    return text + filtered * p.spectrum.filtered


def _errors(result: Identification) -> ShownSection:
    """Errors of every motion by channel."""
    tables = [_error_table(p, role) for role, ps in (("validation", result.validation), ("fitted", result.fitted)) for p in ps]
    return ShownSection("Errors in numbers", [
        f"Root mean square of measured less predicted, in the band up to {number(BAND, 2)} Hz and on raw samples (where the "
        "measurement noise counts in full), also relative to the root mean square of the reading. **Times noise** is the "
        "residual below 10 Hz in units of the measurement noise (with what encoder errors make of a prediction), read off the "
        "readings and not off the fit: 1 is what that noise alone leaves, more is model error. Both numbers count: a motion "
        "that hardly moves leaves little but noise under any model, and a channel whose relative error is above 100 % is "
        "predicted worse than by zero, whatever its noise. **In the interval**: share of residuals inside their 95 % "
        "prediction interval; 95 % is right.",
        Html(f'<div class="pair">{"".join(f"<div>{table.content}</div>" for table in tables)}</div>'),
    ], "Errors")  # fmt: skip


def _error_table(p: Prediction, role: str) -> Html:
    rows: list[list[Cell]] = []
    for k, (name, unit, white) in enumerate(zip(p.channel_names, p.channel_units, p.whitened_rms_by_channel, strict=True)):
        mood = "bad" if worse_than_nothing(p.nrmse[k]) else mood_of(white) if p.noise_known else ""
        errors = number(p.rmse[k], 3), percent(p.nrmse[k]), number(p.rmse_raw[k], 3), percent(p.nrmse_raw[k])
        rows.append([name, *errors, unit, (number(white if p.noise_known else None, 3), mood)])
    whole = (percent(p.relative_error), "sure"), "", percent(p.relative_error_raw), "", (number(p.times_noise, 3), judged(p).mood)
    head = ["channel", f"rms error, {number(BAND, 2)} Hz", "relative", "rms error, raw", "relative", "unit", "times noise"]
    table = ShownTable(head, [*rows, ["all", "", *whole]], "- nb n n n ku n", "narrow", {len(rows): "rule"})
    repeats = f" This motion repeats the fitted ‘{p.repeats}’." if p.repeats else ""
    text = f"{percent(p.coverage)} of residuals in their 95 % prediction interval.{repeats}"
    return below(_title(p, role), table, note(text))


def _links(result: Identification) -> ShownSection:
    """Nominal and identified links, with how far the data alone determine each number."""
    urdf = result.urdf
    if not urdf.usable:
        return ShownSection("Link parameters", [
            f"Not shown: no robot of this URDF is as heavy as these links ({number(urdf.mass, 3)} kg), so they are no result. "
            f"{urdf.text()} The base parameters above hold the fit.",
        ], "Links")  # fmt: skip
    both = " `identified-unconstrained.urdf` holds the links with exactly the estimated base parameters, possible or not."
    return ShownSection("Link parameters", [
        "Ten numbers a link, nearest to the nominal model among all that can exist and whose base parameters stay within the "
        "estimate's uncertainty; this is what `identified.urdf` holds, with the identified friction of joints. "
        f"{urdf.text()}{both * result.unconstrained_urdf}",
        "Only **bold** numbers are determined by the data alone. Plain ones move with the data, yet how a combination is "
        "shared among links is the nominal model's choice: they predict these readings, but taken one by one they are no "
        "measurement. Grey ones influence no reading at all: they only keep the link near its nominal mass distribution. "
        "Centre of mass in the joint's frame [m], inertia about the centre of mass, axes of the joint's frame [kg m²], mass "
        "[kg].",
        _link_table(result),
        note("A link can exist if its mass is positive and its inertia is that of some distribution of positive mass."),
    ], "Links")  # fmt: skip


def _link_table(result: Identification) -> ShownTable:
    robot, estimate = result.problem.experiment.robot, result.estimate
    bodies = result.link_parameters.reshape(-1, 10)
    seen = estimate.base.matrix[~estimate.undetermined[: estimate.base.rank]]
    length = np.linalg.norm(seen, axis=0)
    # The projector on what the data see: one on its diagonal means that a parameter is seen by itself.
    alone = (np.diag(np.linalg.pinv(seen) @ seen) > 1.0 - 1e-6).reshape(-1, 10) if len(seen) else np.zeros(bodies.shape, bool)
    moved = (length > 0).reshape(-1, 10)
    # The centre of mass takes the mass and its first moment; the inertia about it takes these, too.
    needs = [[0], [0, 1], [0, 2], [0, 3], *([0, 1, 2, 3, k] for k in range(4, 10))]
    rows: list[list[Cell]] = []
    for k, name in enumerate(robot.body_names):
        nominal, found = physical(robot.nominal[k]), physical(bodies[k])
        if max(np.abs(robot.nominal[k]).max(), np.abs(bodies[k]).max()) < 1e-9:
            continue
        kinds = ["sure" if alone[k, n].all() else "" if moved[k, n].any() else "dim" for n in needs]
        before, after = inertia.is_physically_consistent(np.stack([robot.nominal[k], bodies[k]]))
        dim = [(text, "dim") for text in ("nominal", *(number(v, 3) for v in nominal), "yes" if before else "no")]
        values = [(number(v, 3), kind) for v, kind in zip(found, kinds, strict=True)]
        rows.append([f"{k + 1} {name}", *dim])
        rows.append(["", "identified", *values, ("yes", "sure good") if after else ("no", "sure bad")])
    head = ["link of", "", "mass", "cx", "cy", "cz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz", "can exist"]
    return ShownTable(head, rows, f"k -{' n' * 10} -", "tight", {k: "rule" for k in range(0, len(rows), 2)})


def _agreement(result: Identification) -> ShownSection:
    """The same numbers from parts of the data."""
    title, name = "Do the data agree with themselves?", "Agreement"
    if not result.agreements:
        return ShownSection(title, ["There is nothing to compare: it takes two motions, or a wrench and torques."], name)
    rows = [
        [a.first, a.second, str(a.compared), (number(a.rms, 3), "sure"), chance(a.probability),
         ("contradict", "sure bad") if a.contradiction else ("agree", "sure good"), a.worst]
        for a in result.agreements
    ]  # fmt: skip
    head = ["estimate", "against", "numbers", "difference, sigma", "probability", "", "differs most"]
    return ShownSection(title, [
        "The same numbers, estimated twice from data that have nothing in common. The difference should be as large as both "
        "intervals say: about 1 sigma root mean square. A probability below 0.1 % means that they contradict each other, and "
        "that the intervals are too narrow for one of them.",
        ShownTable(head, rows, "- - n n n k w"),
    ], name)  # fmt: skip


def _both_ways(result: Identification) -> list[ShownSection]:
    """Subtracting the static run and fitting it along, side by side."""
    other = result.static_alternative
    if other is None:
        return []
    subtracted = result.problem.static == "motion"
    tables = []
    for estimate in (result.estimate, other):
        own = estimate.parameters().to_list()[: estimate.base.rank]
        tables.append({p["name"]: (*with_interval(*(p[k] for k in _INTERVAL)), p["label"], p["unit"]) for p in own})
    first, second = tables if subtracted else tables[::-1]
    nothing, either = (DASH, DASH), second | first
    rows = [
        [either[name][2], *first.get(name, nothing)[:2], *second.get(name, nothing)[:2], either[name][3]]
        for name in dict.fromkeys([*first, *second])
    ]
    head = ["base parameter", "subtracted", "± 95 %", "fitted along", "± 95 %", "unit"]
    return [ShownSection("The static run, used both ways", [
        "The readings at rest can be subtracted sample by sample, which removes the sensor's offset and all gravity (equation "
        "21 of the paper), or fitted along, which keeps what gravity tells. The estimate of this report "
        f"{'subtracts them' if subtracted else 'fits them along'}. Both use the same moving samples, so they are not "
        "independent: differences much beyond the intervals mean that subtracting or gravity brings in something that is not "
        "in the model.",
        ShownTable(head, rows, "w n n n n ku"),
        note("A dash: that way does not show the parameter." if set(first) != set(second) else ""),
    ], "Static run")]  # fmt: skip


def how_motions(problem: Problem) -> list[tuple[str, str]]:
    """Where the joint motion comes from, and what is done with readings at rest."""
    filters = problem.row_model.filters
    return [
        ("Bandwidth of the motion", f"{number(problem.smoother.bandwidth, 3)} Hz; {problem.smoother.reason}"),
        ("Accelerations", "from a spline through the positions, without delay" if filters is None else
         f"none: low-pass filters on both sides, l = {number(filters.l, 3)} and d = {number(filters.d, 3)} rad/s"),
        ("Static readings", _STATIC[problem.static]),
    ]  # fmt: skip


def _how(result: Identification) -> list[tuple[str, str]]:
    """What was chosen and why, as pairs of a term and a text."""
    estimate, problem = result.estimate, result.problem
    noise = estimate.noise
    orders = {group: model.order for group, model in noise.items()}
    names, units = problem.row_model.channels.names, problem.row_model.channels.units
    sizes = [
        f"{group}: " + ", ".join(f"{c} {number(s, 2)} {u}" for c, s, u in zip(names, model.std, units, strict=True))
        for group, model in noise.items()
    ]
    bandwidth, accelerations, static = how_motions(problem)
    rows = [
        bandwidth, accelerations,
        ("Rows", f"{estimate.rows} numbers, {number(1.0 / problem.row_model.step, 3)} rows a second"), static,
        ("Noise", "autoregressive in time, correlated between channels; order "
         + ", ".join(f"{o} ({g})" for g, o in orders.items())),
        ("Noise model, stationary standard deviation of a row", "; ".join(sizes) + ". It is learned from what the fit leaves, so "
         "that model error counts as noise, and holds noise slower than the recording: it may exceed the residual, and the noise "
         "of one sample of the sensor"),
        ("Residual of the fit", f"{number(estimate.residual_rms, 3)} times the noise; largest autocorrelation of whitened "
         f"residuals {number(estimate.whiteness, 2)} standard errors"),
        ("Condition number", f"{number(estimate.condition_number, 3)}, with columns of unit length"),
        ("Intervals", estimate.interval if not estimate.interval_reason else f"{estimate.interval}: {estimate.interval_reason}"),
    ]  # fmt: skip
    if result.prior_check is not None:
        rows.append(("Prior against data", result.prior_check.brief()))
    return [*rows, *described(estimate.details.to_dict())]


@figures_of.register
def _(result: Identification) -> Figures:
    intervals = partial(intervals_figure, result.problem.regression, result.estimate)
    return {"predictions": measured_against_predicted, "residuals": residuals, "intervals": intervals}


def limits_section(result: Identification) -> ShownSection:
    """What these motions, and these readings, do not show."""
    base, problem = result.estimate.base, result.problem
    lost = result.not_shown
    parts: list[Part] = []
    if lost.motions:
        parts.append(below(
            "Hidden by these motions",
            "Other motions of this robot could show these; the recorded ones do not, or not well enough to say more than the "
            "size of the body does. Where the tables give a number, it rests on the nominal one (class prior) or is less "
            "sure than the body is large (class weak): it should not be used by itself. Motions that move these links faster, "
            "or in other poses, would help.",
            *_combinations(lost.motions),
        ))  # fmt: skip
    if lost.effects:
        parts.append(below(
            "Lost to an effect in the model",
            "These motions show these only together with an effect that is estimated along, as inertia about a joint's axis "
            "adds to that of the rotor behind it: where the tables give a number of either, rely on their sum alone. What "
            "is stated of the effect in [model.values] gives them back.",
            bullets([f"{label}: not told from {', '.join(specs)}" for label, specs in lost.effects.items()]),
        ))  # fmt: skip
    if lost.static_run:
        tells = "A scale, or the nominal model, tells them."
        if lost.fitted_along:
            tells = f"Where the run is fitted along, readings show {', '.join(lost.fitted_along)}."
        parts.append(below(
            "Lost to the static run",
            f"The static run is subtracted, and gravity with it: no motion shows these. {tells}",
            *_combinations(lost.static_run),
        ))  # fmt: skip
    if not parts:
        parts.append("Nothing that these readings can show at all was hidden by the motions.")
    if lost.invisible:
        gravity = " (with the static run subtracted, nor does what only gravity would show)" if problem.static == "motion" else ""
        parts.append(below(
            "Invisible to these readings",
            f"No motion whatever shows these {len(lost.invisible)} parameters in the {channel_text(problem.channel)}: they "
            f"influence no reading{gravity}. Only the nominal model tells them.",
            bullets(_by_body(lost.invisible)),
        ))  # fmt: skip
    if absorbed := _absorbed(base):
        parts.append(below(
            "What the unknown sensor offset costs",
            "Nothing here measures the sensor's offset by itself, so it is estimated along, and what acts on the sensor like a "
            "constant offset cannot be told from it: it is taken up by the offset instead of by the base parameters. A static "
            "run, or a reading of the unloaded sensor, would give it back. An offset that is estimated contains, beside the "
            "true offset:",
            ShownTable(["axis", "contains besides"], absorbed, "- w"),
        ))  # fmt: skip
    return ShownSection("What could not be identified", parts)


def _combinations(labels: Sequence[str]) -> list[Part]:
    """Single parameters in one line, then the sums as a list."""
    return [", ".join(label for label in labels if " " not in label), bullets([x for x in labels if " " in x], sums=True)]


def _by_body(names: Sequence[str]) -> list[str]:
    """``joint1.m, joint1.mcx`` as ``joint1: m, mcx``."""
    bodies: dict[str, list[str]] = {}
    for name in names:
        body, _, kind = name.rpartition(".")
        bodies.setdefault(body, []).append(kind)
    return [f"{body}: {', '.join(kinds)}" if body else ", ".join(kinds) for body, kinds in bodies.items()]


def _absorbed(base: BaseParameters) -> list[list[str]]:
    """What an estimated offset contains besides the true one, axis by axis."""
    rows, names = () if base.absorbed is None else base.absorbed, notation(base.parameter_names)
    return [[axis, combination(row, names)] for axis, row in zip(WRENCH_NAMES, rows, strict=False) if row.any()]
