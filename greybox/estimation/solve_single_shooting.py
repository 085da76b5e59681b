"""Single shooting: a growing part of the record, then all of it, then a check of the integrator."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from greybox.estimation.options import FitOptions, FitProgress, FitProgressCallback
from greybox.estimation.problem import EstimationProblem
from greybox.estimation.progressive_horizon import (
    FOLLOWED,
    choose_first_share,
    choose_next_share,
    compute_explained_share,
    shorten_share,
)
from greybox.estimation.solution import Solution
from greybox.estimation.step_refinement import HALVINGS, refine_step
from greybox.optim import IterationCallback, MinimisationResult, TerminationStatus, minimise
from greybox.transcription import DecisionVector, Evaluation

# While only part of the record is used, positive constants are held by a weak prior: a factor e^2 is one standard deviation.
PRIOR = 0.25
# Converged when the next Gauss-Newton step would lower chi-square by less than this (in units of the residual variance): the
# constants are within 1 % of their standard deviations. Part of the record is only a way to a start: a tenth will do.
NEGLIGIBLE, NEGLIGIBLE_IN_PART = 1e-4, 1e-2
# ... or when it would lower the misfit over noise by less than this (data without noise end at rounding errors).
PERFECT = 1e-7
# A cost with kinks (dry friction) never meets that rule: enough when so many iterations gained less than this share of it.
PATIENCE, LITTLE_GAIN = 12, 1e-5
# A scaled variable this close to its bound, and pushed against it, is held there.
AT_BOUND = 1e-6
# Growth of the number of substeps that a fit which is not thorough follows.
COSTLY = 16
NO_RESULT = (TerminationStatus.INTERRUPTED, TerminationStatus.NO_START)


def solve_single(
    problem: EstimationProblem, options: FitOptions, report: FitProgressCallback | None = None
) -> Solution:
    """Minimise the cost of the free run over each record."""
    run = _Run(problem, options, report)
    if options.progressive and problem.variables.size:
        run.grow()
    run.fit(1.0)
    error = np.zeros(len(problem.noise.std))
    for halving in range(HALVINGS + 1):
        if run.over:
            break
        better, error = refine_step(run.problem, run.variables, run.evaluation, options)
        if better is None or halving == HALVINGS or run.costly(better):
            break
        run.problem, run.known = better, None
        run.fit(1.0)
    return Solution(
        run.problem, run.variables, run.evaluation, run.status, run.word, run.iterations, run.passes, run.seconds,
        tuple(run.shares), error, _strategy(run.shares),
    )  # fmt: skip


class _Run:
    """A search in progress: where it is, and the work so far.

    ``known`` is the evaluation at ``z = 0`` of ``variables`` over the share that comes next, where a former stage has it already.
    """

    def __init__(self, problem: EstimationProblem, options: FitOptions, report: FitProgressCallback | None) -> None:
        self.problem, self.options, self.report = problem, options, report
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
        return not self.options.thorough and better.step.substeps > COSTLY * self.first

    @property
    def evaluation(self) -> Evaluation:
        """The present point over the whole record."""
        if self.known is None:
            self.known = self.measure(1.0)
        return self.known

    def measure(self, share: float) -> Evaluation:
        """The present point over part of the record."""
        self.passes += 1
        return self.problem.shooting(self.variables, share).evaluate(np.zeros(self.variables.size))

    def grow(self) -> None:
        """Fit a growing part of the record, until a part foretells the whole."""
        share, outcome = self.begin()
        while outcome is not None and not self.over and share < 1:
            share, self.known = choose_next_share(self.problem, share, outcome.value, self.measure)
            if share < 1:
                outcome = self.fit(share)

    def begin(self) -> tuple[float, MinimisationResult | None]:
        """Fit the first part: one so short that it can be followed from these start values, if there is one."""
        share, start = choose_first_share(self.problem), self.variables
        tried: list[tuple[float, float, DecisionVector, MinimisationResult]] = []
        while share < 1:
            self.variables, self.status = start, TerminationStatus.CONVERGED
            outcome = self.fit(share)
            if outcome is not None:
                tried.append(
                    (compute_explained_share(self.problem, outcome.value, share), share, self.variables, outcome)
                )
            less = shorten_share(self.problem, share)
            if (
                self.status is TerminationStatus.INTERRUPTED
                or less == share
                or (outcome is not None and tried[-1][0] >= FOLLOWED)
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
        evaluate, prior = shooting.evaluate, _prior(variables, start) if share < 1 else None
        low, high = variables.bounds()
        outcome = minimise(
            evaluate if prior is None else lambda z: prior(z, evaluate(z)),
            np.zeros(variables.size),
            low,
            high,
            scale=max(start.cost, 1e-300),
            first=start,
            tolerance=self.options.tolerance,
            iterations=self.options.iterations,
            finished=make_termination_test(low, high, NEGLIGIBLE if share == 1 else NEGLIGIBLE_IN_PART),
            thorough=self.options.thorough and share == 1,
            progress=self.progress(share),
        )
        self.variables, self.status, self.word = variables.moved(outcome.z), outcome.status, outcome.solver_status
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


def _strategy(shares: list[float]) -> str:
    """What was picked, in words."""
    growing = [share for share in shares if share < 1]
    if not growing:
        return "single shooting on the whole record"
    parts = ", ".join(f"{100 * share:.3g} %" for share in (*growing, 1.0))
    return f"single shooting on a growing record ({parts})"


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


def _prior(v: DecisionVector, start: Evaluation) -> Callable[[np.ndarray, Evaluation], Evaluation]:
    """Adds to a cost a weak prior on positive constants, in units of the residual variance at the start."""
    held = np.zeros(v.size)
    held[: len(v.which)] = np.where(v.logarithmic, PRIOR * max(1.0, start.cost / max(start.count, 1)), 0.0)

    def added(z: np.ndarray, e: Evaluation) -> Evaluation:
        return replace(
            e, cost=e.cost + held @ z**2, gradient=e.gradient + 2 * held * z, hessian=e.hessian + np.diag(2 * held)
        )

    return added


def make_termination_test(
    low: np.ndarray, high: np.ndarray, negligible: float
) -> Callable[[np.ndarray, Evaluation], TerminationStatus | None]:
    """Ends a search when a further Gauss-Newton step, off the bounds, would change nothing that matters, or none helps."""
    costs: list[float] = []

    def enough(z: np.ndarray, e: Evaluation) -> TerminationStatus | None:
        held = (z - low <= AT_BOUND) & (e.gradient > 0) | (high - z <= AT_BOUND) & (e.gradient < 0)
        gradient, hessian = e.gradient, e.hessian
        if held.any():
            gradient, hessian = gradient[~held], hessian[~held][:, ~held]
        decrease = _promised(gradient, hessian)
        if decrease <= negligible * e.cost / max(e.count, 1) + PERFECT**2 * e.count:
            return TerminationStatus.CONVERGED
        costs.append(e.cost)
        flat = len(costs) > PATIENCE and costs[-1 - PATIENCE] - e.cost <= LITTLE_GAIN * e.cost
        return TerminationStatus.ACCEPTABLE if flat else None

    return enough


def _promised(gradient: np.ndarray, hessian: np.ndarray) -> float:
    """By how much a Gauss-Newton step would lower the cost: ``g' H^-1 g / 2`` over the directions that have a curvature."""
    scale = np.sqrt(np.maximum(hessian.diagonal(), 1e-300))
    with np.errstate(over="ignore", invalid="ignore"):
        scaled = hessian / scale / scale[:, None]
    if not np.isfinite(scaled).all():  # sensitivities near overflow: anything may still be gained
        return np.inf
    curvature, vectors = np.linalg.eigh(scaled)
    usable = curvature > 1e-13 * curvature.max(initial=0.0)
    along = vectors.T @ (gradient / scale)
    return 0.5 * float(np.sum(along[usable] ** 2 / curvature[usable]))
