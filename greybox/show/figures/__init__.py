"""What figures show, as data, and two thin back ends that draw it: matplotlib for pictures, Plotly for pages.

`draw_fit` and its kin write pictures; ``plot_run`` and its kin in the modules of this package build the figures, which pages show too.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from greybox.base.faces import lazy_face

if TYPE_CHECKING:
    from greybox.base.figure import Axis, Figure, Panel, Role
    from greybox.show.figures.pictures import draw_comparison, draw_discovery, draw_fit, draw_gap, draw_residual_tests

# The figures of one page do not need what those of another one import.
__getattr__, __all__, __dir__ = lazy_face(__name__)
