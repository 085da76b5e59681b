"""Plants that come as an FMU: read, simulated beside a record, and fitted like a model."""

from greybox.fmu.description import FmuPlant, FmuVariable, read_fmu
from greybox.fmu.fit_fmu import FmuFit, fit_fmu
from greybox.fmu.simulator import FmuRunError, FmuSimulator

__all__ = ["FmuFit", "FmuPlant", "FmuRunError", "FmuSimulator", "FmuVariable", "fit_fmu", "read_fmu"]
