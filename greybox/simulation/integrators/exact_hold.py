"""Exact discretisation of a linear model: the matrix exponential, for a held input and for one that is linear between samples."""

from __future__ import annotations

import math
from typing import NamedTuple

import casadi as ca
import numpy as np
from scipy.linalg import expm

from greybox.base.errors import ModelError
from greybox.model.system import System
from greybox.simulation.integrators.input_delay import count_history_columns, delay_outputs, make_delay_function
from greybox.simulation.integrators.step import InputHistory, Step, call_function

# Exponentials of the generator of an exact hold over several interval lengths at once, with their slopes.


class HoldExponentials(NamedTuple):
    """Exponentials of the generator over some lengths: ``values`` (nh, size, size), ``slopes`` (nh, n, size, size) along n
    parameters."""

    values: np.ndarray
    slopes: np.ndarray
    nx: int

    def flat(self, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The entries of `index_hold_entries`: (nh, nq) and their slopes (nh, nq, n)."""
        nh, n, size, _ = self.slopes.shape
        slopes = self.slopes.reshape(nh, n, size * size)[:, :, places]
        return self.values.reshape(nh, size * size)[:, places], slopes.transpose(0, 2, 1)

    def of(self, k: int) -> HoldBlocks:
        """The blocks of length number ``k``."""
        return HoldBlocks(_cut_blocks(self.values[k], self.nx), _cut_blocks(self.slopes[k], self.nx))


class HoldBlocks(NamedTuple):
    """``Phi`` (nx, nx), ``G1`` (nx, nu + 1), ``G2`` (nx, nu) of one length, and their slopes along n parameters (n, ...)."""

    values: tuple[np.ndarray, ...]
    slopes: tuple[np.ndarray, ...]


def compute_exponentials(generator: np.ndarray, slopes: np.ndarray, lengths: np.ndarray, nx: int) -> HoldExponentials:
    """Exponentials over each of ``lengths``, and their slopes along ``slopes`` (n, size, size) of the generator: the upper right
    block of that of ``[[M, dM], [0, M]]`` (Najfeld, Havel 1995)."""
    size, n, nh = len(generator), len(slopes), len(lengths)
    inputs = (size - nx) // 2
    scaled = generator * lengths[:, None, None]
    # The ramp block is 1 per interval, not per second, so that G2 multiplies ``ub - ua`` as it stands.
    scaled[:, nx : nx + inputs, nx + inputs :] = np.eye(inputs)
    # `expm` raises on what is not finite; a trial point out of reach is no error: the run that follows is NaN, and
    # the search draws back.
    if not (np.isfinite(scaled).all() and np.isfinite(slopes).all()):
        return HoldExponentials(np.full(scaled.shape, np.nan), np.full((nh, n, size, size), np.nan), nx)
    if n == 0:
        return HoldExponentials(expm(scaled), np.empty((nh, 0, size, size)), nx)
    pairs = np.zeros((nh, n, 2 * size, 2 * size))
    pairs[:, :, :size, :size] = pairs[:, :, size:, size:] = scaled[:, None]
    pairs[:, :, :size, size:] = slopes * lengths[:, None, None, None]
    exponential_pairs = expm(pairs)
    # The diagonal block is the same for every direction: exp(M) comes with the first.
    return HoldExponentials(exponential_pairs[:, 0, :size, :size], exponential_pairs[:, :, :size, size:], nx)


def index_hold_entries(nx: int, nu: int) -> np.ndarray:
    """Where the entries of ``Phi, G1, G2``, each column by column, stand in a flattened exponential."""
    size = nx + 2 * (nu + 1)
    return np.concatenate(
        [block.ravel(order="F") for block in _cut_blocks(np.arange(size * size).reshape(size, size), nx)]
    )


def _cut_blocks(e: np.ndarray, nx: int) -> tuple[np.ndarray, ...]:
    """``Phi, G1, G2``; the constant's column has no ramp."""
    inputs = (e.shape[-1] - nx) // 2
    return e[..., :nx, :nx], e[..., :nx, nx : nx + inputs], e[..., :nx, nx + inputs : nx + 2 * inputs - 1]


# The exact hold with a delayed input: the jump inside the interval is exact, and so is the derivative along the delay.
#
# With ``g(t) = integral of exp(A s) B ds`` from 0 to ``t`` and ``b = (1 - f) h`` what is left of the interval after the cut, a held input
# enters with ``g(b)`` for the row of ``n`` intervals ago and ``g(h) - g(b)`` for the one before; the ramps of a linear input likewise.


class DelayedHold:
    """What a delayed input adds to the exact hold: ``share`` of the next state, with gains ``q`` of each row of the past."""

    def __init__(self, system: System, past: InputHistory, ua: ca.SX, ub: ca.SX) -> None:
        nx, nu = system.x.numel(), system.u.numel()
        self.past, self.rows = past, past.rows + 1
        level, ramp = ca.SX.sym("level", nx, self.rows), ca.SX.sym("ramp", nx, self.rows)
        input_columns = [past.column, *range(nu, nu + past.rows)]
        self.q = ca.vertcat(ca.vec(level), ca.vec(ramp))
        self.share = level @ ua[input_columns] + ramp @ ((ub - ua)[input_columns] * ua[-2])
        seconds = make_delay_function(system)(system.p)
        densified = ca.densify(ca.jacobian(seconds, system.p))
        self.seconds = ca.Function("seconds", [system.p], [ca.densify(seconds), densified])

    def gains(
        self, whole: HoldBlocks, generator: np.ndarray, slopes: np.ndarray, p: np.ndarray, which: np.ndarray, h: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Gains (nq,) and their slopes (nq, n) along the parameters numbered ``which``, for an interval of ``h`` seconds.

        ``whole`` are the blocks of the interval, ``generator`` and ``slopes`` what they are exponentials of.
        """
        seconds, along = (value.ravel() for value in call_function(self.seconds, p))
        delay, n = self._split(float(seconds[0]), h)
        # b = (1 - f) h, what is left of the interval after the cut; f = delay - n.
        c, b, nx = self.past.column, (1 - (delay - n)) * h, len(whole.values[0])
        # db/dp = -d(delay)/dp; zero where the delay is clipped to the rows that the step sees.
        db = -along[which] if 0 <= seconds[0] <= self.past.rows * h else 0 * along[which]
        rest = compute_exponentials(generator, slopes, np.array([b]), nx).of(0)
        (g1, g2), (dg1, dg2) = _input_columns(whole, c)
        (r1, r2), (dr1, dr2) = _input_columns(rest, c)
        # d g(b) / d b = exp(A b) B; d (b G2(b)) / d b = g(b)
        rate = rest.values[0] @ generator[:nx, nx + c]
        dr2 = b * dr2 + np.outer(db, r1)
        # After ``dr2``, which takes g(b); in this order each line uses what it needs before it is overwritten.
        dr1 = dr1 + np.outer(db, rate)
        gains = np.zeros((2, self.rows, nx))
        changes = np.zeros((len(which), *gains.shape))
        # Row n ago drives the rest b of the interval: level g(b); its ramp rises from zero at the cut, by the share
        # b / h of G2(b).
        gains[:, n] = r1, b * r2 / h
        # Row n + 1 ago drives up to the cut: level g(h) - g(b). Its ramp is at b / h when the interval begins, hence
        # what it adds to G2(h), less what the rest would have got from it.
        gains[:, n + 1] = g1 - r1, g2 + b / h * (g1 - r2) - r1
        changes[:, 0, n], changes[:, 1, n] = dr1, dr2 / h
        changes[:, 0, n + 1] = dg1 - dr1
        changes[:, 1, n + 1] = dg2 + b / h * dg1 + np.outer(db, g1) / h - dr2 / h - dr1
        return gains.ravel(), changes.reshape(len(which), gains.size).T

    def _split(self, seconds: float, length: float) -> tuple[float, int]:
        """The delay in intervals, and how many whole ones."""
        delay = min(max(seconds / length, 0.0), float(self.past.rows))
        # A delay of exactly ``rows`` intervals is rows - 1 whole ones and a share of one: row n + 1 must exist.
        return delay, min(math.floor(delay), self.past.rows - 1) if math.isfinite(delay) else 0


def _input_columns(blocks: HoldBlocks, c: int) -> tuple[tuple[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]:
    """Column ``c`` of G1 and G2 (nx,), and their slopes (n, nx)."""
    (_, g1, g2), (_, dg1, dg2) = blocks.values, blocks.slopes
    return (g1[:, c], g2[:, c]), (dg1[..., c], dg2[..., c])


def exact_hold(system: System, past: InputHistory | None = None) -> Step:
    """``x+ = Phi x + G1 [ua; 1] + G2 [ub - ua; 0]``, exact for ``dx/dt = A x + B u + c``.

    With ``n`` states and ``m`` inputs the three blocks are the first rows of ``expm([[A h, B h, 0], [0, 0, I], [0, 0, 0]])``
    (Van Loan 1978; Franklin, Powell, Workman, first-order hold). A delayed input needs its ``past``: see
    `greybox.simulation.integrators.exact_hold`. Raises ModelError for a model that is not linear.
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
        # The column says whether the input is linear between rows; a held one has no ramp.
        u_ramp = u_ramp * ua[-2]
        delayed = DelayedHold(system, past, ua, ub)
        # The delayed column comes in by ``delayed.share`` alone.
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
    # With a delay q has gains beside the exponential's entries: no kernel computes them by itself.
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
