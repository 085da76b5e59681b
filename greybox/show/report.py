"""`report`: whatever was computed in, one page out."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from greybox.base.errors import GreyboxError
from greybox.show.pages.html import write_page
from greybox.show.pages.page import Page

# Classes that have a page: the module of its builder, ``build_<module>``, is loaded when needed. A check does not load what a fit needs.
PAGES = {
    "Fit": "fit_page",
    "ModelCheck": "check_page",
    "Comparison": "comparison_page",
    "Demo": "demo_page",
    "Discovery": "discovery_page",
    "Linearisation": "linearisation_page",
    "Simulation": "simulation_page",
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
        builder = _find_builder(kind)
        if builder is not None:
            page: Page = builder(value, **options)
            return page
    raise GreyboxError(f"report: a {type(value).__name__} has no page; give one of {', '.join(PAGES)}")


def _find_builder(kind: type) -> Callable[..., Page] | None:
    """``build_<module>`` of this package; an extension has a module ``page`` beside the class, with a table ``PAGES`` by class."""
    if kind.__name__ in PAGES and kind.__module__.startswith("greybox."):
        module = PAGES[kind.__name__]
        builder: Callable[..., Page] = getattr(import_module(f"{__package__}.{module}"), f"build_{module}")
        return builder
    package = kind.__module__.rpartition(".")[0]
    if not package or find_spec(f"{package}.page") is None:
        return None
    table: Mapping[str, Callable[..., Page]] = getattr(import_module(f"{package}.page"), "PAGES", {})
    return table.get(kind.__name__)
