"""Random jumping over a full factorial of draws, exact and cheap: three of the five constants are linear.

Equation 17 is ``A - A r cos(theta) e^(-sigma t) sin(w t) - A r sin(theta) e^(-sigma t) cos(w t)``: for given ``(w, sigma)`` the
mean square error is a quadratic form in three numbers. One Gram matrix for each drawn pair replaces a simulation of every
combination, and of the drawn amplitudes the one nearest to the vertex of a parabola is the best: nothing is approximated.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from greybox.blackbox.monte_carlo_smoothing.intervals import AXES, DrawIntervals


@dataclass(frozen=True)
class DrawCounts:
    """How many values are drawn on each axis (the paper's numbers); all their combinations are tried."""

    amplitude: int = 50
    ratio: int = 10
    phase: int = 10
    frequency: int = 20
    decay: int = 20

    @property
    def combinations(self) -> int:
        """Number of combinations in one evaluation."""
        return int(np.prod([getattr(self, axis) for axis in AXES]))


@dataclass(frozen=True)
class StepResponseConstants:
    """The best combination of one evaluation: a value on each axis, and its mean square error."""

    amplitude: float
    ratio: float
    phase: float
    frequency: float
    decay: float
    error: float


def draw_and_search(
    time: np.ndarray, y: np.ndarray, intervals: DrawIntervals, draws: DrawCounts, generator: np.random.Generator
) -> StepResponseConstants:
    """The best of all combinations of fresh uniform draws on each axis; ``time`` (N,) in seconds after the step, ``y`` (N,)."""
    ends: dict[str, tuple[float, float]] = {axis: getattr(intervals, axis) for axis in AXES}
    values = {axis: generator.uniform(low, high, size=getattr(draws, axis)) for axis, (low, high) in ends.items()}
    return search_grid(time, y, values)


def search_grid(time: np.ndarray, y: np.ndarray, values: dict[str, np.ndarray]) -> StepResponseConstants:
    """The combination of ``values`` (by axis) with the smallest mean square of ``y - yhat`` (equation 17), over all of them."""
    w, sigma, amplitude = values["frequency"], values["decay"], np.sort(values["amplitude"])
    gram, product = _grams(time, y, w, sigma)
    # directions v of the three linear coefficients A v = A (1, -r cos theta, -r sin theta), for every (theta, r)
    theta, r = (axis.ravel() for axis in np.meshgrid(values["phase"], values["ratio"], indexing="ij"))
    v = np.column_stack([np.ones_like(r), -r * np.cos(theta), -r * np.sin(theta)])
    along = product @ v.T
    square = np.einsum("pij,vi,vj->pv", gram, v, v, optimize=True)
    chosen = _nearest(amplitude, along / square)
    error = (y @ y - 2 * chosen * along + chosen**2 * square) / len(y)
    pair, direction = np.unravel_index(np.argmin(error), error.shape)
    return StepResponseConstants(
        float(chosen[pair, direction]),
        float(r[direction]),
        float(theta[direction]),
        float(w[pair // len(sigma)]),
        float(sigma[pair % len(sigma)]),
        float(error[pair, direction]),
    )


def _grams(time: np.ndarray, y: np.ndarray, w: np.ndarray, sigma: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Gram matrices (pairs, 3, 3) of ``1, e^(-sigma t) sin(w t), e^(-sigma t) cos(w t)`` and their products with y (pairs, 3)."""
    angle, fading = np.outer(w, time), np.exp(-np.outer(sigma, time))
    sine, cosine, faded = np.sin(angle), np.cos(angle), fading**2
    shape = (len(w) * len(sigma),)
    gram, product = np.empty((*shape, 3, 3)), np.empty((*shape, 3))
    gram[:, 0, 0], product[:, 0] = len(time), y.sum()
    for k, wave in enumerate((sine, cosine), 1):
        gram[:, 0, k] = gram[:, k, 0] = (wave @ fading.T).ravel()
        gram[:, k, k] = (wave**2 @ faded.T).ravel()
        product[:, k] = ((wave * y) @ fading.T).ravel()
    gram[:, 1, 2] = gram[:, 2, 1] = ((sine * cosine) @ faded.T).ravel()
    return gram, product


def _nearest(drawn: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """For each of ``wanted`` the nearest of the sorted ``drawn``: the lowest point of a parabola among them."""
    above = np.clip(np.searchsorted(drawn, wanted), 1, max(len(drawn) - 1, 1))
    low, high = drawn[above - 1], drawn[np.minimum(above, len(drawn) - 1)]
    return np.where(wanted - low <= high - wanted, low, high)
