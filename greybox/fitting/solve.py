"""From a problem to its optimum: a growing part of the record, then all of it, then a check of the integrator."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from greybox.fitting.options import FitOptions, Progress, Report
from greybox.fitting.problem import Problem
from greybox.integrators import substeps_for
from greybox.optimiser import Iteration, Outcome, Status, minimise
from greybox.transcription import Evaluation, SingleShooting, Variables

# A growing record begins with this many of the slowest time constants, at least so many rows, and grows by this factor.
TIME_CONSTANTS, LEAST_ROWS, GROWTH = 2.0, 60, 4.0
# The first part must contain this share of the outputs' movement.
MOVEMENT = 0.1
# While only part of the record is used, positive constants are held by a weak prior: a factor e^2 is one standard deviation.
PRIOR = 0.25
# Converged when the next Gauss-Newton step would lower chi-square by less than this (in units of the residual variance).
NEGLIGIBLE = 1e-6
# ... or when it would lower the misfit over noise by less than this (data without noise end at rounding errors).
PERFECT = 1e-7
# A cost with kinks (dry friction) never meets that rule: enough when so many iterations gained less than this share of it.
PATIENCE, LITTLE_GAIN = 12, 1e-5
# A scaled variable this close to its bound, and pushed against it, is held there.
AT_BOUND = 1e-6
# The step is halved while that changes an output by more than this share of the noise, or of the misfit.
OF_NOISE, OF_MISFIT, HALVINGS = 0.1, 0.01, 4


@dataclass(frozen=True)
class Solution:
    """The optimum: ``variables`` with ``z = 0`` there, the evaluation, how it ended, and the work it took."""

    problem: Problem
    variables: Variables
    evaluation: Evaluation
    status: Status
    solver_status: str
    iterations: int
    evaluations: int
    seconds: float
    shares: tuple[float, ...]
    integration_error: np.ndarray


def solve(problem: Problem, options: FitOptions, report: Report | None = None) -> Solution:
    """Minimise the noise-weighted free-run error of ``problem``."""
    shares = growing(problem) if options.progressive and problem.variables.size else (1.0,)
    variables, work = problem.variables, _Work()
    status, word = Status.CONVERGED, ""
    for k, share in enumerate(shares):
        variables, status, word = _stage(problem, variables, share, options, work, _reporter(report, k, len(shares), problem, share))
        if status in (Status.INTERRUPTED, Status.NO_START):
            break
    error = np.zeros(len(problem.noise.std))
    for _ in range(HALVINGS):
        evaluation = problem.shooting(variables).evaluate(np.zeros(variables.size))
        if status in (Status.INTERRUPTED, Status.NO_START) or not np.isfinite(evaluation.cost):
            break
        finer, error = _finer(problem, variables, evaluation, options)
        if finer is None:
            break
        problem = finer
        variables, status, word = _stage(problem, variables, 1.0, options, work, _reporter(report, len(shares) - 1, len(shares), problem, 1.0))
    evaluation = problem.shooting(variables).evaluate(np.zeros(variables.size))
    return Solution(problem, variables, evaluation, status, word, work.iterations, work.evaluations, work.seconds, shares, error)


@dataclass
class _Work:
    """Running totals over the stages."""

    iterations: int = 0
    evaluations: int = 0
    seconds: float = 0.0

    def add(self, outcome: Outcome) -> None:
        self.iterations += outcome.iterations
        self.evaluations += outcome.evaluations
        self.seconds += outcome.seconds


def growing(problem: Problem) -> tuple[float, ...]:
    """Shares of the record for the stages, the last one 1: the first holds a few time constants and some movement."""
    v = problem.variables
    rows = max(len(r.u) for r in problem.records)
    period = max(float(np.median(r.h)) for r in problem.records)
    eigenvalues = np.linalg.eigvals(problem.model.system.jacobian(v.initial.guess[0], problem.records[0].u[0], v.fixed).full())
    decays = -eigenvalues.real[np.isfinite(eigenvalues) & (eigenvalues.real < 0)]
    slowest = 1 / decays.min() if len(decays) else 0.0
    first = max(LEAST_ROWS, 5 * v.size, TIME_CONSTANTS * slowest / period) / rows
    first = max(first, min(_moving(r.y) for r in problem.records))
    shares = [1.0]
    while shares[0] / GROWTH >= first:
        shares.insert(0, shares[0] / GROWTH)
    if shares[0] > 1.5 * first:
        shares.insert(0, first)
    return tuple(shares)


def _moving(y: np.ndarray) -> float:
    """Share of the record after which an output has shown `MOVEMENT` of its range."""
    shares = []
    for column in y.T:
        finite = np.flatnonzero(np.isfinite(column))
        if len(finite) == 0:
            continue
        values = column[finite]
        seen = np.maximum.accumulate(values) - np.minimum.accumulate(values)
        if seen[-1] > 0:
            shares.append(finite[np.argmax(seen >= MOVEMENT * seen[-1])] / len(column))
    return min(shares, default=1.0)


def _stage(
    problem: Problem, variables: Variables, share: float, options: FitOptions, work: _Work, progress: Iteration | None
) -> tuple[Variables, Status, str]:
    """One minimisation over part of the record, begun at ``z = 0`` of ``variables``."""
    shooting = problem.shooting(variables, share)
    start = shooting.evaluate(np.zeros(variables.size))
    if not np.isfinite(start.cost):
        return variables, Status.NO_START, ""
    variables = variables.rescaled(start.cost, np.diag(start.hessian) / 2)
    shooting = problem.shooting(variables, share)
    low, high = variables.bounds()
    outcome = minimise(
        _with_prior(shooting) if share < 1 else shooting.evaluate, np.zeros(variables.size), low, high,
        scale=max(start.cost, 1e-300), tolerance=options.tolerance, iterations=options.iterations,
        finished=_finished(low, high), progress=progress,
    )  # fmt: skip
    work.add(outcome)
    return variables.moved(outcome.z), outcome.status, outcome.solver_status


def _with_prior(shooting: SingleShooting) -> Callable[[np.ndarray], Evaluation]:
    """The cost with a weak prior on positive constants, for stages that see only part of the record."""
    v = shooting.variables
    held = np.zeros(v.size)
    held[: len(v.which)] = np.where(v.logarithmic, PRIOR, 0.0)

    def evaluate(z: np.ndarray) -> Evaluation:
        e = shooting.evaluate(z)
        return replace(e, cost=e.cost + held @ z**2, gradient=e.gradient + 2 * held * z, hessian=e.hessian + np.diag(2 * held))

    return evaluate


def _finished(low: np.ndarray, high: np.ndarray) -> Callable[[np.ndarray, Evaluation], Status | None]:
    """Ends a search when a further Gauss-Newton step, off the bounds, would change nothing that matters, or none helps."""
    costs: list[float] = []

    def finished(z: np.ndarray, e: Evaluation) -> Status | None:
        inside = ~((z - low <= AT_BOUND) & (e.gradient > 0) | (high - z <= AT_BOUND) & (e.gradient < 0))
        gradient, hessian = e.gradient[inside], e.hessian[np.ix_(inside, inside)]
        decrease = 0.5 * gradient @ np.linalg.lstsq(hessian, gradient, rcond=1e-13)[0]
        if decrease <= NEGLIGIBLE * e.cost / max(e.count, 1) + PERFECT**2 * e.count:
            return Status.CONVERGED
        costs.append(e.cost)
        flat = len(costs) > PATIENCE and costs[-1 - PATIENCE] - e.cost <= LITTLE_GAIN * e.cost
        return Status.ACCEPTABLE if flat else None

    return finished


def _finer(problem: Problem, variables: Variables, evaluation: Evaluation, options: FitOptions) -> tuple[Problem | None, np.ndarray]:
    """A problem with a smaller step, if the present one is too coarse at the optimum; and its error over the noise (ny,)."""
    if problem.step.per_interval:
        return None, np.zeros(len(problem.noise.std))
    z = np.zeros(variables.size)
    runs = problem.shooting(variables).simulate(z)
    longest = max(float(r.lengths.max()) for r in problem.records)
    visited = np.concatenate([x[:: max(1, len(x) // 10)] for _, x in runs])
    needed = substeps_for(problem.model.system, variables.fixed, visited, longest)
    used = problem.step.substeps
    halved = problem.with_step(2 * used, variables.fixed)
    finer = halved.shooting(variables).simulate(z)
    change = np.concatenate([a - b for (a, _), (b, _) in zip(runs, finer, strict=True)])
    error = np.sqrt(np.mean(change**2, axis=0)) / problem.noise.std
    ratio = np.sqrt(evaluation.squares / np.maximum(evaluation.counts, 1))
    if options.substeps:
        return None, error
    if not np.isfinite(error).all() or np.any(error > np.maximum(OF_NOISE, OF_MISFIT * ratio)):
        return problem.with_step(max(2 * used, needed), variables.fixed), error
    return (problem.with_step(needed, variables.fixed) if needed > used else None), error


def _reporter(report: Report | None, stage: int, stages: int, problem: Problem, share: float) -> Iteration | None:
    if report is None:
        return None
    count = sum(int(np.isfinite(r.y[: round(share * len(r.u))]).sum()) for r in problem.records)

    def progress(iteration: int, cost: float) -> None:
        report(Progress(stage + 1, stages, iteration, float(np.sqrt(cost / max(count, 1)))))

    return progress
