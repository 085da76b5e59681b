"""What an estimation minimises: the simulation error or the prediction error of a model, over one decision vector.

Both are costs at a point ``z`` with gradient and Gauss-Newton or Fisher matrix from the kernel. The simulation error is that of free
runs; the prediction error is minus twice the log-likelihood of the innovations of a Kalman filter, which is a step of the same kernel.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, Protocol, Self

import numpy as np

from greybox.estimation.transcription.decision_vector import DecisionVector, NoiseLevels
from greybox.estimation.transcription.problem import EstimationProblem
from greybox.estimation.transcription.simulation_error import Evaluation
from greybox.estimation.transcription.solution import Runs
from greybox.simulation.filtering.kalman_filter import LOG_TWO_PI, InnovationSensitivities, KalmanFilter
from greybox.simulation.filtering.smoother import BatchFilter, predict_outputs
from greybox.simulation.kernel.record import Record

# The noise of an output is not followed below this share of what the records' differences say.
LEAST_NOISE = 0.0001
# Nor above its start times the exponential of this.
GREATEST_NOISE = 25.0


def add_noise_levels(variables: DecisionVector, problem: EstimationProblem) -> DecisionVector:
    """``variables`` with the noise of the outputs: known where it is given or a quiet record tells it, else estimated with the rest."""
    measured = np.any([np.isfinite(r.y).any(axis=0) for r in problem.records], axis=0)
    sources = problem.noise.sources
    known = np.array([o.name in sources and sources[o.name].is_independent for o in problem.model.outputs])
    std = problem.noise.std
    return replace(variables, noise=NoiseLevels(std, measured & ~known, LEAST_NOISE * std, GREATEST_NOISE))


@dataclass(frozen=True, eq=False)
class ResidualRows:
    """What the data tell of the unknowns at the present point, record by record along `DecisionVector.columns`.

    ``rows``: weighted residuals or innovations (N, ny), NaN in gaps, and the slopes (N, ny, L) of their mean over their standard
    deviation. ``log_variance``: of innovations the slopes (N, ny, L) of the logarithm of their variance.
    """

    rows: Runs
    log_variance: Sequence[np.ndarray] = ()

    @property
    def scores(self) -> list[np.ndarray]:
        """Slope (N, L) of half the cost by row; they add up to half the gradient but for the priors."""
        # d(cost / 2) = e de_mean
        result = [np.nansum(r[:, :, None] * slopes, axis=1) for r, slopes in self.rows]
        for score, (r, _), slopes in zip(result, self.rows, self.log_variance, strict=False):
            # ... + (1 - e^2) / 2 dlog s^2: a variance above the squares it explains costs as one below them.
            score += np.nansum(0.5 * (1 - r[:, :, None] ** 2) * slopes, axis=1)
        return result

    def compute_information(self, variables: DecisionVector) -> np.ndarray:
        """Half the expected curvature (size, size) of the cost, without priors."""
        total = np.zeros((variables.size, variables.size))
        for e, (r, slopes) in enumerate(self.rows):
            measured, block = np.isfinite(r), np.ix_(variables.columns(e), variables.columns(e))
            total[block] += slopes[measured].T @ slopes[measured]
            if self.log_variance:
                louder = self.log_variance[e][measured]
                # Fisher's information of a normal variance: (1/2) L'L.
                total[block] += 0.5 * louder.T @ louder
        return total


class Objective(Protocol):
    """A cost over a decision vector. What takes no ``z`` is that of the present point."""

    @property
    def variables(self) -> DecisionVector:
        """The decision vector; ``z = 0`` is the present point."""

    @property
    def squares(self) -> int | None:
        """How many squares the cost sums up; None for a likelihood."""

    def at(self, variables: DecisionVector) -> Self:
        """The same cost over other variables."""

    def evaluate(self, z: np.ndarray) -> Evaluation:
        """The cost with its quadratic model at ``z``."""

    def linearise(self) -> ResidualRows | None:
        """The residuals with their slopes; None where the run is not finite."""

    def halve_step(self) -> Self:
        """The same with half the integration step, where that is not exact."""


@dataclass(frozen=True)
class SimulationErrorObjective:
    """Squares of the free-run error over its noise, whitened where that is coloured, or a robust loss of them; and the priors.

    The noise is not estimated with the rest, but in turn with it (`greybox.estimation.noise_loop`).
    """

    problem: EstimationProblem

    @property
    def variables(self) -> DecisionVector:
        """The constants and initial states of the problem."""
        return self.problem.variables

    @property
    def squares(self) -> int:
        """Number of measurements."""
        return sum(int(np.isfinite(r.y).sum()) for r in self.problem.records)

    def at(self, variables: DecisionVector) -> SimulationErrorObjective:
        """The same cost over other variables."""
        return SimulationErrorObjective(replace(self.problem, variables=variables))

    def evaluate(self, z: np.ndarray) -> Evaluation:
        """Cost, gradient and Gauss-Newton matrix."""
        return self.problem.shooting().evaluate(z)

    def linearise(self) -> ResidualRows:
        """The weighted residuals with their slopes."""
        return ResidualRows(tuple(self.problem.shooting().residuals(self.variables.here)))

    def halve_step(self) -> SimulationErrorObjective:
        """The same with half the integration step."""
        return SimulationErrorObjective(self.problem.halve_step())


@dataclass(frozen=True)
class PredictionErrorObjective:
    """``-2 log L = sum (v / s)^2 + 2 log s + log(2 pi)`` over all innovations ``v`` with their standard deviations ``s``, and the priors.

    The first states are unknowns (`greybox.simulation.filtering.kalman_filter`), exact ones without process noise, so that it is then
    the free-run cost plus a constant (where the noise of the outputs is known).
    """

    variables: DecisionVector
    kalman: KalmanFilter
    records: tuple[Record, ...]

    @classmethod
    def of(cls, problem: EstimationProblem) -> PredictionErrorObjective:
        """The likelihood of the records of ``problem``."""
        known_start = not problem.variables.initial.free.any()
        kalman = KalmanFilter.of(problem.model.system, problem.step, known_start=known_start)
        return cls(add_noise_levels(problem.variables, problem), kalman, problem.records)

    def at(self, variables: DecisionVector) -> PredictionErrorObjective:
        """The same cost over other variables."""
        return replace(self, variables=variables)

    def halve_step(self) -> PredictionErrorObjective:
        """The same with half the integration step."""
        return replace(self, kalman=self.kalman.with_substeps(2 * self.kalman.step.substeps))

    @property
    def squares(self) -> None:
        """It is a likelihood."""

    @property
    def noise(self) -> np.ndarray:
        """Standard deviation of each output's noise (ny,)."""
        return self.variables.noise_levels(self.variables.here)

    def cost(self) -> float:
        """The cost alone; infinite where a run overflows."""
        total = self.variables.penalty(self.variables.here)[0]
        for e, record in enumerate(self.records):
            with np.errstate(all="ignore"):  # what is not finite is reported
                total -= 2 * self.kalman.run(record, *self.start(e)).log_likelihood
        return float(total) if np.isfinite(total) else np.inf

    def start(self, experiment: int) -> tuple[np.ndarray, np.ndarray]:
        """``[p; noise]`` (np + ny,) and first states (nx,) of an experiment."""
        v = self.variables
        p = v.parameters(v.here, experiment)
        return np.concatenate([p, v.noise_levels(v.here)]), v.compute_initial_state(v.here, p, experiment)[0]

    def slopes(self, z: np.ndarray, experiments: Sequence[int] | None = None) -> list[InnovationSensitivities | None]:
        """Innovations of each of the ``experiments`` (None: all) with their slopes along `DecisionVector.columns`."""
        v, estimated = self.variables, self.variables.estimated_noise
        sensitivities = []
        for e in range(len(self.records)) if experiments is None else experiments:
            p, noise = v.parameters(z, e), v.noise_levels(z)
            x0, dx0 = v.compute_initial_state(z, p, e)
            lanes, dpn = dx0.shape[1], np.zeros((len(p) + len(noise), dx0.shape[1]))
            # dp/dz of the constants, and dnoise/dz below, in the columns that concern this experiment.
            dpn[v.which, np.arange(len(v.which))] = v.slopes(p, e)
            # The level is noise exp(z): its slope along z is the level itself.
            dpn[len(p) + estimated, lanes - len(estimated) + np.arange(len(estimated))] = noise[estimated]
            with np.errstate(all="ignore"):
                pn = np.concatenate([p, noise])
                sensitivities.append(self.kalman.slopes(self.records[e], pn, dpn, x0, dx0))
        return sensitivities

    def evaluate(self, z: np.ndarray) -> Evaluation:
        """Cost, gradient and Fisher's expected Hessian ``2 J'J + L'L``, ``J`` the slope of ``v`` over ``s`` and ``L`` of ``log s^2``."""
        v, ny = self.variables, self.kalman.sizes[1]
        n = len(v.which)
        gradient, hessian = np.zeros(v.size), np.zeros((v.size, v.size))
        squares, counts = np.zeros(ny), np.zeros(ny, int)
        # Priors count once, not once a record.
        cost, slope, curvature = v.penalty(z)
        gradient[:n] += slope
        hessian[np.arange(n), np.arange(n)] += curvature
        for e, innovations in enumerate(self.slopes(z)):
            sums = None if innovations is None else _sum_innovations(innovations)
            if innovations is None or sums is None:
                nothing = np.zeros(v.size), np.zeros((v.size, v.size)), np.zeros(ny), np.zeros(ny, int)
                return Evaluation(np.inf, *nothing, (e, 0))
            columns = v.columns(e)
            gradient[columns] += sums.gradient
            # First states of other experiments have no part in it.
            hessian[np.ix_(columns, columns)] += sums.hessian
            cost += sums.cost
            squares += np.bincount(innovations.outputs, innovations.e**2, ny)
            counts += np.bincount(innovations.outputs, minlength=ny)
        return Evaluation(cost, gradient, hessian, squares, counts)

    def gradient(self, z: np.ndarray, experiments: Sequence[int] | None = None) -> np.ndarray:
        """The gradient (size,) alone, of the records of some ``experiments``; NaN where a run overflows."""
        v = self.variables
        total = np.zeros(v.size)
        for e, innovations in zip(experiments or range(len(self.records)), self.slopes(z, experiments), strict=True):
            if innovations is None:
                return np.full(v.size, np.nan)
            total[v.columns(e)] += 2 * innovations.e @ innovations.de + innovations.dlog_variance.sum(axis=0)
        return total

    def innovations(self) -> list[np.ndarray]:
        """Standardised innovations (N, ny) of each record, NaN in gaps."""
        return [self.kalman.run(r, *self.start(e)).innovation for e, r in enumerate(self.records)]

    def linearise(self) -> ResidualRows | None:
        """The innovations with their slopes; None where the filter is not finite."""
        rows, log_variance = [], []
        for record, run in zip(self.records, self.slopes(self.variables.here), strict=True):
            if run is None:
                return None
            e = np.full(record.y.shape, np.nan)
            mean, logarithm = (np.full((*record.y.shape, run.de.shape[1]), np.nan) for _ in range(2))
            e[run.rows, run.outputs] = run.e
            mean[run.rows, run.outputs], logarithm[run.rows, run.outputs] = run.mean_slopes, run.dlog_variance
            rows.append((record.samples(e), record.samples(mean)))
            log_variance.append(record.samples(logarithm))
        return ResidualRows(tuple(rows), tuple(log_variance))

    def simulate(self) -> Runs:
        """For each record outputs (N, ny) and states (N, nx) without any correction."""
        return self._evaluate_outputs(lambda e: self.kalman.simulate_free_run(self.records[e], *self.start(e)))

    def predict_one_step(self) -> Runs:
        """For each record outputs (N, ny) and states (N, nx) given the measurements before each row."""
        return self._evaluate_outputs(lambda e: self.kalman.run(self.records[e], *self.start(e)).predicted)

    def predict_ahead(self, steps: int) -> list[np.ndarray]:
        """Outputs (samples, ny) of each record given the measurements up to ``steps`` samples before."""
        return [predict_outputs(self.kalman, r, *self.start(e), steps) for e, r in enumerate(self.records)]

    def _evaluate_outputs(self, states: Callable[[int], np.ndarray]) -> Runs:
        """Outputs of the states (N, nx) of each experiment, and these."""
        runs = []
        for e, record in enumerate(self.records):
            x = states(e)
            y, _ = BatchFilter(self.kalman, record, self.start(e)[0]).outputs(x, np.arange(len(x)))
            runs.append((y, x))
        return tuple(runs)


class _LikelihoodSums(NamedTuple):
    """What one record adds to the cost, its gradient (L,) and its expected Hessian (L, L)."""

    cost: float
    gradient: np.ndarray
    hessian: np.ndarray


def _sum_innovations(innovations: InnovationSensitivities) -> _LikelihoodSums | None:
    """None where squares overflow although the numbers themselves do not."""
    with np.errstate(over="ignore", invalid="ignore"):
        mean = innovations.mean_slopes
        sums = _LikelihoodSums(
            float(np.sum(innovations.e**2 + innovations.logarithm + LOG_TWO_PI)),
            2 * innovations.e @ innovations.de + innovations.dlog_variance.sum(axis=0),
            # 2 J'J + L'L: twice the expected information, as the cost is -2 log L.
            2 * mean.T @ mean + innovations.dlog_variance.T @ innovations.dlog_variance,
        )
    is_finite = np.isfinite(sums.cost) and np.isfinite(sums.gradient).all() and np.isfinite(sums.hessian).all()
    return sums if is_finite else None
