"""Results as values: a fit, its constants, its misfit; saved and loaded as JSON."""

from greybox.result.fit import Fit, fit_data, load_fit, restore_fit
from greybox.result.fit_parts import (
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
from greybox.result.json_data import format_json, to_json_data

__all__ = [
    "Estimate",
    "Fit",
    "FitConstraints",
    "FitDiscretisation",
    "FitNoise",
    "FitUncertainty",
    "IntervalKind",
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
    "restore_fit",
    "to_json_data",
]
