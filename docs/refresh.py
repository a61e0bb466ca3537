"""Renew what the README shows of the demo: its printed output and the picture. Run from anywhere."""

from __future__ import annotations

import contextlib
import io
import os
import re
import tempfile
from pathlib import Path

import bayesid
from bayesid.cli import main
from bayesid.report.fit_figures import measured_against_predicted
from bayesid.workflows.demo import demo_experiment

DOCS = Path(__file__).resolve().parent
README = DOCS.parent / "README.md"


def refresh() -> None:
    """Run the demo twice: by command for its output, in Python for the picture."""
    printed = io.StringIO()
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        with contextlib.redirect_stdout(printed):
            if main(["demo"]):
                raise SystemExit("the demo failed")
        result = bayesid.identify(demo_experiment(Path(folder)))
    figure = measured_against_predicted(result.validation[0])
    figure.savefig(DOCS / "demo-validation.png", dpi=100, facecolor="white", metadata={"Software": None})
    shown = f"```text\n{printed.getvalue().replace(os.sep, '/')}```\n"
    text = re.sub(r"```text\n.*?```\n", lambda _: shown, README.read_text(encoding="utf-8"), count=1, flags=re.DOTALL)
    README.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    refresh()
