"""Single shooting with coloured measurement noise: residuals and sensitivities pass an autoregressive filter."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from greybox.integrators import Step
from greybox.kernel import Kernel, Record
from greybox.noise import AutoRegression
from greybox.transcription.decision_vector import DecisionVector
from greybox.transcription.single_shooting import Evaluation, SingleShooting, add_prior_penalty

Terms = tuple[np.ndarray, np.ndarray, np.ndarray]


class WhitenedShooting(SingleShooting):
    """Cost of the free-run error in units of its own innovations: minus twice the log-likelihood of autoregressive noise.

    ``colour`` (ny,) holds the autoregression of each output's noise. The filter begins anew after gaps, with the exact weights of
    the first samples (`AutoRegression.whiten`). Samples count as evenly spaced. A pass keeps the whole Jacobian
    (N, ny, L) of a record in memory, where white noise needs only sums.
    """

    def __init__(
        self, variables: DecisionVector, step: Step, kernel: Kernel, records: Sequence[Record], weight: np.ndarray,
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
            for e, (r, jacobian) in enumerate(self.whitened(z)):
                there = np.isfinite(self.records[e].samples(self.records[e].y[: self.rows[e]]))
                r, jacobian = r[: len(there)], jacobian[: len(there)]
                lost = there & ~(np.isfinite(r) & np.isfinite(jacobian).all(axis=2))
                if lost.any():
                    return _impossible(v.size, ny, (e, int(np.flatnonzero(lost.any(axis=1))[0])))
                cost, psi, weight = self.terms(np.where(there, r, 0.0))
                columns, rows = v.columns(e), jacobian[there]
                gradient[columns] += 2 * rows.T @ psi[there]
                hessian[np.ix_(columns, columns)] += 2 * rows.T @ (weight[there][:, None] * rows)
                squares += np.where(there, cost, 0.0).sum(axis=0)
                counts += there.sum(axis=0)
        if not np.isfinite(squares.sum()):
            return _impossible(v.size, ny, (0, 0))
        return add_prior_penalty(v, z, Evaluation(float(squares.sum()), gradient, hessian, squares, counts))

    def terms(self, r: np.ndarray) -> Terms:
        """Cost, half its slope and weight of each residual (N, ny)."""
        return r**2, r, np.ones_like(r)

    def residuals(self, z: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        """For each record the whitened residuals (N, ny) and their Jacobian (N, ny, L) along `columns`."""
        return self.whitened(z)

    def whitened(self, z: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        """For each record the free-run residuals (N, ny) and their Jacobian (N, ny, L) in units of their innovations."""
        if not any(colour.order for colour in self.colour):
            return super().residuals(z)
        result = []
        for r, jacobian in super().residuals(z):
            both = np.concatenate([r[:, :, None], jacobian], axis=2)
            white = np.stack([colour.whiten(both[:, j]) for j, colour in enumerate(self.colour)], axis=1)
            result.append((white[:, :, 0], white[:, :, 1:]))
        return result


def _impossible(size: int, outputs: int, failed: tuple[int, int]) -> Evaluation:
    """The evaluation of a point that cannot be simulated."""
    return Evaluation(np.inf, np.zeros(size), np.zeros((size, size)), np.zeros(outputs), np.zeros(outputs, int), failed)
