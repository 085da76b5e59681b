"""Classical Runge-Kutta of order four, with dry friction that sticks."""

from __future__ import annotations

import math
from collections.abc import Callable

import casadi as ca
import numpy as np

from greybox.integrators.dry import sticking
from greybox.integrators.step import Step
from greybox.model.system import System

# |h lambda| per substep. RK4 is stable up to 2.785; at 0.5 a fast mode is followed to a few parts in ten thousand.
TARGET = 0.5
MOST_SUBSTEPS = 128


def rk4(system: System, substeps: int = 1) -> Step:
    """RK4 step: ``x+ = x + h/6 (k1 + 2 k2 + 2 k3 + k4)``, error of order h^4; the input is linear within the step.

    Not for stiff models: the fastest mode decides the number of substeps, see `substeps_for`.
    """
    x, p = ca.SX.sym("x", system.x.numel()), ca.SX.sym("p", system.p.numel())
    ua, ub, h = ca.SX.sym("ua", system.u.numel()), ca.SX.sym("ub", system.u.numel()), ca.SX.sym("h")
    advance = sticking(system, one_step) if system.dry else one_step(ca.Function("f", [system.x, system.u, system.p], [system.rhs]))
    function = ca.Function("advance", [x, ua, ub, p, h], [ca.cse(advance(x, ua, ub, p, h))])
    return Step("RK4", function, system.output_function, parameters_themselves, substeps)


Rate = Callable[[ca.SX, ca.SX, ca.SX], ca.SX]
Advance = Callable[[ca.SX, ca.SX, ca.SX, ca.SX, ca.SX], ca.SX]


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


def parameters_themselves(p: np.ndarray, lengths: np.ndarray, which: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients of a step that takes the parameters as they are: one row for every interval length."""
    return p[None, :], np.eye(len(p))[None, :, which]


def substeps_for(system: System, p: np.ndarray, x: np.ndarray, longest: float, target: float = TARGET) -> int:
    """Number of RK4 substeps for an interval of ``longest`` seconds, from the fastest eigenvalue at states ``x`` (k, nx)."""
    u = np.zeros(system.u.numel())
    rates = [np.abs(np.linalg.eigvals(j)).max() for row in x if np.isfinite(j := system.jacobian(row, u, p).full()).all()]
    fastest = max(rates, default=0.0)
    return int(min(max(1, math.ceil(longest * fastest / target)), MOST_SUBSTEPS))
