"""All samples of an experiment with sensitivities in one call: compiled where there is a C compiler, else interpreted."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Collection
from functools import lru_cache
from typing import Any

import numpy as np

from greybox.base import GreyboxError
from greybox.simulation.integrators.step import MANY_STATES, Step
from greybox.simulation.kernel.adaptive import AdaptiveKernel
from greybox.simulation.kernel.c_compiler import CompilerError, GreyboxWarning, NoCompilerError
from greybox.simulation.kernel.compiled import CompiledKernel
from greybox.simulation.kernel.gradual import GradualKernel
from greybox.simulation.kernel.interface import GaussNewtonSums, Kernel
from greybox.simulation.kernel.interpreted import InterpretedKernel
from greybox.simulation.kernel.linear import LinearKernel
from greybox.simulation.kernel.record import Record
from greybox.simulation.kernel.tape import UnsupportedOperationError

# A kernel that goes on interpreted where the compiler or the disk fails, whichever library it is that cannot be had.


class FallbackKernel:
    """The compiled kernel until one of its libraries cannot be made, from then on the interpreted one.

    A kernel has several libraries, and the larger ones are compiled in the middle of a fit; see
    `greybox.simulation.kernel.interface.Kernel` for the methods.

    Parameters
    ----------
    compiled
        The kernel whose first library there is.
    on_failure
        Called once with what went wrong.
    """

    def __init__(
        self, compiled: CompiledKernel, on_failure: Callable[[CompilerError | UnsupportedOperationError], None]
    ):
        self._kernel: Kernel = compiled
        self._on_failure = on_failure

    @property
    def name(self) -> str:
        """The name of the kernel at work."""
        return self._kernel.name

    @property
    def description(self) -> str:
        """What the kernel at work is."""
        return self._kernel.description

    @property
    def reason(self) -> str:
        """Why it is the one."""
        return self._kernel.reason

    def with_substeps(self, substeps: int) -> Kernel:
        """The same step with another number of substeps in an interval."""
        kernel = self._kernel.with_substeps(substeps)
        return FallbackKernel(kernel, self._on_failure) if isinstance(kernel, CompiledKernel) else kernel

    def coefficients(self, record: Record, p: np.ndarray, dp: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Coefficients (rows, nq) of the step at ``p`` (np,), and their slopes (rows, nq, L) along ``dp`` (np, L)."""
        return self._call("coefficients", record, p, dp)

    def simulate(self, record: Record, q: np.ndarray, p: np.ndarray, x0: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Outputs (N, ny) and states (N, nx); not finite from where the simulation overflows."""
        return self._call("simulate", record, q, p, x0)

    def sums(self, *arguments: Any, **options: Any) -> GaussNewtonSums:
        """Cost, gradient and Gauss-Newton matrix."""
        return self._call("sums", *arguments, **options)

    def residuals(self, *arguments: Any, **options: Any) -> tuple[np.ndarray, np.ndarray]:
        """Residuals (N, ny) and their Jacobian (N, ny, L)."""
        return self._call("residuals", *arguments, **options)

    def _call(self, method: str, *arguments: Any, **options: Any) -> Any:
        kernel = self._kernel
        if isinstance(kernel, CompiledKernel):
            try:
                return getattr(kernel, method)(*arguments, **options)
            except (CompilerError, UnsupportedOperationError) as error:
                self._on_failure(error)
                # For good: the next library would fail by the same compiler or disk.
                self._kernel = InterpretedKernel(kernel.step, str(error))
        return getattr(self._kernel, method)(*arguments, **options)


# What was reported already: one warning a process is enough, for the compiler and for each operation that C does not have.
_warned: set[str] = set()


def make_kernel(step: Step, free: Collection[int] | None = None) -> Kernel:
    """The fastest kernel that works on this machine.

    The environment variable ``GREYBOX_KERNEL`` forces ``compiled`` or ``interpreted``. Without a C compiler the interpreted kernel is
    taken silently; a compiler or a disk that fails, for this kernel or for a larger library that a fit needs later, is reported once,
    as a GreyboxWarning, and the kernel goes on interpreted.

    Parameters
    ----------
    step
        The discrete step to run over records.
    free
        Numbers of the parameters that directions move, None for any. Directions that move others are allowed, but take a second
        compilation.

    Returns
    -------
    Kernel
        Its ``reason`` says why it is the one.

    Raises
    ------
    CompilerError, UnsupportedOperationError
        If ``compiled`` is forced and impossible.
    UnsupportedOperationError
        If neither kernel knows an operation.
    GreyboxError
        If ``GREYBOX_KERNEL`` names no kernel.
    """
    which = None if free is None else tuple(sorted(set(map(int, free))))
    if step.adaptive is not None:
        return _make_adaptive(step, which)
    forced = os.environ.get("GREYBOX_KERNEL", "")
    if forced not in ("", "compiled", "interpreted"):
        raise GreyboxError(f"GREYBOX_KERNEL={forced}: no such kernel; set it to compiled or interpreted, or unset it")
    if forced == "interpreted":
        return InterpretedKernel(step, "GREYBOX_KERNEL=interpreted")
    if not forced and step.regressors is not None and step.advance.size1_in(0) >= MANY_STATES:
        return _make_linear(step)
    try:
        # Forced, the simulation is compiled before anything runs; else the machine begins at once.
        make = _make_compiled if forced == "compiled" else _make_fallback
        return make(step, which)
    except (CompilerError, UnsupportedOperationError) as error:
        if forced == "compiled":
            raise
        _warn_once(error)
        return InterpretedKernel(step, str(error))


# These are for the next fit with the same step.
_make_linear = lru_cache(maxsize=64)(LinearKernel)
_make_adaptive = lru_cache(maxsize=64)(AdaptiveKernel)


@lru_cache(maxsize=64)
def _make_compiled(step: Step, free: tuple[int, ...] | None) -> CompiledKernel:
    kernel = CompiledKernel(step, free)
    kernel.compile_simulation()
    return kernel


@lru_cache(maxsize=256)
def _make_fallback(step: Step, free: tuple[int, ...] | None) -> FallbackKernel:
    return FallbackKernel(GradualKernel(step, free, _warn_once), _warn_once)


def _warn_once(error: CompilerError | UnsupportedOperationError) -> None:
    kind = "compiler" if isinstance(error, CompilerError) else str(error)
    if kind not in _warned and not isinstance(error, NoCompilerError):
        _warned.add(kind)
        warnings.warn(f"{error}; fits run without compiled code, many times slower", GreyboxWarning, stacklevel=3)
