"""Fitting a model's parameters to records.

`fit` makes an `EstimationProblem` of model, records and noise; `solve` chooses a transcription and minimises; the `Solution` is fitted
again where the residual shows more of the noise, and becomes a `greybox.estimation.result.Fit` with covariance, tests and findings.
"""

from greybox.estimation.fit import fit
from greybox.estimation.multistart import MultiStartResult, multistart
from greybox.estimation.options import FitOptions
from greybox.estimation.predictor import Predictor, SmoothedStates, predict, predictor, smooth
from greybox.estimation.result import Fit, load_fit
from greybox.estimation.result_parts import (
    Estimate,
    FitConstraints,
    FitDiscretisation,
    FitNoise,
    FitUncertainty,
    IntervalKind,
    Misfit,
    PredictionReport,
    PriorCheck,
    Provenance,
    RobustReport,
    SolverReport,
    StartResult,
    Trace,
    Validation,
)
from greybox.estimation.validate import validate

__all__ = [
    "Estimate",
    "Fit",
    "FitConstraints",
    "FitDiscretisation",
    "FitNoise",
    "FitOptions",
    "FitUncertainty",
    "IntervalKind",
    "Misfit",
    "MultiStartResult",
    "PredictionReport",
    "Predictor",
    "PriorCheck",
    "Provenance",
    "RobustReport",
    "SmoothedStates",
    "SolverReport",
    "StartResult",
    "Trace",
    "Validation",
    "fit",
    "load_fit",
    "multistart",
    "predict",
    "predictor",
    "smooth",
    "validate",
]
