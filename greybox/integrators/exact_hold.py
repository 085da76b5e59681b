"""Exact discretisation of a linear model: the matrix exponential, for a held input and for one that is linear between samples."""

from __future__ import annotations

import casadi as ca
import numpy as np

from greybox.errors import ModelError
from greybox.integrators.casadi_call import call_function
from greybox.integrators.delayed_hold import DelayedHold
from greybox.integrators.input_delay import count_history_columns, delay_outputs
from greybox.integrators.matrix_exponential import compute_exponentials, index_hold_entries
from greybox.integrators.step import InputHistory, Step
from greybox.model.system import System


def exact_hold(system: System, past: InputHistory | None = None) -> Step:
    """``x+ = Phi x + G1 [ua; 1] + G2 [ub - ua; 0]``, exact for ``dx/dt = A x + B u + c``.

    With ``n`` states and ``m`` inputs the three blocks are the first rows of ``expm([[A h, B h, 0], [0, 0, I], [0, 0, 0]])``
    (Van Loan 1978; Franklin, Powell, Workman, first-order hold). A delayed input needs its ``past``: see
    `greybox.integrators.delayed_hold`. Raises ModelError for a model that is not linear.
    """
    if not system.linear:
        raise ModelError("the exact hold needs equations that are linear in the states and inputs; use RK4")
    if system.delays and past is None:
        raise ModelError(f"the delayed input of {system.delays[0].effect!r} needs its past; use discretise")
    nx, nu = system.x.numel(), system.u.numel()
    columns = nu + count_history_columns(past)
    x, ua, ub, h = ca.SX.sym("x", nx), ca.SX.sym("ua", columns), ca.SX.sym("ub", columns), ca.SX.sym("h")
    phi, g1, g2 = ca.SX.sym("phi", nx, nx), ca.SX.sym("g1", nx, nu + 1), ca.SX.sym("g2", nx, nu)
    q = ca.vertcat(ca.vec(phi), ca.vec(g1), ca.vec(g2))
    u_start, u_ramp = ua[:nu], (ub - ua)[:nu]
    outputs, matrices = system.output_function, _make_matrices(system)
    delayed = None
    if past is not None:
        u_ramp = u_ramp * ua[-2]
        delayed = DelayedHold(system, past, ua, ub)
        u_start[past.column] = u_ramp[past.column] = 0
        q, outputs = ca.vertcat(q, delayed.q), delay_outputs(system, past)
    following = phi @ x + g1 @ ca.vertcat(u_start, 1) + g2 @ u_ramp + (delayed.share if delayed else 0)
    places = index_hold_entries(nx, nu)

    def coefficients(p: np.ndarray, lengths: np.ndarray, which: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        generator, along = call_function(matrices, p)
        size = len(generator)
        slopes = along.T.reshape(-1, size, size)[which].transpose(0, 2, 1)
        exponentials_by_length = compute_exponentials(generator, slopes, lengths, nx)
        q, dq = exponentials_by_length.flat(places)
        if delayed is None:
            return q, dq
        gains = [
            delayed.gains(exponentials_by_length.of(k), generator, slopes, p, which, length)
            for k, length in enumerate(lengths)
        ]
        return np.hstack([q, [g for g, _ in gains]]), np.hstack([dq, [dg for _, dg in gains]])

    advance = ca.Function("advance", [x, ua, ub, q, h], [following])
    generator = None if delayed else _make_generator(system)
    return Step("exact hold", advance, outputs, coefficients, per_interval=True, past=past, generator=generator)


def _make_generator(system: System) -> ca.Function:
    """``p -> vec([A, B, c])`` of ``dx/dt = A x + B u + c``."""
    xu = ca.vertcat(system.x, system.u)
    constant = ca.substitute(system.rhs, xu, ca.SX.zeros(xu.numel()))
    whole = ca.horzcat(ca.jacobian(system.rhs, xu), constant)
    return ca.Function("generator", [system.p], [ca.densify(ca.vec(whole))])


def _make_matrices(system: System) -> ca.Function:
    """``p -> (M, d vec(M) / d p)`` with ``M = [[A, [B c], 0], [0, 0, I], [0, 0, 0]]`` per second.

    The identity block stands for the ramp of the input over one interval: it is not multiplied by the interval length, and left
    out here.
    """
    nx, size = system.x.numel(), system.x.numel() + 2 * (system.u.numel() + 1)
    rows = ca.reshape(_make_generator(system)(system.p), nx, nx + system.u.numel() + 1)
    m = ca.SX.zeros(size, size)
    m[:nx, : rows.size2()] = rows
    return ca.Function("matrices", [system.p], [ca.densify(m), ca.densify(ca.jacobian(ca.vec(m), system.p))])
