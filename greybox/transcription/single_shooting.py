"""Single shooting: a growing part of the record, then all of it, then a check of the integrator."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from greybox.numerics import TINY
from greybox.optim import IterationCallback, MinimisationResult, TerminationStatus, minimise
from greybox.optim.termination import Termination
from greybox.transcription.decision_vector import DecisionVector
from greybox.transcription.options import SolverOptions, Transcription
from greybox.transcription.problem import EstimationProblem
from greybox.transcription.progress import FitProgress, FitProgressCallback
from greybox.transcription.progressive_horizon import (
    choose_first_share,
    choose_next_share,
    compute_explained_share,
    shorten_share,
)
from greybox.transcription.simulation_error import Evaluation
from greybox.transcription.solution import Solution, make_strategy
from greybox.transcription.step_refinement import NO_RESULT, Refinement, refine_step, solve_with_refined_steps


def solve_single_shooting(
    problem: EstimationProblem, options: SolverOptions, report: FitProgressCallback | None = None
) -> Solution:
    """Minimise the cost of the free run over each record."""
    search = _Search(problem, options, report)
    return solve_with_refined_steps(problem, search.solve, search.refine, options.policy.step_refinement)


class _Search:
    """A search in progress: where it is, and the work since the last solution.

    ``known`` is the evaluation at ``z = 0`` of ``variables`` over the share that comes next, where a former stage has it already.
    """

    def __init__(self, problem: EstimationProblem, options: SolverOptions, report: FitProgressCallback | None) -> None:
        self.options, self.report = options, report
        self.horizon, self.convergence = options.policy.progressive_horizon, options.policy.convergence
        self.first_substeps = problem.step.substeps
        self.progressive = options.progressive and problem.variables.size > 0
        self.known: Evaluation | None = None
        self.shares: list[float] = []

    def solve(self, problem: EstimationProblem) -> Solution:
        """The optimum over whole records, the first time by way of growing parts of them."""
        self.problem, self.variables, self.known = problem, problem.variables, None
        self.status, self.word, self.solver = TerminationStatus.CONVERGED, "", ""
        self.iterations = self.passes = 0
        self.seconds, self.shares = 0.0, []
        if self.progressive:
            self.progressive = False
            self.grow()
        self.fit(1.0)
        return Solution(
            problem,
            self.variables,
            self.known or self.measure(1.0),
            self.status,
            self.word,
            self.iterations,
            self.passes,
            self.seconds,
            tuple(self.shares),
            np.zeros(len(problem.noise.std)),
            make_strategy(Transcription.SINGLE, shares=list(self.shares)),
            solver=self.solver,
        )

    def refine(self, solution: Solution) -> Refinement:
        """A smaller step if need be, but for one of many candidates that would take all the time: it has strayed to stiff constants."""
        finer, error = refine_step(solution, self.options)
        too_stiff = self.convergence.stiff_growth * self.first_substeps
        is_costly = finer is not None and not self.options.thorough and finer.step.substeps > too_stiff
        return None if is_costly else finer, error

    @property
    def over(self) -> bool:
        """Whether there is nothing to go on from."""
        return self.status in NO_RESULT

    def measure(self, share: float) -> Evaluation:
        """The present point over part of the record."""
        self.passes += 1
        return self.problem.shooting(self.variables, share).evaluate(self.variables.here)

    def grow(self) -> None:
        """Fit a growing part of the record, until a part foretells the whole."""
        share, outcome = self.begin()
        while outcome is not None and not self.over and share < 1:
            share, self.known = choose_next_share(self.problem, share, outcome.value, self.measure, self.horizon)
            if share < 1:
                outcome = self.fit(share)

    def begin(self) -> tuple[float, MinimisationResult | None]:
        """Fit the first part: one so short that it can be followed from these start values, if there is one."""
        share, start = choose_first_share(self.problem, self.horizon), self.variables
        tried: list[tuple[float, float, DecisionVector, MinimisationResult]] = []
        while share < 1:
            self.variables, self.status = start, TerminationStatus.CONVERGED
            outcome = self.fit(share)
            if outcome is not None:
                tried.append(
                    (compute_explained_share(self.problem, outcome.value, share), share, self.variables, outcome)
                )
            less = shorten_share(self.problem, share, self.horizon)
            if (
                self.status is TerminationStatus.INTERRUPTED
                or less == share
                or (outcome is not None and tried[-1][0] >= self.horizon.followed_share)
            ):
                break
            share = less
        if not tried:
            return 1.0, None
        _, share, self.variables, outcome = max(tried, key=lambda one: one[0])
        self.status = outcome.status
        return share, outcome

    def fit(self, share: float) -> MinimisationResult | None:
        """One minimisation over part of the record; None where it cannot begin."""
        if self.over:
            self.known = None
            return None
        start = self.known or self.measure(share)
        self.known = None
        if not np.isfinite(start.cost):
            self.status = TerminationStatus.NO_START
            return None
        self.shares.append(share)
        variables, start = _rescale(self.variables, start)
        evaluate = self.problem.shooting(variables, share).evaluate
        is_whole, low_high = share == 1, variables.bounds()
        prior = None if is_whole else _make_weak_prior(variables, start, self.convergence.weak_prior)
        policy = self.convergence if is_whole else self.convergence.in_part
        outcome = minimise(
            evaluate if prior is None else lambda z: prior(z, evaluate(z)),
            variables.here,
            *low_high,
            scale=max(start.cost, TINY),
            value_at_start=start,
            tolerance=self.options.tolerance,
            iterations=self.options.iterations,
            termination_test=Termination(policy, *low_high, start.count).test,
            thorough=self.options.thorough and is_whole,
            progress=self.progress(share),
            policy=self.options.policy.minimisation,
        )
        self.variables, self.status, self.word = variables.recentre(outcome.z), outcome.status, outcome.solver_status
        self.solver = outcome.solver or self.solver
        self.iterations += outcome.iterations
        self.passes += outcome.evaluations
        self.seconds += outcome.seconds
        self.known = outcome.value if share == 1 else None
        return outcome

    def progress(self, share: float) -> IterationCallback | None:
        """What IPOPT calls after each iteration."""
        if self.report is None:
            return None
        report, stage, stages = self.report, len(self.shares), len(self.shares) + (share < 1)
        count = sum(int(np.isfinite(r.y[: round(share * len(r.u))]).sum()) for r in self.problem.records)

        def progress(iteration: int, cost: float) -> None:
            report(FitProgress(stage, stages, iteration, float(np.sqrt(cost / max(count, 1)))))

        return progress


def _rescale(variables: DecisionVector, start: Evaluation) -> tuple[DecisionVector, Evaluation]:
    """Variables in which a step of one changes the cost by about itself, and the evaluation along them."""
    scaled = variables.rescale(start.cost, np.diag(start.hessian) / 2)
    ratio = scaled.units / variables.units
    return scaled, replace(start, gradient=start.gradient * ratio, hessian=start.hessian * ratio[:, None] * ratio)


def _make_weak_prior(
    v: DecisionVector, start: Evaluation, precision: float
) -> Callable[[np.ndarray, Evaluation], Evaluation]:
    """Adds to a cost a weak prior on positive constants, in units of the residual variance at the start."""
    held = np.zeros(v.size)
    v.split(held).parameters[v.logarithmic] = precision * max(1.0, start.cost / max(start.count, 1))

    def add_prior(z: np.ndarray, e: Evaluation) -> Evaluation:
        return replace(
            e, cost=e.cost + held @ z**2, gradient=e.gradient + 2 * held * z, hessian=e.hessian + np.diag(2 * held)
        )

    return add_prior
