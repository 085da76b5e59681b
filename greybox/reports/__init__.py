"""Reports: one self-contained HTML file for everything that was computed, for a colleague who has not got the program."""

from greybox.reports.html import write_page
from greybox.reports.page import Page
from greybox.reports.report import build_page, report

__all__ = ["Page", "build_page", "report", "write_page"]
