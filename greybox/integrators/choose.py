"""Pick the discretisation that suits a model and its data."""

from __future__ import annotations

import numpy as np

from greybox.errors import ModelError, nearest
from greybox.integrators.exact_hold import exact_hold
from greybox.integrators.rk4 import rk4, substeps_for
from greybox.integrators.step import Step
from greybox.model.system import System

METHODS = ("automatic", "exact", "rk4")
# The exact hold needs one matrix exponential for each distinct interval length.
MOST_LENGTHS = 200


def discretise(
    system: System, p: np.ndarray, x: np.ndarray, lengths: np.ndarray, *, method: str = "automatic", substeps: int = 0
) -> Step:
    """One discrete step of ``system`` for records whose intervals have the given ``lengths`` (s).

    ``automatic`` takes the exact hold for a linear model (unless the time is so irregular that every interval has a length of
    its own) and RK4 otherwise. ``substeps`` of RK4 per sample: 0 ties them to the fastest eigenvalue at the parameters ``p``
    (np,) and the states ``x`` (k, nx). Raises ModelError for an unknown method, or the exact hold of a nonlinear model.
    """
    if method not in METHODS:
        raise ModelError(f"unknown discretisation {method!r}; {nearest(method, METHODS)}")
    few = len(lengths) <= MOST_LENGTHS
    if method == "exact" or (method == "automatic" and system.linear and few):
        return exact_hold(system)
    longest = float(np.max(lengths, initial=0.0))
    return rk4(system, substeps or substeps_for(system, p, x, longest))
