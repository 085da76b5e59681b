"""Implicit steps for stiff models: the midpoint rule and Radau IIA with two stages.

The stage equations are solved by a fixed number of Newton iterations, written out as ordinary instructions, so that both kernels run them
and differentiate them exactly. Each has the Jacobian where it stands: with that of the start a stiff mode whose stiffness grows, as of a
cubic spring, would leave by more with every iteration, and shorter steps would not bring it back.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import casadi as ca

from greybox.base import ModelError
from greybox.model import System
from greybox.simulation.integrators.composition import make_step
from greybox.simulation.integrators.step import AdvanceFunction, InputHistory, IntegrationMethod, RateFunction, Step


def midpoint(system: System, substeps: int = 1, past: InputHistory | None = None) -> Step:
    """``x+ = x + h f((x + x+) / 2)``: order 2, symplectic, stable for every decaying mode (A-stable), damps none of them.

    A mode much faster than the step rings on without decay: take `radau` for those. Raises ModelError beyond the states that
    ``policy`` allows.
    """
    step = make_step("implicit midpoint", _require_few_states(system), midpoint_step(), substeps, past)
    return replace(step, implicit=True)


def radau(system: System, substeps: int = 1, past: InputHistory | None = None) -> Step:
    """Radau IIA with two stages: order 3, L-stable, modes much faster than the step die out at once.

    Hairer, Wanner, Solving Ordinary Differential Equations II, table IV.5.5. Raises ModelError beyond the states that ``policy`` allows.
    """
    return replace(make_step("Radau IIA", _require_few_states(system), radau_step(), substeps, past), implicit=True)


# Newton iterations of an implicit step. Each gains an order in ``h`` at least; the methods are of order two and three. What they leave of a
# large jump is found by halving the step: the next one goes on from there.
NEWTON_ITERATIONS = 4


def midpoint_step() -> IntegrationMethod:
    """The implicit midpoint rule for ``dx/dt = rate(x, u, p)``."""

    def make_advance(rate: RateFunction) -> AdvanceFunction:
        def advance(x: ca.SX, ua: ca.SX, ub: ca.SX, p: ca.SX, h: ca.SX) -> ca.SX:
            middle = (ua + ub) / 2
            z = ca.SX.zeros(x.numel())  # half the increment
            for _ in range(NEWTON_ITERATIONS):
                # (I - h J / 2) dz = h f(x + z) / 2 - z
                solve = _make_solver(ca.SX.eye(x.numel()) - h / 2 * _jacobian(rate, x + z, middle, p))
                z = z + solve(h / 2 * rate(x + z, middle, p) - z)
            return x + 2 * z

        return advance

    return make_advance


def radau_step() -> IntegrationMethod:
    """Radau IIA (two stages) for ``dx/dt = rate(x, u, p)``."""
    # Butcher's table with c = (1/3, 1): the second stage is the end of the step.
    (a11, a12), (a21, a22) = (5 / 12, -1 / 12), (3 / 4, 1 / 4)

    def make_advance(rate: RateFunction) -> AdvanceFunction:
        def advance(x: ca.SX, ua: ca.SX, ub: ca.SX, p: ca.SX, h: ca.SX) -> ca.SX:
            # The input at c1 = 1/3; at c2 = 1 it is ``ub``.
            u1 = ua + (ub - ua) / 3
            one = ca.SX.eye(x.numel())
            z1 = z2 = ca.SX.zeros(x.numel())
            for _ in range(NEWTON_ITERATIONS):
                # With the Jacobian at the end of the step for both stages (I - A x J) z = r goes by blocks: they are polynomials of J and
                # commute, so one matrix of the size of the model is left.
                j = h * _jacobian(rate, x + z2, ub, p)
                solve = _make_solver(one - (a11 + a22) * j + (a11 * a22 - a12 * a21) * (j @ j))
                k1, k2 = h * rate(x + z1, u1, p), h * rate(x + z2, ub, p)
                r1, r2 = a11 * k1 + a12 * k2 - z1, a21 * k1 + a22 * k2 - z2
                # Cramer's rule on blocks: the inverse of I - A x J is the adjugate over the determinant polynomial
                # that ``solve`` takes.
                z1 = z1 + solve(r1 - j @ (a22 * r1 - a12 * r2))
                z2 = z2 + solve(r2 - j @ (a11 * r2 - a21 * r1))
            # Stiffly accurate: x+ is the last stage itself, hence L-stable.
            return x + z2

        return advance

    return make_advance


# States for which the implicit methods are written out: their linear equations become scalar instructions.
MAX_IMPLICIT_STATES = 8


def _require_few_states(system: System) -> System:
    states = system.x.numel()
    if states > MAX_IMPLICIT_STATES:
        raise ModelError(
            f"implicit methods take up to {MAX_IMPLICIT_STATES} states, this model has {states}; use 'rk4' or 'mixed'"
        )
    return system


def _jacobian(rate: RateFunction, x: ca.SX, u: ca.SX, p: ca.SX) -> ca.SX:
    # `x` may be an expression, by which CasADi does not differentiate.
    point = ca.SX.sym("point", x.numel())
    return ca.densify(ca.substitute(ca.jacobian(rate(point, u, p), point), point, x))


def _make_solver(matrix: ca.SX) -> Callable[[ca.SX], ca.SX]:
    """``r -> matrix^-1 r``, written out (QR, which needs no exchange of rows); the factors are shared between calls by `casadi.cse`."""

    def solve(r: ca.SX) -> ca.SX:
        return ca.densify(ca.solve(matrix, r))

    return solve
