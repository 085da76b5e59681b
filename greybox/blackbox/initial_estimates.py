"""Where prediction-error searches start: linear estimates that need no start of their own."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import lfilter

from greybox.blackbox.linear_regression import Orders, build_regressors, find_usable_rows
from greybox.blackbox.policy import DEFAULT_SEARCH, PredictionErrorPolicy
from greybox.blackbox.polynomial_roots import confine_roots, reflect_roots
from greybox.blackbox.prediction_error import compute_prediction_errors
from greybox.blackbox.responses import predict_ahead
from greybox.blackbox.sampled_data import SampledData, SampledRecord, delay_rows
from greybox.blackbox.structure import PolynomialStructure, to_monic
from greybox.optim import QuadraticModel


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


def estimate_output_error_starts(
    structure: PolynomialStructure, data: SampledData, rest: bool, policy: PredictionErrorPolicy = DEFAULT_SEARCH
) -> list[np.ndarray]:
    """Candidates for ``B / F``: ARX, Steiglitz and McBride's iteration (one ``F`` for all inputs), and realised impulse responses."""
    filled, orders = interpolate_gaps(data), structure.orders
    candidates: list[tuple[np.ndarray, ...]] = []
    poles = max(structure.nf)
    if len(set(structure.nf)) == 1 and poles:
        rows = collect_equations(filled, replace(orders, na=poles), structure.offset, rest)
        a = to_monic(rows.solve()[:poles])
        candidates.append((confine_roots(a),) * len(orders.nb))
        for _ in range(policy.filter_passes):
            a = to_monic(rows.filtered(reflect_roots(a)).solve()[:poles])
            candidates.append((confine_roots(reflect_roots(a)),) * len(orders.nb))
    candidates.append(tuple(map(confine_roots, _realise_poles(structure, filled, rest, policy))))
    return [_with_best_numerators(structure, f, data, rest) for f in candidates]


def estimate_armax_starts(
    structure: PolynomialStructure, data: SampledData, rest: bool, policy: PredictionErrorPolicy = DEFAULT_SEARCH
) -> list[np.ndarray]:
    """Candidates for ``A, B, C``: ARX with ``C = 1``, pseudo-linear regression on a long ARX model's innovations (Hannan and
    Rissanen 1982), and Steiglitz and McBride's ``A`` with ``C = A``, which white noise on the output alone would have."""
    filled, orders = interpolate_gaps(data), structure.orders
    rows = collect_equations(filled, orders, structure.offset, rest)
    plain = rows.solve()
    starts = [_with_noise(structure, plain, np.zeros(structure.nc))]
    a = to_monic(plain[: orders.na])
    for _ in range(policy.filter_passes if orders.na else 0):
        theta = rows.filtered(reflect_roots(a)).solve()
        a = to_monic(theta[: orders.na])
        stable = reflect_roots(a)[1:]
        noise = np.append(stable, np.zeros(structure.nc))[: structure.nc]
        starts.append(_with_noise(structure, np.append(stable, theta[orders.na :]), noise))
    return starts + list(_pseudo_linear_starts(structure, filled, rest, policy))


def estimate_box_jenkins_starts(
    structure: PolynomialStructure, data: SampledData, rest: bool, policy: PredictionErrorPolicy = DEFAULT_SEARCH
) -> list[np.ndarray]:
    """Candidates for ``B / F`` as of an output error, the best of them with ``C / D`` from its residual."""
    plain = replace(structure, kind="output error", nc=0, nd=0)
    starts = estimate_output_error_starts(plain, data, rest, policy)
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
        for coloured in estimate_armax_starts(noise, residual, rest, policy):
            d, c = np.split(coloured, [structure.nd])
            parts = structure.parts(structure.vector(model))
            parts[-3], parts[-2] = c, reflect_roots(to_monic(d))[1:]
            candidates.append(np.concatenate(parts))
    return candidates


def _pseudo_linear_starts(
    structure: PolynomialStructure, data: SampledData, rest: bool, policy: PredictionErrorPolicy
) -> Iterator[np.ndarray]:
    """Least squares with the last estimate's innovations as further columns."""
    orders = structure.orders
    long = _long_orders(orders, structure.nc, data, policy)
    model = collect_equations(data, long, structure.offset, rest).solve()
    innovations = [s.y - build_regressors(s, long, structure.offset) @ model for s in data.records]
    if not rest:
        for e in innovations:
            e[: long.reach] = 0.0
    for _ in range(policy.innovation_passes):
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


def _long_orders(orders: Orders, more: int, data: SampledData, policy: PredictionErrorPolicy) -> Orders:
    """Orders of an ARX model that is long enough to whiten its errors, and no longer than the records allow."""
    largest = max(1, data.measured // (policy.rows_per_long_order * (1 + len(orders.nb))))
    order = min(max(policy.long_order, policy.long_order_factor * (orders.na + more)), largest)
    return Orders(max(order, orders.na), tuple(max(order, b) for b in orders.nb), orders.nk)


def _realise_poles(
    structure: PolynomialStructure, data: SampledData, rest: bool, policy: PredictionErrorPolicy
) -> list[np.ndarray]:
    """``F`` of each input from the impulse response of a long ARX model, by Ho and Kalman's realisation (Kung 1978)."""
    long = _long_orders(replace(structure.orders, na=max(structure.nf)), max(structure.nf), data, policy)
    theta = collect_equations(data, long, structure.offset, rest).solve()
    shape = PolynomialStructure("arx", long, (0,) * len(structure.nf), offset=structure.offset)
    model = shape.model(theta, data)
    polynomials = []
    for b, nk, nf in zip(model.b, long.nk, structure.nf, strict=True):
        length = max(policy.impulse_rows, policy.impulse_rows_per_pole * nf)
        response = lfilter(b, reflect_roots(model.a), np.eye(1, 2 * length + nk + 1)[0])[nk + 1 :]
        if nf == 0 or not response.any():
            polynomials.append(np.append(1.0, np.zeros(nf)))
            continue
        hankel = response[np.add.outer(np.arange(length), np.arange(length))]
        left, size, _ = np.linalg.svd(hankel)
        observability = left[:, :nf] * np.sqrt(size[:nf])
        transition = np.linalg.lstsq(observability[:-1], observability[1:], rcond=None)[0]
        polynomials.append(np.real(np.poly(np.linalg.eigvals(transition))))
    return polynomials
