"""A kernel that never waits for the compiler: the tape machine runs a structure until it has earned a library of its own.

A search looks at some fifty structures, and most of them for a few passes: those are over before a compiler would be done. Machine and
libraries give the same bits, so it does not matter to a result when one takes over from the other.
"""

from __future__ import annotations

import ctypes
import hashlib
import threading
import time
from collections.abc import Callable, Collection
from typing import Any, NamedTuple

from greybox.integrators.step import Step
from greybox.kernel.c_compiler import CompilerError, find_library, load_library
from greybox.kernel.compiled import CompiledKernel, KernelFunctions, LibraryShape
from greybox.kernel.policy import GRADUAL_POLICY, GradualPolicy
from greybox.kernel.tape_machine import TapeMachine, block_width, load_machine

_compiler_is_busy = threading.Lock()


class LibraryOrder:
    """A library that is there already, or that is compiled in the background once it was earned.

    Parameters
    ----------
    key, is_quick
        What the library is made from, and how, as for `greybox.kernel.c_compiler.load_library`.
    """

    def __init__(self, key: str, is_quick: bool) -> None:
        self.key, self.is_quick = key, is_quick
        self.library: ctypes.CDLL | None = find_library(key, is_quick)
        self.error: CompilerError | None = None
        self.seconds = 0.0
        """What was spent on its work without it."""
        self._is_placed = False

    def place(self, source: Callable[[], str]) -> None:
        """Compile in the background, unless another library is being compiled: then the next pass asks again."""
        if self._is_placed or not _compiler_is_busy.acquire(blocking=False):
            return
        self._is_placed = True
        text = source()
        threading.Thread(target=self._compile, args=(text,), daemon=True).start()

    def _compile(self, text: str) -> None:
        try:
            self.library = load_library(lambda: text, self.key, self.is_quick)
        except CompilerError as error:
            self.error = error
        finally:
            _compiler_is_busy.release()


_orders: dict[tuple[str, bool], LibraryOrder] = {}


def _find_order(key: str, is_quick: bool) -> LibraryOrder:
    """The order of this process for what ``key`` says."""
    name = hashlib.sha256(key.encode(errors="backslashreplace")).hexdigest(), is_quick
    if name not in _orders:
        _orders[name] = LibraryOrder(key, is_quick)
    return _orders[name]


class _Course(NamedTuple):
    """How one shape comes to its library."""

    machine: TapeMachine
    by_machine: KernelFunctions
    quick: LibraryOrder
    """What the machine works for."""

    full: LibraryOrder
    """What the quick one works for; the same where there is no quick one."""


class GradualKernel(CompiledKernel):
    """The tape machine, and compiled C from where that pays; see `greybox.kernel.interface.Kernel` for the arguments.

    Parameters
    ----------
    step
        The discrete step to run over records.
    free
        As in `greybox.kernel.make_kernel`.
    on_failure
        Called with what went wrong where a library cannot be compiled; the machine then stays.
    policy
        When a structure has earned its libraries.

    Raises
    ------
    CompilerError
        If the machine itself cannot be compiled.
    UnsupportedOperationError
        For an operation that C does not have.
    """

    def __init__(
        self,
        step: Step,
        free: Collection[int] | None,
        on_failure: Callable[[CompilerError], None],
        policy: GradualPolicy = GRADUAL_POLICY,
    ) -> None:
        super().__init__(step, free)
        self._on_failure, self._policy = on_failure, policy
        self._courses: dict[LibraryShape, _Course] = {}
        load_machine()
        self.refuse_unsupported()

    def _forget_functions(self) -> None:
        super()._forget_functions()
        self._courses = {}

    def _get_functions(self, shape: LibraryShape) -> KernelFunctions:
        if shape in self._functions:
            return self._functions[shape]
        course = self._find_course(shape)
        if course.full.library is not None:
            self._functions[shape] = self._declare(course.full.library, shape)
            return self._functions[shape]
        if course.quick.library is not None:
            return self._run_quick(shape, course)
        return self._run_by_machine(shape, course)

    def _run_quick(self, shape: LibraryShape, course: _Course) -> KernelFunctions:
        """The functions of the quick library; what they take counts towards the full one."""
        if course.full.seconds > self._policy.full_seconds:
            course.full.place(lambda: self.source(shape))
        functions = self._declare(course.quick.library, shape)  # type: ignore[arg-type]
        return _count_seconds(functions, course.full)

    def _run_by_machine(self, shape: LibraryShape, course: _Course) -> KernelFunctions:
        """The functions of the machine; what they take counts towards a library."""
        order, policy = course.quick, self._policy
        if order.error is not None:
            error, order.error = order.error, None
            self._on_failure(error)
        if order.seconds > policy.earned_seconds:
            order.place(lambda: self.source(shape))
        if course.machine.scratch_bytes > policy.largest_scratch_bytes:
            return self._load(shape)
        functions = _count_seconds(course.by_machine, order, (course.machine.address,))

        def sums(rows: int, *arguments: Any) -> int:
            if rows * self.step.substeps * course.machine.instructions > policy.most_instructions:
                self._functions[shape] = self._load(shape)
                return self._functions[shape].sums(rows, *arguments)
            return functions.sums(rows, *arguments)

        return functions._replace(sums=sums)

    def _find_course(self, shape: LibraryShape) -> _Course:
        if shape not in self._courses:
            sizes = {"nx": self.sizes.nx, "nu": self.sizes.nu, "nq": self.sizes.nq, "ny": self.sizes.ny}
            blocks = shape.blocks * shape.width // block_width()
            machine, key = TapeMachine(sizes | {"nb": blocks}, self.read_tapes(shape)), self._key(shape)
            full = _find_order(key, is_quick=False)
            # The exact hold is a few lines in a loop: it wants the loop well compiled, and that takes no longer.
            quick = full if self.step.per_interval else _find_order(key, is_quick=True)
            by_machine = self._declare(machine.library, shape, (ctypes.c_void_p,))
            self._courses[shape] = _Course(machine, by_machine, quick, full)
        return self._courses[shape]


def _count_seconds(functions: KernelFunctions, order: LibraryOrder, leading: tuple[int, ...] = ()) -> KernelFunctions:
    """``functions`` with the arguments ``leading`` in front, whose seconds count towards ``order``."""

    def count(function: Any) -> Any:
        def run(*arguments: Any) -> Any:
            began = time.perf_counter()
            result = function(*leading, *arguments)
            order.seconds += time.perf_counter() - began
            return result

        return run

    return KernelFunctions(*(None if f is None else count(f) for f in functions))
