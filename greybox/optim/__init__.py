"""Minimisation of sums of squares and of sparse programs. The only package that calls IPOPT."""

from greybox.optim.ipopt_sparse import solve_sparse
from greybox.optim.methods import MinimisationMethod, minimise
from greybox.optim.policy import GaussNewtonPolicy, GradientSamplingPolicy, MinimisationPolicy, TerminationPolicy
from greybox.optim.quadratic_model import QuadraticModel
from greybox.optim.status import IterationCallback, MinimisationResult, TerminationStatus
from greybox.optim.termination import Termination

__all__ = [
    "GaussNewtonPolicy",
    "GradientSamplingPolicy",
    "IterationCallback",
    "MinimisationMethod",
    "MinimisationPolicy",
    "MinimisationResult",
    "QuadraticModel",
    "Termination",
    "TerminationPolicy",
    "TerminationStatus",
    "minimise",
    "solve_sparse",
]
