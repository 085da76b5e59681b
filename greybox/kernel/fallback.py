"""A kernel that goes on interpreted where the compiler or the disk fails, whichever library it is that cannot be had."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from greybox.kernel.c_compiler import CompilerError
from greybox.kernel.compiled import CompiledKernel
from greybox.kernel.interface import GaussNewtonSums, Kernel
from greybox.kernel.interpreted import InterpretedKernel
from greybox.kernel.record import Record
from greybox.kernel.tape import UnsupportedOperationError


class FallbackKernel:
    """The compiled kernel until one of its libraries cannot be made, from then on the interpreted one.

    A kernel has several libraries, and the larger ones are compiled in the middle of a fit; see `greybox.kernel.interface.Kernel`
    for the methods.

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
                self._kernel = InterpretedKernel(kernel.step, str(error))
        return getattr(self._kernel, method)(*arguments, **options)
