"""Single shooting with coloured measurement noise: residuals and sensitivities pass an autoregressive filter."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from greybox.integrators import Step
from greybox.kernel import Kernel, Record
from greybox.noise import AutoRegression
from greybox.transcription.shooting import Evaluation, SingleShooting
from greybox.transcription.variables import Variables


class WhitenedShooting(SingleShooting):
    """Cost of the free-run error in units of its own innovations: minus twice the log-likelihood of autoregressive noise.

    ``colour`` (ny,) holds the autoregression of each output's noise. The filter begins anew after gaps, with the exact weights of
    the first samples (`AutoRegression.whiten`). Samples count as evenly spaced. A pass keeps the whole Jacobian
    (N, ny, L) of a record in memory, where white noise needs only sums.
    """

    def __init__(
        self, variables: Variables, step: Step, kernel: Kernel, records: Sequence[Record], weight: np.ndarray,
        colour: Sequence[AutoRegression], share: float = 1.0,
    ):  # fmt: skip
        super().__init__(variables, step, kernel, records, weight, share)
        self.colour = tuple(colour)

    def evaluate(self, z: np.ndarray) -> Evaluation:
        """Cost and derivatives at ``z``."""
        v, ny = self.variables, len(self.weight)
        gradient, hessian = np.zeros(v.size), np.zeros((v.size, v.size))
        squares, counts = np.zeros(ny), np.zeros(ny, int)
        with np.errstate(all="ignore"):  # what is not finite is found and reported
            for e, (r, jacobian) in enumerate(self.residuals(z)):
                there = np.isfinite(self.records[e].y[: self.rows[e]])
                r, jacobian = r[: self.rows[e]], jacobian[: self.rows[e]]
                lost = there & ~(np.isfinite(r) & np.isfinite(jacobian).all(axis=2))
                if lost.any():
                    failed = (e, int(np.flatnonzero(lost.any(axis=1))[0]))
                    return Evaluation(
                        np.inf, np.zeros(v.size), np.zeros((v.size, v.size)), np.zeros(ny), np.zeros(ny, int), failed
                    )
                columns = v.columns(e)
                rows = jacobian[there]
                gradient[columns] += 2 * rows.T @ r[there]
                hessian[np.ix_(columns, columns)] += 2 * rows.T @ rows
                squares += np.square(np.where(there, r, 0.0)).sum(axis=0)
                counts += there.sum(axis=0)
        cost = float(squares.sum())
        if not np.isfinite(cost):
            return Evaluation(
                np.inf, np.zeros(v.size), np.zeros((v.size, v.size)), np.zeros(ny), np.zeros(ny, int), (0, 0)
            )
        return Evaluation(cost, gradient, hessian, squares, counts)

    def residuals(self, z: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        """For each record the whitened residuals (N, ny) and their Jacobian (N, ny, L) along `columns`."""
        result = []
        for r, jacobian in super().residuals(z):
            both = np.concatenate([r[:, :, None], jacobian], axis=2)
            white = np.stack([colour.whiten(both[:, j]) for j, colour in enumerate(self.colour)], axis=1)
            result.append((white[:, :, 0], white[:, :, 1:]))
        return result
