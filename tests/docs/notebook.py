"""Pages as notebooks: their Python blocks as cells, run by IPython without a browser or a kernel process."""

from __future__ import annotations

import base64
import contextlib
import io
import json
from pathlib import Path
from typing import Any

from IPython.core.displayhook import DisplayHook
from IPython.core.displaypub import CapturingDisplayPublisher
from IPython.core.interactiveshell import InteractiveShell
from traitlets.config import Config


class _Shown(DisplayHook):
    """Keeps what the last line of a cell shows, in every form that a notebook would ask for."""

    def write_format_data(self, format_dict: dict[str, Any], md_dict: dict[str, Any] | None = None) -> None:
        self.shell.display_pub.publish(format_dict, md_dict)

    def write_output_prompt(self) -> None:
        """Print no prompt."""

    def finish_displayhook(self) -> None:
        """Print no line after it."""
        self._is_active = False


class Notebook:
    """Cells run one after the other in one namespace, with what each of them shows.

    No inline backend is switched on: what is shown shows itself.
    """

    def __init__(self, folder: Path) -> None:
        config = Config({"HistoryManager": {"enabled": False}})
        self.shell = InteractiveShell(
            config=config, ipython_dir=str(folder), displayhook_class=_Shown, display_pub_class=CapturingDisplayPublisher
        )
        self.cells: list[dict[str, Any]] = []

    @property
    def scope(self) -> dict[str, Any]:
        """Names of the notebook."""
        return self.shell.user_ns

    def run(self, code: str) -> dict[str, Any]:
        """Run a cell as Shift-Enter does; whatever it raises is raised here."""
        shown, printed = self.shell.display_pub.outputs, io.StringIO()
        shown.clear()
        with contextlib.redirect_stdout(printed):
            done = self.shell.run_cell(code)
        done.raise_error()
        outputs: list[dict[str, Any]] = []
        if printed.getvalue():
            outputs.append({"output_type": "stream", "name": "stdout", "text": printed.getvalue()})
        for output in shown:
            data = {k: base64.b64encode(v).decode() if isinstance(v, bytes) else v for k, v in output["data"].items()}
            outputs.append({"output_type": "display_data", "data": data, "metadata": output["metadata"] or {}})
        cell = {"cell_type": "code", "execution_count": len(self.cells) + 1, "metadata": {}, "source": code, "outputs": outputs}
        self.cells.append(cell)
        return cell

    @property
    def images(self) -> list[bytes]:
        """Every figure that was shown."""
        shown = (output.get("data", {}) for cell in self.cells for output in cell["outputs"])
        return [base64.b64decode(data["image/png"]) for data in shown if "image/png" in data]

    def write(self, path: Path) -> None:
        """Write an ``.ipynb``."""
        document = {"cells": self.cells, "metadata": {"language_info": {"name": "python"}}, "nbformat": 4, "nbformat_minor": 4}
        path.write_text(json.dumps(document), encoding="utf-8")
