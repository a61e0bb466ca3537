"""The verb ``sample``."""

from __future__ import annotations

import click

import bayesid
from bayesid.cli import options as shared
from bayesid.cli.terminal import say
from bayesid.estimators.prior_check import conflicts


@click.command()
@shared.EXPERIMENT
@shared.model_options
@click.option("--draws", type=int, default=2000, show_default=True, help="Draws in all, rounded up to as many of each chain.")
@click.option("--chains", type=int, default=4, show_default=True, help="Independent chains.")
@click.option("--prior", help="nominal or flat; default: nominal where the experiment has an inertia_rel_std above 0.")
@click.option("--prior-std", type=float, help="Relative standard deviation of every nominal mass; default: inertia_rel_std.")
@click.option("--noise", default="gaussian", show_default=True, help="gaussian, or student against outliers.")
@click.option("--engine", help="hmc or emcee; default: the one that suits.")
@click.option("--longest", type=int, default=32, show_default=True, help="Times the usual length before giving up.")
@click.option("--keep-going", is_flag=True, help="Write draws that have not converged, with a warning.")
@click.option("--resume", is_flag=True, help="Go on with a run of the same --out that was interrupted.")
@shared.STATIC
@shared.on_workers
@shared.OUT
@shared.SEED
def sample(experiment, filter_l, filter_d, model, effects_from, out, engine, longest, resume, **options) -> None:
    """Draws from the posterior, with convergence checks and held-out validation."""
    with shared.running("sample", out) as run:
        filters = shared.low_pass(filter_l, filter_d)
        loaded = shared.load(experiment, model, effects_from)
        with run.resumable(loaded.name) as kept:
            sampler = bayesid.Sampler(engine=engine, longest=longest, checkpoint=kept, resume=resume)
            result = bayesid.sample(loaded, low_pass=filters, sampler=sampler, progress=run.progress, **options)
            report = run.write(result, loaded.name)
    say(result)
    for warning in [w for w in result.warnings if w not in conflicts(result.prior_check)]:  # those stand above
        say(f"  warning: {warning}")
    say(f"report: {report}")
