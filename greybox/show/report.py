"""`report`: whatever was computed in, one page out."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from greybox.base.document import Document
from greybox.base.errors import GreyboxError
from greybox.show.describe import DOCUMENTS, describe
from greybox.show.printers.html import write_page


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
    return write_page(describe_page(value, command=command, **options), target)


def describe_page(value: Any, **options: Any) -> Document:
    """The document of a result that has a page. Raises GreyboxError where it has none."""
    try:
        document = describe(value, **options)
    except TypeError:
        document = None
    if document is None or not document.sections:
        raise GreyboxError(
            f"report: a {type(value).__name__} has no page; give one of {', '.join(k for k in DOCUMENTS if not k.endswith('Answer'))}"
        )
    return document
