"""The slopes of a model's equations: as expressions, and as numbers along a run."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np

from greybox.model import System


def differentiate_equations(system: System, *, slide: bool = False) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:
    """``A, B, C, D`` of ``dx/dt = A x + B u, y = C x + D u`` as expressions of states, inputs and constants.

    Dry friction is left out: it has no slope. With ``slide`` every state that is set after each step stands where that puts one from
    far away, at the end of its play.
    """
    rates, outputs = ca.substitute(system.rhs, system.direction, ca.SX.zeros(len(system.dry))), system.outputs
    for update in system.updates if slide else ():
        state = system.x[update.state]
        reached = ca.substitute(update.value, state, ca.inf)
        rates, outputs = (ca.substitute(e, state, reached) for e in (rates, outputs))
    a, b, c, d = (ca.jacobian(e, along) for e in (rates, outputs) for along in (system.x, system.u))
    return a, b, c, d


def linearise_along(
    system: System, x: np.ndarray, u: np.ndarray, p: np.ndarray, *, slide: bool = False, others: Sequence[ca.SX] = ()
) -> list[np.ndarray]:
    """``A`` (R, nx, nx), ``B``, ``C``, ``D`` along a run, and ``others``; one entry each (R = 1) where they are the same all along.

    Parameters
    ----------
    system
        The equations.
    x, u, p
        States (R, nx), inputs (R, nu) and constants (np,).
    slide
        As of `differentiate_equations`.
    others
        Further matrices of states, inputs and constants to evaluate.
    """
    matrices = [*differentiate_equations(system, slide=slide), *others]
    signals = ca.vertcat(system.x, system.u)
    rows = slice(None) if any(ca.depends_on(m, signals) for m in matrices) else slice(0, 1)
    evaluate = ca.Function("slopes", [system.x, system.u, system.p], [ca.densify(ca.vec(m.T)) for m in matrices])
    values = evaluate(x[rows].T, u[rows].T, p)
    return [v.full().T.reshape(len(x[rows]), *m.shape) for v, m in zip(values, matrices, strict=True)]
