"""The discretisation that suits a model and its records."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from greybox.base import ModelError, nearest
from greybox.model import System
from greybox.simulation.integrators.esdirk import MOST_STATES, esdirk
from greybox.simulation.integrators.exact_hold import exact_hold
from greybox.simulation.integrators.implicit import MAX_IMPLICIT_STATES, midpoint, radau
from greybox.simulation.integrators.input_delay import add_input_history, require_history
from greybox.simulation.integrators.runge_kutta import compute_fastest_rate, find_fast_relaxing_states, mixed, rk4
from greybox.simulation.integrators.step import MANY_STATES, InputHistory, Step, call_function
from greybox.simulation.integrators.taylor import choose_taylor_step, taylor


@dataclass(frozen=True)
class DiscretisationPolicy:
    """How a model is divided in steps.

    Parameters
    ----------
    eigenvalue_step
        Largest ``|h lambda|`` of an explicit substep. RK4 is stable up to 2.785; at 0.5 it follows a fast mode to a few parts in ten
        thousand.
    max_substeps
        Substeps in one sampling interval; a model that asks for more is stiff and gets an implicit method.
    """

    eigenvalue_step: float = 0.5
    max_substeps: int = 1000


DEFAULT_POLICY = DiscretisationPolicy()


def follow_step(policy: DiscretisationPolicy, step: Step) -> DiscretisationPolicy:
    """``policy`` with substeps as long as the method of ``step`` takes them."""
    return policy if step.reach is None else replace(policy, eigenvalue_step=step.reach)


# How many substeps: from the fastest eigenvalue as a first guess, and from the error measured by halving.


def choose_substeps(
    system: System,
    p: np.ndarray,
    x: np.ndarray,
    longest: float,
    *,
    relaxing: Sequence[int] | None = None,
    policy: DiscretisationPolicy = DEFAULT_POLICY,
) -> int:
    """Number of RK4 substeps for the longest sampling interval, from the fastest eigenvalue.

    A model with a delayed input takes twice as many, for the two sides of the cut.

    Parameters
    ----------
    system
        The equations.
    p, x
        Parameters (np,) and the states (k, nx) at which the equations are linearised.
    longest
        The longest sampling interval in seconds.
    relaxing
        States whose own rate does not count, because their exponential is exact. None: those declared as relaxing.
    policy
        The largest ``|h lambda|`` of a substep, and the most substeps.
    """
    x = x[:1] if system.linear else x  # the eigenvalues are the same at every state
    u = np.zeros(system.u.numel())
    exact_states = list(system.relaxing if relaxing is None else relaxing)
    fastest = max(
        (compute_fastest_rate(call_function(system.jacobian, row, u, p)[0], exact_states) for row in x), default=0.0
    )
    # h max|lambda| <= eigenvalue_step, with h = longest / number.
    number = max(1, math.ceil(longest * fastest / policy.eigenvalue_step))
    # With a delayed input either side of the cut takes half of them, and may be nearly the whole interval.
    return min(2 * number if system.delays else number, policy.max_substeps)


# Rows at the beginning of a record over which the integration error is measured by halving the step.
ERROR_ROWS = 2000


def refine_substeps(
    target: float,
    make: Callable[[int], Step],
    first: int,
    p: np.ndarray,
    x0: np.ndarray,
    inputs: np.ndarray,
    length: float,
    policy: DiscretisationPolicy = DEFAULT_POLICY,
) -> Step:
    """The step with the fewest of ``first``, ``2 first``, ``4 first``, ... substeps that is within the ``target``.

    Its run over ``inputs`` (N, nu), held over intervals of ``length`` seconds, differs from that with half the substep by at most
    ``target`` times the movement of each state (root-mean-square). A run that overflows is not within any target.
    """
    step = make(first)
    path = run_step(step, p, x0, inputs, length, ERROR_ROWS)
    while step.substeps < policy.max_substeps:
        finer = make(2 * step.substeps)
        finer_path = run_step(finer, p, x0, inputs, length, ERROR_ROWS)
        # The coarser step is kept, whose error the difference is: for order 4 the finer one is 16 times nearer.
        # Movement from the first row, not the size of the state, is the measure: a level far from zero would hide
        # every error.
        if np.isfinite(finer_path).all() and np.all(
            _rms(path - finer_path) <= target * _rms(finer_path - finer_path[0])
        ):
            return step
        step, path = finer, finer_path
    return step


def run_step(
    step: Step, p: np.ndarray, x0: np.ndarray, inputs: np.ndarray, length: float, rows: int = ERROR_ROWS
) -> np.ndarray:
    """States (N, nx) at the first ``rows`` of ``inputs`` (., nu), held over intervals of ``length`` seconds, without a kernel."""
    u = np.asarray(inputs, float)[:rows]
    if step.past is not None:
        # The delayed input is held like the others: this run measures the step alone.
        u = add_input_history(u, np.full(len(u) - 1, length), step.past, first_order=False)
    q, _ = step.coefficients(p, np.array([length]), np.empty(0, int))
    path = np.empty((len(u), len(x0)))
    path[0] = x0
    advance, share = step.advance.mapaccum(step.substeps), np.arange(step.substeps + 1) / step.substeps
    common = np.repeat(q.T, step.substeps, axis=1), np.full((1, step.substeps), length / step.substeps)
    for k in range(len(u) - 1):
        # The flags of a delayed input run from row to row, everything else is held.
        ends = u[k][:, None] + (u[k + 1] - u[k])[:, None] * (share if step.past is not None else 0 * share)
        path[k + 1] = call_function(advance, path[k], ends[:, :-1], ends[:, 1:], *common)[0][:, -1]
    return path


def _rms(values: np.ndarray) -> np.ndarray:
    with np.errstate(over="ignore", invalid="ignore"):
        return np.sqrt(np.mean(values**2, axis=0))


EXPLICIT = {"rk4": rk4}
"""Methods whose substeps are tied to the fastest eigenvalue: ``(system, substeps, past) -> Step``."""

IMPLICIT = {"midpoint": midpoint, "radau": radau}
"""Methods that take stiff modes in one step: ``(system, substeps, past) -> Step``."""

ADAPTIVE = "esdirk"
"""The method whose steps follow the error, whatever the lengths of the intervals are."""

METHODS = ("automatic", "exact", *EXPLICIT, "mixed", *IMPLICIT, ADAPTIVE)
"""What may be asked for."""


# Explicit substeps in an interval from which an implicit method is taken in their place; where fewer are allowed, the run is meant to be
# a coarse one.
MOST_EXPLICIT_SUBSTEPS = 1000


def choose_implicit_method(system: System, *, written_out: bool = False) -> str:
    """The method that suits a stiff model; "" where there is none.

    Steps that follow the error for a smooth model: those of one length may agree with half of themselves where both jump over what
    happens between two rows. Radau IIA for few states where the model is not smooth, or the step must be ``written_out`` as instructions.
    """
    if not (written_out or system.dry or system.updates or system.delays) and system.x.numel() <= MOST_STATES:
        return ADAPTIVE
    return "radau" if system.x.numel() <= MAX_IMPLICIT_STATES else ""


# Distinct interval lengths for which the exact hold is taken: each needs a matrix exponential of its own.
MAX_INTERVAL_LENGTHS = 200
# Ratio of the longest interval to the shortest up to which all are stepped alike.
ALIKE_LENGTHS = 1.5
# Numbers that the coefficients of all lengths may take with their slopes along every parameter: 320 MB.
MAX_HOLD_NUMBERS = 4e7


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
    rows: int = 0,
    directions: int = 0,
    written_out: bool = False,
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
        own), by its series where the model is so large and sparse that this costs less, and RK4 otherwise, but an implicit method
        where that would need more substeps than the policy allows.
        ``exact``, ``rk4``, ``mixed`` (RK4 with exponentials of fast relaxing states), and for stiff nonlinear
        models ``midpoint``, ``radau`` and ``esdirk``, whose steps follow the error.
    substeps
        Substeps in each sampling interval. 0 ties them to the fastest eigenvalue; the implicit methods then take one.
    target
        With a positive target that number is only the first guess: it is doubled until a run over ``inputs`` (N, nu), from the first of
        the states ``x``, changes by less than this share of its movement when the step is halved.
    rows, directions
        Rows of all records over which a search will run it, and directions of the tangents: what a large linear model costs decides how
        its exact hold is computed (`greybox.simulation.integrators.taylor`). Zero for single runs.
    written_out
        Whether the step must be written out as instructions, as a filter or an export takes it; then its length is fixed.
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
    past = require_history(system, lengths)
    # An exact hold costs one exponential for each length, once in each pass; RK4 costs the same whatever the lengths
    # are.
    numbers = len(lengths) * system.x.numel() ** 2 * (1 + system.p.numel())
    few_lengths = len(lengths) <= MAX_INTERVAL_LENGTHS and (numbers <= MAX_HOLD_NUMBERS or len(lengths) == 1)
    uneven_delay = past is not None and past.uneven
    if method == "exact" and uneven_delay:
        raise ModelError(
            f"the exact hold with a delayed input needs one sampling time, the intervals run from {min(lengths):g} to {max(lengths):g} s;"
            " use RK4, or resample the record"
        )
    longest = float(np.max(lengths, initial=0.0))
    # Where intervals differ much, each is best taken whole.
    is_even = longest <= ALIKE_LENGTHS * float(np.min(lengths, initial=longest))
    if (
        method == "automatic"
        and rows
        and is_even
        and system.linear
        and past is None
        and system.x.numel() >= MANY_STATES
    ):
        chosen = choose_taylor_step(system, p, longest, rows, directions)
        if chosen is not None:
            return _make_taylor(system, chosen[0], substeps or chosen[1])
    if method == "exact" or (method == "automatic" and system.linear and few_lengths and not uneven_delay):
        return _make(system, "exact", (), 1, past)
    # As written out they take few states only, and steps that follow the error cannot be written out.
    if (method in IMPLICIT and system.x.numel() > MAX_IMPLICIT_STATES) or (method == ADAPTIVE and written_out):
        method = choose_implicit_method(system, written_out=written_out) or method
    fast = find_fast_relaxing_states(system, p, x) if method == "mixed" else system.relaxing
    first = substeps or (
        # An implicit step is stable at any length; whether it is accurate is what ``target`` asks.
        1 if method in (*IMPLICIT, ADAPTIVE) else choose_substeps(system, p, x, longest, relaxing=fast, policy=policy)
    )
    if method == "automatic" and not substeps and first >= max(policy.max_substeps, MOST_EXPLICIT_SUBSTEPS):
        implicit = choose_implicit_method(system, written_out=written_out)
        method, first = (implicit, 1) if implicit else (method, first)

    def make(count: int) -> Step:
        return _make(system, method, tuple(fast), count, past)

    if target <= 0 or inputs is None or substeps:
        return make(first)
    return refine_substeps(target, make, first, p, x[0], inputs, longest, policy)


# Both for the next fit of the same equations at other values.
_make_taylor = lru_cache(maxsize=64)(taylor)


@lru_cache(maxsize=256)
def _make(system: System, method: str, fast: tuple[int, ...], substeps: int, past: InputHistory | None) -> Step:
    if method == "exact":
        return exact_hold(system, past)
    if method == "mixed":
        return mixed(system, fast, substeps, past)
    if method == ADAPTIVE:
        return esdirk(system, substeps)
    return (IMPLICIT | EXPLICIT).get(method, rk4)(system, substeps, past)
