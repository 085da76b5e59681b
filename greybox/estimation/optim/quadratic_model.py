"""A cost and its quadratic model at one point: the one bounded step, and the one predicted decrease, of all minimisations."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from greybox.base.numerics import NEGLIGIBLE_SINGULAR_VALUE, RANK_CUTOFF, TINY, WRONG_MULTIPLIER


@dataclass(frozen=True)
class QuadraticModel:
    """``m(d) = cost + gradient' d + d' hessian d / 2`` along a step ``d`` from one point.

    Steps are computed in units of ``1 / scale``, where the matrix has ones on its diagonal, so that neither cut-offs nor damping depend
    on the units of the unknowns.
    """

    cost: float
    """The cost; infinite where it cannot be computed."""

    gradient: np.ndarray
    """Its gradient (n,)."""

    hessian: np.ndarray
    """Its positive semidefinite curvature (n, n): Gauss and Newton's, or Fisher's."""

    factor: tuple[np.ndarray, np.ndarray] | None = field(default=None, kw_only=True, repr=False)
    """``R`` (m, n) and ``rho`` (m,) with ``R'R = hessian`` and ``R'rho = gradient``, where they are known better than the products are."""

    @classmethod
    def from_residuals(cls, jacobian: np.ndarray, residual: np.ndarray) -> QuadraticModel:
        """The model of a sum of squares, with steps from a triangular factor: ``J'J`` would square the condition number.

        Parameters
        ----------
        jacobian
            Slopes of the residuals (N, n).
        residual
            The residuals (N,).

        Returns
        -------
        QuadraticModel
            Cost ``r'r``, gradient ``2 J'r``, curvature ``2 J'J``, and their factor.
        """
        # A reflection leaves what it does not touch: the last column of the triangle is Q'r.
        triangle = np.asarray(np.linalg.qr(np.column_stack([jacobian, residual]), mode="r"))
        return cls.from_triangle(triangle, float(residual @ residual))

    @classmethod
    def from_triangle(cls, triangle: np.ndarray, squares: float) -> QuadraticModel:
        """As `from_residuals`, of slopes and residuals that were reduced to a triangle already.

        Parameters
        ----------
        triangle
            ``R`` (m, n + 1) of a QR factorisation of the slopes and, in the last column, the residuals.
        squares
            The sum of squares of the residuals.

        Returns
        -------
        QuadraticModel
            Cost, gradient and curvature of the sum of squares, and their factor.
        """
        n = triangle.shape[1] - 1
        # The cost is r'r, not r'r / 2: hence sqrt(2) on the factor, and R'R = 2 J'J.
        scaled = np.sqrt(2) * triangle[:n]
        root, target = scaled[:, :n], scaled[:, n]
        return cls(squares, root.T @ target, root.T @ root, factor=(root, target))

    @cached_property
    def scale(self) -> np.ndarray:
        """Root of the curvature along each unknown (n,); one where there is none."""
        # Marquardt's scaling: the unit matrix added to the scaled one damps every unknown by the same share of its
        # curvature.
        diagonal = self.hessian.diagonal()
        return np.where(diagonal > TINY, np.sqrt(np.maximum(diagonal, TINY)), 1.0)

    @cached_property
    def is_finite(self) -> bool:
        """Whether there is a step: sensitivities that overflow show no direction."""
        return bool(np.isfinite(self._scaled).all() and np.isfinite(self.gradient).all())

    def bounded_step(
        self, low: np.ndarray | None = None, high: np.ndarray | None = None, damping: float = 0.0
    ) -> np.ndarray:
        """The step to the minimum of the model within bounds, by a primal active set (Nocedal and Wright 2006, section 16.5).

        Parameters
        ----------
        low, high
            Distances to the bounds (n,), ``low <= 0 <= high``; infinite, or None, where there are none.
        damping
            Is added to the diagonal of the scaled matrix (Levenberg and Marquardt).

        Returns
        -------
        np.ndarray
            The step (n,). Directions without curvature stay where they are; zero where the model is not finite.
        """
        if not self.is_finite:
            return np.zeros(len(self.gradient))
        free = self._free_step(damping) / self.scale
        if low is None or high is None:
            return free
        low, high = np.minimum(low, 0.0), np.maximum(high, 0.0)
        # The unconstrained minimum is the constrained one where it is inside.
        if np.all((free >= low) & (free <= high)):
            return free
        root, target, cutoff = self._least_squares
        if damping:
            n = len(low)
            # |R d + rho|^2 + damping |d|^2 as one least-squares problem
            root, target = np.vstack([root, np.sqrt(damping) * np.eye(n)]), np.append(target, np.zeros(n))
        bounds = low * self.scale, high * self.scale
        # In scaled unknowns: bounds scale with them.
        step = _solve_bounded_least_squares(root, target, *bounds, cutoff, free * self.scale) / self.scale
        return np.clip(step, low, high)

    def predicted_decrease(self, low: np.ndarray | None = None, high: np.ndarray | None = None) -> float:
        """By how much the model falls along the undamped step within bounds.

        Parameters
        ----------
        low, high
            Distances to the bounds (n,); None: there are none.

        Returns
        -------
        float
            At least zero; infinite where the model is not finite, as anything may still be gained.
        """
        if not self.is_finite:
            return np.inf
        bounds = b"" if low is None or high is None else low.tobytes() + high.tobytes()
        if bounds not in self._decreases:
            self._decreases[bounds] = self.decrease_along(self.bounded_step(low, high))
        return self._decreases[bounds]

    def decrease_along(self, step: np.ndarray) -> float:
        """By how much the model falls along ``step`` (n,)."""
        if self.factor is None:
            # -(g'd + d'Hd / 2).
            return -float(self.gradient @ step) - 0.5 * float(step @ self.hessian @ step)
        root, target = self.factor
        # From the factor: g'd + d'Hd / 2 loses half the digits where J is nearly singular.
        along = root @ step
        return -float(target @ along) - 0.5 * float(along @ along)

    def principal_axes(self) -> tuple[np.ndarray, np.ndarray]:
        """Directions (n, k) of the scaled unknowns that have a curvature, and these curvatures (k,)."""
        axes, curvature, _ = self._spectrum
        return axes, curvature

    @cached_property
    def _scaled(self) -> np.ndarray:
        """The matrix (n, n) with ones on its diagonal."""
        with np.errstate(over="ignore", invalid="ignore"):
            return np.asarray(self.hessian / self.scale / self.scale[:, None])

    @cached_property
    def _decreases(self) -> dict[bytes, float]:
        """Predicted decreases by their bounds: the rule that ends a search and the one that changes the method both ask."""
        return {}

    @cached_property
    def _spectrum(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Eigenvectors (n, k) of the scaled matrix, without those that are rounding; curvatures (k,) and slopes (k,) along them."""
        if self.factor is None:
            curvature, axes = np.linalg.eigh(self._scaled)
            # Of J'J: half the digits of J's singular values are left, hence the larger cut-off.
            usable = curvature > RANK_CUTOFF * curvature.max(initial=0.0)
            axes = axes[:, usable]
            return axes, curvature[usable], axes.T @ (self.gradient / self.scale)
        root, target = self.factor
        left, size, right = np.linalg.svd(root / self.scale, full_matrices=False)
        usable = size > NEGLIGIBLE_SINGULAR_VALUE * size.max(initial=0.0)
        size = size[usable]
        # F = U S V': the matrix F'F has the curvatures S^2, the gradient F't the slopes S U't.
        return right[usable].T, size**2, size * (left[:, usable].T @ target)

    @cached_property
    def _least_squares(self) -> tuple[np.ndarray, np.ndarray, float]:
        """Root (m, n) and target (m,) of the scaled model as least squares, and the share of its singular values that is rounding."""
        if self.factor is not None:
            root, target = self.factor
            return root / self.scale, target, NEGLIGIBLE_SINGULAR_VALUE
        axes, curvature, slope = self._spectrum
        size = np.sqrt(curvature)
        # F = L^(1/2) V' and t = L^(-1/2) V'g: then F'F is the matrix and F't the gradient.
        return size[:, None] * axes.T, slope / size, np.sqrt(RANK_CUTOFF)

    def _free_step(self, damping: float) -> np.ndarray:
        """The step (n,) without bounds, in units of ``1 / scale``."""
        axes, curvature, slope = self._spectrum
        # d = -V (slope / (curvature + damping)): directions without curvature are not in V and stay at zero.
        return -np.asarray(axes @ (slope / (curvature + damping)))


def _solve_bounded_least_squares(
    root: np.ndarray, target: np.ndarray, low: np.ndarray, high: np.ndarray, cutoff: float, free_step: np.ndarray
) -> np.ndarray:
    """The step (n,) with the least ``|root @ step + target|`` within bounds ``low <= 0 <= high``, from zero on.

    Steps go to the minimum over the free unknowns, or to the first bound, which is held then. At a minimum the bound that pushes
    hardest against the slope is released. Of all minima over the free unknowns the step goes to the nearest. ``free_step`` is that
    without bounds.
    """
    n = len(low)
    step, slope = np.zeros(n), root.T @ target
    rounding = WRONG_MULTIPLIER * np.abs(slope).max(initial=0.0)
    is_fixed = low == high
    # A bound at which the slope pushes outwards is active from the start.
    is_free = ~(is_fixed | ((low == 0) & (slope > 0)) | ((high == 0) & (slope < 0)))
    for _ in range(
        n * n + 2
    ):  # each minimum is lower than the last one, so it ends long before this unless rounding errors circle
        end = step.copy()
        if is_free.all() and not step.any():
            end = free_step
        elif is_free.any():
            left, size, right = np.linalg.svd(root[:, is_free], full_matrices=False)
            kept = int(np.count_nonzero(size > cutoff * size[0]))
            # What the determined part of the free unknowns can still take away of the residual.
            remainder = left[:, :kept].T @ (target + root @ step)
            # Least-norm Newton step over the free unknowns: of many minima the nearest.
            end[is_free] -= right[:kept].T @ (remainder / size[:kept])
        beyond = np.flatnonzero((end < low) | (end > high))
        # On to the first bound only: behind it the minimum over the free unknowns is another one.
        if len(beyond):
            bound = np.where(end[beyond] < low[beyond], low[beyond], high[beyond])
            # Share of the step up to each bound that it would cross; the first one becomes active.
            reach = (bound - step[beyond]) / (end[beyond] - step[beyond])
            first = int(np.argmin(reach))
            step = step + max(reach[first], 0.0) * (end - step)
            step[beyond[first]] = bound[first]
            is_free[beyond[first]] = False
            continue
        step = end
        # Gradient of |F d + t|^2 / 2.
        slope = root.T @ (target + root @ step)
        # Lagrange multipliers of the active bounds: positive where the cost falls on leaving.
        pull = np.where(is_free | is_fixed, 0.0, np.where(step <= low, -slope, slope))
        worst = int(np.argmax(pull))
        if pull[worst] <= rounding:
            break
        is_free[worst] = True
    return step
