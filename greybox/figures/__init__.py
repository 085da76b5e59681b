"""The only room that draws: pictures of fits as PNG files."""

from greybox.figures.comparison import comparison_figure
from greybox.figures.discovery import discovery_figures
from greybox.figures.fit_figure import fit_figure, misfits_of
from greybox.figures.gap import gap_figure
from greybox.figures.residual_tests import residual_figure

__all__ = ["comparison_figure", "discovery_figures", "fit_figure", "gap_figure", "misfits_of", "residual_figure"]
