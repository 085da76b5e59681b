"""Sensitivities of a linear model, exactly: its transfer functions and free responses at random complex frequencies.

With ``R = (s I - A)^-1`` the outputs are ``Y = (C R B e^(-s tau) + D) U + C R (x0 + c / s) + d / s``. Input and initial
states are rich and independent, so both parts are known as functions of ``s``. Slopes are relative, which keeps what shows
only at high frequency as visible as the gain.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction

import casadi as ca
import numpy as np
from scipy.linalg import matrix_balance

from greybox.base.numerics import CANCELLED_RESPONSE, INTEGRATING_POLE, TINY
from greybox.estimation.identifiability.sensitivity import Sensitivity
from greybox.model import System
from greybox.simulation.free_run import differentiate_equations

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


# Random frequencies of a linear model reach this many decades beyond its fastest and slowest pole.
POLE_DECADES = 1.0
# Points at which the terms of a slope are looked at.
FEW_POINTS = 8
# Free responses of a linear model, each with initial states of its own.
FREE_RESPONSES = 2


def compute_transfer_function_sensitivity(
    system: System, p: np.ndarray, which: np.ndarray, slopes: np.ndarray, at_rest: bool, generator: np.random.Generator
) -> Sensitivity:
    """Slopes at the parameters ``p`` (np,), along those numbered ``which`` in steps of ``slopes``; ``at_rest``: known x0."""
    nominal, along = _matrices(system, p, which, slopes)
    # Random points from below the slowest pole to above the fastest. Of the right half-plane: R of a stable model has no pole there, and a
    # random point misses those of an unstable one.
    poles = np.abs(np.linalg.eigvals(nominal.a))
    poles = poles[poles > INTEGRATING_POLE * max(poles.max(initial=0.0), TINY)]
    low, high = (poles.min(), poles.max()) if len(poles) else (1.0, 1.0)
    reach, count = np.log(10.0) * POLE_DECADES, 40 + 8 * (len(which) + 2 * len(nominal.a))
    radius = np.exp(generator.uniform(np.log(low) - reach, np.log(high) + reach, count))
    s = radius * np.exp(1j * generator.uniform(0.0, 0.45 * np.pi, count))
    forced = _responses(s, nominal, along, nominal.b, along.b, nominal.d, along.d)
    blocks: dict[str, Rows] = {name: ([], []) for name in system.output_names}
    nx, nu = len(nominal.a), system.u.numel()
    states = 0 if at_rest else FREE_RESPONSES * nx
    for j, rows in enumerate(blocks.values()):
        for m in range(nu):
            value, slope, size = (part[:, j, m] for part in forced)
            delay = np.exp(-s * nominal.tau[m])
            # d/dp of G e^(-s tau)
            slope = (slope - s[:, None] * along.tau[:, m] * value[:, None]) * delay[:, None]
            _add(rows, value * delay, slope, np.zeros((len(s), states)), size)
    # The free response of each record: C R (x0 + c / s) + d / s.
    d, dd = nominal.d[None, :, nu] / s[:, None], along.d[None, :, :, nu] / s[:, None, None]
    for e in range(1 if at_rest else FREE_RESPONSES):
        x0 = nominal.start if at_rest else nominal.start * generator.uniform(0.7, 1.4, nx) + generator.normal(size=nx)
        dx0 = along.start if at_rest else np.zeros_like(along.start)
        b = x0[None, :] + nominal.b[None, :, nu] / s[:, None]
        db = dx0[None] + along.b[None, :, :, nu] / s[:, None, None]
        value, slope, size = _responses(s, nominal, along, b[:, :, None], db[..., None], d[:, :, None], dd[..., None])
        # Slope of the free response along the first states: C R.
        of_states = nominal.c @ _resolvent(s, nominal.a)
        for j, rows in enumerate(blocks.values()):
            columns = np.zeros((len(s), states), complex)
            if not at_rest:
                columns[:, e * nx : (e + 1) * nx] = of_states[:, j]
            _add(rows, value[:, j, 0], slope[:, j, 0], columns, size[:, j, 0])
    n = len(which)
    stacked = {
        name: (np.vstack([np.zeros((1, states)), *x]), np.vstack([np.zeros((1, n)), *c]))
        for name, (x, c) in blocks.items()
    }
    return Sensitivity(stacked).compress()


def _responses(
    s: np.ndarray, nominal: _Matrices, along: _Matrices, b: np.ndarray, db: np.ndarray, d: np.ndarray, dd: np.ndarray
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
    # dG = dC R B + C R (dA R B + dB) + dD, by products of matrices: of twenty states sums over every index take ten times as long.
    of_outputs, of_states = (np.tensordot(da, x, axes=(2, 1)) for da in (along.c, along.a))  # (np, ny or nx, k, m)
    inner = of_states.transpose(2, 1, 3, 0) + db.transpose(0, 2, 3, 1)  # (k, nx, m, np)
    through = (cr @ inner.reshape(*inner.shape[:2], -1)).reshape(len(s), -1, *inner.shape[2:])
    of_outputs, dd = of_outputs.transpose(2, 1, 3, 0), np.moveaxis(dd, 1, -1)
    slope = of_outputs + through + dd
    # A slope far below its own terms is what cancellation leaves: scaled to length one it would count as any other. Of a function of s that
    # is zero at a few random points it is so everywhere.
    few = slice(0, FEW_POINTS)
    of_states, db = np.abs(of_states.transpose(2, 1, 3, 0)[few]), np.abs(db.transpose(0, 2, 3, 1)[few])
    terms = np.abs(of_outputs[few]) + np.einsum("kyx,kxmp->kymp", np.abs(cr[few]), of_states + db) + np.abs(dd[few])
    slope[:, (np.abs(slope[few]) <= CANCELLED_RESPONSE * terms).all(axis=0)] = 0.0
    # Sum of magnitudes: a response far below it is what cancellation leaves, not a response.
    size = np.abs(nominal.c) @ np.abs(r) @ np.abs(b) + np.abs(d)
    return value, slope, size


def _resolvent(s: np.ndarray, a: np.ndarray) -> np.ndarray:
    # R(s) = (s I - A)^-1.
    return np.linalg.inv(s[:, None, None] * np.eye(len(a)) - a)


def _add(rows: Rows, value: np.ndarray, constants: np.ndarray, states: np.ndarray, size: np.ndarray) -> None:
    """Relative slopes, real and imaginary, where there is a response."""
    kept_rows = np.abs(value) > CANCELLED_RESPONSE * size
    for kept, matrix in zip(rows, (states, constants), strict=True):
        # d log G = dG / G: what shows only at high frequency is as visible as the gain.
        relative = matrix[kept_rows] / value[kept_rows, None]
        kept += [relative.real, relative.imag]


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
    # Constant terms: what is left of rates and outputs at x = 0, u = 0.
    zero = [
        ca.substitute(e, ca.vertcat(system.x, system.u), ca.SX.zeros(nx + nu)) for e in (system.rhs, system.outputs)
    ]
    tau = ca.SX.zeros(nu)
    for delay in system.delays:
        tau[delay.column] += delay.seconds
    a, b, c, d = differentiate_equations(system)
    parts = [a, ca.horzcat(b, zero[0]), c, ca.horzcat(d, zero[1]), tau, system.start]
    flat = [ca.densify(ca.vec(part)) for part in parts]
    return ca.Function("matrices", [system.p], [*flat, *(ca.densify(ca.jacobian(v, system.p)) for v in flat)])


# Transfer functions as formulas: their coefficients as sums of products of powers of the constants.
#
# A term is a tuple of exponents, one for each parameter, with a rational factor: ``Kf Kv / (Ra M)``. Where a model divides by
# anything but a product the formulas are not of this kind, and there are none.

Polynomial = dict[tuple[int, ...], Fraction]


class _NoFormulaError(Exception):
    """The expression is not a sum of products of powers."""


def transfer_function_coefficients(
    system: System, outputs: Sequence[int] | None = None, *, at_rest: bool = False
) -> list[Polynomial]:
    """Coefficients of ``det(s I - A)``, of the numerators of ``C adj(s I - A) B``, and ``D``; plain numbers are left out.

    Of ``outputs``, by their numbers (None: all). With ``at_rest`` also those of the free response to the declared start and to constant
    terms, and the delays: together they say all that a record shows. Empty where there are no such formulas, or only unwieldy ones.
    """
    zero = ca.substitute(
        ca.vertcat(system.rhs, system.outputs),
        ca.vertcat(system.x, system.u),
        ca.SX.zeros(system.x.numel() + system.u.numel()),
    )
    parts = [*differentiate_equations(system), system.start, zero, ca.vertcat(*[d.seconds for d in system.delays])]
    try:
        a, b, c, d, start, constant, delays = (_read_matrix(part, system.p) for part in parts)
        rates, offsets = constant[: len(a)], constant[len(a) :]
        if outputs is not None:
            c, d, offsets = ([m[j] for j in outputs] for m in (c, d, offsets))
        characteristic, adjugates = _leverrier(a, system.p.numel())
        result = [*characteristic]
        for m in adjugates:
            result += [entry for row in _times(_times(c, m), b) for entry in row]
        result += [entry for row in d for entry in row]
        if at_rest:
            # C R (x0 + c / s) + d / s = (s C adj x0 + C adj c + d det) / (s det), power by power.
            of_start, of_rates = ([_times(_times(c, m), v) for m in adjugates] for v in (start, rates))
            nothing: list[list[Polynomial]] = [[{}] for _ in c]
            whole = zip(
                [*of_start, nothing],
                [nothing, *of_rates],
                [{(0,) * system.p.numel(): Fraction(1)}, *characteristic],
                strict=True,
            )
            for x0, rate, det in whole:
                result += [
                    _sum([x[0], r[0], _product_of(o[0], det)]) for x, r, o in zip(x0, rate, offsets, strict=True)
                ]
            result += [entry for row in delays for entry in row]
    except _NoFormulaError:
        return []
    return [poly for poly in result if poly and not _constant(poly)]


def _read_matrix(part: ca.SX, p: ca.SX) -> list[list[Polynomial]]:
    """The entries of a matrix of expressions in ``p``. Raises _NoFormulaError."""
    rows, columns = part.shape
    if not rows * columns:
        return [[] for _ in range(rows)]
    flat = _read(ca.Function("entries", [p], [ca.densify(ca.vec(part))]), p.numel())
    return [[flat[i + rows * j] for j in range(columns)] for i in range(rows)]


@dataclass(frozen=True, eq=False)
class PolynomialValues:
    """Polynomials to be evaluated at many points at once: ``powers`` (T, np) and ``factors`` (T,) of their terms, ``first`` of each."""

    powers: np.ndarray
    factors: np.ndarray
    first: np.ndarray

    @classmethod
    def of(cls, polynomials: Sequence[Polynomial]) -> PolynomialValues:
        """The terms of at least one polynomial."""
        counts = [len(poly) for poly in polynomials]
        return cls(
            np.array([e for poly in polynomials for e in poly], float),
            np.array([float(f) for poly in polynomials for f in poly.values()]),
            np.concatenate([[0], np.cumsum(counts)[:-1]]).astype(int),
        )

    def at(self, p: np.ndarray, which: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Values (S, m) at the parameters ``p`` (S, np), and slopes (S, m, k) along the logarithms of those numbered ``which``."""
        with np.errstate(all="ignore"):
            terms = self.factors * np.prod(p[:, None, :] ** self.powers, axis=2)
            # p dt/dp = e t of a term t = f p^e
            slopes = terms[:, :, None] * self.powers[:, which]
            return np.add.reduceat(terms, self.first, axis=1), np.add.reduceat(slopes, self.first, axis=1)


def divide(numerator: Polynomial, denominator: Polynomial) -> Polynomial | None:
    """The quotient, if the denominator is one term."""
    if len(denominator) != 1:
        return None
    ((exponents, factor),) = denominator.items()
    return {tuple(np.subtract(e, exponents).tolist()): f / factor for e, f in numerator.items()}


def logarithmic_gradient(poly: Polynomial, p: np.ndarray) -> np.ndarray:
    """``d log |poly| / d log p`` (np,) at the parameters ``p``; not finite where a divisor or the whole is zero."""
    powers = np.array(list(poly), float)
    with np.errstate(all="ignore"):
        # d log sum(t_i) / d log p = sum t_i e_i / sum t_i, e_i the exponents of the term t_i.
        terms = np.array([float(f) for f in poly.values()]) * np.prod(p**powers, axis=1)
        return np.asarray(terms @ powers / terms.sum())


def remove_known_factors(poly: Polynomial, known: Sequence[int]) -> Polynomial:
    """The same up to a known factor: constants in ``known`` that are in every term alike are taken out, so is the number."""
    shared = np.zeros(len(next(iter(poly))), int)
    for k in known:
        powers = {e[k] for e in poly}
        if len(powers) == 1:
            shared[k] = powers.pop()
    first = next(iter(poly.values()))
    return {tuple(np.subtract(e, shared).tolist()): f / first for e, f in poly.items()}


def format_polynomial(poly: Polynomial, names: Sequence[str]) -> str:
    """As a person writes it: ``(B + Kf Kv/Ra)/M``."""
    powers = np.array(list(poly))
    low, high = powers.min(axis=0), powers.max(axis=0)
    outside = np.where(low > 0, low, np.where(high < 0, high, 0))
    if len(poly) == 1:
        return _product(powers[0], names)
    factors = ("" if f == 1 else "-" if f == -1 else f"{float(f):g} " for f in poly.values())
    terms = [factor + _product(np.array(e) - outside, names) for factor, e in zip(factors, poly, strict=True)]
    total = " + ".join(terms).replace("+ -", "- ")
    return _product(outside, names, f"({total})") if outside.any() else total


def _product(powers: np.ndarray, names: Sequence[str], first: str = "") -> str:
    above = [first] if first else []
    above += [_power(n, k) for n, k in zip(names, powers, strict=True) if k > 0]
    below = [_power(n, -k) for n, k in zip(names, powers, strict=True) if k < 0]
    text = " ".join(above) or "1"
    if not below:
        return text
    return f"{text}/{below[0]}" if len(below) == 1 else f"{text}/({' '.join(below)})"


def _power(name: str, exponent: float) -> str:
    return name if exponent == 1 else f"{name}^{exponent:g}"


def _leverrier(a: list[list[Polynomial]], width: int) -> tuple[list[Polynomial], list[list[list[Polynomial]]]]:
    """Faddeev and Leverrier: coefficients of ``det(s I - A)`` and the matrices of ``adj(s I - A)``, highest power first."""
    n = len(a)
    zero = (0,) * width
    m = [[{zero: Fraction(1)} if i == j else {} for j in range(n)] for i in range(n)]
    characteristic, adjugates = [], []
    for k in range(1, n + 1):
        adjugates.append(m)
        am = _times(a, m)
        # c_k = -trace(A M_k) / k, M_{k+1} = A M_k + c_k I
        c = _scaled(_sum([am[i][i] for i in range(n)]), Fraction(-1, k))
        characteristic.append(c)
        m = [[_sum([am[i][j], c]) if i == j else am[i][j] for j in range(n)] for i in range(n)]
    return characteristic, adjugates


def _times(left: list[list[Polynomial]], right: list[list[Polynomial]]) -> list[list[Polynomial]]:
    columns = range(len(right[0]) if right else 0)
    return [[_sum([_product_of(row[k], right[k][j]) for k in range(len(right))]) for j in columns] for row in left]


def _product_of(one: Polynomial, other: Polynomial) -> Polynomial:
    result: Polynomial = {}
    for e, f in one.items():
        for g, h in other.items():
            key = tuple(x + y for x, y in zip(e, g, strict=True))
            result[key] = result.get(key, Fraction(0)) + f * h
    return _drop_zeros(result)


def _sum(parts: Sequence[Polynomial]) -> Polynomial:
    result: Polynomial = {}
    for part in parts:
        for e, f in part.items():
            result[e] = result.get(e, Fraction(0)) + f
    return _drop_zeros(result)


def _scaled(poly: Polynomial, factor: Fraction) -> Polynomial:
    return {e: f * factor for e, f in poly.items()}


# Most terms of a coefficient of a transfer function; longer ones are unwieldy as formulas.
MAX_TERMS = 60


def _drop_zeros(poly: Polynomial) -> Polynomial:
    if len(poly) > MAX_TERMS:
        raise _NoFormulaError
    return {e: f for e, f in poly.items() if f}


def _constant(poly: Polynomial) -> bool:
    return not any(any(e) for e in poly)


def _read(f: ca.Function, width: int) -> list[Polynomial]:
    """The outputs of a function of one column of ``width`` symbols."""
    work: dict[int, Polynomial] = {}
    out: list[Polynomial] = [{} for _ in range(f.numel_out(0))]
    zero = (0,) * width
    for k in range(f.n_instructions()):
        kind, where, source = f.instruction_id(k), f.instruction_output(k), f.instruction_input(k)
        if kind == ca.OP_CONST:
            value = Fraction(f.instruction_constant(k))
            work[where[0]] = {zero: value} if value else {}
        elif kind == ca.OP_INPUT:
            work[where[0]] = {tuple(int(j == source[1]) for j in range(width)): Fraction(1)}
        elif kind == ca.OP_OUTPUT:
            out[where[1]] = work[source[0]]
        elif kind in _OPERATIONS:
            work[where[0]] = _OPERATIONS[kind](*(work[s] for s in source))
        else:
            raise _NoFormulaError
    return out


def _quotient(one: Polynomial, other: Polynomial) -> Polynomial:
    result = divide(one, other)
    if result is None:
        raise _NoFormulaError
    return result


def _raised(one: Polynomial, other: Polynomial) -> Polynomial:
    if not _constant(other) or len(other) > 1:
        raise _NoFormulaError
    power = next(iter(other.values()), Fraction(0))
    if power.denominator != 1 or not 0 <= power <= 6:
        raise _NoFormulaError
    result: Polynomial = {(0,) * len(next(iter(one), ())): Fraction(1)}
    for _ in range(int(power)):
        result = _product_of(result, one)
    return result


_OPERATIONS: dict[int, Callable[..., Polynomial]] = {
    ca.OP_ASSIGN: lambda a: a,
    ca.OP_ADD: lambda a, b: _sum([a, b]),
    ca.OP_SUB: lambda a, b: _sum([a, _scaled(b, Fraction(-1))]),
    ca.OP_MUL: _product_of,
    ca.OP_DIV: _quotient,
    ca.OP_NEG: lambda a: _scaled(a, Fraction(-1)),
    ca.OP_SQ: lambda a: _product_of(a, a),
    ca.OP_TWICE: lambda a: _scaled(a, Fraction(2)),
    ca.OP_INV: lambda a: _quotient({(0,) * len(next(iter(a), ())): Fraction(1)}, a),
    ca.OP_POW: _raised,
    ca.OP_CONSTPOW: _raised,
}
