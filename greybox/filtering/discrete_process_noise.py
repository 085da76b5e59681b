"""What process noise adds to the covariance over one interval of a linear model, exactly, and its slope along the parameters."""

from __future__ import annotations

import casadi as ca
import numpy as np
from scipy.linalg import expm

from greybox.filtering.symmetric_matrices import to_lower_triangle, to_symmetric
from greybox.integrators.step import CoefficientFunction
from greybox.model.system import System


def discretise_process_noise(system: System) -> CoefficientFunction:
    """``(p, lengths, which) ->`` the covariance ``Qd`` (nh, m) of each interval length and its slopes (nh, m, na).

    ``Qd = integral of exp(A s) diag(diffusion^2) exp(A s)' ds`` from 0 to ``h``, its lower triangle column by column,
    ``m = nx (nx + 1) / 2`` (the integral of Van Loan, IEEE Trans. Automatic Control 23, 1978, equation 1.3). It is found as the
    solution of the linear equation ``dQd/ds = A Qd + Qd A' + diag(diffusion^2)``, whose exponential stays bounded for stiff models,
    where that of ``-A`` in Van Loan's own formula overflows. ``which`` numbers the parameters of ``system.p``.
    """
    nx = system.x.numel()
    a = ca.jacobian(system.rhs, system.x)
    covariance = ca.SX.sym("P", nx * (nx + 1) // 2)
    rate = to_lower_triangle(
        a @ to_symmetric(covariance, nx) + to_symmetric(covariance, nx) @ a.T + ca.diag(system.diffusion**2)
    )
    size = covariance.numel() + 1
    generator = ca.SX.zeros(size, size)
    generator[:-1, :-1] = ca.jacobian(rate, covariance)
    generator[:-1, -1] = ca.substitute(rate, covariance, ca.SX.zeros(size - 1))
    along = ca.jacobian(ca.vec(generator), system.p)
    matrices = ca.Function("noise", [system.p], [ca.densify(generator), ca.densify(along)])

    def coefficients(p: np.ndarray, lengths: np.ndarray, which: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        values, slopes = (np.asarray(m) for m in matrices(p))
        return _exponential_column(
            values, slopes.T.reshape(-1, size, size).transpose(0, 2, 1)[which], np.asarray(lengths)
        )

    return coefficients


def _exponential_column(
    generator: np.ndarray, slopes: np.ndarray, lengths: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Last column, without its one, of the exponential over each length (nh, m), and its slopes (nh, m, n)."""
    size, n, nh = len(generator), len(slopes), len(lengths)
    scaled = generator * lengths[:, None, None]
    if not (np.isfinite(scaled).all() and np.isfinite(slopes).all()):
        return np.full((nh, size - 1), np.nan), np.full((nh, size - 1, n), np.nan)
    with np.errstate(
        over="ignore", invalid="ignore"
    ):  # of an unstable model far off; the run that follows tells what is not finite
        values = expm(scaled)[:, :-1, -1]
    moving = np.flatnonzero(slopes.any(axis=(1, 2)))
    change = np.zeros((nh, size - 1, n))
    if len(moving):
        # the upper right block of the exponential of [[M, dM], [0, M]] (Najfeld, Havel 1995)
        pairs = np.zeros((nh, len(moving), 2 * size, 2 * size))
        pairs[:, :, :size, :size] = pairs[:, :, size:, size:] = scaled[:, None]
        pairs[:, :, :size, size:] = slopes[moving] * lengths[:, None, None, None]
        with np.errstate(over="ignore", invalid="ignore"):
            change[:, :, moving] = expm(pairs)[:, :, : size - 1, -1].transpose(0, 2, 1)
    return values, change
