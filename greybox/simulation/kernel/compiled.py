"""The compiled kernel: a step as C with tangents in vector registers.

A pass with gradient and Gauss-Newton matrix takes little longer than one simulation, and its memory does not grow with the record.
"""

from __future__ import annotations

import copy
import ctypes
from collections.abc import Collection
from dataclasses import replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from greybox.simulation.integrators.composition import as_coefficients
from greybox.simulation.integrators.step import Step
from greybox.simulation.kernel import interface
from greybox.simulation.kernel.c_compiler import choose_vector_width, load_library
from greybox.simulation.kernel.c_routine import CRoutine, read_template, refuse_unwritable
from greybox.simulation.kernel.record import Record, is_repeated
from greybox.simulation.kernel.tape import Tape, fuse_products, read_tape, simplify_tape

ADVANCE = ("x", "ua", "ub", "q", "h")
OUTPUTS = ("x", "u", "p")


class LibraryShape(NamedTuple):
    """What a library of a step has room for."""

    width: int
    blocks: int
    """Blocks of ``width`` directions; 0 is a simulation."""

    all_held: bool
    """Whether it takes held inputs only."""

    free: frozenset[int] | None
    """The parameters that have tangents, None for all."""


SIMULATION = LibraryShape(0, 0, False, None)
"""The library without tangents."""


class KernelFunctions(NamedTuple):
    """Functions of a compiled library: ``simulate`` of one without tangents, else ``sums``, and ``hold`` where the kernel computes the
    coefficients itself."""

    simulate: Any
    sums: Any
    hold: Any


class CompiledKernel:
    """Runs a step as compiled C; see `greybox.simulation.kernel.interface.Kernel` for the arguments.

    There is a library for simulation and one with tangents for each number of blocks of directions, and for held inputs; each is compiled
    when it is first asked for. ``free`` as in `greybox.simulation.kernel.make_kernel.make_kernel`. Raises CompilerError where it compiles.
    """

    name = "compiled"
    reason = "a C compiler is available"

    def __init__(self, step: Step, free: Collection[int] | None = None) -> None:
        self.step = step
        # Tangents of the other parameters are zero: a library without them takes a tenth less time, and half of that to compile.
        self._free = frozenset(free) if free is not None and step.coefficients is as_coefficients else None
        self.description = f"compiled C, {step.label}"
        self.sizes = interface.StepSizes.of(step)
        self._functions: dict[LibraryShape, KernelFunctions] = {}
        self._tapes: dict[frozenset[int] | None, tuple[Tape, Tape]] = {}

    def compile_simulation(self) -> None:
        """Compile the library of the simulation now. Raises CompilerError, and UnsupportedOperationError for an operation that C lacks."""
        self._get_functions(SIMULATION)

    def _get_functions(self, shape: LibraryShape) -> KernelFunctions:
        """The functions of a shape, compiled when first asked for."""
        if shape not in self._functions:
            library = load_library(lambda: self.source(shape), self._key(shape))
            self._functions[shape] = self._declare(library, shape)
        return self._functions[shape]

    def _key(self, shape: LibraryShape) -> str:
        """What `source` is made from, which takes longer to write than a library to load."""
        # Sorted: a set has no order, and the same library must have the same key.
        free = shape.free and sorted(shape.free)
        return f"{self._statement} {shape.width} {shape.blocks} {shape.all_held} {self._is_one_step} {free}"

    def _declare(self, library: ctypes.CDLL, shape: LibraryShape, leading: tuple[Any, ...] = ()) -> KernelFunctions:
        """The functions of a library, which take the types ``leading`` first."""
        numbers = (ctypes.c_int, ctypes.c_int)
        if not shape.blocks:
            return KernelFunctions(_declare(library.simulate, None, leading, numbers, 9), None, None)
        # Coefficients are asked for with directions, and the library of the simulation has no lanes to carry slopes
        # in.
        has_hold = self.step.generator is not None
        return KernelFunctions(
            None,
            _declare(library.sums, ctypes.c_long, leading, (*numbers, ctypes.c_int), 15),
            _declare(library.hold, None, leading, (), 5) if has_hold else None,
        )

    @cached_property
    def _statement(self) -> str:
        """The functions of the step, as CasADi writes them down."""
        known = (self.step.advance, self.step.outputs, self.step.generator)
        return " ".join("" if f is None else f.serialize() for f in known)

    def refuse_unsupported(self) -> None:
        """Raise UnsupportedOperationError for an operation that has no tangent rule or that C does not have."""
        for tape in self.read_tapes(LibraryShape(0, 0, False, self._free)).values():
            for kind, k in tape.order:
                if kind == "node":
                    refuse_unwritable(tape.nodes[k].op)

    def _read_tapes(self, free: frozenset[int] | None) -> tuple[Tape, Tape]:
        if free not in self._tapes:
            # Coefficients are input 3 of the step and input 2 of the outputs; for a step whose q is p both are numbered
            # alike.
            of_step, of_outputs = ({}, {}) if free is None else ({3: free}, {2: free})
            # Tangents come in by the state and the coefficients: inputs and interval lengths are given.
            advance = read_tape(self.step.advance, active=(0, 3), varying=(0, 1, 2), elements=of_step)
            outputs = read_tape(self.step.outputs, active=(0, 2), varying=(0, 1), elements=of_outputs)
            self._tapes[free] = fuse_products(simplify_tape(advance)), fuse_products(simplify_tape(outputs))
        return self._tapes[free]

    def read_tapes(self, shape: LibraryShape) -> dict[str, Tape]:
        """The tapes of a library by the names of their routines."""
        # A simulation leaves the tangents out, of whatever parameters they are.
        advance, outputs = self._read_tapes(shape.free if shape.blocks else self._free)
        tapes = {"advance": advance, "outputs": outputs}
        if shape.blocks and self.step.generator is not None:
            tapes["generator"] = fuse_products(simplify_tape(read_tape(self.step.generator, active=(0,), varying=(0,))))
        return tapes

    def source(self, shape: LibraryShape = SIMULATION) -> str:
        """The C text of a library."""
        tapes, blocks = self.read_tapes(shape), shape.blocks
        sizes = {"NX": self.sizes.nx, "NU": self.sizes.nu, "NQ": self.sizes.nq, "NY": self.sizes.ny}
        parts = [
            "/* Generated by greybox: one step of a model and the loop over a record. */",
            read_template("kernel.h"),
        ]
        parts += [f"#define {name} {size}" for name, size in sizes.items()]
        if blocks:
            # Sizes as constants of the text: loops over lanes and states are unrolled by the compiler.
            parts += [f"#define W {shape.width}", f"#define NB {blocks}", read_template("lanes.h")]
            parts.append(f"#define ALL_HELD {int(shape.all_held)}")
            parts.append(f"#define SUBSTEPS {1 if self._is_one_step else 'substeps'}")
        parts.append(CRoutine("advance", tapes["advance"], ADVANCE, (0, 3), blocks).text())
        parts.append(CRoutine("outputs", tapes["outputs"], OUTPUTS, (0, 2), blocks).text())
        parts.append(read_template("sums.c" if blocks else "simulate.c"))
        if "generator" in tapes:
            parts.append(CRoutine("generator", tapes["generator"], ("p",), (0,), blocks).text())
            parts.append(read_template("exact_hold.c"))
        return "\n".join(parts)

    def with_substeps(self, substeps: int) -> CompiledKernel:
        """The same step with another number of substeps in an interval; nothing is compiled anew."""
        # Libraries are shared: the number of substeps is an argument of theirs.
        other = copy.copy(self)
        other.step = replace(self.step, substeps=substeps)
        other.description = f"compiled C, {other.step.label}"
        # Only where the count of substeps is written into the text as a constant; else it is an argument, and the
        # library serves both.
        if self._is_one_step or other._is_one_step:
            other._forget_functions()  # the number of substeps is a constant there
        return other

    def _forget_functions(self) -> None:
        self._functions = {}

    @property
    def _is_one_step(self) -> bool:
        """Whether an interval is always one step, as the exact hold takes it."""
        return self.step.per_interval and self.step.substeps == 1

    def coefficients(self, record: Record, p: np.ndarray, dp: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Coefficients (rows, nq) of the step at ``p`` (np,), and their slopes (rows, nq, L) along ``dp`` (np, L)."""
        if self.step.generator is None:
            return interface.chain_coefficients(self.step, record.lengths, p, dp)
        directions, rows = dp.shape[1], len(record.lengths)
        p, dp = (np.ascontiguousarray(a, dtype=np.float64) for a in (p, _pad_directions(dp)))
        q, dq = np.empty((rows, self.sizes.nq)), np.empty((rows, self.sizes.nq, _count_padded(directions)))
        self._get_functions(_choose_shape(directions, record.all_held, None)).hold(
            rows, *map(_get_address, (record.lengths, p, dp, q, dq))
        )
        return q, np.ascontiguousarray(dq[:, :, :directions])

    def simulate(self, record: Record, q: np.ndarray, p: np.ndarray, x0: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Outputs (N, ny) and states (N, nx); not finite from where the simulation overflows."""
        arguments = interface.check_arguments(self.sizes, record, q, None, p, None, x0, None)
        y, x = np.empty((len(record.y), self.sizes.ny)), np.empty((len(record.y), self.sizes.nx))
        self._get_functions(SIMULATION).simulate(
            *self._leading_arguments(record, len(y)),
            *map(
                _get_address,
                (record.is_linear, record.u, record.h, arguments.row, arguments.q, arguments.p, arguments.x0, y, x),
            ),
        )
        return y, x

    def sums(
        self, record: Record, point: interface.KernelPoint, weight: np.ndarray, rows: int | None = None
    ) -> interface.GaussNewtonSums:
        """Cost, gradient and Gauss-Newton matrix over the first ``rows`` samples (None: all)."""
        arguments = interface.check_arguments(self.sizes, record, *point, weight)
        samples = len(record.y) if rows is None else min(rows, len(record.y))
        ny, directions, padded = self.sizes.ny, arguments.directions, _count_padded(arguments.directions)
        # One array for squares, counts, J'r and J'J: one address to hand over.
        results = np.zeros(2 * ny + padded + padded * padded)
        failed_at = self._run_pass(record, samples, arguments, (results, None, None))
        gradient, matrix = (
            results[2 * ny : 2 * ny + directions],
            results[2 * ny + padded :].reshape(padded, padded)[:directions, :directions],
        )
        return interface.check_sums(
            results[:ny], results[ny : 2 * ny], gradient, matrix, None if failed_at < 0 else failed_at, samples
        )

    def residuals(
        self, record: Record, point: interface.KernelPoint, weight: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Residuals (N, ny) and their Jacobian (N, ny, L), NaN in gaps and from where the simulation overflows."""
        arguments = interface.check_arguments(self.sizes, record, *point, weight)
        samples = len(record.y)
        r, jacobian = (
            np.full((samples, self.sizes.ny), np.nan),
            np.full((samples, self.sizes.ny, arguments.directions), np.nan),
        )
        self._run_pass(record, samples, arguments, (None, r, jacobian))
        return r, jacobian

    def _run_pass(
        self, record: Record, samples: int, arguments: interface.KernelArguments, results: tuple[np.ndarray | None, ...]
    ) -> int:
        """One pass over the first ``samples`` samples; the first sample that failed, or -1."""
        arrays = (
            record.is_linear,
            record.u,
            record.y,
            record.h,
            arguments.row,
            arguments.q,
            _pad_directions(arguments.dq),
            arguments.p,
            _pad_directions(arguments.dp),
            arguments.x0,
            _pad_directions(arguments.dx0),
            arguments.weight,
        )
        # A direction along a parameter outside of ``free`` would have lost its tangent: such a pass takes the
        # library with all of them.
        is_free = self._free is not None and self._free.issuperset(np.flatnonzero(arguments.dp.any(axis=1)).tolist())
        # Directions in whole blocks: a fit of 5 and one of 7 constants share a library of 8.
        shape = _choose_shape(arguments.directions, record.all_held, self._free if is_free else None)
        return self._get_functions(shape).sums(
            *self._leading_arguments(record, samples), arguments.directions, *map(_get_address, (*arrays, *results))
        )

    def _leading_arguments(self, record: Record, n: int) -> tuple[Any, ...]:
        return n, self.step.substeps, is_repeated(record.h)


def _declare(function: Any, result: Any, leading: tuple[Any, ...], numbers: tuple[Any, ...], arrays: int) -> Any:
    """A function ``(leading ..., length, numbers ..., arrays ...)`` of a library with its types declared."""
    function.argtypes = (*leading, ctypes.c_long, *numbers, *[ctypes.c_void_p] * arrays)
    function.restype = result
    return function


def _choose_shape(directions: int, all_held: bool, free: frozenset[int] | None) -> LibraryShape:
    width = choose_vector_width(directions)
    return LibraryShape(width, _count_padded(directions) // width, all_held, free)


def _count_padded(directions: int) -> int:
    """Room for the directions in whole blocks, at least one."""
    width = choose_vector_width(directions)
    return max(1, -(-directions // width)) * width


def _pad_directions(array: np.ndarray) -> np.ndarray:
    """Directions (last axis) filled up with zeros to whole blocks."""
    directions = array.shape[-1]
    if directions == _count_padded(directions):
        return array
    padded = np.zeros((*array.shape[:-1], _count_padded(directions)))
    padded[..., :directions] = array
    return padded


def _get_address(array: np.ndarray | None) -> int | None:
    """Where the numbers of an array begin; a pass asks for some fifteen, and the short way takes a quarter of the time."""
    if array is None:
        return None
    if array.size and array.flags.carray and not is_repeated(array):
        return ctypes.addressof(ctypes.c_char.from_buffer(array))  # type: ignore[arg-type]
    return array.__array_interface__["data"][0]  # empty, or not to be written
