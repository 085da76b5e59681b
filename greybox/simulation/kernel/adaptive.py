"""The kernel of steps whose length follows the error: compiled where there is a C compiler, else by NumPy.

A pass is a simulation whose steps are chosen on the way; its tangents are the derivatives of just these steps, their lengths held, so that
cost and gradient belong together to rounding. Each pass chooses anew: where the constants change the steps change with them.
"""

from __future__ import annotations

import ctypes
from collections.abc import Collection, Iterator
from dataclasses import replace
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from greybox.base.numerics import NUMBERS_AT_A_TIME
from greybox.simulation.integrators import esdirk
from greybox.simulation.integrators.step import Step, call_function
from greybox.simulation.kernel.c_compiler import CompilerError, choose_vector_width, load_library
from greybox.simulation.kernel.c_routine import CRoutine, read_template
from greybox.simulation.kernel.interface import KernelArguments, KernelInParts, RecordPart, StepSizes
from greybox.simulation.kernel.record import Record, is_repeated
from greybox.simulation.kernel.tape import UnsupportedOperationError, fuse_products, read_tape, simplify_tape

# Share of the largest size a state has had that its error is measured against beside its present size: a state that dies away, or passes
# through zero, is followed to a thousandth of the tolerance of its peak.
FLOOR = 1e-3
# The same of the largest size of all states in its unit: below, rounding of the others is what moves it.
MATES = 1e-5
# The first step moves the states by about this share of themselves.
FIRST_SHARE = 1e-3
# Steps of a run, refused ones included, and what comes to them for each interval; the shortest step as a share of its interval. A run
# that asks for more has run away, and does not go on.
MOST_STEPS = 20_000
STEPS_AN_INTERVAL = 100
SMALLEST_STEP = 1e-13
# The first step at least, as a share of its interval: of a state that begins at zero, beside large ones, nearly any move is a large one.
FIRST_STEP = 1e-11
# A step is as long as would make the error of the next one (SAFETY)^4 of what is allowed, and stays as long as it is unless it may grow by
# KEPT_GROWTH: with another length comes another matrix to factorise.
SAFETY = 0.9
KEPT_GROWTH = 1.2
# Newton's iterations of a stage, and the share of the tolerance of a step that they may leave.
MOST_ITERATIONS = 10
NEWTON_SHARE = 0.01
# Ratios of a change to the one before: above the first the Jacobian is made anew for the next step, above the second the stage has no end.
SLOW = 0.2
DIVERGING = 0.9
# States up to which each step has a Jacobian of its own: it costs no more than the iterations that it saves.
FEW_STATES = 12
# Share of the products of a full elimination up to which the entries that are no zeros are eliminated by themselves: each is looked up.
FEW_PRODUCTS = 0.25
# A diagonal so much smaller than what it divides is left to an elimination that exchanges rows: what it would leave of the others is
# rounding by that factor.
SMALLEST_PIVOT = 1e-3


class AdaptiveKernel(KernelInParts):
    """Runs steps whose length follows the error; see `greybox.simulation.kernel.interface.Kernel` for the arguments.

    Parameters
    ----------
    step
        A step with `Step.adaptive`.
    free
        Numbers of the parameters that directions move, None for any.
    """

    def __init__(self, step: Step, free: Collection[int] | None = None) -> None:
        assert step.adaptive is not None
        self.step, self.sizes, self.free = step, StepSizes.of(step), None if free is None else frozenset(free)
        # Of a method of order 4, k times as many steps have a k^4th of the error.
        self.tolerance = step.adaptive.tolerance / step.substeps**esdirk.ERROR_ORDER
        x, u, p = (
            ca.SX.sym(name, size)
            for name, size in zip("xup", (self.sizes.nx, self.sizes.nu, self.sizes.np), strict=True)
        )
        rates, outputs = step.adaptive.rates(x, u, p), step.outputs(x, u, p)
        by_state = ca.jacobian(rates, x)
        self._rates = ca.Function("rates", [x, u, p], [ca.densify(rates)])
        self._jacobian = ca.Function("jacobian", [x, u, p], [_list_entries(by_state)])
        self._places = [np.array(part, int) for part in by_state.sparsity().get_triplet()]
        self._elimination = plan_elimination(self.sizes.nx, *self._places)
        slopes = [rates, by_state, ca.jacobian(rates, p)]
        self._slopes = ca.Function("slopes", [x, u, p], [ca.densify(e) for e in slopes])
        self._outputs = ca.Function("outputs", [x, u, p], [ca.densify(outputs)])
        slopes = [ca.jacobian(outputs, along) for along in (x, p)]
        self._output_slopes = ca.Function("output_slopes", [x, u, p], [_list_entries(e) for e in slopes])
        self._output_places = [tuple(np.array(part, int) for part in e.sparsity().get_triplet()) for e in slopes]
        # The number of each state's unit.
        units = list(step.adaptive.units)
        self._units = [units.index(unit) for unit in units]
        # Low and high limit of each state (2, nx); C has no infinite constant.
        self._is_limited, most = bool(step.adaptive.limits), np.finfo(float).max
        self._limits = np.tile([[-most], [most]], self.sizes.nx)
        for k, low, high in step.adaptive.limits:
            self._limits[:, k] = np.clip((low, high), -most, most)
        self._libraries: dict[tuple[int, int], Any] = {}
        self.work = np.zeros(4, np.int64)
        """Steps, steps refused, Jacobians and factorisations so far."""
        self.reason, self.is_compiled = "stiff, and smooth", True
        self._compile(0)

    name = "adaptive"

    @property
    def is_fresh_each_step(self) -> bool:
        """Whether each step has a Jacobian of its own."""
        return self._elimination is not None or self.sizes.nx <= FEW_STATES

    @property
    def description(self) -> str:
        """What runs it, and to which tolerance."""
        return f"{'compiled C' if self.is_compiled else 'NumPy'}, {self.step.label}"

    def with_substeps(self, substeps: int) -> AdaptiveKernel:
        """The same with steps as many times shorter than the tolerance of the step asks for."""
        return AdaptiveKernel(replace(self.step, substeps=substeps), self.free)

    def run_parts(self, record: Record, n: int, arguments: KernelArguments) -> Iterator[RecordPart]:
        """The first ``n`` samples of a record, some at a time."""
        directions, nx = arguments.directions, self.sizes.nx
        size = max(2, NUMBERS_AT_A_TIME // (2 * (nx + self.sizes.ny) * (1 + directions)))
        x, dx, carry, start = arguments.x0, arguments.dx0, np.zeros(1 + nx), 0
        while start < n:
            count = min(size, n - start)
            # One row more than is handed over: where the next part begins.
            end = min(start + count + 1, n)
            h = record.h if is_repeated(record.h) else record.h[start : end - 1]
            xs, dxs = np.full((end - start, nx), np.nan), np.zeros((end - start, nx, directions))
            run = self._run if self.is_compiled and self._compile(arguments.directions) else self._run_by_numpy
            run(record.u[start:end], h, record.is_linear, arguments, x, dx, carry, xs, dxs)
            (y,) = self._map(self._outputs, xs[:count], record.u[start : start + count], arguments.p)
            yield RecordPart(start, xs[:count], y, dxs[:count])
            x, dx, start = xs[-1].copy(), dxs[-1].copy(), start + count

    def linearise(self, record: Record, part: RecordPart, arguments: KernelArguments) -> tuple[np.ndarray, np.ndarray]:
        """Residuals (n, ny) of a part and their Jacobian (n, ny, L)."""
        rows = slice(part.start, part.start + len(part.x))
        # r = (y_measured - y) w and dr = -w (dy/dx S + dy/dp dp).
        r = (record.y[rows] - part.y) * arguments.weight
        along = np.zeros((*r.shape, arguments.directions))
        moved = part.tangents, np.broadcast_to(arguments.dp, (len(r), *arguments.dp.shape))
        entries = self._map(self._output_slopes, part.x, record.u[rows], arguments.p)
        for (row, column), values, tangents in zip(self._output_places, entries, moved, strict=True):
            slopes = np.zeros((*r.shape, tangents.shape[1]))
            slopes[:, row, column] = values
            along += slopes @ tangents
        return r, -arguments.weight[:, None] * along

    def _map(self, function: ca.Function, x: np.ndarray, u: np.ndarray, p: np.ndarray) -> list[np.ndarray]:
        """The results of a ``function`` whose results are columns, for each row: (n, entries of a result)."""
        count = len(x)
        results = call_function(function.map(count), x.T, u.T, np.broadcast_to(p, (count, len(p))).T)
        # CasADi lays the results of the rows side by side.
        return [result.T.reshape(count, -1) for result in results]

    def _run(
        self,
        u: np.ndarray,
        h: np.ndarray,
        is_linear: np.ndarray,
        arguments: KernelArguments,
        x: np.ndarray,
        dx: np.ndarray,
        carry: np.ndarray,
        xs: np.ndarray,
        dxs: np.ndarray,
    ) -> None:
        """The states (n, nx) at all rows and their tangents (n, nx, L), written to ``xs`` and ``dxs``; ``carry`` is updated."""
        directions = arguments.directions
        width, blocks = _layout(directions)
        lanes = np.zeros((*xs.shape, blocks * width))
        dp, dx0 = (_pad(a, blocks * width) for a in (arguments.dp, dx))
        arrays = [np.ascontiguousarray(a, np.float64) for a in (is_linear, u, h, arguments.p, x, dp, dx0)]
        self._get_library(width, blocks)(
            len(u),
            is_repeated(h),
            self.tolerance,
            *(a.ctypes.data for a in (*arrays, carry, xs, lanes, self.work)),
        )
        dxs[:] = lanes[:, :, :directions]

    def _run_by_numpy(
        self,
        u: np.ndarray,
        h: np.ndarray,
        is_linear: np.ndarray,
        arguments: KernelArguments,
        x: np.ndarray,
        dx: np.ndarray,
        carry: np.ndarray,
        xs: np.ndarray,
        dxs: np.ndarray,
    ) -> None:
        """The same in Python, line by line."""
        run = _NumpyRun(self, arguments, carry, MOST_STEPS + STEPS_AN_INTERVAL * len(u))
        with np.errstate(all="ignore"):  # what is not finite ends the run
            for row in range(len(u)):
                xs[row], dxs[row] = x, dx
                if row + 1 == len(u):
                    break
                length, ends = float(h[row]), (u[row], np.where(is_linear, u[row + 1], u[row]))
                reached = run.cross(x, dx, length, *ends)
                if reached is None:
                    break
                x, dx = reached

    def _compile(self, directions: int) -> bool:
        """Whether there is compiled code for so many directions; from where there is none on, NumPy runs."""
        try:
            self._get_library(*_layout(directions))
        except (CompilerError, UnsupportedOperationError) as error:
            self.reason, self.is_compiled = f"no compiled code: {error}", False
        return self.is_compiled

    def _get_library(self, width: int, blocks: int) -> Any:
        """The function of the C text with room for ``blocks`` of ``width`` directions, compiled when first asked for."""
        key = width, blocks
        if key not in self._libraries:
            statement = " ".join(f.serialize() for f in (self._rates, self._jacobian))
            library = load_library(
                lambda: self._write_source(width, blocks),
                f"adaptive {statement} {key} {self.free and sorted(self.free)} {self._limits.tolist()}",
                is_quick=True,
            )
            function = library.integrate
            numbers = (ctypes.c_long, ctypes.c_int, ctypes.c_double)
            function.argtypes, function.restype = (*numbers, *[ctypes.c_void_p] * 11), ctypes.c_long
            self._libraries[key] = function
        return self._libraries[key]

    def _write_source(self, width: int, blocks: int) -> str:
        """The C text of a library."""
        row, column = self._places
        constants = {
            **{"NX": self.sizes.nx, "NU": self.sizes.nu, "NJ": len(row), "STAGES": esdirk.STAGES},
            **{"GAMMA": float(esdirk.GAMMA), "ORDER": esdirk.ERROR_ORDER, "FLOOR": FLOOR, "MATES": MATES},
            **{"FIRST_SHARE": FIRST_SHARE, "MOST_STEPS": MOST_STEPS, "STEPS_AN_INTERVAL": STEPS_AN_INTERVAL},
            **{"SMALLEST_STEP": SMALLEST_STEP, "FIRST_STEP": FIRST_STEP, "SAFETY": SAFETY},
            **{"KEPT_GROWTH": KEPT_GROWTH, "MOST_ITERATIONS": MOST_ITERATIONS, "NEWTON_SHARE": NEWTON_SHARE},
            **{"SLOW": SLOW, "DIVERGING": DIVERGING, "SMALLEST_PIVOT": SMALLEST_PIVOT},
            "IS_FRESH_EACH_STEP": int(self.is_fresh_each_step),
        }
        if blocks:
            constants |= {"W": width, "NB": blocks}
        arrays = {"int JACOBIAN_ROW": row, "int JACOBIAN_COLUMN": column, "double NODES": esdirk.NODES}
        arrays |= {"int UNIT": np.array(self._units), "double LESS": esdirk.LESS, "double TABLE": esdirk.TABLE.ravel()}
        if self._is_limited:
            constants["LIMITED"] = 1
            arrays |= {"double LOW": self._limits[0], "double HIGH": self._limits[1]}
        if self._elimination is not None:
            constants["ORDERED"] = 1
            arrays["int PIVOTS"] = np.array(self._elimination.order)
            for name, parts in (("BELOW", self._elimination.below), ("RIGHT", self._elimination.right)):
                arrays[f"int {name}_START"] = np.cumsum([0, *map(len, parts)])
                arrays[f"int {name}"] = np.concatenate(parts)
        inputs = ("x", "u", "p")
        tapes = {name: read_tape(f, active=(), varying=(0, 1)) for name, f in self._plain_functions().items()}
        routines = [CRoutine(name, fuse_products(simplify_tape(t)), inputs, (), 0).text() for name, t in tapes.items()]
        if blocks:
            elements = {} if self.free is None else {2: self.free}
            tape = fuse_products(
                simplify_tape(read_tape(self._rates, active=(0, 2), varying=(0, 1), elements=elements))
            )
            routines.append(CRoutine("slopes", tape, inputs, (0, 2), blocks).text())
        return "\n".join(
            [
                "/* Generated by greybox: the rates of a model and steps whose length follows the error. */",
                read_template("kernel.h"),
                *(f"#define {name} {value!r}" for name, value in constants.items()),
                *(
                    f"static const {name}[] = {{{', '.join(map(repr, values.tolist())) or '0'}}};"
                    for name, values in arrays.items()
                ),
                *([read_template("lanes.h")] if blocks else []),
                *routines,
                read_template("adaptive.c"),
            ]
        )

    def _plain_functions(self) -> dict[str, ca.Function]:
        return {"rates": self._rates, "jacobian": self._jacobian}


class Elimination(NamedTuple):
    """The order in which unknowns are eliminated; for each the rows that hold it then, and the columns that its own row holds then."""

    order: list[int]
    below: list[np.ndarray]
    right: list[np.ndarray]


def plan_elimination(n: int, row: np.ndarray, column: np.ndarray) -> Elimination | None:
    """How ``n`` equations with entries at ``row``, ``column`` and the diagonal are solved with few products; None where few are full ones.

    Each time the unknown whose elimination makes the fewest entries (H. M. Markowitz, Management Science 3, 1957), of the diagonal alone.
    """
    held, left = np.eye(n, dtype=bool), np.ones(n, bool)
    held[row, column] = True
    plan = Elimination([], [], [])
    for _ in range(n):
        counts = (held[left].sum(axis=0) - 1.0) * (held[:, left].sum(axis=1) - 1.0)
        k = int(np.argmin(np.where(left, counts, np.inf)))
        left[k] = False
        below, right = np.flatnonzero(held[:, k] & left), np.flatnonzero(held[k] & left)
        held[np.ix_(below, right)] = True
        plan.order.append(k)
        plan.below.append(below)
        plan.right.append(right)
    products = sum(len(b) * len(r) for b, r in zip(plan.below, plan.right, strict=True))
    # A full one takes the squares of n - 1, n - 2, ..., 1.
    return plan if products <= FEW_PRODUCTS * n * (n - 1) * (2 * n - 1) / 6 else None


def _list_entries(matrix: ca.SX) -> ca.SX:
    """The entries of a sparse matrix in a column, in the order of its triplets."""
    return ca.densify(ca.vertcat(*matrix.nonzeros()))


def _layout(directions: int) -> tuple[int, int]:
    """Width of a block of directions, and how many blocks."""
    width = choose_vector_width(directions) if directions else 0
    return width, -(-directions // width) if directions else 0


def _pad(array: np.ndarray, lanes: int) -> np.ndarray:
    """Directions (last axis) filled up with zeros."""
    padded = np.zeros((*array.shape[:-1], lanes))
    padded[..., : array.shape[-1]] = array
    return padded


class _Matrix(NamedTuple):
    """``I - scale J`` as factors."""

    scale: float
    factors: tuple[np.ndarray, np.ndarray]


class _NumpyRun:
    """Steps one after the other; ``carry`` (1 + nx) is the length of the next one and the largest size of each state so far."""

    def __init__(self, kernel: AdaptiveKernel, arguments: KernelArguments, carry: np.ndarray, steps: int) -> None:
        self.kernel, self.arguments, self.carry, self.before = kernel, arguments, carry, 1.0
        self.steps_left = steps

    def rates(self, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        return call_function(self.kernel._rates, x, u, self.arguments.p)[0].ravel()

    def rates_along(self, x: np.ndarray, dx: np.ndarray, u: np.ndarray) -> np.ndarray:
        _, by_state, by_parameter = call_function(self.kernel._slopes, x, u, self.arguments.p)
        return by_state @ dx + by_parameter @ self.arguments.dp

    def set_scales(self, x: np.ndarray) -> None:
        """What the error of each state is measured against; zero where nothing in its unit has moved yet."""
        size = self.carry[1:]
        size[:] = np.maximum(size, np.abs(x))
        units = np.array(self.kernel._units)
        mates = np.array([size[units == unit].max() for unit in units])
        self.scale = np.abs(x) + FLOOR * np.maximum(size, MATES * mates)

    def measure(self, error: np.ndarray, rate: np.ndarray, step: float) -> float:
        """Root mean square of the errors over what a step may make; a state without a scale has that of its present rate over the step."""
        if not np.isfinite(error).all():
            return np.inf
        scale = np.where(self.scale > 0, self.scale, FLOOR * step * np.abs(rate))
        known = scale > 0
        return float(np.sqrt(np.sum((error[known] / (self.kernel.tolerance * scale[known])) ** 2) / len(error)))

    def cross(
        self, x: np.ndarray, dx: np.ndarray, length: float, start: np.ndarray, end: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray] | None:
        """State and tangents after an interval over which the input runs from ``start`` to ``end``; None where its end is not reached."""
        self.set_scales(x)
        first, dfirst = self.rates(x, start), self.rates_along(x, dx, start)
        known = self.scale > 0
        state, rate = (float(np.sum((v[known] / self.scale[known]) ** 2)) for v in (x, first))
        # Where all is at zero the steps before tell nothing.
        if not (self.carry[0] > 0 and state > 0):
            share = max(FIRST_SHARE * np.sqrt(state / rate), FIRST_STEP * length) if state > 0 and rate > 0 else 0.0
            self.carry[0] = share or FIRST_SHARE * length
        done, jacobian, matrix, is_fresh = 0.0, None, None, False
        while self.steps_left > 0:
            self.steps_left -= 1
            left = length - done
            step = left if self.carry[0] >= left else left / 2 if 2 * self.carry[0] > left else self.carry[0]
            if not step > SMALLEST_STEP * length:
                return None
            if jacobian is None:
                jacobian = call_function(self.kernel._slopes, x, start, self.arguments.p)[1]
                matrix, is_fresh = None, True
                self.kernel.work[2] += 1
            if matrix is None or matrix.scale != float(esdirk.GAMMA) * step:
                matrix = _factorise(float(esdirk.GAMMA) * step, jacobian)
                self.kernel.work[3] += 1
            inputs = [start + (end - start) * (done + c * step) / length for c in esdirk.NODES]
            stages, rates, is_slow = self._solve_stages(x, first, step, inputs, matrix)
            wrong = np.inf
            if stages is not None:
                error = _solve(matrix, step * (esdirk.LESS @ np.array(rates)))
                wrong = self.measure(error, first, step)
            if not wrong <= 1:
                self.kernel.work[1] += 1
                if stages is None and not is_fresh:
                    jacobian = None
                    continue
                shorter = max(0.2, SAFETY * wrong ** (-1 / esdirk.ERROR_ORDER)) if wrong < np.inf else 0.25
                self.carry[0] = step * shorter
                continue
            self.kernel.work[0] += 1
            assert stages is not None
            dx, dfirst = self._move_tangents(dx, dfirst, step, stages, inputs)
            x, first = stages[-1], rates[-1]
            # As `greybox.simulation.integrators.composition.stop_at_bounds` has it.
            inside = np.clip(x, *self.kernel._limits)
            if np.any(is_stopped := inside != x):
                x, dx[is_stopped] = inside, 0.0
                first, dfirst = self.rates(x, inputs[-1]), self.rates_along(x, dx, inputs[-1])
            self.set_scales(x)
            growth = (
                SAFETY * max(wrong, 1e-10) ** (-0.7 / esdirk.ERROR_ORDER) * self.before ** (0.4 / esdirk.ERROR_ORDER)
            )
            self.before = max(wrong, 1e-4)
            done = length if step == left else done + step
            if step == self.carry[0] or growth < 1:
                self.carry[0] = step * min(max(growth, 0.2), 6) if growth > KEPT_GROWTH or growth < 1 else step
            elif growth * step > self.carry[0]:
                self.carry[0] = min(growth, 6) * step
            if done >= length:
                return x, dx
            jacobian, is_fresh = (None if is_slow or self.kernel.is_fresh_each_step else jacobian), False
        return None

    def _solve_stages(
        self, x: np.ndarray, first: np.ndarray, step: float, inputs: list[np.ndarray], matrix: _Matrix
    ) -> tuple[list[np.ndarray] | None, list[np.ndarray], bool]:
        """Stages and rates, None where the iterations have no end; whether they were slow."""
        stages, rates, is_slow = [x], [first], False
        for s in range(1, esdirk.STAGES):
            base = x + step * (esdirk.TABLE[s, :s] @ np.array(rates))
            stage, last = base + matrix.scale * rates[-1], np.inf
            for iteration in range(MOST_ITERATIONS):
                moved = _solve(matrix, base + matrix.scale * self.rates(stage, inputs[s]) - stage)
                stage = stage + moved
                change = self.measure(moved, first, step)
                ratio = change / last
                if not change < np.inf or ratio > DIVERGING:
                    return None, rates, is_slow
                is_slow |= SLOW < ratio < np.inf
                rest = change * min(ratio / (1 - min(ratio, 0.9)), 1) if iteration else change / NEWTON_SHARE
                last = change
                if rest <= NEWTON_SHARE:
                    break
            else:
                return None, rates, is_slow
            stages.append(stage)
            rates.append((stage - base) / matrix.scale)
        return stages, rates, is_slow

    def _move_tangents(
        self,
        dx: np.ndarray,
        dfirst: np.ndarray,
        step: float,
        stages: list[np.ndarray],
        inputs: list[np.ndarray],
    ) -> tuple[np.ndarray, np.ndarray]:
        """The tangents at the end of a step, and those of the rate there."""
        slopes, scale = [dfirst], float(esdirk.GAMMA) * step
        for s in range(1, esdirk.STAGES):
            base = dx + step * np.tensordot(esdirk.TABLE[s, :s], np.array(slopes), 1)
            _, by_state, by_parameter = call_function(self.kernel._slopes, stages[s], inputs[s], self.arguments.p)
            # (I - h gamma J) dK = J V + df/dp dp, with J at the stage itself.
            along = by_state @ base + by_parameter @ self.arguments.dp
            slopes.append(_solve(_factorise(scale, by_state), along))
        return base + scale * slopes[-1], slopes[-1]


def _factorise(scale: float, jacobian: np.ndarray) -> _Matrix:
    from scipy.linalg import lu_factor

    return _Matrix(scale, lu_factor(np.eye(len(jacobian)) - scale * jacobian, check_finite=False))


def _solve(matrix: _Matrix, right: np.ndarray) -> np.ndarray:
    from scipy.linalg import lu_solve

    return lu_solve(matrix.factors, right, check_finite=False)
