"""The exact hold with a delayed input: the jump inside the interval is exact, and so is the derivative along the delay.

With ``g(t) = integral of exp(A s) B ds`` from 0 to ``t`` and ``b = (1 - f) h`` what is left of the interval after the cut, a held input
enters with ``g(b)`` for the row of ``n`` intervals ago and ``g(h) - g(b)`` for the one before; the ramps of a linear input likewise.
"""

from __future__ import annotations

import math

import casadi as ca
import numpy as np

from greybox.integrators.casadi_call import call_function
from greybox.integrators.input_delay import make_delay_function
from greybox.integrators.matrix_exponential import HoldBlocks, compute_exponentials
from greybox.integrators.step import InputHistory
from greybox.model.system import System


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
        c, b, nx = self.past.column, (1 - (delay - n)) * h, len(whole.values[0])
        db = -along[which] if 0 <= seconds[0] <= self.past.rows * h else 0 * along[which]
        rest = compute_exponentials(generator, slopes, np.array([b]), nx).of(0)
        (g1, g2), (dg1, dg2) = _input_columns(whole, c)
        (r1, r2), (dr1, dr2) = _input_columns(rest, c)
        # d g(b) / d b = exp(A b) B; d (b G2(b)) / d b = g(b)
        rate = rest.values[0] @ generator[:nx, nx + c]
        dr2 = b * dr2 + np.outer(db, r1)
        dr1 = dr1 + np.outer(db, rate)
        gains = np.zeros((2, self.rows, nx))
        changes = np.zeros((len(which), *gains.shape))
        gains[:, n] = r1, b * r2 / h
        gains[:, n + 1] = g1 - r1, g2 + b / h * (g1 - r2) - r1
        changes[:, 0, n], changes[:, 1, n] = dr1, dr2 / h
        changes[:, 0, n + 1] = dg1 - dr1
        changes[:, 1, n + 1] = dg2 + b / h * dg1 + np.outer(db, g1) / h - dr2 / h - dr1
        return gains.ravel(), changes.reshape(len(which), gains.size).T

    def _split(self, seconds: float, length: float) -> tuple[float, int]:
        """The delay in intervals, and how many whole ones."""
        delay = min(max(seconds / length, 0.0), float(self.past.rows))
        return delay, min(math.floor(delay), self.past.rows - 1) if math.isfinite(delay) else 0


def _input_columns(blocks: HoldBlocks, c: int) -> tuple[tuple[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]:
    """Column ``c`` of G1 and G2 (nx,), and their slopes (n, nx)."""
    (_, g1, g2), (_, dg1, dg2) = blocks.values, blocks.slopes
    return (g1[:, c], g2[:, c]), (dg1[..., c], dg2[..., c])
