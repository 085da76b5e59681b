"""Single shooting with a robust loss: outliers are measured with the others, and cannot pull the constants away."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from greybox.integrators import Step
from greybox.kernel import Kernel, Record
from greybox.noise import AutoRegression
from greybox.transcription.decision_vector import DecisionVector
from greybox.transcription.robust_loss import RobustLoss
from greybox.transcription.whitened_shooting import Terms, WhitenedShooting


class RobustShooting(WhitenedShooting):
    """Cost ``sum rho(r)`` of the free-run error ``r``, whitened first where its colour is known, with the loss ``rho`` of `RobustLoss`.

    The Hessian weighs each residual as the loss does, ``2 J' W J`` with ``W = psi(r) / r`` (iteratively reweighted least squares): never
    indefinite, and never too small where ``rho`` bends down.
    """

    def __init__(
        self, variables: DecisionVector, step: Step, kernel: Kernel, records: Sequence[Record], weight: np.ndarray,
        colour: Sequence[AutoRegression], loss: RobustLoss, share: float = 1.0,
    ):  # fmt: skip
        super().__init__(variables, step, kernel, records, weight, colour, share)
        self.loss = loss

    def terms(self, r: np.ndarray) -> Terms:
        """Cost, half its slope and weight of each residual (N, ny)."""
        rho, psi, weight, _ = self.loss.terms(r)
        return rho, psi, weight

    def residuals(self, z: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        """For each record residuals (N, ny) and Jacobian (N, ny, L) of the least-squares problem that the optimum also solves.

        With ``m`` the mean curvature of the loss for each output they are ``psi(r) / sqrt(m)`` and ``sqrt(m) J``: gradient and
        curvature are those of the robust cost, and the spread of the residual is what outliers leave of it, so that every
        statement about least squares (covariance, bootstrap, tests) holds for the robust fit (Huber 1981, chapter 7).
        """
        raw = self.whitened(z)
        m = np.sqrt(self.loss.mean_curvature(np.concatenate([r for r, _ in raw])))
        return [(self.loss.terms(r)[1] / m, m[:, None] * jacobian) for r, jacobian in raw]
