"""Fitting a model's constants to records."""

from greybox.fitting.fit import fit
from greybox.fitting.multistart import MultiStart, multistart
from greybox.fitting.options import FitOptions
from greybox.fitting.predictive_ahead import Predictor, predict, predictor
from greybox.fitting.predictive_smooth import Smoothed, smooth
from greybox.fitting.validate import validate

__all__ = [
    "FitOptions", "MultiStart", "Predictor", "Smoothed", "fit", "multistart", "predict", "predictor", "smooth", "validate",
]  # fmt: skip
