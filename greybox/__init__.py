"""greybox: from measured data of an actuator to physical constants with honest intervals.

The verbs: `read_csv`, `simulate`, `fit`, `validate`. A model is a list of named balances; ``model + effect`` is a new model.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from greybox.discovery import Discovery, discover
    from greybox.effects import CATALOGUE, effect
    from greybox.errors import DataError, FitError, GreyboxError, ModelError, UnitError
    from greybox.experiment import Experiment, read_csv, read_experiments
    from greybox.fitting import FitOptions, fit, multistart, validate
    from greybox.model import Balance, DryFriction, Effect, Model
    from greybox.result import Estimate, Fit, Misfit, load_fit
    from greybox.signals import Input, Output, Parameter, State
    from greybox.simulation import Simulation, simulate

# Where each public name lives. Loaded when first asked for: stating a model should not load a solver.
_ROOMS = {
    "discovery": ("Discovery", "discover"),
    "effects": ("CATALOGUE", "effect"),
    "errors": ("DataError", "FitError", "GreyboxError", "ModelError", "UnitError"),
    "experiment": ("Experiment", "read_csv", "read_experiments"),
    "fitting": ("FitOptions", "fit", "multistart", "validate"),
    "model": ("Balance", "DryFriction", "Effect", "Model"),
    "result": ("Estimate", "Fit", "Misfit", "load_fit"),
    "signals": ("Input", "Output", "Parameter", "State"),
    "simulation": ("Simulation", "simulate"),
}
_HOME = {name: f"greybox.{room}" for room, names in _ROOMS.items() for name in names}

__all__ = [
    "CATALOGUE", "Balance", "DataError", "Discovery", "DryFriction", "Effect", "Estimate", "Experiment", "Fit", "FitError",
    "FitOptions", "GreyboxError", "Input", "Misfit", "Model", "ModelError", "Output", "Parameter", "Simulation",
    "State", "UnitError", "discover", "effect", "fit", "load_fit", "multistart", "read_csv", "read_experiments", "simulate", "validate",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'greybox' has no attribute {name!r}")
    value = getattr(import_module(_HOME[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
