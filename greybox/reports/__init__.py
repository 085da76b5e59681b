"""Reports: one self-contained HTML file for everything that was computed."""

from greybox.reports.fit_page import fit_page
from greybox.reports.render import write

__all__ = ["fit_page", "write"]
