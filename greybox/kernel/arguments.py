"""The arrays of a kernel call, checked: compiled code reads them without asking again."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from greybox.errors import DataError
from greybox.integrators.step import Step
from greybox.kernel.record import Record


@dataclass(frozen=True)
class StepSizes:
    """How many states, inputs, coefficients, parameters and outputs a step has."""

    nx: int
    nu: int
    nq: int
    np: int
    ny: int

    @staticmethod
    def of(step: Step) -> StepSizes:
        """The sizes of ``step``."""
        advance, outputs = step.advance, step.outputs
        return StepSizes(
            advance.size1_in(0), advance.size1_in(1), advance.size1_in(3), outputs.size1_in(2), outputs.size1_out(0)
        )


@dataclass(frozen=True, eq=False)
class KernelArguments:
    """A checked call; see `greybox.kernel.interface.Kernel`. ``row`` is None where one row of ``q`` serves every
    interval."""

    q: np.ndarray
    dq: np.ndarray
    p: np.ndarray
    dp: np.ndarray
    x0: np.ndarray
    dx0: np.ndarray
    weight: np.ndarray
    row: np.ndarray | None

    @property
    def directions(self) -> int:
        """Number of directions L."""
        return self.dx0.shape[1]


def check_arguments(
    sizes: StepSizes,
    record: Record,
    q: np.ndarray,
    p: np.ndarray,
    x0: np.ndarray,
    *,
    dq: np.ndarray | None = None,
    dp: np.ndarray | None = None,
    dx0: np.ndarray | None = None,
    weight: np.ndarray | None = None,
) -> KernelArguments:
    """The arguments as contiguous float64 arrays of the right shapes; None means no directions, weight one. Raises
    DataError."""
    directions = 0 if dx0 is None else np.shape(dx0)[-1]
    rows = len(q)
    if rows not in (1, len(record.lengths)):
        raise DataError(
            f"kernel: q has {rows} rows for {len(record.lengths)} interval lengths;"
            " give one row for each length, or one for all"
        )
    if record.u.shape[1] != sizes.nu or record.y.shape[1] != sizes.ny:
        raise DataError(
            f"kernel: the record has {record.u.shape[1]} inputs and {record.y.shape[1]} outputs,"
            f" the step {sizes.nu} and {sizes.ny}; build the record from the same model"
        )
    return KernelArguments(
        q=_array("q", q, (rows, sizes.nq)),
        dq=_array("dq", dq, (rows, sizes.nq, directions)),
        p=_array("p", p, (sizes.np,)),
        dp=_array("dp", dp, (sizes.np, directions)),
        x0=_array("x0", x0, (sizes.nx,)),
        dx0=_array("dx0", dx0, (sizes.nx, directions)),
        weight=_array("weight", np.ones(sizes.ny) if weight is None else weight, (sizes.ny,)),
        row=None if rows == 1 else record.row,
    )


def chain_coefficients(step: Step, lengths: np.ndarray, p: np.ndarray, dp: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients (rows, nq) of ``step`` at the parameters ``p`` (np,) and their slopes (rows, nq, L) along ``dp`` (np, L)."""
    which = np.flatnonzero(dp.any(axis=1))
    q, along = step.coefficients(p, lengths, which)
    return q, along @ dp[which]


def _array(name: str, values: np.ndarray | None, shape: tuple[int, ...]) -> np.ndarray:
    array = np.ascontiguousarray(np.zeros(shape) if values is None else values, dtype=np.float64)
    if array.shape != shape:
        raise DataError(f"kernel: {name} has shape {array.shape}, the step needs {shape}")
    return array
