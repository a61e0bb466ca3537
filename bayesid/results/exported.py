"""What ``export`` made."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from bayesid.argument_types import explains_types
from bayesid.arguments import ByName, argument
from bayesid.errors import InputError
from bayesid.results.files import SCHEMA, WRITTEN, Files, ShownResult
from bayesid.rounding import channel_name
from bayesid.section import ShownTable


@dataclass(frozen=True, eq=False)
class Exported(ByName, ShownResult):
    """An identified robot in other tools' forms.

    Attributes
    ----------
    name, method, channel
        Of the experiment; how it was estimated, and from which readings.
    to
        The forms asked for.
    texts
        The files by name.
    about
        What each file is, by form.
    left_out
        Value and unit of what was identified and a form cannot hold, by form and name.
    warnings
        What the user should know.
    """

    verb, report = "export", "export"
    name: str
    method: str
    channel: str
    to: tuple[str, ...]
    texts: Mapping[str, str]
    about: Mapping[str, str]
    left_out: Mapping[str, Mapping[str, tuple[float, str]]] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()

    def __getitem__(self, name: str) -> str:
        """Text of a file."""
        return self.texts[name]

    @explains_types
    def write(self, folder: str | Path) -> Path:
        """Write the files, ``export.json`` and ``report.html``, all or none; returns the report's path.

        An `InputError` where the folder holds the result that they are from, or another: its report would be replaced.
        """
        for document in (WRITTEN[verb][0] for verb in ("identify", "sample")):
            if (Path(folder) / document).is_file():
                where = argument("folder", str(folder))
                raise InputError(f"{where}: holds {document}, whose report would be replaced; name another folder")
        return super().write(folder)

    def _beside(self) -> Files:
        return self.texts

    def __repr__(self) -> str:
        return f"<Exported {self.name}: {', '.join(self.to)}>"

    def _parts(self) -> list[str | ShownTable]:
        lines = [f"{self.name}, {self.method} from the {channel_name(self.channel)}:"]
        lines += [f"{form}: {text}" for form, text in self.about.items()]
        for form, values in self.left_out.items():
            count = Counter(name.partition("@")[0] for name in values)
            left_out = ", ".join(f"{name} ({number})" for name, number in count.items())
            lines += [f"not in {form}: {left_out}; values in export.json"] if left_out else []
        return [*lines, *(f"warning: {text}" for text in self.warnings)]

    def to_dict(self) -> dict[str, Any]:
        """What ``export.json`` holds."""
        return {
            "schema": SCHEMA, "experiment": self.name, "method": self.method, "channel": self.channel,
            "to": list(self.to), "about": dict(self.about),
            "not_held": {
                form: {name: {"value": value, "unit": unit} for name, (value, unit) in values.items()}
                for form, values in self.left_out.items()
            },
            "warnings": list(self.warnings),
        }  # fmt: skip
