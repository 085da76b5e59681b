"""Black-box models: difference equations between inputs and one output, fitted without physics."""

from greybox.blackbox.arx import arx
from greybox.blackbox.best_models import best_black_boxes
from greybox.blackbox.continuous import ContinuousTransferFunction, to_continuous
from greybox.blackbox.hammerstein import HammersteinModel, hammerstein
from greybox.blackbox.monte_carlo_smoothing import MonteCarloSmoothing, monte_carlo_smoothing
from greybox.blackbox.policy import PredictionErrorPolicy, StructureScanPolicy, SubspacePolicy
from greybox.blackbox.polynomial import PolynomialModel
from greybox.blackbox.prediction_error_models import armax, box_jenkins, output_error
from greybox.blackbox.resample import keep_measured_rows, resample
from greybox.blackbox.rounding import count_digits_needed, round_coefficients
from greybox.blackbox.static_nonlinearity import StaticNonlinearity
from greybox.blackbox.structure_scan import BlackBoxKind, ScannedStructure, StructureScan, scan_structures
from greybox.blackbox.subspace import StateSpaceModel, SubspaceOutput, subspace

__all__ = [
    "BlackBoxKind",
    "ContinuousTransferFunction",
    "HammersteinModel",
    "MonteCarloSmoothing",
    "PolynomialModel",
    "PredictionErrorPolicy",
    "ScannedStructure",
    "StateSpaceModel",
    "StaticNonlinearity",
    "StructureScan",
    "StructureScanPolicy",
    "SubspaceOutput",
    "SubspacePolicy",
    "armax",
    "arx",
    "best_black_boxes",
    "box_jenkins",
    "count_digits_needed",
    "hammerstein",
    "keep_measured_rows",
    "monte_carlo_smoothing",
    "output_error",
    "resample",
    "round_coefficients",
    "scan_structures",
    "subspace",
    "to_continuous",
]
