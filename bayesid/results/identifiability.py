"""What ``identifiability`` found."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from bayesid.design.findings import Findings
from bayesid.design.identifiability import SetReport
from bayesid.design.visibility import WORDS, LinkExpectation
from bayesid.drawing import figures_of
from bayesid.posterior.result import PRIOR_DRIVEN
from bayesid.results.files import Result, strict
from bayesid.results.identifiability_text import as_html, as_text, counts

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SCHEMA = 1


@dataclass(frozen=True, eq=False, repr=False)
class Identifiability(Findings, Result):
    """What motions can and cannot determine, for each sensor set."""

    verb = "identifiability"

    def __repr__(self) -> str:
        return f"<Identifiability of {self.name}: rank {self.main.rank} from {self.main.sensor_set.title}>"

    def __str__(self) -> str:
        return as_text(self)

    def _repr_html_(self) -> str:
        return as_html(self)

    def __getitem__(self, name: str) -> SetReport:
        """The report of a sensor set, ``torque`` for example."""
        return {r.sensor_set.name: r for r in self.sensor_sets}[name]

    def plot_classes(self, *, ax: Any = None) -> Figure:
        """Draw every link parameter's class, a panel (and one of the axes given) for each sensor set."""
        return figures_of(self)["classes"](ax=ax)

    def plot_expected(self, *, ax: Any = None) -> Figure:
        """Draw the expected standard deviation of every combination over its size, for the readings that would be used."""
        return figures_of(self)["expected"](ax=ax)

    def to_dict(self) -> dict[str, Any]:
        """``identifiability.json``."""
        return strict({
            "schema": SCHEMA,
            "experiment": self.name,
            "source": self.source,
            "motions": [{"name": n, "duration": d} for n, d in self.motions.items()],
            "still_joints": list(self.still),
            "default_sensor_set": self.main.sensor_set.name,
            "classes": WORDS,
            "sensor_sets": [_set(r) for r in self.sensor_sets],
            "advice": [{"about": a.about, "text": a.text, "gain": a.gain} for a in self.advice],
            "tell": [
                {"sensor_set": name, "pairs": [asdict(pair) for pair in pairs]} for name, pairs in self.separations.items()
            ],
            "warnings": list(self.warnings),
            "runtime_s": self.seconds,
        })  # fmt: skip


def own_std(link: LinkExpectation, report: SetReport) -> float | None:
    """Expected standard deviation of a parameter that is identified alone, or of the combination it is most of; None without."""
    return report.base_parameters[link.combinations[0]].std if link.combinations else None


def _set(report: SetReport) -> dict[str, Any]:
    bases = report.base_parameters
    return {
        "name": report.sensor_set.name,
        "title": report.sensor_set.title,
        "recorded": report.recorded,
        "noise": report.noise,
        "noise_std": report.noise_std,
        "rank": report.rank,
        "rank_of_any_motion": report.rank_of_any_motion,
        "better_than_size": report.well_known,
        "condition_number": report.condition_number,
        "parameters": [_link(link, report) for link in report.parameters],
        "parameters_by_class": dict(counts(report)),
        "base_parameters": [
            {"name": b.name, "label": b.label, "unit": b.unit, "class": b.kind, "expected_std": b.std, "size": b.size,
             "relative_std": None if not b.size else b.std / b.size, "prior_share": b.prior_share,
             "prior_driven": None if b.prior_share is None else b.prior_share > PRIOR_DRIVEN}
            for b in bases
        ],
        "not_excited": list(report.unexcited),
        "effects": [{"name": e.name, "unit": e.unit, "expected_std": e.std} for e in report.effects],
        "covariance": report.shown.covariance,
    }  # fmt: skip


def _link(link: LinkExpectation, report: SetReport) -> dict[str, Any]:
    inside = [report.base_parameters[k] for k in link.combinations]
    return {
        "name": link.name, "class": link.kind, "text": WORDS[link.kind],
        "combination": inside[0].label if inside else None, "combinations": [b.name for b in inside],
        "expected_std": own_std(link, report), "class_of_any_motion": link.of_any_motion,
        "shown_by_moving": list(link.joints), "shown_by_sensor_sets": list(link.sensor_sets),
    }  # fmt: skip
