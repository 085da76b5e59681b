"""Single shooting: a growing part of the record, then all of it, then a check of the integrator."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from greybox.numerics import AT_BOUND, DECREASE_CUTOFF, TINY
from greybox.optim import IterationCallback, MinimisationResult, TerminationStatus, minimise
from greybox.transcription.decision_vector import DecisionVector
from greybox.transcription.options import SolverOptions, Transcription
from greybox.transcription.policy import ConvergencePolicy
from greybox.transcription.problem import EstimationProblem
from greybox.transcription.progress import FitProgress, FitProgressCallback
from greybox.transcription.progressive_horizon import (
    choose_first_share,
    choose_next_share,
    compute_explained_share,
    shorten_share,
)
from greybox.transcription.simulation_error import Evaluation
from greybox.transcription.solution import Solution
from greybox.transcription.step_refinement import refine_step
from greybox.transcription.strategy import make_strategy

# Nothing to go on from.
NO_RESULT = (TerminationStatus.INTERRUPTED, TerminationStatus.NO_START)


def solve_single(
    problem: EstimationProblem, options: SolverOptions, report: FitProgressCallback | None = None
) -> Solution:
    """Minimise the cost of the free run over each record."""
    run = _Run(problem, options, report)
    if options.progressive and problem.variables.size:
        run.grow()
    run.fit(1.0)
    error = np.zeros(len(problem.noise.std))
    halvings = options.policy.step_refinement.halvings
    for halving in range(halvings + 1):
        if run.over:
            break
        better, error = refine_step(run.problem, run.variables, run.evaluation, options)
        if better is None or halving == halvings or run.costly(better):
            break
        run.problem, run.known = better, None
        run.fit(1.0)
    return Solution(
        run.problem,
        run.variables,
        run.evaluation,
        run.status,
        run.word,
        run.iterations,
        run.passes,
        run.seconds,
        tuple(run.shares),
        error,
        make_strategy(Transcription.SINGLE, shares=list(run.shares)),
    )


class _Run:
    """A search in progress: where it is, and the work so far.

    ``known`` is the evaluation at ``z = 0`` of ``variables`` over the share that comes next, where a former stage has it already.
    """

    def __init__(self, problem: EstimationProblem, options: SolverOptions, report: FitProgressCallback | None) -> None:
        self.problem, self.options, self.report = problem, options, report
        self.horizon, self.convergence = options.policy.progressive_horizon, options.policy.convergence
        self.variables, self.first = problem.variables, problem.step.substeps
        self.status, self.word = TerminationStatus.CONVERGED, ""
        self.iterations = self.passes = 0
        self.seconds = 0.0
        self.shares: list[float] = []
        self.known: Evaluation | None = None

    @property
    def over(self) -> bool:
        """Whether there is nothing to go on from."""
        return self.status in NO_RESULT

    def costly(self, better: EstimationProblem) -> bool:
        """Whether one of many candidates has strayed to constants so stiff that to follow it would take all the time."""
        return not self.options.thorough and better.step.substeps > self.convergence.stiff_growth * self.first

    @property
    def evaluation(self) -> Evaluation:
        """The present point over the whole record."""
        if self.known is None:
            self.known = self.measure(1.0)
        return self.known

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
        variables, start = _rescaled(self.variables, start)
        shooting = self.problem.shooting(variables, share)
        evaluate, prior = (
            shooting.evaluate,
            _make_weak_prior(variables, start, self.convergence.weak_prior) if share < 1 else None,
        )
        low, high = variables.bounds()
        outcome = minimise(
            evaluate if prior is None else lambda z: prior(z, evaluate(z)),
            variables.here,
            low,
            high,
            scale=max(start.cost, TINY),
            value_at_start=start,
            tolerance=self.options.tolerance,
            iterations=self.options.iterations,
            termination_test=make_termination_test(low, high, self.convergence, whole=share == 1),
            thorough=self.options.thorough and share == 1,
            progress=self.progress(share),
            policy=self.options.policy.minimisation,
        )
        self.variables, self.status, self.word = variables.recentre(outcome.z), outcome.status, outcome.solver_status
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


def _rescaled(variables: DecisionVector, start: Evaluation) -> tuple[DecisionVector, Evaluation]:
    """Variables in which a step of one changes the cost by about itself, and the evaluation along them."""
    curvature = np.diag(start.hessian) / 2
    scaled = variables.rescale(start.cost, curvature)
    ratio = _spans(scaled) / _spans(variables)
    return scaled, replace(start, gradient=start.gradient * ratio, hessian=start.hessian * ratio[:, None] * ratio)


def _spans(v: DecisionVector) -> np.ndarray:
    """Physical size of a step of one in each entry of ``z`` (for a logarithmic one, in its logarithm)."""
    states = np.tile(v.initial.scale[v.free_states], v.experiments)
    return np.concatenate([np.where(v.logarithmic, 1.0, v.scale), states])


def _make_weak_prior(
    v: DecisionVector, start: Evaluation, precision: float
) -> Callable[[np.ndarray, Evaluation], Evaluation]:
    """Adds to a cost a weak prior on positive constants, in units of the residual variance at the start."""
    held = np.zeros(v.size)
    held[: len(v.which)] = np.where(v.logarithmic, precision * max(1.0, start.cost / max(start.count, 1)), 0.0)

    def added(z: np.ndarray, e: Evaluation) -> Evaluation:
        return replace(
            e, cost=e.cost + held @ z**2, gradient=e.gradient + 2 * held * z, hessian=e.hessian + np.diag(2 * held)
        )

    return added


def make_termination_test(
    low: np.ndarray, high: np.ndarray, policy: ConvergencePolicy, *, whole: bool = True
) -> Callable[[np.ndarray, Evaluation], TerminationStatus | None]:
    """Ends a search when a further Gauss-Newton step, off the bounds, would change nothing that matters, or none helps.

    ``whole``: whether the whole record is used, or a part of it that is only a way to a start.
    """
    costs: list[float] = []
    negligible = policy.negligible_decrease if whole else policy.negligible_decrease_in_part

    def test(z: np.ndarray, e: Evaluation) -> TerminationStatus | None:
        held = (z - low <= AT_BOUND) & (e.gradient > 0) | (high - z <= AT_BOUND) & (e.gradient < 0)
        gradient, hessian = e.gradient, e.hessian
        if held.any():
            gradient, hessian = gradient[~held], hessian[~held][:, ~held]
        decrease = _predict_decrease(gradient, hessian)
        if decrease <= negligible * e.cost / max(e.count, 1) + policy.perfect_noise_ratio**2 * e.count:
            return TerminationStatus.CONVERGED
        costs.append(e.cost)
        flat = len(costs) > policy.patience and costs[-1 - policy.patience] - e.cost <= policy.little_gain * e.cost
        return TerminationStatus.ACCEPTABLE if flat else None

    return test


def _predict_decrease(gradient: np.ndarray, hessian: np.ndarray) -> float:
    """By how much a Gauss-Newton step would lower the cost: ``g' H^-1 g / 2`` over the directions that have a curvature."""
    scale = np.sqrt(np.maximum(hessian.diagonal(), TINY))
    with np.errstate(over="ignore", invalid="ignore"):
        scaled = hessian / scale / scale[:, None]
    if not np.isfinite(scaled).all():  # sensitivities near overflow: anything may still be gained
        return np.inf
    curvature, vectors = np.linalg.eigh(scaled)
    usable = curvature > DECREASE_CUTOFF * curvature.max(initial=0.0)
    along = vectors.T @ (gradient / scale)
    return 0.5 * float(np.sum(along[usable] ** 2 / curvature[usable]))
