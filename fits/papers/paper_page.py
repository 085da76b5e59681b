"""What the studies of the two papers write: Markdown tables of printed against computed numbers, and small figures."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

PAGE = "paper_tables.md"
FIGURES = "figures"
TITLE = """# The papers' tables, printed and computed

Every table of the two papers beside the same computed by greybox: in `27.13 / 26.87` the first is printed and the second computed.
Neither paper prints its data; the records are **generated, not measured** (`fits/papers/micromotion_twin.py`,
`fits/papers/pneumatic_twin.py`). Written by `python -m fits.papers`; the papers' own mistakes are in [errata](errata.md).
"""
DPI = 80
MEASURED, MODELS = "#9a9a9a", ("#c0392b", "#1f5a8a", "#2e8b57", "#b8860b")
Say = Callable[[str], object]


def docs_folder(study: str) -> Path:
    """The folder that the command line names, `docs` if it names none."""
    parser = argparse.ArgumentParser(prog=f"python -m fits.{study}")
    parser.add_argument(
        "--output", metavar="FOLDER", type=Path, default=Path("docs/studies"), help="folder of the page (docs/studies)"
    )
    folder: Path = parser.parse_args().output
    return folder


def write_section(folder: Path, name: str, text: str, page: str = PAGE, head: str = TITLE) -> Path:
    """Put ``text`` as the part ``name`` into a page (that of both papers) below its ``head``, in place of what was there."""
    folder.mkdir(parents=True, exist_ok=True)
    path, parts = folder / page, {}
    if path.is_file():
        for chunk in path.read_text(encoding="utf-8").split("<!-- part ")[1:]:
            title, _, body = chunk.partition(" -->\n")
            parts[title] = body.strip()
    parts[name] = text.strip()
    chunks = [f"<!-- part {title} -->\n{parts[title]}\n" for title in sorted(parts)]
    path.write_text("\n".join([head, *chunks]), encoding="utf-8")
    return path


def markdown(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def beside(printed: float | None, ours: float | None, digits: int = 4) -> str:
    """``printed / ours`` with so many digits; a cross for what there is not."""
    return " / ".join("x" if v is None else f"{v:.{digits}g}" for v in (printed, ours))


def rms_log(ours: Sequence[float] | np.ndarray, printed: Sequence[float] | np.ndarray) -> float:
    """Root mean square of the logarithm of the ratios: 0.1 means ten percent off, typically."""
    return float(np.sqrt(np.mean(np.log(np.asarray(ours, float) / np.asarray(printed, float)) ** 2)))


def picture(rows: int = 1, width: float = 8.0, height: float = 3.2) -> tuple[Figure, list[Axes]]:
    """A figure with ``rows`` axes above one another."""
    figure = Figure(figsize=(width, height * rows), layout="constrained")
    FigureCanvasAgg(figure)
    axes = list(figure.subplots(rows, 1, squeeze=False)[:, 0])
    for axis in axes:
        axis.grid(alpha=0.25, lw=0.5)
        axis.margins(x=0.01)
    return figure, axes


def legend(axis: Axes, x: str, y: str, title: str, columns: int = 1) -> None:
    """Labels, title and legend of one of the axes."""
    axis.set_xlabel(x)
    axis.set_ylabel(y)
    axis.set_title(title, loc="left", fontsize=10)
    if axis.get_legend_handles_labels()[0]:
        axis.legend(fontsize=8, frameon=False, ncols=columns)


def save(figure: Figure, folder: Path, name: str) -> Path:
    """Write ``figure`` as a small PNG into the page's folder of figures."""
    path = folder / FIGURES / f"{name}.png"
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=DPI, metadata={"Software": None})
    return path


@contextmanager
def progress(title: str, total: int) -> Iterator[Callable[[], None]]:
    """A bar of ``total`` steps on the terminal; the function given moves it on."""
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(title, total=total)
        yield lambda: bar.advance(task)
