"""Hand-over to controller design: linear models with their uncertainty, and the model as code."""

from greybox.export.api import to_control, to_json, to_mat, to_numpy
from greybox.export.c_code import to_c
from greybox.export.fmu import to_fmu
from greybox.export.linearisation import Linearisation
from greybox.export.linearise import linearise
from greybox.export.model_family import ModelFamily, WorstCase, sample_family
from greybox.export.modelica import to_modelica
from greybox.export.nonlinear import to_nonlinear_system
from greybox.export.operating_point import OperatingPoint, find_operating_point
from greybox.export.python_model import to_python

__all__ = [
    "Linearisation",
    "ModelFamily",
    "OperatingPoint",
    "WorstCase",
    "find_operating_point",
    "linearise",
    "sample_family",
    "to_c",
    "to_control",
    "to_fmu",
    "to_json",
    "to_mat",
    "to_modelica",
    "to_nonlinear_system",
    "to_numpy",
    "to_python",
]
