"""Multiple shooting: each record in segments that start from states of their own and are made to meet at the optimum.

For an unstable or chaotic plant, and for long records, where a free run from one initial state forgets the constants (or
overflows) before the optimiser can use them: an error grows over one segment only.

The nodes never reach the optimiser as variables. In each step the segments are linearised,

    r_k + R_k ds_k + P_k dz,      ds_{k+1} = A_k ds_k + B_k dz + d_k,      d_k = x(end of segment k) - s_{k+1},

and the nodes eliminated from the constrained least-squares problem, which leaves a bounded one in the constants alone (Bock
1987; lifted Newton, Albersmeyer and Diehl 2010). They are eliminated with all nodes at once, not by carrying everything back
to the first one: that product of ``A_k`` is what overflows on an unstable plant.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import casadi as ca
import numpy as np

from greybox.integrators import Step
from greybox.kernel import Kernel, Record, make_kernel
from greybox.numerics import CONSTANT_STATE
from greybox.optim.status import TerminationStatus
from greybox.transcription.arcs import place_cuts
from greybox.transcription.condensing import CondensedProblem, LinearisedSegment, condense
from greybox.transcription.decision_vector import DecisionVector
from greybox.transcription.initialisation import (
    compute_bounded_step,
    estimate_arc_states,
    fit_without_continuity,
    simulate_segments,
    to_nodes,
)
from greybox.transcription.policy import DEFAULT_POLICY, SegmentPolicy, TranscriptionPolicy
from greybox.transcription.simulation_error import Evaluation, SingleShooting

Report = Callable[[int, float], object]
"""``(iteration, cost)``, called after every iteration; an answer that is true ends the search."""


@dataclass(frozen=True)
class MultipleShootingResult:
    """The optimum of a multiple-shooting fit."""

    variables: DecisionVector
    """The decision vector with ``z = 0`` at the optimum."""

    evaluation: Evaluation
    """Cost, gradient and Gauss-Newton matrix of the constants, every state eliminated: the rows of initial states are zero."""

    nodes: tuple[np.ndarray, ...]
    """First states of the segments of each record, its end included (segments + 1, nx)."""

    runs: tuple[tuple[np.ndarray, np.ndarray], ...]
    """Outputs (N, ny) and states (N, nx) of each record, segment by segment."""

    rows: tuple[tuple[np.ndarray, np.ndarray], ...]
    """Weighted residuals (N, ny) of each record and their Jacobian (N, ny, L) along `DecisionVector.columns`, states eliminated."""

    gap: float
    """The largest jump between segments, as a share of the state's range."""

    status: TerminationStatus
    """How the search ended."""

    iterations: int
    evaluations: int
    seconds: float

    @property
    def converged(self) -> bool:
        """Whether the point can be used as an optimum."""
        return self.status.success


def choose_segment_rows(growth: float, record: Record, policy: SegmentPolicy = DEFAULT_POLICY.segments) -> int:
    """Samples of a segment for a plant whose errors grow by ``exp(growth t)`` (1/s; at most zero: they do not)."""
    longest = max(len(record.samples(record.u)) // policy.max_segments, policy.usual_rows)
    period = record.rows_per_sample * float(np.median(record.h)) if len(record.h) else 1.0
    if growth > 0:
        longest = min(longest, int(np.log(policy.max_growth) / (growth * period)))
    return max(policy.least_rows, longest)


class MultipleShooting:
    """Lifted Gauss-Newton over records cut in segments.

    Parameters
    ----------
    variables, step, records, weight
        As for `SingleShooting`.
    kernel
        Used for the first guess of the nodes: hidden states of each segment are found from its own samples at the start values,
        beginning where the segment before ended.
    rows
        Samples of a segment: one number, or one for each record.
    nodes
        First states of the segments (segments, nx) of each record, in the place of that guess.
    policy
        When the search has converged and which steps it takes, how it begins, and how short a segment may be.
    """

    def __init__(
        self,
        variables: DecisionVector,
        step: Step,
        kernel: Kernel,
        records: Sequence[Record],
        weight: np.ndarray,
        rows: int | Sequence[int],
        nodes: Sequence[np.ndarray] | None = None,
        policy: TranscriptionPolicy = DEFAULT_POLICY,
    ) -> None:
        self.variables, self.weight = variables, weight
        self.policy, self.relaxation = policy.multiple_shooting, policy.relaxation
        self.single = SingleShooting(variables, step, kernel, records, weight)
        self.records = self.single.records
        segment_rows = [rows] * len(records) if isinstance(rows, int) else list(rows)
        pairs = zip(self.records, segment_rows, strict=True)
        self.cuts = [place_segments(e, r, n, policy.segments) for e, (r, n) in enumerate(pairs)]
        self.kernel = make_kernel(add_state_outputs(step))
        self.nx, self.ny = step.advance.size1_in(0), len(weight)
        self.segments = [
            [slice_segment(r, a, b, self.nx) for a, b in pairwise(c)]
            for r, c in zip(self.records, self.cuts, strict=True)
        ]
        self._arcs = estimate_arc_states(self.single, self.cuts, policy.projection) if nodes is None else None
        first_nodes = to_nodes(self.single, self.cuts, self._arcs) if self._arcs else nodes or ()
        self.nodes = [np.array(n, float) for n in first_nodes]
        self.scale = measure_state_ranges(self.nodes)
        self.evaluations = 0

    def solve(
        self, *, iterations: int = 100, relax: bool = True, report: Report | None = None
    ) -> MultipleShootingResult:
        """Minimise the cost with the segments joined, from ``z = 0`` and the present nodes.

        Parameters
        ----------
        iterations
            The most iterations.
        relax
            Whether the segments are first fitted as arcs that need not meet (not where nodes were given).
        report
            Called with the number of each iteration and its cost; ends the search by an answer that is true.
        """
        began = time.perf_counter()
        point = _ShootingPoint(self.variables.here, self.nodes)
        if relax and self._arcs:
            point.z[: self._arcs.size] = fit_without_continuity(self._arcs, self.relaxation)
            point.nodes = to_nodes(self.single, self.cuts, self._arcs)
        linearised = self._linearise(point)
        status, costs, iteration = TerminationStatus.NO_START, [], 0
        while linearised is not None:
            costs.append(linearised.cost)
            if report and report(iteration, linearised.cost):
                status = TerminationStatus.INTERRUPTED
                break
            is_joined = linearised.gap < self.policy.continuity
            if self._is_converged(linearised) or (is_joined and self._is_flat(costs)):
                is_converged = self._is_converged(linearised)
                status = TerminationStatus.CONVERGED if is_converged else TerminationStatus.ACCEPTABLE
                break
            if iteration == iterations:
                status = TerminationStatus.ITERATION_LIMIT
                break
            accepted = self._search_step(point, linearised)
            if accepted is None:  # at rounding errors, or truly stuck
                is_optimum = self._is_converged(linearised, self.policy.rounding_slack)
                status = TerminationStatus.ACCEPTABLE if is_optimum else TerminationStatus.STUCK
                break
            point, linearised = accepted
            iteration += 1
        return self._make_result(point, linearised, status, iteration, time.perf_counter() - began)

    def gauss_newton_step(self) -> np.ndarray:
        """The next Gauss-Newton step of the constants (nf,) in ``z`` from the present nodes; NaN where a segment overflows."""
        linearised = self._linearise(_ShootingPoint(self.variables.here, self.nodes))
        if linearised is None:
            return np.full(len(self.variables.which), np.nan)
        return self._compute_step(linearised, 0.0)[0]

    def _is_converged(self, linearised: _LinearisedPoint, slack: float = 1.0) -> bool:
        """Whether a further step would neither lower the cost nor close a gap."""
        policy, count = self.policy, max(int(linearised.counts.sum()), 1)
        change = abs(linearised.cost - linearised.condensed.cost_after(self._compute_step(linearised, 0.0)))
        negligible = policy.negligible_decrease * linearised.cost / count + policy.negligible_ratio**2 * count
        return linearised.gap <= policy.continuity and change <= slack * negligible

    def _is_flat(self, costs: Sequence[float]) -> bool:
        """Whether the last iterations gained next to nothing."""
        patience = self.policy.patience
        return len(costs) > patience and costs[-1 - patience] - costs[-1] <= self.policy.little_gain * costs[-1]

    def _search_step(
        self, point: _ShootingPoint, linearised: _LinearisedPoint
    ) -> tuple[_ShootingPoint, _LinearisedPoint] | None:
        """The next point: the longest step, ever more damped, that lowers the cost or the gaps (filter of Fletcher and Leyffer)."""
        point.filter.append((linearised.violation, linearised.cost))
        for damping in self.policy.dampings:
            step = self._compute_step(linearised, damping)
            for length in self.policy.step_lengths:
                trial = self._take_step(point, step, length)
                linearised_trial = self._linearise(trial)
                if linearised_trial is not None and trial.accepts(
                    linearised_trial.violation, linearised_trial.cost, self.policy.filter_margin
                ):
                    return trial, linearised_trial
        return None

    def _compute_step(self, linearised: _LinearisedPoint, damping: float) -> tuple[np.ndarray, list[np.ndarray]]:
        """The step of constants and nodes that minimises the condensed quadratic within the bounds of the constants."""
        condensed = linearised.condensed
        dz = compute_bounded_step(
            self.variables, linearised.z, condensed.gradient, condensed.hessian, damping, self.relaxation
        )
        return condensed.step(dz)

    def _take_step(
        self, point: _ShootingPoint, step: tuple[np.ndarray, list[np.ndarray]], length: float
    ) -> _ShootingPoint:
        dz, ds = step
        z = point.z.copy()
        z[: len(dz)] += length * dz
        nodes = [s + length * d * self.scale for s, d in zip(point.nodes, ds, strict=True)]
        return _ShootingPoint(z, nodes, list(point.filter))

    def _linearise(self, point: _ShootingPoint) -> _LinearisedPoint | None:
        """Residuals, end states and their slopes of every segment, the nodes eliminated; None where a segment overflows, or nearly."""
        self.evaluations += 1
        segments, squares, counts = [], np.zeros(self.ny), np.zeros(self.ny, int)
        for e in range(len(self.records)):
            record_segments = self._linearise_record(point, e, squares, counts)
            if record_segments is None:
                return None
            segments.append(record_segments)
        condensed = condense(segments, len(self.variables.which))
        if condensed is None:
            return None
        if self.variables.has_prior.any():
            condensed = condensed.with_penalty(*self.variables.penalty(point.z))
        gaps = np.concatenate([np.abs(s.defect) for record_segments in segments for s in record_segments])
        return _LinearisedPoint(
            point.z,
            float(squares.sum()) + condensed.prior[0],
            squares,
            counts,
            condensed,
            float(gaps.max(initial=0.0)),
            float(gaps.sum()),
        )

    def _run_segments(self, point: _ShootingPoint, e: int) -> list[tuple[np.ndarray, np.ndarray]]:
        """Residuals and Jacobian, along the constants and its own first state, of each segment of record ``e``; states beside outputs."""
        n, nx = len(self.variables.which), self.nx
        p = self.variables.parameters(point.z, e)
        q, dq, dp, _, _ = self.single.at(point.z, p, e)
        dx0 = np.zeros((nx, n + nx))
        dx0[:, n:] = np.diag(self.scale)
        dq = np.concatenate([dq[:, :, :n], np.zeros((*dq.shape[:2], nx))], axis=2)
        dp = np.concatenate([dp[:, :n], np.zeros((len(dp), nx))], axis=1)
        weight = np.concatenate([self.weight, np.ones(nx)])
        return [
            self.kernel.residuals(segment, q, dq, p, dp, node, dx0, weight)
            for segment, node in zip(self.segments[e], point.nodes[e], strict=False)
        ]

    def _linearise_record(
        self, point: _ShootingPoint, e: int, squares: np.ndarray, counts: np.ndarray
    ) -> list[LinearisedSegment] | None:
        v, n, nodes = self.variables, len(self.variables.which), point.nodes[e]
        segments = []
        for k, ((r, j), segment) in enumerate(zip(self._run_segments(point, e), self.segments[e], strict=True)):
            end, ends = -r[-1, self.ny :], -j[-1, self.ny :]
            r, j = r[:, : self.ny], j[:, : self.ny]
            is_measured = np.isfinite(segment.y[:, : self.ny])
            if not all(np.isfinite(values).all() for values in (end, ends, r[is_measured], j[is_measured])):
                return None
            squares += np.square(np.where(is_measured, r, 0.0)).sum(axis=0)
            counts += is_measured.sum(axis=0)
            defect = (end - nodes[k + 1]) / self.scale
            segments.append(LinearisedSegment(r[is_measured], j[is_measured], ends / self.scale[:, None], defect, None))
        declared = np.flatnonzero(~v.initial.free)
        if len(declared):  # states that begin as declared
            *_, x0, dx0 = self.single.at(point.z, v.parameters(point.z, e), e)
            tie = declared, ((x0 - nodes[0]) / self.scale)[declared], (dx0[:, :n] / self.scale[:, None])[declared]
            segments[0] = replace(segments[0], tie=tie)
        return segments

    def _condense_residuals(self, point: _ShootingPoint, e: int, slope: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Residuals (N, ny) of record ``e`` and their Jacobian (N, ny, L), ``slope`` (segments + 1, nx, nf) being that of the nodes."""
        n, pieces = len(self.variables.which), []
        for k, ((r, j), (a, b)) in enumerate(zip(self._run_segments(point, e), pairwise(self.cuts[e]), strict=True)):
            r, j = r[: b - a, : self.ny], j[: b - a, : self.ny]
            pieces.append((r, j[:, :, :n] + j[:, :, n:] @ slope[k]))
        r, j = (np.concatenate(each) for each in zip(*pieces, strict=True))
        states = len(self.variables.free_states)
        return r, np.concatenate([j, np.zeros((*j.shape[:2], states))], axis=2)

    def _make_result(
        self,
        point: _ShootingPoint,
        linearised: _LinearisedPoint | None,
        status: TerminationStatus,
        iteration: int,
        seconds: float,
    ) -> MultipleShootingResult:
        v, n = self.variables, len(self.variables.which)
        z, free = point.z.copy(), v.free_states
        for e in range(v.experiments):
            z[v.columns(e)[n:]] = (point.nodes[e][0][free] - v.initial.guess[e, free]) / v.initial.scale[free]
        gradient, hessian = np.zeros(v.size), np.zeros((v.size, v.size))
        work, nodes = (iteration, self.evaluations, seconds), tuple(point.nodes)
        if linearised is None:
            failed = Evaluation(np.inf, gradient, hessian, np.zeros(self.ny), np.zeros(self.ny, int), (0, 0))
            return MultipleShootingResult(v, failed, nodes, (), (), np.inf, status, *work)
        gradient[:n], hessian[:n, :n] = 2 * linearised.condensed.gradient, 2 * linearised.condensed.hessian
        evaluation = Evaluation(linearised.cost, gradient, hessian, linearised.squares, linearised.counts)
        runs = tuple(simulate_segments(self.single, z, e, self.cuts[e], point.nodes[e]) for e in range(v.experiments))
        rows = tuple(self._condense_residuals(point, e, linearised.condensed.slope[e]) for e in range(v.experiments))
        return MultipleShootingResult(v.recentre(z), evaluation, nodes, runs, rows, linearised.gap, status, *work)


@dataclass
class _ShootingPoint:
    """``z``, the nodes of each record, and the pairs (gaps, cost) that a new point must not be worse than in both."""

    z: np.ndarray
    nodes: list[np.ndarray]
    filter: list[tuple[float, float]] = field(default_factory=list)

    def accepts(self, violation: float, cost: float, margin: float) -> bool:
        """Whether a point is better than each in the filter in one respect or the other."""
        return all(
            violation < (1 - margin) * v or cost < c - margin * min(violation, 1.0) * abs(c) for v, c in self.filter
        )


@dataclass(frozen=True)
class _LinearisedPoint:
    """Cost, gaps, and the problem with its nodes eliminated, at one point."""

    z: np.ndarray
    cost: float
    squares: np.ndarray
    counts: np.ndarray
    condensed: CondensedProblem
    gap: float
    violation: float


def add_state_outputs(step: Step) -> Step:
    """The step with its states as further outputs, so that the kernel gives the end of a segment with its slopes."""
    f = step.outputs
    x, u, p = (ca.SX.sym(name, f.size1_in(k)) for k, name in enumerate(("x", "u", "p")))
    return replace(step, outputs=ca.Function("outputs", [x, u, p], [ca.vertcat(f(x, u, p), x)]))


def place_segments(
    e: int, record: Record, rows: int, policy: SegmentPolicy = DEFAULT_POLICY.segments
) -> tuple[int, ...]:
    """First rows of the segments of ``rows`` samples of record ``e`` and, at the end, its number of rows."""
    return place_cuts(
        f"record {e + 1}",
        np.arange(len(record.u), dtype=float),
        rows=rows,
        rows_per_sample=record.rows_per_sample,
        policy=policy,
    )


def slice_segment(record: Record, a: int, b: int, nx: int) -> Record:
    """Rows ``a`` to ``b``; the last one is the first of the next segment and counts for its states alone."""
    last = min(b + 1, len(record.u))
    y = np.full((last - a, record.y.shape[1] + nx), np.nan)
    y[: b - a, : record.y.shape[1]] = record.y[a:b]
    y[-1, record.y.shape[1] :] = 0.0
    return replace(record, u=record.u[a:last], y=y, h=record.h[a : last - 1], row=record.row[a : last - 1])


def measure_state_ranges(nodes: Sequence[np.ndarray]) -> np.ndarray:
    """Range of each state over all nodes, one where it never moves."""
    together = np.concatenate(nodes)
    spread = np.ptp(together, axis=0)
    size = np.abs(together).max(axis=0)
    return np.where(spread > CONSTANT_STATE * size, spread, np.where(size > 0, size, 1.0))
