"""Static nonlinearities of an input: polynomials and piecewise linear functions, as sums of basis functions."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.polynomial.chebyshev import chebvander

NonlinearityShape = Literal["polynomial", "piecewise"]


@dataclass(frozen=True)
class StaticNonlinearity:
    """``v = sum_j weights[j] g_j(u)`` with ``v(0) = 0``.

    ``polynomial``: ``g_j = T_j(u / size) - T_j(0)`` with Chebyshev's ``T_j``, j = 1 ... . ``piecewise``: ``g_1 = u / size``, and a
    kink at every knot, ``g_j = (max(u - knot, 0) - max(-knot, 0)) / size``. ``size`` is the largest input of the records, in its
    unit.
    """

    shape: NonlinearityShape
    size: float
    weights: tuple[float, ...]
    knots: tuple[float, ...] = ()

    def basis(self, u: np.ndarray) -> np.ndarray:
        """The functions (N, m) of the input ``u`` (N,)."""
        if self.shape == "polynomial":
            degree = len(self.weights)
            return (chebvander(u / self.size, degree) - chebvander(np.zeros(1), degree))[:, 1:]
        kinks = [np.maximum(u - k, 0.0) - max(-k, 0.0) for k in self.knots]
        return np.column_stack([u, *kinks]) / self.size

    def __call__(self, u: np.ndarray) -> np.ndarray:
        """The curve's value (N,) at ``u`` (N,)."""
        return self.basis(np.asarray(u, float)) @ np.array(self.weights)

    def with_weights(self, weights: np.ndarray) -> StaticNonlinearity:
        """The same functions with other weights (m,)."""
        return replace(self, weights=tuple(map(float, weights)))


def make_linear_nonlinearity(shape: NonlinearityShape, u: np.ndarray, basis_size: int) -> StaticNonlinearity:
    """A straight line through zero with ``basis_size`` functions to bend it: the degree, or one more than the number of kinks.

    Kinks lie at equal fractions of the input's distinct values, so that each piece has data.
    """
    size = float(np.abs(u).max(initial=0.0)) or 1.0
    weights = (1.0, *(0.0,) * (basis_size - 1))
    if shape == "polynomial":
        return StaticNonlinearity(shape, size, weights)
    levels = np.quantile(np.unique(u), np.arange(1, basis_size) / basis_size)
    return StaticNonlinearity(shape, size, weights, tuple(map(float, levels)))
