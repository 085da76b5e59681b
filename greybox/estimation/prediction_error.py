"""Minus twice the log-likelihood of a model with process noise, by its Kalman filter: unknowns, cost, slopes, innovations and runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from greybox.errors import FitError
from greybox.estimation.policy import LikelihoodSearchPolicy
from greybox.filtering import InnovationSensitivities, KalmanFilter, predict_outputs
from greybox.filtering.batch_filter import BatchFilter
from greybox.filtering.kalman_filter import LOG_TWO_PI
from greybox.kernel import Record
from greybox.transcription import DecisionVector, Evaluation
from greybox.transcription.problem import EstimationProblem


@dataclass(frozen=True)
class LikelihoodUnknowns:
    """``z = [z of the variables; log(noise / level)]``; the second part for the outputs whose noise is estimated.

    ``level`` (ny,) standard deviation of each output's noise at ``z = 0``, ``estimated`` (ny,) bool, ``least`` (ny,) below which it is
    not followed, and ``greatest`` the logarithm of its ratio to ``level`` above which it is not.
    """

    variables: DecisionVector
    level: np.ndarray
    estimated: np.ndarray
    least: np.ndarray
    greatest: float

    @property
    def size(self) -> int:
        """Length of ``z``."""
        return self.variables.size + int(self.estimated.sum())

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Bounds on ``z``."""
        low, high = self.variables.bounds()
        floor = np.minimum(np.log(self.least / self.level)[self.estimated], 0.0)
        return np.concatenate([low, floor]), np.concatenate([high, np.full(len(floor), self.greatest)])

    def noise(self, z: np.ndarray) -> np.ndarray:
        """Standard deviation of each output's noise (ny,)."""
        level = self.level.copy()
        level[self.estimated] *= np.exp(z[self.variables.size :])
        return level

    def columns(self, experiment: int) -> np.ndarray:
        """Which entries of ``z`` concern one experiment."""
        return np.concatenate([self.variables.columns(experiment), np.arange(self.variables.size, self.size)])

    def parameters(self, z: np.ndarray, experiment: int) -> np.ndarray:
        """What the filter calls parameters, ``[p; noise]`` (np + ny,), in one experiment."""
        return np.concatenate([self.variables.parameters(z[: self.variables.size], experiment), self.noise(z)])

    def slopes(self, pn: np.ndarray, experiment: int) -> np.ndarray:
        """Slopes (np + ny, L) of ``parameters`` along `columns`."""
        v = self.variables
        n, constants = len(pn) - len(self.level), len(v.which)
        lanes = self.columns(experiment)
        result = np.zeros((len(pn), len(lanes)))
        result[v.which, np.arange(constants)] = v.slopes(pn[:n], experiment)
        outputs = np.flatnonzero(self.estimated)
        result[n + outputs, len(lanes) - len(outputs) + np.arange(len(outputs))] = pn[n + outputs]
        return result

    def compute_initial_state(self, z: np.ndarray, pn: np.ndarray, experiment: int) -> tuple[np.ndarray, np.ndarray]:
        """First states (nx,) of an experiment and their slopes (nx, L) along `columns`."""
        v = self.variables
        x0, dx0 = v.compute_initial_state(z[: v.size], pn[: len(pn) - len(self.level)], experiment)
        return x0, np.hstack([dx0, np.zeros((len(x0), int(self.estimated.sum())))])

    def moved(self, z: np.ndarray) -> LikelihoodUnknowns:
        """The same with ``z = 0`` at the given point."""
        return replace(self, variables=self.variables.recentre(z[: self.variables.size]), level=self.noise(z))

    def rescale(self, count: int, curvature: np.ndarray) -> LikelihoodUnknowns:
        """Linear scales such that a step of one changes ``-2 log L`` by about ``count``.

        ``curvature`` (size,) is the diagonal of half its Hessian.
        """
        v = self.variables
        return replace(self, variables=v.rescale(float(count), curvature[: v.size]))


def make_likelihood_unknowns(
    problem: EstimationProblem, variables: DecisionVector, policy: LikelihoodSearchPolicy
) -> LikelihoodUnknowns:
    """``variables`` with the noise of the outputs: known where it is given or a quiet record tells it, else estimated."""
    measured = np.any([np.isfinite(r.y).any(axis=0) for r in problem.records], axis=0)
    sources = problem.noise.sources
    known = np.array([o.name in sources and sources[o.name].is_independent for o in problem.model.outputs])
    return LikelihoodUnknowns(
        variables, problem.noise.std, measured & ~known, policy.least_noise * problem.noise.std, policy.greatest_noise
    )


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
            with np.errstate(all="ignore"):  # what is not finite is reported
                total -= 2 * self.kalman.run(record, pn, u.compute_initial_state(z, pn, e)[0]).log_likelihood
        return float(total) if np.isfinite(total) else np.inf

    def slopes(self, z: np.ndarray, experiments: Sequence[int] | None = None) -> list[InnovationSensitivities | None]:
        """Innovations of each of the ``experiments`` (None: all) with their slopes along `LikelihoodUnknowns.columns`."""
        u = self.unknowns
        sensitivities = []
        for e in range(len(self.records)) if experiments is None else experiments:
            pn = u.parameters(z, e)
            x0, dx0 = u.compute_initial_state(z, pn, e)
            with np.errstate(all="ignore"):
                sensitivities.append(self.kalman.slopes(self.records[e], pn, u.slopes(pn, e), x0, dx0))
        return sensitivities

    def evaluate(self, z: np.ndarray) -> Evaluation:
        """Cost, gradient and Fisher's expected Hessian ``2 J'J + L'L``, ``J`` the slope of ``v`` over ``s`` and ``L`` of ``log s^2``."""
        u, ny = self.unknowns, len(self.unknowns.level)
        n = len(u.variables.which)
        gradient, hessian = np.zeros(u.size), np.zeros((u.size, u.size))
        squares, counts = np.zeros(ny), np.zeros(ny, int)
        cost, slope, curvature = u.variables.penalty(z[: u.variables.size])
        gradient[:n] += slope
        hessian[np.arange(n), np.arange(n)] += curvature
        for e, innovations in enumerate(self.slopes(z)):
            if innovations is None:
                nothing = np.zeros(u.size), np.zeros((u.size, u.size)), np.zeros(ny), np.zeros(ny, int)
                return Evaluation(np.inf, *nothing, (e, 0))
            columns = u.columns(e)
            mean = innovations.mean_slopes
            gradient[columns] += 2 * innovations.e @ innovations.de + innovations.dlog_variance.sum(axis=0)
            hessian[np.ix_(columns, columns)] += (
                2 * mean.T @ mean + innovations.dlog_variance.T @ innovations.dlog_variance
            )
            cost += float(np.sum(innovations.e**2 + innovations.logarithm + LOG_TWO_PI))
            squares += np.bincount(innovations.outputs, innovations.e**2, ny)
            counts += np.bincount(innovations.outputs, minlength=ny)
        return Evaluation(cost, gradient, hessian, squares, counts)

    def gradient(self, z: np.ndarray, experiments: Sequence[int] | None = None) -> np.ndarray:
        """The gradient (size,) alone, of the records of some ``experiments``; NaN where a run overflows."""
        u = self.unknowns
        total = np.zeros(u.size)
        for e, innovations in zip(experiments or range(len(self.records)), self.slopes(z, experiments), strict=True):
            if innovations is None:
                return np.full(u.size, np.nan)
            total[u.columns(e)] += 2 * innovations.e @ innovations.de + innovations.dlog_variance.sum(axis=0)
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
        for record, innovations in zip(self.records, self.slopes(np.zeros(self.unknowns.size)), strict=True):
            rows = np.zeros((len(record.y), 0 if innovations is None else innovations.de.shape[1]))
            if innovations is not None:
                np.add.at(
                    rows, innovations.rows, innovations.e[:, None] * innovations.de + 0.5 * innovations.dlog_variance
                )
            result.append(rows)
        return result


# Outputs (N, ny) and states (N, nx) of each record.
Runs = tuple[tuple[np.ndarray, np.ndarray], ...]


def compute_free_runs(cost: PredictionErrorObjective) -> Runs:
    """For each record outputs (N, ny) and states (N, nx) without any correction, at ``z = 0``."""
    result = []
    for e, record in enumerate(cost.records):
        pn, x0 = evaluate_initial_state(cost, e)
        states = cost.kalman.simulate_free_run(record, pn, x0)
        y, _ = BatchFilter(cost.kalman, record, pn).outputs(states, np.arange(len(states)))
        result.append((y, states))
    return tuple(result)


def compute_one_step_runs(cost: PredictionErrorObjective) -> Runs:
    """For each record outputs (N, ny) and states (N, nx) given the measurements before each row, at ``z = 0``."""
    result = []
    for e, record in enumerate(cost.records):
        pn, x0 = evaluate_initial_state(cost, e)
        states = cost.kalman.run(record, pn, x0).predicted
        y, _ = BatchFilter(cost.kalman, record, pn).outputs(states, np.arange(len(states)))
        result.append((y, states))
    return tuple(result)


def predict_ahead(cost: PredictionErrorObjective, steps: int) -> list[np.ndarray]:
    """Outputs (samples, ny) of each record given the measurements up to ``steps`` samples before, at ``z = 0``."""
    return [
        predict_outputs(cost.kalman, r, *evaluate_initial_state(cost, e), steps) for e, r in enumerate(cost.records)
    ]


def evaluate_initial_state(cost: PredictionErrorObjective, experiment: int) -> tuple[np.ndarray, np.ndarray]:
    """``[p; noise]`` (np + ny,) and first states (nx,) of an experiment at ``z = 0``."""
    z = np.zeros(cost.unknowns.size)
    pn = cost.unknowns.parameters(z, experiment)
    return pn, cost.unknowns.compute_initial_state(z, pn, experiment)[0]


@dataclass(frozen=True, eq=False)
class Innovations:
    """Innovations (N, ny) of each record, NaN in gaps, and what they tell: the slopes (N, ny, L) of their mean over their standard
    deviation and of the logarithm of their variance; ``evaluation`` of the likelihood at the optimum.
    """

    rows: tuple[tuple[np.ndarray, np.ndarray, np.ndarray], ...]
    evaluation: Evaluation


def compute_innovations(cost: PredictionErrorObjective) -> Innovations:
    """The innovations at ``z = 0`` of a likelihood. Raises FitError where its filter is not finite."""
    zero = np.zeros(cost.unknowns.size)
    rows = []
    for record, run in zip(cost.records, cost.slopes(zero), strict=True):
        if run is None:
            title = cost.unknowns.variables.model.title
            raise FitError(f"fit of {title}: its filter is not finite at the fitted parameters; fit again")
        e = np.full(record.y.shape, np.nan)
        mean, logarithm = (np.full((*record.y.shape, run.de.shape[1]), np.nan) for _ in range(2))
        e[run.rows, run.outputs] = run.e
        mean[run.rows, run.outputs], logarithm[run.rows, run.outputs] = (
            run.mean_slopes,
            run.dlog_variance,
        )
        rows.append((record.samples(e), record.samples(mean), record.samples(logarithm)))
    return Innovations(tuple(rows), cost.evaluate(zero))
