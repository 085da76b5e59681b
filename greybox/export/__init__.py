"""Hand-over to controller design: linear models with their uncertainty, and the model as code."""

from greybox.export.c_code import to_c
from greybox.export.casadi_model import to_acados, to_casadi, to_do_mpc
from greybox.export.findings import ExportFinding
from greybox.export.fmu import to_fmu
from greybox.export.linear_files import to_json, to_mat, to_numpy, write_linear
from greybox.export.linearisation import Linearisation
from greybox.export.linearise import linearise
from greybox.export.minimal_realisation import minimal_realisation
from greybox.export.model_family import ModelFamily, WorstCase, sample_family
from greybox.export.modelica import to_modelica
from greybox.export.observer import Observer, ObserverRun, design_observer
from greybox.export.operating_point import OperatingPoint, find_operating_point
from greybox.export.python_control import to_control, to_nonlinear_system, to_state_space, to_transfer_function
from greybox.export.python_model import to_python
from greybox.export.sampling import sample
from greybox.export.transfer_channel import TransferChannel, extract_channel

__all__ = [
    "ExportFinding",
    "Linearisation",
    "ModelFamily",
    "Observer",
    "ObserverRun",
    "OperatingPoint",
    "TransferChannel",
    "WorstCase",
    "design_observer",
    "extract_channel",
    "find_operating_point",
    "linearise",
    "minimal_realisation",
    "sample",
    "sample_family",
    "to_acados",
    "to_c",
    "to_casadi",
    "to_control",
    "to_do_mpc",
    "to_fmu",
    "to_json",
    "to_mat",
    "to_modelica",
    "to_nonlinear_system",
    "to_numpy",
    "to_python",
    "to_state_space",
    "to_transfer_function",
    "write_linear",
]
