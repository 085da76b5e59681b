"""What a person sees of a result: its document, found by its class, printed as text or written as a page. It computes nothing."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from greybox.base import Check, Finding, GreyboxError, nearest
from greybox.base.document import Block, Details, Document, FigureBlock, Paragraphs
from greybox.base.texts import LINE_WIDTH, to_lines
from greybox.show.printers.text import MOST_LINES, print_text
from greybox.show.sentences import EXTENSIONS, find_writer, sentence

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from greybox.base.figure import Figure

Describer = Callable[..., Document]

# Class -> the function of `greybox.show.documents` that describes it. Loaded when needed: a check does not load what a fit needs.
DOCUMENTS = {
    "Fit": "fit.describe_fit",
    "ModelCheck": "check.describe_check",
    "Comparison": "comparison.describe_comparison",
    "Demo": "demo.describe_demo",
    "Discovery": "discovery.describe_discovery",
    "EffectListing": "check.describe_effects",
    "Linearisation": "linearisation.describe_linearisation",
    "Simulation": "simulation.describe_simulation",
    "FitAnswer": "fit.describe_fit_answer",
    "SimulationAnswer": "simulation.describe_simulation_answer",
    "LinearAnswer": "linearisation.describe_linear_answer",
    "CodeAnswer": "linearisation.describe_code_answer",
}


def describe(value: Any, **options: Any) -> Document:
    """The document of a result.

    Parameters
    ----------
    value
        A result.
    **options
        Of its describer: ``command`` that was typed, ``model`` of a simulation.

    Raises
    ------
    TypeError
        For a value that nothing describes.
    """
    describer = _describer_of(value)
    if describer is not None:
        return describer(value, **options)
    written: Any = find_writer(value)(value)
    return Document(type(value).__name__, details=[Paragraphs([written])] if isinstance(written, str) else written)


def text(value: Any, width: int = LINE_WIDTH, *, details: bool | None = None, lines: int = MOST_LINES) -> str:
    """A result in plain text, in at most ``lines``: what ``print(value)`` shows; with ``details`` all that a terminal can show.

    A value that is one text stays in its lines: it is part of others.
    """
    if isinstance(value, (Finding, Check)):
        return sentence(value)
    if isinstance(value, Document):
        return print_text(value, width, details=details, lines=lines)
    if _describer_of(value) is None and isinstance(written := find_writer(value)(value), str):
        return to_lines(written)
    return print_text(describe(value), width, details=details, lines=lines)


def _describer_of(value: Any) -> Describer | None:
    """The function that describes a value, of the first of its classes that has one."""
    return next(filter(None, map(_find_describer, type(value).__mro__)), None)


@cache
def _find_describer(kind: type) -> Describer | None:
    """The function in the table above; an extension has a module ``document`` beside the class, with a table ``DOCUMENTS`` of its own."""
    place = DOCUMENTS.get(kind.__name__)
    if place is not None and kind.__module__.startswith("greybox."):
        module, name = place.split(".")
        describer: Describer = getattr(import_module(f"greybox.show.documents.{module}"), name)
        return describer
    package = kind.__module__.rpartition(".")[0]
    is_core = package.startswith("greybox.") and not package.startswith(f"{EXTENSIONS}.")
    if not package or is_core or find_spec(f"{package}.document") is None:
        return None
    table: Mapping[str, Describer] = getattr(import_module(f"{package}.document"), "DOCUMENTS", {})
    return table.get(kind.__name__)


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
    from greybox.show.printers.html import write_page  # printing text needs none of it

    target = Path(path)
    target = target if target.suffix.lower() in (".html", ".htm") else target / "report.html"
    return write_page(describe_page(value, command=command, **options), target)


def describe_page(value: Any, **options: Any) -> Document:
    """The document of a result that has a page. Raises GreyboxError where it has none."""
    # What has no describer of its own has a sentence, and no page; an error inside a describer is a bug, and is not hidden.
    describer = _describer_of(value)
    document = None if describer is None else describer(value, **options)
    if document is None or not document.sections:
        raise GreyboxError(
            f"report: a {type(value).__name__} has no page; give one of {', '.join(k for k in DOCUMENTS if not k.endswith('Answer'))}"
        )
    return document


def plot(value: Any, figure: str = "", panel: str = "", *, ax: Axes | None = None) -> Axes:
    """Draw one figure of the page of a result with matplotlib.

    Parameters
    ----------
    value
        A result that `report` writes a page of.
    figure
        Which of its figures, by its address on the page, as in ``report.html#residual-0``; the one at the head of the page where left out.
    panel
        Which of its panels: the button above it on the page; the first where left out.
    ax
        The axes to draw into; new ones where left out.

    Returns
    -------
    matplotlib.axes.Axes
        What was drawn into.

    Raises
    ------
    GreyboxError
        For a value without a page or without figures; for a name that none of them has, with the names that there are.

    Examples
    --------
    >>> import greybox as gb
    >>> gb.plot(fit, "residual-0", ax=ax)  # doctest: +SKIP
    """
    from greybox.show.figures.matplotlib_backend import draw_in_axes

    page = describe_page(value)
    figures = list_figures([*page.evidence, *(block for section in page.sections for block in section.blocks)])
    name = figure or next(iter(figures), "")
    if name not in figures:
        which = nearest(name, list(figures)) if figures else "there is none"
        raise GreyboxError(f"plot: the page of this {type(value).__name__} has no figure {name!r}; {which}")
    panels = {p.name: p for p in figures[name].panels}
    if panel and panel not in panels:
        raise GreyboxError(f"plot: the figure {name} has no panel {panel!r}; {nearest(panel, list(panels))}")
    return draw_in_axes(panels[panel] if panel else figures[name].panels[0], ax)


def list_figures(blocks: Iterable[Block]) -> dict[str, Figure]:
    """The figures among blocks, by their names, those within folds included."""

    def walk(inner: Iterable[Block]) -> Iterator[Figure]:
        for block in inner:
            if isinstance(block, FigureBlock):
                yield block.figure
            elif isinstance(block, Details):
                yield from walk(block.blocks)

    return {figure.name: figure for figure in walk(blocks)}
