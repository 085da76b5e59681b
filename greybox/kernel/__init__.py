"""All samples of an experiment with sensitivities in one call: compiled where there is a C compiler, else interpreted."""

from __future__ import annotations

import os
import warnings
from collections.abc import Collection
from functools import lru_cache

from greybox.errors import GreyboxError
from greybox.integrators.step import Step
from greybox.kernel.c_compiler import CompilerError, GreyboxWarning, NoCompilerError
from greybox.kernel.compiled import CompiledKernel
from greybox.kernel.fallback import FallbackKernel
from greybox.kernel.gradual import GradualKernel
from greybox.kernel.interface import GaussNewtonSums, Kernel
from greybox.kernel.interpreted import InterpretedKernel
from greybox.kernel.record import Record
from greybox.kernel.tape import UnsupportedOperationError

__all__ = [
    "CompiledKernel",
    "CompilerError",
    "GaussNewtonSums",
    "GreyboxWarning",
    "InterpretedKernel",
    "Kernel",
    "Record",
    "UnsupportedOperationError",
    "make_kernel",
]

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
    forced = os.environ.get("GREYBOX_KERNEL", "")
    if forced not in ("", "compiled", "interpreted"):
        raise GreyboxError(f"GREYBOX_KERNEL={forced}: no such kernel; set it to compiled or interpreted, or unset it")
    if forced == "interpreted":
        return InterpretedKernel(step, "GREYBOX_KERNEL=interpreted")
    try:
        make = _make_compiled if forced == "compiled" else _make_fallback
        return make(step, None if free is None else tuple(sorted(set(map(int, free)))))
    except (CompilerError, UnsupportedOperationError) as error:
        if forced == "compiled":
            raise
        _warn_once(error)
        return InterpretedKernel(step, str(error))


@lru_cache(maxsize=64)  # for the next fit with the same step
def _make_compiled(step: Step, free: tuple[int, ...] | None) -> CompiledKernel:
    kernel = CompiledKernel(step, free)
    kernel.compile_simulation()
    return kernel


@lru_cache(maxsize=64)
def _make_fallback(step: Step, free: tuple[int, ...] | None) -> FallbackKernel:
    return FallbackKernel(GradualKernel(step, free, _warn_once), _warn_once)


def _warn_once(error: CompilerError | UnsupportedOperationError) -> None:
    kind = "compiler" if isinstance(error, CompilerError) else str(error)
    if kind not in _warned and not isinstance(error, NoCompilerError):
        _warned.add(kind)
        warnings.warn(f"{error}; fits run without compiled code, many times slower", GreyboxWarning, stacklevel=3)
