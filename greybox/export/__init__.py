"""Hand-over to controller design: linear models with their uncertainty, and the model as code."""

from greybox.export.c_code import to_c
from greybox.export.family import Family, Worst, family
from greybox.export.fmu import to_fmu
from greybox.export.hand_over import to_control, to_json, to_mat, to_numpy
from greybox.export.linear import Linearisation
from greybox.export.linearise import linearise
from greybox.export.modelica import to_modelica
from greybox.export.nonlinear import nonlinear_system
from greybox.export.point import OperatingPoint, operating_point
from greybox.export.python_model import to_python

__all__ = [
    "Family", "Linearisation", "OperatingPoint", "Worst", "family", "linearise", "nonlinear_system", "operating_point",
    "to_c", "to_control", "to_fmu", "to_json", "to_mat", "to_modelica", "to_numpy", "to_python",
]  # fmt: skip
