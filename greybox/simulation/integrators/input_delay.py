"""Transport delay: the step reads earlier rows of the input and uses the delayed value.

With a delay of ``n + f`` intervals the input arriving during an interval is the end of the input of ``n + 1`` intervals ago for the
share ``f`` of it, and then the beginning of that of ``n`` intervals ago. The step is cut where the two meet, so nothing is lost of the
method's order, and what comes out is continuous in the delay and has a slope along it. Before the first row the input is zero;
one that is linear between rows rises from there to its first value during the interval before the first row.
"""

from __future__ import annotations

import math

import casadi as ca
import numpy as np

from greybox.base.errors import DataError, ModelError
from greybox.base.numerics import TIME_ROUNDING
from greybox.model.system import System
from greybox.simulation.integrators.step import AdvanceFunction, InputHistory

FLAG_COLUMNS = ("parity", "linear", "length")
"""Columns after the earlier rows: 0 and 1 in turn, whether the input is linear between rows, and the interval's length in seconds."""


# Longest delay of an input in sampling intervals: each interval adds a column to the input of the step.
MAX_DELAY_ROWS = 200


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
    longest, shortest = sum(d.longest for d in system.delays), float(np.min(lengths, initial=np.inf))
    # By the upper bound of the delay, not its value: columns must not change while a search moves it.
    rows = max(1, math.ceil(longest / shortest - TIME_ROUNDING)) if np.isfinite(shortest) else 1
    most = MAX_DELAY_ROWS
    if rows > most:
        raise ModelError(
            f"effect {names!r}: a delay of up to {longest:g} s is {rows} intervals of {shortest:g} s, more than {most}; give"
            f" its parameter an upper bound of {most * shortest:.4g} s or less, or shift the record by whole samples first"
        )
    return InputHistory(columns.pop(), rows)


def count_history_columns(past: InputHistory | None) -> int:
    """How many columns `add_input_history` adds."""
    return 0 if past is None else past.rows + len(FLAG_COLUMNS)


def add_input_history(u: np.ndarray, lengths: np.ndarray, past: InputHistory, first_order: bool) -> np.ndarray:
    """Inputs (N, nu) and, in each row, the delayed input 1, 2, ... rows ago (zero before the first row) and the flags.

    Intervals have the one length in ``lengths`` (s). Raises DataError where there are several: a delay in rows then has no meaning.
    """
    if len(lengths) > 1:
        raise DataError(
            f"a delayed input needs uniform sampling, the intervals run from {min(lengths):g} to {max(lengths):g} s; resample the record"
        )
    rows = len(u)
    earlier = np.zeros((rows, past.rows))
    for j in range(1, min(past.rows, rows - 1) + 1):
        earlier[j:, j - 1] = u[:-j, past.column]
    flags = np.column_stack(
        [np.arange(rows) % 2, np.full(rows, float(first_order)), np.full(rows, max(lengths, default=1.0))]
    )
    return np.ascontiguousarray(np.hstack([u, earlier, flags]))


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
        u_ramp = (ub[:nu] - ua[:nu]) * n
        u_start = ua[:nu] - number / n * u_ramp
        u_ramp = u_ramp * ua[-2]
        whole, part = _split_delay(seconds(p), n * h, past.rows)
        # Half of the substeps on either side whatever the share is: instructions do not depend on the delay, so it
        # can be differentiated.
        before = ca.floor(n / 2)
        is_before_cut = number < before
        steps = (number, number + 1)
        a, b = (
            ca.if_else(is_before_cut, part * (k / before), part + (1 - part) * ((k - before) / (n - before)))
            for k in steps
        )
        columns = [past.column, *range(nu, nu + past.rows)]
        # Two neighbours of the past at both ends of the substep, then their value and ramp over the whole interval.
        ends = [_select_two(u[columns], whole) for u in (ua, ub)]
        ramps = [(b - a) * n for a, b in zip(*ends, strict=True)]
        starts = [a - number / n * ramp for a, ramp in zip(ends[0], ramps, strict=True)]
        ramps = [ramp * ua[-2] for ramp in ramps]
        # Lines of the arriving input over the interval: the row of n + 1 ago (k = 1) is at 1 - f of its ramp when
        # the interval begins; that of n ago (k = 0) arrives at the share f, so its line begins f of its ramp below.
        newer, older = (starts[k] + ramps[k] * (k - part) for k in (0, 1))
        slope = ca.if_else(is_before_cut, ramps[1], ramps[0])
        arrived = ca.if_else(is_before_cut, older, newer)

        def at(share: ca.SX) -> ca.SX:
            values = u_start + u_ramp * share
            values[past.column] = arrived + slope * share
            return values

        return advance(x, at(a), at(b), p, (b - a) * n * h)

    return advance_delayed


def delay_outputs(system: System, past: InputHistory) -> ca.Function:
    """``(x, row of with_past, p) -> y``."""
    nu = system.u.numel()
    row = ca.SX.sym("u", nu + count_history_columns(past))
    whole, part = _split_delay(make_delay_function(system)(system.p), row[-1], past.rows)
    row_inputs = row[[past.column, *range(nu, nu + past.rows)]]
    newer, older = _select_two(row_inputs, whole)
    # A held input has at a row the value that arrives there: that of n + 1 rows ago unless the delay is a whole
    # number.
    held = ca.if_else(part > 0, older, newer)
    u = ca.SX(row[:nu])
    u[past.column] = ca.if_else(row[-2] > 0, newer + part * (older - newer), held)
    y = ca.substitute(system.outputs, system.u, u)
    return ca.Function("outputs", [system.x, row, system.p], [y])


def make_delay_function(system: System) -> ca.Function:
    """``p -> delay`` in seconds; several on one input add up."""
    return ca.Function("seconds", [system.p], [sum((d.seconds for d in system.delays), ca.SX(0))])


def _split_delay(seconds: ca.SX, interval: ca.SX, rows: int) -> tuple[ca.SX, ca.SX]:
    """A delay as whole intervals and the share (0 to 1) of one more."""
    delay = ca.fmin(ca.fmax(seconds / interval, 0), rows)
    # The longest delay is the end of the last pair of rows, not the beginning of one that is not seen.
    whole = ca.fmin(ca.floor(delay), rows - 1)
    return whole, delay - whole


def _select_two(values: ca.SX, number: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Element ``number`` and the one after it."""
    # An index that depends on parameters: a sum of choices, which every kernel runs. `floor` has slope zero, so the
    # delay's slope comes from the share alone.
    flags = [number == k for k in range(values.numel() - 1)]
    first, second = (
        sum((ca.if_else(flag, values[k + later], 0) for k, flag in enumerate(flags)), ca.SX(0)) for later in (0, 1)
    )
    return first, second
