"""What a kernel is: all samples of one experiment, with sensitivities, in one call."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from greybox.base import DataError
from greybox.simulation.integrators.step import Step
from greybox.simulation.kernel.record import Record


@dataclass(frozen=True, eq=False)
class GaussNewtonSums:
    """What a Gauss-Newton step needs of one experiment, along L directions.

    The residuals are ``r = (measured - y) * weight`` over the samples that were measured, and ``J = dr / d direction``.
    """

    cost: float
    """``r'r``."""

    gradient: np.ndarray
    """``J'r`` (L,), so that ``d cost / d direction = 2 J'r``."""

    gauss_newton: np.ndarray
    """``J'J`` (L, L)."""

    squares: np.ndarray
    """The squared residuals of each output (ny,), which add up to ``cost``."""

    counts: np.ndarray
    """How many samples of each output were used (ny,)."""

    failed_at: int | None = None
    """The first sample with a state or output that is not finite; then ``cost`` is infinite and the rest zero. The number of samples where
    the simulation went through and only a sensitivity did not."""


class KernelPoint(NamedTuple):
    """Where a kernel runs over a record, with slopes along L directions."""

    q: np.ndarray
    dq: np.ndarray
    """Coefficients of the step (rows, nq), one row for each entry of ``record.lengths`` or one row for all; their slopes (rows, nq, L)."""

    p: np.ndarray
    dp: np.ndarray
    """Parameters (np,) of the output equations and their slopes (np, L)."""

    x0: np.ndarray
    dx0: np.ndarray
    """Initial state (nx,) and its slopes (nx, L)."""


class Kernel(Protocol):
    """Runs one `Step` over a `Record`.

    ``weight`` (ny,) is one over the noise of each output; samples that are NaN in ``record.y`` are left out.
    """

    @property
    def name(self) -> str:
        """``compiled`` or ``interpreted``."""

    @property
    def description(self) -> str:
        """What it is, for people."""

    @property
    def reason(self) -> str:
        """Why it is the one."""

    def with_substeps(self, substeps: int) -> Kernel:
        """The same step with another number of substeps in an interval; nothing is compiled anew."""

    def coefficients(self, record: Record, p: np.ndarray, dp: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Coefficients (rows, nq) of the step at ``p`` (np,), and their slopes (rows, nq, L) along ``dp`` (np, L)."""

    def simulate(self, record: Record, q: np.ndarray, p: np.ndarray, x0: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Outputs (N, ny) and states (N, nx); not finite from where the simulation overflows."""

    def sums(self, record: Record, point: KernelPoint, weight: np.ndarray, rows: int | None = None) -> GaussNewtonSums:
        """Cost, gradient and Gauss-Newton matrix over the first ``rows`` samples (None: all)."""

    def residuals(self, record: Record, point: KernelPoint, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Residuals (N, ny) and their Jacobian (N, ny, L), NaN in gaps and from where the simulation overflows."""


def check_sums(
    squares: np.ndarray,
    counts: np.ndarray,
    gradient: np.ndarray,
    gauss_newton: np.ndarray,
    failed_at: int | None,
    samples: int,
) -> GaussNewtonSums:
    """The sums, or an infinite cost where anything was not finite."""
    # Numbers of Python overflow without a warning, and so few are summed up sooner than an array is.
    cost, size = float(sum(squares.tolist())), float(sum(gauss_newton.diagonal().tolist()))
    # |J'r|^2 is at most J'J r'r, and an entry of J'J at most the product of two on its diagonal.
    # One test for cost, gradient and matrix: the diagonal bounds the rest, see above.
    if failed_at is None and not math.isfinite(2 * (cost + size)):  # both are doubled later
        failed_at = samples
    if failed_at is not None:
        zero = np.zeros_like
        return GaussNewtonSums(np.inf, zero(gradient), zero(gauss_newton), zero(squares), zero(counts), failed_at)
    return GaussNewtonSums(cost, gradient, gauss_newton, squares, counts)


class RunningSums:
    """The sums of a record that comes in parts."""

    def __init__(self, outputs: int, directions: int) -> None:
        self.squares, self.counts = np.zeros(outputs), np.zeros(outputs)
        self.gradient, self.matrix = np.zeros(directions), np.zeros((directions, directions))

    def add(self, r: np.ndarray, jacobian: np.ndarray) -> None:
        """Residuals (n, ny) and their Jacobian (n, ny, L); a gap is a residual of NaN."""
        is_measured = np.isfinite(r)
        self.counts += is_measured.sum(axis=0)
        if is_measured.all():
            self.squares += np.square(r).sum(axis=0)
            r, jacobian = r.ravel(), jacobian.reshape(r.size, -1)
        else:
            # J'r and J'J over the measured entries: a gap is left out, not a zero that counts.
            self.squares += np.square(np.where(is_measured, r, 0.0)).sum(axis=0)
            r, jacobian = r[is_measured], jacobian[is_measured]
        self.gradient += jacobian.T @ r
        self.matrix += jacobian.T @ jacobian

    def check(self, failed_at: int | None, samples: int) -> GaussNewtonSums:
        """The sums over so many ``samples``, or an infinite cost; see `check_sums`."""
        return check_sums(self.squares, self.counts, self.gradient, self.matrix, failed_at, samples)


# The arrays of a kernel call, checked: compiled code reads them without asking again.


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
    """A checked call; see `greybox.simulation.kernel.interface.Kernel`. ``row`` is None where one row of ``q`` serves every
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
    dq: np.ndarray | None,
    p: np.ndarray,
    dp: np.ndarray | None,
    x0: np.ndarray,
    dx0: np.ndarray | None,
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
    # Slopes along parameters that no direction moves are not computed: dq = (dq/dp[which]) dp[which].
    which = np.flatnonzero(dp.any(axis=1))
    q, along = step.coefficients(p, lengths, which)
    return q, along @ dp[which]


class RecordPart(NamedTuple):
    """Samples ``start : start + len(y)``: states (n, nx), outputs (n, ny), and tangents (n, nx or ny, L) of the ones or the others."""

    start: int
    x: np.ndarray
    y: np.ndarray
    tangents: np.ndarray

    @property
    def failed_at(self) -> int | None:
        """The first sample with a state or output that is not finite."""
        is_bad = ~(np.isfinite(self.x).all(axis=1) & np.isfinite(self.y).all(axis=1))
        return self.start + int(np.argmax(is_bad)) if is_bad.any() else None


class KernelInParts(ABC):
    """A kernel that runs a record part by part: memory does not grow beyond one. See `Kernel` for the arguments."""

    step: Step
    sizes: StepSizes

    @abstractmethod
    def run_parts(self, record: Record, n: int, arguments: KernelArguments) -> Iterator[RecordPart]:
        """The first ``n`` samples of a record, each part begun where the one before ended."""

    @abstractmethod
    def linearise(self, record: Record, part: RecordPart, arguments: KernelArguments) -> tuple[np.ndarray, np.ndarray]:
        """Residuals (n, ny) of a part and their Jacobian (n, ny, L)."""

    def coefficients(self, record: Record, p: np.ndarray, dp: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Coefficients (rows, nq) of the step at ``p`` (np,), and their slopes (rows, nq, L) along ``dp`` (np, L)."""
        return chain_coefficients(self.step, record.lengths, p, dp)

    def simulate(self, record: Record, q: np.ndarray, p: np.ndarray, x0: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Outputs (N, ny) and states (N, nx); not finite from where the simulation overflows."""
        parts = list(
            self.run_parts(record, len(record.y), check_arguments(self.sizes, record, q, None, p, None, x0, None))
        )
        return np.concatenate([part.y for part in parts]), np.concatenate([part.x for part in parts])

    def sums(self, record: Record, point: KernelPoint, weight: np.ndarray, rows: int | None = None) -> GaussNewtonSums:
        """Cost, gradient and Gauss-Newton matrix over the first ``rows`` samples (None: all)."""
        arguments = check_arguments(self.sizes, record, *point, weight)
        samples, directions = len(record.y) if rows is None else min(rows, len(record.y)), arguments.directions
        totals, failed_at = RunningSums(self.sizes.ny, directions), None
        with np.errstate(all="ignore"):  # what is not finite is found and reported
            # J is never in memory as a whole, as in the compiled pass.
            for part in self.run_parts(record, samples, arguments):
                failed_at = part.failed_at
                if failed_at is not None:
                    break
                totals.add(*self.linearise(record, part, arguments))
        return totals.check(failed_at, samples)

    def residuals(self, record: Record, point: KernelPoint, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Residuals (N, ny) and their Jacobian (N, ny, L), NaN in gaps and from where the simulation overflows."""
        arguments = check_arguments(self.sizes, record, *point, weight)
        r = np.full(record.y.shape, np.nan)
        jacobian = np.full((*record.y.shape, arguments.directions), np.nan)
        with np.errstate(all="ignore"):  # what is not finite is left NaN
            for part in self.run_parts(record, len(record.y), arguments):
                failed_at = part.failed_at
                # What was computed before the failure is good.
                end = part.start + len(part.y) if failed_at is None else failed_at
                kept = slice(part.start, end)
                of_part = self.linearise(record, part, arguments)
                r[kept], jacobian[kept] = (values[: end - part.start] for values in of_part)
                jacobian[kept][np.isnan(r[kept])] = np.nan  # a gap has no residual, hence no slope that could be summed
                if failed_at is not None:
                    break
        return r, jacobian


def _array(name: str, values: np.ndarray | None, shape: tuple[int, ...]) -> np.ndarray:
    # Compiled code reads them by address: order and type have to be what it expects.
    array = np.ascontiguousarray(np.zeros(shape) if values is None else values, dtype=np.float64)
    if array.shape != shape:
        raise DataError(f"kernel: {name} has shape {array.shape}, the step needs {shape}")
    return array
