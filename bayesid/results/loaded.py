"""Results read back from the files that they were written to: what the files hold, with the methods of the result."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import bayesid
from bayesid.argument_types import explains_types
from bayesid.arguments import call
from bayesid.drawing import Plots, figures_of
from bayesid.dynamics.base_parameters import BaseParameters
from bayesid.errors import InputError
from bayesid.estimators import Estimate
from bayesid.estimators.attenuation import without_expected_error
from bayesid.estimators.estimator import CustomDetails, Details
from bayesid.estimators.parameters import HasParameters, Parameters, central_interval, tails
from bayesid.posterior.convert import as_dataset, load_arviz
from bayesid.posterior.result import moments, predicted_rows
from bayesid.results.comparison import Entry, HasEntries
from bayesid.results.estimated import HasEstimate
from bayesid.results.files import BESIDE, WRITTEN, check_schema
from bayesid.results.frames import frame
from bayesid.results.posterior import EXPECTED_ERROR
from bayesid.robot.prior import natural_sizes
from bayesid.robot.urdf import JointDynamics
from bayesid.rounding import LEVEL
from bayesid.validation.flexible import FlexibleGap
from bayesid.validation.prediction import Prediction

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from pandas import DataFrame
    from xarray import Dataset

#: Files that hold a result.
DOCUMENTS = tuple(files[0] for files in WRITTEN.values())
DRAWS = "posterior.nc"


class NeedsRecording(InputError, AttributeError):
    """What a loaded result is asked for is not in its file: it needs the recording that the result is of."""


@dataclass(frozen=True, eq=False, repr=False)
class Loaded(Plots):
    """A result read back from its file.

    It prints as the result did, ``to_dict()`` gives the same, and every key of that is an attribute: ``diagnosis.verdict``,
    ``loaded.warnings``. What the file does not hold, such as predictions of other motions, needs the recording and says so.
    """

    kind: str  # name of the result's class
    document: Mapping[str, Any]  # what `to_dict` gave
    printed: str  # what ``print`` showed
    path: Path  # the file

    def to_dict(self) -> dict[str, Any]:
        """The document, as the result's `to_dict`."""
        return dict(self.document)

    def to_dataframe(self) -> DataFrame:
        """The numbers that are printed, as a pandas table: that of the result."""
        return frame(self.kind, self.document)

    def plot(self, *, ax: Any = None) -> Figure:
        """Draw the figure that says most of those that the file holds.

        Raises
        ------
        NeedsRecording
            It holds none.
        """
        if not (drawn := figures_of(self) if self.report else {}):
            raise self._lacks("plot")
        return next(iter(drawn.values()))(ax=ax)

    def __getattr__(self, name: str) -> Any:
        """Keys of the document; anything else that the result has is not in its file."""
        document = self.__dict__.get("document", {})
        if name in document and not name.startswith("_"):
            return document[name]
        live = getattr(bayesid, self.__dict__.get("kind", ""), None)
        if not name.startswith("_") and (hasattr(live, name) or name in getattr(live, "__dataclass_fields__", ())):
            raise self._lacks(name)
        raise AttributeError(f"a loaded {self.__dict__.get('kind', 'result')} has no '{name}'; it has {', '.join(document)}")

    def _held(self, key: str, name: str) -> Any:
        """An entry of the document that `name` is made of; a `NeedsRecording` where it is not there, as in draws alone."""
        if key not in self.document:
            raise self._lacks(name)
        return self.document[key]

    def _lacks(self, name: str) -> NeedsRecording:
        return NeedsRecording(
            f"{self.path}: does not hold what {name} of {self.kind} needs, which is the recording; run the verb again on the "
            "experiment, or keep the result itself with pickle"
        )

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.kind} of {self.document.get('experiment')}: {self.path.name}>"

    def __str__(self) -> str:
        """What the result printed."""
        return self.printed or repr(self)

    def _repr_html_(self) -> str:
        return f"<pre>{escape(str(self))}</pre>"


class _WithModel(Loaded):
    """A result read back that holds the effects of its model, and errors of predictions by it."""

    def effects(self) -> list[dict[str, Any]]:
        """Every effect of the model with values, standard deviations and units of its parameters."""
        return self._held("effects", "effects")

    @property
    def fitted(self) -> tuple[Prediction, ...]:
        """Errors of the fitted motions."""
        return _predictions(self._held("fit", "fitted"), fitted=True)

    @property
    def validation(self) -> tuple[Prediction, ...]:
        """Errors of the motions that were not fitted."""
        return _predictions(self._held("validation", "validation"))


def _column(key: str, text: str) -> Any:
    """A property: one number of each parameter (r,)."""
    return property(lambda loaded: _numbers(loaded._entries, key), doc=text)


class _WithParameters(Loaded):
    """A result read back that lists parameters (r,): the base parameters, or those of the joint torques that bounds are of."""

    @property
    def _entries(self) -> Sequence[Mapping[str, Any]]:
        return self.document["base_parameters"]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters (r,)."""
        return tuple(p["name"] for p in self._entries)

    values = _column("value", "Posterior means of the parameters, or the centre of their bounds (r,).")
    std = _column("std", "Standard deviations of the parameters (r,); nan where there is none.")
    low = _column("low", "Lower ends of the central 95 % intervals (r,); of bounds, of the box that holds all at once.")
    high = _column("high", "Upper ends, as `low` (r,).")


@dataclass(frozen=True, eq=False, repr=False)
class LoadedIdentification(HasEstimate, _WithModel):
    """What `bayesid.identify` found, read back: names, values, intervals, errors of predictions, links."""

    report = "fit_figures"

    @property
    def estimate(self) -> Estimate:
        """Base and effect parameters with their covariance."""
        return _estimate(self.document, self.document["effect_parameters"])

    @property
    def link_parameters(self) -> np.ndarray:
        """Ten parameters a body (10 b), those of ``identified.urdf``."""
        return np.array(self.document["link_parameters"])

    @property
    def dynamics(self) -> JointDynamics:
        """Friction in ``identified.urdf``, and what it has no place for."""
        saved = self.document["identified_urdf"]
        beside = {name: (entry["value"], entry["unit"]) for name, entry in saved["not_in_urdf"].items()}
        return JointDynamics(saved["dynamics"], tuple(saved["negative_friction"]), beside)

    def parameters(self, level: float = LEVEL) -> Parameters:
        """Base parameters, then effect parameters, with central intervals of a probability.

        Raises
        ------
        InputError
            The level is no probability.
        """
        effects = [
            {"name": f"{e['name']}@{e['where']}.{key}", "label": f"{e['name']}@{e['where']}.{key}", "class": "effect", **entry}
            for e in self.document["effects"] for key, entry in e["parameters"].items()
        ]  # fmt: skip
        return _parameters([*self.document["base_parameters"], *effects], level)

    @property
    def nominal(self) -> np.ndarray | None:
        """Base parameters of the nominal model (r,), if there is one."""
        links = self.document["nominal_links"]
        return None if links is None else self.base.matrix @ np.array(links)

    @property
    def nominal_scale(self) -> np.ndarray | None:
        """How uncertain ``nominal`` is when every body's mass distribution is so by its own size (r,)."""
        links = self.document["nominal_links"]
        return None if links is None else natural_sizes(np.array(links), self.base.matrix)


def _entries(key: str, text: str) -> Any:
    """A property: what each estimator made of the data."""
    return property(lambda loaded: tuple(map(loaded._entry, loaded.document[key])), doc=text)


@dataclass(frozen=True, eq=False, repr=False)
class LoadedComparison(HasEntries, Loaded):
    """What `bayesid.compare` found, read back: estimates by name, errors of their predictions."""

    report = "comparison"

    entries = _entries("methods", "One for each estimator, in the order asked for.")
    baselines = _entries("baselines", "The nominal model, predicted without a fit, and with its effects fitted.")

    @property
    def reference(self) -> str | None:
        """Name of the estimator in whose standard deviations differences are counted."""
        return self.document["agreement"]["reference"]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the base parameters (r,)."""
        return next(iter(self.estimates.values())).names

    def _entry(self, d: Mapping[str, Any]) -> Entry:
        links, impossible = d.get("link_parameters"), d.get("impossible_bodies")
        return Entry(
            name=d["name"], description=d.get("description", ""),
            estimate=_estimate({**self.document, **d}, d["effects"]) if "method" in d else None, refusal=d.get("reason", ""),
            seconds=self.document["runtime_s"]["methods"].get(d["name"], 0.0), links=None if links is None else np.array(links),
            impossible=None if impossible is None else tuple(impossible), fitted=_predictions(d.get("fit", ()), fitted=True),
            validation=_predictions(d.get("validation", ())),
        )  # fmt: skip


@dataclass(frozen=True, eq=False, repr=False)
class LoadedPosterior(HasParameters, _WithParameters, _WithModel):
    """What `bayesid.sample` found, read back: draws of ``posterior.nc``, summaries of ``posterior.json``."""

    report = "posterior"

    def to_arviz(self) -> Any:
        """InferenceData (ArviZ 0.x) or DataTree (1.x) of ``posterior.nc``.

        Raises
        ------
        InputError
            The file is not there.
        """
        path = self.path.with_name(DRAWS) if self.path.suffix == ".json" else self.path
        if not path.is_file():
            raise InputError(f"{path}: no such file, and the draws are in it; sample again")
        return load_arviz().from_netcdf(str(path))

    def to_xarray(self) -> Dataset:
        """The draws as an xarray Dataset: ``base`` (chain, draw, base_parameter) and what else was sampled; as in `to_arviz`."""
        return as_dataset(self._group)

    @cached_property
    def _group(self) -> Any:
        return self.to_arviz()["posterior"]

    @property
    def physical(self) -> bool:
        """Whether the draws are of links that can exist."""
        return "bodies that can exist only" in self.document["prior"]

    @property
    def base_draws(self) -> np.ndarray:
        """Draws of the base parameters (chains, draws, r)."""
        return self._drawn("base")

    @property
    def effect_draws(self) -> np.ndarray:
        """Draws of the effect parameters (chains, draws, e)."""
        return self._drawn("effect") if "effect" in self._group else self.base_draws[..., :0]

    @property
    def own_effect_draws(self) -> np.ndarray:
        """Draws of the effect parameters, as `bayesid.results.posterior.ExperimentPosterior.own_effect_draws`."""
        return _own_effects(self._group) if "effect" in self._group else self.effect_draws

    @property
    def link_draws(self) -> np.ndarray | None:
        """Draws of the link parameters (chains, draws, P); None with a flat prior."""
        return self._drawn("link") if "link" in self._group else None

    def _drawn(self, name: str) -> np.ndarray:
        return np.asarray(self._group[name].values, float)

    @property
    def covariance(self) -> np.ndarray:
        """Posterior covariance of the base parameters (r, r)."""
        return np.array(self.document["covariance"])

    @property
    def base(self) -> BaseParameters:
        """What the base parameters are combinations of."""
        self._held("base_map", "base")
        return _base(self.document)

    @property
    def classes(self) -> tuple[str, ...]:
        """``alone``, ``combination`` or, where the prior decides, ``prior`` for each base parameter."""
        return tuple(p["class"] for p in self.document["base_parameters"])

    def parameters(self, level: float = LEVEL) -> Parameters:
        """Base parameters, then effect parameters, with central intervals of a probability, from the draws.

        Raises
        ------
        InputError
            The level is no probability, or another than 0.95 and ``posterior.nc`` is not there.
        """
        found = _parameters([*self.document["base_parameters"], *self.document["effect_parameters"]], LEVEL)
        if level == LEVEL:
            return found
        low, high = np.quantile(np.concatenate([self.base_draws, self.own_effect_draws], axis=-1), tails(level), axis=(0, 1))
        if "sensor_offset" not in self._group:  # without links, the nominal ones say how much of an offset is weight
            weighed = np.array([name.startswith("sensor_offset@") for name in found.names], bool)
            low, high = np.where(weighed, central_interval(found.values, found.std, level), (low, high))
        return Parameters(found.names, found.labels, found.values, found.std, low, high, found.units, found.classes)

    def plot_marginals(self, *, ax: Any = None) -> Figure:
        """Draw the posterior of every base parameter; the prior is not in the file."""
        return figures_of(self)["marginals"](ax=ax)

    def plot_predictive(self, rows: str | None = None, *, channels: Sequence[str] | str | None = None, ax: Any = None) -> Figure:
        """Draw rows as measured over the 95 % of the readings that the posterior predicts; as `Posterior.plot_predictive`."""
        draws = self.to_arviz()
        predicted, measured = draws["posterior_predictive"], draws["observed_data"]
        chosen = predicted_rows(rows, list(predicted.data_vars))
        names = [str(name) for name in predicted["channel"].values]
        return figures_of(self)["predictive"](names, predicted[chosen].values, measured[chosen].values, channels, ax)


@dataclass(frozen=True, eq=False, repr=False)
class LoadedBounds(_WithParameters):
    """What `bayesid.bounds` found, read back: sets of the parameters of the joint torques, bounds of the workspace."""

    @property
    def covariance(self) -> np.ndarray:
        """Covariance V of the parameters (k, k)."""
        return np.array(self._torques["covariance"], float)

    @property
    def ellipsoid(self) -> float:
        """Radius rho_V of the ellipsoid ``(b - b_hat)' V^-1 (b - b_hat) <= rho_V^2``."""
        return self.document["rho_V"]

    def to_dataframe(self) -> DataFrame:
        """A row a parameter of the joint torques, as `ControllerBounds.to_dataframe`."""
        return _parameters(self._torques["parameters"], LEVEL).to_dataframe()

    @property
    def _entries(self) -> Sequence[Mapping[str, Any]]:
        return self._torques["parameters"]

    @property
    def _torques(self) -> Mapping[str, Any]:
        return self.document["joint_torques"]


_CLASSES: dict[str, type[Loaded]] = {
    "Identification": LoadedIdentification, "Comparison": LoadedComparison, "ExperimentPosterior": LoadedPosterior,
    "ControllerBounds": LoadedBounds,
}  # fmt: skip


@explains_types
def load(path: str | Path) -> Loaded:
    """The result of a verb, read back from what it wrote.

    Parameters
    ----------
    path
        The folder, or the JSON or NetCDF file in it.

    Returns
    -------
    loaded
        Prints as the result did and has its names, values, intervals and tables, and the figures that the file holds the numbers
        of; what needs the recording says so.

    Raises
    ------
    InputError
        There is no such file, or it is none that bayesid wrote.
    """
    path = Path(path)
    file = _file_in(path) if path.is_dir() else path
    if file.suffix == ".nc":
        beside = file.with_name("posterior.json")
        return LoadedPosterior("ExperimentPosterior", _of_draws(file), "", file) if not beside.is_file() else load(beside)
    if file.suffix != ".json":
        raise InputError(f"{file}: holds no result; name the folder, or its JSON or NetCDF file")
    try:
        document = json.loads(file.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{file}: {error.strerror or error}; name a folder that bayesid wrote") from None
    except (ValueError, RecursionError) as error:
        raise InputError(f"{file}: cannot be read as JSON ({error}); run the verb again") from None
    kind = document.get("result") if isinstance(document, dict) else None
    if kind is None or not {"schema", "experiment"} <= document.keys():
        raise InputError(f"{file}: is no document of bayesid; name one of {', '.join(DOCUMENTS)} as a verb wrote it")
    check_schema(document, str(file))
    printed = "\n".join(document.get("printed", ()))
    return _CLASSES.get(kind, Loaded)(kind, {k: v for k, v in document.items() if k not in BESIDE}, printed, file)


def _file_in(folder: Path) -> Path:
    """The document in a folder."""
    there = [name for name in DOCUMENTS if (folder / name).is_file()] or [DRAWS] * (folder / DRAWS).is_file()
    if len(there) == 1:
        return folder / there[0]
    if there:
        raise InputError(f"{folder}: holds {' and '.join(there)}; name one of them")
    if (folder / "experiment.toml").is_file():
        wrote = f"give the folder that a verb wrote, `{call('identify')}` for example"
        raise InputError(f"{folder}: is an experiment, no result; {wrote}")
    raise InputError(f"{folder}: holds no result of bayesid; name a folder that a verb wrote")


def _of_draws(file: Path) -> dict[str, Any]:
    """What the draws alone say, where ``posterior.json`` is not beside them."""
    if not file.is_file():
        raise InputError(f"{file}: no such file; name a folder that bayesid wrote")
    group = load_arviz().from_netcdf(str(file))["posterior"]
    if "base" not in group:
        raise InputError(f"{file}: is no posterior of bayesid; name one as sample wrote it")

    def entries(variable: str) -> list[dict[str, Any]]:
        if variable not in group:
            return []
        array = group[variable]
        short = [str(n) for n in array.coords[array.dims[-1]].values]
        # NetCDF gives a list of one text back as that text.
        names = [str(n) for n in np.atleast_1d(group.attrs["base_parameters"])] if variable == "base" else short
        draws = (_own_effects(group) if variable == "effect" else np.asarray(array.values, float)).reshape(-1, len(names))
        low, high = np.quantile(draws, tails(), axis=0)
        columns = zip(names, short, draws.mean(axis=0), draws.std(axis=0, ddof=1), low, high, strict=True)
        return [
            {"name": n, "label": label, "unit": "", "class": "effect" if variable == "effect" else "",
             "value": float(v), "std": float(s), "low": float(lo), "high": float(hi)}
            for n, label, v, s, lo, hi in columns
        ]  # fmt: skip

    draws = np.asarray(group["base"].values, float)
    return {
        **{key: value for key, value in group.attrs.items() if isinstance(value, (str, int, float))},
        "experiment": None, "base_parameters": entries("base"), "effect_parameters": entries("effect"),
        "covariance": moments(draws)[2].tolist(),
    }  # fmt: skip


def _own_effects(group: Any) -> np.ndarray:
    """Draws of the effect parameters (chains, draws, e) of a group of ``posterior.nc``, as `LoadedPosterior.own_effect_draws`."""
    draws = np.array(group["effect"].values, float)
    if "sensor_offset" in group:
        own = group["sensor_offset"]
        names = [str(name) for name in group["effect_parameter"].values]
        draws[..., [names.index(f"sensor_offset@sensor.{axis}") for axis in own["axis"].values]] = own.values
    error = group.attrs.get(EXPECTED_ERROR)
    return without_expected_error(draws, None if error is None else np.atleast_1d(error))


def _base(document: Mapping[str, Any]) -> BaseParameters:
    listed, matrix = document["base_parameters"], np.array(document["base_map"], float)
    behind = tuple(document["link_parameter_names"])
    names, labels, units = (tuple(p[key] for p in listed) for key in ("name", "label", "unit"))
    independent = []
    for row, name in zip(np.eye(len(listed)), names, strict=True):
        alike = np.flatnonzero((matrix == row[:, None]).all(axis=0)).tolist()
        independent.append(next((j for j in alike if name.startswith(behind[j])), alike[0]))
    absorbed = document.get("weight_in_offset")
    absorbed = None if absorbed is None else np.array(absorbed, float)
    return BaseParameters(matrix, np.array(independent, int), behind, names, labels, units, absorbed)


def _estimate(d: Mapping[str, Any], effects: Sequence[Mapping[str, Any]]) -> Estimate:
    """The estimate of a document, but for the noise that it was weighted with."""
    listed = [*d["base_parameters"], *effects]
    rank = len(d["base_parameters"])
    said = d["details"]
    own = {k: v for k, v in said.items() if k not in {f.name for f in fields(Details)}}
    details = CustomDetails(
        entries=own, model_complete=said.get("model_complete"), agreement_of_gls_and_wls=said.get("agreement_of_gls_and_wls"),
        dispersion=said.get("dispersion"), dispersion_by_channel=said.get("dispersion_by_channel"),
        warnings=tuple(said.get("warnings", ())),
    )  # fmt: skip
    values, std = _numbers(listed, "value"), _numbers(listed, "std")
    covariance = None if d["full_covariance"] is None else np.array(d["full_covariance"], float)
    expected, held = (None if d.get(key) is None else np.array(d[key], float) for key in ("expected_error", "held_covariance"))
    kinds = [p["class"] for p in d["base_parameters"]]
    unknown = covariance is not None and np.isnan(std[rank:])
    number = {k: np.nan if v is None else v for k, v in (("condition", d["condition_number"]), *d["residual"].items())}
    return Estimate(
        method=d["method"], base=_base(d), effect_names=tuple(p["name"] for p in effects),
        effect_units=tuple(p["unit"] for p in effects), solution=values if expected is None else values + expected,
        full_covariance=covariance,
        undetermined=np.append(np.array(kinds) == "prior", np.broadcast_to(unknown, len(effects))).astype(bool),
        weak=np.array([*(k == "weak" for k in kinds), *(False for _ in effects)], bool), interval=d["interval"], noise={},
        rows=d["residual"]["rows"], condition_number=number["condition"], residual_rms=number["whitened_rms"],
        whiteness=number["whiteness"], interval_reason=d.get("interval_reason", ""), details=details,
        possible=_possible(listed), expected_error=expected, held_covariance=held,
    )  # fmt: skip


def _parameters(listed: Sequence[Mapping[str, Any]], level: float) -> Parameters:
    values, std = _numbers(listed, "value"), _numbers(listed, "std")
    ends = _numbers(listed, "low"), _numbers(listed, "high")
    if level != LEVEL:
        ends = central_interval(values, std, level, _possible(listed))
    names, labels, units, kinds = ([p[key] for p in listed] for key in ("name", "label", "unit", "class"))
    return Parameters(names, labels, values, std, *ends, units, kinds)


def _possible(listed: Sequence[Mapping[str, Any]]) -> np.ndarray:
    """Where intervals were cut off (2, p), as nothing beyond is possible."""
    values, std = _numbers(listed, "value"), _numbers(listed, "std")
    low, high = central_interval(values, std)
    slack = 1e-9 * (np.abs(values) + std)
    own = _numbers(listed, "low"), _numbers(listed, "high")
    return np.array([np.where(own[0] > low + slack, own[0], -np.inf), np.where(own[1] < high - slack, own[1], np.inf)])


def _numbers(listed: Sequence[Mapping[str, Any]], key: str) -> np.ndarray:
    return np.array([p[key] for p in listed], float)


def _predictions(listed: Sequence[Mapping[str, Any]], *, fitted: bool = False) -> tuple[Prediction, ...]:
    """Errors of predictions; the samples are not in the file."""
    out = []
    for d in listed:
        names = tuple(d["rmse"])
        none = np.empty((0, len(names)))
        rmse, rmse_raw, nrmse, nrmse_raw, whitened = (
            np.array(list(d[key].values()), float)
            for key in ("rmse", "rmse_raw", "nrmse", "nrmse_raw", "whitened_rms_by_channel")
        )
        out.append(
            Prediction(
                d["motion"], d["role"], names, ("",) * len(names), none[:, 0], none, none, rmse, rmse_raw, nrmse, nrmse_raw,
                d["whitened_rms"], whitened, d["interval_coverage"], d["expected_rms"], d["noise_source"], d["repeats"],
                flexible=None if (gap := d.get("flexible_model")) is None else FlexibleGap(gap["removed"], gap["std"]),
                fitted=fitted, largest_rms=d.get("largest_rms"),
            )
        )  # fmt: skip
    return tuple(out)
