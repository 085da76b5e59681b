"""How two clocks of one file lie to each other, from a signal that both have stamped.

Which offset and which drift make the copy of the second clock lie on that of the first is a least-squares problem; correlation gives
its start. Without a common signal nobody can tell an offset from a delay of the plant, which is said.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from greybox.experiment.findings import RecordCode
from greybox.experiment.policy import CHANNEL_POLICY, ChannelPolicy
from greybox.experiment.time_base import Samples
from greybox.findings import Finding, Severity


class ClockOffset(NamedTuple):
    """``offset`` (s) to be added to the stamps of the second clock at time ``middle`` (s), and its standard deviation; ``drift`` in s/s."""

    offset: float
    std: float
    drift: float
    middle: float
    correlation: float

    def correct(self, time: np.ndarray) -> np.ndarray:
        """The stamps (N,) of the second clock on the first."""
        return time + self.offset + self.drift * (time - self.middle)


def correct_clocks(
    samples: Mapping[int, Samples],
    wanted: Sequence[int],
    clocks: Mapping[int, str],
    shared: Sequence[tuple[int, int, str]],
    policy: ChannelPolicy = CHANNEL_POLICY,
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
    policy
        When an offset is believed.
    """
    reference = clocks[wanted[0]]
    others = list(dict.fromkeys(clocks[k] for k in wanted if clocks[k] != reference))
    corrected = {k: samples[k] for k in wanted}
    findings: list[Finding] = []
    for clock in others:
        pairs = [(a, b, name) for a, b, name in shared if clocks[b] == clock]
        estimates = [(estimate_clock_offset(samples[a], samples[b], policy), name) for a, b, name in pairs]
        best = max(
            ((e, name) for e, name in estimates if e is not None), key=lambda pair: pair[0].correlation, default=None
        )
        of_recorder = None if best is not None else _compare_latencies(samples, wanted, clocks, clock)
        if of_recorder is not None:
            if abs(of_recorder) > policy.recorder_latency:
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


def estimate_clock_offset(
    first: Samples, second: Samples, policy: ChannelPolicy = CHANNEL_POLICY
) -> ClockOffset | None:
    """What must be added to the stamps of ``second`` for its signal to lie on that of ``first``.

    None where the two do not look alike at any offset, or show none because they hardly move.
    """
    first, second = (Samples(s.time[np.isfinite(s.values)], s.values[np.isfinite(s.values)]) for s in (first, second))
    if min(len(first.time), len(second.time)) < policy.least_shared_samples:
        return None
    coarse, step = _correlate(first, second, policy)
    if coarse is None:
        return None
    return _refine(first, second, coarse, step, policy)


def is_held(values: np.ndarray, policy: ChannelPolicy = CHANNEL_POLICY) -> bool:
    """Whether a signal (N,) stays at its values and jumps between them: a command, a switch, a set point."""
    known = values[np.isfinite(values)]
    return len(known) > 1 and 0 < float(np.mean(np.diff(known) != 0)) <= policy.held_values


def _correlate(first: Samples, second: Samples, policy: ChannelPolicy) -> tuple[float | None, float]:
    """The offset at which the two correlate most, on a grid of ``step`` seconds."""
    from scipy.signal import fftconvolve

    spans = [s.time[-1] - s.time[0] for s in (first, second)]
    step = max(
        min(float(np.median(np.diff(s.time))) for s in (first, second)), max(spans) / policy.most_correlated_rows
    )
    grids = [s.time[0] + step * np.arange(int((s.time[-1] - s.time[0]) / step) + 1) for s in (first, second)]
    a, b = (np.interp(g, s.time, s.values) for g, s in zip(grids, (first, second), strict=True))
    a, b = a - a.mean(), b - b.mean()
    if not (a.any() and b.any()):
        return None, step
    products = fftconvolve(a, b[::-1])
    lag = int(np.argmax(np.abs(products))) - (len(b) - 1)
    return float(grids[0][0] + lag * step - grids[1][0]), step


def _refine(first: Samples, second: Samples, offset: float, step: float, policy: ChannelPolicy) -> ClockOffset | None:
    """Gauss-Newton on offset, drift, gain and level: ``second(t) = gain * first(t + offset + drift (t - middle)) + level``."""
    middle, drift = float(second.time.mean()), 0.0
    slope = Samples(first.time, np.gradient(first.values, first.time))
    correlation, covariance = 0.0, np.full((2, 2), np.inf)
    for _ in range(policy.offset_iterations):
        at = second.time + offset + drift * (second.time - middle)
        inside = (at >= first.time[0]) & (at <= first.time[-1])
        if inside.sum() < policy.least_shared_samples:
            return None
        t, y = second.time[inside], second.values[inside]
        model = np.interp(at[inside], first.time, first.values)
        rate = np.interp(at[inside], slope.time, slope.values)
        if not (np.ptp(model) and np.ptp(y)):
            return None
        correlation = float(np.corrcoef(model, y)[0, 1])
        gain = float(np.polyfit(model, y, 1)[0])
        columns = np.column_stack([model, np.ones_like(t), gain * rate, gain * rate * (t - middle)])
        solution, _, rank, _ = np.linalg.lstsq(columns, y, rcond=None)
        if rank < columns.shape[1]:
            return None
        residual = y - columns @ solution
        covariance = np.linalg.inv(columns.T @ columns)[2:, 2:] * float(residual @ residual) / max(len(t) - 4, 1)
        move = np.clip(solution[2], -step, step)
        offset, drift = offset + float(move), drift + float(solution[3])
        if abs(move) < policy.offset_resolution * step:
            break
    if correlation < policy.least_correlation:
        return None
    std = float(np.sqrt(covariance[0, 0]))
    steps = [float(np.median(np.diff(s.time))) for s in (first, second)]
    # The edges of a held signal are known to a step of each clock, however well the rest of it fits.
    held = any(is_held(s.values, policy) for s in (first, second))
    if held:
        std = float(np.sqrt(std**2 + (steps[0] ** 2 + steps[1] ** 2) / 12))
    span = second.time[-1] - second.time[0]
    least = max(steps) if held else policy.drift_significance * float(np.sqrt(covariance[1, 1])) * span
    if abs(drift) * span <= 2 * least:
        drift = 0.0
    return ClockOffset(offset, std, drift, middle, correlation)
