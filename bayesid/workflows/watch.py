"""The verb ``watch``: a series of recordings against one reference."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from math import log
from pathlib import Path

from bayesid.diagnosis.changes.findings import compare_with_learned
from bayesid.diagnosis.changes.reference import Reference, learn_reference
from bayesid.diagnosis.settings import DEFAULT, Settings
from bayesid.errors import BayesidError, InputError
from bayesid.estimators import Estimate
from bayesid.estimators.nonlinear import default_method, solve
from bayesid.recordings.experiment import Experiment, as_experiment
from bayesid.regression.options import FitOptions, some_options
from bayesid.regression.parallel import one_blas_thread
from bayesid.regression.problem import Problem, prepare
from bayesid.results.changes import Watch, Watched
from bayesid.tasks import cluster, map_tasks
from bayesid.validation.prediction import Prediction, predict_elsewhere
from bayesid.workflows.progress import SHOWN, Progress, quiet, shows_progress
from bayesid.workflows.warnings import lacking_reference, of_recordings, of_reference


@shows_progress
def watch(
    reference: Experiment | str | Path,
    recordings: Experiment | str | Path | Sequence[Experiment | str | Path],
    channel: str | None = None,
    *,
    options: FitOptions | None = None,
    motions: str | Sequence[str] | None = None,
    effects: str | Sequence[str] | None = None,
    seed: int = 0,
    settings: Settings | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    progress: Progress | None = SHOWN,
    tell: Callable[[Watched], object] = lambda _: None,
) -> Watch:
    """Compare recordings of a robot with one of its known state: what changed, and when.

    Parameters
    ----------
    reference, recordings
        Loaded, or their folders; recordings in the order of time, or a single one.
    channel, options, motions, effects, seed, settings, progress
        As for `bayesid.diagnose` with a reference.
    workers, scheduler
        Processes on this machine that share the recordings, or the address of a Dask cluster that does; the result depends on
        neither.
    tell
        Called with every recording as soon as it is compared.

    Returns
    -------
    watch
        One entry a recording. One that cannot be compared has the complaint instead; Ctrl-C ends the series with what there is.

    Raises
    ------
    InputError
        There are no recordings, one cannot be read, the reference cannot be fitted, or none could be compared.

    Notes
    -----
    A Bayes factor of B is reached with a probability of at most 1 / B where nothing changed. So that the series as a whole names
    falsely as rarely as a single recording does, each of n recordings has to bring log(n) more in log evidence (Bonferroni).
    """
    since = time.perf_counter()
    chosen = some_options("watch", options, channel=channel, motions=motions, effects=effects)
    settings, progress = settings or DEFAULT, progress or quiet
    progress("reading")
    before = as_experiment(reference)
    series = [as_experiment(r) for r in ([recordings] if isinstance(recordings, (Experiment, str, Path)) else recordings)]
    if not series:
        raise InputError("watch: there are no recordings; name at least one folder after the reference")
    accept = settings.accept + log(len(series))
    done: list[Watched] = []
    with one_blas_thread(), cluster(workers, scheduler):
        progress("reference")
        learn = _Learned(before, chosen)
        learn()
        named = list(zip(_names(series), series, strict=True))
        compared = partial(_compared, learn, chosen.motions, seed, replace(settings, accept=accept))
        try:
            progress(f"recording 1 of {len(series)}: {named[0][0]}")
            for k, recording in enumerate(map_tasks(compared, named), 1):
                done.append(recording)
                tell(recording)
                if k < len(series):
                    progress(f"recording {k + 1} of {len(series)}: {named[k][0]}")
        except KeyboardInterrupt:
            if not done:
                raise
    if all(w.comparison is None for w in done):
        raise InputError(f"none of the recordings could be compared; the first, {done[0].name}: {done[0].complaint}")
    folder = None if before.folder is None else str(before.folder)
    said = {text for w in done for text in w.warnings}
    warnings = (*lacking_reference(learn().problem), *of_reference(before, said))
    return Watch(before.name, folder, tuple(done), accept, len(series), time.perf_counter() - since, warnings)


class _Learned:
    """What the reference says at its own bandwidth or others, found once a process."""

    def __init__(self, before: Experiment, chosen: FitOptions):
        self._given = before, chosen
        self._found: dict[float | None, Reference] = {}
        self._fit: tuple[Problem, Estimate] | None = None

    def left(self, recording: Experiment) -> tuple[Prediction, ...]:
        """What a fit of the reference alone leaves of a recording's motions."""
        if self._fit is None:
            problem = prepare(self._given[0], replace(self._given[1], motions=None))
            self._fit = solve(problem, default_method(problem))
        return predict_elsewhere(*self._fit, recording)

    def __call__(self, bandwidth: float | None = None) -> Reference:
        if bandwidth not in self._found:
            before, chosen = self._given
            more = () if bandwidth is None else (bandwidth,)
            self._found[bandwidth] = learn_reference(before, chosen.channel, chosen.effects, *more)
        return self._found[bandwidth]

    def __reduce__(self):
        return _Learned, self._given


def _compared(
    learn: _Learned, motions: Sequence[str] | None, seed: int, settings: Settings, given: tuple[str, Experiment]
) -> Watched:
    """A recording compared with the reference, or why it cannot be."""
    name, after = given
    try:
        compared = compare_with_learned(learn, after, motions=motions, seed=seed, settings=settings)
    except BayesidError as error:
        return Watched(name, None, str(error), warnings=of_recordings(after, ()))
    try:
        left = tuple(p for p in learn.left(after) if motions is None or p.motion in motions)
    except BayesidError:  # too short for rows of their own
        left = ()
    return Watched(name, compared, left=left, warnings=of_recordings(after, (), [x.change.name for x in compared.changes]))


def _names(series: Sequence[Experiment]) -> list[str]:
    """Names of recordings; their folders' where they have the same."""
    names = [e.name for e in series]
    folders = [e.folder for e in series]
    return [
        name if names.count(name) == 1 else f"{name} ({k})" if folder is None else str(folder)
        for k, (name, folder) in enumerate(zip(names, folders, strict=True), 1)
    ]
