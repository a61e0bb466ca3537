"""Reports: results and figures put together into one page that needs nothing else.

Pages come from the templates in ``bayesid/templates``. Results of the layers above come in as they are.
"""

from bayesid.report.check import check_report
from bayesid.report.comparison import comparison_report
from bayesid.report.diagnosis import diagnosis_report
from bayesid.report.identification import identification_report
from bayesid.report.page import render
from bayesid.report.posterior import posterior_report

__all__ = ["check_report", "comparison_report", "diagnosis_report", "identification_report", "posterior_report", "render"]
