"""Constants that bodies can have: mass nowhere negative, by the logarithmic Cholesky factor of each pseudo-inertia.

``P = L L'`` with a positive diagonal ``exp(phi)`` is positive for any parameters, and every positive one has such a factor (Rucker,
Wensing, IEEE Robotics and Automation Letters 7, 2022): what base parameters leave open is chosen near the description.
"""

from __future__ import annotations

import casadi as ca
import numpy as np
from scipy.optimize import least_squares

from greybox.extensions.robot.base_parameters import BaseParameters
from greybox.extensions.robot.description import to_pseudo_inertia

# Weight of the distance to the description in the parameters of the factors, beside squares in standard errors of the base parameters.
NEARNESS = 1e-3
# Steps at most: what is left of the squares settles in a tenth of them.
MOST_STEPS = 300
LARGEST_LOGARITHM = 30.0
# Links without a mass of their own, which many descriptions have, get this share of the largest one.
LEAST_INERTIA = 1e-6


def find_physical_constants(
    base: BaseParameters, beta: np.ndarray, information: np.ndarray
) -> tuple[np.ndarray, float]:
    """Constants that bodies can have, as near as possible to base parameters.

    Parameters
    ----------
    base
        The base parameters.
    beta, information
        Their estimates (B,), and the inverse (B, B) of their covariance.

    Returns
    -------
    tuple
        The constants (10 L,), and by how much the sum of squares in standard errors grows with them.
    """
    links = base.robot.inertial.reshape(-1, 10)
    start = np.concatenate(
        [_to_factor(to_pseudo_inertia(link), LEAST_INERTIA * max(np.abs(links).max(), 1.0)) for link in links]
    )
    phi = ca.SX.sym("phi", len(start))
    theta = ca.vertcat(*(_from_factor(phi[10 * k : 10 * (k + 1)]) for k in range(len(links))))
    constants = ca.Function("constants", [phi], [theta, ca.jacobian(theta, phi)])
    root = np.linalg.cholesky(information).T

    def residual(values: np.ndarray) -> np.ndarray:
        misfit = root @ (base.mixing @ constants(values)[0].full()[:, 0] - beta)
        return np.concatenate([misfit, NEARNESS * (values - start)])

    def slope(values: np.ndarray) -> np.ndarray:
        return np.vstack([root @ base.mixing @ constants(values)[1].full(), NEARNESS * np.eye(len(start))])

    # The last digits of what the record leaves open would take for ever.
    result = least_squares(residual, start, slope, method="lm", x_scale="jac", ftol=1e-4, max_nfev=MOST_STEPS)
    return constants(result.x)[0].full()[:, 0], float(np.sum(residual(result.x)[: len(beta)] ** 2))


def _to_factor(P: np.ndarray, floor: float) -> np.ndarray:
    """Parameters (10,) of a pseudo-inertia: logarithms of the factor's diagonal, then what is below it."""
    values, vectors = np.linalg.eigh(P)
    L = np.linalg.cholesky(vectors * np.maximum(values, floor) @ vectors.T)
    return np.concatenate([np.log(np.diag(L)), L[np.tril_indices(4, -1)]])


def _from_factor(phi: ca.SX) -> ca.SX:
    """The ten constants of such parameters."""
    # A wild step of the search ends within what numbers can hold.
    L = ca.diag(ca.exp(ca.fmin(ca.fmax(phi[:4], -LARGEST_LOGARITHM), LARGEST_LOGARITHM)))
    for k, (row, column) in enumerate(zip(*np.tril_indices(4, -1), strict=True)):
        L[int(row), int(column)] = phi[4 + k]
    P = L @ L.T
    # I = tr(S) - S
    xx, yy, zz = P[1, 1] + P[2, 2], P[0, 0] + P[2, 2], P[0, 0] + P[1, 1]
    return ca.vertcat(P[3, 3], P[3, 0], P[3, 1], P[3, 2], xx, -P[0, 1], yy, -P[0, 2], -P[1, 2], zz)
