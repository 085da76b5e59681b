"""Reports: one self-contained HTML file for everything that was computed, for a colleague who has not got the program."""

from greybox.show.pages.html import write_page
from greybox.show.pages.page import Page
from greybox.show.pages.report import build_page, report

__all__ = ["Page", "build_page", "report", "write_page"]
