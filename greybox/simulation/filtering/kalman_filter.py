"""A Kalman filter made ready for one model: its likelihood with exact slopes, and its run over a record."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import casadi as ca
import numpy as np
from scipy.linalg import expm

from greybox.model import System
from greybox.simulation.integrators.step import CoefficientFunction, Step
from greybox.simulation.kernel.interface import Kernel, KernelPoint
from greybox.simulation.kernel.make_kernel import make_kernel
from greybox.simulation.kernel.record import Record

# Symmetric matrices as the column of their lower triangle, column by column.


def to_symmetric(lower: ca.SX, n: int) -> ca.SX:
    """The symmetric matrix (n, n) of a lower triangle (n (n + 1) / 2,)."""
    index = _triangle_index(n)
    return ca.horzcat(*[ca.vertcat(*[lower[int(index[i, j])] for i in range(n)]) for j in range(n)])


def to_lower_triangle(matrix: ca.SX) -> ca.SX:
    """The lower triangle (n (n + 1) / 2,) of a matrix that is symmetric."""
    n = matrix.size1()
    return ca.vertcat(*[matrix[i, j] for j in range(n) for i in range(j, n)])


def to_symmetric_arrays(lower: np.ndarray, n: int) -> np.ndarray:
    """Symmetric matrices (..., n, n) of lower triangles (..., n (n + 1) / 2)."""
    return lower[..., _triangle_index(n)]


def to_lower_triangle_array(matrix: np.ndarray) -> np.ndarray:
    """The lower triangle (n (n + 1) / 2,) of a symmetric matrix (n, n)."""
    n = len(matrix)
    return np.array([matrix[i, j] for j in range(n) for i in range(j, n)])


def _triangle_index(n: int) -> np.ndarray:
    """Position of each entry (n, n) in the lower triangle."""
    index = np.zeros((n, n), int)
    columns, rows = np.triu_indices(n)
    index[rows, columns] = index[columns, rows] = np.arange(len(rows))
    return index


# What process noise adds to the covariance over one interval of a linear model, exactly, and its slope along the parameters.


def discretise_process_noise(system: System) -> CoefficientFunction:
    """``(p, lengths, which) ->`` the covariance ``Qd`` (nh, m) of each interval length and its slopes (nh, m, na).

    ``Qd = integral of exp(A s) diag(diffusion^2) exp(A s)' ds`` from 0 to ``h``, its lower triangle column by column,
    ``m = nx (nx + 1) / 2`` (the integral of Van Loan, IEEE Trans. Automatic Control 23, 1978, equation 1.3). It is found as the
    solution of the linear equation ``dQd/ds = A Qd + Qd A' + diag(diffusion^2)``, whose exponential stays bounded for stiff models,
    where that of ``-A`` in Van Loan's own formula overflows. ``which`` numbers the parameters of ``system.p``.
    """
    nx = system.x.numel()
    a = ca.jacobian(system.rhs, system.x)
    covariance = ca.SX.sym("P", nx * (nx + 1) // 2)
    rate = to_lower_triangle(
        a @ to_symmetric(covariance, nx) + to_symmetric(covariance, nx) @ a.T + ca.diag(system.diffusion**2)
    )
    # m + 1: the triangle and the constant one behind it.
    size = covariance.numel() + 1
    generator = ca.SX.zeros(size, size)
    generator[:-1, :-1] = ca.jacobian(rate, covariance)
    # d[P; 1]/ds = [[K, vec Q], [0, 0]] [P; 1]: the constant Q becomes the column of a state that stays one, so that
    # the last column of the exponential is Qd.
    generator[:-1, -1] = ca.substitute(rate, covariance, ca.SX.zeros(size - 1))
    along = ca.jacobian(ca.vec(generator), system.p)
    matrices = ca.Function("noise", [system.p], [ca.densify(generator), ca.densify(along)])

    def coefficients(p: np.ndarray, lengths: np.ndarray, which: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        values, slopes = (np.asarray(m) for m in matrices(p))
        return _exponential_column(
            values, slopes.T.reshape(-1, size, size).transpose(0, 2, 1)[which], np.asarray(lengths)
        )

    return coefficients


def _exponential_column(
    generator: np.ndarray, slopes: np.ndarray, lengths: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Last column, without its one, of the exponential over each length (nh, m), and its slopes (nh, m, n)."""
    size, n, nh = len(generator), len(slopes), len(lengths)
    scaled = generator * lengths[:, None, None]
    if not (np.isfinite(scaled).all() and np.isfinite(slopes).all()):
        return np.full((nh, size - 1), np.nan), np.full((nh, size - 1, n), np.nan)
    with np.errstate(
        over="ignore", invalid="ignore"
    ):  # of an unstable model far off; the run that follows tells what is not finite
        values = expm(scaled)[:, :-1, -1]
    # Directions along which the generator stands still have zero slope: no exponential of twice the size for them.
    moving = np.flatnonzero(slopes.any(axis=(1, 2)))
    change = np.zeros((nh, size - 1, n))
    if len(moving):
        # the upper right block of the exponential of [[M, dM], [0, M]] (Najfeld, Havel 1995)
        pairs = np.zeros((nh, len(moving), 2 * size, 2 * size))
        pairs[:, :, :size, :size] = pairs[:, :, size:, size:] = scaled[:, None]
        pairs[:, :, :size, size:] = slopes[moving] * lengths[:, None, None, None]
        with np.errstate(over="ignore", invalid="ignore"):
            change[:, :, moving] = expm(pairs)[:, :, : size - 1, -1].transpose(0, 2, 1)
    return values, change


# A record as the filter reads it: the measurements stand beside the inputs.


def to_filter_record(record: Record, step: Step) -> Record:
    """``record`` for the filter of ``step``: columns of a row are what ``step`` sees as input, the measurements (0 in a gap), 1 where
    something was measured, and 0 and 1 in turn.

    The filter's own outputs are compared with zero.
    """
    read = record.read_by(step)
    present = np.isfinite(record.y)
    rows = len(record.y)
    columns = [
        read.u,
        np.where(present, record.y, 0.0),
        present,
        (np.arange(rows) % 2)[:, None],
    ]
    targets = np.zeros((rows, 2 * record.y.shape[1]))
    # A measurement stays what it is during its interval; the last column alone moves by its substeps.
    courses = [read.is_linear, np.zeros(targets.shape[1]), np.ones(1)]
    return Record(
        np.hstack(columns),
        targets,
        read.h,
        read.row,
        read.lengths,
        is_linear=np.concatenate(courses),
        rows_per_sample=record.rows_per_sample,
    )


def remove_measurements(record: Record, outputs: int) -> Record:
    """The rows of `to_filter_record` with every measurement taken for a gap: the filter then runs freely."""
    u = record.u.copy()
    u[:, -1 - outputs : -1] = 0.0
    return replace(record, u=u)


# The Kalman filter written as one discrete step, so that the kernels run and differentiate it like any model.
#
# Its state is ``z = [x; lower triangle of P]``: the prediction of each sample and its covariance. Its input is a row of the record with
# the measurement in it, its outputs are the innovation of each measurement over its standard deviation, and the logarithm of its
# variance. An interval begins with the correction by the measurement (Kalman 1960), one output after the other, which is exact for
# independent sensors and needs no inverse, in Joseph's form, which keeps the covariance positive. Then the model's own step moves the
# state, and its Jacobian ``F`` the covariance, ``P+ = F P F' + Qd``: exact for a linear model, the extended filter otherwise (Jazwinski
# 1970, section 8.3).


class FilterRow(NamedTuple):
    """A row of the record as the filter reads it; see `greybox.simulation.filtering.kalman_filter.to_filter_record`."""

    u: ca.SX
    y: ca.SX
    present: ca.SX
    turn: ca.SX


def count_row_columns(step: Step, outputs: int) -> int:
    """How many columns a row of the filter of ``step`` has."""
    return step.advance.size1_in(1) + 2 * outputs + 1


def split_row(row: ca.SX, step: Step, outputs: int) -> FilterRow:
    """The parts of a row."""
    nu = step.advance.size1_in(1)
    return FilterRow(*ca.vertsplit(row, [0, nu, nu + outputs, nu + 2 * outputs, nu + 2 * outputs + 1]))


class Moments(NamedTuple):
    """Mean (nx,) and covariance (nx, nx) of the states."""

    x: ca.SX
    P: ca.SX


class Innovation(NamedTuple):
    """Of each measurement (ny,): the innovation over its standard deviation, and the logarithm of its variance; 0 in a gap."""

    standardised: ca.SX
    logarithm: ca.SX


def correct_by_measurement(
    step: Step, predicted_moments: Moments, row: FilterRow, p: ca.SX, noise: ca.SX
) -> tuple[Moments, Innovation]:
    """The states after the measurement in ``row`` with standard deviations ``noise`` (ny,), and its innovations."""
    linearised_at = ca.SX.sym("x", predicted_moments.x.numel())
    outputs = step.outputs(linearised_at, row.u, p)
    predict = ca.Function("predict", [linearised_at, row.u, p], [outputs, ca.jacobian(outputs, linearised_at)])
    predicted, slopes = predict(predicted_moments.x, row.u, p)
    x, P = predicted_moments
    standardised, logarithm = [], []
    for j in range(row.y.numel()):
        slope, is_present = slopes[j, :], row.present[j]
        # v_j = y_j - h_j(x-) - H_j (x - x-): one output after the other, all linearised at the prediction, gives
        # what the joint update gives.
        innovation = row.y[j] - predicted[j] - slope @ (x - predicted_moments.x)
        cross_covariance = P @ slope.T
        # S = H P H' + R
        variance = slope @ cross_covariance + noise[j] ** 2
        standardised.append(is_present * innovation / ca.sqrt(variance))
        logarithm.append(is_present * ca.log(variance))
        # K = P H' / S; zero in a gap, which leaves x and P as they are.
        gain = is_present * cross_covariance / variance
        remaining = ca.SX.eye(x.numel()) - gain @ slope
        x = x + gain * innovation
        # Joseph: P+ = (I - K H) P (I - K H)' + K R K', a sum of squares whatever the rounding of K is; its lower
        # triangle alone goes on.
        P = _symmetrise(remaining @ P @ remaining.T + gain @ gain.T * noise[j] ** 2)
    return Moments(x, P), Innovation(ca.vertcat(*standardised), ca.vertcat(*logarithm))


def make_filter_step(system: System, step: Step) -> Step:
    """The Kalman filter of ``system``, moved by ``step``, as a step of its own.

    Parameters are those of the model and the standard deviation of each output's noise, ``[p; noise]``. ``advance`` takes ``z``, two
    rows and ``q = [q of step; p; noise; Qd]`` (no ``Qd`` where the model's step is not exact: it follows from ``F`` then).
    ``outputs`` are ``[standardised innovation; logarithm of its variance]`` (2 ny,).
    """
    nx, ny, np_ = system.x.numel(), step.outputs.size1_out(0), system.p.numel()
    m = nx * (nx + 1) // 2
    is_exact = step.per_interval
    x, lower, h = ca.SX.sym("x", nx), ca.SX.sym("P", m), ca.SX.sym("h")
    z, q, noise = ca.vertcat(x, lower), ca.SX.sym("q", step.advance.size1_in(3)), ca.SX.sym("noise", ny)
    ra, rb = (ca.SX.sym(name, count_row_columns(step, ny)) for name in ("ra", "rb"))
    qd = ca.SX.sym("Qd", m if is_exact else 0)
    first, second = split_row(ra, step, ny), split_row(rb, step, ny)

    before = Moments(x, to_symmetric(lower, nx))
    _, innovation = correct_by_measurement(step, before, first, system.p, noise)
    outputs = ca.Function("outputs", [z, ra, ca.vertcat(system.p, noise)], [ca.cse(ca.vertcat(*innovation))])

    # An exact step takes the whole interval: there is one substep, and the measurement belongs to it.
    measured_row = first if is_exact else _measure_first_substep(first, second)
    after, _ = correct_by_measurement(step, before, measured_row, system.p, noise)
    following, slope = _advance_with_slope(step, after.x, first.u, second.u, q, h)
    substep_noise = (
        to_symmetric(qd, nx) if is_exact else _integrate_substep_noise(slope, ca.diag(system.diffusion**2), h)
    )
    # P+ = F P F' + Qd
    P = slope @ after.P @ slope.T + substep_noise
    q_of_filter = ca.vertcat(q, system.p, noise, qd)
    advance = ca.Function("advance", [z, ra, rb, q_of_filter, h], [ca.cse(ca.vertcat(following, to_lower_triangle(P)))])

    accumulated = discretise_process_noise(system) if is_exact else None

    def coefficients(pn: np.ndarray, lengths: np.ndarray, which: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        model_parameters = np.flatnonzero(which < np_)
        q_of_step, q_slopes = step.coefficients(pn[:np_], lengths, which[model_parameters])
        rows = len(q_of_step)
        values = [q_of_step, np.tile(pn, (rows, 1))]
        slopes = [np.zeros((rows, q_of_step.shape[1], len(which))), np.tile(np.eye(len(pn))[:, which], (rows, 1, 1))]
        slopes[0][:, :, model_parameters] = q_slopes
        if accumulated is not None:
            noise_covariance, noise_slopes = accumulated(pn[:np_], lengths, which[model_parameters])
            values.append(noise_covariance)
            slopes.append(np.zeros((rows, m, len(which))))
            slopes[2][:, :, model_parameters] = noise_slopes
        return np.hstack(values), np.concatenate(slopes, axis=1)

    return Step(f"Kalman filter, {step.name}", advance, outputs, coefficients, step.substeps, step.per_interval)


def _measure_first_substep(first: FilterRow, second: FilterRow) -> FilterRow:
    """The row at the beginning of a substep with its measurement where it counts, in the first substep of an interval alone."""
    # The column of 0 and 1 runs straight from row to row, by 1/n over a substep: that says how many there are, and which this one is.
    n = ca.floor(1 / ca.fabs(second.turn - first.turn) + 0.5)
    number = ca.floor(ca.if_else(second.turn > first.turn, first.turn, 1 - first.turn) * n + 0.5)
    return first._replace(present=first.present * (number == 0))


def _advance_with_slope(step: Step, x: ca.SX, ua: ca.SX, ub: ca.SX, q: ca.SX, h: ca.SX) -> tuple[ca.SX, ca.SX]:
    """The states after a step, and their slope (nx, nx) along those before it."""
    symbols = [ca.SX.sym(f"i{k}", step.advance.size1_in(k)) for k in range(5)]
    whole = step.advance(*symbols)
    return ca.Function("moved", symbols, [whole, ca.jacobian(whole, symbols[0])])(x, ua, ub, q, h)


def compute_interval_noise(step: Step, system: System, u: ca.SX, q: ca.SX, h: ca.SX) -> ca.SX:
    """What process noise adds to the covariance (nx, nx) in an interval ``h``, linearised at ``system.x`` and the input ``u``."""
    part = h / step.substeps
    _, slope = _advance_with_slope(step, system.x, u, u, q, part)
    added = _integrate_substep_noise(slope, ca.diag(system.diffusion**2), part)
    covariance = added
    # F and the noise of one substep serve all: P <- F P F' + Qd, at the state where the interval begins.
    for _ in range(step.substeps - 1):
        covariance = _symmetrise(slope @ covariance @ slope.T + added)
    return covariance


def _integrate_substep_noise(slope: ca.SX, intensity: ca.SX, h: ca.SX) -> ca.SX:
    """``Qd`` of a substep from its Jacobian: Simpson's rule for the integral of ``F(s) Q F(s)'``.

    The Jacobian of half a step is the root of ``F = I + D``, by its series ``I + D/2 - D^2/8 + D^3/16``: relative error of order
    ``(h lambda)^4``, and bounded where a mode has decayed within the step.
    """
    identity = ca.SX.eye(slope.size1())
    d = slope - identity
    half = identity + d @ (identity / 2 - d @ (identity / 8 - d / 16))
    # Simpson: Qd = h/6 (F Q F' + 4 F_half Q F_half' + Q)
    return h / 6 * (slope @ intensity @ slope.T + 4 * (half @ intensity @ half.T) + intensity)


def _symmetrise(matrix: ca.SX) -> ca.SX:
    """A symmetric matrix from its lower triangle alone."""
    return to_symmetric(to_lower_triangle(matrix), matrix.size1())


# How uncertain the first states of a record are, where they are unknown: what process noise adds in one interval.


@dataclass(frozen=True, eq=False)
class InitialCovariance:
    """Covariance of first states that are themselves estimated, as its lower triangle (m,), with slopes.

    The state one interval (the record's shortest) before the first row counts as the unknown one; from there to the first row process
    noise pushes. Were the first row's state the unknown, it could meet the first measurement exactly: the noise of a sensor could
    shrink to nothing at no cost while process noise explains all other rows, and the likelihood would grow without bound. Without
    process noise the first states are exact, as those of a free run.

    ``function``: ``(x, u, q, p, h) ->`` the triangle and its slopes along ``[x; q; p]``; None for an exact step, whose coefficients
    have it.
    """

    step: Step
    states: int
    function: ca.Function | None

    @classmethod
    def of(cls, system: System, step: Step) -> InitialCovariance:
        """For ``system`` moved by ``step``."""
        nx = system.x.numel()
        if step.per_interval:
            return cls(step, nx, None)
        u, q = ca.SX.sym("u", step.advance.size1_in(1)), ca.SX.sym("q", step.advance.size1_in(3))
        h = ca.SX.sym("h")
        lower = ca.cse(to_lower_triangle(compute_interval_noise(step, system, u, q, h)))
        along = ca.jacobian(lower, ca.vertcat(system.x, q, system.p))
        return cls(step, nx, ca.Function("begin", [system.x, u, q, system.p, h], [lower, ca.densify(along)]))

    def covariance(self, rows: Record, q: np.ndarray, pn: np.ndarray, x0: np.ndarray) -> np.ndarray:
        """The triangle (m,) for the rows and coefficients ``q`` (nh, nq) of a filter, from the first states ``x0`` (nx,)."""
        size = self.states * (self.states + 1) // 2
        if not len(rows.h):
            return np.zeros(size)
        if self.function is None:
            return q[int(np.argmin(rows.lengths)), -size:]
        return np.asarray(self.function(*self._arguments(self.function, rows, q, pn, x0))[0]).ravel()

    def slopes(
        self,
        rows: Record,
        q: np.ndarray,
        dq: np.ndarray,
        pn: np.ndarray,
        dpn: np.ndarray,
        x0: np.ndarray,
        dx0: np.ndarray,
    ) -> np.ndarray:
        """Slopes (m, L) of the triangle along the columns of ``dq`` (nh, nq, L), ``dpn`` (np + ny, L) and ``dx0`` (nx, L)."""
        size = self.states * (self.states + 1) // 2
        if not len(rows.h):
            return np.zeros((size, dx0.shape[1]))
        if self.function is None:
            return dq[int(np.argmin(rows.lengths)), -size:]
        along = np.asarray(self.function(*self._arguments(self.function, rows, q, pn, x0))[1])
        nq, constants = self.step.advance.size1_in(3), self.function.size1_in(3)
        return along @ np.vstack([dx0, dq[0, :nq], dpn[:constants]])

    def _arguments(self, function: ca.Function, rows: Record, q: np.ndarray, pn: np.ndarray, x0: np.ndarray) -> tuple:
        columns, nq = function.size1_in(1), function.size1_in(2)
        return x0, rows.u[0, :columns], q[0, :nq], pn[: function.size1_in(3)], float(rows.lengths.min())


LOG_TWO_PI = float(np.log(2 * np.pi))
NO_PARAMETERS = np.empty(0, int)


@dataclass(frozen=True, eq=False)
class FilterRun:
    """A run of the filter over a record of N rows; not finite from where it overflows."""

    predicted: np.ndarray
    """States (N, nx) of each row given the measurements before it."""

    covariance: np.ndarray
    """Their covariance (N, nx, nx)."""

    innovation: np.ndarray
    """Measured minus predicted output over the standard deviation of that difference (N, ny), NaN in gaps."""

    log_likelihood: float
    """Of all measurements."""


@dataclass(frozen=True, eq=False)
class InnovationSensitivities:
    """Innovations of the k measurements there are, and their slopes along L directions.

    ``-2 log L = sum e^2 + logarithm + log(2 pi)``.
    """

    e: np.ndarray
    """Standardised innovations (k,)."""

    logarithm: np.ndarray
    """Logarithms of their variances (k,)."""

    de: np.ndarray
    """Slopes of the innovations (k, L)."""

    dlog_variance: np.ndarray
    """Slopes of the logarithms (k, L)."""

    rows: np.ndarray
    """Row of each measurement (k,)."""

    outputs: np.ndarray
    """Output of each measurement (k,)."""

    @property
    def mean_slopes(self) -> np.ndarray:
        """Slopes (k, L) of the innovations, not standardised, over their standard deviations."""
        return self.de + 0.5 * self.e[:, None] * self.dlog_variance


@dataclass(frozen=True, eq=False)
class KalmanFilter:
    """The filter of ``system`` moved by ``step``.

    The parameters ``pn`` of its calls are ``[p; noise]``: the model's constants and the standard deviation of each output's noise.
    """

    system: System
    step: Step

    filter_step: Step
    """The filter itself, as a discrete step."""

    kernel: Kernel
    """What runs the filter's step over a record."""

    initial_covariance: InitialCovariance | None = None
    """How uncertain first states are of which nothing else is said; None: they are known exactly."""

    @classmethod
    def of(cls, system: System, step: Step, *, known_start: bool = True) -> KalmanFilter:
        """The filter, compiled where there is a compiler; ``known_start``: the first states are known exactly, see `InitialCovariance`."""
        step_of_filter = make_filter_step(system, step)
        return cls(
            system,
            step,
            step_of_filter,
            make_kernel(step_of_filter),
            None if known_start else InitialCovariance.of(system, step),
        )

    def with_substeps(self, substeps: int) -> KalmanFilter:
        """The same with another number of substeps in an interval; nothing is compiled."""
        filter_step, step = (replace(s, substeps=substeps) for s in (self.filter_step, self.step))
        initial_covariance = None if self.initial_covariance is None else InitialCovariance.of(self.system, step)
        return replace(
            self,
            step=step,
            filter_step=filter_step,
            kernel=self.kernel.with_substeps(substeps),
            initial_covariance=initial_covariance,
        )

    @property
    def sizes(self) -> tuple[int, int]:
        """Numbers of states and outputs."""
        return self.system.x.numel(), self.step.outputs.size1_out(0)

    def run(self, record: Record, pn: np.ndarray, x0: np.ndarray, covariance: np.ndarray | None = None) -> FilterRun:
        """The run from first states ``x0`` (nx,) with their ``covariance`` (nx, nx); None: that of `initial_covariance`."""
        nx, ny = self.sizes
        rows = to_filter_record(record, self.step)
        q, _ = self.filter_step.coefficients(pn, rows.lengths, NO_PARAMETERS)
        y, z = self.kernel.simulate(rows, q, pn, self._initial_filter_state(rows, q, pn, x0, covariance))
        is_measured = np.isfinite(record.y)
        e, logarithm = np.where(is_measured, y[:, :ny], np.nan), y[:, ny:]
        # log L = -1/2 sum (e^2 + log s^2 + log 2 pi)
        likelihood = -0.5 * float(np.sum(e[is_measured] ** 2 + logarithm[is_measured] + LOG_TWO_PI))
        return FilterRun(z[:, :nx], to_symmetric_arrays(z[:, nx:], nx), e, likelihood)

    def simulate_free_run(self, record: Record, pn: np.ndarray, x0: np.ndarray) -> np.ndarray:
        """States (N, nx) without any correction: the free run of the model."""
        nx, ny = self.sizes
        rows = remove_measurements(to_filter_record(record, self.step), ny)
        q, _ = self.filter_step.coefficients(pn, rows.lengths, NO_PARAMETERS)
        return self.kernel.simulate(rows, q, pn, np.append(x0, np.zeros(nx * (nx + 1) // 2)))[1][:, :nx]

    def slopes(
        self, record: Record, pn: np.ndarray, dpn: np.ndarray, x0: np.ndarray, dx0: np.ndarray
    ) -> InnovationSensitivities | None:
        """Innovations and their slopes along the L columns of ``dpn`` (np + ny, L) and ``dx0`` (nx, L); None where the run overflows.

        The first states are as uncertain as `initial_covariance` says, besides what there is to ``x0`` as an unknown.
        """
        nx, ny = self.sizes
        rows = to_filter_record(record, self.step)
        which = np.flatnonzero(dpn.any(axis=1))
        q, along = self.filter_step.coefficients(pn, rows.lengths, which)
        dq = along @ dpn[which]
        initial_covariance = self.initial_covariance
        covariance_slopes = (
            np.zeros((nx * (nx + 1) // 2, dx0.shape[1]))
            if initial_covariance is None
            else initial_covariance.slopes(rows, q, dq, pn, dpn, x0, dx0)
        )
        start, dz0 = self._initial_filter_state(rows, q, pn, x0, None), np.vstack([dx0, covariance_slopes])
        r, jacobian = self.kernel.residuals(rows, KernelPoint(q, dq, pn, dpn, start, dz0), np.ones(2 * ny))
        # The kernel's residuals are zero minus the filter's outputs.
        measured = np.nonzero(np.isfinite(record.y))
        row, output = measured
        sensitivities = -r[row, output], -r[row, output + ny], -jacobian[row, output], -jacobian[row, output + ny]
        if not all(np.isfinite(a).all() for a in sensitivities):
            return None
        return InnovationSensitivities(*sensitivities, row, output)

    def _initial_filter_state(
        self, rows: Record, q: np.ndarray, pn: np.ndarray, x0: np.ndarray, covariance: np.ndarray | None
    ) -> np.ndarray:
        """``[x0; lower triangle of the covariance]``."""
        if covariance is not None:
            return np.append(x0, to_lower_triangle_array(covariance))
        if self.initial_covariance is None:
            return np.append(x0, np.zeros(len(x0) * (len(x0) + 1) // 2))
        return np.append(x0, self.initial_covariance.covariance(rows, q, pn, x0))
