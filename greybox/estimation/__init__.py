"""Fitting a model's parameters to records.

`fit` makes an `EstimationProblem` of model, records and noise; `solve` chooses a transcription and minimises; the `Solution` is fitted
again where the residual shows more of the noise, and becomes a `greybox.result.Fit` with covariance, tests and findings.
"""

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
