"""greybox: from measured data of an actuator to physical constants with honest intervals.

The verbs: `read_csv`, `simulate`, `fit`, `validate`. A model is a list of named balances; ``model + effect`` is a new model.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from greybox.blackbox import (
        Candidate,
        HammersteinModel,
        PolynomialModel,
        Scan,
        Smoothing,
        armax,
        arx,
        best_black_boxes,
        box_jenkins,
        digits_needed,
        hammerstein,
        monte_carlo_smoothing,
        output_error,
        resample,
        rounded,
        scan_structures,
    )
    from greybox.comparison import Comparison, compare
    from greybox.diagnose import ResidualTests, Scores, diagnose_residuals, scores
    from greybox.discovery import (
        Attempt,
        Deepened,
        Discovery,
        Unexplained,
        discover,
        drop_effect,
        further,
        try_effect,
        unexplained,
    )
    from greybox.effects import CATALOGUE, effect
    from greybox.errors import DataError, FitError, GreyboxError, ModelError, UnitError
    from greybox.experiment import Experiment, read_csv, read_experiments
    from greybox.export import (
        Family,
        Linearisation,
        OperatingPoint,
        family,
        linearise,
        nonlinear_system,
        operating_point,
        to_c,
        to_control,
        to_fmu,
        to_json,
        to_mat,
        to_modelica,
        to_numpy,
        to_python,
    )
    from greybox.fitting import (
        FitOptions,
        Predictor,
        Smoothed,
        fit,
        multistart,
        predict,
        predictor,
        smooth,
        validate,
    )
    from greybox.model import Balance, DryFriction, Effect, Model
    from greybox.reports import report
    from greybox.result import Estimate, Fit, Misfit, load_fit
    from greybox.signals import Input, Output, Parameter, State
    from greybox.simulation import Simulation, simulate
    from greybox.uncertainty import Bootstrap, Profile, bootstrap, profile

# Where each public name lives. Loaded when first asked for: stating a model should not load a solver.
_ROOMS = {
    "blackbox": (
        *("Candidate", "HammersteinModel", "PolynomialModel", "Scan", "Smoothing", "armax", "arx", "best_black_boxes"),
        *(
            "box_jenkins",
            "digits_needed",
            "hammerstein",
            "monte_carlo_smoothing",
            "output_error",
            "resample",
            "rounded",
        ),
        "scan_structures",
    ),
    "comparison": ("Comparison", "compare"),
    "diagnose": ("ResidualTests", "Scores", "diagnose_residuals", "scores"),
    "discovery": (
        *("Attempt", "Deepened", "Discovery", "Unexplained", "discover", "drop_effect", "further", "try_effect"),
        "unexplained",
    ),
    "effects": ("CATALOGUE", "effect"),
    "errors": ("DataError", "FitError", "GreyboxError", "ModelError", "UnitError"),
    "experiment": ("Experiment", "read_csv", "read_experiments"),
    "export": (
        *("Family", "Linearisation", "OperatingPoint", "family", "linearise", "nonlinear_system", "operating_point"),
        *("to_c", "to_control", "to_fmu", "to_json", "to_mat", "to_modelica", "to_numpy", "to_python"),
    ),
    "fitting": (
        *("FitOptions", "Predictor", "Smoothed", "fit", "multistart"),
        *("predict", "predictor", "smooth", "validate"),
    ),
    "model": ("Balance", "DryFriction", "Effect", "Model"),
    "reports": ("report",),
    "result": ("Estimate", "Fit", "Misfit", "load_fit"),
    "signals": ("Input", "Output", "Parameter", "State"),
    "simulation": ("Simulation", "simulate"),
    "uncertainty": ("Bootstrap", "Profile", "bootstrap", "profile"),
}
_HOME = {name: f"greybox.{room}" for room, names in _ROOMS.items() for name in names}

__all__ = [
    "CATALOGUE",
    "Attempt",
    "Balance",
    "Bootstrap",
    "Candidate",
    "Comparison",
    "DataError",
    "Deepened",
    "Discovery",
    "DryFriction",
    "Effect",
    "Estimate",
    "Experiment",
    "Family",
    "Fit",
    "FitError",
    "FitOptions",
    "GreyboxError",
    "HammersteinModel",
    "Input",
    "Linearisation",
    "Misfit",
    "Model",
    "ModelError",
    "OperatingPoint",
    "Output",
    "Parameter",
    "PolynomialModel",
    "Predictor",
    "Profile",
    "ResidualTests",
    "Scan",
    "Scores",
    "Simulation",
    "Smoothed",
    "Smoothing",
    "State",
    "Unexplained",
    "UnitError",
    "armax",
    "arx",
    "best_black_boxes",
    "bootstrap",
    "box_jenkins",
    "compare",
    "diagnose_residuals",
    "digits_needed",
    "discover",
    "drop_effect",
    "effect",
    "family",
    "fit",
    "further",
    "hammerstein",
    "linearise",
    "load_fit",
    "monte_carlo_smoothing",
    "multistart",
    "nonlinear_system",
    "operating_point",
    "output_error",
    "predict",
    "predictor",
    "profile",
    "read_csv",
    "read_experiments",
    "report",
    "resample",
    "rounded",
    "scan_structures",
    "scores",
    "simulate",
    "smooth",
    "to_c",
    "to_control",
    "to_fmu",
    "to_json",
    "to_mat",
    "to_modelica",
    "to_numpy",
    "to_python",
    "try_effect",
    "unexplained",
    "validate",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'greybox' has no attribute {name!r}")
    value = getattr(import_module(_HOME[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
