"""What ``diagnose`` found, and how it shows itself."""

from __future__ import annotations

from bayesid.results.diagnosis_text import lines_of, notebook_parts
from bayesid.results.files import ShownResult
from bayesid.results.findings import Findings
from bayesid.section import as_html


class Diagnosis(Findings, ShownResult):
    """What `diagnose` found: `Findings` that can be printed and written."""

    verb = "diagnose"

    def __repr__(self) -> str:
        named = f": {', '.join(f.term.effect.spec for f in self.found)}" if self.found else ""
        return f"<Diagnosis of {self.data.experiment.name}: {self.verdict}{named}>"

    def _parts(self) -> list[str]:
        return lines_of(self)

    def _repr_html_(self) -> str:
        """The same for notebooks, values as a table."""
        return as_html(notebook_parts(self))
