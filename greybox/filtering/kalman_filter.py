"""A Kalman filter made ready for one model: its likelihood with exact slopes, and its run over a record."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from greybox.filtering.filter_record import remove_measurements, to_filter_record
from greybox.filtering.filter_step import make_filter_step
from greybox.filtering.initial_covariance import InitialCovariance
from greybox.filtering.symmetric_matrices import to_lower_triangle_array, to_symmetric_arrays
from greybox.integrators import Step
from greybox.kernel import Kernel, Record, make_kernel
from greybox.model.system import System

LOG_TWO_PI = float(np.log(2 * np.pi))
NO_PARAMETERS = np.empty(0, int)


@dataclass(frozen=True, eq=False)
class FilterRun:
    """A run of the filter over a record of N rows; not finite from where it overflows."""

    predicted: np.ndarray
    """States (N, nx) of each row given the measurements before it."""

    covariance: np.ndarray
    """Their covariance (N, nx, nx)."""

    innovation: np.ndarray
    """Measured minus predicted output over the standard deviation of that difference (N, ny), NaN in gaps."""

    log_likelihood: float
    """Of all measurements."""


@dataclass(frozen=True, eq=False)
class InnovationSensitivities:
    """Innovations of the k measurements there are, and their slopes along L directions.

    ``-2 log L = sum e^2 + logarithm + log(2 pi)``.
    """

    e: np.ndarray
    """Standardised innovations (k,)."""

    logarithm: np.ndarray
    """Logarithms of their variances (k,)."""

    de: np.ndarray
    """Slopes of the innovations (k, L)."""

    dlog_variance: np.ndarray
    """Slopes of the logarithms (k, L)."""

    rows: np.ndarray
    """Row of each measurement (k,)."""

    outputs: np.ndarray
    """Output of each measurement (k,)."""

    @property
    def mean_slopes(self) -> np.ndarray:
        """Slopes (k, L) of the innovations, not standardised, over their standard deviations."""
        return self.de + 0.5 * self.e[:, None] * self.dlog_variance


@dataclass(frozen=True, eq=False)
class KalmanFilter:
    """The filter of ``system`` moved by ``step``.

    The parameters ``pn`` of its calls are ``[p; noise]``: the model's constants and the standard deviation of each output's noise.
    """

    system: System
    step: Step

    filter_step: Step
    """The filter itself, as a discrete step."""

    kernel: Kernel
    """What runs the filter's step over a record."""

    initial_covariance: InitialCovariance | None = None
    """How uncertain first states are of which nothing else is said; None: they are known exactly."""

    @classmethod
    def of(cls, system: System, step: Step, *, known_start: bool = True) -> KalmanFilter:
        """The filter, compiled where there is a compiler; ``known_start``: the first states are known exactly, see `InitialCovariance`."""
        step_of_filter = make_filter_step(system, step)
        return cls(
            system,
            step,
            step_of_filter,
            make_kernel(step_of_filter),
            None if known_start else InitialCovariance.of(system, step),
        )

    def with_substeps(self, substeps: int) -> KalmanFilter:
        """The same with another number of substeps in an interval; nothing is compiled."""
        filter_step, step = (replace(s, substeps=substeps) for s in (self.filter_step, self.step))
        initial_covariance = None if self.initial_covariance is None else InitialCovariance.of(self.system, step)
        return replace(
            self,
            step=step,
            filter_step=filter_step,
            kernel=self.kernel.with_substeps(substeps),
            initial_covariance=initial_covariance,
        )

    @property
    def sizes(self) -> tuple[int, int]:
        """Numbers of states and outputs."""
        return self.system.x.numel(), self.step.outputs.size1_out(0)

    def run(self, record: Record, pn: np.ndarray, x0: np.ndarray, covariance: np.ndarray | None = None) -> FilterRun:
        """The run from first states ``x0`` (nx,) with their ``covariance`` (nx, nx); None: that of `initial_covariance`."""
        nx, ny = self.sizes
        rows = to_filter_record(record, self.step)
        q, _ = self.filter_step.coefficients(pn, rows.lengths, NO_PARAMETERS)
        y, z = self.kernel.simulate(rows, q, pn, self._initial_filter_state(rows, q, pn, x0, covariance))
        is_measured = np.isfinite(record.y)
        e, logarithm = np.where(is_measured, y[:, :ny], np.nan), y[:, ny:]
        likelihood = -0.5 * float(np.sum(e[is_measured] ** 2 + logarithm[is_measured] + LOG_TWO_PI))
        return FilterRun(z[:, :nx], to_symmetric_arrays(z[:, nx:], nx), e, likelihood)

    def simulate_free_run(self, record: Record, pn: np.ndarray, x0: np.ndarray) -> np.ndarray:
        """States (N, nx) without any correction: the free run of the model."""
        nx, ny = self.sizes
        rows = remove_measurements(to_filter_record(record, self.step), ny)
        q, _ = self.filter_step.coefficients(pn, rows.lengths, NO_PARAMETERS)
        return self.kernel.simulate(rows, q, pn, np.append(x0, np.zeros(nx * (nx + 1) // 2)))[1][:, :nx]

    def slopes(
        self, record: Record, pn: np.ndarray, dpn: np.ndarray, x0: np.ndarray, dx0: np.ndarray
    ) -> InnovationSensitivities | None:
        """Innovations and their slopes along the L columns of ``dpn`` (np + ny, L) and ``dx0`` (nx, L); None where the run overflows.

        The first states are as uncertain as `initial_covariance` says, besides what there is to ``x0`` as an unknown.
        """
        nx, ny = self.sizes
        rows = to_filter_record(record, self.step)
        which = np.flatnonzero(dpn.any(axis=1))
        q, along = self.filter_step.coefficients(pn, rows.lengths, which)
        dq = along @ dpn[which]
        initial_covariance = self.initial_covariance
        covariance_slopes = (
            np.zeros((nx * (nx + 1) // 2, dx0.shape[1]))
            if initial_covariance is None
            else initial_covariance.slopes(rows, q, dq, pn, dpn, x0, dx0)
        )
        start, dz0 = self._initial_filter_state(rows, q, pn, x0, None), np.vstack([dx0, covariance_slopes])
        r, jacobian = self.kernel.residuals(rows, q, dq, pn, dpn, start, dz0, np.ones(2 * ny))
        # The kernel's residuals are zero minus the filter's outputs.
        measured = np.nonzero(np.isfinite(record.y))
        row, output = measured
        sensitivities = -r[row, output], -r[row, output + ny], -jacobian[row, output], -jacobian[row, output + ny]
        if not all(np.isfinite(a).all() for a in sensitivities):
            return None
        return InnovationSensitivities(*sensitivities, row, output)

    def _initial_filter_state(
        self, rows: Record, q: np.ndarray, pn: np.ndarray, x0: np.ndarray, covariance: np.ndarray | None
    ) -> np.ndarray:
        """``[x0; lower triangle of the covariance]``."""
        if covariance is not None:
            return np.append(x0, to_lower_triangle_array(covariance))
        if self.initial_covariance is None:
            return np.append(x0, np.zeros(len(x0) * (len(x0) + 1) // 2))
        return np.append(x0, self.initial_covariance.covariance(rows, q, pn, x0))
