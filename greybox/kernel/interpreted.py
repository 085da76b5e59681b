"""The kernel without a compiler: the same instructions run by CasADi's virtual machine, some hundred samples at a
time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cached_property
from typing import NamedTuple

import casadi as ca
import numpy as np

from greybox.integrators.step import Step
from greybox.kernel.arguments import KernelArguments, StepSizes, chain_coefficients, check_arguments
from greybox.kernel.interface import GaussNewtonSums, check_sums
from greybox.kernel.record import Record
from greybox.kernel.simplify import simplify_tape
from greybox.kernel.tape import Tape, read_tape

CHUNKS = (1000, 100)  # samples in one call of the virtual machine; memory does not grow beyond one chunk


class RecordChunk(NamedTuple):
    """Samples ``start : start + len(y)``: states, outputs and their tangents (samples, ny, L)."""

    start: int
    x: np.ndarray
    y: np.ndarray
    dy: np.ndarray


class InterpretedKernel:
    """Runs a step in CasADi's virtual machine; see `greybox.kernel.interface.Kernel` for the arguments.

    A pass takes 10 to 100 times as long as compiled: the more, the less the equations call functions such as ``tanh``.
    """

    name = "interpreted"

    def __init__(self, step: Step, reason: str = "asked for") -> None:
        self.step = step
        self.reason = reason
        self.description = f"CasADi virtual machine, {step.label} (no compiled code: {reason})"
        self.sizes = StepSizes.of(step)
        self._passes: dict[tuple, ca.Function] = {}

    @cached_property
    def _tapes(self) -> tuple[Tape, Tape]:
        return simplify_tape(read_tape(self.step.advance, active=(0, 3))), simplify_tape(
            read_tape(self.step.outputs, active=(0, 2))
        )

    def with_substeps(self, substeps: int) -> InterpretedKernel:
        """The same step with another number of substeps in an interval."""
        return InterpretedKernel(replace(self.step, substeps=substeps), self.reason)

    def coefficients(self, record: Record, p: np.ndarray, dp: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Coefficients (rows, nq) of the step at ``p`` (np,), and their slopes (rows, nq, L) along ``dp`` (np, L)."""
        return chain_coefficients(self.step, record.lengths, p, dp)

    def simulate(self, record: Record, q: np.ndarray, p: np.ndarray, x0: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Outputs (N, ny) and states (N, nx); not finite from where the simulation overflows."""
        a = check_arguments(self.sizes, record, q, p, x0)
        parts = list(self._parts(record, len(record.y), a))
        return np.concatenate([part.y for part in parts]), np.concatenate([part.x for part in parts])

    def sums(
        self,
        record: Record,
        q: np.ndarray,
        dq: np.ndarray,
        p: np.ndarray,
        dp: np.ndarray,
        x0: np.ndarray,
        dx0: np.ndarray,
        weight: np.ndarray,
        rows: int | None = None,
    ) -> GaussNewtonSums:
        """Cost, gradient and Gauss-Newton matrix over the first ``rows`` samples (None: all)."""
        a = check_arguments(self.sizes, record, q, p, x0, dq=dq, dp=dp, dx0=dx0, weight=weight)
        n, directions = len(record.y) if rows is None else min(rows, len(record.y)), a.directions
        squares, counts = np.zeros(self.sizes.ny), np.zeros(self.sizes.ny)
        gradient, matrix = np.zeros(directions), np.zeros((directions, directions))
        failed_at = None
        with np.errstate(all="ignore"):  # what is not finite is found and reported
            for part in self._parts(record, n, a):
                failed_at = _first_failure(part)
                if failed_at is not None:
                    break
                r, jacobian = _residuals(record, part, a.weight)
                there = np.isfinite(r)
                squares += np.square(np.where(there, r, 0.0)).sum(axis=0)
                counts += there.sum(axis=0)
                gradient += jacobian[there].T @ r[there]
                matrix += jacobian[there].T @ jacobian[there]
        return check_sums(squares, counts, gradient, matrix, failed_at, n)

    def residuals(
        self,
        record: Record,
        q: np.ndarray,
        dq: np.ndarray,
        p: np.ndarray,
        dp: np.ndarray,
        x0: np.ndarray,
        dx0: np.ndarray,
        weight: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Residuals (N, ny) and their Jacobian (N, ny, L), NaN in gaps and from where the simulation overflows."""
        a = check_arguments(self.sizes, record, q, p, x0, dq=dq, dp=dp, dx0=dx0, weight=weight)
        r = np.full(record.y.shape, np.nan)
        jacobian = np.full((*record.y.shape, a.directions), np.nan)
        with np.errstate(all="ignore"):  # what is not finite is left NaN
            for part in self._parts(record, len(record.y), a):
                end = _first_failure(part)
                here = slice(part.start, part.start + len(part.y) if end is None else end)
                size = here.stop - here.start
                r[here], slopes = (values[:size] for values in _residuals(record, part, a.weight))
                jacobian[here] = np.where(np.isnan(r[here])[:, :, None], np.nan, slopes)
                if end is not None:
                    break
        return r, jacobian

    def _parts(self, record: Record, n: int, a: KernelArguments) -> Iterator[RecordChunk]:
        """The record in chunks, each started where the one before ended."""
        s, tangents = self.sizes, a.directions
        used_dq, used_dp = (a.dq != 0).any(axis=0), a.dp != 0
        z = np.concatenate([a.x0, a.dx0.ravel()])
        start = 0
        while start < n:
            size = CHUNKS[0] if n - start >= CHUNKS[0] else CHUNKS[1]
            used = min(size, n - start)
            samples = np.minimum(np.arange(start, start + size), n - 1)
            after = np.minimum(samples + 1, len(record.u) - 1)
            intervals = np.minimum(samples, max(len(record.h) - 1, 0))
            h = np.zeros(size) if not len(record.h) else record.h[intervals] / self.step.substeps
            row = np.zeros(size, np.int32) if a.row is None or not len(a.row) else a.row[intervals]
            columns = [
                z, record.u[samples], record.u[after], h, a.q[row], a.dq[row].reshape(size, -1),
                np.broadcast_to(a.p, (size, s.np)), np.broadcast_to(a.dp.ravel(), (size, s.np * tangents)),
            ]  # fmt: skip
            states, y, dy = np.empty((size, len(z))), np.empty((size, s.ny)), np.empty((size, s.ny * tangents))
            _call(self._pass(used_dq, used_dp, record.first_order, size), columns, [states, y, dy])
            x = np.vstack([z[: s.nx], states[: used - 1, : s.nx]])
            yield RecordChunk(start, x, y[:used], dy[:used].reshape(used, s.ny, tangents))
            z = states[-1].copy()
            start += used

    def _pass(self, used_dq: np.ndarray, used_dp: np.ndarray, first_order: bool, size: int) -> ca.Function:
        """``size`` samples: (z, u, u after, h, q, dq, p, dp) -> (z after, y, dy) with ``z`` the state and its tangents.

        Entries of ``dq`` and ``dp`` that are zero throughout (most are: a coefficient depends on few parameters) are
        left out.
        """
        key = (used_dq.shape, used_dq.tobytes(), used_dp.tobytes(), first_order, size)
        if key not in self._passes:
            self._passes[key] = self._sample(used_dq, used_dp, first_order).mapaccum(size)
        return self._passes[key]

    def _sample(self, used_dq: np.ndarray, used_dp: np.ndarray, first_order: bool) -> ca.Function:
        """One sample and the interval after it."""
        s, n, tangents = self.sizes, self.step.substeps, used_dq.shape[1]
        shapes = {"x": s.nx, "dx": s.nx * tangents, "u": s.nu, "after": s.nu, "h": 1, "q": s.nq, "dq": s.nq * tangents}
        v = {name: ca.SX.sym(name, size) for name, size in (shapes | {"p": s.np, "dp": s.np * tangents}).items()}
        x, dx = v["x"], _rows(v["dx"], s.nx, tangents)
        dq = _rows(v["dq"] * ca.DM(used_dq.ravel().astype(float)), s.nq, tangents)
        dp = _rows(v["dp"] * ca.DM(used_dp.ravel().astype(float)), s.np, tangents)
        advance, outputs = self._tapes
        y, dy = evaluate_tape(outputs, [x, v["u"], v["p"]], {0: dx, 2: dp}, tangents)
        for j in range(n):
            ends = [v["u"] + (v["after"] - v["u"]) * (i / n) if first_order else v["u"] for i in (j, j + 1)]
            x, dx = evaluate_tape(advance, [x, *ends, v["q"], v["h"]], {0: dx, 3: dq}, tangents)
        before = ca.vertcat(v["x"], v["dx"])
        names = ("u", "after", "h", "q", "dq", "p", "dp")
        results = [ca.vertcat(x, ca.vec(dx.T)), y, ca.vec(dy.T)]
        return ca.Function("sample", [before, *(v[name] for name in names)], results)


def evaluate_tape(tape: Tape, inputs: Sequence[ca.SX], seeds: dict[int, ca.SX], tangents: int) -> tuple[ca.SX, ca.SX]:
    """The first output of a tape and its tangents (rows, ``lanes``) as expressions."""
    nodes: dict[int, ca.SX] = {}
    rows: dict[int, ca.SX] = {}
    zero = ca.SX.zeros(1, tangents)
    for kind, k in tape.order:
        if kind == "node":
            node = tape.nodes[k]
            if node.op == ca.OP_CONST:
                nodes[k] = ca.SX(node.number)
            elif node.op == ca.OP_INPUT:
                nodes[k] = inputs[node.args[0]][node.args[1]]
            else:
                args = [nodes[a] for a in node.args]
                nodes[k] = ca.SX.unary(node.op, *args) if len(args) == 1 else ca.SX.binary(node.op, *args)
        elif tangents:
            tangent = tape.tangents[k]
            if tangent.source is not None:
                rows[k] = seeds[tangent.source[0]][tangent.source[1], :]
            elif tangent.condition is not None:
                sides = [zero if side is None else rows[side] for _, side in tangent.terms]
                rows[k] = ca.if_else(nodes[tangent.condition], *sides)
            else:
                signs = tangent.signs or (1.0,) * len(tangent.terms)
                rows[k] = zero
                for sign, (coefficient, side) in zip(signs, tangent.terms, strict=True):
                    term = rows[side] if coefficient is None else nodes[coefficient] * rows[side]  # type: ignore[index]
                    rows[k] = rows[k] + term if sign > 0 else rows[k] - term
    values = ca.vertcat(*[nodes[node] for node, _ in tape.outputs[0]])
    slopes = ca.vertcat(*[zero if k is None or not tangents else rows[k] for _, k in tape.outputs[0]])
    return values, slopes


def _rows(column: ca.SX, rows: int, tangents: int) -> ca.SX:
    """A column (rows * lanes) in numpy's order as (rows, lanes)."""
    return ca.reshape(column, tangents, rows).T


def _call(function: ca.Function, arguments: Sequence[np.ndarray], results: Sequence[np.ndarray]) -> None:
    """Run on arrays in place, each (samples, size): column by column for CasADi. A buffer of its own for each call and
    thread."""
    buffer, evaluate = function.buffer()
    held = [np.ascontiguousarray(a, dtype=np.float64) for a in arguments]
    for i, array in enumerate(held):
        if array.size:
            buffer.set_arg(i, array.data)
    for i, array in enumerate(results):
        if array.size:
            buffer.set_res(i, array.data)
    evaluate()


def _residuals(record: Record, part: RecordChunk, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    measured = record.y[part.start : part.start + len(part.y)]
    return (measured - part.y) * weight, -weight[:, None] * part.dy


def _first_failure(part: RecordChunk) -> int | None:
    """The first sample with a state or output that is not finite."""
    bad = ~(np.isfinite(part.x).all(axis=1) & np.isfinite(part.y).all(axis=1))
    return part.start + int(np.argmax(bad)) if bad.any() else None
