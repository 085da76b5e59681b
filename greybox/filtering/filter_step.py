"""The Kalman filter written as one discrete step, so that the kernels run and differentiate it like any model.

Its state is ``z = [x; lower triangle of P]``: the prediction of each sample and its covariance. Its input is a row of the record with
the measurement in it, its outputs are the innovation of each measurement over its standard deviation, and the logarithm of its
variance. An interval begins with the correction by the measurement (Kalman 1960), one output after the other, which is exact for
independent sensors and needs no inverse, in Joseph's form, which keeps the covariance positive. Then the model's own step moves the
state, and its Jacobian ``F`` the covariance, ``P+ = F P F' + Qd``: exact for a linear model, the extended filter otherwise (Jazwinski
1970, section 8.3).
"""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca
import numpy as np

from greybox.filtering.discrete_process_noise import discretise_process_noise
from greybox.filtering.symmetric_matrices import to_lower_triangle, to_symmetric
from greybox.integrators import Step
from greybox.model.system import System

FLAG_COLUMNS = ("turn", "linear")
"""Last columns of a row: 0 and 1 in turn, and whether the input is linear between rows."""


class FilterRow(NamedTuple):
    """A row of the record as the filter reads it; see `greybox.filtering.filter_record.to_filter_record`."""

    u: ca.SX
    y: ca.SX
    present: ca.SX
    turn: ca.SX
    linear: ca.SX


def count_row_columns(step: Step, outputs: int) -> int:
    """How many columns a row of the filter of ``step`` has."""
    return step.advance.size1_in(1) + 2 * outputs + len(FLAG_COLUMNS)


def split_row(row: ca.SX, step: Step, outputs: int) -> FilterRow:
    """The parts of a row."""
    nu = step.advance.size1_in(1)
    return FilterRow(
        *ca.vertsplit(row, [0, nu, nu + outputs, nu + 2 * outputs, nu + 2 * outputs + 1, nu + 2 * outputs + 2])
    )


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
        innovation = row.y[j] - predicted[j] - slope @ (x - predicted_moments.x)
        cross_covariance = P @ slope.T
        variance = slope @ cross_covariance + noise[j] ** 2
        standardised.append(is_present * innovation / ca.sqrt(variance))
        logarithm.append(is_present * ca.log(variance))
        gain = is_present * cross_covariance / variance
        remaining = ca.SX.eye(x.numel()) - gain @ slope
        x = x + gain * innovation
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

    measured_row, ua, ub = _locate_substep(first, second, is_exact)
    after, _ = correct_by_measurement(step, before, measured_row, system.p, noise)
    following, slope = _advance_with_slope(step, after.x, ua, ub, q, h)
    substep_noise = (
        to_symmetric(qd, nx) if is_exact else _integrate_substep_noise(slope, ca.diag(system.diffusion**2), h)
    )
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


def _locate_substep(first: FilterRow, second: FilterRow, exact: bool) -> tuple[FilterRow, ca.SX, ca.SX]:
    """The measurement where it counts (in the first substep alone), and the input at both ends of this substep.

    The kernel runs straight from row to row; ``turn`` tells which of how many substeps this is.
    """
    if exact:
        return first, first.u, first.u + first.linear * (second.u - first.u)
    n = ca.floor(1 / ca.fabs(second.turn - first.turn) + 0.5)
    number = ca.floor(ca.if_else(second.turn > first.turn, first.turn, 1 - first.turn) * n + 0.5)
    ramp = (second.u - first.u) * n
    u_start = first.u - number / n * ramp
    ua, ub = (ca.if_else(first.linear > 0, end, u_start) for end in (first.u, second.u))
    return first._replace(present=first.present * (number == 0)), ua, ub


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
    return h / 6 * (slope @ intensity @ slope.T + 4 * (half @ intensity @ half.T) + intensity)


def _symmetrise(matrix: ca.SX) -> ca.SX:
    """A symmetric matrix from its lower triangle alone."""
    return to_symmetric(to_lower_triangle(matrix), matrix.size1())
