"""Implicit steps for stiff models: the midpoint rule and Radau IIA with two stages.

The stage equations are solved by a fixed number of Newton iterations with the Jacobian at the start of the step, written out as
ordinary instructions, so that both kernels run them and differentiate them exactly.
"""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca

from greybox.errors import ModelError
from greybox.integrators.composition import make_step
from greybox.integrators.step import AdvanceFunction, InputHistory, RateFunction, Step
from greybox.model.system import System

MOST_STATES = 8
ITERATIONS = 4  # each gains one order in h, and the methods are of order 2 and 3


def midpoint(system: System, substeps: int = 1, past: InputHistory | None = None) -> Step:
    """``x+ = x + h f((x + x+) / 2)``: order 2, symplectic, stable for every decaying mode (A-stable), damps none of them.

    A mode much faster than the step rings on without decay: take `radau` for those. Raises ModelError beyond 8 states.
    """
    return make_step("implicit midpoint", _small(system), midpoint_step, substeps, past)


def radau(system: System, substeps: int = 1, past: InputHistory | None = None) -> Step:
    """Radau IIA with two stages: order 3, L-stable, modes much faster than the step die out at once.

    Hairer, Wanner, Solving Ordinary Differential Equations II, table IV.5.5. Raises ModelError beyond 8 states.
    """
    return make_step("Radau IIA", _small(system), radau_step, substeps, past)


def midpoint_step(rate: RateFunction) -> AdvanceFunction:
    """The implicit midpoint rule for ``dx/dt = rate(x, u, p)``."""

    def advance(x: ca.SX, ua: ca.SX, ub: ca.SX, p: ca.SX, h: ca.SX) -> ca.SX:
        middle = (ua + ub) / 2
        matrix = ca.SX.eye(x.numel()) - h / 2 * _jacobian(rate, x, middle, p)
        z = ca.SX.zeros(x.numel())  # half the increment
        solve = _solver(matrix)
        for _ in range(ITERATIONS):
            z = z + solve(h / 2 * rate(x + z, middle, p) - z)
        return x + 2 * z

    return advance


def radau_step(rate: RateFunction) -> AdvanceFunction:
    """Radau IIA (two stages) for ``dx/dt = rate(x, u, p)``."""
    (a11, a12), (a21, a22) = (5 / 12, -1 / 12), (3 / 4, 1 / 4)

    def advance(x: ca.SX, ua: ca.SX, ub: ca.SX, p: ca.SX, h: ca.SX) -> ca.SX:
        u1 = ua + (ub - ua) / 3
        one = ca.SX.eye(x.numel())
        j = h * _jacobian(rate, x, ua, p)
        # (I - A x J) z = r by blocks: they are polynomials of J and commute, so one matrix of the size of the model is left.
        solve = _solver(one - (a11 + a22) * j + (a11 * a22 - a12 * a21) * (j @ j))
        z1 = z2 = ca.SX.zeros(x.numel())
        for _ in range(ITERATIONS):
            k1, k2 = h * rate(x + z1, u1, p), h * rate(x + z2, ub, p)
            r1, r2 = a11 * k1 + a12 * k2 - z1, a21 * k1 + a22 * k2 - z2
            z1 = z1 + solve(r1 - j @ (a22 * r1 - a12 * r2))
            z2 = z2 + solve(r2 - j @ (a11 * r2 - a21 * r1))
        return x + z2

    return advance


def _small(system: System) -> System:
    states = system.x.numel()
    if states > MOST_STATES:
        raise ModelError(
            f"implicit methods take up to {MOST_STATES} states, this model has {states}; use 'rk4' or 'mixed'"
        )
    return system


def _jacobian(rate: RateFunction, x: ca.SX, u: ca.SX, p: ca.SX) -> ca.SX:
    point = ca.SX.sym("point", x.numel())
    return ca.densify(ca.substitute(ca.jacobian(rate(point, u, p), point), point, x))


def _solver(matrix: ca.SX) -> Callable[[ca.SX], ca.SX]:
    """``r -> matrix^-1 r``, written out (QR, which needs no exchange of rows); the factors are shared between calls by `casadi.cse`."""

    def solve(r: ca.SX) -> ca.SX:
        return ca.densify(ca.solve(matrix, r))

    return solve
