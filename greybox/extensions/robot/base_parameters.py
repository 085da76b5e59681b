"""Base parameters: the combinations of inertial constants that torques can show at all, found by rank and said in words.

Of the columns of the regressor at random states a set that is independent is kept, those of inner links first; each of the others is a
combination of them, and its constant is carried by theirs (Gautier, Khalil, IEEE Trans. Robotics and Automation 6, 1990; Gautier,
J. Robotic Systems 8, 1991). The rank is structural: no record can show more, and a poor record shows less.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np
from scipy.linalg import solve_triangular
from scipy.optimize import least_squares

from greybox.base.values import ReadOnly
from greybox.extensions.robot.description import INERTIAL_NAMES, INERTIAL_UNITS, JointKind, Robot, to_pseudo_inertia
from greybox.extensions.robot.rigid_body import RigidBody
from greybox.model import Parameter

# Random states give so many times more rows than there are columns.
ROWS_PER_COLUMN = 3
# Columns are dependent where less than this share of one is left beside the others: many files round right angles to five digits (1.5708),
# and what such a tilt would show is below the noise of any record.
DEPENDENT_SHARE = 3e-5
# Share of a combination's largest number below which another is rounding.
NEGLIGIBLE = 3e-5


@dataclass(frozen=True, eq=False)
class BaseParameters(ReadOnly):
    """Which combinations ``beta = mixing @ theta`` of the inertial constants the torques of a robot depend on.

    Parameters
    ----------
    robot
        The robot of which they are.
    columns
        Numbers (B,) among all constants of those that lead the combinations: the regressor of ``beta`` has their columns.
    mixing
        The combinations (B, 10 L): one at its leading constant.
    """

    robot: Robot
    columns: np.ndarray
    mixing: np.ndarray

    @property
    def names(self) -> tuple[str, ...]:
        """The leading constant of each with the number of its joint; ``+`` where others are carried with it."""
        return tuple(name_constant(c) for c in self.columns)

    @property
    def units(self) -> tuple[str, ...]:
        """The unit of each."""
        return tuple(INERTIAL_UNITS[c % 10] for c in self.columns)

    @cached_property
    def values(self) -> np.ndarray:
        """Of the description (B,)."""
        return np.asarray(self.mixing @ self.robot.inertial)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """As constants of a model, as described."""
        each = enumerate(zip(self.names, self.units, self.values, strict=True))
        return tuple(
            Parameter(name, unit.replace(" ", "*"), float(value), description=self.describe(k), source="description")
            for k, (name, unit, value) in each
        )

    @cached_property
    def regressor(self) -> ca.Function:
        """``(q, dq, ddq) -> Y`` (n, B) with ``tau = Y beta``."""
        whole = RigidBody(self.robot).regressor
        states = whole.sx_in()
        return ca.Function("base_regressor", states, [ca.densify(whole(*states)[:, self.columns.tolist()])])

    def describe(self, k: int) -> str:
        """One of them as a formula: ``Izz1 + 0.18 (m2 + m3)``."""
        row = self.mixing[k]
        terms: dict[float, list[str]] = {}
        for column in np.flatnonzero(row):
            # Constants with the same factor stand in one bracket.
            terms.setdefault(float(f"{row[column]:.3g}"), []).append(name_constant(int(column)))
        lead = name_constant(self.columns[k])
        first = [lead, *(name for name in terms.pop(1.0) if name != lead)]
        text = " + ".join(first)
        for factor, names in terms.items():
            bracket = names[0] if len(names) == 1 else f"({' + '.join(names)})"
            size = "" if abs(factor) == 1 else f"{abs(factor):g} "
            text += f" {'-' if factor < 0 else '+'} {size}{bracket}"
        return text


def name_constant(column: int) -> str:
    """``Izz2``: which constant of the link behind which joint, counted from 1."""
    return f"{INERTIAL_NAMES[column % 10]}{column // 10 + 1}"


def find_base_parameters(robot: Robot) -> BaseParameters:
    """The base parameters of a robot, exact and without a record.

    Parameters
    ----------
    robot
        The robot.

    Returns
    -------
    BaseParameters
        As many as the rank of its regressor.
    """
    order = _rank_constants(robot)
    n = len(robot.axes)
    generator = np.random.default_rng(0)
    q, dq, ddq = generator.uniform(-np.pi, np.pi, (3, -(-ROWS_PER_COLUMN * len(order) // n) + 1, n))
    regressor = RigidBody(robot).compute_regressors(q, dq, ddq).reshape(-1, len(order))
    independent, factors = split_columns(regressor[:, order])
    columns = np.array(order)[independent]
    mixing = np.zeros((len(columns), len(order)))
    mixing[:, np.array(order)] = factors
    by_place = np.argsort(columns)
    return BaseParameters(robot, columns[by_place], mixing[by_place])


def split_columns(matrix: np.ndarray) -> tuple[list[int], np.ndarray]:
    """Independent columns of a matrix (N, K), the first possible ones, and all columns as combinations of them (B, K)."""
    lengths = np.linalg.norm(matrix, axis=0)
    scaled = matrix / np.where(lengths > NEGLIGIBLE * lengths.max(), lengths, np.inf)
    basis = np.zeros((len(matrix), 0))
    independent: list[int] = []
    for k, column in enumerate(scaled.T):
        # Twice is enough to be orthogonal to the last digit (Kahan).
        for _ in range(2):
            column = column - basis @ (basis.T @ column)
        if np.linalg.norm(column) > DEPENDENT_SHARE:
            independent.append(k)
            basis = np.column_stack([basis, column / np.linalg.norm(column)])
    triangle = basis.T @ matrix
    factors = solve_triangular(triangle[:, independent], triangle)
    factors[np.abs(factors) < NEGLIGIBLE * np.abs(factors).max(axis=1, keepdims=True)] = 0.0
    return independent, factors


def _rank_constants(robot: Robot) -> list[int]:
    """All constants, those first that shall lead: inner links before outer ones, and of a link those that its own joint shows."""
    order = []
    for k, joint in enumerate(robot.joints):
        along, *across = np.argsort(-np.abs(joint.axis), kind="stable").tolist()
        first, second = sorted(across)
        diagonal = [f"I{a}{a}" for a in "xyz"]
        moments = [f"m{a}" for a in "xyz"]
        # As in Khalil's tables: the second moment across, the first moment along the axis and the mass are carried by others.
        names: Sequence[str] = (
            *(diagonal[along], "Ixy", "Ixz", "Iyz", diagonal[first], moments[first], moments[second]),
            *(moments[along], diagonal[second], "m"),
        )
        if joint.kind is JointKind.PRISMATIC:
            names = ("m", *(name for name in names if name != "m"))
        order += [10 * k + INERTIAL_NAMES.index(name) for name in names]
    return order


# Constants that bodies can have: mass nowhere negative, by the logarithmic Cholesky factor of each pseudo-inertia.
#
# ``P = L L'`` with a positive diagonal ``exp(phi)`` is positive for any parameters, and every positive one has such a factor (Rucker,
# Wensing, IEEE Robotics and Automation Letters 7, 2022): what base parameters leave open is chosen near the description.

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
