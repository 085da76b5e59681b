"""greybox: from measured data of an actuator to physical parameters with honest intervals.

The verbs of the first week stand here: `read_csv`, `simulate`, `fit`, `validate`, `residual_tests`, `compare`, `discover`,
`detect_changes`, `linearise`, `report`, `plot`, `design`. A model is a list of named balances; ``model + effect`` is a new model.

Everything else is in a namespace: ``gb.signals`` (test signals), ``gb.effects`` (the catalogue), ``gb.blackbox``, ``gb.discovery``,
``gb.changes``, ``gb.identifiability``, ``gb.uncertainty`` (profile likelihood, bootstrap), ``gb.residuals``,
``gb.export``, ``gb.fleet`` (many records), ``gb.frequency`` (frequency responses), ``gb.fmu``, ``gb.robots``, ``gb.errors``.
"""

from __future__ import annotations

import os
import sys
import warnings
from importlib import import_module

TYPE_CHECKING = False  # as type checkers read it; importing typing takes longer than all the rest
if TYPE_CHECKING:
    from typing import Any

    from greybox.base import errors
    from greybox.base.errors import GreyboxError
    from greybox.comparison.compare import compare
    from greybox.data import signals
    from greybox.data.experiment import Experiment
    from greybox.data.noise.growing import GrowingNoise
    from greybox.data.read import read_csv, read_experiments
    from greybox.data.signals import SignalLimit
    from greybox.discovery.pipeline import discover
    from greybox.estimation.fit import fit
    from greybox.estimation.linear.linearise import linearise
    from greybox.estimation.multistart import multistart
    from greybox.estimation.options import FitOptions
    from greybox.estimation.predictor import predict, smooth
    from greybox.estimation.residuals import residual_tests
    from greybox.estimation.result import Fit, load_fit
    from greybox.estimation.validate import validate
    from greybox.extensions import changes, export, fleet, fmu
    from greybox.extensions import robot as robots
    from greybox.extensions.changes.detect import detect_changes
    from greybox.extensions.design.next_record import design
    from greybox.extensions.fleet.batch import fit_each
    from greybox.extensions.robot.model import robot
    from greybox.model import effects
    from greybox.model.balance import Balance
    from greybox.model.characteristic import Characteristic
    from greybox.model.effect import DryFriction, Effect
    from greybox.model.effects.catalogue import effect
    from greybox.model.model import Model
    from greybox.model.signals import Input, Output, Parameter, State
    from greybox.show import plot, report
    from greybox.simulation.simulate import simulate

    from greybox import comparison, data, discovery, estimation, simulation  # isort: skip
    from greybox.comparison import blackbox, frequency  # isort: skip
    from greybox.estimation import identifiability, residuals, uncertainty  # isort: skip

# Where each name lives. Loaded when first asked for: stating a model should not load a solver.
_NAMES = {
    "comparison.compare": ("compare",),
    "discovery.pipeline": ("discover",),
    "model.effects.catalogue": ("effect",),
    "base.errors": ("GreyboxError",),
    "estimation.fit": ("fit",),
    "estimation.linear.linearise": ("linearise",),
    "estimation.multistart": ("multistart",),
    "estimation.options": ("FitOptions",),
    "estimation.predictor": ("predict", "smooth"),
    "estimation.residuals": ("residual_tests",),
    "estimation.result": ("Fit", "load_fit"),
    "estimation.validate": ("validate",),
    "data.experiment": ("Experiment",),
    "data.noise.growing": ("GrowingNoise",),
    "data.read": ("read_csv", "read_experiments"),
    "extensions.changes.detect": ("detect_changes",),
    "extensions.design.next_record": ("design",),
    "extensions.fleet.batch": ("fit_each",),
    "extensions.robot.model": ("robot",),
    "data.signals": ("SignalLimit",),
    "model": ("Balance", "Characteristic", "DryFriction", "Effect", "Model"),
    "model.signals": ("Input", "Output", "Parameter", "State"),
    "show": ("plot", "report"),
    "simulation.simulate": ("simulate",),
}
_HOME = {name: f"greybox.{module}" for module, names in _NAMES.items() for name in names}
# The namespaces that users know, and the packages that they are: `gb.signals.chirp`.
_NAMESPACES = {
    "blackbox": "comparison.blackbox",
    "changes": "extensions.changes",
    "comparison": "comparison",
    "data": "data",
    "discovery": "discovery",
    "effects": "model.effects",
    "errors": "base.errors",
    "estimation": "estimation",
    "export": "extensions.export",
    "fleet": "extensions.fleet",
    "fmu": "extensions.fmu",
    "frequency": "comparison.frequency",
    "identifiability": "estimation.identifiability",
    "residuals": "estimation.residuals",
    "robots": "extensions.robot",
    "signals": "data.signals",
    "simulation": "simulation",
    "uncertainty": "estimation.uncertainty",
}

__all__ = [
    "Balance",
    "Characteristic",
    "DryFriction",
    "Effect",
    "Experiment",
    "Fit",
    "FitOptions",
    "GreyboxError",
    "GrowingNoise",
    "Input",
    "Model",
    "Output",
    "Parameter",
    "SignalLimit",
    "State",
    "blackbox",
    "changes",
    "compare",
    "comparison",
    "data",
    "design",
    "detect_changes",
    "discover",
    "discovery",
    "effect",
    "effects",
    "errors",
    "estimation",
    "export",
    "fit",
    "fit_each",
    "fleet",
    "fmu",
    "frequency",
    "identifiability",
    "linearise",
    "load_fit",
    "multistart",
    "plot",
    "predict",
    "read_csv",
    "read_experiments",
    "report",
    "residual_tests",
    "residuals",
    "robot",
    "robots",
    "signals",
    "simulate",
    "simulation",
    "smooth",
    "uncertainty",
    "validate",
]


def __getattr__(name: str) -> Any:
    if name in _NAMESPACES:
        return import_module(f"greybox.{_NAMESPACES[name]}")
    if name not in _HOME:
        raise AttributeError(f"module 'greybox' has no attribute {name!r}")
    value = getattr(import_module(_HOME[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)


def _warn_of_namesake() -> None:
    """Tell of the distribution called ``greybox`` (a forecasting toolbox), which has the import name of this one, greybox-sysid.

    From the names of folders alone: reading metadata takes longer than all of this import.
    """
    for folder in sys.path:
        try:
            entries = os.listdir(folder or ".")
        except OSError:  # an archive, not there, or not ours to read
            continue
        for entry in entries:
            if entry.startswith(("greybox-", "Greybox-")) and entry.endswith((".dist-info", ".egg-info")):
                warnings.warn(
                    f"another package has the import name of greybox-sysid: {entry.rpartition('.')[0]} (a forecasting toolbox) in"
                    f" {folder}; the two overwrite each other's files, so keep them in separate environments: pip uninstall greybox,"
                    " then pip install --force-reinstall greybox-sysid",
                    stacklevel=3,
                )


_warn_of_namesake()
