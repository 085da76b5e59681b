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
from enum import Enum
from itertools import pairwise

import numpy as np

from greybox.integrators import Step
from greybox.kernel import Kernel, Record, make_kernel
from greybox.transcription.condensing import CondensedProblem, LinearisedSegment, condense
from greybox.transcription.decision_vector import DecisionVector
from greybox.transcription.initialisation import estimate_arc_states, simulate_segments, to_nodes
from greybox.transcription.relaxation import DAMPING, compute_bounded_step, fit_without_continuity
from greybox.transcription.segments import add_state_outputs, measure_state_ranges, place_segments, slice_segment
from greybox.transcription.single_shooting import Evaluation, SingleShooting

# Over one segment an error may grow by this factor.
SEGMENT_GROWTH = 5.0
# A record has at most this many segments of at least so many rows, unless growth asks for shorter ones: at least so many.
SEGMENTS, ROWS, FEWEST_ROWS = 50, 20, 8
# Converged when a further step would lower chi-square by less than NEGLIGIBLE residual variances (or the misfit over noise by
# PERFECT) and the segments meet within CONTINUOUS of the range of each state.
NEGLIGIBLE, PERFECT, CONTINUOUS = 1e-6, 1e-7, 1e-7
# A step is shortened, then damped, until cost or gaps come down.
SHARES = (1.0, 0.5, 0.25, 0.1, 0.03)
# What counts as lower: this share of the gaps.
MARGIN = 1e-3
# Where no step helps any more, a point that meets this rule so much less strictly is an optimum to within rounding errors.
LOOSER = 1e4
# A flat search ends: so many iterations that gained less than this share of the cost.
PATIENCE, LITTLE_GAIN = 8, 1e-5

Report = Callable[[int, float], object]  # (iteration, cost); an answer that is true ends the search


class MultipleShootingStatus(Enum):
    """How a search over segments ended; the values are what a person reads."""

    CONVERGED = "converged"
    FLAT = "the cost no longer changes"
    LIMIT = "stopped at the iteration limit before it converged"
    STUCK = "no further progress: no step lowers the cost or closes the gaps"
    NO_START = "the model cannot be simulated from the start values"
    INTERRUPTED = "interrupted"


@dataclass(frozen=True)
class MultipleShootingResult:
    """The optimum of a multiple-shooting fit.

    ``variables`` with ``z = 0`` there; ``evaluation`` with the gradient and Gauss-Newton matrix of the constants, every state
    eliminated (the rows of initial states are zero); ``nodes`` (segments + 1, nx) of each record, its end included; ``runs``
    outputs (N, ny) and states (N, nx) of each record, segment by segment, and ``rows`` its weighted residuals (N, ny) with their
    Jacobian (N, ny, L) along `DecisionVector.columns`, states eliminated; ``gap`` the largest jump between segments, as a share of the
    state's range. ``end`` says how the search ended.
    """

    variables: DecisionVector
    evaluation: Evaluation
    nodes: tuple[np.ndarray, ...]
    runs: tuple[tuple[np.ndarray, np.ndarray], ...]
    rows: tuple[tuple[np.ndarray, np.ndarray], ...]
    gap: float
    end: MultipleShootingStatus
    iterations: int
    evaluations: int
    seconds: float

    @property
    def converged(self) -> bool:
        """Whether the point can be used as an optimum."""
        return self.end in (MultipleShootingStatus.CONVERGED, MultipleShootingStatus.FLAT)


def choose_segment_rows(growth: float, record: Record) -> int:
    """Samples of a segment for a plant whose errors grow by ``exp(growth t)`` (1/s; at most zero: they do not)."""
    longest = max(len(record.samples(record.u)) // SEGMENTS, ROWS)
    period = record.every * float(np.median(record.h)) if len(record.h) else 1.0
    if growth > 0:
        longest = min(longest, int(np.log(SEGMENT_GROWTH) / (growth * period)))
    return max(FEWEST_ROWS, longest)


class MultipleShooting:
    """Lifted Gauss-Newton over records cut in segments of ``rows`` samples (one number, or one for each record).

    ``variables``, ``step``, ``records`` and ``weight`` as for `SingleShooting`; ``kernel`` is used for the first guess of the
    nodes: hidden states of each segment are found from its own samples at the start values, beginning where the segment before
    ended. ``nodes`` gives them instead, (segments, nx) for each record.
    """

    def __init__(
        self, variables: DecisionVector, step: Step, kernel: Kernel, records: Sequence[Record], weight: np.ndarray,
        rows: int | Sequence[int], nodes: Sequence[np.ndarray] | None = None,
    ) -> None:  # fmt: skip
        self.variables, self.weight = variables, weight
        self.single = SingleShooting(variables, step, kernel, records, weight)
        self.records = self.single.records
        each = [rows] * len(records) if isinstance(rows, int) else list(rows)
        self.cuts = [place_segments(e, r, n) for e, (r, n) in enumerate(zip(self.records, each, strict=True))]
        self.kernel = make_kernel(add_state_outputs(step))
        self.nx, self.ny = step.advance.size1_in(0), len(weight)
        self.parts = [
            [slice_segment(r, a, b, self.nx) for a, b in pairwise(c)]
            for r, c in zip(self.records, self.cuts, strict=True)
        ]
        self._arcs = estimate_arc_states(self.single, self.cuts) if nodes is None else None
        found = to_nodes(self.single, self.cuts, self._arcs) if self._arcs else nodes or ()
        self.nodes = [np.array(n, float) for n in found]
        self.scale = measure_state_ranges(self.nodes)
        self.evaluations = 0

    def solve(
        self, *, iterations: int = 100, relax: bool = True, report: Report | None = None
    ) -> MultipleShootingResult:
        """Minimise the cost with the segments joined, from ``z = 0`` and the present nodes.

        ``relax``: first fit the segments as arcs that need not meet (not where nodes were given). ``report`` is called with the
        number of each iteration and its cost, and ends the search by an answer that is true.
        """
        began = time.perf_counter()
        state = _Search(np.zeros(self.variables.size), self.nodes)
        if relax and self._arcs:
            state.z[: self._arcs.size] = fit_without_continuity(self._arcs)
            state.nodes = to_nodes(self.single, self.cuts, self._arcs)
        now = self._linearised(state)
        end, costs, done = MultipleShootingStatus.NO_START, [], 0
        while now is not None:
            costs.append(now.cost)
            if report and report(done, now.cost):
                end = MultipleShootingStatus.INTERRUPTED
                break
            if self._converged(now) or (now.gap < CONTINUOUS and _flat(costs)):
                end = MultipleShootingStatus.CONVERGED if self._converged(now) else MultipleShootingStatus.FLAT
                break
            if done == iterations:
                end = MultipleShootingStatus.LIMIT
                break
            following = self._following(state, now)
            if following is None:  # at rounding errors, or truly stuck
                end = MultipleShootingStatus.FLAT if self._converged(now, LOOSER) else MultipleShootingStatus.STUCK
                break
            state, now = following
            done += 1
        return self._result(state, now, end, done, time.perf_counter() - began)

    def gauss_newton_step(self) -> np.ndarray:
        """The next Gauss-Newton step of the constants (nf,) in ``z`` from the present nodes; NaN where a segment overflows."""
        now = self._linearised(_Search(np.zeros(self.variables.size), self.nodes))
        return np.full(len(self.variables.which), np.nan) if now is None else self._bounded(now, 0.0)[0]

    def _converged(self, now: _Linear, looser: float = 1.0) -> bool:
        """Whether a further step would neither lower the cost nor close a gap."""
        count = max(int(now.counts.sum()), 1)
        change = abs(now.cost - now.reduced.cost_after(self._bounded(now, 0.0)))
        return now.gap <= CONTINUOUS and change <= looser * (NEGLIGIBLE * now.cost / count + PERFECT**2 * count)

    def _following(self, state: _Search, now: _Linear) -> tuple[_Search, _Linear] | None:
        """The next point: the longest step, ever more damped, that lowers the cost or the gaps (filter of Fletcher and Leyffer)."""
        state.filter.append((now.violation, now.cost))
        for damping in DAMPING:
            change = self._bounded(now, damping)
            for share in SHARES:
                trial = self._moved(state, now, change, share)
                there = self._linearised(trial)
                if there is not None and trial.accepts(there.violation, there.cost):
                    return trial, there
        return None

    def _bounded(self, now: _Linear, damping: float) -> tuple[np.ndarray, list[np.ndarray]]:
        """The step of constants and nodes that minimises the reduced quadratic within the bounds of the constants."""
        return now.reduced.step(
            compute_bounded_step(self.variables, now.z, now.reduced.gradient, now.reduced.hessian, damping)
        )

    def _moved(
        self, state: _Search, now: _Linear, change: tuple[np.ndarray, list[np.ndarray]], share: float
    ) -> _Search:
        dz, ds = change
        z = state.z.copy()
        z[: len(dz)] += share * dz
        nodes = [s + share * d * self.scale for s, d in zip(state.nodes, ds, strict=True)]
        return _Search(z, nodes, list(state.filter))

    def _linearised(self, state: _Search) -> _Linear | None:
        """Residuals, end states and their slopes of every segment, the nodes eliminated; None where a segment overflows, or nearly."""
        self.evaluations += 1
        segments, squares, counts = [], np.zeros(self.ny), np.zeros(self.ny, int)
        for e in range(len(self.records)):
            own = self._record(state, e, squares, counts)
            if own is None:
                return None
            segments.append(own)
        reduced = condense(segments, len(self.variables.which))
        if reduced is None:
            return None
        if self.variables.held.any():
            reduced = reduced.with_penalty(*self.variables.penalty(state.z))
        gaps = np.concatenate([np.abs(s.defect) for own in segments for s in own])
        return _Linear(
            state.z,
            float(squares.sum()) + reduced.prior[0],
            squares,
            counts,
            reduced,
            float(gaps.max(initial=0.0)),
            float(gaps.sum()),
        )

    def _runs(self, state: _Search, e: int) -> list[tuple[np.ndarray, np.ndarray]]:
        """Residuals and Jacobian, along the constants and its own first state, of each segment of record ``e``; states beside outputs."""
        n, nx = len(self.variables.which), self.nx
        p = self.variables.parameters(state.z, e)
        q, dq, dp, _, _ = self.single.at(state.z, p, e)
        lanes = np.zeros((nx, n + nx))
        lanes[:, n:] = np.diag(self.scale)
        dq = np.concatenate([dq[:, :, :n], np.zeros((*dq.shape[:2], nx))], axis=2)
        dp = np.concatenate([dp[:, :n], np.zeros((len(dp), nx))], axis=1)
        weight = np.concatenate([self.weight, np.ones(nx)])
        return [
            self.kernel.residuals(part, q, dq, p, dp, node, lanes, weight)
            for part, node in zip(self.parts[e], state.nodes[e], strict=False)
        ]

    def _record(
        self, state: _Search, e: int, squares: np.ndarray, counts: np.ndarray
    ) -> list[LinearisedSegment] | None:
        v, n, nodes = self.variables, len(self.variables.which), state.nodes[e]
        found = []
        for k, ((r, j), part) in enumerate(zip(self._runs(state, e), self.parts[e], strict=True)):
            end, ends = -r[-1, self.ny :], -j[-1, self.ny :]
            r, j = r[:, : self.ny], j[:, : self.ny]
            there = np.isfinite(part.y[:, : self.ny])
            if not all(np.isfinite(values).all() for values in (end, ends, r[there], j[there])):
                return None
            squares += np.square(np.where(there, r, 0.0)).sum(axis=0)
            counts += there.sum(axis=0)
            defect = (end - nodes[k + 1]) / self.scale
            found.append(LinearisedSegment(r[there], j[there], ends / self.scale[:, None], defect, None))
        first = np.flatnonzero(~v.initial.free)
        if len(first):  # states that begin as declared
            *_, x0, dx0 = self.single.at(state.z, v.parameters(state.z, e), e)
            tie = first, ((x0 - nodes[0]) / self.scale)[first], (dx0[:, :n] / self.scale[:, None])[first]
            found[0] = replace(found[0], tie=tie)
        return found

    def _rows(self, state: _Search, e: int, slope: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Residuals (N, ny) of record ``e`` and their Jacobian (N, ny, L), ``slope`` (segments + 1, nx, nf) being that of the nodes."""
        n, found = len(self.variables.which), []
        for k, ((r, j), (a, b)) in enumerate(zip(self._runs(state, e), pairwise(self.cuts[e]), strict=True)):
            r, j = r[: b - a, : self.ny], j[: b - a, : self.ny]
            found.append((r, j[:, :, :n] + j[:, :, n:] @ slope[k]))
        r, j = (np.concatenate(each) for each in zip(*found, strict=True))
        own = len(self.variables.free_states)
        return r, np.concatenate([j, np.zeros((*j.shape[:2], own))], axis=2)

    def _result(
        self, state: _Search, now: _Linear | None, end: MultipleShootingStatus, done: int, seconds: float
    ) -> MultipleShootingResult:
        v, n = self.variables, len(self.variables.which)
        z, own = state.z.copy(), v.free_states
        for e in range(v.experiments):
            z[v.columns(e)[n:]] = (state.nodes[e][0][own] - v.initial.guess[e, own]) / v.initial.scale[own]
        gradient, hessian = np.zeros(v.size), np.zeros((v.size, v.size))
        work, nodes = (done, self.evaluations, seconds), tuple(state.nodes)
        if now is None:
            nothing = Evaluation(np.inf, gradient, hessian, np.zeros(self.ny), np.zeros(self.ny, int), (0, 0))
            return MultipleShootingResult(v, nothing, nodes, (), (), np.inf, end, *work)
        gradient[:n], hessian[:n, :n] = 2 * now.reduced.gradient, 2 * now.reduced.hessian
        evaluation = Evaluation(now.cost, gradient, hessian, now.squares, now.counts)
        runs = tuple(simulate_segments(self.single, z, e, self.cuts[e], state.nodes[e]) for e in range(v.experiments))
        rows = tuple(self._rows(state, e, now.reduced.slope[e]) for e in range(v.experiments))
        return MultipleShootingResult(v.moved(z), evaluation, nodes, runs, rows, now.gap, end, *work)


@dataclass
class _Search:
    """A point: ``z``, the nodes of each record, and the pairs (gaps, cost) that a new point must not be worse than in both."""

    z: np.ndarray
    nodes: list[np.ndarray]
    filter: list[tuple[float, float]] = field(default_factory=list)

    def accepts(self, violation: float, cost: float) -> bool:
        """Whether a point is better than each in the filter in one respect or the other."""
        return all(
            violation < (1 - MARGIN) * v or cost < c - MARGIN * min(violation, 1.0) * abs(c) for v, c in self.filter
        )


@dataclass(frozen=True)
class _Linear:
    """Everything at one point: cost, gaps, and the problem with its nodes eliminated."""

    z: np.ndarray
    cost: float
    squares: np.ndarray
    counts: np.ndarray
    reduced: CondensedProblem
    gap: float
    violation: float


def _flat(costs: Sequence[float]) -> bool:
    """Whether the last iterations gained next to nothing."""
    return len(costs) > PATIENCE and costs[-1 - PATIENCE] - costs[-1] <= LITTLE_GAIN * costs[-1]
