"""What comparisons share, whether they were just made or read from their file."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, Protocol

from bayesid.errors import InputError
from bayesid.estimators import Estimate
from bayesid.results.entry import Entry, equal_estimates

if TYPE_CHECKING:
    from pandas import DataFrame


class _Holder(Protocol):
    @property
    def entries(self) -> tuple[Entry, ...]: ...

    @property
    def baselines(self) -> tuple[Entry, ...]: ...

    @property
    def estimates(self) -> dict[str, Estimate]: ...


class HasEntries:
    """Estimates by name and their tables, from ``entries`` and ``baselines``."""

    @property
    def estimates(self: _Holder) -> dict[str, Estimate]:
        """Estimates by the names of their estimators, without those that refused."""
        return {e.name: e.estimate for e in self.entries if e.estimate is not None}

    def same_as(self: _Holder, name: str) -> tuple[str, ...]:
        """Names of the other estimators whose values and covariance equal those of this one to the last digit."""
        return tuple(n for names in equal_estimates(self.entries) if name in names for n in names if n != name)

    def __getitem__(self: _Holder, name: str) -> Estimate:
        """The estimate of a name.

        Raises
        ------
        KeyError
            No estimator of that name took part, or it refused; the message says why.
        """
        if name not in self.estimates:
            refused = [e.refusal for e in self.entries if e.name == name]
            raise KeyError(f"{name} refused: {refused[0]}" if refused else f"{name}; there are {', '.join(self.estimates)}")
        return self.estimates[name]

    def to_dataframe(self: _Holder, of: Literal["parameters", "scores"] = "parameters") -> DataFrame:
        """Tables of what was compared.

        Parameters
        ----------
        of
            ``parameters``: those of all estimators below each other, ``method`` and then the columns of
            `Estimate.to_dataframe`. ``scores``: a row an estimator and motion, the nominal model's first: ``method``,
            ``motion``, ``role``, ``relative_error`` (all channels together, in the band), ``relative_error_raw``,
            ``whitened_rms``, ``expected_rms``, ``coverage`` and ``nrmse_fx`` ... by channel.

        Raises
        ------
        InputError
            It is neither.
        """
        from pandas import DataFrame, concat

        if of == "scores":
            entries = [e for e in (*self.baselines, *self.entries) if not e.refusal]
            return DataFrame(
                {
                    "method": e.name, "motion": p.motion, "role": p.role, "relative_error": p.relative_error,
                    "relative_error_raw": p.relative_error_raw, "whitened_rms": p.whitened_rms, "expected_rms": p.expected_rms,
                    "coverage": p.coverage, **{f"nrmse_{n}": v for n, v in zip(p.channel_names, p.nrmse, strict=True)},
                }
                for e in entries for p in (*e.fitted, *e.validation)
            )  # fmt: skip
        if of != "parameters":
            raise InputError(f"of = {of!r}: give 'parameters' or 'scores'")
        tables = {name: e.to_dataframe() for name, e in self.estimates.items()}
        return concat(tables, names=["method"]).reset_index(level="method").reset_index(drop=True)
