"""The discretisation that suits a model and its records."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from greybox.errors import ModelError, nearest
from greybox.integrators.exact_hold import exact_hold
from greybox.integrators.exponential_relaxation import find_fast_relaxing_states, mixed
from greybox.integrators.implicit import midpoint, radau
from greybox.integrators.input_delay import require_history
from greybox.integrators.policy import DEFAULT_POLICY, DiscretisationPolicy
from greybox.integrators.rk4 import rk4
from greybox.integrators.step import InputHistory, Step
from greybox.integrators.substeps import choose_substeps, refine_substeps
from greybox.model.system import System

EXPLICIT = {"rk4": rk4}
"""Methods whose substeps are tied to the fastest eigenvalue: ``(system, substeps, past) -> Step``."""

IMPLICIT = {"midpoint": midpoint, "radau": radau}
"""Methods that take stiff modes in one step: ``(system, substeps, past, policy) -> Step``."""

METHODS = ("automatic", "exact", *EXPLICIT, "mixed", *IMPLICIT)
"""What may be asked for."""


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
    policy: DiscretisationPolicy = DEFAULT_POLICY,
) -> Step:
    """One discrete step of ``system`` for records with given interval lengths.

    Parameters
    ----------
    system
        The equations.
    p, x
        Parameters (np,) and states (k, nx) at which the fastest eigenvalue is taken.
    lengths
        The distinct interval lengths of the records, in seconds.
    method
        ``automatic`` takes the exact hold for a linear model (unless the time is so irregular that every interval has a length of its
        own) and RK4 otherwise. ``exact``, ``rk4``, ``mixed`` (RK4 with exponentials of fast relaxing states), and for stiff nonlinear
        models ``midpoint`` and ``radau``.
    substeps
        Substeps in each sampling interval. 0 ties them to the fastest eigenvalue; the implicit methods then take one.
    target
        With a positive target that number is only the first guess: it is doubled until a run over ``inputs`` (N, nu), from the first of
        the states ``x``, changes by less than this share of its movement when the step is halved.
    policy
        How fine a step has to be, and what the methods can take.

    Raises
    ------
    ModelError
        For an unknown method, the exact hold of a nonlinear model, a target without inputs, or a delay that cannot be stepped.
    """
    if method not in METHODS:
        raise ModelError(f"unknown discretisation {method!r}; {nearest(method, METHODS)}")
    if target > 0 and (inputs is None or len(x) == 0):
        raise ModelError(
            f"the error target {target:g} needs inputs (N, nu) and a state to run from; give both, or substeps"
        )
    past = require_history(system, lengths, policy)
    few_lengths = len(lengths) <= policy.max_interval_lengths
    if method == "exact" or (method == "automatic" and system.linear and few_lengths):
        return _make_exact(system, past)
    longest = float(np.max(lengths, initial=0.0))
    fast = find_fast_relaxing_states(system, p, x) if method == "mixed" else system.relaxing
    first = substeps or (
        1 if method in IMPLICIT else choose_substeps(system, p, x, longest, relaxing=fast, policy=policy)
    )

    def make(count: int) -> Step:
        return _make_stepped(method, system, tuple(fast), count, past, policy)

    if target <= 0 or inputs is None or substeps:
        return make(first)
    return refine_substeps(target, make, first, p, x[0], inputs, longest, policy)


@lru_cache(maxsize=64)  # for the next fit of the same equations at other values
def _make_exact(system: System, past: InputHistory | None) -> Step:
    return exact_hold(system, past)


@lru_cache(maxsize=64)
def _make_stepped(
    method: str,
    system: System,
    fast: tuple[int, ...],
    substeps: int,
    past: InputHistory | None,
    policy: DiscretisationPolicy,
) -> Step:
    if method == "mixed":
        return mixed(system, fast, substeps, past)
    if method in IMPLICIT:
        return IMPLICIT[method](system, substeps, past, policy)
    return EXPLICIT.get(method, rk4)(system, substeps, past)
