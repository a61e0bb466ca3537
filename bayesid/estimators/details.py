"""What an estimator says of its own work beyond the estimate: one class for each family, all with the same beginning."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, is_dataclass
from typing import Any

#: Marks a field that ``to_dict`` leaves out while it is None.
OPTIONAL = {"optional": True}


@dataclass(frozen=True, kw_only=True)
class Details:
    """What every estimator says.

    Attributes
    ----------
    model_complete
        Whether generalised and channel-weighted least squares agree, so that residuals are noise alone; None: not tested.
    agreement_of_gls_and_wls
        Probability of a difference as large as theirs when the model is complete.
    dispersion
        Factor that covariances have for model error: how much more the fit scatters between parts of the recording
        than noise explains; 1 where noise does.
    dispersion_by_channel
        That of each channel's readings, of which the former is the mean; None where the model is complete, or noise explains it.
    warnings
        What the user should know before using the estimate.
    """

    model_complete: bool | None = field(default=None, metadata=OPTIONAL)
    agreement_of_gls_and_wls: float | None = field(default=None, metadata=OPTIONAL)
    dispersion: float | None = field(default=None, metadata=OPTIONAL)
    dispersion_by_channel: Mapping[str, float] | None = field(default=None, metadata=OPTIONAL)
    warnings: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Plain values, as in ``estimate.json``; warnings only where there are any."""
        out = as_plain(self)
        if not self.warnings:
            del out["warnings"]
        return out


@dataclass(frozen=True, kw_only=True)
class CustomDetails(Details):
    """Details of an estimator of one's own, by name.

    Attributes
    ----------
    entries
        Plain values.
    """

    entries: Mapping[str, Any]

    def to_dict(self) -> dict[str, Any]:
        """The entries, after what every estimator says."""
        out = super().to_dict()
        entries = out.pop("entries")
        return {**out, **entries}


def as_plain(value: Any) -> Any:
    """Dataclasses and mappings as dictionaries, tuples as lists; a class with another ``to_dict`` decides for itself."""
    if is_dataclass(value) and not isinstance(value, type):
        out = {}
        for f in fields(value):
            entry = getattr(value, f.name)
            if entry is not None or not f.metadata.get("optional"):
                own = getattr(entry, "to_dict", None)
                out[f.metadata.get("key", f.name)] = as_plain(entry) if own is None else own()
        return out
    if isinstance(value, Mapping):
        return {key: as_plain(entry) for key, entry in value.items()}
    if isinstance(value, tuple | list):
        return [as_plain(entry) for entry in value]
    return value
