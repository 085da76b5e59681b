"""Prediction-error models: errors, gradients, the search with its starts, and the finished model with its covariance.

Over ``theta`` the sum of squares of ``e = D / C (A y - sum B / F u - constant / F_1)`` is minimised. The unknown past of each record
(of each part between gaps, where the predictor uses measured outputs) enters linearly; it is eliminated by projecting
errors and gradients off its responses (variable projection, Golub and Pereyra 1973, with Kaufman's gradient). The gradients are
filtered signals (Ljung, System identification, 2nd ed., section 10.3)::

    de/da_j = D / C q^-j y      de/db_j = -D / (C F) q^-j u      de/df_j = 1 / (C F) q^-j w,   w = D B / F u + its past
    de/dc_j = -1 / C q^-j e     de/dd_j = 1 / C q^-j (A y - sum B / F u - constant / F_1)
    de/dconstant = -D / (C F_1)
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, get_args

import numpy as np
from scipy.linalg import null_space
from scipy.signal import lfilter

from greybox.base.errors import DataError, nearest
from greybox.base.linear_algebra import RowTriangle
from greybox.base.numerics import COLLINEAR_COLUMNS, DEPENDENT_COLUMN_SHARE, NEGLIGIBLE_SINGULAR_VALUE
from greybox.comparison.blackbox.arx import find_instability, find_unfinished_search
from greybox.comparison.blackbox.linear_regression import (
    BlockDelay,
    BlockFilter,
    Orders,
    SampledData,
    SampledRecord,
    build_regressors,
    collect_equations,
    delayed_columns,
    each_block,
    refuse_few_rows,
)
from greybox.comparison.blackbox.polynomial import (
    ONE,
    ConstantCourse,
    PolynomialModel,
    PolynomialStructure,
    compute_initial_responses,
    confine_roots,
    count_rows_of_memory,
    predict_ahead,
    reflect_roots,
    to_monic,
)
from greybox.estimation.optim import minimisation
from greybox.estimation.optim.methods import MinimisationMethod, minimise
from greybox.estimation.optim.quadratic_model import QuadraticModel

HistoryTreatment = Literal["estimated", "zero"]
Starts = Callable[[PolynomialStructure, SampledData, bool], Sequence[np.ndarray]]


@dataclass(frozen=True)
class PredictionErrorPolicy:
    """How hard a prediction-error model is searched for (ARMAX, output error, Box-Jenkins, Hammerstein).

    Parameters
    ----------
    starts
        Starting points that are followed, best first. The linear estimates seldom disagree more than threefold.
    first_iterations
        Iterations from each start; after these only the best goes on. Enough to tell basins apart.
    iterations
        Iterations of the final search. A quadratically converging search needs about ten.
    termination
        When a search ends: a millionth of a standard deviation gives the coefficients their digits. No error is small by itself:
        exact records are followed to the last digit.
    damped
        How its steps are damped. Starts are far off, and there are no kinks.
    """

    starts: int = 3
    first_iterations: int = 8
    iterations: int = 100
    termination: minimisation.TerminationPolicy = field(
        default_factory=lambda: minimisation.TerminationPolicy(
            negligible_decrease=1e-12, perfect_noise_ratio=0.0, patience=1, little_gain=1e-12
        )
    )
    damped: minimisation.GaussNewtonPolicy = field(
        default_factory=lambda: minimisation.GaussNewtonPolicy(
            initial_damping=1e-4, max_rejections=10, max_kink_steps=100
        )
    )


DEFAULT_SEARCH = PredictionErrorPolicy()


@dataclass(frozen=True, eq=False)
class PredictionErrors:
    """One-step errors of all parts of the records with the unknown past projected out, and what least squares needs of their slopes.

    Attributes
    ----------
    squares
        Sum of squares of the errors; infinite where they leave all bounds.
    count
        Number of errors n.
    states
        Number of initial states that were projected out.
    triangle
        ``R`` (p + 1, p + 1) of the derivatives with respect to the coefficients (n, p) and, in its last column, of the errors; None
        where it was not asked for.
    """

    squares: float
    count: int
    states: int
    triangle: np.ndarray | None = None

    @property
    def gradient(self) -> np.ndarray:
        """As many rows as matter of the derivatives (p + 1, p): their lengths, products and rank."""
        assert self.triangle is not None
        return self.triangle[:, :-1]


@dataclass(frozen=True, eq=False)
class PredictionErrorMinimum:
    """Where a search ended: ``theta`` (p,), its errors, iterations, and whether it converged."""

    theta: np.ndarray
    errors: PredictionErrors
    iterations: int
    converged: bool


@dataclass(frozen=True, eq=False)
class PredictionErrorProblem:
    """A structure and the parts of the records that it is fitted to; ``rest``: all was zero before them, nothing is projected out."""

    structure: PolynomialStructure
    data: SampledData
    parts: tuple[SampledRecord, ...]
    rest: bool

    def evaluate(self, theta: np.ndarray, with_gradient: bool) -> PredictionErrors:
        """Errors at the coefficients ``theta`` (p,), and their gradient if wanted.

        Behind the derivatives to ``theta`` stand those to the weights of each input's ``basis``, where the parts have them.
        """
        model = self.structure.model(theta, self.data)
        rows, squares, states = RowTriangle(), 0.0, 0
        count = 0
        for part in self.parts:
            for errors, gradient, projected in _each_block_of_errors(
                self.structure, model, part, self.rest, with_gradient
            ):
                with np.errstate(over="ignore", invalid="ignore"):
                    squares += float(errors @ errors)
                count, states = count + len(errors), states + projected
                if with_gradient:
                    rows.add(np.column_stack([gradient, errors]))
        return PredictionErrors(squares if np.isfinite(squares) else np.inf, count, states, rows.values)

    def stabilise(self, theta: np.ndarray) -> np.ndarray:
        """The coefficients with stable filters."""
        return stabilise(self.structure, theta)


def fit_prediction_error(
    structure: PolynomialStructure,
    data: SampledData,
    estimate_starts: Starts,
    history: HistoryTreatment,
    policy: PredictionErrorPolicy = DEFAULT_SEARCH,
) -> PolynomialModel:
    """The best minimum from the best of the starts that ``estimate_starts`` makes, for scaled data.

    Raises DataError where there are too few rows or the columns are collinear.
    """
    problem = PredictionErrorProblem(structure, data, split_records(data, structure), history == "zero")
    label = structure.model(np.zeros(structure.size), data).label
    count = int(sum(np.isfinite(part.y).sum() for part in problem.parts))
    refuse_few_rows(data, label, count, structure.size, history)
    starts = [problem.stabilise(start) for start in estimate_starts(structure, data, problem.rest)]
    errors = [problem.evaluate(start, False) for start in starts] if problem.parts else []
    states = max((e.states for e in errors), default=0)
    refuse_few_rows(data, label, count - states, structure.size, history)
    best = minimise_from_starts(problem, starts, [e.squares for e in errors], policy)
    model = structure.model(best.theta, data)
    refuse_collinear(best.errors, list(model.coefficients), label)
    freedom = count - structure.size - best.errors.states
    covariance = estimate_coefficient_covariance(best.errors, freedom)
    finished = replace(finish_model(model, best, count, freedom, history), covariance=covariance)
    return finished.in_units(data.scaling)


def check_history(history: str) -> None:
    """Refuse, with DataError, a history that is neither estimated nor zero."""
    if history not in get_args(HistoryTreatment):
        raise DataError(f"unknown history {history!r}; {nearest(history, get_args(HistoryTreatment))}")


# ---- Errors and gradients ----


def split_records(data: SampledData, structure: PolynomialStructure) -> tuple[SampledRecord, ...]:
    """What has one initial state each: whole records for an output error, the parts between gaps where the past outputs count."""
    if not (structure.orders.na or structure.nc or structure.nd):
        return data.records
    least = 2 * max(structure.orders.reach, structure.nc, *structure.nf) + structure.nd + 2
    return tuple(part for record in data.records for part in record.segments(least))


def _each_block_of_errors(
    structure: PolynomialStructure, model: PolynomialModel, part: SampledRecord, rest: bool, with_gradient: bool
) -> Iterator[tuple[np.ndarray, np.ndarray, int]]:
    """Errors (n,), gradient (n, p) and number of initial states of one part of a record, block by block of its rows.

    The first block reaches until the past is forgotten: only there is anything to project out.
    """
    c, d = model.c, model.d
    memory = count_rows_of_memory(model, part.rows, c)
    through = [BlockFilter(b, f) for b, f in zip(model.b, model.f, strict=True)]
    regression, whitened = BlockFilter(model.a, ONE), BlockFilter(d, c)
    course = ConstantCourse(model.f[0], rest) if structure.offset else None
    slopes = _Slopes.of(structure, model) if with_gradient else None
    for rows in each_block(part.rows, memory):
        begins = rows.start == 0
        measured = np.isfinite(part.y[rows])
        driven = [run(signal[rows]) for run, signal in zip(through, part.signals, strict=True)]
        # Output error: the zeros in the gaps meet no filter, and their rows are left out below.
        y = part.y[rows] if measured.all() else np.where(measured, part.y[rows], 0.0)
        constant = course(len(y)) if course is not None else np.zeros(len(y))
        equation_error = regression(y) - sum(driven) - (model.constant or 0.0) * constant
        # e = D / C (A y - sum B / F u - constant / F_1)
        e = whitened(equation_error)
        projection = _project(np.empty((0, 0)))
        blocks = []
        if begins and not rest:
            blocks = compute_initial_responses(model, memory, [len(model.a) + len(d) - 1, len(c)], c)
            responses = np.hstack([np.empty((memory, 0)), *blocks])
            projection = _project(responses[measured[:memory]])
        projected = projection.remove(e[measured])
        if slopes is None:
            yield projected, np.empty((len(projected), 0)), projection.states
            continue
        if begins and not rest:
            initial = projection.coefficients(e[measured])
            # The drive of each input includes what its own unknown past adds.
            slopes.set_past(np.split(initial, np.cumsum([block.shape[1] for block in blocks])[:-1]) if blocks else [])
            # The past as found belongs to the errors that the gradient of C sees: de/dc_j = -1 / C q^-j e.
            e[:memory] -= responses @ initial
        functions = [each[rows] for each in part.basis]
        if structure.offset and not rest:
            # F_1 acts on what drives the first input and on the constant.
            driven[0] = driven[0] + (model.constant or 0.0) * constant
        gradient = slopes.take(part, rows, y, equation_error, driven, constant, e, functions)
        if rest and structure.offset:
            # A constant that had always been there, c / F_1(1): its derivative to each f is -c / F_1(1)^2.
            first = sum((structure.orders.na, *structure.orders.nb))
            last = structure.size - 1
            share = (model.constant or 0.0) / model.f[0].sum()
            gradient[:, first : first + structure.nf[0]] -= share * gradient[:, [last]]
        gradient = gradient[measured]
        yield projected, projection.remove(gradient), projection.states


@dataclass(frozen=True, eq=False)
class _Projection:
    """Orthonormal ``basis`` (k, r) of the free responses, which are over after k rows, and ``back`` (m, r) to their coefficients."""

    basis: np.ndarray
    back: np.ndarray

    @property
    def states(self) -> int:
        return self.basis.shape[1]

    def remove(self, values: np.ndarray) -> np.ndarray:
        """``values`` (n, ...) without their part along the free responses."""
        if not self.states:
            return values
        remainder, k = values.copy(), len(self.basis)
        remainder[:k] -= self.basis @ (self.basis.T @ values[:k])
        return remainder

    def coefficients(self, e: np.ndarray) -> np.ndarray:
        """Coefficients (m,) of the free responses that come nearest to ``e`` (n,)."""
        # Least squares of the past, used in the gradient alone: errors have it projected out (variable projection).
        return self.back @ (self.basis.T @ e[: len(self.basis)])


def _project(responses: np.ndarray) -> _Projection:
    """The span of the columns of ``responses`` (n, m)."""
    if not responses.size:
        return _Projection(np.empty((0, 0)), np.zeros((responses.shape[1], 0)))
    q, triangle = np.linalg.qr(responses)
    left, size, right = np.linalg.svd(triangle, full_matrices=False)
    # Responses of several inputs may span the same: a dependent one is no further state.
    kept = size > NEGLIGIBLE_SINGULAR_VALUE * size[0]
    return _Projection(q @ left[:, kept], right[kept].T / size[kept])


@dataclass(eq=False)
class _Slopes:
    """Derivatives of the errors in the order of the vector: filtered signals, each filter with its memory from block to block."""

    structure: PolynomialStructure
    model: PolynomialModel
    filters: dict[str, list[BlockFilter]]
    delays: dict[str, list[BlockDelay]]
    past: list[BlockFilter | None]

    @classmethod
    def of(cls, structure: PolynomialStructure, model: PolynomialModel) -> _Slopes:
        """Those of ``model`` before the first block."""
        c, d, orders = model.c, model.d, structure.orders
        below = [np.convolve(c, f) for f in model.f]
        filters = {
            # de/da_j = D / C q^-j y
            "a": [BlockFilter(d, c)],
            # de/db_j = -D / (C F) q^-j u
            "b": [BlockFilter(d, each) for each in below],
            # de/df_j = 1 / (C F) q^-j w
            "f": [BlockFilter(ONE, each) for each in below],
            "drive": [BlockFilter(d, ONE) for _ in below],
            # de/dc_j = -1 / C q^-j e
            "c": [BlockFilter(ONE, c)],
            # de/dd_j = 1 / C q^-j (A y - sum B / F u - constant / F_1)
            "d": [BlockFilter(ONE, c)],
            "constant": [BlockFilter(d, c)],
            "basis": [BlockFilter(np.convolve(b, d), each) for b, each in zip(model.b, below, strict=True)],
        }
        delays = {
            "a": [BlockDelay(orders.na)],
            "b": [BlockDelay(nk + nb - 1) for nb, nk in zip(orders.nb, orders.nk, strict=True)],
            "f": [BlockDelay(nf) for nf in structure.nf],
            "c": [BlockDelay(structure.nc)],
            "d": [BlockDelay(structure.nd)],
        }
        return cls(structure, model, filters, delays, [None] * len(below))

    def set_past(self, shares: Sequence[np.ndarray]) -> None:
        """What the time before the record adds to the drive of each input: its shares of the responses ``q^-j / F``."""
        self.past = [BlockFilter(s, f) if len(s) else None for s, f in zip(shares, self.model.f, strict=True)]

    def take(
        self,
        part: SampledRecord,
        rows: slice,
        y: np.ndarray,
        equation_error: np.ndarray,
        driven: Sequence[np.ndarray],
        constant: np.ndarray,
        e: np.ndarray,
        functions: Sequence[np.ndarray],
    ) -> np.ndarray:
        """Those of the next block (n, p), from its signals (n,) and the functions (n, m) of each input."""
        orders, structure = self.structure.orders, self.structure

        def columns(
            letter: str, place: int, signal: np.ndarray, delays: Sequence[int], sign: float
        ) -> list[np.ndarray]:
            if not len(delays):
                return []
            delay = self.delays[letter][place]
            delay.take(sign * self.filters[letter][place](signal))
            return [delay.delayed(j) for j in delays]

        slopes = columns("a", 0, y, range(1, orders.na + 1), 1.0)
        for i, (nb, nk, signal) in enumerate(zip(orders.nb, orders.nk, part.signals, strict=True)):
            slopes += columns("b", i, signal[rows], range(nk, nk + nb), -1.0)
        # w = D B / F u (of the first input with the constant) + its past, which is a pulse in the first row through q^-j / F.
        pulse = np.zeros(len(y))
        pulse[: rows.start == 0] = 1.0
        for i, (nf, w, past) in enumerate(zip(structure.nf, driven, self.past, strict=True)):
            drive = self.filters["drive"][i](w)
            if past is not None:
                drive = drive + past(pulse)
            slopes += columns("f", i, drive, range(1, nf + 1), 1.0)
        slopes += columns("c", 0, e, range(1, structure.nc + 1), -1.0)
        slopes += columns("d", 0, equation_error, range(1, structure.nd + 1), 1.0)
        if structure.offset:
            slopes.append(-self.filters["constant"][0](constant))
        slopes += [-slope(each) for slope, each in zip(self.filters["basis"], functions, strict=False)]
        return np.column_stack(slopes)


# ---- Search ----


# Relative difference of two starts' sums of squares below which they are the same start.
PREDICTION_ERROR_DUPLICATE = 0.001


def minimise_from_starts(
    problem: PredictionErrorProblem,
    starts: Sequence[np.ndarray],
    squares: Sequence[float],
    policy: PredictionErrorPolicy = DEFAULT_SEARCH,
) -> PredictionErrorMinimum:
    """Short searches from the ``starts`` that differ, and a long one from where the best of them ended."""
    distinct: list[int] = []
    for k in sorted(range(len(starts)), key=lambda k: squares[k]):
        if all(abs(squares[k] - squares[c]) > PREDICTION_ERROR_DUPLICATE * squares[c] for c in distinct):
            distinct.append(k)
    followed = distinct[: policy.starts]
    first = policy.first_iterations if len(followed) > 1 else policy.iterations
    minima = [minimise_prediction_errors(problem, starts[k], policy=policy, iterations=first) for k in followed]
    best = min(minima, key=lambda m: m.errors.squares)
    if best.converged or first == policy.iterations:
        return best
    return minimise_prediction_errors(problem, best.theta, policy=policy)


def minimise_prediction_errors(
    problem: PredictionErrorProblem,
    start: np.ndarray,
    *,
    policy: PredictionErrorPolicy = DEFAULT_SEARCH,
    iterations: int | None = None,
) -> PredictionErrorMinimum:
    """Damped Gauss-Newton steps from ``start`` (p,); ``iterations``: None takes those of the ``policy``.

    Where that ends at an integrator the steps go on along the limit: those that point beyond it had nowhere to go.
    """
    limit = policy.iterations if iterations is None else iterations
    begin = problem.stabilise(start)
    free = _search(problem, begin, np.eye(len(begin)), policy, limit)
    kept = keep_integrators(problem.structure, free.theta)
    if kept is None:
        return free
    along = _search(problem, free.theta, kept, policy, limit)
    return along if along.errors.squares < free.errors.squares else free


def _search(
    problem: PredictionErrorProblem,
    begin: np.ndarray,
    directions: np.ndarray,
    policy: PredictionErrorPolicy,
    iterations: int,
) -> PredictionErrorMinimum:
    """Damped Gauss-Newton steps from ``begin`` (p,) along ``directions`` (p, m)."""
    everywhere = directions.shape[0] == directions.shape[1]

    def at(z: np.ndarray) -> np.ndarray:
        return z if everywhere else begin + directions @ z

    def evaluate(z: np.ndarray) -> _ErrorModel:
        return _ErrorModel.at(problem.evaluate(at(z), True), directions)

    z = begin if everywhere else np.zeros(directions.shape[1])
    unbounded = np.full(len(z), np.inf)
    first = evaluate(z)
    result = minimise(
        evaluate,
        z,
        -unbounded,
        unbounded,
        method=MinimisationMethod.GAUSS_NEWTON,
        value_at_start=first,
        iterations=iterations,
        termination_test=minimisation.Termination(policy.termination, count=first.errors.count).test,
        # Along the limit the other roots stay inside by the cost: beyond the circle the errors grow.
        project=problem.stabilise if everywhere else None,
        cost=lambda z: problem.evaluate(at(z), False).squares,
        policy=minimisation.MinimisationPolicy(damped=policy.damped),
    )
    # Where no step is short enough to help, the errors are as small as rounding allows.
    ended = result.status is not minimisation.TerminationStatus.ITERATION_LIMIT
    return PredictionErrorMinimum(at(result.z), (result.value or first).errors, result.iterations, ended)


# A real root of ``F`` this near one is an integrator's.
INTEGRATOR = 1e-6


def keep_integrators(structure: PolynomialStructure, theta: np.ndarray) -> np.ndarray | None:
    """Directions (p, m), orthonormal, in which every integrator of an ``F`` stays where it is; None where there is none."""
    parts, ends = structure.parts(theta[: structure.size]), np.cumsum(structure.sizes)
    n, rows = len(structure.nf), []
    for k in range(1 + n, 1 + 2 * n):
        roots = np.roots(to_monic(parts[k]))
        near = roots.real[(np.abs(roots.imag) < INTEGRATOR) & (roots.real > 1 - INTEGRATOR)]
        if len(near):
            # F(r) = 1 + sum f_j r^-j = 0 is linear in F.
            row = np.zeros(len(theta))
            row[ends[k - 1] : ends[k]] = near.max() ** -np.arange(1.0, len(parts[k]) + 1)
            rows.append(row)
    return null_space(np.array(rows)) if rows else None


@dataclass(frozen=True, eq=False)
class _ErrorModel(QuadraticModel):
    """The sum of squares of ``errors`` as a function of the coefficients, near those that they belong to."""

    errors: PredictionErrors

    @classmethod
    def at(cls, errors: PredictionErrors, directions: np.ndarray) -> _ErrorModel:
        """Near ``errors``, along ``directions`` (p, m)."""
        assert errors.triangle is not None
        m = directions.shape[1]
        if not np.isfinite(errors.squares) or not np.isfinite(errors.triangle).all():
            return cls(np.inf, np.zeros(m), np.zeros((m, m)), errors)
        triangle = errors.triangle
        if m < len(directions):
            along = np.column_stack([errors.gradient @ directions, triangle[:, -1]])
            triangle = np.asarray(np.linalg.qr(along, mode="r"))
        model = QuadraticModel.from_triangle(triangle, errors.squares)
        return cls(model.cost, model.gradient, model.hessian, errors, factor=model.factor)


def stabilise(structure: PolynomialStructure, theta: np.ndarray) -> np.ndarray:
    """``theta`` (p,) with ``C`` and ``D`` reflected into, and the roots of ``F`` held inside the unit circle."""
    parts = structure.parts(theta)
    n = len(structure.nf)
    for k in range(1 + n, 1 + 2 * n):
        # F is moved, not mirrored: a mirrored pole has another phase, and the free run would be another one. Of C
        # and D the spectrum alone counts.
        parts[k] = confine_roots(to_monic(parts[k]))[1:]
    for k in (1 + 2 * n, 2 + 2 * n):
        parts[k] = reflect_roots(to_monic(parts[k]))[1:]
    return np.concatenate(parts)


# ---- The finished model ----


def estimate_coefficient_covariance(errors: PredictionErrors, freedom: int) -> np.ndarray:
    """Covariance (p, p) of the coefficients, for a white error."""
    gradient = errors.gradient
    scale = np.linalg.norm(gradient, axis=0)
    _, size, right = np.linalg.svd(gradient / scale, full_matrices=False)
    inverse = right.T / size
    return errors.squares / freedom * (inverse @ inverse.T) / np.outer(scale, scale)


def refuse_collinear(errors: PredictionErrors, names: Sequence[str], label: str) -> None:
    """DataError that names the coefficients whose derivatives are zero or linearly dependent."""
    gradient = errors.gradient
    scale = np.linalg.norm(gradient, axis=0)
    without_effect = [n for n, s in zip(names, scale, strict=True) if s == 0]
    if without_effect:
        raise DataError(
            f"{label}: {', '.join(without_effect)} have no effect in these records; take a smaller structure"
        )
    _, size, right = np.linalg.svd(gradient / scale)
    if size[-1] <= COLLINEAR_COLUMNS * np.sqrt(errors.count):
        participation = np.abs(right[-1]) / np.abs(right[-1]).max()
        dependent = [n for n, s in zip(names, participation, strict=True) if s > DEPENDENT_COLUMN_SHARE]
        raise DataError(
            f"{label}: the coefficients {', '.join(dependent)} are not distinguishable in these records; a constant"
            " input (a step after its edge) determines one, and each sine two: take a smaller structure, history='zero' where the"
            " record begins at rest and with the step's edge, or a record with a richer input"
        )


def finish_model(
    model: PolynomialModel, best: PredictionErrorMinimum, count: int, freedom: int, history: str
) -> PolynomialModel:
    """The model with its noise, of ``count`` errors with so much ``freedom``, and with what is to be known of its search."""
    # A, C and D of order zero are 1, one coefficient each: then the errors are those of a simulation.
    has_noise_model = len(model.a) + len(model.c) + len(model.d) > 3
    return replace(
        model,
        noise_std=float(np.sqrt(best.errors.squares / freedom)),
        samples=count,
        loss=best.errors.squares / count,
        history=history,
        focus="prediction" if has_noise_model else "simulation",
        findings=(*find_unfinished_search(best.converged, best.iterations), *find_instability(model)),
    )


# Where prediction-error searches start: linear estimates that need no start of their own.


def solve_equations(
    data: SampledData, orders: Orders, offset: bool, rest: bool, prefilter: np.ndarray | None = None
) -> np.ndarray:
    """Least squares of smallest norm (p,) of the usable ARX equations, those of each record filtered by ``1 / prefilter``."""
    equations = collect_equations(data, orders, offset, "zero" if rest else "measured", prefilter)
    return _solve(equations, orders.na + sum(orders.nb) + offset)


def _solve(equations: RowTriangle, unknowns: int) -> np.ndarray:
    """Least squares of smallest norm (p,); zero without an equation."""
    if equations.values is None:
        return np.zeros(unknowns)
    # What is rounding among the singular values grows with the rows, of which the triangle has few.
    rounding = np.finfo(float).eps * max(equations.rows, unknowns)
    return np.linalg.lstsq(equations.values[:, :-1], equations.values[:, -1], rcond=rounding)[0]


def interpolate_gaps(data: SampledData) -> SampledData:
    """``data`` with gaps filled by straight lines: good enough for a start, never for an estimate."""

    def interpolate(record: SampledRecord) -> SampledRecord:
        gaps = np.isnan(record.y)
        if not gaps.any():
            return record
        measured = np.flatnonzero(~gaps)
        return replace(record, y=np.interp(np.arange(record.rows), measured, record.y[measured]))

    return replace(data, records=tuple(map(interpolate, data.records)))


# Passes of Steiglitz and McBride's filter.
FILTER_PASSES = 8


def estimate_output_error_starts(structure: PolynomialStructure, data: SampledData, rest: bool) -> list[np.ndarray]:
    """Candidates for ``B / F``: ARX, Steiglitz and McBride's iteration (one ``F`` for all inputs), and realised impulse responses."""
    filled, orders = interpolate_gaps(data), structure.orders
    candidates: list[tuple[np.ndarray, ...]] = []
    poles = max(structure.nf)
    if len(set(structure.nf)) == 1 and poles:
        equations = filled, replace(orders, na=poles), structure.offset, rest
        a = to_monic(solve_equations(*equations)[:poles])
        candidates.append((confine_roots(a),) * len(orders.nb))
        for _ in range(FILTER_PASSES):
            a = to_monic(solve_equations(*equations, reflect_roots(a))[:poles])
            candidates.append((confine_roots(reflect_roots(a)),) * len(orders.nb))
    candidates.append(tuple(map(confine_roots, _realise_poles(structure, filled, rest))))
    return [_with_best_numerators(structure, f, data, rest) for f in candidates]


def estimate_armax_starts(structure: PolynomialStructure, data: SampledData, rest: bool) -> list[np.ndarray]:
    """Candidates for ``A, B, C``: ARX with ``C = 1``, pseudo-linear regression on a long ARX model's innovations (Hannan and
    Rissanen 1982), and Steiglitz and McBride's ``A`` with ``C = A``, which white noise on the output alone would have."""
    filled, orders = interpolate_gaps(data), structure.orders
    equations = filled, orders, structure.offset, rest
    plain = solve_equations(*equations)
    starts = [_with_noise(structure, plain, np.zeros(structure.nc))]
    a = to_monic(plain[: orders.na])
    for _ in range(FILTER_PASSES if orders.na else 0):
        theta = solve_equations(*equations, reflect_roots(a))
        a = to_monic(theta[: orders.na])
        stable = reflect_roots(a)[1:]
        # C = A: white noise on the output alone, seen through A y = B u + A e.
        noise = np.append(stable, np.zeros(structure.nc))[: structure.nc]
        starts.append(_with_noise(structure, np.append(stable, theta[orders.na :]), noise))
    return starts + list(_pseudo_linear_starts(structure, filled, rest))


def estimate_box_jenkins_starts(structure: PolynomialStructure, data: SampledData, rest: bool) -> list[np.ndarray]:
    """Candidates for ``B / F`` as of an output error, the best of them with ``C / D`` from its residual."""
    plain = replace(structure, kind="output error", nc=0, nd=0)
    starts = estimate_output_error_starts(plain, data, rest)
    problem = PredictionErrorProblem(plain, data, data.records, rest)
    squares = [problem.evaluate(start, False).squares for start in starts]
    noise = PolynomialStructure("arma", Orders(structure.nd, (), ()), (), nc=structure.nc)
    candidates = []
    for start in (starts[k] for k in np.argsort(squares)[:2]):
        model = plain.model(start, data)
        runs = [predict_ahead(model, s, 1, "zero" if rest else "estimated", None)[0] for s in data.records]
        residuals = [replace(s, y=s.y - run, signals=()) for s, run in zip(data.records, runs, strict=True)]
        residual = replace(data, inputs=(), records=tuple(residuals))
        for coloured in estimate_armax_starts(noise, residual, rest):
            d, c = np.split(coloured, [structure.nd])
            parts = structure.parts(structure.vector(model))
            parts[-3], parts[-2] = c, reflect_roots(to_monic(d))[1:]
            candidates.append(np.concatenate(parts))
    return candidates


# Passes of the pseudo-linear regression on the innovations (Hannan and Rissanen 1982).
INNOVATION_PASSES = 4


def _pseudo_linear_starts(structure: PolynomialStructure, data: SampledData, rest: bool) -> Iterator[np.ndarray]:
    """Least squares with the last estimate's innovations as further columns."""
    orders = structure.orders
    long = _long_orders(orders, structure.nc, data)
    model = solve_equations(data, long, structure.offset, rest)
    innovations = [np.empty(s.rows) for s in data.records]
    for record, e in zip(data.records, innovations, strict=True):
        for rows in each_block(record.rows):
            e[rows] = record.y[rows] - build_regressors(record, long, structure.offset, rows) @ model
        e[: 0 if rest else long.reach] = 0.0
    for _ in range(INNOVATION_PASSES):
        equations = RowTriangle()
        for record, e in zip(data.records, innovations, strict=True):
            first = 0 if rest else orders.reach + structure.nc
            for rows in each_block(record.rows):
                noise = delayed_columns(e, rows, range(1, structure.nc + 1))
                known = build_regressors(record, orders, structure.offset, rows)
                equations.add(np.column_stack([known, *noise, record.y[rows]])[max(first - rows.start, 0) :])
        theta = _solve(equations, structure.size)
        split = len(theta) - structure.nc
        c = reflect_roots(to_monic(theta[split:]))
        yield _with_noise(structure, theta[:split], c[1:])
        for record, e in zip(data.records, innovations, strict=True):
            through = BlockFilter(ONE, c)
            for rows in each_block(record.rows):
                known = build_regressors(record, orders, structure.offset, rows)
                e[rows] = through(record.y[rows] - known @ theta[:split])
            e[: 0 if rest else orders.reach] = 0.0


def _with_noise(structure: PolynomialStructure, plain: np.ndarray, c: np.ndarray) -> np.ndarray:
    """The structure's vector from ARX coefficients and ``c``; ``F`` and ``D`` are one."""
    arx = PolynomialStructure("arx", structure.orders, (0,) * len(structure.nf), offset=structure.offset).parts(plain)
    n = len(structure.nf)
    inputs = [np.zeros(k) for k in structure.nf]
    return np.concatenate([*arx[: 1 + n], *inputs, c, np.zeros(structure.nd), arx[-1]])


def _with_best_numerators(
    structure: PolynomialStructure, f: Sequence[np.ndarray], data: SampledData, rest: bool
) -> np.ndarray:
    """The structure's vector with these ``F`` and, for them, the best ``B`` and constant: a linear problem."""
    parts = structure.parts(np.zeros(structure.size))
    n = len(structure.nf)
    for k in range(n):
        parts[1 + n + k] = f[k][1:]
    start = np.concatenate(parts)
    linear = [*range(1, 1 + n), len(parts) - 1]
    free = np.concatenate([np.full(size, k in linear) for k, size in enumerate(structure.sizes)])
    errors = PredictionErrorProblem(structure, data, data.records, rest).evaluate(start, True)
    assert errors.triangle is not None
    start[free] = QuadraticModel.from_residuals(errors.gradient[:, free], errors.triangle[:, -1]).bounded_step()
    return start


# Least order of the long ARX model whose innovations and impulse response the starts are made of.
LONG_ORDER = 12
# Order of the long ARX model over that of the structure, where this is larger.
LONG_ORDER_FACTOR = 3
# Measured values for each coefficient of the long ARX model, at least: more coefficients would fit noise.
ROWS_PER_LONG_ORDER = 10


def _long_orders(orders: Orders, more: int, data: SampledData) -> Orders:
    """Orders of an ARX model that is long enough to whiten its errors, and no longer than the records allow."""
    largest = max(1, data.measured // (ROWS_PER_LONG_ORDER * (1 + len(orders.nb))))
    order = min(max(LONG_ORDER, LONG_ORDER_FACTOR * (orders.na + more)), largest)
    return Orders(max(order, orders.na), tuple(max(order, b) for b in orders.nb), orders.nk)


# Least number of impulse-response samples that are realised as a state space.
IMPULSE_ROWS = 60
# Impulse-response samples for each pole, where this is more.
IMPULSE_ROWS_PER_POLE = 12


def _realise_poles(structure: PolynomialStructure, data: SampledData, rest: bool) -> list[np.ndarray]:
    """``F`` of each input from the impulse response of a long ARX model, by Ho and Kalman's realisation (Kung 1978)."""
    long = _long_orders(replace(structure.orders, na=max(structure.nf)), max(structure.nf), data)
    theta = solve_equations(data, long, structure.offset, rest)
    shape = PolynomialStructure("arx", long, (0,) * len(structure.nf), offset=structure.offset)
    model = shape.model(theta, data)
    polynomials = []
    for b, nk, nf in zip(model.b, long.nk, structure.nf, strict=True):
        length = max(IMPULSE_ROWS, IMPULSE_ROWS_PER_POLE * nf)
        response = lfilter(b, reflect_roots(model.a), np.eye(1, 2 * length + nk + 1)[0])[nk + 1 :]
        if nf == 0 or not response.any():
            polynomials.append(np.append(1.0, np.zeros(nf)))
            continue
        # H_ij = g(i + j + 1) = C A^{i+j} B: its column space is that of the observability matrix.
        hankel = response[np.add.outer(np.arange(length), np.arange(length))]
        left, size, _ = np.linalg.svd(hankel)
        observability = left[:, :nf] * np.sqrt(size[:nf])
        transition = np.linalg.lstsq(observability[:-1], observability[1:], rcond=None)[0]
        polynomials.append(np.real(np.poly(np.linalg.eigvals(transition))))
    return polynomials
