"""Minus twice the log-likelihood of a model with process noise, by its Kalman filter, with slope and expected curvature."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from greybox.estimation.likelihood_unknowns import LikelihoodUnknowns
from greybox.filtering import InnovationSensitivities, KalmanFilter
from greybox.filtering.kalman_filter import LOG_TWO_PI
from greybox.kernel import Record
from greybox.transcription import Evaluation


@dataclass(frozen=True)
class PredictionErrorObjective:
    """``-2 log L = sum (v / s)^2 + 2 log s + log(2 pi)`` over all innovations ``v`` with their standard deviations ``s``, and the priors.

    The first states are unknowns (`greybox.filtering.initial_covariance`), exact ones without process noise, so that it is then
    the free-run
    cost plus a constant (where the noise of the outputs is known).
    """

    unknowns: LikelihoodUnknowns
    kalman: KalmanFilter
    records: tuple[Record, ...]

    def at(self, unknowns: LikelihoodUnknowns) -> PredictionErrorObjective:
        """The same cost with other unknowns."""
        return replace(self, unknowns=unknowns)

    @property
    def count(self) -> int:
        """Number of measurements."""
        return sum(int(np.isfinite(r.y).sum()) for r in self.records)

    def cost(self, z: np.ndarray | None = None) -> float:
        """The cost alone, at ``z`` or at zero; infinite where a run overflows."""
        u = self.unknowns
        z = np.zeros(u.size) if z is None else z
        total = u.variables.penalty(z[: u.variables.size])[0]
        for e, record in enumerate(self.records):
            pn = u.parameters(z, e)
            with np.errstate(all="ignore"):  # what is not finite is found and reported
                total -= 2 * self.kalman.run(record, pn, u.compute_initial_state(z, pn, e)[0]).log_likelihood
        return float(total) if np.isfinite(total) else np.inf

    def slopes(self, z: np.ndarray, experiments: Sequence[int] | None = None) -> list[InnovationSensitivities | None]:
        """Innovations of each of the ``experiments`` (None: all) with their slopes along `LikelihoodUnknowns.columns`."""
        u = self.unknowns
        found = []
        for e in range(len(self.records)) if experiments is None else experiments:
            pn = u.parameters(z, e)
            x0, dx0 = u.compute_initial_state(z, pn, e)
            with np.errstate(all="ignore"):
                found.append(self.kalman.slopes(self.records[e], pn, u.slopes(pn, e), x0, dx0))
        return found

    def evaluate(self, z: np.ndarray) -> Evaluation:
        """Cost, gradient and Fisher's expected Hessian ``2 J'J + L'L``, ``J`` the slope of ``v`` over ``s`` and ``L`` of ``log s^2``."""
        u, ny = self.unknowns, len(self.unknowns.level)
        n = len(u.variables.which)
        gradient, hessian = np.zeros(u.size), np.zeros((u.size, u.size))
        squares, counts = np.zeros(ny), np.zeros(ny, int)
        cost, slope, curvature = u.variables.penalty(z[: u.variables.size])
        gradient[:n] += slope
        hessian[np.arange(n), np.arange(n)] += curvature
        for e, found in enumerate(self.slopes(z)):
            if found is None:
                nothing = np.zeros(u.size), np.zeros((u.size, u.size)), np.zeros(ny), np.zeros(ny, int)
                return Evaluation(np.inf, *nothing, (e, 0))
            columns = u.columns(e)
            mean = found.mean_slopes
            gradient[columns] += 2 * found.e @ found.de + found.dlog_variance.sum(axis=0)
            hessian[np.ix_(columns, columns)] += 2 * mean.T @ mean + found.dlog_variance.T @ found.dlog_variance
            cost += float(np.sum(found.e**2 + found.logarithm + LOG_TWO_PI))
            squares += np.bincount(found.outputs, found.e**2, ny)
            counts += np.bincount(found.outputs, minlength=ny)
        return Evaluation(cost, gradient, hessian, squares, counts)

    def gradient(self, z: np.ndarray, experiments: Sequence[int] | None = None) -> np.ndarray:
        """The gradient (size,) alone, of the records of some ``experiments``; NaN where a run overflows."""
        u = self.unknowns
        total = np.zeros(u.size)
        for e, found in zip(experiments or range(len(self.records)), self.slopes(z, experiments), strict=True):
            if found is None:
                return np.full(u.size, np.nan)
            total[u.columns(e)] += 2 * found.e @ found.de + found.dlog_variance.sum(axis=0)
        return total

    def innovations(self) -> list[np.ndarray]:
        """Standardised innovations (N, ny) of each record at ``z = 0``, NaN in gaps."""
        u, z = self.unknowns, np.zeros(self.unknowns.size)
        return [
            self.kalman.run(r, pn := u.parameters(z, e), u.compute_initial_state(z, pn, e)[0]).innovation
            for e, r in enumerate(self.records)
        ]

    def scores(self) -> list[np.ndarray]:
        """Slope of half the cost by row (N, L) of each record at ``z = 0``, along `LikelihoodUnknowns.columns`; they add up to
        half the gradient."""
        result = []
        for record, found in zip(self.records, self.slopes(np.zeros(self.unknowns.size)), strict=True):
            rows = np.zeros((len(record.y), 0 if found is None else found.de.shape[1]))
            if found is not None:
                np.add.at(rows, found.rows, found.e[:, None] * found.de + 0.5 * found.dlog_variance)
            result.append(rows)
        return result
