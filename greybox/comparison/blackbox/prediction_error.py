"""Prediction-error models: errors, gradients, the search with its starts, and the finished model with its covariance.

Over ``theta`` the sum of squares of ``e = D / C (A y - sum B / F u - constant)`` is minimised. The unknown past of each record
(of each part between gaps, where the predictor uses measured outputs) enters linearly; it is eliminated by projecting
errors and gradients off its responses (variable projection, Golub and Pereyra 1973, with Kaufman's gradient). The gradients are
filtered signals (Ljung, System identification, 2nd ed., section 10.3)::

    de/da_j = D / C q^-j y      de/db_j = -D / (C F) q^-j u      de/df_j = 1 / (C F) q^-j w,   w = D B / F u + its past
    de/dc_j = -1 / C q^-j e     de/dd_j = 1 / C q^-j (A y - sum B / F u - constant)
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, get_args

import numpy as np
from scipy.signal import lfilter

from greybox.base.errors import DataError, nearest
from greybox.base.numerics import COLLINEAR_COLUMNS, DEPENDENT_COLUMN_SHARE, FADED_RESPONSE, NEGLIGIBLE_SINGULAR_VALUE
from greybox.comparison.blackbox.arx import find_instability, find_unfinished_search
from greybox.comparison.blackbox.linear_regression import (
    Orders,
    SampledData,
    SampledRecord,
    build_regressors,
    delay_rows,
    find_usable_rows,
    refuse_few_rows,
)
from greybox.comparison.blackbox.polynomial import (
    PolynomialModel,
    PolynomialStructure,
    compute_initial_responses,
    confine_roots,
    predict_ahead,
    reflect_roots,
    to_monic,
)
from greybox.estimation.optim.methods import MinimisationMethod, minimise
from greybox.estimation.optim.minimisation import (
    GaussNewtonPolicy,
    MinimisationPolicy,
    Termination,
    TerminationPolicy,
    TerminationStatus,
)
from greybox.estimation.optim.quadratic_model import QuadraticModel

HistoryTreatment = Literal["estimated", "zero"]
Starts = Callable[[PolynomialStructure, SampledData, bool], Sequence[np.ndarray]]


@dataclass(frozen=True)
class PredictionErrorPolicy:
    """How hard a prediction-error model is searched for (ARMAX, output error, Box-Jenkins, Hammerstein)."""

    starts: int = 3
    """Starting points that are followed, best first. The linear estimates seldom disagree more than threefold."""
    first_iterations: int = 8
    """Iterations from each start; after these only the best goes on. Enough to tell basins apart."""
    iterations: int = 100
    """Iterations of the final search. A quadratically converging search needs about ten."""
    termination: TerminationPolicy = field(
        default_factory=lambda: TerminationPolicy(
            negligible_decrease=1e-12, perfect_noise_ratio=0.0, patience=1, little_gain=1e-12
        )
    )
    """When a search ends: a millionth of a standard deviation gives the coefficients their digits. The errors are in the output's unit, so
    that none is small by itself."""
    damped: GaussNewtonPolicy = field(
        default_factory=lambda: GaussNewtonPolicy(initial_damping=1e-4, max_rejections=10, max_kink_steps=100)
    )
    """How its steps are damped. Starts are far off, and there are no kinks."""


DEFAULT_SEARCH = PredictionErrorPolicy()


@dataclass(frozen=True, eq=False)
class PredictionErrors:
    """One-step errors of all parts of the records with the unknown past projected out.

    Attributes
    ----------
    e
        Errors (n,).
    gradient
        Their derivatives (n, p) with respect to the coefficients; no columns where they were not asked for.
    states
        Number of initial states that were projected out.
    """

    e: np.ndarray
    gradient: np.ndarray
    states: int

    @property
    def squares(self) -> float:
        """Sum of squares; infinite where the errors leave all bounds."""
        with np.errstate(over="ignore", invalid="ignore"):
            squares = float(self.e @ self.e)
        return squares if np.isfinite(squares) else np.inf


@dataclass(frozen=True, eq=False)
class PredictionErrorMinimum:
    """Where a search ended: ``theta`` (p,), its errors, iterations, and whether it converged."""

    theta: np.ndarray
    errors: PredictionErrors
    iterations: int
    converged: bool


@dataclass(frozen=True, eq=False)
class PredictionErrorProblem:
    """A structure and the parts of the records that it is fitted to; ``rest``: all was zero before them."""

    structure: PolynomialStructure
    data: SampledData
    parts: tuple[SampledRecord, ...]
    rest: bool

    def evaluate(self, theta: np.ndarray, with_gradient: bool) -> PredictionErrors:
        """Errors at the coefficients ``theta`` (p,)."""
        return compute_prediction_errors(
            self.structure, theta, self.data, self.parts, rest=self.rest, with_gradient=with_gradient
        )

    def stabilise(self, theta: np.ndarray) -> np.ndarray:
        """The coefficients with stable filters."""
        return stabilise(self.structure, theta)


def fit_prediction_error(
    structure: PolynomialStructure,
    data: SampledData,
    estimate_starts: Starts,
    history: HistoryTreatment,
    units: Mapping[str, str] | None = None,
    policy: PredictionErrorPolicy = DEFAULT_SEARCH,
) -> PolynomialModel:
    """The best minimum from the best of the starts that ``estimate_starts`` makes.

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
    return _finish(structure, data, best, count, label, history, units or {})


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


def compute_prediction_errors(
    structure: PolynomialStructure,
    theta: np.ndarray,
    data: SampledData,
    parts: Sequence[SampledRecord],
    *,
    rest: bool,
    with_gradient: bool,
) -> PredictionErrors:
    """Errors at ``theta``, and their gradient if wanted; ``rest``: everything was zero before each record, nothing is projected out.

    Behind the derivatives to ``theta`` stand those to the weights of each input's ``basis``, where the parts have them.
    """
    model = structure.model(theta, data)
    results = [_errors_of_part(structure, model, part, rest, with_gradient) for part in parts]
    e, gradient, states = zip(*results, strict=True)
    return PredictionErrors(np.concatenate(e), np.concatenate(gradient), sum(states))


def _errors_of_part(
    structure: PolynomialStructure, model: PolynomialModel, part: SampledRecord, rest: bool, with_gradient: bool
) -> tuple[np.ndarray, np.ndarray, int]:
    """Errors, gradient and number of initial states of one part of a record."""
    c, d, measured = model.c, model.d, np.isfinite(part.y)
    through = [lfilter(b, f, u) for b, f, u in zip(model.b, model.f, part.u.T, strict=True)]
    # Output error: the zeros in the gaps meet no filter, and their rows are left out below.
    y = part.y if measured.all() else np.where(measured, part.y, 0.0)
    equation_error = lfilter(model.a, [1.0], y) - sum(through) - (model.constant or 0.0)
    # e = D / C (A y - sum B / F u - constant)
    e = lfilter(d, c, equation_error)
    rows = _rows_of_memory(model, part.rows)
    blocks = [] if rest else compute_initial_responses(model, rows, [len(model.a) + len(d) - 1, len(c)], c)
    responses = np.hstack([np.empty((rows, 0)), *blocks])
    projection = _project(responses[measured[:rows]])
    projected = projection.remove(e[measured])
    if not with_gradient:
        return projected, np.empty((len(projected), 0)), projection.states
    initial = projection.coefficients(e[measured])
    # The drive of each input includes what its own unknown past adds.
    ends = np.cumsum([block.shape[1] for block in blocks])
    initial_by_input = np.split(initial, ends[:-1]) if blocks else [np.empty(0)] * len(through)
    driven = [
        lfilter(d, [1.0], w) + lfilter(s, f, np.eye(1, part.rows)[0]) if len(s) else lfilter(d, [1.0], w)
        for w, s, f in zip(through, initial_by_input, model.f, strict=True)
    ]
    # The past as found belongs to the errors that the gradient of C sees: de/dc_j = -1 / C q^-j e.
    e[:rows] -= responses @ initial
    gradient = _gradient(structure, model, part, y, equation_error, driven, e)[measured]
    return projected, projection.remove(gradient), projection.states


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
    left, size, right = np.linalg.svd(triangle)
    # Responses of several inputs may span the same: a dependent one is no further state.
    kept = size > NEGLIGIBLE_SINGULAR_VALUE * size[0]
    return _Projection(q @ left[:, kept], right[kept].T / size[kept])


def _rows_of_memory(model: PolynomialModel, rows: int) -> int:
    """Rows after which what was before the record is forgotten, at most ``rows``: by then the slowest root has faded."""
    slowest = max((float(np.abs(np.roots(p)).max(initial=0.0)) for p in (model.c, *model.f)), default=0.0)
    longest = max(len(model.a) + len(model.d), len(model.c), *(len(b) + len(model.d) for b in model.b)) + len(model.d)
    if slowest <= 0:
        return min(rows, longest)
    if slowest >= 1:
        return rows
    # Half as long again, for roots of several filters that meet.
    return int(min(rows, longest + 10 + 1.5 * np.log(FADED_RESPONSE) / np.log(slowest)))


def _gradient(
    structure: PolynomialStructure,
    model: PolynomialModel,
    part: SampledRecord,
    y: np.ndarray,
    equation_error: np.ndarray,
    driven: Sequence[np.ndarray],
    e: np.ndarray,
) -> np.ndarray:
    """Derivatives (N, p) of the errors ``e`` (N,), in the order of the structure's vector."""
    orders, c, d = structure.orders, model.c, model.d
    # de/da_j = D / C q^-j y
    filtered = lfilter(d, c, y)
    columns = [delay_rows(filtered, j) for j in range(1, orders.na + 1)]
    for f, nb, nk, u in zip(model.f, orders.nb, orders.nk, part.u.T, strict=True):
        # de/db_j = -D / (C F) q^-j u
        filtered = -lfilter(d, np.convolve(c, f), u)
        columns += [delay_rows(filtered, nk + j) for j in range(nb)]
    for f, nf, drive in zip(model.f, structure.nf, driven, strict=True):
        # de/df_j = 1 / (C F) q^-j w
        filtered = lfilter([1.0], np.convolve(c, f), drive)
        columns += [delay_rows(filtered, j) for j in range(1, nf + 1)]
    # de/dc_j = -1 / C q^-j e
    filtered = -lfilter([1.0], c, e)
    columns += [delay_rows(filtered, j) for j in range(1, structure.nc + 1)]
    # de/dd_j = 1 / C q^-j (A y - sum B / F u - constant)
    filtered = lfilter([1.0], c, equation_error)
    columns += [delay_rows(filtered, j) for j in range(1, structure.nd + 1)]
    if structure.offset:
        columns.append(-lfilter(d, c, np.ones(len(y))))
    for b, f, functions in zip(model.b, model.f, part.basis, strict=False):
        columns.append(-lfilter(np.convolve(b, d), np.convolve(c, f), functions, axis=0))
    return np.column_stack(columns)


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
    minima = [
        minimise_prediction_errors(problem.evaluate, problem.stabilise, starts[k], policy=policy, iterations=first)
        for k in followed
    ]
    best = min(minima, key=lambda m: m.errors.squares)
    if best.converged or first == policy.iterations:
        return best
    return minimise_prediction_errors(problem.evaluate, problem.stabilise, best.theta, policy=policy)


def minimise_prediction_errors(
    evaluate: Callable[[np.ndarray, bool], PredictionErrors],
    stabilise: Callable[[np.ndarray], np.ndarray],
    start: np.ndarray,
    *,
    policy: PredictionErrorPolicy = DEFAULT_SEARCH,
    iterations: int | None = None,
) -> PredictionErrorMinimum:
    """Damped Gauss-Newton steps from ``start`` (p,).

    ``evaluate`` gives the errors, with their gradient if its second argument says so; ``stabilise`` maps coefficients to allowed
    ones. ``iterations``: None takes those of the ``policy``.
    """
    begin = stabilise(start)
    unbounded = np.full(len(begin), np.inf)
    first = _ErrorModel.at(evaluate(begin, True))
    result = minimise(
        lambda theta: _ErrorModel.at(evaluate(theta, True)),
        begin,
        -unbounded,
        unbounded,
        method=MinimisationMethod.GAUSS_NEWTON,
        value_at_start=first,
        iterations=policy.iterations if iterations is None else iterations,
        termination_test=Termination(policy.termination, count=len(first.errors.e)).test,
        project=stabilise,
        cost=lambda theta: evaluate(theta, False).squares,
        policy=MinimisationPolicy(damped=policy.damped),
    )
    # Where no step is short enough to help, the errors are as small as rounding allows.
    ended = result.status is not TerminationStatus.ITERATION_LIMIT
    return PredictionErrorMinimum(result.z, (result.value or first).errors, result.iterations, ended)


@dataclass(frozen=True, eq=False)
class _ErrorModel(QuadraticModel):
    """The sum of squares of ``errors`` as a function of the coefficients, near those that they belong to."""

    errors: PredictionErrors

    @classmethod
    def at(cls, errors: PredictionErrors) -> _ErrorModel:
        if not np.isfinite(errors.squares) or not np.isfinite(errors.gradient).all():
            p = errors.gradient.shape[1]
            return cls(np.inf, np.zeros(p), np.zeros((p, p)), errors)
        model = QuadraticModel.from_residuals(errors.gradient, errors.e)
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


def estimate_coefficient_covariance(gradient: np.ndarray, squares: float, freedom: int) -> np.ndarray:
    """Covariance (p, p) of coefficients with this ``gradient`` (n, p), for a white error."""
    scale = np.linalg.norm(gradient, axis=0)
    _, size, right = np.linalg.svd(gradient / scale, full_matrices=False)
    inverse = right.T / size
    return squares / freedom * (inverse @ inverse.T) / np.outer(scale, scale)


def refuse_collinear(gradient: np.ndarray, names: Sequence[str], label: str) -> None:
    """DataError that names the coefficients whose columns of ``gradient`` (n, p) are zero or linearly dependent."""
    scale = np.linalg.norm(gradient, axis=0)
    without_effect = [n for n, s in zip(names, scale, strict=True) if s == 0]
    if without_effect:
        raise DataError(
            f"{label}: {', '.join(without_effect)} have no effect in these records; take a smaller structure"
        )
    _, size, right = np.linalg.svd(np.linalg.qr(gradient / scale, mode="r"))
    if size[-1] <= COLLINEAR_COLUMNS * np.sqrt(len(gradient)):
        participation = np.abs(right[-1]) / np.abs(right[-1]).max()
        dependent = [n for n, s in zip(names, participation, strict=True) if s > DEPENDENT_COLUMN_SHARE]
        raise DataError(
            f"{label}: the coefficients {', '.join(dependent)} are not distinguishable in these records; a constant"
            " input (a step after its edge) determines one, and each sine two: take a smaller structure, history='zero' where the"
            " record begins at rest and with the step's edge, or a record with a richer input"
        )


def _finish(
    structure: PolynomialStructure,
    data: SampledData,
    best: PredictionErrorMinimum,
    count: int,
    label: str,
    history: str,
    units: Mapping[str, str],
) -> PolynomialModel:
    model = structure.model(best.theta, data)
    errors = best.errors
    refuse_collinear(errors.gradient, list(model.coefficients), label)
    freedom = count - structure.size - errors.states
    has_noise_model = bool(structure.orders.na or structure.nc or structure.nd)
    return replace(
        model,
        noise_std=float(np.sqrt(errors.squares / freedom)),
        covariance=estimate_coefficient_covariance(errors.gradient, errors.squares, freedom),
        samples=count,
        loss=errors.squares / count,
        history=history,
        units=dict(units),
        focus="prediction" if has_noise_model else "simulation",
        findings=(*find_unfinished_search(best.converged, best.iterations), *find_instability(model)),
    )


# Where prediction-error searches start: linear estimates that need no start of their own.


@dataclass(frozen=True, eq=False)
class RegressionRows:
    """Equations of all records in one: ``phi`` (n, p), ``y`` (n,), and where each record's first row stands."""

    phi: np.ndarray
    y: np.ndarray
    starts: tuple[int, ...]

    def filtered(self, a: np.ndarray) -> RegressionRows:
        """The equations filtered by ``1 / a``, each record for itself."""
        pairs = zip(np.split(self.phi, self.starts[1:]), np.split(self.y, self.starts[1:]), strict=True)
        both = [(lfilter([1.0], a, p, axis=0), lfilter([1.0], a, t)) for p, t in pairs]
        return replace(self, phi=np.concatenate([p for p, _ in both]), y=np.concatenate([t for _, t in both]))

    def solve(self) -> np.ndarray:
        """Least squares of smallest norm (p,)."""
        return np.linalg.lstsq(self.phi, self.y, rcond=None)[0]


def collect_equations(data: SampledData, orders: Orders, offset: bool, rest: bool) -> RegressionRows:
    """The usable ARX equations of each record."""
    phi, y, starts, count = [], [], [], 0
    for record in data.records:
        rows = find_usable_rows(record, orders, "zero" if rest else "measured")
        if len(rows):
            phi.append(build_regressors(record, orders, offset)[rows])
            y.append(record.y[rows])
            starts.append(count)
            count += len(rows)
    if not count:
        return RegressionRows(np.empty((0, orders.na + sum(orders.nb) + offset)), np.empty(0), ())
    return RegressionRows(np.concatenate(phi), np.concatenate(y), tuple(starts))


def interpolate_gaps(data: SampledData) -> SampledData:
    """``data`` with gaps filled by straight lines: good enough for a start, never for an estimate."""

    def interpolate(record: SampledRecord) -> SampledRecord:
        measured = np.flatnonzero(np.isfinite(record.y))
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
        rows = collect_equations(filled, replace(orders, na=poles), structure.offset, rest)
        a = to_monic(rows.solve()[:poles])
        candidates.append((confine_roots(a),) * len(orders.nb))
        for _ in range(FILTER_PASSES):
            a = to_monic(rows.filtered(reflect_roots(a)).solve()[:poles])
            candidates.append((confine_roots(reflect_roots(a)),) * len(orders.nb))
    candidates.append(tuple(map(confine_roots, _realise_poles(structure, filled, rest))))
    return [_with_best_numerators(structure, f, data, rest) for f in candidates]


def estimate_armax_starts(structure: PolynomialStructure, data: SampledData, rest: bool) -> list[np.ndarray]:
    """Candidates for ``A, B, C``: ARX with ``C = 1``, pseudo-linear regression on a long ARX model's innovations (Hannan and
    Rissanen 1982), and Steiglitz and McBride's ``A`` with ``C = A``, which white noise on the output alone would have."""
    filled, orders = interpolate_gaps(data), structure.orders
    rows = collect_equations(filled, orders, structure.offset, rest)
    plain = rows.solve()
    starts = [_with_noise(structure, plain, np.zeros(structure.nc))]
    a = to_monic(plain[: orders.na])
    for _ in range(FILTER_PASSES if orders.na else 0):
        theta = rows.filtered(reflect_roots(a)).solve()
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
    squares = [
        compute_prediction_errors(plain, s, data, data.records, rest=rest, with_gradient=False).squares for s in starts
    ]
    noise = PolynomialStructure("arma", Orders(structure.nd, (), ()), (), nc=structure.nc)
    candidates = []
    for start in (starts[k] for k in np.argsort(squares)[:2]):
        model = plain.model(start, data)
        runs = [predict_ahead(model, s, 1, "zero" if rest else "estimated", None)[0] for s in data.records]
        residuals = [replace(s, y=s.y - run, u=s.u[:, :0]) for s, run in zip(data.records, runs, strict=True)]
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
    model = collect_equations(data, long, structure.offset, rest).solve()
    innovations = [s.y - build_regressors(s, long, structure.offset) @ model for s in data.records]
    if not rest:
        for e in innovations:
            e[: long.reach] = 0.0
    for _ in range(INNOVATION_PASSES):
        blocks, targets = [], []
        for record, e in zip(data.records, innovations, strict=True):
            rows = slice(0 if rest else orders.reach + structure.nc, None)
            noise = [delay_rows(e, j) for j in range(1, structure.nc + 1)]
            blocks.append(np.column_stack([build_regressors(record, orders, structure.offset), *noise])[rows])
            targets.append(record.y[rows])
        theta = np.linalg.lstsq(np.concatenate(blocks), np.concatenate(targets), rcond=None)[0]
        split = len(theta) - structure.nc
        c = reflect_roots(to_monic(theta[split:]))
        yield _with_noise(structure, theta[:split], c[1:])
        innovations = [
            lfilter([1.0], c, s.y - build_regressors(s, orders, structure.offset) @ theta[:split]) for s in data.records
        ]
        if not rest:
            for e in innovations:
                e[: orders.reach] = 0.0


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
    errors = compute_prediction_errors(structure, start, data, data.records, rest=rest, with_gradient=True)
    start[free] = QuadraticModel.from_residuals(errors.gradient[:, free], errors.e).bounded_step()
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
    theta = collect_equations(data, long, structure.offset, rest).solve()
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
