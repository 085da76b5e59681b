"""Reports: one self-contained HTML file for everything that was computed, for a colleague who has not got the program."""

from greybox.reports.of_fit import report_of_fit
from greybox.reports.page import Page
from greybox.reports.render import write
from greybox.reports.report import report

__all__ = ["Page", "report", "report_of_fit", "write"]
