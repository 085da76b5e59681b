"""What a large residual costs: least squares, or a robust loss that outliers cannot pull (Huber 1964; Student's t)."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np

from greybox.errors import ModelError, nearest
from greybox.numerics import NORMAL_QUADRATURE_POINTS, NORMAL_QUADRATURE_WIDTH
from greybox.transcription.policy import DEFAULT_POLICY, RobustLossPolicy


class LossKind(StrEnum):
    """What a residual costs."""

    SQUARES = "squares"
    HUBER = "huber"
    STUDENT = "student"


@dataclass(frozen=True)
class RobustLoss:
    """``cost = sum s^2 rho(r / s)`` of the residuals ``r`` in units of their noise, ``s`` (ny,) being their ``scale`` in that unit.

    ``huber`` with threshold ``k``: ``rho(t) = t^2`` up to ``k`` and ``2 k |t| - k^2`` beyond, where a residual pulls no more than one of
    ``k``. ``student`` with ``k`` degrees of freedom: ``rho(t) = (k + 1) log(1 + t^2 / k)``, the likelihood of Student's distribution,
    where a residual far out pulls less and less. For small residuals both are least squares (but for a factor).
    """

    kind: str
    threshold: float
    scale: np.ndarray = field(default_factory=lambda: np.ones(1))
    policy: RobustLossPolicy = DEFAULT_POLICY.robust_loss

    def __str__(self) -> str:
        unit = " noise standard deviations" if self.kind == LossKind.HUBER else " degrees of freedom"
        return f"{self.kind}, {self.threshold:g}{unit}"

    def terms(self, r: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """For residuals (N, ny): cost ``rho``, half its slope ``psi``, weight ``psi / r`` and half its curvature; NaN stays NaN."""
        t, k = r / self.scale, self.threshold
        if self.kind == LossKind.HUBER:
            inside = ~(np.abs(t) > k)
            size = np.where(inside, 1.0, np.abs(t))
            rho = np.where(inside, t**2, 2 * k * size - k**2)
            weight = np.where(inside, 1.0, k / size)
            curvature = np.where(inside, 1.0, 0.0)
        else:
            rho = (k + 1) * np.log1p(t**2 / k)
            weight = (k + 1) / (k + t**2)
            curvature = (k + 1) * (k - t**2) / (k + t**2) ** 2
        return self.scale**2 * rho, weight * r, weight, curvature

    def mean_curvature(self, r: np.ndarray) -> np.ndarray:
        """The mean of ``rho'' / 2`` over the residuals (N, ny) of each output: what the loss leaves of the information."""
        is_measured = np.isfinite(r)
        total = np.where(is_measured, self.terms(np.where(is_measured, r, 0.0))[3], 0.0).sum(axis=0)
        return np.maximum(total / np.maximum(is_measured.sum(axis=0), 1), self.policy.least_curvature)

    def least(self) -> np.ndarray:
        """Mean of ``psi^2`` over that of the curvature (ny,) for normal noise of variance one: 1 for least squares, less otherwise."""
        t = np.linspace(-NORMAL_QUADRATURE_WIDTH, NORMAL_QUADRATURE_WIDTH, NORMAL_QUADRATURE_POINTS)
        w = np.exp(-(t**2) / 2)
        _, psi, _, curvature = self.terms(np.repeat(t[:, None], len(self.scale), axis=1))
        return (w @ psi**2) / (w @ curvature)

    def outliers(self, r: np.ndarray) -> np.ndarray:
        """Which residuals (N, ny) count for much less than they would in least squares."""
        is_measured = np.isfinite(r)
        weight = self.terms(np.where(is_measured, r, 0.0))[2]
        return is_measured & (weight < self.policy.outlier_weight * self.terms(np.zeros_like(r))[2])


def parse_loss(text: str, policy: RobustLossPolicy = DEFAULT_POLICY.robust_loss) -> RobustLoss | None:
    """``huber``, ``student``, or either with its threshold, ``huber:2``; None for ``squares``. Raises ModelError for other text.

    ``policy`` has the threshold that is taken where none is given.
    """
    kind, colon, value = text.partition(":")
    kinds = [str(known) for known in LossKind]
    if kind not in kinds:
        raise ModelError(f"unknown loss {kind!r}; {nearest(kind, kinds)}")
    if kind == LossKind.SQUARES and not colon:
        return None
    try:
        usual = policy.student_freedom if kind == LossKind.STUDENT else policy.huber_threshold
        threshold = float(value) if colon else usual
    except ValueError:
        threshold = math.nan
    if kind == LossKind.SQUARES or not (math.isfinite(threshold) and threshold > 0):
        raise ModelError(
            f"loss {text!r}: write huber:K with the threshold K in noise standard deviations, student:K with K degrees of freedom,"
            " K above zero, or squares"
        )
    return RobustLoss(kind, threshold, policy=policy)
