"""A kernel that never waits for the compiler: the tape machine runs a structure until it has earned a library of its own.

A search looks at some fifty structures, and most of them for a few passes: those are over before a compiler would be done. Machine and
libraries give the same bits, so it does not matter to a result when one takes over from the other.
"""

from __future__ import annotations

import ctypes
import hashlib
import os
import threading
import time
from collections.abc import Callable, Collection
from dataclasses import dataclass
from enum import Enum
from typing import Any, NamedTuple

from greybox.simulation.integrators.step import Step
from greybox.simulation.kernel.c_compiler import (
    CompilerBudgetError,
    CompilerError,
    find_library,
    find_wasted_seconds,
    forget_wasted_seconds,
    load_library,
    note_wasted_seconds,
)
from greybox.simulation.kernel.compiled import CompiledKernel, KernelFunctions, LibraryShape
from greybox.simulation.kernel.llvm_routine import has_llvm
from greybox.simulation.kernel.tape_machine import TapeMachine, block_width, load_machine


@dataclass(frozen=True)
class GradualPolicy:
    """When a structure that the tape machine runs has earned a library of its own."""

    earned_seconds: float = 0.1
    """Seconds that the machine spends on a library's work before the library is compiled, quickly: half of what that takes, on another
    core if there is one. Most structures of a search never spend so much."""
    translated_seconds: float = 0.02
    """The same where LLVM is installed, which takes 30 to 100 ms."""
    most_translated: int = 64
    """Steps whose translated routines a process keeps for a kernel that comes again; beyond, those that were used longest ago go. Each
    takes about 1 MB, a search makes twenty to fifty, and without a limit a process that searches all day fills the memory."""
    full_seconds: float = 0.5
    """Seconds in what was compiled quickly before it is compiled with all optimisation, in the background: half a second, for code that
    takes a tenth to a half less time and is there when the same model comes again."""
    long_pass_seconds: float = 0.25
    """Seconds that the machine would take for one pass from which a library is ordered before the pass has run."""


GRADUAL_POLICY = GradualPolicy()


class CompilerKind(Enum):
    """How code is made, by rising effort."""

    TRANSLATED = "by LLVM, for the loops of the machine"
    QUICK = "by the C compiler with few optimisations"
    FULL = "by the C compiler with all of them"


# Seconds that the machine takes for an instruction, tangents included: measured with 1 to 16 directions.
SECONDS_OF_INSTRUCTION = 2.5e-9
# Seconds that each way to code takes for an instruction of the machine with one block of tangents: chains of 3 to 25 nonlinear springs, 26
# directions at most. Work of a model begins to be compiled when it has taken as long as that will.
COMPILER_SECONDS = {CompilerKind.TRANSLATED: 4e-5, CompilerKind.QUICK: 1e-4, CompilerKind.FULL: 2e-4}
# Share of a pass by the machine for which its library is waited for: the two together take at most half as long again.
WAITED_SHARE = 0.5


# One compilation at a time in a process: a second one would take the core on which the search runs.
_compiler_is_busy = threading.Lock()


class CompilerOrder:
    """What a compiler has made already, or makes in the background once it was earned.

    Parameters
    ----------
    result
        What is there: a library, or a machine whose routines are translated.
    """

    def __init__(self, result: Any = None) -> None:
        self.result = result
        self.error: CompilerError | None = None
        self.seconds = 0.0
        """What was spent on its work without it."""
        self._is_placed, self._is_done = False, threading.Event()

    def place(self, prepare: Callable[[], Callable[[], Any]], key: str, kind: str) -> None:
        """Let another thread run what ``prepare`` gives, unless one is at work already: then the next pass asks again.

        Until it is done, ``key`` and ``kind`` count as made in vain: the program may end before.
        """
        if self._is_placed or not _compiler_is_busy.acquire(blocking=False):
            return
        self._is_placed = True
        note_wasted_seconds(key, kind, self.seconds)
        # No daemon: the interpreter waits for the thread before it takes LLVM apart. The thread gives up by itself once the program ends
        # (`run_compiler`), so that this takes no longer than a short piece of machine code.
        threading.Thread(target=self._run, args=(prepare(), key, kind)).start()

    def wait(self, seconds: float) -> bool:
        """Wait for what was placed, and no longer; whether it is there."""
        if self._is_placed and self.result is None and self.error is None:
            self._is_done.wait(seconds)
        return self.result is not None

    def forget_thread(self) -> None:
        """Begin anew what is not there yet."""
        if self.result is None:
            self._is_placed, self._is_done = False, threading.Event()

    def _run(self, make: Callable[[], Any], key: str, kind: str) -> None:
        try:
            self.result = make()
            forget_wasted_seconds(key, kind)
        except CompilerBudgetError:  # what runs now goes on, with the same numbers
            self.result = None
        except CompilerError as error:
            self.error = error
        except RuntimeError:  # LLVM cannot, or not in the time and memory that it is given: the tape machine goes on, with the same numbers
            self.result = None
        finally:
            self._is_done.set()
            _compiler_is_busy.release()


_orders: dict[tuple[str, CompilerKind], CompilerOrder] = {}
"""The orders of this process, the ones that were used last at the end."""


def _find_order(key: str, kind: CompilerKind, policy: GradualPolicy) -> CompilerOrder:
    """The order of this process for what ``key`` says."""
    name = hashlib.sha256(key.encode(errors="backslashreplace")).hexdigest(), kind
    is_library = kind is not CompilerKind.TRANSLATED
    order = _orders.pop(name, None) or CompilerOrder(
        find_library(key, kind is CompilerKind.QUICK) if is_library else None
    )
    _orders[name] = order
    if not is_library:  # a library stays loaded until the process ends, whoever has forgotten it
        _forget_translated(policy.most_translated)
    return order


def _forget_translated(most: int) -> None:
    """Forget translated routines beyond ``most``, those that were used longest ago first; a kernel that works with one keeps it."""
    translated = [
        name
        for name, order in list(_orders.items())  # in one piece: other threads add to it
        if name[1] is CompilerKind.TRANSLATED and order.result is not None
    ]
    # The dictionary keeps the order of use: `_find_order` puts what is asked for at its end.
    for name in translated[: max(0, len(translated) - most)]:
        _orders.pop(name, None)


def _become_copy() -> None:
    """After `os.fork`, in the new process: the thread at work is the other one's, and what it makes may be ordered anew."""
    global _compiler_is_busy
    _compiler_is_busy = threading.Lock()
    for order in _orders.values():
        order.forget_thread()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_become_copy)


class _Course(NamedTuple):
    """How one shape comes to its library."""

    machine: TapeMachine
    by_machine: KernelFunctions
    kind: CompilerKind
    """What the machine works for."""

    order: CompilerOrder
    full: CompilerOrder
    """What comes after that; the same where nothing does."""


class GradualKernel(CompiledKernel):
    """The tape machine, and compiled C from where that pays; see `greybox.simulation.kernel.interface.Kernel` for the arguments.

    Parameters
    ----------
    step
        The discrete step to run over records.
    free
        As in `greybox.simulation.kernel.make_kernel.make_kernel`.
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
        # The best there is, and for good: later passes do not look any more.
        if course.full.result is not None:
            self._functions[shape] = self._declare(course.full.result, shape)
            return self._functions[shape]
        if course.order.result is not None:
            return self._run_quick(shape, course)
        return self._run_by_machine(shape, course)

    def _run_quick(self, shape: LibraryShape, course: _Course) -> KernelFunctions:
        """What was made with little effort; what it takes counts towards the full library."""
        if course.full.seconds > self._earned_seconds(course, CompilerKind.FULL):
            self._place(course.full, CompilerKind.FULL, shape)
        result = course.order.result
        if isinstance(result, TapeMachine):
            return _count_seconds(self._declare_machine(result, shape), course.full, (result.address,))
        # What the quick library spends is what a better one could save.
        return _count_seconds(self._declare(result, shape), course.full)

    def _run_by_machine(self, shape: LibraryShape, course: _Course) -> KernelFunctions:
        """The functions of the machine; what they take counts towards compiled code."""
        order, policy = course.order, self._policy
        # Told once; the machine goes on, and its time is counted no more towards a compilation that fails.
        if order.error is not None:
            error, order.error = order.error, None
            self._on_failure(error)
        earned = self._earned_seconds(course, course.kind)
        if order.seconds > earned:
            self._place(order, course.kind, shape)
        functions = _count_seconds(course.by_machine, order, (course.machine.address,))

        def sums(rows: int, *arguments: Any) -> int:
            # One pass may take longer than the compilation: it is begun at once, and waited for half as long as the machine would take.
            seconds = rows * self.step.substeps * course.machine.instructions * SECONDS_OF_INSTRUCTION
            if seconds > policy.long_pass_seconds and order.seconds + seconds > earned:
                self._place(order, course.kind, shape, seconds)
                if order.wait(WAITED_SHARE * seconds):
                    return self._get_functions(shape).sums(rows, *arguments)
            return functions.sums(rows, *arguments)

        return functions._replace(sums=sums)

    def _earned_seconds(self, course: _Course, kind: CompilerKind) -> float:
        """Seconds of its work after which a library is ordered: some, and as many as the compiler will take."""
        least = {
            CompilerKind.TRANSLATED: self._policy.translated_seconds,
            CompilerKind.QUICK: self._policy.earned_seconds,
            CompilerKind.FULL: self._policy.full_seconds,
        }[kind]
        return max(least, COMPILER_SECONDS[kind] * course.machine.length) if least else least

    def _place(self, order: CompilerOrder, kind: CompilerKind, shape: LibraryShape, ahead: float = 0.0) -> None:
        """Order a library whose work has taken ``order.seconds``, and takes ``ahead`` more; not one that took longer in vain before."""
        key = self._key(shape)
        if order.seconds + ahead < find_wasted_seconds(key, kind.value):
            return

        def prepare() -> Callable[[], Any]:
            if kind is CompilerKind.TRANSLATED:
                tapes = self.read_tapes(shape)
                return lambda: TapeMachine(self._machine_sizes(shape), tapes, is_translated=True)
            # Written here, in the thread of the search: CasADi's functions are not shared between threads.
            text = self.source(shape)
            return lambda: load_library(lambda: text, key, kind is CompilerKind.QUICK, is_background=True)

        order.place(prepare, key, kind.value)

    def _find_course(self, shape: LibraryShape) -> _Course:
        if shape not in self._courses:
            machine, key = TapeMachine(self._machine_sizes(shape), self.read_tapes(shape)), self._key(shape)
            # The exact hold is a few lines in a loop: it wants the loop well compiled, and that takes no longer.
            few = CompilerKind.FULL if self.step.per_interval else CompilerKind.QUICK
            # LLVM is done sooner than the quickest compilation of C.
            kind = CompilerKind.TRANSLATED if has_llvm() else few
            order, full = (_find_order(key, each, self._policy) for each in (kind, CompilerKind.FULL))
            self._courses[shape] = _Course(machine, self._declare_machine(machine, shape), kind, order, full)
        return self._courses[shape]

    def _machine_sizes(self, shape: LibraryShape) -> dict[str, int]:
        # The machine has one width for all models; the padding of directions is a multiple of it.
        blocks = shape.blocks * shape.width // block_width()
        return {"nx": self.sizes.nx, "nu": self.sizes.nu, "nq": self.sizes.nq, "ny": self.sizes.ny, "nb": blocks}

    def _declare_machine(self, machine: TapeMachine, shape: LibraryShape) -> KernelFunctions:
        return self._declare(machine.library, shape, (ctypes.c_void_p,))


def _count_seconds(functions: KernelFunctions, order: CompilerOrder, leading: tuple[int, ...] = ()) -> KernelFunctions:
    """``functions`` with the arguments ``leading`` in front, whose seconds count towards ``order``."""

    def count(function: Any) -> Any:
        def run(*arguments: Any) -> Any:
            began = time.perf_counter()
            result = function(*leading, *arguments)
            order.seconds += time.perf_counter() - began
            return result

        return run

    return KernelFunctions(*(None if f is None else count(f) for f in functions))
