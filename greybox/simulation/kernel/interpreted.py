"""The kernel without a compiler: CasADi's virtual machine runs the same instructions, some hundred samples at a time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cached_property

import casadi as ca
import numpy as np

from greybox.base.numerics import NUMBERS_AT_A_TIME
from greybox.simulation.integrators.step import Step
from greybox.simulation.kernel.interface import KernelArguments, KernelInParts, RecordPart, StepSizes
from greybox.simulation.kernel.record import Record
from greybox.simulation.kernel.tape import Tape, read_tape, simplify_tape


class InterpretedKernel(KernelInParts):
    """Runs a step in CasADi's virtual machine; see `greybox.simulation.kernel.interface.Kernel` for the arguments.

    A pass takes 10 to 100 times as long as compiled: the more, the less the equations call functions such as ``tanh``.
    """

    name = "interpreted"
    chunk_sizes = (1000, 100)
    """Samples in one call of the virtual machine, of a long record and of its rest, but for wide models fewer: memory does not grow
    beyond one chunk."""

    def __init__(self, step: Step, reason: str = "asked for") -> None:
        self.step = step
        self.reason = reason
        self.description = f"CasADi virtual machine, {step.label} (no compiled code: {reason})"
        self.sizes = StepSizes.of(step)
        self._mapped_samples: dict[tuple, ca.Function] = {}

    @cached_property
    def _tapes(self) -> tuple[Tape, Tape]:
        return simplify_tape(read_tape(self.step.advance, active=(0, 3))), simplify_tape(
            read_tape(self.step.outputs, active=(0, 2))
        )

    def with_substeps(self, substeps: int) -> InterpretedKernel:
        """The same step with another number of substeps in an interval."""
        return InterpretedKernel(replace(self.step, substeps=substeps), self.reason)

    def run_parts(self, record: Record, n: int, arguments: KernelArguments) -> Iterator[RecordPart]:
        """The record in chunks, each started where the one before ended."""
        sizes, directions = self.sizes, arguments.directions
        # By its pattern over all rows: one function serves every chunk of the pass.
        used_dq, used_dp = (arguments.dq != 0).any(axis=0), arguments.dp != 0
        state = np.concatenate([arguments.x0, arguments.dx0.ravel()])
        widest = (sizes.nx + sizes.ny + sizes.nq + sizes.np) * (1 + directions)
        # Wide models take fewer samples in a call, so that a call stays within the same memory.
        most = max(1, NUMBERS_AT_A_TIME // max(widest, 1))
        start = 0
        while start < n:
            size = min(self.chunk_sizes[0] if n - start >= self.chunk_sizes[0] else self.chunk_sizes[1], most)
            count = min(size, n - start)
            # The last chunk repeats the last sample up to the length of the mapped function, which is built for a
            # few lengths only; what is repeated is cut off below.
            samples = np.minimum(np.arange(start, start + size), n - 1)
            after = record.find_ends(samples)
            intervals = np.minimum(samples, max(len(record.h) - 1, 0))
            # h of a substep.
            h = np.zeros(size) if not len(record.h) else record.h[intervals] / self.step.substeps
            row = (
                np.zeros(size, np.int32)
                if arguments.row is None or not len(arguments.row)
                else arguments.row[intervals]
            )
            columns = [
                state,
                record.u[samples],
                after,
                h,
                arguments.q[row],
                arguments.dq[row].reshape(size, -1),
                np.broadcast_to(arguments.p, (size, sizes.np)),
                np.broadcast_to(arguments.dp.ravel(), (size, sizes.np * directions)),
            ]
            states, y, dy = (
                np.empty((size, len(state))),
                np.empty((size, sizes.ny)),
                np.empty((size, sizes.ny * directions)),
            )
            _call_in_place(self._mapped_sample(used_dq, used_dp, size), columns, [states, y, dy])
            # States before each sample: the chunk's own results are those after it.
            x = np.vstack([state[: sizes.nx], states[: count - 1, : sizes.nx]])
            yield RecordPart(start, x, y[:count], dy[:count].reshape(count, sizes.ny, directions))
            state = states[-1].copy()
            start += count

    def linearise(self, record: Record, part: RecordPart, arguments: KernelArguments) -> tuple[np.ndarray, np.ndarray]:
        """Residuals (n, ny) and their Jacobian (n, ny, L)."""
        measured = record.y[part.start : part.start + len(part.y)]
        # r = (y_measured - y) w, hence dr = -w dy; NaN in ``measured`` marks gaps.
        return (measured - part.y) * arguments.weight, -arguments.weight[:, None] * part.tangents

    def _mapped_sample(self, used_dq: np.ndarray, used_dp: np.ndarray, size: int) -> ca.Function:
        """``size`` samples: (z, u, u after, h, q, dq, p, dp) -> (z after, y, dy) with ``z`` the state and its tangents.

        Entries of ``dq`` and ``dp`` that are zero throughout (most are: a coefficient depends on few parameters) are
        left out.
        """
        key = (used_dq.shape, used_dq.tobytes(), used_dp.tobytes(), size)
        if key not in self._mapped_samples:
            self._mapped_samples[key] = self._build_sample(used_dq, used_dp).mapaccum(size)
        return self._mapped_samples[key]

    def _build_sample(self, used_dq: np.ndarray, used_dp: np.ndarray) -> ca.Function:
        """One sample and the interval after it."""
        sizes, substeps, directions = self.sizes, self.step.substeps, used_dq.shape[1]
        shapes = {
            "x": sizes.nx,
            "dx": sizes.nx * directions,
            "u": sizes.nu,
            "after": sizes.nu,
            "h": 1,
            "q": sizes.nq,
            "dq": sizes.nq * directions,
        }
        symbols = {
            name: ca.SX.sym(name, size)
            for name, size in (shapes | {"p": sizes.np, "dp": sizes.np * directions}).items()
        }
        x, dx = symbols["x"], _rows(symbols["dx"], sizes.nx, directions)
        # A product with a structural zero drops out of the expression, and the tangents that hang on it.
        dq = _rows(symbols["dq"] * ca.DM(used_dq.ravel().astype(float)), sizes.nq, directions)
        dp = _rows(symbols["dp"] * ca.DM(used_dp.ravel().astype(float)), sizes.np, directions)
        advance, outputs = self._tapes
        # Outputs at the beginning of the interval, before the state moves on.
        y, dy = evaluate_tape(outputs, [x, symbols["u"], symbols["p"]], {0: dx, 2: dp}, directions)
        for j in range(substeps):
            ends = [symbols["u"] + (symbols["after"] - symbols["u"]) * (i / substeps) for i in (j, j + 1)]
            x, dx = evaluate_tape(advance, [x, *ends, symbols["q"], symbols["h"]], {0: dx, 3: dq}, directions)
        initial = ca.vertcat(symbols["x"], symbols["dx"])
        names = ("u", "after", "h", "q", "dq", "p", "dp")
        # Row by row, as numpy has tangents: the transpose turns CasADi's columns.
        results = [ca.vertcat(x, ca.vec(dx.T)), y, ca.vec(dy.T)]
        return ca.Function("sample", [initial, *(symbols[name] for name in names)], results)


def evaluate_tape(tape: Tape, inputs: Sequence[ca.SX], seeds: dict[int, ca.SX], directions: int) -> tuple[ca.SX, ca.SX]:
    """The first output of a tape and its tangents (rows, ``directions``) as expressions, ``seeds`` being the tangents of its inputs."""
    nodes: dict[int, ca.SX] = {}
    rows: dict[int, ca.SX] = {}
    zero = ca.SX.zeros(1, directions)
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
        elif directions:
            tangent = tape.tangents[k]
            if tangent.source is not None:
                rows[k] = seeds[tangent.source[0]][tangent.source[1], :]
            elif tangent.condition is not None:
                sides = [zero if side is None else rows[side] for _, side in tangent.terms]
                # A choice takes one side whole: a product with 0 and 1 would carry NaN from the side that does not
                # count.
                rows[k] = ca.if_else(nodes[tangent.condition], *sides)
            else:
                signs = tangent.signs or (1.0,) * len(tangent.terms)
                rows[k] = zero
                for sign, (coefficient, side) in zip(signs, tangent.terms, strict=True):
                    term = rows[side] if coefficient is None else nodes[coefficient] * rows[side]  # type: ignore[index]
                    rows[k] = rows[k] + term if sign > 0 else rows[k] - term
    values = ca.vertcat(*[nodes[node] for node, _ in tape.outputs[0]])
    slopes = ca.vertcat(*[zero if k is None or not directions else rows[k] for _, k in tape.outputs[0]])
    return values, slopes


def _rows(column: ca.SX, rows: int, directions: int) -> ca.SX:
    """A column (rows * directions) in numpy's order as (rows, directions)."""
    return ca.reshape(column, directions, rows).T


def _call_in_place(function: ca.Function, arguments: Sequence[np.ndarray], results: Sequence[np.ndarray]) -> None:
    """Run on arrays in place, each (samples, size): column by column for CasADi. A buffer of its own for each call and
    thread."""
    buffer, evaluate = function.buffer()
    contiguous = [np.ascontiguousarray(a, dtype=np.float64) for a in arguments]
    for i, array in enumerate(contiguous):
        if array.size:
            buffer.set_arg(i, array.data)
    for i, array in enumerate(results):
        if array.size:
            buffer.set_res(i, array.data)
    evaluate()
