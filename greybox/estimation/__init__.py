"""Fitting a model's constants to records."""

from greybox.estimation.fit import fit
from greybox.estimation.multistart import MultiStartResult, multistart
from greybox.estimation.options import FitOptions
from greybox.estimation.predictor import Predictor, predict, predictor
from greybox.estimation.smoother import SmoothedStates, smooth
from greybox.estimation.validate import validate

__all__ = [
    "FitOptions",
    "MultiStartResult",
    "Predictor",
    "SmoothedStates",
    "fit",
    "multistart",
    "predict",
    "predictor",
    "smooth",
    "validate",
]
