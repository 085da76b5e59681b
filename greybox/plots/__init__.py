"""The only room that draws: pictures of fits as PNG files."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from greybox.plots.comparison import comparison_figure
    from greybox.plots.discovery import discovery_figures
    from greybox.plots.gap import gap_figure
    from greybox.plots.of_fit import fit_figure, misfits_of
    from greybox.plots.residual_tests import residual_figure

# Where each name lives. Loaded when first asked for: a page needs the thinning of curves, and not the drawing library.
_HOME = {
    "comparison_figure": "comparison",
    "discovery_figures": "discovery",
    "fit_figure": "of_fit",
    "gap_figure": "gap",
    "misfits_of": "of_fit",
    "residual_figure": "residual_tests",
}

__all__ = ["comparison_figure", "discovery_figures", "fit_figure", "gap_figure", "misfits_of", "residual_figure"]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"greybox.plots.{_HOME[name]}"), name)
