"""The exact hold of a large sparse linear model by the series of its exponential, applied to the state and never formed.

The matrices of `greybox.simulation.integrators.exact_hold` are dense, and so are their slopes along each constant: a pass over a record
costs ``n^2`` for every row and constant, and the slopes take ``n^2`` numbers for each. The equations of a large plant are sparse. For
``dx/dt = A x + B u + c`` with an input that moves along a straight line from ``ua`` to ``ub``, Horner's scheme of the series

    z_m = x + (h / m) (A z_(m+1) + B w_m + c),   w_m = ua + (ub - ua) / (m + 1),   z_(M+1) = x,   x+ = z_1

takes ``M`` evaluations of the equations. Tangents run along with it, as with RK4, and take ``n`` numbers for each constant.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import casadi as ca
import numpy as np

from greybox.base import ModelError
from greybox.model import System
from greybox.simulation.integrators.composition import make_step
from greybox.simulation.integrators.runge_kutta import compute_fastest_rate
from greybox.simulation.integrators.step import AdvanceFunction, RateFunction, Step

# Largest ``|h lambda|`` of a substep: the terms of the series are then no larger than its sum, and no digits are lost.
TAYLOR_REACH = 1.0
# What the series leaves out of the motion of the fastest mode in a substep, where constants have moved and that mode is twice as fast.
TAYLOR_REMAINDER = 1e-10


def choose_taylor_order(rate_times_step: float) -> int:
    """Fewest terms ``M`` of the series for ``|h lambda|`` of the fastest mode: ``(2 |h lambda|)^(M + 1) / (M + 1)!`` is negligible."""
    order, left = 1, 2 * rate_times_step
    while left > TAYLOR_REMAINDER:
        order += 1
        left *= 2 * rate_times_step / order
    return max(order - 1, 1)


def taylor(system: System, order: int, substeps: int = 1) -> Step:
    """The series of so many terms. Raises ModelError for a model that is not linear, and for one with a delayed input."""
    if not system.linear:
        raise ModelError("the series needs equations that are linear in the states and inputs; use RK4")
    # (|h lambda|)^(M + 1) / (M + 1)! is what the remainder may be.
    reach = (TAYLOR_REMAINDER * math.factorial(order + 1)) ** (1 / (order + 1))
    return make_step(f"series of order {order}", system, make_taylor_method(order), substeps, None, reach)


def make_taylor_method(order: int) -> Callable[[RateFunction], AdvanceFunction]:
    """The series of so many terms for ``dx/dt = rate(x, u, p)``, linear in ``x`` and ``u``."""

    def one_step(rate: RateFunction) -> AdvanceFunction:
        def advance(x: ca.SX, ua: ca.SX, ub: ca.SX, p: ca.SX, h: ca.SX) -> ca.SX:
            z = x
            for m in range(order, 0, -1):
                # z_m = x + (h / m) f(z_(m+1), ua + (ub - ua) / (m + 1))
                z = x + h / m * rate(z, ua + (ub - ua) / (m + 1), p)
            return z

        return advance

    return one_step


# Measured on chains of masses on springs of 16 to 200 states, one core of an Intel Xeon with AVX-512: what one row and direction of a pass
# costs for each entry of the equations and term of the series, and for each entry of the dense matrices, with which the pass multiplies
# the tangents and what drives them (s).
TAYLOR_ENTRY, DENSE_ENTRY = 3.0e-10, 8.5e-11
# What the calls of the matrix library cost for each row beside their arithmetic (s).
DENSE_ROW = 4e-6
# What it costs once to lay out the instructions, for each entry and term (s): the matrices have none.
TAYLOR_LAYOUT = 2.5e-4
# Passes over the records that a search takes, from a start that is not far off.
PASSES = 10


def choose_taylor_step(
    system: System, p: np.ndarray, longest: float, rows: int, directions: int
) -> tuple[int, int] | None:
    """Order and substeps of the series where a search takes less time with it than with dense matrices; None where it does not.

    Parameters
    ----------
    system
        Linear equations.
    p
        Parameters (np,).
    longest
        The longest sampling interval in seconds.
    rows, directions
        Rows of all records, and directions along which their tangents run.
    """
    n, inputs = system.x.numel(), system.u.numel()
    jacobian = system.jacobian(np.zeros(n), np.zeros(inputs), p).full()
    reach = longest * compute_fastest_rate(jacobian, ())
    substeps = max(1, math.ceil(reach / TAYLOR_REACH))
    order = choose_taylor_order(reach / substeps)
    runs, terms = PASSES * rows, np.count_nonzero(jacobian) * order
    by_series = terms * (TAYLOR_LAYOUT + TAYLOR_ENTRY * substeps * directions * runs)
    by_matrices = (DENSE_ROW + DENSE_ENTRY * n * (2 * n + inputs + 1) * directions) * runs
    return (order, substeps) if by_series < by_matrices else None
