"""Fitting a model's constants to records."""

from greybox.fitting.fit import fit
from greybox.fitting.options import FitOptions
from greybox.fitting.validate import validate

__all__ = ["FitOptions", "fit", "validate"]
