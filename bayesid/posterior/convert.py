"""Draws as ArviZ keeps them: InferenceData before version 1, a DataTree since."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np


@dataclass(frozen=True, eq=False)
class Groups:
    """Named groups of arrays."""

    arrays: dict[str, dict[str, np.ndarray]] = field(default_factory=dict)  # by variable by group
    coordinates: dict[str, Any] = field(default_factory=dict)  # labels of every dimension
    dimensions: dict[str, list[str]] = field(default_factory=dict)  # of every variable, beyond chains and draws


def load_arviz() -> Any:
    """ArviZ, imported only when needed: that takes seconds, and version 0.23 announces the next one once a day."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=r"\s*ArviZ is undergoing", category=FutureWarning)
        import arviz
    return arviz


def before_trees(az: Any) -> bool:
    """Whether this ArviZ has InferenceData of its own; from version 1 on it is xarray's DataTree."""
    return int(az.__version__.partition(".")[0]) < 1


def as_dataset(group: Any) -> Any:
    """A group as an xarray Dataset, whichever ArviZ it is of."""
    return group.to_dataset() if hasattr(group, "to_dataset") else group


def to_arviz(
    groups: dict[str, dict[str, np.ndarray]],
    coordinates: dict[str, Any],
    dimensions: dict[str, list[str]],
    attributes: dict[str, Any],
) -> Any:
    """InferenceData or DataTree of arrays by variable by group, with labels of every dimension and attributes of the posterior.

    Chains and draws are first, but in ``observed_data``; ``dimensions`` are the further ones of every variable.
    """
    az = load_arviz()
    if before_trees(az):
        used = {name for arrays in groups.values() for name in arrays}
        return az.from_dict(
            **groups, coords=coordinates, dims={k: v for k, v in dimensions.items() if k in used}, posterior_attrs=attributes
        )
    tree = az.from_dict(groups, coords=coordinates, dims=dimensions)
    tree["posterior"].attrs.update(attributes)
    return tree


def write_netcdf(data: Any, path: Path) -> None:
    """Write what `to_arviz` made as NetCDF, compressed."""
    az = load_arviz()
    if before_trees(az):
        data.to_netcdf(str(path), engine="h5netcdf")
        return
    packed = {
        f"/{group}": {name: {"zlib": True, "complevel": 4} for name, array in node.data_vars.items() if array.ndim}
        for group, node in data.children.items()
    }
    data.to_netcdf(path, engine="h5netcdf", encoding=packed)
