"""Reports: one self-contained HTML file for everything that was computed, for a colleague who has not got the program."""

from greybox.reports.page import Page
from greybox.reports.render import write
from greybox.reports.report import page_of, report

__all__ = ["Page", "page_of", "report", "write"]
