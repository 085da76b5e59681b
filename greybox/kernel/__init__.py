"""All samples of an experiment with sensitivities in one call: compiled where there is a C compiler, interpreted
elsewhere."""

from __future__ import annotations

import os
import warnings
from functools import lru_cache

from greybox.errors import GreyboxError
from greybox.integrators.step import Step
from greybox.kernel.c_compiler import CompilerError, GreyboxWarning
from greybox.kernel.compiled import CompiledKernel
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

# Kernels that are kept, for the next fit with the same step.
KEPT = 64

_warned: set[str] = set()


def make_kernel(step: Step) -> Kernel:
    """The fastest kernel that works here; ``kernel.reason`` says why it is the one.

    The environment variable ``GREYBOX_KERNEL`` forces ``compiled`` or ``interpreted``. A compiler that fails is
    reported once, as a GreyboxWarning, and the interpreted kernel takes over. Raises CompilerError or
    UnsupportedOperationError only if ``compiled`` is forced and impossible, UnsupportedOperationError if neither kernel
    knows an operation.
    """
    wanted = os.environ.get("GREYBOX_KERNEL", "")
    if wanted not in ("", "compiled", "interpreted"):
        raise GreyboxError(f"GREYBOX_KERNEL={wanted}: no such kernel; set it to compiled or interpreted, or unset it")
    if wanted == "interpreted":
        return InterpretedKernel(step, "GREYBOX_KERNEL=interpreted")
    try:
        return _compiled(step)
    except (CompilerError, UnsupportedOperationError) as error:
        if wanted == "compiled":
            raise
        reason = str(error)
    if reason not in _warned and not reason.startswith("no C compiler"):
        _warned.add(reason)
        warnings.warn(f"{reason}; fits run without compiled code, many times slower", GreyboxWarning, stacklevel=2)
    return InterpretedKernel(step, reason)


@lru_cache(maxsize=KEPT)
def _compiled(step: Step) -> CompiledKernel:
    return CompiledKernel(step)
