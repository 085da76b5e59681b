"""Black-box models: difference equations between inputs and one output, fitted without physics."""

from greybox.comparison.blackbox.arx import arx
from greybox.comparison.blackbox.best_models import best_black_boxes
from greybox.comparison.blackbox.hammerstein import HammersteinModel, StaticNonlinearity, hammerstein
from greybox.comparison.blackbox.polynomial import PolynomialModel
from greybox.comparison.blackbox.prediction_error import PredictionErrorPolicy
from greybox.comparison.blackbox.prediction_error_models import armax, box_jenkins, output_error
from greybox.comparison.blackbox.resample import keep_measured_rows, resample
from greybox.comparison.blackbox.rounding import (
    ContinuousTransferFunction,
    count_digits_needed,
    round_coefficients,
    to_continuous,
)
from greybox.comparison.blackbox.structure_scan import (
    BlackBoxKind,
    ScannedStructure,
    StructureScan,
    StructureScanPolicy,
    scan_structures,
)
from greybox.comparison.blackbox.subspace import StateSpaceModel, SubspaceOutput, subspace

__all__ = [
    "BlackBoxKind",
    "ContinuousTransferFunction",
    "HammersteinModel",
    "PolynomialModel",
    "PredictionErrorPolicy",
    "ScannedStructure",
    "StateSpaceModel",
    "StaticNonlinearity",
    "StructureScan",
    "StructureScanPolicy",
    "SubspaceOutput",
    "armax",
    "arx",
    "best_black_boxes",
    "box_jenkins",
    "count_digits_needed",
    "hammerstein",
    "keep_measured_rows",
    "output_error",
    "resample",
    "round_coefficients",
    "scan_structures",
    "subspace",
    "to_continuous",
]
