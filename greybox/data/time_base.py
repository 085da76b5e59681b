"""Signals with stamps of their own on one time base.

The base is the stamps of the fastest signal, or a grid. An input is taken at every row, by the course that belongs to it: held,
straight, or band-limited. An output is taken where it was measured:
 each measurement moves along its own slope to the nearest row, by at
most half a row, and the rows between are empty, so that nothing measured once is counted twice. Rows at which an input is not known
are left out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from greybox.base import TIME_ROUNDING, Finding, Severity
from greybox.data import input_course, policy, sampling
from greybox.data.columns import SignalKind, check_size
from greybox.data.findings import RecordCode
from greybox.data.problems import RowLabels, find_repeats, find_time_problems


class Samples(NamedTuple):
    """Stamps in seconds and values, both (N,); ``latency``: the shortest time (s) from stamp to recording, by the recorder's clock."""

    time: np.ndarray
    values: np.ndarray
    latency: float | None = None

    def without_repeats(self) -> Samples:
        """Without samples that were written twice, time and value alike."""
        twice = find_repeats(self.time, [self.values])
        return self._replace(time=self.time[~twice], values=self.values[~twice]) if twice.any() else self


class ChannelUse(NamedTuple):
    """What a channel is for, and its ``course`` between samples; a held input counts by its mean in each interval."""

    name: str
    kind: SignalKind
    course: input_course.Hold


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
    return find_time_problems(samples.time, RowLabels("sample"))


def bring_to_one_base(
    samples: Mapping[int, Samples],
    uses: Mapping[int, ChannelUse],
    step: float | None = None,
    reading: policy.ReadingPolicy = policy.READING_POLICY,
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
    """
    first = next(iter(samples.values()))
    if step is None and all(s.time is first.time or np.array_equal(s.time, first.time) for s in samples.values()):
        return TimeBase(first.time, {k: s.values for k, s in samples.items()})
    means = [repr(use.name) for use in uses.values() if use.course == "mean"]
    if means:
        refused = f"{', '.join(means)}: a mean belongs to an interval of its own clock, and these are brought to one; say held (zero)"
        return TimeBase(np.zeros(0), {k: np.zeros(0) for k in samples}, problems=(refused,))
    fastest = _find_fastest(samples, uses)
    half_row = (_usual_step(samples[fastest].time) if step is None else step) / 2
    start, stop = _find_window(samples, uses, half_row)
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
            base = base[~_in_gap(base, s, uses[k].course)]
    if len(base) < 2:
        return TimeBase(base, {k: np.full(len(base), np.nan) for k in samples})
    columns: dict[int, np.ndarray] = {}
    problems: list[str] = []
    for k, s in samples.items():
        if uses[k].course == "band-limited" and sampling.find_sampling_time(s.time) is None:
            problems.append(
                f"{uses[k].name!r} has irregular times: a band-limited signal needs uniform ones; take it straight (first)"
            )
            continue
        is_output = uses[k].kind is SignalKind.OUTPUT
        columns[k] = _place_measurements(s, base) if is_output else _interpolate(s, base, uses[k])
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


# Samples on either side by which a band-limited signal is interpolated; the error is below 1e-5 up to 0.8 of its band.
BAND_LIMITED_SAMPLES = 32
# Shape of the window over these samples: side lobes of 1e-5.
CHANNEL_KAISER_BETA = 10.0


def interpolate_band_limited(samples: Samples, at: np.ndarray) -> np.ndarray:
    """A uniformly sampled signal without content above half its rate, at other times ``at`` (M,).

    Whittaker-Shannon, cut by a Kaiser window; beyond its ends the signal is reflected about its last value.
    """
    half = min(BAND_LIMITED_SAMPLES, len(samples.time) - 1)
    step = (samples.time[-1] - samples.time[0]) / (len(samples.time) - 1)
    y = samples.values
    # Reflected about its end points: value and slope go on there.
    padded = np.concatenate((2 * y[0] - y[half:0:-1], y, 2 * y[-1] - y[-2 : -half - 2 : -1]))
    place = (at - samples.time[0]) / step
    whole = np.floor(place).astype(int)
    result = np.zeros(len(at))
    for shift in range(1 - half, half + 1):
        distance = place - (whole + shift)
        # Kaiser: I0(beta sqrt(1 - (d / half)^2)) / I0(beta), at the distance d in samples.
        window = np.i0(CHANNEL_KAISER_BETA * np.sqrt(np.maximum(1 - (distance / half) ** 2, 0))) / np.i0(
            CHANNEL_KAISER_BETA
        )
        # Whittaker and Shannon: the sum of y_k sinc(d_k), cut off by the window.
        result += padded[np.clip(whole + shift + half, 0, len(padded) - 1)] * np.sinc(distance) * window
    return result


def _usual_step(time: np.ndarray) -> float:
    return float(np.median(np.diff(time))) if len(time) > 1 else float("nan")


def _find_fastest(samples: Mapping[int, Samples], uses: Mapping[int, ChannelUse]) -> int:
    """The signal with the shortest step; of equal ones an output, whose measurements then stay where they are."""
    steps = {k: _usual_step(s.time) for k, s in samples.items() if uses[k].kind is not SignalKind.CONDITION}
    shortest = min(steps.values())
    close = [k for k, step in steps.items() if step <= shortest * (1 + sampling.STEP_TOLERANCE)]
    return next((k for k in close if uses[k].kind is SignalKind.OUTPUT), close[0])


def _find_window(
    samples: Mapping[int, Samples], uses: Mapping[int, ChannelUse], half_row: float
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
            regular = sampling.find_sampling_time(s.time) is not None
            end = end + _usual_step(s.time) if regular else float("inf")
        spans.append((float(s.time[0]), end))
    if outputs:
        first, last = min(float(s.time[0]) for s in outputs), max(float(s.time[-1]) for s in outputs)
        spans.append((first - half_row, last + half_row))
    start, stop = max(a for a, _ in spans), min(b for _, b in spans)
    return start, stop if np.isfinite(stop) else max(float(s.time[-1]) for s in samples.values())


def _in_gap(base: np.ndarray, samples: Samples, course: input_course.Hold) -> np.ndarray:
    """Which rows lie in a gap of an input, where nobody knows it."""
    after = sampling.find_time_gaps(samples.time)
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
    # A row reaches half way to its nearer neighbour.
    reach = np.minimum(np.append(steps, steps[-1]), np.append(steps[0], steps)) / 2
    near = distance <= np.minimum(reach, _usual_step(time)) * (1 + TIME_ROUNDING)
    # A measurement half way between two rows belongs to the earlier one.
    nearest = np.where(np.abs(base - time[before]) <= np.abs(base - time[after]), before, after)
    twice = np.append(False, near[1:] & near[:-1] & (nearest[1:] == nearest[:-1]))
    near &= ~twice
    slope = np.diff(values) / np.diff(time)
    result[near] = (values[before] + slope[before] * (base - time[before]))[near]
    return result


def _interpolate(samples: Samples, base: np.ndarray, use: ChannelUse) -> np.ndarray:
    known = np.isfinite(samples.values)
    time, values = samples.time[known], samples.values[known]
    if not len(time):
        return np.full(len(base), np.nan)
    if use.course == "first" or use.kind is SignalKind.CONDITION:
        return np.interp(base, time, values)
    if use.course == "band-limited":
        return interpolate_band_limited(Samples(time, values), base)
    slack = TIME_ROUNDING * (base[-1] - base[0])
    row = np.clip(np.searchsorted(time, base + slack, side="right") - 1, 0, len(time) - 1)
    held = values[row]
    # The mean of a held signal over an interval does to a plant, in first order, what the signal does.
    area = np.concatenate(([0.0], np.cumsum(values[:-1] * np.diff(time))))
    ends = np.append(base, 2 * base[-1] - base[-2])
    total = np.interp(ends, time, area) + values[-1] * np.maximum(ends - time[-1], 0)
    inside = np.searchsorted(time, ends[1:] - slack) - 1 > row
    held = np.where(inside, np.diff(total) / np.diff(ends), held)
    return held


# How two clocks of one file lie to each other, from a signal that both have stamped.
#
# Which offset and which drift make the copy of the second clock lie on that of the first is a least-squares problem; correlation gives
# its start. Without a common signal nobody can tell an offset from a delay of the plant, which is said.


class ClockOffset(NamedTuple):
    """``offset`` (s) to be added to the stamps of the second clock at time ``middle`` (s), and its standard deviation; ``drift`` in s/s,
    above zero where the second clock loses."""

    offset: float
    std: float
    drift: float
    middle: float
    correlation: float

    def correct(self, time: np.ndarray) -> np.ndarray:
        """The stamps (N,) of the second clock on the first."""
        return time + self.offset + self.drift * (time - self.middle)


# Difference (s) of the shortest ways to the recorder from which it is an offset of the clocks; networks take milliseconds.
RECORDER_LATENCY = 0.05


def correct_clocks(
    samples: Mapping[int, Samples],
    wanted: Sequence[int],
    clocks: Mapping[int, str],
    shared: Sequence[tuple[int, int, str]],
) -> tuple[dict[int, Samples], tuple[Finding, ...]]:
    """The wanted samples on the clock of the first of them, and what was found.

    Parameters
    ----------
    samples
        Position -> samples, of the wanted channels and of those in ``shared``.
    wanted
        Positions of the wanted channels.
    clocks
        Position -> clock.
    shared
        Pairs of positions of a signal that the first clock and another one have stamped, with its name.
    """
    reference = clocks[wanted[0]]
    others = list(dict.fromkeys(clocks[k] for k in wanted if clocks[k] != reference))
    corrected = {k: samples[k] for k in wanted}
    findings: list[Finding] = []
    for clock in others:
        pairs = [(a, b, name) for a, b, name in shared if clocks[b] == clock]
        estimates = [(estimate_clock_offset(samples[a], samples[b]), name) for a, b, name in pairs]
        best = max(
            ((e, name) for e, name in estimates if e is not None), key=lambda pair: pair[0].correlation, default=None
        )
        of_recorder = None if best is not None else _compare_latencies(samples, wanted, clocks, clock)
        if of_recorder is not None:
            if abs(of_recorder) > RECORDER_LATENCY:
                values = {"reference": reference, "offset": of_recorder}
                findings.append(Finding(RecordCode.CLOCK_OFFSET_BY_RECORDER, Severity.WARNING, clock, values))
                for k in wanted:
                    if clocks[k] == clock:
                        corrected[k] = samples[k]._replace(time=samples[k].time + of_recorder)
        elif best is None:
            findings.append(Finding(RecordCode.CLOCKS_NOT_COMPARED, subject=clock, values={"reference": reference}))
        if best is None:
            continue
        offset, name = best
        values = {"reference": reference, "signal": name, **{n: float(v) for n, v in offset._asdict().items()}}
        findings.append(Finding(RecordCode.CLOCK_OFFSET, Severity.WARNING, clock, values))
        for k in wanted:
            if clocks[k] == clock:
                corrected[k] = samples[k]._replace(time=offset.correct(samples[k].time))
    return corrected, tuple(findings)


def _compare_latencies(
    samples: Mapping[int, Samples], wanted: Sequence[int], clocks: Mapping[int, str], clock: str
) -> float | None:
    """Seconds to be added to the stamps of ``clock``, from what the recorder saw of it and of the first clock; None if it saw nothing."""
    first, other = samples[wanted[0]].latency, next(samples[k].latency for k in wanted if clocks[k] == clock)
    return None if first is None or other is None else other - first


# Samples of a signal on two clocks from which their offset is estimated: four numbers are fitted to them.
LEAST_SHARED_SAMPLES = 20


def estimate_clock_offset(first: Samples, second: Samples) -> ClockOffset | None:
    """What must be added to the stamps of ``second`` for its signal to lie on that of ``first``.

    None where the two do not look alike at any offset, or show none because they hardly move.
    """
    first, second = (Samples(s.time[np.isfinite(s.values)], s.values[np.isfinite(s.values)]) for s in (first, second))
    if min(len(first.time), len(second.time)) < LEAST_SHARED_SAMPLES:
        return None
    coarse, step = _correlate(first, second)
    if coarse is None:
        return None
    edges = [_find_edges(x) for x in (first, second)]
    a, b = edges
    return _refine(first, second, coarse, step) if a is None or b is None else _match_edges(a, b, coarse)


class _Edges(NamedTuple):
    """Between which two stamps (M, 2) a signal jumps, whether upwards, and for how long (s) it moves on before and after: behind a filter
    all come late, and nobody knows by how much."""

    bounds: np.ndarray
    up: np.ndarray
    smear: float


# Share of its range that a signal moves from one sample to the next when it jumps, and the least ratio of a jump to the noise between.
EDGE_HEIGHT = 0.5
EDGE_CLEARNESS = 5.0


def _find_edges(samples: Samples) -> _Edges | None:
    """Where a trigger, a switch or a pulse jumps; None for a signal that moves otherwise. Noise on its levels does not count."""
    step = np.diff(samples.values)
    jumps = np.abs(step) > EDGE_HEIGHT * np.ptp(samples.values)
    if not 0 < jumps.mean() <= HELD_VALUES:
        return None
    between = step[~jumps]
    if EDGE_CLEARNESS * float(np.sqrt(np.mean(between**2))) > float(np.abs(step[jumps]).min()):
        return None
    at = np.flatnonzero(jumps)
    bounds, up = np.column_stack([samples.time[at], samples.time[at + 1]]), step[at] > 0
    beside = sum(np.maximum(step[np.clip(at + k, 0, len(step) - 1)] / step[at], 0) % 1 for k in (-1, 1))
    return _Edges(bounds, up, float(np.mean(beside * np.diff(bounds, axis=1)[:, 0])))


def _match_edges(first: _Edges, second: _Edges, coarse: float) -> ClockOffset | None:
    """Offset and drift from the edges that both clocks have seen; None where they do not fit each other.

    A clock tells of an edge only between which two of its samples it was. The middle of them is off by an error that is uniform over the
    step, so that an offset ``d_j = m1_j - m2_j`` has the variance ``(s1_j^2 + s2_j^2) / 12``, and ``d_j = offset + drift (m2_j - middle)``
    is a line through the edges: the more there are, the better.
    """
    a, b = (edges.bounds.mean(axis=1) for edges in (first, second))
    widths = [np.diff(edges.bounds, axis=1)[:, 0] for edges in (first, second)]
    offset, drift, middle = coarse, 0.0, float(b.mean())
    for _ in range(OFFSET_ITERATIONS):
        expected = b + offset + drift * (b - middle)
        near = np.abs(expected[:, None] - a[None, :]).argmin(axis=1)
        # An edge is that of the other clock if each is the other's nearest.
        back = np.abs(expected[:, None] - a[None, :]).argmin(axis=0)
        mutual = back[near] == np.arange(len(b))
        i, j = near[mutual], np.flatnonzero(mutual)
        variance = float(np.mean(widths[0][i] ** 2 + widths[1][j] ** 2)) / 12
        centred, distance = b[j] - b[j].mean(), a[i] - b[j]
        spread = float(centred @ centred)
        slope = float(centred @ distance) / spread if len(j) >= LEAST_EDGES and spread else 0.0
        # Below its error a drift does more harm than good.
        slope = slope if abs(slope) > DRIFT_SIGNIFICANCE * np.sqrt(variance / (spread or 1.0)) else 0.0
        settled = (
            abs(float(distance.mean()) - offset) + abs(slope - drift) * float(np.ptp(b))
            <= OFFSET_RESOLUTION * widths[0].min()
        )
        offset, drift, middle = float(distance.mean()), slope, float(b[j].mean())
        if settled:
            break
    residual = distance - offset - drift * centred
    # Edges that lie off the line by more than the steps of both clocks are not the same.
    same = np.abs(residual) <= widths[0][i] + widths[1][j]
    common = min(len(a), len(b))
    agreed = float(np.mean(first.up[i] == second.up[j]))
    if same.sum() < LEAST_CORRELATION * common or 1 - LEAST_CORRELATION < agreed < LEAST_CORRELATION:
        return None
    # What the line leaves tells the error too where there are enough edges: a trigger that bounces, or a filter before one clock.
    seen = float(residual @ residual) / max(len(j) - 2, 1) if len(j) >= LEAST_EDGES else 0.0
    # What samples of each clock leave open, less where the edges do not share it.
    of_clocks = [_error_of_mean(edges.bounds[k], edges.up[k]) for edges, k in ((first, i), (second, j))]
    std = float(np.sqrt(max(sum(of_clocks), seen / len(j)) + first.smear**2 + second.smear**2))
    return ClockOffset(offset, std, drift, middle, float(same.mean()))


# Edges from which a drift is estimated: a line through fewer says nothing of its error.
LEAST_EDGES = 4


def _error_of_mean(bounds: np.ndarray, up: np.ndarray) -> float:
    """Variance (s^2) of the mean time of edges between ``bounds`` (M, 2).

    Edges at a period of whole samples lie at one place between two samples, so that their errors are one and do not average out; nor do
    those of the two edges of a pulse that lasts whole samples.
    """
    middles, variance = bounds.mean(axis=1), float(np.mean(np.diff(bounds, axis=1) ** 2)) / 12
    scatters = []
    for times in (middles[up], middles[~up]):
        if len(times) >= LEAST_EDGES:
            period = np.round((times - times[0]) / np.diff(times).min())
            line = np.polynomial.Polynomial.fit(period, times, 1)
            scatters.append(float(np.mean((times - line(period)) ** 2)))
    are_independent = bool(scatters) and min(scatters) > LEAST_SCATTER * variance
    lengths = [np.diff(middles)[starts] for starts in (up[:-1], ~up[:-1])]
    are_pairs = any(len(each) > 1 and np.var(each) < LEAST_SCATTER * variance for each in lengths)
    return variance / (max(up.sum(), (~up).sum()) if are_pairs else len(up)) if are_independent else variance


# Share of the variance that samples allow from which edges of one period lie at places of their own between the samples.
LEAST_SCATTER = 0.25


# Share of samples that change, at most, for a signal to be called held: commands, switches, set points.
HELD_VALUES = 0.2


def is_held(values: np.ndarray) -> bool:
    """Whether a signal (N,) stays at its values and jumps between them: a command, a switch, a set point."""
    known = values[np.isfinite(values)]
    return len(known) > 1 and 0 < float(np.mean(np.diff(known) != 0)) <= HELD_VALUES


# Rows of the grid on which the start of the search is found by correlation; longer records get a coarser one.
MOST_CORRELATED_ROWS = 2000000


def _correlate(first: Samples, second: Samples) -> tuple[float | None, float]:
    """The offset at which the two correlate most, on a grid of ``step`` seconds."""
    from scipy.signal import fftconvolve

    spans = [s.time[-1] - s.time[0] for s in (first, second)]
    step = max(min(float(np.median(np.diff(s.time))) for s in (first, second)), max(spans) / MOST_CORRELATED_ROWS)
    grids = [s.time[0] + step * np.arange(int((s.time[-1] - s.time[0]) / step) + 1) for s in (first, second)]
    a, b = (np.interp(g, s.time, s.values) for g, s in zip(grids, (first, second), strict=True))
    a, b = a - a.mean(), b - b.mean()
    if not (a.any() and b.any()):
        return None, step
    # The correlation at every lag is a convolution with the reversed copy.
    products = fftconvolve(a, b[::-1])
    lag = int(np.argmax(np.abs(products))) - (len(b) - 1)
    return float(grids[0][0] + lag * step - grids[1][0]), step


# Correlation of the two copies from which they are the same signal; noise of a third of the signal leaves 0.9.
LEAST_CORRELATION = 0.9
# Most steps of the search; it settles in five, and may need more where the grid is coarse.
OFFSET_ITERATIONS = 30
# A step of the search below this share of the grid's ends it.
OFFSET_RESOLUTION = 1e-06
# Standard deviations from which one clock runs faster than the other; below, the drift is zero, which errs by no more than that.
DRIFT_SIGNIFICANCE = 2.0


def _refine(first: Samples, second: Samples, offset: float, step: float) -> ClockOffset | None:
    """Gauss-Newton on offset, drift, gain and level: ``second(t) = gain * first(t + offset + drift (t - middle)) + level``."""
    middle, drift = float(second.time.mean()), 0.0
    # Two estimates of the slope with errors of their own, from every other sample: noise of one alone would pass for slope.
    halves = [Samples(first.time[k::2], np.gradient(first.values[k::2], first.time[k::2])) for k in (0, 1)]
    correlation = 0.0
    covariance: np.ndarray = np.full((2, 2), np.inf)
    for _ in range(OFFSET_ITERATIONS):
        at = second.time + offset + drift * (second.time - middle)
        inside = (at >= first.time[0]) & (at <= first.time[-1])
        if inside.sum() < LEAST_SHARED_SAMPLES:
            return None
        t, y = second.time[inside], second.values[inside]
        model = np.interp(at[inside], first.time, first.values)
        rates = [np.interp(at[inside], half.time, half.values) for half in halves]
        if not (np.ptp(model) and np.ptp(y)):
            return None
        correlation = float(np.corrcoef(model, y)[0, 1])
        gain = float(np.polyfit(model, y, 1)[0])
        # Derivatives by gain, level, offset and drift, and instruments beside them (Z' X b = Z' y).
        columns, instruments = (
            np.column_stack([model, np.ones_like(t), gain * rate, gain * rate * (t - middle)]) for rate in rates
        )
        product = instruments.T @ columns
        if np.linalg.matrix_rank(product) < columns.shape[1]:
            return None
        solution = np.linalg.solve(product, instruments.T @ y)
        residual = y - columns @ solution
        # s^2 (Z' X)^-1 Z' Z (X' Z)^-1, of offset and drift; four numbers are fitted.
        inverse = np.linalg.inv(product)
        variance = float(residual @ residual) / max(len(t) - 4, 1)
        covariance = variance * (inverse @ (instruments.T @ instruments) @ inverse.T)[2:, 2:]
        # At most a step of the grid at a time: farther away the slope is another.
        move = np.clip(solution[2], -step, step)
        offset, drift = offset + float(move), drift + float(solution[3])
        if abs(move) < OFFSET_RESOLUTION * step:
            break
    if correlation < LEAST_CORRELATION:
        return None
    std = float(np.sqrt(covariance[0, 0]))
    if abs(drift) <= DRIFT_SIGNIFICANCE * float(np.sqrt(covariance[1, 1])):
        drift = 0.0
    return ClockOffset(offset, std, drift, middle, correlation)
