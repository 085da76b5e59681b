"""What a kernel is: all samples of one experiment, with sensitivities, in one call."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from greybox.kernel.record import Record


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


class Kernel(Protocol):
    """Runs one `Step` over a `Record`.

    Arguments: coefficients ``q`` (rows, nq), one row for each entry of ``record.lengths`` or one row for all;
    parameters ``p`` (np,) of the output equations; first state ``x0`` (nx,). Their derivatives along L directions:
    ``dq`` (rows, nq, L), ``dp`` (np, L), ``dx0`` (nx, L). ``weight`` (ny,) is one over the noise of each output;
    samples that are NaN in ``record.y`` are left out.
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

    def sums(
        self,
        record: Record,
        q: np.ndarray,
        dq: np.ndarray,
        p: np.ndarray,
        dp: np.ndarray,
        x0: np.ndarray,
        dx0: np.ndarray,
        weight: np.ndarray,
        rows: int | None = None,
    ) -> GaussNewtonSums:
        """Cost, gradient and Gauss-Newton matrix over the first ``rows`` samples (None: all)."""

    def residuals(
        self,
        record: Record,
        q: np.ndarray,
        dq: np.ndarray,
        p: np.ndarray,
        dp: np.ndarray,
        x0: np.ndarray,
        dx0: np.ndarray,
        weight: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
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
    if failed_at is None and not math.isfinite(2 * (cost + size)):  # both are doubled later
        failed_at = samples
    if failed_at is not None:
        zero = np.zeros_like
        return GaussNewtonSums(np.inf, zero(gradient), zero(gauss_newton), zero(squares), zero(counts), failed_at)
    return GaussNewtonSums(cost, gradient, gauss_newton, squares, counts)
