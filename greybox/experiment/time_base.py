"""Signals with stamps of their own on one time base.

The base is the stamps of the fastest signal, or a grid. An input is taken at every row, by the course that belongs to it: held,
straight, or band-limited. An output is taken where it was measured:
 each measurement moves along its own slope to the nearest row, by at
most half a row, and the rows between are empty, so that nothing measured once is counted twice. Rows at which an input is not known
are left out.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from greybox.experiment.columns import SignalKind
from greybox.experiment.experiment import Hold
from greybox.experiment.findings import RecordCode
from greybox.experiment.policy import (
    CHANNEL_POLICY,
    READING_POLICY,
    RECORD_POLICY,
    ChannelPolicy,
    ReadingPolicy,
    RecordPolicy,
)
from greybox.experiment.sampling import find_sampling_time, find_time_gaps
from greybox.experiment.table import check_size
from greybox.findings import Finding
from greybox.numerics import TIME_ROUNDING


class Samples(NamedTuple):
    """Stamps in seconds and values, both (N,); ``latency``: the shortest time (s) from stamp to recording, by the recorder's clock."""

    time: np.ndarray
    values: np.ndarray
    latency: float | None = None


class ChannelUse(NamedTuple):
    """What a channel is for, and its ``course`` between samples; ``mean``: a held input counts by its mean in each interval."""

    name: str
    kind: SignalKind
    course: Hold
    mean: bool


@dataclass(frozen=True)
class TimeBase:
    """The common ``time`` (N,), position -> values (N,), what was done, and why it could not be done."""

    time: np.ndarray
    columns: Mapping[int, np.ndarray]
    findings: tuple[Finding, ...] = ()
    problems: tuple[str, ...] = ()


def find_stamp_problems(samples: Samples) -> list[str]:
    """Why these stamps are no time."""
    if len(samples.time) < 2:
        return [f"{len(samples.time)} samples; a signal needs at least 2"]
    if not np.isfinite(samples.time).all():
        return ["time is empty, NaN or infinite; every sample needs its time"]
    steps = np.diff(samples.time)
    bad = np.flatnonzero(steps <= 0)
    if len(bad):
        what = "repeated" if steps[bad[0]] == 0 else "going back"
        return [
            f"time is {what} at sample {bad[0] + 2} ({samples.time[bad[0] + 1]:.12g} s after {samples.time[bad[0]]:.12g} s),"
            f" {len(bad)} time{'s' * (len(bad) != 1)}; time must increase from sample to sample"
        ]
    return []


def bring_to_one_base(
    samples: Mapping[int, Samples],
    uses: Mapping[int, ChannelUse],
    step: float | None = None,
    reading: ReadingPolicy = READING_POLICY,
    policy: ChannelPolicy = CHANNEL_POLICY,
    records: RecordPolicy = RECORD_POLICY,
) -> TimeBase:
    """The signals on one time base.

    Parameters
    ----------
    samples
        Position -> samples with increasing stamps.
    uses
        Position -> what each is for.
    step
        Seconds between the rows of the base; None takes the stamps of the fastest signal.
    reading
        How large the result may be.
    policy, records
        How band-limited signals are interpolated; what a gap in time is.
    """
    first = next(iter(samples.values()))
    if step is None and all(_same_stamps(s.time, first.time) for s in samples.values()):
        return TimeBase(first.time, {k: s.values for k, s in samples.items()})
    fastest = _find_fastest(samples, uses)
    half_row = (_usual_step(samples[fastest].time) if step is None else step) / 2
    start, stop = _find_window(samples, uses, half_row, records)
    if not start < stop:
        spans = ", ".join(f"{uses[k].name!r} {s.time[0]:.6g} to {s.time[-1]:.6g} s" for k, s in samples.items())
        return TimeBase(
            np.zeros(0),
            {k: np.zeros(0) for k in samples},
            problems=(f"the signals share no time ({spans}); choose signals of one run",),
        )
    if step is None:
        base = samples[fastest].time
        slack = TIME_ROUNDING * (base[-1] - base[0])
        base = base[(base >= start - slack) & (base <= stop + slack)]
    else:
        rows = int((stop - start) / step + TIME_ROUNDING) + 1
        check_size(rows, len(samples), reading)
        base = start + step * np.arange(rows)
    check_size(len(base), len(samples), reading)
    for k, s in samples.items():
        if uses[k].kind is SignalKind.INPUT:
            base = base[~_in_gap(base, s, uses[k].course, records)]
    if len(base) < 2:
        return TimeBase(base, {k: np.full(len(base), np.nan) for k in samples})
    columns: dict[int, np.ndarray] = {}
    problems: list[str] = []
    for k, s in samples.items():
        if uses[k].course == "band-limited" and find_sampling_time(s.time, records) is None:
            problems.append(
                f"{uses[k].name!r} has irregular times: a band-limited signal needs uniform ones; take it straight (first)"
            )
            continue
        is_output = uses[k].kind is SignalKind.OUTPUT
        columns[k] = _place_measurements(s, base) if is_output else _interpolate(s, base, uses[k], policy)
    if problems:
        return TimeBase(np.zeros(0), {k: np.zeros(0) for k in samples}, problems=tuple(problems))
    signals = [
        [
            uses[k].name,
            str(uses[k].kind),
            _usual_step(s.time),
            "measured" if uses[k].kind is SignalKind.OUTPUT else uses[k].course,
        ]
        for k, s in samples.items()
    ]
    values = {
        "base": "" if step is not None else uses[fastest].name,
        "step": _usual_step(base),
        "rows": len(base),
        "start": float(base[0]),
        "stop": float(base[-1]),
        "signals": signals,
    }
    return TimeBase(base, columns, (Finding(RecordCode.BROUGHT_TO_ONE_TIME, values=values),))


def interpolate_band_limited(samples: Samples, at: np.ndarray, policy: ChannelPolicy = CHANNEL_POLICY) -> np.ndarray:
    """A uniformly sampled signal without content above half its rate, at other times ``at`` (M,).

    Whittaker-Shannon, cut by a Kaiser window; beyond its ends the signal is reflected about its last value.
    """
    half = min(policy.band_limited_samples, len(samples.time) - 1)
    step = (samples.time[-1] - samples.time[0]) / (len(samples.time) - 1)
    y = samples.values
    padded = np.concatenate((2 * y[0] - y[half:0:-1], y, 2 * y[-1] - y[-2 : -half - 2 : -1]))
    place = (at - samples.time[0]) / step
    whole = np.floor(place).astype(int)
    result = np.zeros(len(at))
    for shift in range(1 - half, half + 1):
        distance = place - (whole + shift)
        window = np.i0(policy.kaiser_beta * np.sqrt(np.maximum(1 - (distance / half) ** 2, 0))) / np.i0(
            policy.kaiser_beta
        )
        result += padded[np.clip(whole + shift + half, 0, len(padded) - 1)] * np.sinc(distance) * window
    return result


def _same_stamps(a: np.ndarray, b: np.ndarray) -> bool:
    return a is b or (len(a) == len(b) and bool(np.array_equal(a, b)))


def _usual_step(time: np.ndarray) -> float:
    return float(np.median(np.diff(time))) if len(time) > 1 else float("nan")


def _find_fastest(samples: Mapping[int, Samples], uses: Mapping[int, ChannelUse]) -> int:
    """The signal with the shortest step; of equal ones an output, whose measurements then stay where they are."""
    steps = {k: _usual_step(s.time) for k, s in samples.items() if uses[k].kind is not SignalKind.CONDITION}
    shortest = min(steps.values())
    close = [k for k, step in steps.items() if step <= shortest * (1 + RECORD_POLICY.step_tolerance)]
    return next((k for k in close if uses[k].kind is SignalKind.OUTPUT), close[0])


def _find_window(
    samples: Mapping[int, Samples], uses: Mapping[int, ChannelUse], half_row: float, records: RecordPolicy
) -> tuple[float, float]:
    """First and last time at which every input is known and some output was measured, within half a row."""
    spans: list[tuple[float, float]] = []
    outputs = [s for k, s in samples.items() if uses[k].kind is SignalKind.OUTPUT]
    for k, s in samples.items():
        if uses[k].kind is not SignalKind.INPUT:
            continue
        end = float(s.time[-1])
        if uses[k].course == "zero":
            # A held signal stays for its step; one that is written when it changes stays for good.
            regular = find_sampling_time(s.time, records) is not None
            end = end + _usual_step(s.time) if regular else float("inf")
        spans.append((float(s.time[0]), end))
    if outputs:
        first, last = min(float(s.time[0]) for s in outputs), max(float(s.time[-1]) for s in outputs)
        spans.append((first - half_row, last + half_row))
    start, stop = max(a for a, _ in spans), min(b for _, b in spans)
    return start, stop if np.isfinite(stop) else max(float(s.time[-1]) for s in samples.values())


def _in_gap(base: np.ndarray, samples: Samples, course: Hold, records: RecordPolicy) -> np.ndarray:
    """Which rows lie in a gap of an input, where nobody knows it."""
    after = find_time_gaps(samples.time, records)
    known = _usual_step(samples.time) if course == "zero" else 0.0  # a held value stays for its step
    inside = np.zeros(len(base), bool)
    for k in after:
        inside |= (base > samples.time[k] + known) & (base < samples.time[k + 1])
    return inside


def _place_measurements(samples: Samples, base: np.ndarray) -> np.ndarray:
    """Each measurement at its nearest row, moved along the line to its neighbour; NaN at rows that are nearest to none."""
    known = np.isfinite(samples.values)
    time, values = samples.time[known], samples.values[known]
    result = np.full(len(base), np.nan)
    if len(time) < 2:
        return result
    after = np.clip(np.searchsorted(time, base), 1, len(time) - 1)
    before = after - 1
    distance = np.minimum(np.abs(base - time[before]), np.abs(base - time[after]))
    steps = np.diff(base)
    reach = np.minimum(np.append(steps, steps[-1]), np.append(steps[0], steps)) / 2
    near = distance <= np.minimum(reach, _usual_step(time)) * (1 + TIME_ROUNDING)
    # A measurement half way between two rows belongs to the earlier one.
    nearest = np.where(np.abs(base - time[before]) <= np.abs(base - time[after]), before, after)
    twice = np.append(False, near[1:] & near[:-1] & (nearest[1:] == nearest[:-1]))
    near &= ~twice
    slope = np.diff(values) / np.diff(time)
    result[near] = (values[before] + slope[before] * (base - time[before]))[near]
    return result


def _interpolate(samples: Samples, base: np.ndarray, use: ChannelUse, policy: ChannelPolicy) -> np.ndarray:
    known = np.isfinite(samples.values)
    time, values = samples.time[known], samples.values[known]
    if not len(time):
        return np.full(len(base), np.nan)
    if use.course == "first" or use.kind is SignalKind.CONDITION:
        return np.interp(base, time, values)
    if use.course == "band-limited":
        return interpolate_band_limited(Samples(time, values), base, policy)
    slack = TIME_ROUNDING * (base[-1] - base[0])
    row = np.clip(np.searchsorted(time, base + slack, side="right") - 1, 0, len(time) - 1)
    held = values[row]
    if use.mean:
        # The mean of a held signal over an interval does to a plant, in first order, what the signal does.
        area = np.concatenate(([0.0], np.cumsum(values[:-1] * np.diff(time))))
        ends = np.append(base, 2 * base[-1] - base[-2])
        total = np.interp(ends, time, area) + values[-1] * np.maximum(ends - time[-1], 0)
        inside = np.searchsorted(time, ends[1:] - slack) - 1 > row
        held = np.where(inside, np.diff(total) / np.diff(ends), held)
    return held
