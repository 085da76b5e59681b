"""Classical Runge-Kutta of order four."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import casadi as ca
import numpy as np

from greybox.base import ModelError
from greybox.base.numerics import PHI_SERIES_BELOW, PHI_SERIES_TERMS
from greybox.model import System
from greybox.simulation.integrators.composition import make_step
from greybox.simulation.integrators.step import (
    AdvanceFunction,
    InputHistory,
    IntegrationMethod,
    RateFunction,
    Step,
    call_function,
)

# States that relax, ``dz/dt = alpha - beta z`` with ``beta`` of any size: stepped by their exponential, the others by RK4.
#
# Over one substep alpha and beta are those in its middle, where a half step predicts the other states; then
# ``z+ = z exp(-beta h) + alpha (1 - exp(-beta h)) / beta``. Where beta depends on parameters alone (a coil, a spool) alpha is a straight
# line through start and middle instead, which is exact for a ramp. The other states see the straight line that has the mean and
# the first moment of ``z`` over the substep, so that a force ``s1 dz/dt`` acts with ``dz/dt`` averaged over it. Second order in ``h``, and
# stable whatever ``beta h`` is (exponential time differencing: Cox, Matthews 2002, J. Comput. Phys. 176, 430).


def mixed(system: System, numbers: Sequence[int], substeps: int = 1, past: InputHistory | None = None) -> Step:
    """RK4, with the states ``numbers`` (of `find_fast_relaxing_states`) stepped by their exponential, declared relaxing or not.

    With a coil current (``Ra / La``) or a spool out of the way the slow states decide the step. Of order 2. Raises ModelError if
    the model has no such state.
    """
    if not numbers:
        raise ModelError(
            "'mixed' needs a fast state whose rate is linear in itself with a coefficient of parameters alone; use 'rk4'"
        )
    return make_step("RK4 with exponentials", system, make_exponential_method(numbers), substeps, past)


def find_fast_relaxing_states(system: System, p: np.ndarray, x: np.ndarray) -> tuple[int, ...]:
    """Numbers of the states declared relaxing, and of those that relax faster than all the others move.

    The own rate of such a state is linear in it with a coefficient of parameters alone, and that coefficient is larger than
    every eigenvalue of the equations without it, at the parameters ``p`` (np,) and each of the states ``x`` (k, nx).
    """
    others = ca.vertcat(system.x, system.u, system.direction)
    fast_states = set(system.relaxing)
    u = np.zeros(system.u.numel())
    jacobians = [call_function(system.jacobian, row, u, p)[0] for row in x]
    for k in range(system.x.numel()):
        own_rate = ca.jacobian(system.rhs[k], system.x[k])
        has_friction = any(d.state == k for d in system.dry)
        if not has_friction and not own_rate.is_zero() and not ca.depends_on(own_rate, others) and jacobians:
            # Faster than every other mode at all points: else its exponential takes accuracy (order 2) and gains no
            # substep.
            fast_states |= {k} if all(abs(j[k, k]) > compute_fastest_rate(j, [k]) for j in jacobians) else set()
    return tuple(sorted(fast_states))


def compute_fastest_rate(jacobian: np.ndarray, excluded: Sequence[int]) -> float:
    """The largest eigenvalue (1/s) of a Jacobian without the own rates of some states; 0 if it is not finite."""
    remaining = jacobian.copy()
    # Only the own rate: what couples the state to the others still counts, an inductance behind a spring included.
    remaining[list(excluded), list(excluded)] = 0.0
    return float(np.abs(np.linalg.eigvals(remaining)).max(initial=0.0)) if np.isfinite(remaining).all() else 0.0


def make_exponential_method(numbers: Sequence[int]) -> IntegrationMethod:
    """The method for a model whose states ``numbers`` relax."""

    def one_step(rate: RateFunction) -> AdvanceFunction:
        def advance(x: ca.SX, ua: ca.SX, ub: ca.SX, p: ca.SX, h: ca.SX) -> ca.SX:
            middle = (ua + ub) / 2
            start = [_linear_coefficients(rate, k, x, ua, p) for k in numbers]
            # Prediction to the middle: half a step with alpha, beta of the start, order 1, enough for a method of
            # order 2.
            early = [_relax_over_step(x[k], a, 0, b, h / 2) for k, (a, b, _) in zip(numbers, start, strict=True)]
            # The other states to the middle by the midpoint rule, seeing the line through the relaxing ones.
            slope = rate(_replace_states(x, numbers, [z.at(0) for z in early]), ua, p)
            slope = rate(_replace_states(x + h / 4 * slope, numbers, [z.mean for z in early]), (ua + middle) / 2, p)
            halfway = x + h / 2 * slope
            halfway = _replace_states(halfway, numbers, [z.end for z in early])
            courses = []
            for k, (first, _, steady) in zip(numbers, start, strict=True):
                alpha, beta, _ = _linear_coefficients(rate, k, halfway, middle, p)
                # Line through alpha at the start and in the middle; with a beta that moves, alpha alone as a line
                # would not be second order, so both are held at the middle.
                ramp = 2 * (alpha - first) if steady else 0
                # ``alpha`` is that of the middle; the line begins half the ramp before it.
                courses.append(_relax_over_step(x[k], alpha - ramp / 2, ramp, beta, h))
            at = [[z.at(share) for z in courses] for share in (0, 0.5, 1)]
            k1 = rate(_replace_states(x, numbers, at[0]), ua, p)
            k2 = rate(_replace_states(x + h / 2 * k1, numbers, at[1]), middle, p)
            k3 = rate(_replace_states(x + h / 2 * k2, numbers, at[1]), middle, p)
            k4 = rate(_replace_states(x + h * k3, numbers, at[2]), ub, p)
            return _replace_states(x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4), numbers, [z.end for z in courses])

        return advance

    return one_step


class RelaxationCourse(NamedTuple):
    """A relaxing state over one step: its end, and the straight line with its mean and first moment."""

    end: ca.SX
    mean: ca.SX
    rise: ca.SX

    def at(self, share: float) -> ca.SX:
        """The straight line after this share of the step."""
        return self.mean + self.rise * (share - 0.5)


def _relax_over_step(z: ca.SX, alpha: ca.SX, ramp: ca.SX | float, beta: ca.SX, h: ca.SX) -> RelaxationCourse:
    """``dz/dt = alpha + ramp t / h - beta z`` over ``h`` seconds."""
    beta_h = beta * h
    phi = [_phi(k, beta_h) for k in range(5)]
    # z+ = phi_0 z + h (phi_1 alpha + phi_2 ramp); integrals over the step raise each index by one.
    sums = [phi[k] * z + h * (phi[k + 1] * alpha + phi[k + 2] * ramp) for k in range(3)]
    # z at the end, its integral over the step and the integral of that (both over shares of the step)
    end, mean, twice = sums
    # Line m + r (s - 1/2) with the first moment of z: r = 12 int (s - 1/2) z ds = 12 (mean / 2 - twice).
    return RelaxationCourse(end, mean, 12 * (mean / 2 - twice))


def _phi(order: int, w: ca.SX) -> ca.SX:
    """``phi_0 = exp(-w)``, ``phi_(k+1) = (1/k! - phi_k) / w``; near zero by their series ``sum (-w)^j / (j + k)!``."""
    if order == 0:
        return ca.exp(-w)
    # (1/k! - phi_k) / w cancels near zero: the series takes over. Each branch gets a harmless argument where the
    # other counts, so that neither its value nor its slope overflows.
    near = ca.fabs(w) < PHI_SERIES_BELOW
    small, large = ca.if_else(near, w, 0), ca.if_else(near, 1, w)
    series = ca.SX(0)
    for j in reversed(range(PHI_SERIES_TERMS)):
        series = series * -small + 1 / math.factorial(j + order)
    closed = ca.exp(-large)
    for k in range(order):
        closed = (1 / math.factorial(k) - closed) / large
    return ca.if_else(near, series, closed)


def _linear_coefficients(rate: RateFunction, k: int, x: ca.SX, u: ca.SX, p: ca.SX) -> tuple[ca.SX, ca.SX, bool]:
    """alpha and beta of state ``k`` at one point, and whether beta depends on parameters alone."""
    z = ca.SX.sym("z")
    value = rate(_replace_states(x, [k], [z]), u, p)[k]
    beta = -ca.jacobian(value, z)
    # Decided from the expressions, once: the choice must not change from step to step.
    steady = not ca.depends_on(beta, ca.vertcat(z, *ca.symvar(ca.vertcat(x, u))))
    at_point = ca.substitute(ca.vertcat(value, beta), z, x[k])
    # |z| in the rate: beta holds on this side of zero.
    return at_point[0] + at_point[1] * x[k], at_point[1], steady


def _replace_states(x: ca.SX, numbers: Sequence[int], values: Sequence[ca.SX]) -> ca.SX:
    changed = ca.SX(x)
    for k, value in zip(numbers, values, strict=True):
        changed[k] = value
    return changed


def rk4(system: System, substeps: int = 1, past: InputHistory | None = None) -> Step:
    """RK4 step: ``x+ = x + h/6 (k1 + 2 k2 + 2 k3 + k4)``, error of order h^4; the input is linear within the step.

    Not for stiff models: the fastest mode decides the number of substeps, see `choose_substeps`. States declared relaxing are stepped
    by their exponential and do not count as fast; the whole is then of order 2, see `greybox.simulation.integrators.runge_kutta`.
    """
    return make_step(
        "RK4", system, make_exponential_method(system.relaxing) if system.relaxing else rk4_step, substeps, past
    )


def rk4_step(rate: RateFunction) -> AdvanceFunction:
    """RK4 for ``dx/dt = rate(x, u, p)``."""

    def advance(x: ca.SX, ua: ca.SX, ub: ca.SX, p: ca.SX, h: ca.SX) -> ca.SX:
        middle = (ua + ub) / 2
        k1 = rate(x, ua, p)
        k2 = rate(x + h / 2 * k1, middle, p)
        k3 = rate(x + h / 2 * k2, middle, p)
        k4 = rate(x + h * k3, ub, p)
        return x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)

    return advance
