"""When model and data disagree: windows of time with their share of the misfit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from greybox.discovery.policy import LocalisationPolicy


@dataclass(frozen=True)
class MisfitWindow:
    """From ``start`` to ``end`` (seconds) of ``record``: ``share`` of the misfit beyond noise, and ``misfit`` over noise there."""

    record: str
    start: float
    end: float
    share: float
    misfit: float


@dataclass(frozen=True)
class MisfitTiming:
    """The windows in which most of the misfit is concentrated: stretches of time as (record, start, end) in seconds.

    ``share`` of the misfit happens in ``time_share`` of the windows. Without stretches it happens throughout the records.
    """

    share: float
    time_share: float
    stretches: tuple[tuple[str, float, float], ...]


def divide_misfit(
    names: Sequence[str], times: Sequence[np.ndarray], residuals: Sequence[np.ndarray], count: int
) -> tuple[MisfitWindow, ...]:
    """Every record in ``count`` windows of equal length; ``residuals`` (N, ny) are over the noise, NaN in gaps."""
    rows = []
    for name, time, r in zip(names, times, residuals, strict=True):
        edges = np.linspace(0, len(time), min(count, len(time)) + 1).astype(int)
        for first, last in pairwise(edges):
            part = r[first:last]
            is_measured = np.isfinite(part)
            samples, squares = is_measured.sum(), float(np.sum(part[is_measured] ** 2))
            excess = max(squares - samples, 0.0)
            rows.append((name, float(time[first]), float(time[last - 1]), excess, squares, samples))
    total = sum(row[3] for row in rows) or 1.0
    return tuple(
        MisfitWindow(name, start, end, excess / total, float(np.sqrt(squares / max(samples, 1))))
        for name, start, end, excess, squares, samples in rows
    )


def find_concentration(windows: Sequence[MisfitWindow], policy: LocalisationPolicy) -> MisfitTiming | None:
    """In which stretches most of the misfit happens; None where there is none beyond noise."""
    if not windows or not any(w.share for w in windows):
        return None
    ranked = sorted(windows, key=lambda w: -w.share)
    shares = np.cumsum([w.share for w in ranked])
    needed = int(np.searchsorted(shares, policy.concentrated_misfit)) + 1
    if needed > policy.concentrated_time * len(windows):
        return MisfitTiming(1.0, 1.0, ())
    stretches: list[tuple[str, float, float]] = []
    for w in sorted(ranked[:needed], key=lambda w: (w.record, w.start)):
        adjoins = stretches and stretches[-1][0] == w.record and w.start - stretches[-1][2] <= 0.5 * (w.end - w.start)
        if adjoins:
            stretches[-1] = (w.record, stretches[-1][1], w.end)
        else:
            stretches.append((w.record, w.start, w.end))
    return MisfitTiming(float(shares[needed - 1]), needed / len(windows), tuple(stretches))
