"""Records cut in segments, each with an initial state of its own.

Segments that must meet are those of multiple shooting. Segments of a chosen length that need not meet are called arcs. Short arcs
forget: what drifts slowly (an offset, a wrong slow mode) has no time to add up, and the structure of the fast motion shows. Long
arcs remember: drift and slow constants show. A model that is right fits both with the same constants.

Where a search over segments or by collocation begins is found from them as well, as if they need not meet.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from greybox.base import DataError
from greybox.base.numerics import CONSTANT_STATE, TIME_ROUNDING
from greybox.data.experiment import Experiment, as_records
from greybox.estimation.optim.gauss_newton import run_gauss_newton
from greybox.estimation.optim.minimisation import DEFAULT_POLICY as MINIMISATION
from greybox.estimation.optim.minimisation import GaussNewtonPolicy, Minimisation, Termination, TerminationPolicy
from greybox.estimation.options import DEFAULT_POLICY, TranscriptionPolicy
from greybox.estimation.transcription.decision_vector import DecisionVector, InitialStates, find_measured_states
from greybox.estimation.transcription.eliminated_states import ProjectedShooting
from greybox.estimation.transcription.problem import EstimationProblem, Runs
from greybox.estimation.transcription.select import estimate_error_growth
from greybox.estimation.transcription.shooting_cost import Evaluation
from greybox.simulation.kernel.record import Record

Cuts = tuple[tuple[int, ...], ...]
"""First rows of the segments of each record and, at the end, its number of rows."""


def split_into_arcs(
    experiments: Experiment | Iterable[Experiment], *, seconds: float | None = None, rows: int | None = None
) -> tuple[Experiment, ...]:
    """Each experiment cut in arcs of a chosen length, in the order of time.

    No row is left out or used twice; a remainder shorter than half an arc joins the arc before it. An experiment that is
    shorter than an arc stays whole. The arcs are ordinary experiments ``name[first:last]``: fit them with estimated initial
    states (they begin anywhere, not at rest). A delayed or band-limited input is only known inside an arc; where that matters
    cut the records instead, by ``FitOptions(arc_length=...)``: they keep what came before.

    Parameters
    ----------
    experiments
        One or several experiments.
    seconds, rows
        Length of an arc: give one of the two.

    Returns
    -------
    tuple of Experiment
        The arcs of all experiments.

    Raises
    ------
    DataError
        For a length that is not positive, or shorter than three rows.
    """
    originals = as_records(experiments)
    arcs: list[Experiment] = []
    for experiment in originals:
        cuts = place_cuts(experiment.name, experiment.time - experiment.time[0], seconds=seconds, rows=rows)
        stays_whole = len(cuts) == 2
        arcs += [experiment] if stays_whole else [experiment.window(a, b) for a, b in pairwise(cuts)]
    return tuple(arcs)


def cut_by_growth(problem: EstimationProblem) -> Cuts:
    """Segments over which errors grow little at the start values."""
    p, policy = problem.start_parameters, problem.policy.transcription
    growths = [estimate_error_growth(problem.model.system, p, r, policy) for r in problem.records]
    pairs = zip(growths, problem.records, strict=True)
    return cut_in_rows(problem, [choose_segment_rows(growth, r, policy) for growth, r in pairs])


# Factor by which an error may grow over one segment of an unstable plant.
MAX_GROWTH = 5.0
# Fewest samples of a segment in any case: its first states are estimated from them.
SEGMENT_LEAST_ROWS = 8


def choose_segment_rows(
    growth: float, record: Record, policy: TranscriptionPolicy = DEFAULT_POLICY.transcription
) -> int:
    """Samples of a segment for a plant whose errors grow by ``exp(growth t)`` (1/s; at most zero: they do not)."""
    longest = max(len(record.samples(record.u)) // policy.max_segments, policy.usual_rows)
    period = record.rows_per_sample * float(np.median(record.h)) if len(record.h) else 1.0
    if growth > 0:
        # exp(growth t) <= MAX_GROWTH.
        longest = min(longest, int(np.log(MAX_GROWTH) / (growth * period)))
    return max(SEGMENT_LEAST_ROWS, longest)


def cut_in_rows(problem: EstimationProblem, rows: int | Sequence[int]) -> Cuts:
    """Segments of so many samples: one number, or one for each record."""
    numbers = [rows] * len(problem.records) if isinstance(rows, int) else rows
    return tuple(
        place_cuts(f"record {e + 1}", np.arange(len(r.u), dtype=float), rows=n, rows_per_sample=r.rows_per_sample)
        for e, (r, n) in enumerate(zip(problem.records, numbers, strict=True))
    )


def cut_in_seconds(problem: EstimationProblem, seconds: float) -> Cuts:
    """Segments of a length in seconds."""
    return tuple(
        place_cuts(
            f"record {e + 1}",
            np.concatenate([[0.0], np.cumsum(r.h)]),
            seconds=seconds,
            rows_per_sample=r.rows_per_sample,
        )
        for e, r in enumerate(problem.records)
    )


# Fewest samples of an arc whose length was asked for.
LEAST_ARC_ROWS = 3


def place_cuts(
    name: str, since: np.ndarray, *, seconds: float | None = None, rows: int | None = None, rows_per_sample: int = 1
) -> tuple[int, ...]:
    """First rows of the arcs and, at the end, the number of rows, for rows ``since`` (N,) seconds after the first.

    ``rows_per_sample``: how many rows make a sample; ``rows`` counts samples. Raises DataError as `split_into_arcs` does.
    """
    if (seconds is None) == (rows is None):
        raise DataError("arcs: give their length either in seconds or in rows")
    count = len(since)
    least = LEAST_ARC_ROWS
    if rows is not None:
        if rows < least:
            raise DataError(f"arcs of {name!r}: {rows} rows; an arc needs at least {least}")
        return _close_cuts(np.arange(0, count, rows * rows_per_sample), count)
    length = float(seconds or 0.0)
    if not (np.isfinite(length) and length > 0):
        raise DataError(f"arcs of {name!r}: {seconds} s is not a length; give a positive number of seconds")
    # The tolerance keeps a row that is due exactly at a cut out of the arc before.
    arc_number = np.floor(since[::rows_per_sample] / length + TIME_ROUNDING)
    starts = rows_per_sample * np.concatenate([[0], np.flatnonzero(np.diff(arc_number)) + 1])
    cuts = _close_cuts(starts, count)
    shortest = int(np.diff(cuts).min()) // rows_per_sample
    if shortest < least and len(cuts) > 2:
        longest = float(np.diff(since[::rows_per_sample]).max())
        raise DataError(
            f"arcs of {name!r}: one of {length:g} s has {shortest} rows; an arc needs at least {least}: give at least"
            f" {least * longest:g} s"
        )
    return cuts


def _close_cuts(starts: np.ndarray, rows: int) -> tuple[int, ...]:
    """The starts and ``rows``, without a last arc that is shorter than half the one before it."""
    cuts = [int(k) for k in starts]
    if len(cuts) > 1 and 2 * (rows - cuts[-1]) < cuts[-1] - cuts[-2]:
        cuts.pop()
    return (*cuts, rows)


@dataclass(frozen=True)
class SegmentedProblem:
    """A problem whose records are cut in segments."""

    whole: EstimationProblem
    """The problem of the whole records."""

    cuts: Cuts
    """Where each record was cut."""

    pieces: EstimationProblem
    """The problem of the segments, one after the other: all their initial states are estimated."""

    @classmethod
    def of(cls, whole: EstimationProblem, cuts: Cuts, states: np.ndarray | None = None) -> SegmentedProblem:
        """``whole`` cut at ``cuts``, the present point that of ``whole``.

        The segments begin at ``states`` (segments, nx) if given; else those states that are outputs begin at their first measured value,
        the others as the record does.
        """
        v, records, pieces = whole.variables, whole.shooting().records, []
        for record, places in zip(records, cuts, strict=True):
            pieces += [record.cut(a, b) for a, b in pairwise(places)]
        owner = np.repeat(np.arange(len(records)), [len(places) - 1 for places in cuts])
        if states is None:
            guesses = []
            for e, (record, places) in enumerate(zip(records, cuts, strict=True)):
                starts, guess = places[:-1], np.tile(v.initial.guess[e], (len(places) - 1, 1))
                for k, column in find_measured_states(v).items():
                    measured = np.flatnonzero(np.isfinite(record.y[:, column]))
                    if len(measured):
                        nearest = measured[np.minimum(np.searchsorted(measured, starts), len(measured) - 1)]
                        guess[:, k] = record.y[nearest, column]
                guess[0, ~v.initial.free] = v.initial.guess[e, ~v.initial.free]
                guesses.append(guess)
            states = np.concatenate(guesses)
            spread = np.ptp(states, axis=0)
            # A step of one in z is the range of the state along the records.
            scale = np.where(spread > 0, spread, v.initial.scale)
        else:
            scale = measure_state_ranges(states)
        variables = replace(
            v,
            initial=InitialStates(states, np.ones(states.shape[1], bool), scale),
            conditions=tuple(v.conditions[e] for e in owner) if v.conditions else (),
            groups=tuple(v.groups[e] for e in owner),
        )
        return cls(whole, cuts, replace(whole, records=tuple(pieces), variables=variables))

    @property
    def starts_record(self) -> tuple[bool, ...]:
        """Which segments begin a record."""
        return tuple(k == 0 for places in self.cuts for k in range(len(places) - 1))

    def at(self, variables: DecisionVector) -> SegmentedProblem:
        """The same with the present point that of other ``variables`` of the pieces."""
        whole = replace(self.whole, variables=self.to_whole(variables))
        return SegmentedProblem.of(whole, self.cuts, variables.initial.guess)

    def with_step_of(self, problem: EstimationProblem) -> SegmentedProblem:
        """The same at the integration step of another problem."""
        whole = replace(self.whole, step=problem.step, kernel=problem.kernel, method=problem.method)
        return SegmentedProblem.of(whole, self.cuts, self.pieces.variables.initial.guess)

    def to_whole(self, variables: DecisionVector) -> DecisionVector:
        """The variables of the whole records with the constants of the pieces; each record begins as its first segment does."""
        v, guess = self.whole.variables, variables.initial.guess[list(self.starts_record)]
        return replace(
            v,
            base=variables.base,
            scale=variables.scale,
            fixed=variables.fixed,
            initial=replace(v.initial, guess=guess),
        )

    def join(self, runs: Runs) -> Runs:
        """The segments of each record one after the other."""
        edges = np.cumsum([0, *(len(places) - 1 for places in self.cuts)])
        joined = [[np.concatenate(parts) for parts in zip(*runs[a:b], strict=True)] for a, b in pairwise(edges)]
        return tuple((first, second) for first, second in joined)

    def simulate(self) -> Runs:
        """For each record outputs (N, ny) and states (N, nx), each segment run from its own initial state."""
        return self.join(self.pieces.shooting().simulate(self.pieces.variables.here))


def measure_state_ranges(states: np.ndarray) -> np.ndarray:
    """Range of each state (k, nx), its size where it never moves; one where it is zero."""
    spread, size = np.ptp(states, axis=0), np.abs(states).max(axis=0)
    return np.where(spread > CONSTANT_STATE * size, spread, np.where(size > 0, size, 1.0))


# Where a search over segments or by collocation begins: states along the record, and constants without continuity.


def estimate_segment_states(segmented: SegmentedProblem) -> ProjectedShooting:
    """The cost of the segments with the initial state of each estimated in turn, the constants at their start values.

    A state that is an output is taken as measured to begin with, a hidden one from the end of the segment before; then both are
    estimated from the samples of the segment. A short segment, which a wrong constant cannot spoil much, acts as an observer.
    """
    pieces = segmented.pieces.with_plain_squares()
    projected = ProjectedShooting(pieces.shooting())
    projected.carry_states(segmented.starts_record)
    return projected


# Steps at most.
RELAXATION_MAX_STEPS = 15
# A step is the last one when it gained less than a hundredth of the cost, or hardly anything is left.
RELAXATION_TERMINATION = TerminationPolicy(negligible_decrease=1e-6, patience=1, little_gain=1e-2)
# Damped quickly, as the start need not be good.
RELAXATION_DAMPED = GaussNewtonPolicy(damping_growth=100.0, max_rejections=5)
# Short segments may leave a constant open, so positive ones are held weakly: a factor ``e^2`` is one standard deviation.
PRIOR_WEIGHT = 0.25


def fit_without_continuity(projected: ProjectedShooting) -> np.ndarray:
    """A point of the variables near the best for segments that need not meet, by damped Gauss-Newton steps from the start.

    A segment cannot lose its place in an oscillation, so this search is spared the wrong optima of a long run; its result is good to
    the noise over one segment.
    """
    v, start = projected.variables, np.zeros(projected.size)
    # 1 / std^2 of the logarithm.
    precision = np.where(v.logarithmic, PRIOR_WEIGHT, 0.0)
    reach = v.reach[: projected.size]
    low, high = projected.bounds()

    def evaluate(z: np.ndarray) -> Evaluation:
        e = projected.evaluate(z)
        cost, hessian = e.cost + precision @ z**2, e.hessian + np.diag(2 * precision)
        # cost + sum z^2 / std^2.
        return replace(e, cost=cost, gradient=e.gradient + 2 * precision * z, hessian=hessian)

    low, high = np.minimum(np.maximum(low, -reach), 0.0), np.maximum(np.minimum(high, reach), 0.0)
    search = Minimisation(evaluate, 1.0, Termination(RELAXATION_TERMINATION, low, high, 1).test, None, MINIMISATION)
    if np.isfinite(search(start).cost) and not search.test_termination():
        run_gauss_newton(search, low, high, RELAXATION_DAMPED, steps=RELAXATION_MAX_STEPS)
    return projected.full(search.best)


def initialise_without_continuity(problem: EstimationProblem, cuts: Cuts) -> tuple[EstimationProblem, list[np.ndarray]]:
    """``problem`` at constants fitted without continuity, and states (N, nx) along each record: a start for `Collocation`."""
    segmented = SegmentedProblem.of(problem, cuts)
    arcs = estimate_segment_states(segmented)
    z = fit_without_continuity(arcs)
    segmented = segmented.at(segmented.pieces.variables.recentre(z))
    return segmented.whole, [x for _, x in segmented.simulate()]
