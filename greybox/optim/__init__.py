"""Minimisation of sums of squares and of sparse programs. The only package that calls IPOPT."""

from greybox.optim.ipopt_dense import minimise
from greybox.optim.ipopt_sparse import solve_sparse
from greybox.optim.policy import DampedGaussNewtonPolicy, GradientSamplingPolicy, MinimisationPolicy, TerminationPolicy
from greybox.optim.quadratic_model import QuadraticModel
from greybox.optim.status import IterationCallback, MinimisationResult, TerminationStatus
from greybox.optim.termination import Termination

__all__ = [
    "DampedGaussNewtonPolicy",
    "GradientSamplingPolicy",
    "IterationCallback",
    "MinimisationPolicy",
    "MinimisationResult",
    "QuadraticModel",
    "Termination",
    "TerminationPolicy",
    "TerminationStatus",
    "minimise",
    "solve_sparse",
]
