"""States given the whole record, what comes after them included: the fixed-interval smoother."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np

from greybox.simulation.filtering.kalman_filter import (
    KalmanFilter,
    Moments,
    correct_by_measurement,
    count_row_columns,
    split_row,
    to_filter_record,
)
from greybox.simulation.kernel.record import Record

# One interval or one measurement of many rows at once: what the smoother and the prediction over several steps need.

Arguments = dict[int, np.ndarray]  # by their place in a function's list


class BatchFilter:
    """The rows of a record, to be passed in parallel with the model of ``kalman`` at the parameters ``pn`` (np + ny,)."""

    def __init__(self, kalman: KalmanFilter, record: Record, pn: np.ndarray) -> None:
        self.kalman, self.pn = kalman, pn
        self.seen = record.read_by(kalman.step)
        self.rows = to_filter_record(record, kalman.step)
        self.q, _ = kalman.step.coefficients(pn[: kalman.system.p.numel()], self.seen.lengths, np.empty(0, int))

    def correct(self, x: np.ndarray, covariance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """States (N, nx) and their covariance (N, nx, nx) after the measurement of each row."""
        n, nx = x.shape
        results = _map_rows(self._corrected, {0: x, 1: covariance.reshape(n, nx * nx), 2: self.rows.u}, {3: self.pn})
        return results[0], results[1].reshape(n, nx, nx)

    def outputs(self, x: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Outputs (n, ny) of states (n, nx) at ``rows`` (n,), and their slopes (n, ny, nx) along the states."""
        nx, ny = self.kalman.sizes
        p = self.pn[: self.kalman.system.p.numel()]
        y, slopes = _map_rows(self._outputs, {0: x, 1: self.seen.u[rows]}, {2: p})
        return y, slopes.reshape(len(x), nx, ny).transpose(0, 2, 1)

    def move(self, x: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """States (n, nx) one row after ``rows`` (n,)."""
        for arguments, same in self._iterate_substeps(rows):
            (x,) = _map_rows(self._moved, {0: x, **arguments}, same)
        return x

    def move_with_slopes(self, x: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """States (n, nx) one row after ``rows`` (n,), and their slopes (n, nx, nx) along those before."""
        n, nx = x.shape
        whole = np.tile(np.eye(nx), (n, 1, 1))
        for arguments, same in self._iterate_substeps(rows):
            x, slopes = _map_rows(self._moved_with_slopes, {0: x, **arguments}, same)
            # CasADi's columns are read as rows, hence the transpose; the chain rule puts the later substep in front.
            whole = slopes.reshape(n, nx, nx).transpose(0, 2, 1) @ whole
        return x, whole

    def _iterate_substeps(self, rows: np.ndarray) -> Iterator[tuple[Arguments, Arguments]]:
        """Arguments 1 to 4 of the model's step in each substep of the intervals after ``rows``: row by row, and common to all."""
        seen, count = self.seen, self.kalman.step.substeps
        u_start, h = seen.u[rows], seen.h[rows][:, None] / count
        ramp = seen.find_ends(rows) - u_start
        has_one_row = len(self.q) == 1
        for j in range(count):
            arguments = {1: u_start + ramp * (j / count), 2: u_start + ramp * ((j + 1) / count), 4: h}
            yield (
                arguments | ({} if has_one_row else {3: self.q[seen.row[rows]]}),
                {3: self.q[0]} if has_one_row else {},
            )

    @cached_property
    def _corrected(self) -> ca.Function:
        """``(x, vec P, row, [p; noise]) -> (x, vec P)`` after the measurement in the row."""
        kalman, (nx, ny) = self.kalman, self.kalman.sizes
        x, P, noise = ca.SX.sym("x", nx), ca.SX.sym("P", nx, nx), ca.SX.sym("noise", ny)
        row = ca.SX.sym("row", count_row_columns(kalman.step, ny))
        after, _ = correct_by_measurement(
            kalman.step, Moments(x, P), split_row(row, kalman.step, ny), kalman.system.p, noise
        )
        pn = ca.vertcat(kalman.system.p, noise)
        return ca.Function("corrected", [x, ca.vec(P), row, pn], [after.x, ca.densify(ca.vec(after.P))])

    @cached_property
    def _outputs(self) -> ca.Function:
        """``(x, u, p) -> (y, vec d y / d x)``."""
        outputs, system = self.kalman.step.outputs, self.kalman.system
        x, u = ca.SX.sym("x", system.x.numel()), ca.SX.sym("u", outputs.size1_in(1))
        y = outputs(x, u, system.p)
        return ca.Function("outputs", [x, u, system.p], [ca.densify(y), ca.densify(ca.vec(ca.jacobian(y, x)))])

    @cached_property
    def _moved(self) -> ca.Function:
        """``(x, ua, ub, q, h) -> x`` after one substep."""
        symbols, after = self._make_substep()
        return ca.Function("moved", symbols, [ca.densify(after)])

    @cached_property
    def _moved_with_slopes(self) -> ca.Function:
        """``(x, ua, ub, q, h) -> (x, vec d x / d x)`` after one substep."""
        symbols, after = self._make_substep()
        slopes = ca.jacobian(after, symbols[0])
        return ca.Function("moved", symbols, [ca.densify(after), ca.densify(ca.vec(slopes))])

    def _make_substep(self) -> tuple[list[ca.SX], ca.SX]:
        advance = self.kalman.step.advance
        symbols = [ca.SX.sym(f"i{k}", advance.size1_in(k)) for k in range(5)]
        return symbols, advance(*symbols)


def _map_rows(function: ca.Function, rows: Arguments, same: Arguments, chunk: int = 10_000) -> list[np.ndarray]:
    """The outputs (n, .) of ``function`` for each of n rows of some arguments (n, .), the others (.,) being the ``same`` for all.

    One call of CasADi's virtual machine takes ``chunk`` rows, so that memory does not grow with the record.
    """
    n = len(next(iter(rows.values())))
    results = [np.empty((n, function.size1_out(k))) for k in range(function.n_out())]
    contiguous = {k: np.ascontiguousarray(a, dtype=np.float64) for k, a in (rows | same).items()}
    mapped, chunk_size = None, 0
    for start in range(0, n, chunk):
        chunk_rows = slice(start, start + chunk)
        if mapped is None or min(chunk, n - start) != chunk_size:
            chunk_size = min(chunk, n - start)
            mapped = function.map("mapped", "serial", chunk_size, sorted(same), [])
        # Column by column in CasADi is row by row here: nothing is copied.
        buffer, evaluate = mapped.buffer()
        for k, array in contiguous.items():
            view = array if k in same else array[chunk_rows]
            if view.size:
                buffer.set_arg(k, view.data)
        for k, array in enumerate(results):
            if array.size:
                buffer.set_res(k, array[chunk_rows].data)
        evaluate()
    return results


@dataclass(frozen=True, eq=False)
class SmootherRun:
    """States of each of N rows."""

    filtered: np.ndarray
    """States (N, nx) given the measurements up to each row."""

    filtered_covariance: np.ndarray
    """Their covariance (N, nx, nx)."""

    mean: np.ndarray
    """States (N, nx) given all measurements."""

    covariance: np.ndarray
    """Their covariance (N, nx, nx)."""

    innovation: np.ndarray
    """Standardised innovations (N, ny), NaN in gaps."""

    log_likelihood: float
    """Of all measurements."""


def smooth_states(
    kalman: KalmanFilter, record: Record, pn: np.ndarray, x0: np.ndarray, covariance: np.ndarray | None = None
) -> SmootherRun:
    """Rauch, Tung and Striebel's smoother (AIAA Journal 3, 1965), in the form of Bryson and Frazier (1963; de Jong, JASA 84, 1989).

    Backwards along the record ``r = H' S^-1 v + L' F' r`` and ``N = H' S^-1 H + L' F' N F L`` with ``L = I - K H``, then ``x + P r`` and
    ``P - P N P``. It inverts no covariance of the states, so that states without noise, or known at the first row, are ordinary
    cases. For a nonlinear model ``F`` and ``H`` are the slopes along the filter's run.
    """
    run = kalman.run(record, pn, x0, covariance)
    batch = BatchFilter(kalman, record, pn)
    rows = np.arange(len(record.y))
    filtered, after = batch.correct(run.predicted, run.covariance)
    _, transitions = batch.move_with_slopes(filtered[:-1], rows[:-1])
    y, slopes = batch.outputs(run.predicted, rows)
    present = np.isfinite(record.y)
    innovation = np.where(present, record.y - y, 0.0)
    slopes = np.where(present[:, :, None], slopes, 0.0)
    noise = np.where(present, pn[-y.shape[1] :] ** 2, 1.0)
    # S = H P H' + R; a gap has H = 0, v = 0 and R = 1, so that S stays regular and nothing is added.
    variance = slopes @ run.covariance @ slopes.transpose(0, 2, 1) + noise[:, :, None] * np.eye(y.shape[1])
    # S^-1 H
    weighted = np.linalg.solve(variance, slopes)
    weighted_innovation, curvature = np.einsum("tji,tj->ti", weighted, innovation), slopes.transpose(0, 2, 1) @ weighted
    correction = np.eye(len(x0)) - run.covariance @ curvature  # L, from the state before a measurement to that after it
    r, information = np.zeros(run.predicted.shape), np.zeros(run.covariance.shape)
    r_after, information_after = np.zeros(len(x0)), np.zeros((len(x0), len(x0)))
    for k in rows[::-1]:
        if k < rows[-1]:
            r_after, information_after = (
                # r <- F' r and N <- F' N F: back over the interval, before the correction of the row is undone. The
                # last row has none after it.
                transitions[k].T @ r_after,
                transitions[k].T @ information_after @ transitions[k],
            )
        # r = H' S^-1 v + L' r, N = H' S^-1 H + L' N L
        r[k] = r_after = weighted_innovation[k] + correction[k].T @ r_after
        information[k] = information_after = curvature[k] + correction[k].T @ information_after @ correction[k]
    # x + P r and P - P N P
    mean = run.predicted + np.einsum("tij,tj->ti", run.covariance, r)
    smoothed_covariance = run.covariance - run.covariance @ information @ run.covariance
    return SmootherRun(
        filtered,
        after,
        mean,
        (smoothed_covariance + smoothed_covariance.transpose(0, 2, 1)) / 2,
        run.innovation,
        run.log_likelihood,
    )


# Prediction over several samples: from the states after the last measurement, by the model alone.


def predict_outputs(kalman: KalmanFilter, record: Record, pn: np.ndarray, x0: np.ndarray, steps: int) -> np.ndarray:
    """Outputs (N, ny) of each sample given the measurements up to ``steps`` samples before it, the first states ``x0`` (nx,) being known.

    The first ``steps`` samples have no measurement to go by: they are those of the free run. With process noise of intensity zero
    all of them are.
    """
    batch = BatchFilter(kalman, record, pn)
    free = kalman.simulate_free_run(record, pn, x0)
    samples = np.arange(0, len(record.y), record.rows_per_sample)
    # What no measurement reaches is the free run.
    states = free[samples]
    if steps < len(samples):
        run = kalman.run(record, pn, x0)
        filtered, _ = batch.correct(run.predicted, run.covariance)
        # In samples, not rows: the rows between two samples of a band-limited input count as one step.
        origin = samples[:-steps]
        x = filtered[origin]
        for row in range(steps * record.rows_per_sample):
            x = batch.move(x, origin + row)
        states[steps:] = x
    return batch.outputs(states, samples)[0]
