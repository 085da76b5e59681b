"""`report`: whatever was computed in, one page out."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from greybox.errors import GreyboxError
from greybox.reports.of_fit import report_of_fit
from greybox.reports.page import Page
from greybox.reports.render import write
from greybox.result import Fit


def report(value: Any, path: str | Path, *, command: str = "", **more: Any) -> Path:
    """Write the report of ``value`` as one HTML file that opens without a network, and return its path.

    ``value``: a `greybox.Fit`. ``path``: the file, or a folder, which then gets ``report.html``. ``command`` is what was typed, for the
    page to say how to repeat it; ``more`` goes to the builder of the page. Raises GreyboxError for a value of another kind.
    """
    target = Path(path)
    target = target if target.suffix.lower() in (".html", ".htm") else target / "report.html"
    return write(page_of(value, command=command, **more), target)


def page_of(value: Any, **more: Any) -> Page:
    """The page of ``value``, by its type."""
    if isinstance(value, Fit):
        return report_of_fit(value, **more)
    raise GreyboxError(f"report: a {type(value).__name__} has no page; give a Fit")
