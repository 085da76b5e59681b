"""Plants that come as an FMU: read, simulated beside a record, fitted, and searched for missing effects like a model."""

from greybox.extensions.fmu.description import FmuPlant, FmuVariable, read_fmu
from greybox.extensions.fmu.effects import (
    FmuDiscovery,
    FmuEffectFit,
    PreparedFmu,
    discover_fmu,
    fit_fmu_effects,
    prepare_fmu,
)
from greybox.extensions.fmu.fit_fmu import FmuFit, fit_fmu
from greybox.extensions.fmu.simulator import FmuRunError, FmuSimulator

__all__ = [
    "FmuDiscovery",
    "FmuEffectFit",
    "FmuFit",
    "FmuPlant",
    "FmuRunError",
    "FmuSimulator",
    "FmuVariable",
    "PreparedFmu",
    "discover_fmu",
    "fit_fmu",
    "fit_fmu_effects",
    "prepare_fmu",
    "read_fmu",
]
