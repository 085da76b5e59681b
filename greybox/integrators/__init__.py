"""From a model to one discrete step: exact for linear models, Runge-Kutta with exponentials for relaxing states, implicit."""

from greybox.integrators.accuracy import substeps_for
from greybox.integrators.choose import METHODS, discretise
from greybox.integrators.exact_hold import exact_hold
from greybox.integrators.implicit import midpoint, radau
from greybox.integrators.relaxing import mixed
from greybox.integrators.rk4 import rk4
from greybox.integrators.step import Step

__all__ = ["METHODS", "Step", "discretise", "exact_hold", "midpoint", "mixed", "radau", "rk4", "substeps_for"]
