"""Black-box models: difference equations between inputs and one output, fitted without physics."""

from greybox.blackbox.armax import armax
from greybox.blackbox.arx import arx
from greybox.blackbox.best_models import best_black_boxes
from greybox.blackbox.hammerstein import HammersteinModel, hammerstein
from greybox.blackbox.monte_carlo_smoothing.estimate import monte_carlo_smoothing
from greybox.blackbox.monte_carlo_smoothing.result import MonteCarloSmoothing
from greybox.blackbox.output_error import box_jenkins, output_error
from greybox.blackbox.polynomial import PolynomialModel
from greybox.blackbox.resample import keep_measured_rows, resample
from greybox.blackbox.rounding import count_digits_needed, round_coefficients
from greybox.blackbox.static_nonlinearity import StaticNonlinearity
from greybox.blackbox.structure_scan import ScannedStructure, StructureScan, scan_structures

__all__ = [
    "HammersteinModel",
    "MonteCarloSmoothing",
    "PolynomialModel",
    "ScannedStructure",
    "StaticNonlinearity",
    "StructureScan",
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
]
