"""What figures show, as data, and two thin back ends that draw it: matplotlib for pictures, Plotly for pages.

`draw_fit` and its kin write pictures; ``plot_run`` and its kin in the modules of this package build the figures, which pages show too.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from greybox.show.figures.figure import Axis, Figure, Panel, Role
    from greybox.show.figures.pictures import draw_comparison, draw_discovery, draw_fit, draw_gap, draw_residual_tests

# Loaded when first asked for: the figures of one page do not need what those of another one import.
_HOME = {
    **dict.fromkeys(("Axis", "Figure", "Panel", "Role"), "figure"),
    **dict.fromkeys(("draw_comparison", "draw_discovery", "draw_fit", "draw_gap", "draw_residual_tests"), "pictures"),
}

__all__ = [
    "Axis",
    "Figure",
    "Panel",
    "Role",
    "draw_comparison",
    "draw_discovery",
    "draw_fit",
    "draw_gap",
    "draw_residual_tests",
]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"greybox.show.figures.{_HOME[name]}"), name)
