"""The optimiser: IPOPT. The only room that names the solver."""

from greybox.optim.ipopt_dense import minimise
from greybox.optim.ipopt_sparse import solve_sparse
from greybox.optim.status import IterationCallback, MinimisationResult, QuadraticModel, TerminationStatus

__all__ = ["IterationCallback", "MinimisationResult", "QuadraticModel", "TerminationStatus", "minimise", "solve_sparse"]
