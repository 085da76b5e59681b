"""Classical Runge-Kutta of order four."""

from __future__ import annotations

import casadi as ca

from greybox.integrators.compose import stepped
from greybox.integrators.relaxing import relaxing
from greybox.integrators.step import Advance, Past, Rate, Step
from greybox.model.system import System


def rk4(system: System, substeps: int = 1, past: Past | None = None) -> Step:
    """RK4 step: ``x+ = x + h/6 (k1 + 2 k2 + 2 k3 + k4)``, error of order h^4; the input is linear within the step.

    Not for stiff models: the fastest mode decides the number of substeps, see `substeps_for`. States declared relaxing are stepped
    by their exponential and do not count as fast; the whole is then of order 2, see `greybox.integrators.relaxing`.
    """
    return stepped("RK4", system, relaxing(system.relaxing) if system.relaxing else one_step, substeps, past)


def one_step(rate: Rate) -> Advance:
    """RK4 for ``dx/dt = rate(x, u, p)``."""

    def advance(x: ca.SX, ua: ca.SX, ub: ca.SX, p: ca.SX, h: ca.SX) -> ca.SX:
        middle = (ua + ub) / 2
        k1 = rate(x, ua, p)
        k2 = rate(x + h / 2 * k1, middle, p)
        k3 = rate(x + h / 2 * k2, middle, p)
        k4 = rate(x + h * k3, ub, p)
        return x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)

    return advance
