"""Results as values: a fit, its constants, its misfit; saved and loaded as JSON."""

from greybox.result.store import fit_data, layout, load_fit, plain
from greybox.result.values import (
    Estimate,
    Fit,
    FitConstraints,
    FitDiscretisation,
    FitNoise,
    FitUncertainty,
    Misfit,
    PredictionErrors,
    PriorCheck,
    Provenance,
    RobustLoss,
    SolverReport,
    StartResult,
    Trace,
    Validation,
)

__all__ = [
    "Estimate",
    "Fit",
    "FitConstraints",
    "FitDiscretisation",
    "FitNoise",
    "FitUncertainty",
    "Misfit",
    "PredictionErrors",
    "PriorCheck",
    "Provenance",
    "RobustLoss",
    "SolverReport",
    "StartResult",
    "Trace",
    "Validation",
    "fit_data",
    "layout",
    "load_fit",
    "plain",
]
