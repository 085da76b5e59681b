"""Pick the discretisation that suits a model and its data."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from greybox.errors import ModelError, nearest
from greybox.integrators.exact_hold import exact_hold
from greybox.integrators.exponential_relaxation import find_fast_relaxing_states, mixed
from greybox.integrators.implicit import midpoint, radau
from greybox.integrators.input_delay import required_history
from greybox.integrators.rk4 import rk4
from greybox.integrators.step import InputHistory, Step
from greybox.integrators.substeps import choose_substeps, refine_substeps
from greybox.model.system import System

METHODS = ("automatic", "exact", "rk4", "mixed", "midpoint", "radau")
IMPLICIT = {"midpoint": midpoint, "radau": radau}
# The exact hold needs one matrix exponential for each distinct interval length.
MOST_LENGTHS = 200
# Steps that are kept, for the next fit of the same equations at other values.
KEPT = 64


def discretise(
    system: System,
    p: np.ndarray,
    x: np.ndarray,
    lengths: np.ndarray,
    *,
    method: str = "automatic",
    substeps: int = 0,
    target: float = 0.0,
    inputs: np.ndarray | None = None,
) -> Step:
    """One discrete step of ``system`` for records whose intervals have the given ``lengths`` (s).

    ``automatic`` takes the exact hold for a linear model (unless the time is so irregular that every interval has a length of
    its own) and RK4 otherwise; ``mixed``, ``midpoint`` and ``radau`` are for stiff nonlinear models. ``substeps`` per sample: 0 ties
    them to the fastest eigenvalue at the parameters ``p`` (np,) and the states ``x`` (k, nx), for the implicit methods to one.

    ``target``: with a positive one that number is only the first guess, and is doubled until a run over the rows ``inputs`` (N, nu),
    from the first of the states ``x``, changes by less than this share of its movement on halving. Raises ModelError for an
    unknown method, the exact hold of a nonlinear model, or a target without inputs.
    """
    if method not in METHODS:
        raise ModelError(f"unknown discretisation {method!r}; {nearest(method, METHODS)}")
    if target > 0 and (inputs is None or len(x) == 0):
        raise ModelError(
            f"the error target {target:g} needs inputs (N, nu) and a state to run from; give both, or substeps"
        )
    past = required_history(system, lengths)
    few = len(lengths) <= MOST_LENGTHS
    if method == "exact" or (method == "automatic" and system.linear and few):
        return _exact(system, past)
    longest = float(np.max(lengths, initial=0.0))
    fast = find_fast_relaxing_states(system, p, x) if method == "mixed" else system.relaxing
    n = substeps or (1 if method in IMPLICIT else choose_substeps(system, p, x, longest, relaxing=fast))

    def make(count: int) -> Step:
        return _stepped(method, system, tuple(fast), count, past)

    if target <= 0 or inputs is None or substeps:
        return make(n)
    return refine_substeps(target, make, n, p, x[0], inputs, longest)


@lru_cache(maxsize=KEPT)
def _exact(system: System, past: InputHistory | None) -> Step:
    return exact_hold(system, past)


@lru_cache(maxsize=KEPT)
def _stepped(method: str, system: System, fast: tuple[int, ...], substeps: int, past: InputHistory | None) -> Step:
    if method == "mixed":
        return mixed(system, fast, substeps, past)
    return IMPLICIT.get(method, rk4)(system, substeps, past)
