"""A picture as files: PNG to look at, SVG to print and to edit."""

from __future__ import annotations

from pathlib import Path

from matplotlib import rc_context
from matplotlib.figure import Figure

DPI = 110


def save(figure: Figure, png: Path) -> None:
    """Write ``figure`` as ``png`` and, with the same name, as SVG; the same figure gives the same files."""
    figure.savefig(png, dpi=DPI)
    figure.set_layout_engine("none")  # where everything stands is known by now
    with rc_context({"svg.hashsalt": "greybox"}):
        figure.savefig(png.with_suffix(".svg"), metadata={"Date": None})
