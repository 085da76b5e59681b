"""The optimiser: IPOPT. The only room that names the solver."""

from greybox.optimiser.dense import minimise
from greybox.optimiser.outcome import Iteration, Outcome, Quadratic, Status
from greybox.optimiser.sparse import solve_sparse

__all__ = ["Iteration", "Outcome", "Quadratic", "Status", "minimise", "solve_sparse"]
