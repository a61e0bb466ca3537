"""What ``diagnose`` found, and how it shows itself."""

from __future__ import annotations

from bayesid.results.diagnosis_text import notebook, summary
from bayesid.results.files import Result
from bayesid.results.findings import Findings


class Diagnosis(Findings, Result):
    """What `diagnose` found: `Findings` that can be printed and written."""

    verb = "diagnose"

    def __repr__(self) -> str:
        named = f": {', '.join(f.term.effect.spec for f in self.found)}" if self.found else ""
        return f"<Diagnosis of {self.data.experiment.name}: {self.verdict}{named}>"

    def __str__(self) -> str:
        """A few lines: the verdict, values, the gap, where it disagrees."""
        return summary(self)

    def _repr_html_(self) -> str:
        """The same for notebooks."""
        return notebook(self)
