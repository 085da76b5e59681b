"""From a model to one discrete step: exact for linear models, Runge-Kutta with exponentials for relaxing states, implicit."""

from greybox.integrators.discretisation import METHODS, discretise
from greybox.integrators.exact_hold import exact_hold
from greybox.integrators.exponential_relaxation import mixed
from greybox.integrators.implicit import midpoint, radau
from greybox.integrators.policy import DiscretisationPolicy
from greybox.integrators.rk4 import rk4
from greybox.integrators.step import Step
from greybox.integrators.substeps import choose_substeps

__all__ = [
    "METHODS",
    "DiscretisationPolicy",
    "Step",
    "choose_substeps",
    "discretise",
    "exact_hold",
    "midpoint",
    "mixed",
    "radau",
    "rk4",
]
