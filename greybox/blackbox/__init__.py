"""Black-box models: difference equations between inputs and one output, fitted without physics."""

from greybox.blackbox.armax import armax
from greybox.blackbox.arx import arx
from greybox.blackbox.best import best_black_boxes
from greybox.blackbox.curves import Curve
from greybox.blackbox.hammerstein import HammersteinModel, hammerstein
from greybox.blackbox.output_error import box_jenkins, output_error
from greybox.blackbox.polynomial import PolynomialModel
from greybox.blackbox.resample import resample, thinned
from greybox.blackbox.rounding import digits_needed, rounded
from greybox.blackbox.scan import Candidate, Scan, scan_structures
from greybox.blackbox.smoothing import monte_carlo_smoothing
from greybox.blackbox.smoothing_result import Smoothing

__all__ = [
    "Candidate", "Curve", "HammersteinModel", "PolynomialModel", "Scan", "Smoothing", "armax", "arx", "best_black_boxes",
    "box_jenkins", "digits_needed", "hammerstein", "monte_carlo_smoothing", "output_error", "resample", "rounded",
    "scan_structures", "thinned",
]  # fmt: skip
