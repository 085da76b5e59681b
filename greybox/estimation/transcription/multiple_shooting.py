"""Multiple shooting: each record in segments that start from states of their own; they meet at the optimum, or need not (arcs).

For an unstable or chaotic plant, and for long records, where a free run from one initial state forgets the constants (or
overflows) before the optimiser can use them: an error grows over one segment only. Arcs of a chosen length are such segments without
continuity: the initial state of each is eliminated by itself (`ProjectedShooting`), and what drifts along the record does not add up.

With continuity the first states never reach the optimiser as variables either. In each step the segments are linearised,

    r_k + R_k ds_k + P_k dz,      ds_{k+1} = A_k ds_k + B_k dz + d_k,      d_k = x(end of segment k) - s_{k+1},

and the states eliminated from the constrained least-squares problem, which leaves a bounded one in the constants alone (Bock
1987; lifted Newton, Albersmeyer and Diehl 2010). They are eliminated with all at once, not by carrying everything back
to the first one: that product of ``A_k`` is what overflows on an unstable plant.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import casadi as ca
import numpy as np

from greybox.base import TINY, DataError, ModelError
from greybox.base.interrupts import hold_interrupts
from greybox.estimation.optim.methods import minimise
from greybox.estimation.optim.minimisation import MinimisationResult, Termination, TerminationPolicy, TerminationStatus
from greybox.estimation.optim.quadratic_model import QuadraticModel
from greybox.estimation.options import FitOptions, Transcription
from greybox.estimation.transcription import eliminated_states, single_shooting
from greybox.estimation.transcription.decision_vector import DecisionVector
from greybox.estimation.transcription.problem import (
    EstimationProblem,
    FitProgressCallback,
    ProgressMonitor,
    Runs,
    SegmentedRun,
    Solution,
)
from greybox.estimation.transcription.segments import (
    Cuts,
    SegmentedProblem,
    cut_by_growth,
    cut_in_seconds,
    estimate_segment_states,
    fit_without_continuity,
)
from greybox.estimation.transcription.select import TranscriptionChoice
from greybox.estimation.transcription.shooting_cost import Evaluation, SingleShooting, compute_gauss_newton_step
from greybox.simulation.integrators.step import Step
from greybox.simulation.kernel.make_kernel import make_kernel
from greybox.simulation.kernel.record import Record

# Arcs longer than the longest record by at most this share are the whole record, and no mistake.
LENGTH_TOLERANCE = 0.01


def solve_multiple_shooting(
    choice: TranscriptionChoice, options: FitOptions, report: FitProgressCallback | None = None
) -> Solution:
    """Minimise the cost of each record's segments, which end where the next one begins; arcs need not.

    Raises DataError for arcs that are too short (`split_into_arcs`) or longer than every record, ModelError for too many of them where
    their states cannot be eliminated.
    """
    continuity = choice.transcription is Transcription.MULTIPLE
    length, longest = options.arc_length, max(float(record.h.sum()) for record in choice.problem.records)
    if not continuity and length > longest * (1 + LENGTH_TOLERANCE):
        raise DataError(
            f"arcs of {length:g} s: the longest record lasts {longest:.6g} s, so no record would be divided; take shorter arcs, or leave"
            " arc_length out (shell: --arc-length)"
        )
    cuts = cut_records(choice.problem, options)
    search = _SegmentSearch(SegmentedProblem.of(choice.problem, cuts), continuity, options, report)
    solution = single_shooting.solve_with_refined_steps(
        choice.problem, search.solve, search.refine, options.policy.step_refinement
    )
    count, is_whole = sum(len(places) - 1 for places in cuts), all(len(places) == 2 for places in cuts)
    values = {"segments": count} if continuity else {"arcs": count, "arc_length": length, "whole": is_whole}
    solution = replace(solution, transcription=str(choice.transcription), strategy=choice.to_strategy(**values))
    return replace(solution, joined=search.join()) if np.isfinite(solution.evaluation.cost) else solution


def cut_records(problem: EstimationProblem, options: FitOptions) -> Cuts:
    """Where a search over arcs, or over segments that meet, cuts the records."""
    return cut_in_seconds(problem, options.arc_length) if options.arc_length else cut_by_growth(problem)


def evaluate_apart(
    problem: EstimationProblem, cuts: Cuts, states: np.ndarray | None
) -> tuple[Evaluation, tuple[np.ndarray, np.ndarray], np.ndarray]:
    """The cost at the present point of segments that need not meet, the distances to the bounds, and the first states (segments, nx).

    These are the best ones; they are searched for from ``states`` on, or segment by segment.
    """
    segmented = SegmentedProblem.of(problem, cuts, states)
    pieces = segmented.pieces
    if states is None:
        projected = estimate_segment_states(segmented)
    else:
        projected = eliminated_states.ProjectedShooting(pieces.with_plain_squares().shooting())
    evaluation = projected.evaluate(np.zeros(projected.size))
    first = np.concatenate([np.zeros(projected.size), projected.states.ravel()])
    variables = pieces.variables.recentre(first)
    # The first states are eliminated where the search does so (`MultipleShooting`).
    if pieces.is_plain_squares:
        return evaluation, projected.bounds(), variables.initial.guess
    return pieces.shooting(variables).evaluate(variables.here), variables.bounds(), variables.initial.guess


@dataclass(frozen=True, kw_only=True)
class MultipleShootingResult(Solution):
    """The optimum of a search over segments: of the constants, every state eliminated (its rows of the evaluation are zero).

    ``segmented``: the segments with their present point there; ``rows``: weighted residuals (N, ny) of each record and their Jacobian
    (N, ny, L) along `DecisionVector.columns`; ``gap``: the largest jump between segments, as a share of the state's range.
    """

    segmented: SegmentedProblem
    rows: Runs = ()
    gap: float = np.inf

    @property
    def is_run(self) -> bool:
        """Whether the segments meet."""
        return self.gap <= MULTIPLE_SHOOTING_CONTINUITY

    @classmethod
    def of(
        cls,
        segmented: SegmentedProblem,
        evaluation: Evaluation,
        outcome: Solution | MinimisationResult,
        rows: Runs = (),
        gap: float = np.inf,
    ) -> MultipleShootingResult:
        """What a search ``outcome`` means; ``rows`` are those of the segments along the constants alone."""
        whole = segmented.whole
        states = len(whole.variables.free_states)
        whole_rows = [(r, np.pad(jacobian, ((0, 0), (0, 0), (0, states)))) for r, jacobian in rows]
        return cls(
            whole,
            whole.variables,
            evaluation,
            outcome.status,
            outcome.solver_status,
            outcome.iterations,
            outcome.evaluations,
            outcome.seconds,
            (1.0,),
            np.zeros(len(whole.noise.std)),
            solver=outcome.solver,
            segmented=segmented,
            rows=segmented.join(whole_rows) if rows else (),
            gap=gap,
        )


class _SegmentSearch:
    """A search over segments at one integration step after the other, each from the optimum of the one before."""

    def __init__(
        self, segmented: SegmentedProblem, continuity: bool, options: FitOptions, report: FitProgressCallback | None
    ) -> None:
        self.segmented, self.continuity, self.options, self.report = segmented, continuity, options, report
        self.result: MultipleShootingResult | None = None

    def solve(self, problem: EstimationProblem) -> Solution:
        """The optimum with the step of ``problem``."""
        shooting = MultipleShooting(self.segmented.with_step_of(problem), continuity=self.continuity)
        self.result = shooting.solve(self.options, initialise=self.result is None, report=self.report)
        self.segmented = self.result.segmented
        return self.result

    def refine(self, solution: Solution) -> single_shooting.Refinement:
        """A smaller step if need be."""
        return single_shooting.refine_step(
            solution, self.options, lambda problem: self.segmented.with_step_of(problem).simulate()
        )

    def join(self) -> SegmentedRun:
        """The run of the segments at the optimum, and what half the step does to the constants."""
        assert self.result is not None  # a solution was found
        problem, shift = self.segmented.whole, np.zeros(len(self.result.variables.which))
        if not problem.step.per_interval and len(shift):
            both = self.segmented, self.segmented.with_step_of(problem.halve_step())
            coarse, fine = (MultipleShooting(s, continuity=self.continuity).gauss_newton_step() for s in both)
            # Both steps from the same point: what the search has left over does not count.
            shift = fine - coarse
        size = self.result.variables.size if self.continuity else self.segmented.pieces.variables.size
        return SegmentedRun(self.segmented.simulate(), self.result.rows, size, shift)


# Nothing is left to gain: within a thousandth of a standard deviation.
MULTIPLE_SHOOTING_TERMINATION = TerminationPolicy(negligible_decrease=1e-6, patience=8)
# Largest gap between segments of a converged solution, as a share of each state's range.
MULTIPLE_SHOOTING_CONTINUITY = 1e-07
# Shares of a step that are tried in turn, until the cost or the gaps come down.
STEP_LENGTHS: tuple[float, ...] = (1.0, 0.5, 0.25, 0.1, 0.03)
# Dampings, as shares of the curvature, that are tried in turn with all step lengths.
MULTIPLE_SHOOTING_DAMPINGS: tuple[float, ...] = (0.0, 0.01, 1.0, 100.0)
# Unknowns of a fit by arcs with coloured noise, robust loss or priors at most: its Hessian is dense.
MOST_UNKNOWNS = 1000
# Share of the gaps by which a step has to be better than every point before it, in the gaps or in the cost.
FILTER_MARGIN = 0.001
# Where no step helps any more, a point that meets the convergence test this many times less strictly is an optimum to within rounding
# errors.
ROUNDING_SLACK = 10000.0


class MultipleShooting:
    """Segments of records, each with a first state of its own.

    Parameters
    ----------
    segmented
        The segments.
    continuity
        Whether a segment ends where the next one begins.
    """

    def __init__(self, segmented: SegmentedProblem, *, continuity: bool = True) -> None:
        self.continuity, self.evaluations = continuity, 0
        self._place(segmented)

    def _place(self, segmented: SegmentedProblem) -> None:
        """Let the present point be that of ``segmented``."""
        self.segmented, pieces = segmented, segmented.pieces
        self.variables, self.n = pieces.variables, len(pieces.variables.which)
        self.ny, self.nx = len(pieces.noise.std), pieces.variables.initial.guess.shape[1]
        self.joints = [not begins for begins in segmented.starts_record[1:]] + [False]
        if self.continuity:
            step, weight = add_state_outputs(pieces.step), np.concatenate([1 / pieces.noise.std, np.ones(self.nx)])
            whole = zip(segmented.whole.shooting().records, segmented.cuts, strict=True)
            records = [slice_segment(r, a, b, self.nx) for r, places in whole for a, b in pairwise(places)]
            self.with_ends = SingleShooting(self.variables, step, make_kernel(step), records, weight)

    def solve(
        self, options: FitOptions | None = None, *, initialise: bool = True, report: FitProgressCallback | None = None
    ) -> MultipleShootingResult:
        """Minimise the cost from the present point.

        Parameters
        ----------
        options
            How far to go, and where without continuity a general method is used.
        initialise
            Whether the first states are estimated first and, with continuity, the segments fitted as if they need not meet.
        report
            Called after every iteration.
        """
        options = options or FitOptions()
        return (self._solve_joined if self.continuity else self._solve_apart)(options, initialise, report)

    def gauss_newton_step(self) -> np.ndarray:
        """The next step of the constants (nf,) in ``z`` from the present point; NaN where a segment overflows."""
        if not self.continuity:
            whole = self.segmented.whole.variables
            evaluation = _evaluate_rows(_project_residuals(self.segmented.pieces), whole)
            return compute_gauss_newton_step(whole, evaluation)[: self.n]
        linearised = self._linearise(self.variables.here)
        return np.full(self.n, np.nan) if linearised is None else self._compute_step(linearised)[: self.n]

    def _solve_apart(
        self, options: FitOptions, initialise: bool, report: FitProgressCallback | None
    ) -> MultipleShootingResult:
        """Without continuity.

        Where the cost is plain squares the initial states are eliminated segment by segment, else they are searched for with the
        constants.
        """
        pieces = self.segmented.pieces
        if not pieces.is_plain_squares:
            if pieces.variables.size > MOST_UNKNOWNS:
                raise ModelError(
                    f"arcs of {options.arc_length:g} s: {len(self.segmented.starts_record)} of them have {pieces.variables.size} unknowns"
                    f" together; with coloured noise, robust loss or priors at most {MOST_UNKNOWNS} are possible: take longer arcs"
                )
            solution = single_shooting.solve_single_shooting(pieces, replace(options, progressive=False), report)
            segmented = self.segmented.with_step_of(solution.problem).at(solution.variables)
            return self._end_apart(segmented, solution.evaluation, solution)
        projected = eliminated_states.ProjectedShooting(pieces.shooting())
        if initialise:
            projected.carry_states(self.segmented.starts_record)
        (low, high), zero = projected.bounds(), np.zeros(projected.size)
        first = projected.evaluate(zero)
        outcome = minimise(
            projected.evaluate,
            zero,
            low,
            high,
            scale=max(first.cost, TINY),
            value_at_start=first,
            tolerance=options.tolerance,
            iterations=options.iterations,
            termination_test=Termination(single_shooting.CONVERGENCE, low, high, first.count).test,
            thorough=options.thorough,
            progress=ProgressMonitor(pieces, report),
            policy=options.policy.minimisation,
        )
        segmented = self.segmented.at(self.variables.recentre(projected.full(outcome.z)))
        return self._end_apart(segmented, outcome.value or first, outcome)

    def _end_apart(
        self, segmented: SegmentedProblem, reached: Evaluation, outcome: Solution | MinimisationResult
    ) -> MultipleShootingResult:
        """What a search without continuity ended with, its states eliminated to first order."""
        v = segmented.whole.variables
        if not np.isfinite(reached.cost):
            failed = Evaluation.failure(v.size, self.ny, reached.failed or (0, 0))
            return MultipleShootingResult.of(segmented, failed, outcome)
        rows = _project_residuals(segmented.pieces)
        evaluation = replace(_evaluate_rows(rows, v), cost=reached.cost, squares=reached.squares)
        return MultipleShootingResult.of(segmented, evaluation, outcome, rows, 0.0)

    def _solve_joined(
        self, options: FitOptions, initialise: bool, report: FitProgressCallback | None
    ) -> MultipleShootingResult:
        """With continuity: lifted Gauss-Newton."""
        began, monitor = time.perf_counter(), ProgressMonitor(self.segmented.pieces, report)
        with hold_interrupts(monitor):
            # First states are estimated from the samples of each segment, and the constants fitted as if they need not meet.
            if initialise:
                v, arcs = self.segmented.whole.variables, estimate_segment_states(self.segmented)
                point = self.variables.recentre(fit_without_continuity(arcs))
                states, declared = point.initial.guess.copy(), ~v.initial.free
                for e, k in enumerate(np.flatnonzero(self.segmented.starts_record)):
                    states[k, declared] = v.initial.guess[e, declared]
                self._place(self.segmented.at(replace(point, initial=replace(point.initial, guess=states))))
            linearised = self._linearise(self.variables.here)
            status, iteration = TerminationStatus.NO_START, 0
            if linearised is not None:
                count = max(int(linearised.counts.sum()), 1)
                termination = Termination(MULTIPLE_SHOOTING_TERMINATION, count=count)
                visited: list[tuple[float, float]] = []
                while True:
                    is_joined = linearised.gap < MULTIPLE_SHOOTING_CONTINUITY
                    if monitor(iteration, linearised.cost):
                        status = TerminationStatus.INTERRUPTED
                    elif self._is_converged(linearised, termination):
                        status = TerminationStatus.CONVERGED
                    elif termination.is_flat(linearised.cost) and is_joined:
                        status = TerminationStatus.ACCEPTABLE
                    elif iteration == options.iterations:
                        status = TerminationStatus.ITERATION_LIMIT
                    else:
                        visited.append((linearised.violation, linearised.cost))
                        following = self._search_step(linearised, visited)
                        if following is not None:
                            linearised, iteration = following, iteration + 1
                            continue
                        # At rounding errors, or truly stuck.
                        is_optimum = self._is_converged(linearised, termination, ROUNDING_SLACK)
                        status = TerminationStatus.ACCEPTABLE if is_optimum else TerminationStatus.STUCK
                    break
                # The last step is known already: it gives the constants their digits.
                if status is TerminationStatus.CONVERGED:
                    last = self._linearise(linearised.z + self._compute_step(linearised))
                    if last and last.cost <= linearised.cost and self._is_converged(last, termination):
                        linearised = last
                if monitor.stop:  # also where the last iteration was the last anyway: the caller would go on
                    status = TerminationStatus.INTERRUPTED
        work, label = (iteration, self.evaluations, time.perf_counter() - began), "lifted Gauss-Newton"
        size, n, ny = self.segmented.whole.variables.size, self.n, self.ny
        if linearised is None:
            nowhere = MinimisationResult(self.variables.here, np.inf, status, *work, solver=label)
            return MultipleShootingResult.of(self.segmented, Evaluation.failure(size, ny, (0, 0)), nowhere)
        outcome = MinimisationResult(linearised.z, linearised.cost, status, *work, solver=label)
        gradient, hessian = np.zeros(size), np.zeros((size, size))
        gradient[:n], hessian[:n, :n] = linearised.model.gradient, linearised.model.hessian
        evaluation = Evaluation(linearised.cost, gradient, hessian, linearised.squares, linearised.counts)
        # Residuals along the constants, the states following them: P + R S.
        rows = []
        residuals, slopes = self.with_ends.residuals(linearised.z), linearised.condensed.slope
        for (r, j), record, slope in zip(residuals, self.segmented.pieces.records, slopes, strict=True):
            count = len(record.samples(record.y))
            r, j = r[:count, :ny], j[:count, :ny]
            rows.append((r, j[:, :, :n] + j[:, :, n:] @ slope))
        segmented = self.segmented.at(self.variables.recentre(linearised.z))
        return MultipleShootingResult.of(segmented, evaluation, outcome, rows, linearised.gap)

    def _is_converged(self, linearised: _LinearisedPoint, termination: Termination, slack: float = 1.0) -> bool:
        """Whether a further step would neither lower the cost nor close a gap."""
        change = abs(linearised.cost - linearised.cost_after(self._compute_step(linearised)))
        is_joined = linearised.gap <= MULTIPLE_SHOOTING_CONTINUITY
        return is_joined and termination.is_negligible(change, linearised.cost, slack)

    def _search_step(
        self, linearised: _LinearisedPoint, visited: Sequence[tuple[float, float]]
    ) -> _LinearisedPoint | None:
        """The next point: the longest step, ever more damped, that lowers the cost or the gaps (filter of Fletcher and Leyffer)."""
        for damping in MULTIPLE_SHOOTING_DAMPINGS:
            step = self._compute_step(linearised, damping)
            for length in STEP_LENGTHS:
                trial = self._linearise(linearised.z + length * step)
                if trial is not None and trial.improves_on(visited, FILTER_MARGIN):
                    return trial
        return None

    def _compute_step(self, linearised: _LinearisedPoint, damping: float = 0.0) -> np.ndarray:
        """The step of constants and first states that minimises the condensed quadratic within the bounds of the constants."""
        z = linearised.z[: self.n]
        reach = self.variables.reach[: self.n]
        low, high = (edge[: self.n] - z for edge in self.variables.bounds())
        step = linearised.model.bounded_step(np.maximum(low, -reach), np.minimum(high, reach), damping)
        return linearised.condensed.step(step)

    def _linearise(self, z: np.ndarray) -> _LinearisedPoint | None:
        """Residuals, end states and their slopes of every segment, the states eliminated; None where a segment overflows, or nearly."""
        self.evaluations += 1
        v, ny, scale = self.variables, self.ny, self.variables.initial.scale
        states = v.initial.guess + scale * v.split(z).initial_states
        segments, squares, counts = [], np.zeros(ny), np.zeros(ny, int)
        for k, (r, j) in enumerate(self.with_ends.residuals(z)):
            # The last row measures the states as zero: its residual is minus the end of the segment.
            end, ends = -r[-1, ny:], -j[-1, ny:]
            r, j = r[:, :ny], j[:, :ny]
            is_measured = np.isfinite(self.with_ends.records[k].samples(self.with_ends.records[k].y)[:, :ny])
            if not all(np.isfinite(values).all() for values in (end, ends, r[is_measured], j[is_measured])):
                return None
            with np.errstate(over="ignore"):  # far from a solution: an infinite cost is the right one
                squares += np.square(np.where(is_measured, r, 0.0)).sum(axis=0)
            counts += is_measured.sum(axis=0)
            # d_k = x(end of segment k) - s_{k+1}, in scaled states.
            defect = (end - states[k + 1]) / scale if self.joints[k] else np.zeros(self.nx)
            segments.append(
                eliminated_states.LinearisedSegment(r[is_measured], j[is_measured], ends / scale[:, None], defect)
            )
        # The first states of records are held to what is declared.
        whole = self.segmented.whole.variables
        declared = np.flatnonzero(~whole.initial.free)
        if len(declared):
            point = whole.here
            whole.split(point).parameters[:] = z[: self.n]
            for e, first in enumerate(np.flatnonzero(self.segmented.starts_record)):
                x0, dx0 = whole.compute_initial_state(point, whole.parameters(point, e), e)
                distance, slope = (x0 - states[first]) / scale, dx0[:, : self.n] / scale[:, None]
                segments[first] = replace(segments[first], tie=(declared, distance[declared], slope[declared]))
        edges = np.cumsum([0, *(len(places) - 1 for places in self.segmented.cuts)])
        condensed = eliminated_states.condense([segments[a:b] for a, b in pairwise(edges)], self.n)
        if condensed is None:
            return None
        gaps = np.concatenate([np.abs(s.defect) for s in segments])
        # A start that follows the constants is met like the start of any other segment.
        away = np.concatenate([np.zeros(1), *(np.abs(s.tie[1]) for s in segments if s.tie is not None)])
        prior = v.penalty(z) if v.has_prior.any() else (0.0, np.zeros(self.n), np.zeros(self.n))
        gap, violation = max(float(gaps.max()), float(away.max())), float(gaps.sum()) + float(away.sum())
        return _LinearisedPoint(z, squares, counts, condensed, prior, gap, violation)


@dataclass(frozen=True)
class _LinearisedPoint:
    """One point, and the problem there with its states eliminated; ``prior``: what priors add, its slope and curvature (nf,)."""

    z: np.ndarray
    squares: np.ndarray
    counts: np.ndarray
    condensed: eliminated_states.CondensedProblem
    prior: tuple[float, np.ndarray, np.ndarray]
    gap: float
    violation: float

    @property
    def cost(self) -> float:
        """The cost of the segments as they are."""
        return float(self.squares.sum()) + self.prior[0]

    def improves_on(self, visited: Sequence[tuple[float, float]], margin: float) -> bool:
        """Whether the point is better than each visited one in its gaps or in its cost."""
        # Fletcher and Leyffer's filter: better in one of the two than every point before it.
        slack = margin * min(self.violation, 1.0)
        return all(
            self.violation < (1 - margin) * gaps or self.cost < cost - slack * abs(cost) for gaps, cost in visited
        )

    @cached_property
    def model(self) -> QuadraticModel:
        """The cost along the constants."""
        _, slope, curvature = self.prior
        condensed = self.condensed
        return QuadraticModel(self.cost, condensed.gradient + slope, condensed.hessian + np.diag(curvature))

    def cost_after(self, step: np.ndarray) -> float:
        """The linearised cost after a step."""
        cost, slope, curvature = self.prior
        dz = step[: len(slope)]
        return self.condensed.cost_after(step) + cost + float(np.sum(slope * dz + 0.5 * curvature * dz**2))


def _project_residuals(pieces: EstimationProblem) -> list[tuple[np.ndarray, np.ndarray]]:
    """Residuals (N, ny) of each segment and their Jacobian (N, ny, nf), its initial state at its best for the constants."""
    n, result = len(pieces.variables.which), []
    for r, jacobian in pieces.shooting().residuals(pieces.variables.here):
        measured = jacobian[np.isfinite(r)]
        slope = eliminated_states.project_states(measured.T @ measured, n)
        result.append((r, jacobian[:, :, :n] + jacobian[:, :, n:] @ slope))
    return result


def _evaluate_rows(rows: Runs, variables: DecisionVector) -> Evaluation:
    """Cost, gradient and Gauss-Newton matrix of residuals along the constants, initial states eliminated (their rows are zero)."""
    n = len(variables.which)
    gradient, hessian = np.zeros(variables.size), np.zeros((variables.size, variables.size))
    squares = np.sum([np.nansum(r**2, axis=0) for r, _ in rows], axis=0)
    counts = np.sum([np.isfinite(r).sum(axis=0) for r, _ in rows], axis=0)
    for r, jacobian in rows:
        measured = np.isfinite(r)
        slopes = jacobian[measured]
        gradient[:n] += 2 * slopes.T @ r[measured]
        hessian[:n, :n] += 2 * slopes.T @ slopes
    return Evaluation(float(squares.sum()), gradient, hessian, squares, counts)


def add_state_outputs(step: Step) -> Step:
    """The step with its states as further outputs, so that the kernel gives the end of a segment with its slopes."""
    f = step.outputs
    x, u, p = (ca.SX.sym(name, f.size1_in(k)) for k, name in enumerate(("x", "u", "p")))
    return replace(step, outputs=ca.Function("outputs", [x, u, p], [ca.vertcat(f(x, u, p), x)]))


def slice_segment(record: Record, a: int, b: int, nx: int) -> Record:
    """Rows ``a`` to ``b``; the last one is the first of the next segment and counts for its states alone."""
    last = min(b + 1, len(record.u))
    y = np.full((last - a, record.y.shape[1] + nx), np.nan)
    y[: b - a, : record.y.shape[1]] = record.y[a:b]
    y[-1, record.y.shape[1] :] = 0.0
    return replace(record, u=record.u[a:last], y=y, h=record.h[a : last - 1], row=record.row[a : last - 1])
