"""Fitting a model's constants to records."""

from greybox.fitting.fit import fit
from greybox.fitting.multistart import MultiStart, multistart
from greybox.fitting.options import FitOptions
from greybox.fitting.validate import validate

__all__ = ["FitOptions", "MultiStart", "fit", "multistart", "validate"]
