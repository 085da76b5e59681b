"""The only room that draws: pictures of fits as PNG files."""

from greybox.figures.fit_figure import fit_figure, misfits_of

__all__ = ["fit_figure", "misfits_of"]
