"""The report of ``calibrate``."""

from __future__ import annotations

from bayesid.report.page import render, run_times, svg, versions
from bayesid.report.prediction_figures import measured_against_predicted
from bayesid.results.calibration import Calibration


def calibration_report(result: Calibration) -> str:
    """The report of ``calibrate``: an HTML page with all figures inside."""
    return render(
        "calibration.html",
        name=result.name, sensor=result.sensor, motions=", ".join(result.fit.problem.fitted), rows=result.rows(),
        sentences=result.sentences, warnings_list=result.warnings, exports=list(result.exports().items()),
        plot_svg=svg(measured_against_predicted(result.fit.fitted[0]), "readings"),
        how=[("Diagnosis", result.verdict or "refused"), run_times(result.seconds), versions("numpy", "scipy", "pin")],
    )  # fmt: skip
