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
    from greybox import (
        blackbox,
        change_detection,
        discovery,
        effects,
        errors,
        estimation,
        experiment,
        experiment_design,
        export,
        fmu,
        frequency,
        identifiability,
        plots,
        rendering,
        residuals,
        result,
        signals,
        simulation,
        uncertainty,
    )
    from greybox.change_detection import detect_changes
    from greybox.comparison import compare
    from greybox.discovery import discover
    from greybox.effects import effect
    from greybox.errors import GreyboxError
    from greybox.estimation import FitOptions, fit, multistart, predict, smooth, validate
    from greybox.experiment import Experiment, read_csv, read_experiments
    from greybox.experiment_design import SignalLimit, design
    from greybox.export import linearise
    from greybox.model import Balance, Characteristic, DryFriction, Effect, Model
    from greybox.model.signals import Input, Output, Parameter, State
    from greybox.reports import report
    from greybox.residuals import residual_tests
    from greybox.result import Fit, load_fit
    from greybox.simulation import simulate

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
