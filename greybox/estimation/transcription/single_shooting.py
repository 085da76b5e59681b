"""Single shooting: a growing part of the record, then all of it, then a check of the integrator."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from greybox.base import TINY
from greybox.estimation.optim import minimisation
from greybox.estimation.optim.methods import MinimisationMethod, minimise
from greybox.estimation.options import FitOptions, StepRefinementPolicy, Transcription
from greybox.estimation.transcription.decision_vector import DecisionVector
from greybox.estimation.transcription.problem import (
    EstimationProblem,
    FitProgressCallback,
    ProgressMonitor,
    Runs,
    Solution,
    make_strategy,
)
from greybox.estimation.transcription.shooting_cost import Evaluation
from greybox.simulation.integrators.discretisation import choose_substeps, follow_step
from greybox.simulation.integrators.runge_kutta import find_fast_relaxing_states

# How much of a record to fit at first, and how much more next.
#
# A start that is far off runs out of step with a long record and locks onto a wrong oscillation. Over the first few time
# constants it cannot; what is found there is good enough to go on from, as long as it foretells the next part. It is also
# cheap: most iterations see a tenth of the record.


# The first part holds so many of the slowest time constants: over them a start that is far off cannot run out of step.
TIME_CONSTANTS = 2.0
# Rows of the first part at least.
PROGRESSIVE_HORIZON_LEAST_ROWS = 60
# Rows of the first part for each unknown at least.
ROWS_PER_UNKNOWN = 5
# Rows of a record at which movement and sampling time are looked at.
INSPECTED_ROWS = 2000
# From this share of the record on the next part is the whole.
PROGRESSIVE_HORIZON_ALMOST_WHOLE = 0.5


def choose_first_share(problem: EstimationProblem) -> float:
    """Share of the record for the first stage: a few time constants with some movement in them."""
    v = problem.variables
    rows = max(len(r.u) for r in problem.records)
    period = max(float(np.median(r.h[:INSPECTED_ROWS])) for r in problem.records)
    jacobian = problem.model.system.jacobian(v.initial.guess[0], problem.records[0].u[0], v.fixed).full()
    # 1 / slowest decay is the longest time that the motion takes to forget its start.
    decays = -np.linalg.eigvals(jacobian).real if np.isfinite(jacobian).all() else np.empty(0)
    slowest = 1 / decays[decays > 0].min() if np.any(decays > 0) else 0.0
    first = max(PROGRESSIVE_HORIZON_LEAST_ROWS, ROWS_PER_UNKNOWN * v.size, TIME_CONSTANTS * slowest / period) / rows
    first = max(first, min(_find_movement_share(r.y) for r in problem.records))
    return float(first) if first < PROGRESSIVE_HORIZON_ALMOST_WHOLE else 1.0


# The record grows by the first of these factors with which the model foretells the longer part.
PROGRESSIVE_HORIZON_GROWTH: tuple[float, ...] = (10.0, 4.0, 2.0, 1.4)
# A longer part is foretold if the misfit grows at most so many times (of the noise at least).
PROGRESSIVE_HORIZON_SURPRISE = 3.0
# It is foretold as well where the model still follows this share of the outputs' movement.
FORETOLD_SHARE = 0.8


def choose_next_share(
    problem: EstimationProblem, share: float, reached: Evaluation, measure: Callable[[float], Evaluation]
) -> tuple[float, Evaluation]:
    """The next share and the evaluation there: as much more of the record as the present part foretells."""
    # A part that is fitted below the noise foretells no more than the noise.
    expected = PROGRESSIVE_HORIZON_SURPRISE * max(reached.noise_ratio, 1.0)
    for factor in PROGRESSIVE_HORIZON_GROWTH:
        wider = factor * share if factor * share < PROGRESSIVE_HORIZON_ALMOST_WHOLE else 1.0
        ahead = measure(wider)
        if ahead.noise_ratio <= expected or compute_explained_share(problem, ahead, wider) >= FORETOLD_SHARE:
            break
    return wider, ahead


def compute_explained_share(problem: EstimationProblem, e: Evaluation, share: float) -> float:
    """Share of the outputs' movement, in units of their noise, that the model follows over part of the record; 1 is all of it."""
    movement = np.zeros(len(e.squares))
    for record in problem.records:
        for j, column in enumerate(record.y[: max(2, round(share * len(record.y)))].T):
            values = column[np.isfinite(column)]
            # R^2 = 1 - sum r^2 / sum (y - mean)^2, the latter over the noise as well.
            movement[j] += len(values) * np.var(values) if len(values) else 0.0
    total = float(np.sum(movement / problem.noise.std**2))
    return 1.0 - float(e.squares.sum()) / total if total > 0 else 1.0


# It is shortened by this factor.
PROGRESSIVE_HORIZON_SHRINK = 3.0
# A part less than so many times the shortest one is not shortened.
LEAST_SHRINK = 1.2


def shorten_share(problem: EstimationProblem, share: float) -> float:
    """The next shorter beginning, or the same where it cannot be shorter."""
    rows = max(len(r.u) for r in problem.records)
    least = max(PROGRESSIVE_HORIZON_LEAST_ROWS, ROWS_PER_UNKNOWN * problem.variables.size) / rows
    return max(share / PROGRESSIVE_HORIZON_SHRINK, least) if share > LEAST_SHRINK * least else share


# It holds this share of an output's range as well, so that there is something to fit.
PROGRESSIVE_HORIZON_MOVEMENT = 0.1


def _find_movement_share(y: np.ndarray) -> float:
    """Share of the record after which an output has shown the policy's share of its range."""
    shares = []
    for column in y[:: max(1, len(y) // INSPECTED_ROWS)].T:
        finite = np.flatnonzero(np.isfinite(column))
        if len(finite) == 0:
            continue
        values = column[finite]
        # Range shown so far, up to each row.
        seen = np.maximum.accumulate(values) - np.minimum.accumulate(values)
        if seen[-1] > 0:
            shares.append(finite[np.argmax(seen >= PROGRESSIVE_HORIZON_MOVEMENT * seen[-1])] / len(column))
    return min(shares, default=1.0)


# Whether the integrator's step is small enough at the optimum; if not, the search goes on with a smaller one.

NO_RESULT = (minimisation.TerminationStatus.INTERRUPTED, minimisation.TerminationStatus.NO_START)
"""Nothing to go on from."""

Refinement = tuple[EstimationProblem | None, np.ndarray]
"""A problem with a smaller step, None where the present one will do; and the integration error of each output over its noise (ny,)."""


def solve_with_refined_steps(
    problem: EstimationProblem,
    solve: Callable[[EstimationProblem], Solution],
    refine: Callable[[Solution], Refinement],
    policy: StepRefinementPolicy,
) -> Solution:
    """``solve`` a problem, and go on with ever smaller steps from each solution that ``refine`` calls too coarse."""
    solution = solve(problem)
    for halving in range(policy.halvings + 1):
        if solution.status in NO_RESULT:
            break
        finer, error = refine(solution)
        solution = replace(solution, integration_error=error)
        if finer is None or halving == policy.halvings:
            break
        again = solve(replace(finer, variables=solution.variables)).with_work_of(solution)
        solution = replace(again, shares=solution.shares, integration_error=error)
    return solution


# The change is looked at over the first quarter of every record, or so many rows: three more simulations of all of it cost too much.
CHECKED_ROWS = 2000


def refine_step(
    solution: Solution, options: FitOptions, simulate: Callable[[EstimationProblem], Runs] | None = None
) -> Refinement:
    """What half the step changes in the outputs at a solution, and a smaller step if that matters.

    ``simulate`` runs a problem at its present point, usually over the first quarter of each record.
    """
    problem, policy = solution.at_optimum, options.policy.step_refinement
    if problem.step.per_interval:
        return None, np.zeros(len(problem.noise.std))
    if simulate is None:
        parts = tuple(r.first(max(CHECKED_ROWS, len(r.u) // 4)) for r in problem.records)

        def simulate(problem: EstimationProblem) -> Runs:
            return replace(problem, records=parts).shooting().simulate(problem.variables.here)

    runs, halved = simulate(problem), problem.halve_step()
    # The change with half the step stands for the error: of a method of order p it is all but 2^-p of it.
    error = compute_change_over_noise(problem, runs, simulate(halved))
    used = problem.step.substeps
    if options.substeps or used >= policy.max_substeps:
        return None, error
    # Substeps that an explicit method needs at the states it came by to be stable, and a little more.
    needed, system, p = 1, problem.model.system, problem.variables.fixed
    if not problem.step.implicit:
        visited = np.concatenate([x[:: max(1, len(x) // 10)] for _, x in runs])
        longest = max(float(r.lengths.max()) for r in problem.records)
        fast = find_fast_relaxing_states(system, p, visited) if problem.method == "mixed" else None
        rules = follow_step(problem.policy.discretisation, problem.step)
        needed = choose_substeps(system, p, visited, longest, relaxing=fast, policy=rules)
    needed = min(needed, policy.max_substeps)
    if is_too_coarse(error, problem, solution.evaluation):
        return halved if needed <= halved.step.substeps else problem.with_substeps(needed), error
    return (problem.with_substeps(needed) if needed > used else None), error


def compute_change_over_noise(problem: EstimationProblem, runs: Runs, finer: Runs) -> np.ndarray:
    """Root-mean-square change of each output from ``runs`` to ``finer`` ones, over its noise (ny,)."""
    with np.errstate(over="ignore", invalid="ignore"):  # of runs that go astray
        change = np.concatenate([a - b for (a, _), (b, _) in zip(runs, finer, strict=True)])
        return np.sqrt(np.mean(change**2, axis=0)) / problem.noise.std


# Change of an output with half the step that is allowed, over its noise (or its misfit where that is even less).
STEP_REFINEMENT_NOISE_SHARE = 0.1
# The same over a misfit far above the noise.
MISFIT_SHARE = 0.01
# The same over the output's standard deviation: a record without any noise leaves nothing but the integrator's own error.
MOVEMENT_SHARE = 1e-07
# Records of so few steps altogether cost nothing, and get the share below.
FEW_STEPS = 2000
# Allowed change over noise and misfit of records of few steps. An error of a share s of the residual changes the cost by 2 s at most, so
# the cost has its first six digits. Steps that follow the error are as many as that takes, however few the rows are.
NOISE_SHARE_OF_FEW = 1e-06


def is_too_coarse(error: np.ndarray, problem: EstimationProblem, evaluation: Evaluation, substeps: int = 0) -> bool:
    """Whether an ``error`` over the noise (ny,), left by the integrator, matters beside noise and misfit.

    ``substeps`` of an interval (0: those of the problem's step) tell how much a smaller step would cost.
    """
    # Misfit of each output over its noise.
    ratio = np.sqrt(evaluation.squares / np.maximum(evaluation.counts, 1))
    steps = (substeps or problem.step.substeps) * sum(len(r.h) for r in problem.records)
    few = steps <= FEW_STEPS and problem.step.adaptive is None
    noise_share = NOISE_SHARE_OF_FEW if few else STEP_REFINEMENT_NOISE_SHARE
    misfit_share = NOISE_SHARE_OF_FEW if few else MISFIT_SHARE
    # A share of the noise (of the misfit where that is even less), or of a misfit far above it.
    allowed = np.maximum(noise_share * np.minimum(ratio, 1.0), misfit_share * ratio)
    # Standard deviation of each output as measured, zero where it was not.
    y = np.concatenate([r.y for r in problem.records])
    seen = np.isfinite(y)
    count = np.maximum(seen.sum(axis=0), 1)
    mean = np.where(seen, y, 0.0).sum(axis=0) / count
    movement = np.sqrt(np.where(seen, (y - mean) ** 2, 0.0).sum(axis=0) / count)
    allowed = np.maximum(allowed, MOVEMENT_SHARE * movement / problem.noise.std)
    return not np.isfinite(error).all() or bool(np.any((error > allowed)[evaluation.counts > 0]))


def solve_single_shooting(
    problem: EstimationProblem, options: FitOptions, report: FitProgressCallback | None = None
) -> Solution:
    """Minimise the cost of the free run over each record."""
    search = _Search(problem, options, report)
    return solve_with_refined_steps(problem, search.solve, search.refine, options.policy.step_refinement)


# Precision of the prior on the logarithm of positive parameters while only part of the record is used: a factor e^2 is one standard
# deviation.
WEAK_PRIOR = 0.25
# Misfit over noise up to which a search has followed its records: hardly anything can lie below it.
AT_NOISE = 1.1
# Growth of the number of substeps that a fit which is not thorough follows: candidates that stray to stiff parameters would take all the
# time.
STIFF_GROWTH = 16
# The same over whole records of a stiff model, in units of the noise: what gains less than a thousandth of it by a decade of a constant
# stays where it is. Else a rate that the records do not show runs away, and the run with it.
STIFF_PRIOR = 1e-3
# Damping of the first step of a stiff model, as a share of the curvature (Marquardt's): its start need not be near.
STIFF_DAMPING = 1e-3
# A first part of whose movement less than this can be followed is too long for that start.
FOLLOWED_SHARE = 0.5
# When a search by simulation error has converged.
CONVERGENCE = minimisation.TerminationPolicy()
# The same for one of many candidates: along a kink (dry friction) it would creep on for dozens of passes, and change no comparison.
CONVERGENCE_OF_CANDIDATES = replace(CONVERGENCE, patience=6, little_gain=1e-4)
# The same over part of a record, which is only a way to a start: a tenth of a standard deviation will do.
CONVERGENCE_IN_PART = replace(CONVERGENCE, negligible_decrease=0.01)


def scale_slopes(evaluation: Evaluation, before: DecisionVector, after: DecisionVector) -> Evaluation:
    """``evaluation`` at the present point of ``before`` along ``after``, which differs in its scales alone."""
    if after is before:
        return evaluation
    # dp/dz of the constants, and the scales of the rest.
    ratio = after.units / before.units
    ratio[after.slices.parameters] = after.spans / before.spans
    return replace(
        evaluation, gradient=evaluation.gradient * ratio, hessian=evaluation.hessian * ratio[:, None] * ratio
    )


def drop_lost_slopes(evaluation: Evaluation) -> Evaluation:
    """``evaluation`` without slopes that are lost in rounding, along which a step would have no end.

    A first velocity that friction stops at once has such a slope beside those of the others.
    """
    curvature = evaluation.hessian.diagonal()
    largest = curvature.max(initial=0.0)
    lost = (curvature > 0) & (curvature <= np.finfo(float).eps ** 2 * largest)
    # Beside slopes that overflow nothing is known of any.
    if not lost.any() or not np.isfinite(largest):
        return evaluation
    kept = np.where(lost, 0.0, 1.0)
    return replace(evaluation, gradient=evaluation.gradient * kept, hessian=evaluation.hessian * kept[:, None] * kept)


class _Search:
    """A search in progress: where it is, and the work since the last solution.

    ``known`` is the evaluation at ``z = 0`` of ``variables`` over the share that comes next, where a former stage has it already.
    """

    def __init__(self, problem: EstimationProblem, options: FitOptions, report: FitProgressCallback | None) -> None:
        self.options, self.report = options, report
        self.first_substeps = problem.step.substeps
        self.progressive = options.progressive and problem.variables.size > 0
        self.known: Evaluation | None = None
        self.shares: list[float] = []

    def solve(self, problem: EstimationProblem) -> Solution:
        """The optimum over whole records, the first time by way of growing parts of them."""
        self.problem, self.variables, self.known = problem, problem.variables, None
        self.status, self.word, self.solver = minimisation.TerminationStatus.CONVERGED, "", ""
        self.iterations = self.passes = 0
        self.seconds, self.shares = 0.0, []
        if self.progressive:
            self.progressive = False
            begun = self.variables
            self.grow()
            self.fit(1.0)
            self.return_to(begun)
        else:
            self.fit(1.0)
        variables = self.variables.with_scales_of(problem.variables)
        return Solution(
            problem,
            variables,
            scale_slopes(self.known or self.measure(1.0), self.variables, variables),
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

    def return_to(self, begun: DecisionVector) -> None:
        """Search once more from where the search began, if that follows the whole record better than its end: parts led it away then.

        Of the start only the constants count: its initial states are a guess, and are adapted first. The better of the two ends stands.
        """
        interrupted = minimisation.TerminationStatus.INTERRUPTED
        if self.status is interrupted or (self.known is not None and self.known.noise_ratio <= AT_NOISE):
            return
        ended, status = (self.variables, self.known, self.word), self.status
        # An end over a part from which the whole cannot be run is none.
        cost = np.inf if self.known is None else self.known.cost
        self.variables, self.known, self.status = begun, None, minimisation.TerminationStatus.CONVERGED
        self.fit(1.0, holds_constants=True)
        if self.known is not None and self.known.cost < cost:
            self.fit(1.0)
        if self.known is None or not self.known.cost < cost:
            self.variables, self.known, self.word = ended
            self.status = self.status if self.status is interrupted else status

    def refine(self, solution: Solution) -> Refinement:
        """A smaller step if need be, but for one of many candidates that would take all the time: it has strayed to stiff constants."""
        # Of a brief look that may take no smaller step nobody asks what one would change: a tenth of a search went into that.
        if not (self.options.thorough or self.options.policy.step_refinement.halvings):
            return None, np.zeros(len(solution.problem.noise.std))
        finer, error = refine_step(solution, self.options)
        too_stiff = STIFF_GROWTH * self.first_substeps
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
            share, self.known = choose_next_share(self.problem, share, outcome.value, self.measure)
            if share < 1:
                outcome = self.fit(share)

    def begin(self) -> tuple[float, minimisation.MinimisationResult | None]:
        """Fit the first part: one so short that it can be followed from these start values, if there is one."""
        share, start = choose_first_share(self.problem), self.variables
        tried: list[tuple[float, float, DecisionVector, minimisation.MinimisationResult]] = []
        while share < 1:
            self.variables, self.status = start, minimisation.TerminationStatus.CONVERGED
            outcome = self.fit(share)
            if outcome is not None:
                tried.append(
                    (compute_explained_share(self.problem, outcome.value, share), share, self.variables, outcome)
                )
            less = shorten_share(self.problem, share)
            if (
                self.status is minimisation.TerminationStatus.INTERRUPTED
                or less == share
                or (outcome is not None and tried[-1][0] >= FOLLOWED_SHARE)
            ):
                break
            share = less
        if not tried:
            return 1.0, None
        _, share, self.variables, outcome = max(tried, key=lambda one: one[0])
        self.status = outcome.status
        return share, outcome

    def fit(self, share: float, holds_constants: bool = False) -> minimisation.MinimisationResult | None:
        """One minimisation over part of the record, of the initial states alone if it holds the constants; None where it cannot begin."""
        if self.over:
            self.known = None
            return None
        start = self.known or self.measure(share)
        self.known = None
        if not np.isfinite(start.cost):
            self.status = minimisation.TerminationStatus.NO_START
            return None
        if not holds_constants:
            self.shares.append(share)
        # Variables in which a step of one changes the cost by about itself, and the evaluation along them.
        variables = self.variables.rescale(start.cost, np.diag(start.hessian) / 2)
        # Constants of a stiff model are rates, by decades apart. A brief look at a candidate begins beside an effect that is hardly there.
        is_stiff = self.problem.step.implicit and self.options.thorough and not holds_constants
        variables = variables.with_logarithms() if is_stiff else variables
        start = drop_lost_slopes(scale_slopes(start, self.variables, variables))
        shooting = self.problem.shooting(variables, share)
        is_whole, low_high = share == 1, variables.bounds()
        if holds_constants:
            for bound in low_high:
                bound[variables.slices.parameters] = 0.0
        # A weak prior on positive constants, in units of the residual variance at the start, where part of the record leaves some open.
        held = variables.here
        variance = max(1.0, start.cost / max(start.count, 1))
        whole_prior = STIFF_PRIOR if is_stiff else 0.0
        variables.split(held).parameters[variables.logarithmic] = whole_prior if is_whole else WEAK_PRIOR * variance

        def evaluate(z: np.ndarray) -> Evaluation:
            e = drop_lost_slopes(shooting.evaluate(z))
            if not held.any():
                return e
            cost, gradient = e.cost + held @ z**2, e.gradient + 2 * held * z
            return replace(e, cost=cost, gradient=gradient, hessian=e.hessian + np.diag(2 * held))

        thorough = self.options.thorough and not holds_constants
        method = MinimisationMethod.IPOPT if thorough else MinimisationMethod.GAUSS_NEWTON
        solvers = self.options.policy.minimisation
        # Along logarithms the curvature changes from step to step: an interior-point method leaves the record there.
        if is_stiff:
            method = MinimisationMethod.DAMPED_FIRST
            solvers = replace(solvers, damped=replace(solvers.damped, initial_damping=STIFF_DAMPING))
        policy = (CONVERGENCE if thorough else CONVERGENCE_OF_CANDIDATES) if is_whole else CONVERGENCE_IN_PART
        outcome = minimise(
            evaluate,
            variables.here,
            *low_high,
            method=method,
            # Elsewhere a constant may have to come from far: an effect begins nearly absent.
            reach=variables.reach if is_stiff else np.inf,
            scale=max(start.cost, TINY),
            value_at_start=start,
            tolerance=self.options.tolerance,
            iterations=self.options.iterations,
            termination_test=minimisation.Termination(policy, *low_high, start.count).test,
            thorough=thorough and is_whole,
            progress=ProgressMonitor(
                self.problem, self.report, share, len(self.shares), len(self.shares) + (share < 1)
            ),
            policy=solvers,
        )
        self.variables, self.status, self.word = variables.recentre(outcome.z), outcome.status, outcome.solver_status
        self.solver = outcome.solver or self.solver
        self.iterations += outcome.iterations
        self.passes += outcome.evaluations
        self.seconds += outcome.seconds
        self.known = outcome.value if is_whole else None
        if is_whole and held.any():
            self.known = self.measure(1.0)
        return outcome
