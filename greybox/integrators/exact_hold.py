"""Exact discretisation of a linear model: the matrix exponential, for a held input and for one that is linear between samples."""

from __future__ import annotations

import casadi as ca
import numpy as np
from scipy.linalg import expm

from greybox.errors import ModelError
from greybox.integrators.step import Step
from greybox.model.system import System


def exact_hold(system: System) -> Step:
    """``x+ = Phi x + G1 [ua; 1] + G2 [ub - ua; 0]``, exact for ``dx/dt = A x + B u + c``.

    With ``n`` states and ``m`` inputs the three blocks are the first rows of ``expm([[A h, B h, 0], [0, 0, I], [0, 0, 0]])``
    (Van Loan 1978; Franklin, Powell, Workman, first-order hold). Raises ModelError for a model that is not linear.
    """
    if not system.linear:
        raise ModelError("the exact hold needs equations that are linear in the states and inputs; use RK4")
    nx, nu = system.x.numel(), system.u.numel()
    x, ua, ub, h = ca.SX.sym("x", nx), ca.SX.sym("ua", nu), ca.SX.sym("ub", nu), ca.SX.sym("h")
    phi, g1, g2 = ca.SX.sym("phi", nx, nx), ca.SX.sym("g1", nx, nu + 1), ca.SX.sym("g2", nx, nu)
    q = ca.vertcat(ca.vec(phi), ca.vec(g1), ca.vec(g2))
    following = phi @ x + g1 @ ca.vertcat(ua, 1) + g2 @ (ub - ua)
    advance = ca.Function("advance", [x, ua, ub, q, h], [following])
    matrices = _matrices(system)

    def coefficients(p: np.ndarray, lengths: np.ndarray, which: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        m, dm = (np.asarray(block) for block in matrices(p))
        size = nx + 2 * (nu + 1)
        generator = m.reshape(size, size, order="F")
        slopes = dm.reshape(size, size, -1, order="F")[:, :, which]
        rows = [_exponential(generator, slopes, length, nx) for length in lengths]
        return np.array([q for q, _ in rows]), np.array([dq for _, dq in rows])

    return Step("exact hold", advance, system.output_function, coefficients, per_interval=True)


def _matrices(system: System) -> ca.Function:
    """``p -> (generator, d generator / d p)`` with generator ``[[A, [B c], 0], [0, 0, I], [0, 0, 0]]`` per second, flattened.

    The identity block stands for the ramp of the input over one interval: it is not multiplied by the interval length.
    """
    nx, nu = system.x.numel(), system.u.numel()
    a = ca.jacobian(system.rhs, system.x)
    b = ca.jacobian(system.rhs, system.u)
    c = ca.substitute(system.rhs, ca.vertcat(system.x, system.u), ca.SX.zeros(nx + nu))
    size = nx + 2 * (nu + 1)
    generator = ca.SX.zeros(size, size)
    generator[:nx, :nx] = a
    generator[:nx, nx : nx + nu + 1] = ca.horzcat(b, c)
    flat = ca.vec(generator)
    return ca.Function("matrices", [system.p], [ca.densify(flat), ca.densify(ca.jacobian(flat, system.p))])


def _exponential(generator: np.ndarray, slopes: np.ndarray, length: float, nx: int) -> tuple[np.ndarray, np.ndarray]:
    """Step coefficients for one interval length, and their derivatives by the exponential of ``[[M, dM], [0, M]]``."""
    size, n = generator.shape[0], slopes.shape[2]
    inputs = (size - nx) // 2
    scaled = generator * length
    scaled[nx : nx + inputs, nx + inputs :] = np.eye(inputs)
    if not (np.isfinite(scaled).all() and np.isfinite(slopes).all()):
        nq = nx * (nx + inputs + inputs - 1)
        return np.full(nq, np.nan), np.full((nq, n), np.nan)
    if n == 0:
        return _flat(expm(scaled), nx, inputs), np.empty((nx * (nx + inputs + inputs - 1), 0))
    pairs = np.zeros((n, 2 * size, 2 * size))
    pairs[:, :size, :size] = pairs[:, size:, size:] = scaled
    pairs[:, :size, size:] = np.moveaxis(slopes, 2, 0) * length
    exponentials = expm(pairs)
    derivatives = [_flat(e[:size, size:], nx, inputs) for e in exponentials]
    return _flat(exponentials[0, :size, :size], nx, inputs), np.array(derivatives).T


def _flat(e: np.ndarray, nx: int, inputs: int) -> np.ndarray:
    """``[vec Phi, vec G1, vec G2]``; the constant's column has no ramp."""
    phi, g1, g2 = e[:nx, :nx], e[:nx, nx : nx + inputs], e[:nx, nx + inputs : nx + 2 * inputs - 1]
    return np.concatenate([block.ravel(order="F") for block in (phi, g1, g2)])
