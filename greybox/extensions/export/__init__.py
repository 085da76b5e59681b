"""A fitted model for other programs: linear models with their uncertainty, and the model as code, FMU or Modelica."""

from typing import TYPE_CHECKING

from greybox.base.faces import lazy_face

if TYPE_CHECKING:
    from greybox.estimation.linear.exported_model import ExportFinding
    from greybox.estimation.linear.linearisation import Linearisation, minimal_realisation
    from greybox.estimation.linear.linearise import linearise
    from greybox.estimation.linear.model_family import ModelFamily, WorstCase, sample_family
    from greybox.estimation.linear.operating_point import OperatingPoint, find_operating_point
    from greybox.estimation.linear.sampling import sample
    from greybox.estimation.linear.transfer_channel import TransferChannel, extract_channel
    from greybox.extensions.export.c_code import to_c
    from greybox.extensions.export.casadi_model import to_acados, to_casadi, to_do_mpc
    from greybox.extensions.export.fmu import to_fmu
    from greybox.extensions.export.linear_files import write_linear
    from greybox.extensions.export.modelica import to_modelica
    from greybox.extensions.export.observer import Observer, ObserverRun, design_observer
    from greybox.extensions.export.python_control import (
        to_control,
        to_nonlinear_system,
        to_state_space,
        to_transfer_function,
    )
    from greybox.extensions.export.python_model import to_python
    from greybox.extensions.export.target import ExportTarget

__getattr__, __all__, __dir__ = lazy_face(__name__)
