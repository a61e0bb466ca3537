"""What ``diagnose --reference`` found, and how it shows itself."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from bayesid.diagnosis.changes.findings import Change, Comparison
from bayesid.diagnosis.changes.proof import Place
from bayesid.estimators.parameters import with_ends
from bayesid.recordings.experiment import Experiment
from bayesid.recordings.schema import EffectParameters
from bayesid.results.changes_text import next_experiment, notebook, summary, verdict_sentence
from bayesid.results.files import Result

SCHEMA = 1


@dataclass(frozen=True, eq=False)
class Changes(Result):
    """What `diagnose` found with a reference: the changes since then.

    Attributes
    ----------
    comparison
        Everything that was found.
    seconds
        Run time.
    """

    verb = "changes"
    comparison: Comparison
    seconds: float = 0.0

    @property
    def verdict(self) -> str:
        """``named``, ``named_in_part``, ``ambiguous``, ``unknown`` or ``nothing_missing``: nothing changed."""
        return self.comparison.verdict

    @property
    def experiment(self) -> Experiment:
        """The later recording."""
        return self.comparison.recording.problem.experiment

    @property
    def reference(self) -> str:
        """Folder of the reference, its name where it was made in memory."""
        before = self.comparison.reference.problem.experiment
        return before.name if before.folder is None else str(before.folder)

    @property
    def model(self) -> tuple[tuple[str, ...], EffectParameters]:
        """The reference's model with the named changes: effects that came are fixed, for links could take them up again."""
        c = self.comparison
        known = {t.effect.spec for t in c.terms if t.effect in c.reference.effects}
        values: EffectParameters = {spec: dict(given) for spec, given in self.experiment.effect_values.items()}
        for term in c.terms:
            spec = term.effect.spec
            fixed = spec not in known or values.get(spec, {}).get("fixed", False)
            found: dict[str, float | bool] = dict(zip(term.effect.parameters, term.values, strict=True))
            values[spec] = {**found, "fixed": True} if fixed else found
        return tuple(t.effect.spec for t in c.terms), values

    def __repr__(self) -> str:
        c = self.comparison
        named = f": {', '.join(x.change.spec for x in c.changes)}" if c.changes else ""
        return f"<Changes of {self.experiment.name} since {c.reference.problem.experiment.name}: {self.verdict}{named}>"

    def __str__(self) -> str:
        """A few lines: the verdict, values, the gap, what could hide."""
        return summary(self.comparison)

    def _repr_html_(self) -> str:
        """The same for notebooks."""
        return notebook(self.comparison)

    def to_dict(self) -> dict[str, Any]:
        """``diagnosis.json``."""
        c = self.comparison
        minimum = {h.change.spec: h.value for h in c.hidden}
        return {
            "schema": SCHEMA,
            "experiment": self.experiment.name,
            "reference": self.reference,
            "channel": c.recording.problem.channel,
            "verdict": c.verdict,
            "summary": verdict_sentence(c),
            "effects": [change_dict(x) for x in c.changes],
            "where": [self._place(p) for p in c.proof.places],
            "gap": self._gap(),
            "remainder": self._remainder(),
            "candidates": [
                {
                    "name": h.name, "where": h.where, "log_bayes_factor": e,
                    "minimum_detectable": _finite(minimum.get(h.spec, np.inf)),
                }
                for h, e in c.scores
            ],
            "identification": {
                "rows": len(c.recording.left), "rows_that_count_as_one": c.recording.correlation,
                "dispersion": c.selection.marginal().dispersion, "tolerance_factor": c.selection.factor,
                "bandwidth_hz": c.recording.problem.smoother.bandwidth,
            },
            "next_experiment": next_experiment(c),
            "runtime_s": self.seconds,
        }  # fmt: skip

    def _gap(self) -> dict[str, Any]:
        p = self.comparison.proof
        after = p.after if self.comparison.changes else p.tolerance
        steps = [{"name": a.change.spec, "after": float(np.sqrt(m))}
                 for a, m in zip(self.comparison.selection.accepted, p.changes, strict=True)]  # fmt: skip
        return {
            "metric": f"rms on {p.stretches} stretches held out in turn, over what the recording's own fit leaves",
            "before": float(np.sqrt(p.reference)), "after": float(np.sqrt(after)), "floor": float(np.sqrt(p.floor)),
            "closed": _finite(p.closed), "closed_low": _finite(p.closed_low),
            "steps": steps, "tolerance_alone": float(np.sqrt(p.tolerance)),
        }  # fmt: skip

    def _remainder(self) -> dict[str, Any]:
        c = self.comparison
        left = sorted(c.proof.places, key=lambda p: -p.after)
        return {"share": c.proof.remainder, "where": [self._place(p) for p in left[:4]], "described_by": c.described_by}

    def _place(self, place: Place) -> dict[str, Any]:
        problem = self.comparison.recording.problem
        channel = problem.row_model.channels.names[place.channel]
        joint = f"joint{channel[3:]}" if channel.startswith("tau") else None
        return {
            "channel": channel, "motion": problem.regression.motion_names[place.motion], "start": place.start,
            "end": place.end, "joint": joint, "band_hz": [0.0, problem.smoother.bandwidth],
            "before": place.before, "after": place.after,
        }  # fmt: skip


def change_dict(x: Change) -> dict[str, Any]:
    """An entry of ``effects`` in ``diagnosis.json``."""
    lead = x.found.lead
    return {
        "name": x.change.name, "where": x.change.where, "probability": x.probability, "log_bayes_factor": x.found.evidence,
        "parameters": {v.name: {**with_ends(v.value, v.std, v.unit), "reference": v.before} for v in x.values},
        "derived": {v.name: with_ends(v.value, v.std, v.unit) for v in x.derived},
        "ambiguous_with": [{"name": h.name, "where": h.where} for h, _ in x.found.rivals],
        "next_best": None if lead is None else {"name": lead[0].name, "where": lead[0].where, "behind": lead[1]},
        "share": _finite(x.share), "share_low": _finite(x.share_low),
    }  # fmt: skip


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
