"""greybox: from measured data of an actuator to physical parameters with honest intervals.

The verbs of the first week stand here: `read_csv`, `simulate`, `fit`, `validate`, `residual_tests`, `compare`, `discover`,
`detect_changes`, `linearise`, `report`, `design`. A model is a list of named balances; ``model + effect`` is a new model.

Everything else is in a namespace: ``gb.signals`` (test signals), ``gb.effects`` (the catalogue), ``gb.blackbox``, ``gb.discovery``,
``gb.experiment_design``, ``gb.identifiability``, ``gb.uncertainty`` (profile likelihood, bootstrap), ``gb.residuals``,
``gb.export``, ``gb.frequency`` (frequency responses), ``gb.fmu``, ``gb.errors``.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from greybox.base import errors
    from greybox.base.errors import GreyboxError
    from greybox.blackbox import __init__ as blackbox
    from greybox.change_detection import __init__ as change_detection
    from greybox.comparison.compare import compare
    from greybox.data import signals
    from greybox.data.experiment import Experiment
    from greybox.data.read import read_csv, read_experiments
    from greybox.discovery import __init__ as discovery
    from greybox.discovery.pipeline import discover
    from greybox.estimation import __init__ as estimation
    from greybox.estimation.fit import fit
    from greybox.estimation.linear.linearise import linearise
    from greybox.estimation.multistart import multistart
    from greybox.estimation.options import FitOptions
    from greybox.estimation.predictor import predict, smooth
    from greybox.estimation.residuals import residual_tests
    from greybox.estimation.result import Fit, load_fit
    from greybox.estimation.validate import validate
    from greybox.experiment import __init__ as experiment
    from greybox.experiment_design import __init__ as experiment_design
    from greybox.export import __init__ as export
    from greybox.extensions.changes.detect import detect_changes
    from greybox.extensions.design.design import design
    from greybox.extensions.design.problem import SignalLimit
    from greybox.fmu import __init__ as fmu
    from greybox.frequency import __init__ as frequency
    from greybox.identifiability import __init__ as identifiability
    from greybox.model.balance import Balance
    from greybox.model.characteristic import Characteristic
    from greybox.model.effect import DryFriction, Effect
    from greybox.model.effects import catalogue as effects
    from greybox.model.effects.catalogue import effect
    from greybox.model.model import Model
    from greybox.model.signals import Input, Output, Parameter, State
    from greybox.rendering import __init__ as rendering
    from greybox.residuals import __init__ as residuals
    from greybox.result import __init__ as result
    from greybox.show import figures as plots
    from greybox.show.pages.report import report
    from greybox.simulation import __init__ as simulation
    from greybox.simulation.simulate import simulate
    from greybox.uncertainty import __init__ as uncertainty

# Where each name lives. Loaded when first asked for: stating a model should not load a solver.
_NAMES = {
    "change_detection": ("detect_changes",),
    "comparison": ("compare",),
    "discovery": ("discover",),
    "effects": ("effect",),
    "errors": ("GreyboxError",),
    "estimation": (
        "FitOptions",
        "fit",
        "multistart",
        "predict",
        "smooth",
        "validate",
    ),
    "experiment": (
        "Experiment",
        "read_csv",
        "read_experiments",
    ),
    "experiment_design": (
        "SignalLimit",
        "design",
    ),
    "export": ("linearise",),
    "model": (
        "Balance",
        "Characteristic",
        "DryFriction",
        "Effect",
        "Model",
    ),
    "model.signals": (
        "Input",
        "Output",
        "Parameter",
        "State",
    ),
    "reports": ("report",),
    "residuals": ("residual_tests",),
    "result": (
        "Fit",
        "load_fit",
    ),
    "simulation": ("simulate",),
}
_NAMESPACES = (
    "blackbox",
    "change_detection",
    "comparison",
    "discovery",
    "effects",
    "errors",
    "estimation",
    "experiment",
    "experiment_design",
    "export",
    "fmu",
    "frequency",
    "identifiability",
    "plots",
    "rendering",
    "residuals",
    "result",
    "signals",
    "simulation",
    "uncertainty",
)
_HOME = {name: f"greybox.{module}" for module, names in _NAMES.items() for name in names}

__all__ = [
    "Balance",
    "Characteristic",
    "DryFriction",
    "Effect",
    "Experiment",
    "Fit",
    "FitOptions",
    "GreyboxError",
    "Input",
    "Model",
    "Output",
    "Parameter",
    "SignalLimit",
    "State",
    "blackbox",
    "change_detection",
    "compare",
    "comparison",
    "design",
    "detect_changes",
    "discover",
    "discovery",
    "effect",
    "effects",
    "errors",
    "estimation",
    "experiment",
    "experiment_design",
    "export",
    "fit",
    "fmu",
    "frequency",
    "identifiability",
    "linearise",
    "load_fit",
    "multistart",
    "plots",
    "predict",
    "read_csv",
    "read_experiments",
    "rendering",
    "report",
    "residual_tests",
    "residuals",
    "result",
    "signals",
    "simulate",
    "simulation",
    "smooth",
    "uncertainty",
    "validate",
]


def __getattr__(name: str) -> Any:
    if name in _NAMESPACES:
        return import_module(f"greybox.{name}")
    if name not in _HOME:
        raise AttributeError(f"module 'greybox' has no attribute {name!r}")
    value = getattr(import_module(_HOME[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
