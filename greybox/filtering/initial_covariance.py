"""How uncertain the first states of a record are, where they are unknown: what process noise adds in one interval."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from greybox.filtering.filter_step import compute_interval_noise
from greybox.filtering.symmetric_matrices import to_lower_triangle
from greybox.integrators import Step
from greybox.kernel import Record
from greybox.model.system import System


@dataclass(frozen=True, eq=False)
class InitialCovariance:
    """Covariance of first states that are themselves estimated, as its lower triangle (m,), with slopes.

    The state one interval (the record's shortest) before the first row counts as the unknown one; from there to the first row process
    noise pushes. Were the first row's state the unknown, it could meet the first measurement exactly: the noise of a sensor could
    shrink to nothing at no cost while process noise explains all other rows, and the likelihood would grow without bound. Without
    process noise the first states are exact, as those of a free run.

    ``function``: ``(x, u, q, p, h) ->`` the triangle and its slopes along ``[x; q; p]``; None for an exact step, whose coefficients
    have it.
    """

    step: Step
    states: int
    function: ca.Function | None

    @classmethod
    def of(cls, system: System, step: Step) -> InitialCovariance:
        """For ``system`` moved by ``step``."""
        nx = system.x.numel()
        if step.per_interval:
            return cls(step, nx, None)
        u, q = ca.SX.sym("u", step.advance.size1_in(1)), ca.SX.sym("q", step.advance.size1_in(3))
        h = ca.SX.sym("h")
        lower = ca.cse(to_lower_triangle(compute_interval_noise(step, system, u, q, h)))
        along = ca.jacobian(lower, ca.vertcat(system.x, q, system.p))
        return cls(step, nx, ca.Function("begin", [system.x, u, q, system.p, h], [lower, ca.densify(along)]))

    def covariance(self, rows: Record, q: np.ndarray, pn: np.ndarray, x0: np.ndarray) -> np.ndarray:
        """The triangle (m,) for the rows and coefficients ``q`` (nh, nq) of a filter, from the first states ``x0`` (nx,)."""
        size = self.states * (self.states + 1) // 2
        if not len(rows.h):
            return np.zeros(size)
        if self.function is None:
            return q[int(np.argmin(rows.lengths)), -size:]
        return np.asarray(self.function(*self._arguments(self.function, rows, q, pn, x0))[0]).ravel()

    def slopes(
        self,
        rows: Record,
        q: np.ndarray,
        dq: np.ndarray,
        pn: np.ndarray,
        dpn: np.ndarray,
        x0: np.ndarray,
        dx0: np.ndarray,
    ) -> np.ndarray:
        """Slopes (m, L) of the triangle along the columns of ``dq`` (nh, nq, L), ``dpn`` (np + ny, L) and ``dx0`` (nx, L)."""
        size = self.states * (self.states + 1) // 2
        if not len(rows.h):
            return np.zeros((size, dx0.shape[1]))
        if self.function is None:
            return dq[int(np.argmin(rows.lengths)), -size:]
        along = np.asarray(self.function(*self._arguments(self.function, rows, q, pn, x0))[1])
        nq, constants = self.step.advance.size1_in(3), self.function.size1_in(3)
        return along @ np.vstack([dx0, dq[0, :nq], dpn[:constants]])

    def _arguments(self, function: ca.Function, rows: Record, q: np.ndarray, pn: np.ndarray, x0: np.ndarray) -> tuple:
        columns, nq = function.size1_in(1), function.size1_in(2)
        return x0, rows.u[0, :columns], q[0, :nq], pn[: function.size1_in(3)], float(rows.lengths.min())
