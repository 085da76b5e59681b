"""Limits of signals on the command line: ``--limit NAME=LOW:HIGH`` and ``--rate NAME=R``."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from greybox.cli.exit_codes import ExitCode
from greybox.cli.exits import exit_with_error
from greybox.cli.study_values import Numbers, Table, parse_number
from greybox.errors import DataError, GreyboxError, nearest

if TYPE_CHECKING:
    from greybox.experiment_design import SignalLimit
    from greybox.simulation import Simulation


def parse_limits(option: str, limits: Sequence[str], rates: Sequence[str] = ()) -> dict[str, SignalLimit]:
    """Limits by signal. Raises GreyboxError."""
    from greybox.experiment_design import SignalLimit

    pairs = Table(shape="NAME=LOW:HIGH", example="u=-3:3").from_option(option, limits)
    fastest = Numbers(shape="NAME=R", example="u=100").from_option("--rate", rates)
    result = {}
    for name in dict.fromkeys([*pairs, *fastest]):
        text = pairs.get(name, ":")
        low, colon, high = text.partition(":")
        if not colon:
            raise GreyboxError(f"{option} {name}={text}: write it as LOW:HIGH, as in {option} u=-3:3")
        given = f"{option} {name}={text}"
        ends = [
            parse_number(given, end, f"{option} u=-3:3") if end else sign * math.inf
            for end, sign in ((low, -1.0), (high, 1.0))
        ]
        try:
            result[name] = SignalLimit(ends[0], ends[1], fastest.get(name, math.inf))
        except DataError as error:
            raise GreyboxError(f"{name}: {error}") from None
    return result


def refuse_broken_limits(run: Simulation, limits: Mapping[str, SignalLimit]) -> None:
    """End with exit code 1 where a signal of a run leaves its limits. Raises GreyboxError for a signal that the run does not have."""
    signals = {**run.states, **run.outputs, **run.inputs}
    for name, limit in limits.items():
        if name not in signals:
            raise GreyboxError(f"--limit {name}: the model has no such signal; {nearest(name, signals)}")
        values = signals[name]
        outside = np.flatnonzero((values < limit.low) | (values > limit.high))
        if len(outside):
            k = outside[0]
            exit_with_error(
                f"{name} = {values[k]:.4g} leaves its limits of {limit.low:g} to {limit.high:g} after {run.time[k]:.4g} s; nothing was"
                " written",
                ExitCode.UNSUCCESSFUL,
            )
