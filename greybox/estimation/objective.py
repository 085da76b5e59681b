"""What an estimation minimises, the simulation error or the prediction error of a model over one decision vector, and its minimum.

Both are costs at a point ``z`` with gradient and Gauss-Newton or Fisher matrix from the kernel. The simulation error is that of free
runs; the prediction error is minus twice the log-likelihood of the innovations of a Kalman filter, which is a step of the same kernel.
A minimum is searched for from far off, and by damped Gauss-Newton or scoring steps nearby.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Generic, Protocol, Self, TypeVar

import numpy as np

from greybox.estimation.optim.methods import MinimisationMethod, minimise
from greybox.estimation.optim.minimisation import Termination, TerminationPolicy, TerminationStatus
from greybox.estimation.options import FitOptions
from greybox.estimation.transcription.decision_vector import DecisionVector, NoiseLevels
from greybox.estimation.transcription.problem import EstimationProblem, FitProgress, FitProgressCallback, Runs
from greybox.estimation.transcription.shooting_cost import Evaluation
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

    def with_records(self, records: tuple[Record, ...]) -> Self:
        """The same over other records of the same rows."""


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

    def with_records(self, records: tuple[Record, ...]) -> SimulationErrorObjective:
        """The same over other records of the same rows."""
        return SimulationErrorObjective(replace(self.problem, records=records))


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

    def with_records(self, records: tuple[Record, ...]) -> PredictionErrorObjective:
        """The same over other records of the same rows."""
        return replace(self, records=records)

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
            if innovations is None:
                return Evaluation.failure(v.size, ny, (e, 0))
            # First states of other experiments have no part in it.
            columns, mean, louder = v.columns(e), innovations.mean_slopes, innovations.dlog_variance
            block = np.ix_(columns, columns)
            with np.errstate(over="ignore", invalid="ignore"):
                # -2 ln L = sum of e^2 + ln s^2 + ln 2 pi over the innovations.
                added = float(np.sum(innovations.e**2 + innovations.logarithm + LOG_TWO_PI))
                gradient[columns] += 2 * innovations.e @ innovations.de + louder.sum(axis=0)
                # 2 J'J + L'L: twice the expected information, as the cost is -2 log L.
                hessian[block] += 2 * mean.T @ mean + louder.T @ louder
            # Squares may overflow although the numbers themselves do not.
            if not (np.isfinite(added) and np.isfinite(gradient[columns]).all() and np.isfinite(hessian[block]).all()):
                return Evaluation.failure(v.size, ny, (e, 0))
            cost += added
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


ObjectiveT = TypeVar("ObjectiveT", bound=Objective)


@dataclass(frozen=True)
class ObjectiveMinimum(Generic[ObjectiveT]):
    """A minimum: the ``objective`` with its present point there, the evaluation, how the search ended, and the work it took."""

    objective: ObjectiveT
    evaluation: Evaluation
    status: TerminationStatus
    solver_status: str = ""
    solver: str = ""
    iterations: int = 0
    evaluations: int = 1
    seconds: float = 0.0


LikelihoodMaximum = ObjectiveMinimum[PredictionErrorObjective]


@dataclass(frozen=True)
class ProcessNoiseTest:
    """One intensity of process noise as a fit found it.

    ``ratio``: likelihood ratio, twice the gain of the logarithm over zero intensity; ``p_value``: how often chance alone gives so
    much; ``significant``: whether the records show process noise; ``limits``: one-sided 95 % limit
    (0, upper) where it is not significant, else None.
    """

    name: str
    value: float
    ratio: float
    p_value: float
    significant: bool = False
    limits: tuple[float, float] | None = None


# Where a search ends: a thousandth of a standard deviation, squared; acceptable where -2 log L fell by less than a hundredth within the
# patience, as a filter of a model with dry friction is not smooth everywhere.
LIKELIHOOD_TERMINATION = TerminationPolicy(negligible_decrease=1e-6, little_gain=1e-2)
# The same for the steps after it, so that the parameters have their digits.
LIKELIHOOD_LAST_DIGITS = TerminationPolicy(negligible_decrease=1e-12, little_gain=0.0)


def search_minimum(
    objective: ObjectiveT, options: FitOptions, report: FitProgressCallback | None = None
) -> ObjectiveMinimum[ObjectiveT]:
    """The minimum from the present point on, to the last digits."""
    begin = objective.evaluate(objective.variables.here)
    if not np.isfinite(begin.cost):
        return ObjectiveMinimum(objective, begin, TerminationStatus.NO_START)
    if not objective.variables.size:
        return ObjectiveMinimum(objective, begin, TerminationStatus.CONVERGED)
    # A step of one in ``z`` then changes the cost by about itself: IPOPT is told not to scale the problem by itself.
    objective = objective.at(objective.variables.rescale(float(max(begin.count, 1)), np.diag(begin.hessian) / 2))
    low, high = objective.variables.bounds()

    def progress(iteration: int, _: float) -> None:
        if report:
            report(FitProgress(1, 1, iteration, 1.0))

    outcome = minimise(
        objective.evaluate,
        objective.variables.here,
        low,
        high,
        scale=float(max(begin.count, 1)),
        tolerance=options.tolerance,
        iterations=options.iterations,
        termination_test=Termination(LIKELIHOOD_TERMINATION, low, high, objective.squares).test,
        thorough=False,
        progress=progress,
        policy=options.policy.minimisation,
    )
    near = objective.at(objective.variables.recentre(outcome.z))
    # IPOPT's tolerance is not the end: likelihood ratios are differences of two such costs.
    last = refine_minimum(near, options, LIKELIHOOD_LAST_DIGITS, begin=outcome.value)
    status = outcome.status
    # Steps that converge say more than the search that handed over; Ctrl-C stays an interruption.
    if last.status.success and status is not TerminationStatus.INTERRUPTED:
        status = status if status.success else TerminationStatus.CONVERGED
    return replace(
        last,
        status=status,
        solver_status=outcome.solver_status,
        solver=outcome.solver,
        iterations=outcome.iterations,
        evaluations=outcome.evaluations + 1 + last.evaluations,
        seconds=outcome.seconds,
    )


# Damped steps of Fisher scoring, or Gauss and Newton's, at most where a minimum is near.
SCORING_STEPS = 10


def refine_minimum(
    objective: ObjectiveT,
    options: FitOptions,
    termination: TerminationPolicy | None = None,
    *,
    begin: Evaluation | None = None,
) -> ObjectiveMinimum[ObjectiveT]:
    """The minimum near the present point by a few damped steps alone: cheaper than `search_minimum` where that is close already.

    ``termination``: what is nothing left to gain, as for a whole search if left out. ``begin``: the evaluation at the present point.
    """
    passes = 0 if begin else 1
    begin = begin or objective.evaluate(objective.variables.here)
    low, high = objective.variables.bounds()
    outcome = minimise(
        objective.evaluate,
        objective.variables.here,
        low,
        high,
        method=MinimisationMethod.GAUSS_NEWTON,
        value_at_start=begin,
        iterations=SCORING_STEPS,
        termination_test=Termination(termination or LIKELIHOOD_TERMINATION, low, high, objective.squares).test,
        policy=options.policy.minimisation,
    )
    return ObjectiveMinimum(
        objective.at(objective.variables.recentre(outcome.z)) if outcome.evaluations else objective,
        begin if outcome.value is None else outcome.value,
        outcome.status,
        solver=outcome.solver,
        evaluations=outcome.evaluations + passes,
        seconds=outcome.seconds,
    )


def hold_parameters(cost: ObjectiveT, values: Mapping[str, float]) -> ObjectiveT:
    """The same cost with some constants held at ``values``, in every experiment."""
    v = cost.variables
    names = [q.name for q in v.model.all_parameters]
    places = [names.index(name) for name in values]
    fixed = v.fixed.copy()
    fixed[places] = list(values.values())
    return cost.at(replace(v, fixed=fixed).hold(np.isin(v.which, places)))


def start_at(cost: PredictionErrorObjective, values: Mapping[str, float]) -> PredictionErrorObjective:
    """The same cost at other values of some free constants, by their names in the model."""
    v = cost.variables
    return cost.at(
        v.with_values(
            {label: values[q.name] for label, q in zip(v.names, v.quantities, strict=True) if q.name in values}
        )
    )


def raise_noise_to_innovations(cost: PredictionErrorObjective) -> PredictionErrorObjective:
    """``cost`` with each estimated noise as large as the innovations say, where nothing else can make them so large."""
    v = cost.variables
    squares = np.nansum(np.concatenate([r**2 for r in cost.innovations()]), axis=0)
    counts = sum(np.isfinite(r.y).sum(axis=0) for r in cost.records)
    with np.errstate(invalid="ignore", divide="ignore"):
        # Mean square of the standardised innovations is one where the level is right; it is raised, never lowered,
        # because without process noise only the level can explain them.
        growth = np.log(np.sqrt(squares / counts))[v.estimated_noise]
    z = v.here
    v.split(z).noise_levels[:] = np.where(np.isfinite(growth), np.maximum(growth, 0.0), 0.0)
    return cost.at(v.recentre(z))


def select_best_start(costs: Sequence[PredictionErrorObjective]) -> PredictionErrorObjective:
    """The one with the lowest cost at ``z = 0``; the first where none is finite."""
    return min(costs, key=lambda cost: cost.cost())
