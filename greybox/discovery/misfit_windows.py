"""When model and data disagree: windows of time with their share of the misfit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

WINDOWS = 20
# A misfit is concentrated if so much of it happens in so little of the time.
MUCH, LITTLE = 0.6, 0.25


@dataclass(frozen=True)
class MisfitWindow:
    """From ``start`` to ``end`` (seconds) of ``record``: ``share`` of the misfit beyond noise, and ``misfit`` over noise there."""

    record: str
    start: float
    end: float
    share: float
    misfit: float


def divide_misfit(
    names: Sequence[str], times: Sequence[np.ndarray], residuals: Sequence[np.ndarray]
) -> tuple[MisfitWindow, ...]:
    """Every record in `WINDOWS` parts of equal length; ``residuals`` (N, ny) are over the noise, NaN in gaps."""
    rows = []
    for name, time, r in zip(names, times, residuals, strict=True):
        edges = np.linspace(0, len(time), min(WINDOWS, len(time)) + 1).astype(int)
        for first, last in pairwise(edges):
            part = r[first:last]
            there = np.isfinite(part)
            squares = float(np.sum(part[there] ** 2))
            rows.append(
                (name, float(time[first]), float(time[last - 1]), max(squares - there.sum(), 0.0), squares, there.sum())
            )
    total = sum(row[3] for row in rows) or 1.0
    return tuple(
        MisfitWindow(name, start, end, over / total, float(np.sqrt(squares / max(count, 1))))
        for name, start, end, over, squares, count in rows
    )


def told(found: Sequence[MisfitWindow]) -> str:
    """One sentence: where most of the misfit happens, or that it happens throughout."""
    if not found or not any(w.share for w in found):
        return "nowhere beyond noise"
    ranked = sorted(found, key=lambda w: -w.share)
    shares = np.cumsum([w.share for w in ranked])
    needed = int(np.searchsorted(shares, MUCH)) + 1
    if needed > LITTLE * len(found):
        return "throughout the records"
    chosen = sorted(ranked[:needed], key=lambda w: (w.record, w.start))
    parts: list[tuple[str, float, float]] = []
    for w in chosen:
        if parts and parts[-1][0] == w.record and w.start - parts[-1][2] <= 0.5 * (w.end - w.start):
            parts[-1] = (w.record, parts[-1][1], w.end)
        else:
            parts.append((w.record, w.start, w.end))
    places = ", ".join(f"{start:.4g} to {end:.4g} s of {name}" for name, start, end in parts[:4])
    more = f" and {len(parts) - 4} more places" if len(parts) > 4 else ""
    return f"{100 * shares[needed - 1]:.0f} % of it in {100 * needed / len(found):.0f} % of the time: {places}{more}"
