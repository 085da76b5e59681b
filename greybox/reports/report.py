"""`report`: whatever was computed in, one page out."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Any

from greybox.errors import GreyboxError
from greybox.reports.page import Page
from greybox.reports.render import write

# What has a page, and the module with its builder; loaded when needed, because a check should not load what a fit needs.
PAGES = {
    "Fit": "of_fit",
    "ModelCheck": "of_check",
    "Comparison": "of_comparison",
    "Demo": "of_demo",
    "Discovery": "of_discovery",
    "Export": "of_export",
    "Linearisation": "of_linearisation",
    "Simulation": "of_simulation",
}


def report(value: Any, path: str | Path, *, command: str = "", **more: Any) -> Path:
    """Write the report of ``value`` as one HTML file that opens without a network, and return its path.

    ``value``: what `greybox.fit`, `greybox.discover`, `greybox.simulate`, `greybox.linearise`, `greybox.check.check` or
    `greybox.comparison.compare` gave. ``path``: the file, or a folder, which then gets ``report.html``. ``command`` is what was typed,
    for the page to say how to repeat it; ``more`` goes to the builder of the page, such as ``model`` for a simulation. Raises
    GreyboxError for a value of another kind.
    """
    target = Path(path)
    target = target if target.suffix.lower() in (".html", ".htm") else target / "report.html"
    return write(page_of(value, command=command, **more), target)


def page_of(value: Any, **more: Any) -> Page:
    """The page of ``value``, by its type. Raises GreyboxError where that has none."""
    for kind in type(value).__mro__:
        if kind.__name__ in PAGES and kind.__module__.startswith("greybox."):
            home = PAGES[kind.__name__]
            page: Page = getattr(import_module(f"greybox.reports.{home}"), f"report_{home}")(value, **more)
            return page
    raise GreyboxError(f"report: a {type(value).__name__} has no page; give one of {', '.join(PAGES)}")
