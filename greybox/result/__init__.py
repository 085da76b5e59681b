"""Results as values: a fit, its constants, its misfit; saved and loaded as JSON."""

from greybox.result.fit import (
    Estimate,
    Fit,
    FitConstraints,
    FitDiscretisation,
    FitNoise,
    FitUncertainty,
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
from greybox.result.fit_file import fit_data, format_json, load_fit, to_json_data

__all__ = [
    "Estimate",
    "Fit",
    "FitConstraints",
    "FitDiscretisation",
    "FitNoise",
    "FitUncertainty",
    "Misfit",
    "PredictionReport",
    "PriorCheck",
    "Provenance",
    "RobustReport",
    "SolverReport",
    "StartResult",
    "Trace",
    "Validation",
    "fit_data",
    "format_json",
    "load_fit",
    "to_json_data",
]
