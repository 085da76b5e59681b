"""Exact discretisation of a linear model: the matrix exponential, for a held input and for one that is linear between samples."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple

import casadi as ca
import numpy as np
from scipy.linalg import matrix_balance

from greybox.base import ModelError
from greybox.model import System
from greybox.simulation.integrators.input_delay import count_history_columns, delay_outputs, make_delay_function
from greybox.simulation.integrators.step import InputHistory, Step, call_function

# Exponentials of the generator of an exact hold, with their slopes along many constants at once.
#
# The equations of a plant are sparse, and so is what one constant changes in them: a spring between two bodies changes two rows. Its slope
# of the exponential is ``int_0^1 exp(M (1 - s)) dM exp(M s) ds`` (Wilcox 1967, J. Math. Phys. 8, 962), by Gauss's quadrature a product of
# the few columns and rows of the exponential that ``dM`` meets; the exponentials at the nodes are shared by all constants, and so are the
# powers of ``M`` from which they come.


class Generator(NamedTuple):
    """``[A, B, c]`` (nx, nx + nu + 1) of ``dx/dt = A x + B u + c`` per second, and its slopes along n constants by their entries."""

    matrix: np.ndarray
    along: int
    """How many constants there are."""

    rows: np.ndarray
    columns: np.ndarray
    constants: np.ndarray
    slopes: np.ndarray
    """Entry ``k`` is ``d matrix[rows[k], columns[k]] / d constants[k]``."""


class HoldBlocks(NamedTuple):
    """``[Phi, G1, G2]`` (nx, nx + (nu + 1) + nu) of one interval length, and its slopes along n constants (n, ...)."""

    values: np.ndarray
    slopes: np.ndarray

    def flat(self) -> tuple[np.ndarray, np.ndarray]:
        """The coefficients (nq,) of the step, column by column, and their slopes (nq, n)."""
        n = len(self.slopes)
        return self.values.T.ravel(), self.slopes.transpose(2, 1, 0).reshape(self.values.size, n)

    def input_columns(self, column: int, inputs: int) -> tuple[tuple[np.ndarray, np.ndarray], ...]:
        """Columns of G1 and G2 that belong to one of the ``inputs`` (nx,), and their slopes (n, nx)."""
        nx = len(self.values)
        places = nx + column, nx + inputs + 1 + column
        return tuple(self.values[:, k] for k in places), tuple(self.slopes[:, :, k] for k in places)  # type: ignore[return-value]


# Norm, in balanced units, of the part of the interval over which series and quadrature go; the rest is squaring, which costs two products
# of matrices for each constant. Above, the terms of the series are so much larger than their sum that digits are lost.
LARGEST_NORM = 2.0
# What series and quadrature leave out, relative to the norm: half a unit of the last digit.
LEFT_OUT = 2.0**-54
# Terms of the exponential's series: ``norm^k / k!`` is what the next one adds.
TERMS = next(k for k in range(1, 100) if LARGEST_NORM**k / math.factorial(k) < LEFT_OUT)


@lru_cache(maxsize=1)
def _find_quadrature() -> tuple[np.ndarray, np.ndarray]:
    """Nodes and weights of Gauss's quadrature on [0, 1] that are enough for the slopes."""
    for n in range(2, 40):
        # The integrand's derivative of order 2 n is at most (2 norm)^(2 n).
        bound = (2 * LARGEST_NORM) ** (2 * n) * math.factorial(n) ** 4 / math.factorial(2 * n) ** 3 / (2 * n + 1)
        if bound < LEFT_OUT:
            break
    nodes, weights = np.polynomial.legendre.leggauss(n)
    return (nodes + 1) / 2, weights / 2


def compute_hold(generator: Generator, length: float) -> HoldBlocks:
    """The exact hold over an interval of ``length`` seconds: the first rows of ``expm([[A h, B h, 0], [0, 0, I], [0, 0, 0]])`` (Van Loan
    1978), with their slopes; NaN where the generator is not finite."""
    nx, given = generator.matrix.shape
    inputs = given - nx
    kept, size = given + inputs - 1, given + inputs
    ab = generator.matrix * length
    if not (np.isfinite(ab).all() and np.isfinite(generator.slopes).all()):
        # A trial point out of reach is no error: the run that follows is NaN, and the search draws back.
        return HoldBlocks(np.full((nx, kept), np.nan), np.full((generator.along, nx, kept), np.nan))
    with np.errstate(over="ignore", invalid="ignore"):
        # States in units in which rows and columns of A h are of like size: every squaring that this saves would cost half a digit.
        balanced, (unit, _) = matrix_balance(ab[:, :nx], permute=False, separate=True)
        norm = np.abs(balanced).sum(axis=0).max(initial=0.0)
        if not math.isfinite(norm):
            return HoldBlocks(np.full((nx, kept), np.nan), np.full((generator.along, nx, kept), np.nan))
        squarings = max(0, math.frexp(norm / LARGEST_NORM)[1])
        units = np.concatenate([unit, np.ones(2 * inputs)])
        m = np.zeros((size, size))
        m[:nx, :given] = ab
        # The ramp block is 1 per interval, not per second, so that G2 multiplies ``ub - ua`` as it stands.
        m[nx:given, given:] = np.eye(inputs)
        scale = math.ldexp(1.0, -squarings)
        m *= scale * units / units[:, None]
        slopes = scale * length * generator.slopes * units[generator.columns] / units[generator.rows]
        e, d = _exponentiate(m, generator._replace(slopes=slopes))
        for _ in range(squarings):
            # (E E)' = E E' + E' E; below the first rows E' is zero.
            d = np.matmul(e[:nx, :nx], d) + (d.reshape(-1, size) @ e).reshape(d.shape)
            e = e @ e
        back = units[:nx, None] / units[:kept]
        return HoldBlocks(e[:nx, :kept] * back, d[:, :, :kept] * back)


def _exponentiate(m: np.ndarray, entries: Generator) -> tuple[np.ndarray, np.ndarray]:
    """``exp(m)`` (size, size) of a small ``m`` by its series, and the first rows (n, nx, size) of its slopes along what ``entries`` say."""
    size, nx = len(m), len(entries.matrix)
    power = np.eye(size)
    if not len(entries.slopes):
        e = power.copy()
        for k in range(1, TERMS + 1):
            power = power @ m / k
            e += power
        return e, np.zeros((entries.along, nx, size))
    # m^k / k!, from which the exponentials at all nodes are sums.
    powers = np.empty((TERMS + 1, size, size))
    powers[0] = power
    for k in range(1, TERMS + 1):
        np.matmul(powers[k - 1], m, out=powers[k])
        powers[k] /= k
    nodes, weights = _find_quadrature()
    # exp(m s) = sum s^k m^k / k!, at every node s.
    at_nodes = (nodes[:, None] ** np.arange(TERMS + 1) @ powers.reshape(TERMS + 1, -1)).reshape(-1, size, size)
    e, d = powers.sum(axis=0), np.zeros((entries.along, nx, size))
    # exp(m (1 - s)): the nodes lie symmetrically.
    left = at_nodes[::-1, :nx] * weights[:, None, None]
    order = np.argsort(entries.constants, kind="stable")
    for part in np.split(order, np.flatnonzero(np.diff(entries.constants[order])) + 1):
        rows, place = np.unique(entries.rows[part], return_inverse=True)
        # dm exp(m s): the few rows that this constant changes, from the few rows of the exponential that they meet.
        right = np.zeros((len(nodes), len(rows), size))
        for k, entry in zip(place, part, strict=True):
            right[:, k] += entries.slopes[entry] * at_nodes[:, entries.columns[entry]]
        columns = left[:, :, rows].transpose(1, 0, 2).reshape(nx, -1)
        d[entries.constants[part[0]]] = columns @ right.reshape(-1, size)
    return e, d


# The exact hold with a delayed input: the jump inside the interval is exact, and so is the derivative along the delay.
#
# With ``g(t) = integral of exp(A s) B ds`` from 0 to ``t`` and ``b = (1 - f) h`` what is left of the interval after the cut, a held input
# enters with ``g(b)`` for the row of ``n`` intervals ago and ``g(h) - g(b)`` for the one before; the ramps of a linear input likewise.


class DelayedHold:
    """What a delayed input adds to the exact hold: gains of each row of the past."""

    def __init__(self, system: System, past: InputHistory) -> None:
        nu = system.u.numel()
        self.past, self.rows = past, past.rows + 1
        self.input_columns = [past.column, *range(nu, nu + past.rows)]
        seconds = make_delay_function(system)(system.p)
        densified = ca.densify(ca.jacobian(seconds, system.p))
        self.seconds = ca.Function("seconds", [system.p], [ca.densify(seconds), densified])

    def regressors(self, ua: ca.SX, ub: ca.SX) -> tuple[ca.SX, ca.SX]:
        """What the gains multiply: each row of the past, and its ramp where the input is linear between rows."""
        return ua[self.input_columns], (ub - ua)[self.input_columns] * ua[-2]

    def gains(
        self, whole: HoldBlocks, generator: Generator, p: np.ndarray, which: np.ndarray, h: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Gains (nq,) and their slopes (nq, n) along the parameters numbered ``which``, for an interval of ``h`` seconds.

        ``whole`` are the blocks of the interval, ``generator`` what they are exponentials of.
        """
        seconds, along = (value.ravel() for value in call_function(self.seconds, p))
        delay, n = self._split(float(seconds[0]), h)
        # b = (1 - f) h, what is left of the interval after the cut; f = delay - n.
        c, b, nx = self.past.column, (1 - (delay - n)) * h, len(whole.values)
        # db/dp = -d(delay)/dp; zero where the delay is clipped to the rows that the step sees.
        db = -along[which] if 0 <= seconds[0] <= self.past.rows * h else 0 * along[which]
        rest = compute_hold(generator, b)
        inputs = generator.matrix.shape[1] - nx - 1
        (g1, g2), (dg1, dg2) = whole.input_columns(c, inputs)
        (r1, r2), (dr1, dr2) = rest.input_columns(c, inputs)
        # d g(b) / d b = exp(A b) B; d (b G2(b)) / d b = g(b)
        rate = rest.values[:, :nx] @ generator.matrix[:, nx + c]
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
    u_start, u_ramp = ua[:nu], (ub - ua)[:nu]
    outputs, generate = system.output_function, _make_generator(system)
    delayed = None
    if past is not None:
        delayed, outputs = DelayedHold(system, past), delay_outputs(system, past)
        # The delayed column comes in by its gains alone.
        u_start[past.column] = u_ramp[past.column] = 0
    parts = [x, ca.vertcat(u_start, 1), u_ramp, *(delayed.regressors(ua, ub) if delayed else ())]
    # One block of columns for each part: Phi, G1, G2, and the gains of a delayed input.
    blocks = [ca.SX.sym("q", nx, part.numel()) for part in parts]
    following = sum((block @ part for block, part in zip(blocks, parts, strict=True)), ca.SX.zeros(nx))
    q = ca.vertcat(*map(ca.vec, blocks))

    def coefficients(p: np.ndarray, lengths: np.ndarray, which: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        generator, size = generate(p, which), q.numel()
        values, slopes = np.empty((len(lengths), size)), np.empty((len(lengths), size, len(which)))
        for row, length in enumerate(lengths.tolist()):
            whole = compute_hold(generator, length)
            first = whole.values.size
            values[row, :first], slopes[row, :first] = whole.flat()
            if delayed is not None:
                values[row, first:], slopes[row, first:] = delayed.gains(whole, generator, p, which, length)
        return values, slopes

    advance = ca.Function("advance", [x, ua, ub, q, h], [following])
    # With a delay q has gains beside the exponential's entries: no kernel computes them by itself.
    generator = None if delayed else ca.Function("generator", [system.p], [ca.densify(ca.vec(_write_matrix(system)))])
    regressors = ca.Function("regressors", [ua, ub], [ca.densify(ca.vertcat(*parts[1:]))])
    return Step(
        "exact hold",
        advance,
        outputs,
        coefficients,
        per_interval=True,
        past=past,
        generator=generator,
        regressors=regressors,
    )


def _write_matrix(system: System) -> ca.SX:
    """``[A, B, c]`` (nx, nx + nu + 1) with the entries that the equations have."""
    xu = ca.vertcat(system.x, system.u)
    constant = ca.substitute(system.rhs, xu, ca.SX.zeros(xu.numel()))
    return ca.horzcat(ca.jacobian(system.rhs, xu), ca.sparsify(constant))


def _make_generator(system: System) -> Callable[[np.ndarray, np.ndarray], Generator]:
    """``(p, which) -> Generator`` with slopes along the parameters numbered ``which``."""
    matrix = _write_matrix(system)
    rows, columns = (np.array(part, int) for part in matrix.sparsity().get_triplet())
    entries = ca.vertcat(*matrix.nonzeros())
    along = ca.jacobian(entries, system.p)
    # Which entry depends on which parameter, by the pattern: most of them do not.
    of_entry, of_parameter = (np.array(part, int) for part in along.sparsity().get_triplet())
    evaluate = ca.Function("entries", [system.p], [entries, ca.vertcat(*along.nonzeros())])

    def generate(p: np.ndarray, which: np.ndarray) -> Generator:
        values, slopes = (value.ravel() for value in call_function(evaluate, p))
        dense = np.zeros(matrix.shape)
        dense[rows, columns] = values
        place = np.full(len(p), -1)
        place[which] = np.arange(len(which))
        kept = np.flatnonzero(place[of_parameter] >= 0)
        entry = of_entry[kept]
        return Generator(dense, len(which), rows[entry], columns[entry], place[of_parameter[kept]], slopes[kept])

    return generate
