"""From a model to one discrete step: the exact hold for linear models, Runge-Kutta for the others."""

from greybox.integrators.choose import METHODS, discretise
from greybox.integrators.exact_hold import exact_hold
from greybox.integrators.rk4 import rk4, substeps_for
from greybox.integrators.step import Step

__all__ = ["METHODS", "Step", "discretise", "exact_hold", "rk4", "substeps_for"]
