"""`report`: whatever was computed in, one page out."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Any

from greybox.base.errors import GreyboxError
from greybox.show.pages.html import write_page
from greybox.show.pages.page import Page

# Classes that have a page: the module of its builder, ``build_<module>``, is loaded when needed. A check does not load what a fit needs.
PAGES = {
    "Fit": "show.pages.fit_page:fit_page",
    "ModelCheck": "show.pages.check_page:check_page",
    "Campaign": "extensions.design.page:campaign_page",
    "ChangeDetection": "extensions.changes.page:changed_page",
    "Comparison": "show.pages.comparison_page:comparison_page",
    "Demo": "show.pages.demo_page:demo_page",
    "Design": "extensions.design.page:design_page",
    "Discovery": "show.pages.discovery_page:discovery_page",
    "Export": "extensions.export.page:export_page",
    "Linearisation": "show.pages.linearisation_page:linearisation_page",
    "Simulation": "show.pages.simulation_page:simulation_page",
}


def report(value: Any, path: str | Path, *, command: str = "", **options: Any) -> Path:
    """Write the report of a result as one HTML file that opens without a network.

    Parameters
    ----------
    value
        What `greybox.fit`, `greybox.discover`, `greybox.simulate`, `greybox.linearise`, `greybox.compare` or `greybox.estimation.check`
        gave.
    path
        The file, or a folder, which then gets ``report.html``.
    command
        What was typed, for the page to say how to repeat it.
    **options
        Passed to the builder of the page, such as ``model`` for a simulation.

    Returns
    -------
    Path
        The file that was written.

    Raises
    ------
    GreyboxError
        For a value of another kind.

    Examples
    --------
    >>> import greybox as gb
    >>> gb.report(result, "results/")  # doctest: +SKIP
    """
    target = Path(path)
    target = target if target.suffix.lower() in (".html", ".htm") else target / "report.html"
    return write_page(build_page(value, command=command, **options), target)


def build_page(value: Any, **options: Any) -> Page:
    """The page of ``value``, by its type. Raises GreyboxError where that has none."""
    for kind in type(value).__mro__:
        if kind.__name__ in PAGES and kind.__module__.startswith("greybox."):
            module, _, builder = PAGES[kind.__name__].partition(":")
            page: Page = getattr(import_module(f"greybox.{module}"), f"build_{builder}")(value, **options)
            return page
    raise GreyboxError(f"report: a {type(value).__name__} has no page; give one of {', '.join(PAGES)}")
