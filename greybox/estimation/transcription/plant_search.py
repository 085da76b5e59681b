"""The search for constants of a plant that is run from outside: what a run costs decides how it goes.

It begins with the first part of the records and goes on to longer ones, so that most runs are short ones. Slopes by differences cost a run
for each unknown: they are taken where a search begins, and follow from step to step by Broyden's secant update as long as steps gain what
they promise. A run that fails costs a bounded amount. Where a run costs nothing to speak of, the search is that of any model.
"""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from greybox.estimation.optim.methods import MinimisationMethod, minimise
from greybox.estimation.optim.minimisation import DEFAULT_POLICY, GaussNewtonPolicy, TerminationStatus
from greybox.estimation.options import FitOptions, Transcription
from greybox.estimation.transcription.decision_vector import DecisionVector
from greybox.estimation.transcription.problem import (
    EstimationProblem,
    FitProgress,
    FitProgressCallback,
    Solution,
    make_strategy,
)
from greybox.estimation.transcription.shooting_cost import Evaluation, PlantShooting
from greybox.estimation.transcription.single_shooting import solve_single_shooting
from greybox.simulation.plant import CanApproach, PlantModel
from greybox.simulation.plant_kernel import PlantKernel

# Shares of the records that are fitted before the whole: over a short part a start that is far off is not out of step yet, and a run
# costs little.
SHARES = (0.15, 0.4)
# Share of the rows from which a part is not worth a search of its own.
ALMOST_WHOLE = 0.8


def solve_plant(problem: EstimationProblem, options: FitOptions, report: FitProgressCallback | None = None) -> Solution:
    """Minimise the cost of the runs of a plant over each record."""
    model, kernel = problem.model, problem.kernel
    assert isinstance(model, PlantModel)
    assert isinstance(kernel, PlantKernel)
    # The plant knows nothing of ties.
    if options.progressive and isinstance(model.plant, CanApproach) and model.free_parameters and not model.ties:
        free = [q.name for q in model.free_parameters]
        proposed = model.plant.approach(problem.experiments, dict(model.values), free)
        nearer = {name: float(np.clip(value, *model.parameter(name).bounds)) for name, value in proposed.items()}
        problem = replace(problem, variables=problem.variables.start_at(nearer))
    if model.is_cheap:
        return solve_single_shooting(problem, replace(options, progressive=False), report)
    began, search = time.perf_counter(), _PlantSearch(problem, kernel, report)
    if options.progressive:
        for share in SHARES:
            search.descend_part(share)
    status, evaluation = search.descend_whole()
    return Solution(
        problem,
        search.variables,
        evaluation,
        status,
        "",
        search.iterations,
        search.evaluations,
        time.perf_counter() - began,
        (*search.shares, 1.0),
        np.zeros(len(problem.noise.std)),
        make_strategy(Transcription.SINGLE, shares=[*search.shares, 1.0]),
        solver="Gauss-Newton",
    )


# Most times that the search goes on from slopes by differences.
ROUNDS = 12
# Most steps that gain, from one set of slopes by differences.
ITERATIONS = 30
# Damping of the first step, as a share of the curvature: an undamped one may leave a start that is far off for another oscillation.
INITIAL_DAMPING = 0.001
# Steps in a row that gain nothing before slopes are taken by differences again.
REJECTIONS = 5
# Predicted decrease of the cost, over its noise (cost over degrees of freedom), from which nothing visible is left to gain.
CONVERGED = 0.0001
# The same where no step gains although slopes are differences to both sides: a tenth of a standard deviation, squared. What is promised
# then is the scatter of the plant's own solver.
SCATTER = 0.01
# Share of the cost at the start that is a solver's scatter: exact data end here.
EXACT = 1e-12
# Cost of a run that fails, over that of the start: bounded, so that the search turns back and goes on.
FAILED_COST = 100.0


class _PlantSearch:
    """A search in progress: where it is, and the work so far."""

    def __init__(self, problem: EstimationProblem, kernel: PlantKernel, report: FitProgressCallback | None) -> None:
        self.problem, self.kernel, self.report = problem, kernel, report
        # Linear in every constant: over the first, short part a logarithm takes a start that is far off decades further.
        self.logarithmic = problem.variables.logarithmic
        self.variables = replace(problem.variables, logarithmic=np.zeros_like(self.logarithmic))
        self.iterations = self.evaluations = 0
        self.shares: list[float] = []

    def descend_part(self, share: float) -> None:
        """Search over the first ``share`` of every record, unless that is nearly the whole, which costs as much."""
        shooting = self.problem.over_part(share).shooting(self.variables)
        assert isinstance(shooting, PlantShooting)
        rows, whole = (sum(len(r.u) for r in records) for records in (shooting.records, self.problem.records))
        if rows >= ALMOST_WHOLE * whole or not self.variables.size:
            return
        if np.isfinite(shooting.cost(self.variables.here)):
            self.shares.append(share)
            z, _ = self._descend(shooting)
            self.variables = self.variables.recentre(z)

    def descend_whole(self) -> tuple[TerminationStatus, Evaluation]:
        """How the search over the whole records ended, and the cost there."""
        shooting = self.problem.shooting(self.variables)
        assert isinstance(shooting, PlantShooting)
        start = self.variables.here
        if not np.isfinite(shooting.cost(start)) or not self.variables.size:
            self.variables = replace(self.variables, logarithmic=self.logarithmic)
            begun = shooting.evaluate(start)
            return TerminationStatus.CONVERGED if np.isfinite(begun.cost) else TerminationStatus.NO_START, begun
        z, status = self._descend(shooting)
        # As the problem has its constants again; runs and slopes are known there.
        self.variables = replace(self.variables.recentre(z), logarithmic=self.logarithmic)
        return status, self.problem.shooting(self.variables).evaluate(start)

    def _descend(self, shooting: PlantShooting) -> tuple[np.ndarray, TerminationStatus]:
        """Rounds of steps, each from slopes by differences, until these promise nothing."""
        variables: DecisionVector = self.variables
        z, (low, high), status = variables.here, variables.bounds(), TerminationStatus.ITERATION_LIMIT
        at_start = shooting.cost(z)
        penalty, exact = FAILED_COST * at_start, EXACT * at_start
        size, outputs = variables.size, len(shooting.weight)

        def evaluate(at: np.ndarray) -> Evaluation:
            # A run that fails is asked for first, as it costs nothing the second time.
            if not np.isfinite(shooting.cost(at)):
                nothing = np.zeros(outputs)
                return Evaluation(penalty, np.zeros(size), np.eye(size), nothing, nothing.astype(int))
            return shooting.evaluate(at)

        def compute_cost(at: np.ndarray) -> float:
            cost = shooting.cost(at)
            return cost if np.isfinite(cost) else penalty

        def test(at: np.ndarray, value: Evaluation) -> TerminationStatus | None:
            """Converged where the quadratic model promises less than what noise does."""
            noise = value.cost / max(count - size, 1)
            is_done = value.cost <= exact or value.predicted_decrease(low - at, high - at) <= CONVERGED * noise
            return TerminationStatus.CONVERGED if is_done else None

        def progress(iteration: int, cost: float) -> None:
            if self.report:
                ratio = float(np.sqrt(cost / count))
                self.report(FitProgress(len(self.shares), len(SHARES) + 1, self.iterations + iteration, ratio))

        count = max(sum(int(np.isfinite(r.y).sum()) for r in shooting.records), 1)
        damped = GaussNewtonPolicy(initial_damping=INITIAL_DAMPING, max_rejections=REJECTIONS)
        shooting.follows_secants, self.kernel.central = True, False
        for _ in range(ROUNDS):
            shooting.forget_slopes()
            begun = evaluate(z)
            self.evaluations += 1
            if test(z, begun) is not None:
                return z, TerminationStatus.CONVERGED
            outcome = minimise(
                evaluate,
                z,
                low,
                high,
                method=MinimisationMethod.GAUSS_NEWTON,
                scale=float(count),
                value_at_start=begun,
                iterations=ITERATIONS,
                thorough=False,
                cost=compute_cost,
                termination_test=test,
                progress=progress,
                policy=replace(DEFAULT_POLICY, damped=damped),
            )
            status = outcome.status
            self.iterations += outcome.iterations
            self.evaluations += outcome.evaluations
            # Slopes by differences, and no step gains: their own error may be what is left.
            if np.array_equal(outcome.z, z):
                if self.kernel.central:
                    is_end = begun.predicted_decrease(low - z, high - z) <= SCATTER * begun.cost / max(count - size, 1)
                    status = TerminationStatus.CONVERGED if is_end else status
                    break
                # Twice the runs, but without the error of first order in the width.
                self.kernel.central = True
            z = outcome.z
            if status is TerminationStatus.INTERRUPTED:
                break
        return z, status
