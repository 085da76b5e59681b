"""Exact discretisation of a linear model: the matrix exponential, for a held input and for one that is linear between samples."""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca
import numpy as np
from scipy.linalg import expm

from greybox.errors import ModelError
from greybox.integrators.late_hold import LateInput
from greybox.integrators.past import extra_columns, late_outputs
from greybox.integrators.step import Past, Step
from greybox.model.system import System


def exact_hold(system: System, past: Past | None = None) -> Step:
    """``x+ = Phi x + G1 [ua; 1] + G2 [ub - ua; 0]``, exact for ``dx/dt = A x + B u + c``.

    With ``n`` states and ``m`` inputs the three blocks are the first rows of ``expm([[A h, B h, 0], [0, 0, I], [0, 0, 0]])``
    (Van Loan 1978; Franklin, Powell, Workman, first-order hold). A delayed input needs its ``past``: see
    `greybox.integrators.late_hold`. Raises ModelError for a model that is not linear.
    """
    if not system.linear:
        raise ModelError("the exact hold needs equations that are linear in the states and inputs; use RK4")
    if system.delays and past is None:
        raise ModelError(f"the delayed input of {system.delays[0].effect!r} needs its past; use discretise")
    nx, nu = system.x.numel(), system.u.numel()
    columns = nu + extra_columns(past)
    x, ua, ub, h = ca.SX.sym("x", nx), ca.SX.sym("ua", columns), ca.SX.sym("ub", columns), ca.SX.sym("h")
    phi, g1, g2 = ca.SX.sym("phi", nx, nx), ca.SX.sym("g1", nx, nu + 1), ca.SX.sym("g2", nx, nu)
    q = ca.vertcat(ca.vec(phi), ca.vec(g1), ca.vec(g2))
    begin, run = ua[:nu], (ub - ua)[:nu]
    outputs, matrices = system.output_function, _matrices(system)
    late = None
    if past is not None:
        run = run * ua[-2]
        late = LateInput(system, past, ua, ub)
        begin[past.column] = run[past.column] = 0
        q, outputs = ca.vertcat(q, late.q), late_outputs(system, past)
    following = phi @ x + g1 @ ca.vertcat(begin, 1) + g2 @ run + (late.share if late else 0)

    def coefficients(p: np.ndarray, lengths: np.ndarray, which: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        m, dm = (np.asarray(block) for block in matrices(p))
        size = nx + 2 * (nu + 1)
        generator = m.reshape(size, size, order="F")
        slopes = dm.reshape(size, size, -1, order="F")[:, :, which]
        rows = []
        for length in lengths:
            whole = exponential(generator, slopes, length, nx)
            parts = [whole.flat()]
            if late is not None:
                seconds, by_p, rest = late.rest(p, length)
                after, drive = exponential(generator, slopes, rest, nx), generator[:nx, nx + late.past.column]
                parts.append(late.coefficients(whole, after, drive, seconds, by_p[which], length))
            rows.append(tuple(np.concatenate(values) for values in zip(*parts, strict=True)))
        return np.array([q for q, _ in rows]), np.array([dq for _, dq in rows])

    advance = ca.Function("advance", [x, ua, ub, q, h], [following])
    return Step("exact hold", advance, outputs, coefficients, per_interval=True, past=past)


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


class Blocks(NamedTuple):
    """``Phi`` (nx, nx), ``G1`` (nx, nu + 1), ``G2`` (nx, nu) of one length, and their slopes along n parameters (n, ...)."""

    values: tuple[np.ndarray, ...]
    slopes: tuple[np.ndarray, ...]

    def flat(self) -> tuple[np.ndarray, np.ndarray]:
        """Values (nq,) and slopes (nq, n), each block column by column."""
        n = len(self.slopes[0])
        values = np.concatenate([block.ravel(order="F") for block in self.values])
        return values, np.concatenate(
            [b.transpose(0, 2, 1).reshape(n, b.shape[1] * b.shape[2]) for b in self.slopes], axis=1
        ).T


def exponential(generator: np.ndarray, slopes: np.ndarray, length: float, nx: int) -> Blocks:
    """Blocks for one interval length, and their derivatives by the exponential of ``[[M, dM], [0, M]]``."""
    size, n = generator.shape[0], slopes.shape[2]
    inputs = (size - nx) // 2
    scaled = generator * length
    scaled[nx : nx + inputs, nx + inputs :] = np.eye(inputs)
    if not (np.isfinite(scaled).all() and np.isfinite(slopes).all()):
        return Blocks(
            _cut(np.full((size, size), np.nan), nx, inputs), _cut(np.full((n, size, size), np.nan), nx, inputs)
        )
    if n == 0:
        return Blocks(_cut(expm(scaled), nx, inputs), _cut(np.empty((0, size, size)), nx, inputs))
    pairs = np.zeros((n, 2 * size, 2 * size))
    pairs[:, :size, :size] = pairs[:, size:, size:] = scaled
    pairs[:, :size, size:] = np.moveaxis(slopes, 2, 0) * length
    exponentials = expm(pairs)
    return Blocks(_cut(exponentials[0, :size, :size], nx, inputs), _cut(exponentials[:, :size, size:], nx, inputs))


def _cut(e: np.ndarray, nx: int, inputs: int) -> tuple[np.ndarray, ...]:
    """``Phi, G1, G2``; the constant's column has no ramp."""
    return e[..., :nx, :nx], e[..., :nx, nx : nx + inputs], e[..., :nx, nx + inputs : nx + 2 * inputs - 1]
