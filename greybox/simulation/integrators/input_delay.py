"""Transport delay: the step reads earlier rows of the input and uses the delayed value.

With a delay of ``n + f`` intervals the input arriving during an interval is the end of the input of ``n + 1`` intervals ago for the
share ``f`` of it, and then the beginning of that of ``n`` intervals ago. The step is cut where the two meet, so nothing is lost of the
method's order, and what comes out is continuous in the delay and has a slope along it. Before the first row the input is what was
recorded or stated there (`greybox.data.Experiment`), and before that, or where nothing was, its first known value.

Where rows lie unevenly, an interval may see two rows or none arrive. It is cut at the first; what a held input brings after that is
taken as its mean, and of a linear one the line to its end.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import casadi as ca
import numpy as np

from greybox.base import TIME_ROUNDING, ModelError
from greybox.data.experiment import MAX_DELAY_ROWS
from greybox.model import System
from greybox.simulation.integrators.step import AdvanceFunction, InputHistory

FLAG_COLUMNS = ("parity", "linear", "length")
"""Columns after the earlier rows (and after their ages in intervals, where rows lie unevenly): 0 and 1 in turn, whether the input is
linear between rows, and the interval's length in seconds."""


# Share of the lengths of the intervals that may be shorter than the one that says how many of them fit into a delay: with a few that are
# much shorter (two stamps of one sample) as many others are between.
SHORT_INTERVALS = 0.1


def require_history(system: System, lengths: np.ndarray) -> InputHistory | None:
    """What a step must see of the past for the delays of ``system`` on records with intervals of ``lengths`` (s).

    Raises ModelError for delays of two different inputs, and for one of more intervals than the policy allows.
    """
    if not system.delays:
        return None
    columns = {d.column for d in system.delays}
    names = ", ".join(d.effect for d in system.delays)
    if len(columns) > 1:
        raise ModelError(f"delays of two different inputs at once ({names}) are not supported; delay one input")
    # By the upper bound of the delay, not its value: columns must not change while a search moves it.
    longest = sum(d.longest for d in system.delays)
    shortest = float(np.quantile(lengths, SHORT_INTERVALS, method="lower")) if len(lengths) else math.inf
    rows = max(1, math.ceil(longest / shortest - TIME_ROUNDING)) if np.isfinite(shortest) else 1
    most = MAX_DELAY_ROWS
    if rows > most:
        raise ModelError(
            f"effect {names!r}: a delay of up to {longest:g} s is {rows} intervals of {shortest:g} s, more than {most}; give"
            f" its parameter an upper bound of {most * shortest:.4g} s or less, or shift the record by whole samples first"
        )
    return InputHistory(columns.pop(), rows, uneven=len(lengths) > 1)


def count_history_columns(past: InputHistory | None) -> int:
    """How many columns `add_input_history` adds."""
    return 0 if past is None else past.rows * (1 + past.uneven) + len(FLAG_COLUMNS)


def add_input_history(
    u: np.ndarray, intervals: np.ndarray, past: InputHistory, first_order: bool, before: np.ndarray | None = None
) -> np.ndarray:
    """Inputs (N, nu) and, in each row, the delayed input 1, 2, ... rows ago and the flags.

    ``intervals`` are the lengths (N - 1,) between the rows in s. Where they differ each row also says how long ago these rows were, in
    intervals of its own length. ``before``: rows (K, nu) before the first, the latest last, a usual interval from each to the next; what
    was before all that is known is its first value.
    """
    rows, width = len(u), u.shape[1] + past.rows
    length = np.append(intervals, intervals[-1:] if len(intervals) else 1.0)
    known = u[:, past.column] if before is None else np.concatenate([before[-past.rows :], u])[:, past.column]
    # The plant stood in its input long before the record: u(t) = u(0) for t < 0.
    earlier = np.concatenate([np.full(past.rows + rows - len(known), known[0]), known])
    # Column by column into what is returned: a long past is many times the record.
    table = np.empty((rows, u.shape[1] + count_history_columns(past)))
    table[:, : u.shape[1]] = u
    for k in range(past.rows):
        table[:, u.shape[1] + k] = earlier[past.rows - 1 - k :][:rows]
    if past.uneven:
        start = np.concatenate([[0.0], np.cumsum(intervals)])
        time = np.concatenate([-np.median(length) * np.arange(past.rows, 0, -1), start])
        for k in range(past.rows):
            table[:, width + k] = (start - time[past.rows - 1 - k :][:rows]) / length
    table[:, -len(FLAG_COLUMNS) :] = np.column_stack([np.arange(rows) % 2, np.full(rows, float(first_order)), length])
    return table


def delay_input(system: System, advance: AdvanceFunction, past: InputHistory) -> AdvanceFunction:
    """``advance`` for rows of `add_input_history` as inputs, one of two or more substeps: half of them before the cut, half after."""
    nu = system.u.numel()
    seconds = make_delay_function(system)

    def advance_delayed(x: ca.SX, ua: ca.SX, ub: ca.SX, p: ca.SX, h: ca.SX) -> ca.SX:
        # The kernel runs straight from row to row: the column of 0 and 1 tells which of how many substeps this is.
        # The parity moves by one over an interval, hence by 1/n over a substep; rounding saves the whole number from
        # the division.
        n = ca.floor(1 / ca.fabs(ub[-3] - ua[-3]) + 0.5)
        number = ca.floor(ca.if_else(ub[-3] > ua[-3], ua[-3], 1 - ua[-3]) * n + 0.5)
        ramp = (ub - ua) * n
        row = ua - number / n * ramp
        u_ramp = ramp[:nu]
        arrival = _find_arrival(row, row + ramp, seconds(p) / (n * h), past, nu)
        is_linear = ua[-2] > 0
        # Half of the substeps on either side whatever the share is: instructions do not depend on the delay, so it
        # can be differentiated.
        before = ca.floor(n / 2)
        is_before_cut = number < before
        steps = (number, number + 1)
        a, b = (
            ca.if_else(
                is_before_cut,
                arrival.cut * (k / before),
                arrival.cut + (1 - arrival.cut) * ((k - before) / (n - before)),
            )
            for k in steps
        )
        held = ca.if_else(is_before_cut, arrival.older, arrival.mean)
        rest = ca.fmax(1 - arrival.cut, SHORTEST_PIECE)
        slope = ca.if_else(is_before_cut, arrival.slope, (arrival.last - arrival.newer) / rest)
        line = ca.if_else(is_before_cut, arrival.first, arrival.newer - arrival.cut * slope)

        def at(share: ca.SX) -> ca.SX:
            values = row[:nu] + u_ramp * share
            values[past.column] = ca.if_else(is_linear, line + slope * share, held)
            return values

        return advance(x, at(a), at(b), p, (b - a) * n * h)

    return advance_delayed


def delay_outputs(system: System, past: InputHistory) -> ca.Function:
    """``(x, row of with_past, p) -> y``."""
    nu = system.u.numel()
    row = ca.SX.sym("u", nu + count_history_columns(past))
    arrival = _find_arrival(row, row, make_delay_function(system)(system.p) / row[-1], past, nu)
    u = ca.SX(row[:nu])
    u[past.column] = ca.if_else(row[-2] > 0, arrival.first, arrival.older)
    y = ca.substitute(system.outputs, system.u, u)
    return ca.Function("outputs", [system.x, row, system.p], [y])


def make_delay_function(system: System) -> ca.Function:
    """``p -> delay`` in seconds; several on one input add up."""
    return ca.Function("seconds", [system.p], [sum((d.seconds for d in system.delays), ca.SX(0))])


class _Arrival(NamedTuple):
    """What arrives of a delayed input during an interval, in shares of it.

    ``cut``: when the first row arrives. Held: the ``older`` value before it, and the ``mean`` after it. Linear: the ``first`` value and its
    ``slope`` before the cut, the ``newer`` one there, and the ``last`` one.
    """

    cut: ca.SX
    older: ca.SX
    mean: ca.SX
    first: ca.SX
    slope: ca.SX
    newer: ca.SX
    last: ca.SX


# Shortest piece of an interval, as a share of it, that an input can move in.
SHORTEST_PIECE = 1e-12


def _find_arrival(row: ca.SX, following: ca.SX, delay: ca.SX, past: InputHistory, nu: int) -> _Arrival:
    """What arrives after a ``delay`` in intervals, from a row of `add_input_history` and the one after it."""
    count = past.rows
    values = [row[past.column], *(row[nu + j] for j in range(count))]
    ages = [ca.SX(0), *(row[nu + count + j] if past.uneven else ca.SX(j + 1) for j in range(count))]
    following_value = following[past.column]
    delay = ca.fmin(ca.fmax(delay, 0), ages[-1])

    # Rows that arrive during the interval or after it, the newest first: each when its age is the delay.
    is_late = [*(delay > age for age in ages[:-1]), ca.SX(0)]
    arrives = [*(ca.fmin(ca.fmax(delay - age, 0), 1) for age in ages[:-1]), ca.SX(0)]
    is_older = [1 - is_late[0], *(late * (1 - next_late) for late, next_late in pairwise(is_late))]

    def of_older(numbers: Sequence[ca.SX]) -> ca.SX:
        return sum((ca.if_else(flag, value, 0) for flag, value in zip(is_older, numbers, strict=True)), ca.SX(0))

    def slope_at(ago: ca.SX) -> ca.SX:
        """Slope, an interval, of the linear input so many intervals ago, and its value there."""
        newer_than = [ca.SX(-1), *ages]
        bounds = [following_value, *values]
        inside = [ago <= 0, *((ago > a) * (ago <= b) for a, b in pairwise(ages))]
        slopes = [(bounds[j] - bounds[j + 1]) / (newer_than[j + 1] - newer_than[j]) for j in range(count + 1)]
        slope = sum((ca.if_else(flag, s, 0) for flag, s in zip(inside, slopes, strict=True)), ca.SX(0))
        node = sum(
            (ca.if_else(f, v + s * a, 0) for f, v, s, a in zip(inside, values, slopes, ages, strict=True)), ca.SX(0)
        )
        return ca.vertcat(slope, node - slope * ago)

    cut = of_older([ca.SX(0), *arrives[:-1]])
    shares = [1 - arrives[0], *(a - b for a, b in pairwise(arrives))]
    brought = sum((ca.if_else(late, s * v, 0) for late, s, v in zip(is_late, shares, values, strict=True)), ca.SX(0))
    newer = of_older([values[0], *values[:-1]])
    older = of_older(values)
    mean = ca.if_else(
        1 - cut > SHORTEST_PIECE, ca.if_else(cut > 0, brought / ca.fmax(1 - cut, SHORTEST_PIECE), older), newer
    )
    begin, end = slope_at(delay), slope_at(delay - 1)
    return _Arrival(cut, older, mean, begin[1], begin[0], newer, end[1])
