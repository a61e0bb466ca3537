"""The verb ``diagnose`` with a reference: what changed since a recording of the robot in its known state."""

from __future__ import annotations

import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from bayesid.diagnosis.changes.findings import compare_with_reference
from bayesid.diagnosis.settings import Settings
from bayesid.drawing import Figures, figures_of
from bayesid.recordings.experiment import Experiment, as_experiment
from bayesid.recordings.schema import write_model
from bayesid.regression.parallel import one_blas_thread
from bayesid.results.changes import Changes
from bayesid.results.files import Files, files_of, strict
from bayesid.workflows.progress import Progress


def changes(
    after: Experiment | str | Path,
    before: Experiment | str | Path,
    channel: str | None,
    motions: Sequence[str] | None,
    effects: Sequence[str] | None,
    seed: int,
    settings: Settings,
    progress: Progress,
) -> Changes:
    """What changed; parameters and errors as in `bayesid.diagnose`."""
    since = time.perf_counter()
    with one_blas_thread():
        progress("reading")
        after, before = as_experiment(after), as_experiment(before)
        progress("what changed since the reference")
        found = compare_with_reference(before, after, channel, effects=effects, motions=motions, seed=seed, settings=settings)
    return Changes(found, time.perf_counter() - since)


@figures_of.register
def _(result: Changes) -> Figures:
    from bayesid.report.changes import evidence_figure

    return {"evidence": partial(evidence_figure, result)}


@files_of.register
def _(result: Changes) -> Files:
    """``diagnosis.json``, ``model.toml`` and the report."""
    from bayesid.report.changes import changes_report

    effects, values = result.model
    expressions = result.experiment.library.expressions
    others = {"model.toml": lambda path: write_model(effects, values, path, expressions)}
    return Files({"diagnosis.json": strict(result.to_dict())}, others, changes_report(result))
