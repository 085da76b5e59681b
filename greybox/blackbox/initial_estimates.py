"""Where prediction-error searches start: linear estimates that need no start of their own."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import lfilter

from greybox.blackbox.linear_regression import Orders, build_regressors, find_usable_rows
from greybox.blackbox.prediction_error import compute_prediction_errors
from greybox.blackbox.responses import predict_ahead
from greybox.blackbox.rounding import confine_roots, reflect_roots
from greybox.blackbox.sampled_data import SampledData, SampledRecord, delay_rows
from greybox.blackbox.structure import PolynomialStructure, to_monic

LONG, EXTRA = 12, 3  # order of the long ARX model: at least LONG, and EXTRA times the structure's own
PASSES = 8  # of Steiglitz and McBride's filter
PLR_PASSES = 4  # of the pseudo-linear regression on the innovations
IMPULSES = 60  # samples of the impulse response that are realised, and at least so many for each pole
FOR_EACH_POLE = 12


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


def collect_equations(data: SampledData, o: Orders, offset: bool, rest: bool) -> RegressionRows:
    """The usable ARX equations of each record."""
    phi, y, starts, count = [], [], [], 0
    for series in data.series:
        rows = find_usable_rows(series, o, "zero" if rest else "measured")
        if len(rows):
            phi.append(build_regressors(series, o, offset)[rows])
            y.append(series.y[rows])
            starts.append(count)
            count += len(rows)
    if not count:
        return RegressionRows(np.empty((0, o.na + sum(o.nb) + offset)), np.empty(0), ())
    return RegressionRows(np.concatenate(phi), np.concatenate(y), tuple(starts))


def interpolate_gaps(data: SampledData) -> SampledData:
    """``data`` with gaps filled by straight lines: good enough for a start, never for an estimate."""

    def filled(series: SampledRecord) -> SampledRecord:
        there = np.flatnonzero(np.isfinite(series.y))
        return replace(series, y=np.interp(np.arange(series.rows), there, series.y[there]))

    return replace(data, series=tuple(map(filled, data.series)))


def estimate_output_error_starts(structure: PolynomialStructure, data: SampledData, rest: bool) -> list[np.ndarray]:
    """Candidates for ``B / F``: ARX, Steiglitz and McBride's iteration (one ``F`` for all inputs), and realised impulse responses."""
    whole, o = interpolate_gaps(data), structure.orders
    candidates: list[tuple[np.ndarray, ...]] = []
    poles = max(structure.nf)
    if len(set(structure.nf)) == 1 and poles:
        rows = collect_equations(whole, replace(o, na=poles), structure.offset, rest)
        a = to_monic(rows.solve()[:poles])
        candidates.append((confine_roots(a),) * len(o.nb))
        for _ in range(PASSES):
            a = to_monic(rows.filtered(reflect_roots(a)).solve()[:poles])
            candidates.append((confine_roots(reflect_roots(a)),) * len(o.nb))
    candidates.append(tuple(map(confine_roots, _realised(structure, whole, rest))))
    return [_with_best_numerators(structure, f, data, rest) for f in candidates]


def estimate_armax_starts(structure: PolynomialStructure, data: SampledData, rest: bool) -> list[np.ndarray]:
    """Candidates for ``A, B, C``: ARX with ``C = 1``, pseudo-linear regression on a long ARX model's innovations (Hannan and
    Rissanen 1982), and Steiglitz and McBride's ``A`` with ``C = A``, which white noise on the output alone would have."""
    whole, o = interpolate_gaps(data), structure.orders
    rows = collect_equations(whole, o, structure.offset, rest)
    plain = rows.solve()
    found = [_with_noise(structure, plain, np.zeros(structure.nc))]
    a = to_monic(plain[: o.na])
    for _ in range(PASSES if o.na else 0):
        theta = rows.filtered(reflect_roots(a)).solve()
        a = to_monic(theta[: o.na])
        stable = reflect_roots(a)[1:]
        noise = np.append(stable, np.zeros(structure.nc))[: structure.nc]
        found.append(_with_noise(structure, np.append(stable, theta[o.na :]), noise))
    return found + list(_pseudo_linear(structure, whole, rest))


def estimate_box_jenkins_starts(structure: PolynomialStructure, data: SampledData, rest: bool) -> list[np.ndarray]:
    """Candidates for ``B / F`` as of an output error, the best of them with ``C / D`` from its residual."""
    plain = replace(structure, kind="output error", nc=0, nd=0)
    starts = estimate_output_error_starts(plain, data, rest)
    squares = [compute_prediction_errors(plain, s, data, data.series, rest=rest, slopes=False).squares for s in starts]
    noise = PolynomialStructure("arma", Orders(structure.nd, (), ()), (), nc=structure.nc)
    found = []
    for start in (starts[k] for k in np.argsort(squares)[:2]):
        model = plain.model(start, data)
        runs = [predict_ahead(model, s, 1, "zero" if rest else "estimated", None)[0] for s in data.series]
        left = [replace(s, y=s.y - run, u=s.u[:, :0]) for s, run in zip(data.series, runs, strict=True)]
        residual = replace(data, inputs=(), series=tuple(left))
        for coloured in estimate_armax_starts(noise, residual, rest):
            d, c = np.split(coloured, [structure.nd])
            parts = structure.parts(structure.vector(model))
            parts[-3], parts[-2] = c, reflect_roots(to_monic(d))[1:]
            found.append(np.concatenate(parts))
    return found


def _pseudo_linear(structure: PolynomialStructure, data: SampledData, rest: bool) -> Iterator[np.ndarray]:
    """Least squares with the last estimate's innovations as further columns."""
    o = structure.orders
    long = _long_orders(o, structure.nc, data)
    model = collect_equations(data, long, structure.offset, rest).solve()
    innovations = [s.y - build_regressors(s, long, structure.offset) @ model for s in data.series]
    if not rest:
        for e in innovations:
            e[: long.reach] = 0.0
    for _ in range(PLR_PASSES):
        blocks, targets = [], []
        for series, e in zip(data.series, innovations, strict=True):
            rows = slice(0 if rest else o.reach + structure.nc, None)
            noise = [delay_rows(e, j) for j in range(1, structure.nc + 1)]
            blocks.append(np.column_stack([build_regressors(series, o, structure.offset), *noise])[rows])
            targets.append(series.y[rows])
        theta = np.linalg.lstsq(np.concatenate(blocks), np.concatenate(targets), rcond=None)[0]
        split = len(theta) - structure.nc
        c = reflect_roots(to_monic(theta[split:]))
        yield _with_noise(structure, theta[:split], c[1:])
        innovations = [
            lfilter([1.0], c, s.y - build_regressors(s, o, structure.offset) @ theta[:split]) for s in data.series
        ]
        if not rest:
            for e in innovations:
                e[: o.reach] = 0.0


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
    at = compute_prediction_errors(structure, start, data, data.series, rest=rest, slopes=True)
    start[free] = -np.linalg.lstsq(at.slopes[:, free], at.e, rcond=None)[0]
    return start


def _long_orders(o: Orders, more: int, data: SampledData) -> Orders:
    """Orders of an ARX model that is long enough to whiten its errors, and no longer than the records bear."""
    most = max(1, data.measured // (10 * (1 + len(o.nb))))
    order = min(max(LONG, EXTRA * (o.na + more)), most)
    return Orders(max(order, o.na), tuple(max(order, b) for b in o.nb), o.nk)


def _realised(structure: PolynomialStructure, data: SampledData, rest: bool) -> list[np.ndarray]:
    """``F`` of each input from the impulse response of a long ARX model, by Ho and Kalman's realisation (Kung 1978)."""
    long = _long_orders(replace(structure.orders, na=max(structure.nf)), max(structure.nf), data)
    theta = collect_equations(data, long, structure.offset, rest).solve()
    shape = PolynomialStructure("arx", long, (0,) * len(structure.nf), offset=structure.offset)
    model = shape.model(theta, data)
    found = []
    for b, nk, nf in zip(model.b, long.nk, structure.nf, strict=True):
        length = max(IMPULSES, FOR_EACH_POLE * nf)
        response = lfilter(b, reflect_roots(model.a), np.eye(1, 2 * length + nk + 1)[0])[nk + 1 :]
        if nf == 0 or not response.any():
            found.append(np.append(1.0, np.zeros(nf)))
            continue
        hankel = response[np.add.outer(np.arange(length), np.arange(length))]
        left, size, _ = np.linalg.svd(hankel)
        observability = left[:, :nf] * np.sqrt(size[:nf])
        transition = np.linalg.lstsq(observability[:-1], observability[1:], rcond=None)[0]
        found.append(np.real(np.poly(np.linalg.eigvals(transition))))
    return found
