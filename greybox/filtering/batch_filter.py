"""One interval or one measurement of many rows at once: what the smoother and the prediction over several steps need."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property

import casadi as ca
import numpy as np

from greybox.filtering.filter_record import to_filter_record
from greybox.filtering.filter_step import Moments, correct_by_measurement, count_row_columns, split_row
from greybox.filtering.kalman_filter import KalmanFilter
from greybox.kernel import Record

Arguments = dict[int, np.ndarray]  # by their place in a function's list

# Rows in one call of CasADi's virtual machine: memory does not grow with the record.
CHUNK = 10_000


class BatchFilter:
    """The rows of a record, to be passed in parallel with the model of ``kalman`` at the parameters ``pn`` (np + ny,)."""

    def __init__(self, kalman: KalmanFilter, record: Record, pn: np.ndarray) -> None:
        self.kalman, self.pn = kalman, pn
        self.seen = record.read_by(kalman.step)
        self.rows = to_filter_record(record, kalman.step)
        self.q, _ = kalman.step.coefficients(pn[: kalman.system.p.numel()], self.seen.lengths, np.empty(0, int))

    def correct(self, x: np.ndarray, covariance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """States (N, nx) and their covariance (N, nx, nx) with the measurement of each row at hand."""
        n, nx = x.shape
        found = _mapped(self._corrected, {0: x, 1: covariance.reshape(n, nx * nx), 2: self.rows.u}, {3: self.pn})
        return found[0], found[1].reshape(n, nx, nx)

    def outputs(self, x: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Outputs (n, ny) of states (n, nx) at ``rows`` (n,), and their slopes (n, ny, nx) along the states."""
        nx, ny = self.kalman.sizes
        p = self.pn[: self.kalman.system.p.numel()]
        y, slopes = _mapped(self._outputs, {0: x, 1: self.seen.u[rows]}, {2: p})
        return y, slopes.reshape(len(x), nx, ny).transpose(0, 2, 1)

    def move(self, x: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """States (n, nx) one row after ``rows`` (n,)."""
        for arguments, same in self._substeps(rows):
            (x,) = _mapped(self._moved, {0: x, **arguments}, same)
        return x

    def move_with_slopes(self, x: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """States (n, nx) one row after ``rows`` (n,), and their slopes (n, nx, nx) along those before."""
        n, nx = x.shape
        whole = np.tile(np.eye(nx), (n, 1, 1))
        for arguments, same in self._substeps(rows):
            x, slopes = _mapped(self._moved_with_slopes, {0: x, **arguments}, same)
            whole = slopes.reshape(n, nx, nx).transpose(0, 2, 1) @ whole
        return x, whole

    def _substeps(self, rows: np.ndarray) -> Iterator[tuple[Arguments, Arguments]]:
        """Arguments 1 to 4 of the model's step in each substep of the intervals after ``rows``: row by row, and common to all."""
        seen, count = self.seen, self.kalman.step.substeps
        here, h = seen.u[rows], seen.h[rows][:, None] / count
        run = (seen.u[rows + 1] - here) * float(seen.first_order)
        one = len(self.q) == 1
        for j in range(count):
            arguments = {1: here + run * (j / count), 2: here + run * ((j + 1) / count), 4: h}
            yield arguments | ({} if one else {3: self.q[seen.row[rows]]}), {3: self.q[0]} if one else {}

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
        symbols, after = self._substep()
        return ca.Function("moved", symbols, [ca.densify(after)])

    @cached_property
    def _moved_with_slopes(self) -> ca.Function:
        """``(x, ua, ub, q, h) -> (x, vec d x / d x)`` after one substep."""
        symbols, after = self._substep()
        slopes = ca.jacobian(after, symbols[0])
        return ca.Function("moved", symbols, [ca.densify(after), ca.densify(ca.vec(slopes))])

    def _substep(self) -> tuple[list[ca.SX], ca.SX]:
        advance = self.kalman.step.advance
        symbols = [ca.SX.sym(f"i{k}", advance.size1_in(k)) for k in range(5)]
        return symbols, advance(*symbols)


def _mapped(function: ca.Function, rows: Arguments, same: Arguments) -> list[np.ndarray]:
    """The outputs (n, .) of ``function`` for each of n rows of some arguments (n, .), the others (.,) being the ``same`` for all."""
    n = len(next(iter(rows.values())))
    found = [np.empty((n, function.size1_out(k))) for k in range(function.n_out())]
    held = {k: np.ascontiguousarray(a, dtype=np.float64) for k, a in (rows | same).items()}
    whole, chunk = None, 0
    for start in range(0, n, CHUNK):
        part = slice(start, start + CHUNK)
        if whole is None or min(CHUNK, n - start) != chunk:
            chunk = min(CHUNK, n - start)
            whole = function.map("mapped", "serial", chunk, sorted(same), [])
        # Column by column in CasADi is row by row here: nothing is copied.
        buffer, evaluate = whole.buffer()
        for k, array in held.items():
            view = array if k in same else array[part]
            if view.size:
                buffer.set_arg(k, view.data)
        for k, array in enumerate(found):
            if array.size:
                buffer.set_res(k, array[part].data)
        evaluate()
    return found
