"""Classical Runge-Kutta of order four."""

from __future__ import annotations

import casadi as ca

from greybox.integrators.composition import make_step
from greybox.integrators.exponential_relaxation import make_exponential_method
from greybox.integrators.step import AdvanceFunction, InputHistory, RateFunction, Step
from greybox.model.system import System


def rk4(system: System, substeps: int = 1, past: InputHistory | None = None) -> Step:
    """RK4 step: ``x+ = x + h/6 (k1 + 2 k2 + 2 k3 + k4)``, error of order h^4; the input is linear within the step.

    Not for stiff models: the fastest mode decides the number of substeps, see `choose_substeps`. States declared relaxing are stepped
    by their exponential and do not count as fast; the whole is then of order 2, see `greybox.integrators.exponential_relaxation`.
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
