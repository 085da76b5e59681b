"""The kernel of large linear models: products of matrices by the BLAS library, nothing is written out or compiled.

A step of ``n`` states has ``n^2`` coefficients. Written out as scalar instructions, with a tangent for each constant, it takes a compiler
3 s for 16 states and 17 s for 24; as a product of matrices it is one call. All tangents move together, ``S+ = Phi S + W``, and what the
constants change in the step, ``W``, is one product for many samples.
"""

from __future__ import annotations

from collections.abc import Iterator

import casadi as ca
import numpy as np

from greybox.base.numerics import NUMBERS_AT_A_TIME
from greybox.simulation.integrators.step import Step, call_function
from greybox.simulation.kernel.interface import KernelArguments, KernelInParts, RecordPart, StepSizes
from greybox.simulation.kernel.record import Record


class LinearKernel(KernelInParts):
    """Runs a linear step by products of matrices; see `greybox.simulation.kernel.interface.Kernel` for the arguments.

    Parameters
    ----------
    step
        A step with `Step.regressors`, one of them in an interval, whose outputs are linear in the state.
    """

    name = "linear algebra"
    reason = "linear, with many states"

    def __init__(self, step: Step) -> None:
        assert step.regressors is not None
        self.step, self.sizes, self._regressors = step, StepSizes.of(step), step.regressors
        self.description = f"products of matrices, {step.label}"
        x, u, p = (
            ca.SX.sym(name, size)
            for name, size in zip("xup", (self.sizes.nx, self.sizes.nu, self.sizes.np), strict=True)
        )
        y = step.outputs(x, u, p)
        by_state, by_parameter = ca.jacobian(y, x), ca.jacobian(y, p)
        self._of_state = [np.array(part, int) for part in by_state.sparsity().get_triplet()]
        self._of_parameter = [np.array(part, int) for part in by_parameter.sparsity().get_triplet()]
        # dy/dx depends on the parameters alone; dy/dp on the sample.
        self._output_matrix = ca.Function("output_matrix", [u, p], [ca.densify(ca.vertcat(*by_state.nonzeros()))])
        self._outputs = ca.Function(
            "outputs", [x, u, p], [ca.densify(y), ca.densify(ca.vertcat(*by_parameter.nonzeros()))]
        )

        self._mapped: dict[tuple[str, int], ca.Function] = {}

    def with_substeps(self, substeps: int) -> LinearKernel:
        """The same: the step is exact, and there is one of them in an interval."""
        return self

    def run_parts(self, record: Record, n: int, arguments: KernelArguments) -> Iterator[RecordPart]:
        """The first ``n`` samples of a record, some at a time."""
        sizes, directions = self.sizes, arguments.directions
        nx, columns = sizes.nx, sizes.nq // sizes.nx
        # q is the matrix Q of the step, column by column; dq likewise, the directions last.
        steps = np.ascontiguousarray(arguments.q.reshape(-1, columns, nx).transpose(0, 2, 1))
        slopes = arguments.dq.reshape(len(steps), columns, nx * directions)
        moves = [bool(slope.any()) for slope in slopes]
        # W of a part, the tangents of its states and their outputs.
        size = max(1, NUMBERS_AT_A_TIME // (2 * (2 * nx + sizes.ny) * (1 + directions)))
        x, dx = arguments.x0, arguments.dx0
        for start in range(0, n, size):
            count = min(size, n - start)
            samples = np.arange(start, start + count)
            interval = np.minimum(samples, max(len(record.h) - 1, 0))
            row = np.zeros(count, int) if arguments.row is None or not len(arguments.row) else arguments.row[interval]
            inputs = self._evaluate(self._regressors, record.u[samples], record.find_ends(samples))[0]
            # x+ = Phi x + G r, with G r of all samples at once.
            driven = np.empty((count, nx))
            for k in np.unique(row):
                driven[row == k] = inputs[row == k] @ steps[k, :, nx:].T
            phi = steps[:, :, :nx]
            xs = run_recursion(phi, row, driven[:, :, None], x[:, None])[:, :, 0]
            dxs = np.empty((count + 1, nx, 0))
            if directions:
                # S+ = Phi S + W with W = dPhi x + dG r along all directions.
                forced = np.zeros((count, nx * directions))
                seen = np.hstack([xs[:-1], inputs])
                for k in np.unique(row):
                    if moves[k]:
                        forced[row == k] = seen[row == k] @ slopes[k]
                dxs = run_recursion(phi, row, forced.reshape(count, nx, directions), dx)
            y = self._evaluate(
                self._outputs, xs[:-1], record.u[samples], np.broadcast_to(arguments.p, (count, sizes.np))
            )[0]
            yield RecordPart(start, xs[:-1], y, dxs[:-1])
            x, dx = xs[-1].copy(), dxs[-1].copy()

    def _evaluate(self, function: ca.Function, *arguments: np.ndarray) -> list[np.ndarray]:
        """``function``, whose results are dense columns, for each row of the arguments: results (rows, ...)."""
        rows = len(arguments[0])
        key = function.name(), rows
        if key not in self._mapped:
            self._mapped[key] = function.map(rows)
        # CasADi stores column by column, hence row by row of the transposes.
        return [result.T for result in call_function(self._mapped[key], *(a.T for a in arguments))]

    def linearise(self, record: Record, part: RecordPart, arguments: KernelArguments) -> tuple[np.ndarray, np.ndarray]:
        """Residuals (n, ny) and their Jacobian (n, ny, L)."""
        sizes, count, directions = self.sizes, len(part.x), arguments.directions
        rows = slice(part.start, part.start + count)
        # r = (y_measured - y) w; NaN in ``measured`` marks gaps.
        r = (record.y[rows] - part.y) * arguments.weight
        # dr = -w (dy/dx S + dy/dp dp)
        entries = self._evaluate(self._output_matrix, record.u[rows][:1], arguments.p[None])[0][0]
        output, state = self._of_state
        jacobian = np.zeros((count, sizes.ny, directions))
        if len(entries) <= FEW_ENTRIES * sizes.ny:
            for i, k, entry in zip(output, state, entries, strict=True):
                jacobian[:, i] -= (arguments.weight[i] * entry) * part.tangents[:, k]
        else:
            matrix = np.zeros((sizes.ny, sizes.nx))
            matrix[output, state] = -arguments.weight[output] * entries
            np.matmul(matrix, part.tangents, out=jacobian)
        if len(self._of_parameter[0]) and arguments.dp.any():
            p = np.broadcast_to(arguments.p, (count, sizes.np))
            along = self._evaluate(self._outputs, part.x, record.u[rows], p)[1]
            for i, k, slope in zip(*self._of_parameter, along.T, strict=True):
                jacobian[:, i] -= arguments.weight[i] * slope[:, None] * arguments.dp[k]
        return r, jacobian


# Numbers of a state with its tangents up to which blocks of samples are run side by side: products of small matrices cost less than asking
# for them one by one.
FEW_NUMBERS = 1000
# Samples in such a block.
BLOCK = 32


def run_recursion(phi: np.ndarray, row: np.ndarray, forced: np.ndarray, start: np.ndarray) -> np.ndarray:
    """``s[k + 1] = phi[row[k]] s[k] + forced[k]`` from ``start`` (nx, L): all states (n + 1, nx, L)."""
    n = len(forced)
    s = np.empty((n + 1, *start.shape))
    s[0], s[1:] = start, forced
    blocks = n // BLOCK
    done = 0
    if start.size <= FEW_NUMBERS and blocks > 1 and not np.ptp(row):
        one, done = phi[row[0]], blocks * BLOCK
        # Each block from zero, all of them together; then what the state before a block adds to each of its samples.
        parts = s[1 : done + 1].reshape(blocks, BLOCK, *start.shape)
        powers = [one]
        for j in range(1, BLOCK):
            parts[:, j] += one @ parts[:, j - 1]
            powers.append(one @ powers[-1])
        before = np.empty((blocks, *start.shape))
        before[0] = start
        for k in range(1, blocks):
            before[k] = powers[-1] @ before[k - 1] + parts[k - 1, -1]
        parts += (np.concatenate(powers) @ before).reshape(parts.shape)
    for k in range(done, n):
        s[k + 1] += phi[row[k]] @ s[k]
    return s


# Entries of the output matrix for each output up to which they are added up one by one: most outputs are a state, or a sum of two.
FEW_ENTRIES = 4
