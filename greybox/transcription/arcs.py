"""Arcs: a record cut in pieces of a chosen length, each with an initial state of its own.

Short arcs forget: what drifts slowly (an offset, a wrong slow mode) has no time to add up, and the structure of the fast
motion shows. Long arcs remember: drift and slow constants show. A model that is right fits both with the same constants.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from greybox.errors import DataError
from greybox.experiment import Experiment
from greybox.kernel import Record
from greybox.numerics import SAME_INTERVAL
from greybox.transcription.decision_vector import DecisionVector, InitialStates
from greybox.transcription.policy import DEFAULT_POLICY, SegmentPolicy
from greybox.transcription.simulation_error import SingleShooting


def split_into_arcs(
    experiments: Experiment | Iterable[Experiment], *, seconds: float | None = None, rows: int | None = None
) -> tuple[Experiment, ...]:
    """Each experiment cut in arcs of a chosen length, in the order of time.

    No row is left out or used twice; a remainder shorter than half an arc joins the arc before it. An experiment that is
    shorter than an arc stays whole. The arcs are ordinary experiments ``name[first:last]``: fit them with estimated initial
    states (they begin anywhere, not at rest). A delayed or band-limited input is only known inside an arc; where that matters
    cut the records (`cut_into_arcs`), which keep what came before.

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
    originals = (experiments,) if isinstance(experiments, Experiment) else tuple(experiments)
    arcs: list[Experiment] = []
    for experiment in originals:
        cuts = place_cuts(experiment.name, experiment.time - experiment.time[0], seconds=seconds, rows=rows)
        stays_whole = len(cuts) == 2
        arcs += [experiment] if stays_whole else [experiment.window(a, b) for a, b in pairwise(cuts)]
    return tuple(arcs)


@dataclass(frozen=True)
class ArcProblem:
    """Arcs of some records as one problem."""

    shooting: SingleShooting
    """Their cost."""

    cuts: tuple[tuple[int, ...], ...]
    """Where each record was cut: first rows and, at the end, its number of rows."""

    starts_record: tuple[bool, ...]
    """Which arcs begin a record."""


def cut_into_arcs(
    whole: SingleShooting,
    *,
    seconds: float | None = None,
    rows: int | None = None,
    policy: SegmentPolicy = DEFAULT_POLICY.segments,
) -> ArcProblem:
    """The cost of ``whole`` with every record cut in arcs, all their initial states estimated; arguments as for `split_into_arcs`.

    States that are outputs begin at their first measured value, the others as in ``whole``. Many arcs are many initial states:
    `ProjectedShooting(cut_into_arcs(...).shooting)` keeps them from the optimiser.
    """
    cuts = [
        place_cuts(
            f"record {e + 1}",
            np.concatenate([[0.0], np.cumsum(r.h)]),
            seconds=seconds,
            rows=rows,
            rows_per_sample=r.rows_per_sample,
            policy=policy,
        )
        for e, r in enumerate(whole.records)
    ]
    return cut_at_rows(whole, cuts)


def cut_at_rows(whole: SingleShooting, cuts: Sequence[Sequence[int]]) -> ArcProblem:
    """The same with the cuts of each record given: first rows and, at the end, the number of rows."""
    v = whole.variables
    pieces, guesses, conditions, starts_record, groups = [], [], [], [], []
    for e, (record, places) in enumerate(zip(whole.records, cuts, strict=True)):
        guess = guess_arc_states(v, e, record, places[:-1])
        pieces += [slice_rows(record, a, b) for a, b in pairwise(places)]
        guesses.append(guess)
        conditions += [v.conditions[e]] * len(guess) if v.conditions else []
        starts_record += [k == 0 for k in range(len(guess))]
        groups += [v.groups[e]] * len(guess)
    states = np.concatenate(guesses)
    spread = np.ptp(states, axis=0)
    initial = InitialStates(states, np.ones(states.shape[1], bool), np.where(spread > 0, spread, v.initial.scale))
    variables = replace(v, initial=initial, conditions=tuple(conditions), groups=tuple(groups))
    shooting = SingleShooting(variables, whole.step, whole.kernel, pieces, whole.weight)
    return ArcProblem(shooting, tuple(tuple(map(int, places)) for places in cuts), tuple(starts_record))


def guess_arc_states(variables: DecisionVector, e: int, record: Record, starts: Sequence[int]) -> np.ndarray:
    """States (arcs, nx) at the ``starts`` of record ``e``: measured where a state is an output, else as the record begins."""
    guess = np.tile(variables.initial.guess[e], (len(starts), 1))
    for k, column in find_measured_states(variables).items():
        values = record.y[:, column]
        measured = np.flatnonzero(np.isfinite(values))
        if len(measured):
            places = np.searchsorted(measured, starts)
            guess[:, k] = values[measured[np.minimum(places, len(measured) - 1)]]
    is_declared = ~variables.initial.free
    guess[0, is_declared] = variables.initial.guess[e, is_declared]
    return guess


def find_measured_states(variables: DecisionVector) -> dict[int, int]:
    """States that are themselves an output: position of the state -> position of the output."""
    system = variables.model.system
    outputs = [system.outputs[j] for j in range(system.outputs.numel())]
    columns = {y.name(): j for j, y in enumerate(outputs) if y.is_symbolic()}
    return {k: columns[name] for k, name in enumerate(system.state_names) if name in columns}


def slice_rows(record: Record, a: int, b: int) -> Record:
    """Rows ``a`` up to but without ``b``."""
    return replace(record, u=record.u[a:b], y=record.y[a:b], h=record.h[a : b - 1], row=record.row[a : b - 1])


def place_cuts(
    name: str,
    since: np.ndarray,
    *,
    seconds: float | None = None,
    rows: int | None = None,
    rows_per_sample: int = 1,
    policy: SegmentPolicy = DEFAULT_POLICY.segments,
) -> tuple[int, ...]:
    """First rows of the arcs and, at the end, the number of rows, for rows ``since`` (N,) seconds after the first.

    ``rows_per_sample``: how many rows make a sample; ``rows`` counts samples. Raises DataError as `split_into_arcs` does.
    """
    if (seconds is None) == (rows is None):
        raise DataError("arcs: give their length either in seconds or in rows")
    count = len(since)
    least = policy.least_arc_rows
    if rows is not None:
        if rows < least:
            raise DataError(f"arcs of {name!r}: {rows} rows; an arc needs at least {least}")
        return _close_cuts(np.arange(0, count, rows * rows_per_sample), count)
    length = float(seconds or 0.0)
    if not (np.isfinite(length) and length > 0):
        raise DataError(f"arcs of {name!r}: {seconds} s is not a length; give a positive number of seconds")
    # The tolerance keeps a row that is due exactly at a cut out of the arc before.
    arc_number = np.floor(since[::rows_per_sample] / length + SAME_INTERVAL)
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
