"""The verb ``accuracy``."""

from __future__ import annotations

import click

import bayesid
from bayesid.cli import options as shared
from bayesid.cli.terminal import say
from bayesid.errors import InputError
from bayesid.workflows.accuracy import add_certificate, check_estimate


@click.command()
@shared.EXPERIMENT
@shared.model_options
@shared.one_method
@shared.BOUNDS
@shared.STATIC
@click.option("--runs", type=int, default=20, show_default=True, help="Simulated recordings of every level; 0: vary nothing.")
@click.option("--nominal", is_flag=True, help="Take the nominal links for the true ones, not the estimated.")
@click.option("--certificate", is_flag=True, help="Count how often the intervals hold the truth, on simulated twins.")
@click.option("--twins", type=int, help="Twins of the certificate.  [default: 400]")
@click.option("--estimate", type=shared.FILE, help="An estimate.json to write the certificate into, with its report.")
@click.option("--sensors", type=shared.FILE, help="A sensors.toml of candidates to compare before buying one.")
@click.option("--resume", is_flag=True, help="Go on with the twins of an interrupted run of the same --out.")
@shared.on_workers
@shared.OUT
@shared.SEED
def accuracy(
    experiment, filter_l, filter_d, model, effects_from, method, bounds, certificate, twins, estimate, out, resume, **options
) -> None:
    """What the errors depend on, what effects left out of the model do, and whether the intervals hold the truth."""
    given = {"resume": resume, "estimate": estimate, "twins": twins is not None}
    if not certificate and (unused := [name for name, said in given.items() if said]):
        raise InputError(f"--{unused[0]} is for --certificate; add that, or leave it out")
    counted = (400 if twins is None else twins) if certificate else 0
    with shared.running("accuracy", out) as run:
        filters = shared.low_pass(filter_l, filter_d)
        loaded = shared.load(experiment, model, effects_from)
        written = None
        if estimate is not None:
            written, method = check_estimate(estimate, loaded, method)
        chosen = shared.bounded(method, bounds, loaded)
        with run.resumable(loaded.name) as kept:
            result = bayesid.accuracy(
                loaded, method=chosen, low_pass=filters, certificate=counted, kept=kept, resume=resume,
                progress=run.progress, **options,
            )  # fmt: skip
            report = run.write(result, loaded.name)
            changed = written is None or add_certificate(written, result)
    say(result)
    if written is not None:
        say(f"certificate: {written}" + ("" if changed else ", but not its report.html, which is not as it was written"))
    say(f"report: {report}")
