"""Sensitivities of a linear model, exactly: its transfer functions and free responses at random complex frequencies.

With ``R = (s I - A)^-1`` the outputs are ``Y = (C R B e^(-s tau) + D) U + C R (x0 + c / s) + d / s``. Input and initial
states are rich and independent, so both parts are known as functions of ``s``. Slopes are relative, which keeps what shows
only at high frequency as visible as the gain.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import casadi as ca
import numpy as np
from scipy.linalg import matrix_balance

from greybox.identifiability.policy import RANDOM_EXPERIMENT_POLICY, RandomExperimentPolicy
from greybox.identifiability.sensitivity import Sensitivity
from greybox.model.system import System
from greybox.numerics import CANCELLED_RESPONSE, INTEGRATING_POLE, TINY

Rows = tuple[list[np.ndarray], list[np.ndarray]]  # along the initial states, and along the constants


@dataclass(frozen=True, eq=False)
class _Matrices:
    """The linear model at one point, and its slopes along each constant (np first)."""

    a: np.ndarray
    b: np.ndarray
    c: np.ndarray
    d: np.ndarray
    tau: np.ndarray
    start: np.ndarray


def compute_transfer_function_sensitivity(
    system: System,
    p: np.ndarray,
    which: np.ndarray,
    slopes: np.ndarray,
    at_rest: bool,
    generator: np.random.Generator,
    policy: RandomExperimentPolicy = RANDOM_EXPERIMENT_POLICY,
) -> Sensitivity:
    """Slopes at the parameters ``p`` (np,), along those numbered ``which`` in steps of ``slopes``; ``at_rest``: known x0."""
    nominal, along = _matrices(system, p, which, slopes)
    s = _draw_frequencies(nominal.a, len(which), generator, policy.pole_decades)
    forced = _responses(s, nominal, along, nominal.b, along.b, nominal.d, along.d)
    blocks: dict[str, Rows] = {name: ([], []) for name in system.output_names}
    nx, nu = len(nominal.a), system.u.numel()
    responses = policy.free_responses
    states = 0 if at_rest else responses * nx
    for j, rows in enumerate(blocks.values()):
        for m in range(nu):
            value, slope, size = (part[:, j, m] for part in forced)
            delay = np.exp(-s * nominal.tau[m])
            # d/dp of G e^(-s tau)
            slope = (slope - s[:, None] * along.tau[:, m] * value[:, None]) * delay[:, None]
            _add(rows, value * delay, slope, np.zeros((len(s), states)), size)
    for e in range(1 if at_rest else responses):
        _add_free(blocks.values(), s, nominal, along, at_rest, e, responses, generator)
    n = len(which)
    stacked = {
        name: (np.vstack([np.zeros((1, states)), *x]), np.vstack([np.zeros((1, n)), *c]))
        for name, (x, c) in blocks.items()
    }
    return Sensitivity(stacked).compress()


def _add_free(
    blocks: Iterable[Rows],
    s: np.ndarray,
    nominal: _Matrices,
    along: _Matrices,
    at_rest: bool,
    e: int,
    responses: int,
    generator: np.random.Generator,
) -> None:
    """Rows of the free response of one record: ``C R (x0 + c / s) + d / s``."""
    nx, nu = len(nominal.a), nominal.b.shape[1] - 1
    x0 = nominal.start if at_rest else nominal.start * generator.uniform(0.7, 1.4, nx) + generator.normal(size=nx)
    dx0 = along.start if at_rest else np.zeros_like(along.start)
    b = x0[None, :] + nominal.b[None, :, nu] / s[:, None]
    db = dx0[None] + along.b[None, :, :, nu] / s[:, None, None]
    d, dd = nominal.d[None, :, nu] / s[:, None], along.d[None, :, :, nu] / s[:, None, None]
    value, slope, size = _responses(s, nominal, along, b[:, :, None], db[..., None], d[:, :, None], dd[..., None])
    of_states = nominal.c @ _resolvent(s, nominal.a)
    for j, rows in enumerate(blocks):
        columns = np.zeros((len(s), 0 if at_rest else responses * nx), complex)
        if not at_rest:
            columns[:, e * nx : (e + 1) * nx] = of_states[:, j]
        _add(rows, value[:, j, 0], slope[:, j, 0], columns, size[:, j, 0])


def _responses(
    s: np.ndarray,
    nominal: _Matrices,
    along: _Matrices,
    b: np.ndarray,
    db: np.ndarray,
    d: np.ndarray,
    dd: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """``C R b + d`` (k, ny, m), its slopes (k, ny, m, np), and the size of the terms that it is the sum of.

    ``b`` ([k,] nx, m) and ``d`` ([k,] ny, m) with slopes ``db`` ([k,] np, nx, m) and ``dd`` ([k,] np, ny, m).
    """
    r = _resolvent(s, nominal.a)
    b = np.broadcast_to(b, (len(s), *b.shape[-2:]))
    db = np.broadcast_to(db, (len(s), *db.shape[-3:]))
    dd = np.broadcast_to(dd, (len(s), *dd.shape[-3:]))
    x = r @ b
    cr = nominal.c @ r
    value = cr @ b + d
    slope = np.einsum("ijn,knm->kjmi", along.c, x)
    slope = slope + np.einsum("kjn,inl,klm->kjmi", cr, along.a, x, optimize=True)
    slope = slope + np.einsum("kjn,kinm->kjmi", cr, db) + np.moveaxis(dd, 1, -1)
    size = np.abs(nominal.c) @ np.abs(r) @ np.abs(b) + np.abs(d)
    return value, slope, size


def _resolvent(s: np.ndarray, a: np.ndarray) -> np.ndarray:
    return np.linalg.inv(s[:, None, None] * np.eye(len(a)) - a)


def _add(rows: Rows, value: np.ndarray, constants: np.ndarray, states: np.ndarray, size: np.ndarray) -> None:
    """Relative slopes, real and imaginary, where there is a response."""
    kept_rows = np.abs(value) > CANCELLED_RESPONSE * size
    for kept, matrix in zip(rows, (states, constants), strict=True):
        relative = matrix[kept_rows] / value[kept_rows, None]
        kept += [relative.real, relative.imag]


def _draw_frequencies(a: np.ndarray, constants: int, generator: np.random.Generator, decades: float) -> np.ndarray:
    """Random points of the right half-plane, from below the slowest pole to above the fastest."""
    size = np.abs(np.linalg.eigvals(a))
    size = size[size > INTEGRATING_POLE * max(size.max(initial=0.0), TINY)]
    low, high = (size.min(), size.max()) if len(size) else (1.0, 1.0)
    count = 40 + 8 * (constants + 2 * len(a))
    reach = np.log(10.0) * decades
    radius = np.exp(generator.uniform(np.log(low) - reach, np.log(high) + reach, count))
    return radius * np.exp(1j * generator.uniform(0.0, 0.45 * np.pi, count))


def _matrices(system: System, p: np.ndarray, which: np.ndarray, slopes: np.ndarray) -> tuple[_Matrices, _Matrices]:
    """Balanced matrices with the constant terms as one more input, and their slopes along the constants."""
    nx, nu, ny = system.x.numel(), system.u.numel(), len(system.output_names)
    f = make_matrix_function(system)
    values = [np.asarray(v) for v in f(p)]
    shapes = ((nx, nx), (nx, nu + 1), (ny, nx), (ny, nu + 1), (nu,), (nx,))
    nominal = [v.reshape(shape, order="F") for v, shape in zip(values[:6], shapes, strict=True)]
    along = [
        np.moveaxis((v[:, which] * slopes).reshape((*shape, len(which)), order="F"), -1, 0)
        for v, shape in zip(values[6:], shapes, strict=True)
    ]
    # A state in pascals beside one in metres: other units for both, powers of two, so without rounding.
    t = matrix_balance(nominal[0], permute=False, separate=True)[1][0]
    sides = (1 / t[:, None] * t, 1 / t[:, None], t, np.ones(1), np.ones(1), 1 / t)
    return _Matrices(*(m * side for m, side in zip(nominal, sides, strict=True))), _Matrices(
        *(m * side for m, side in zip(along, sides, strict=True))
    )


def make_matrix_function(system: System) -> ca.Function:
    """``p -> A, [B c], C, [D d], delays, start`` flattened, and the slopes of each along ``p``."""
    nx, nu = system.x.numel(), system.u.numel()
    zero = [
        ca.substitute(e, ca.vertcat(system.x, system.u), ca.SX.zeros(nx + nu)) for e in (system.rhs, system.outputs)
    ]
    tau = ca.SX.zeros(nu)
    for delay in system.delays:
        tau[delay.column] += delay.seconds
    parts = [
        ca.jacobian(system.rhs, system.x),
        ca.horzcat(ca.jacobian(system.rhs, system.u), zero[0]),
        ca.jacobian(system.outputs, system.x),
        ca.horzcat(ca.jacobian(system.outputs, system.u), zero[1]),
        tau,
        system.start,
    ]
    flat = [ca.densify(ca.vec(part)) for part in parts]
    return ca.Function("matrices", [system.p], [*flat, *(ca.densify(ca.jacobian(v, system.p)) for v in flat)])
