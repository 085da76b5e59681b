"""Records in segments, and a step that tells where a segment ends."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import casadi as ca
import numpy as np

from greybox.integrators import Step
from greybox.kernel import Record
from greybox.transcription.arcs import place_cuts


def add_state_outputs(step: Step) -> Step:
    """The step with its states as further outputs, so that the kernel gives the end of a segment with its slopes."""
    f = step.outputs
    x, u, p = (ca.SX.sym(name, f.size1_in(k)) for k, name in enumerate(("x", "u", "p")))
    return replace(step, outputs=ca.Function("outputs", [x, u, p], [ca.vertcat(f(x, u, p), x)]))


def place_segments(e: int, record: Record, rows: int) -> tuple[int, ...]:
    """First rows of the segments of ``rows`` samples of record ``e`` and, at the end, its number of rows."""
    return place_cuts(f"record {e + 1}", np.arange(len(record.u), dtype=float), rows=rows, every=record.every)


def slice_segment(record: Record, a: int, b: int, nx: int) -> Record:
    """Rows ``a`` to ``b``, the last one (the first of the next segment) for its state alone; that state is asked for there."""
    last = min(b + 1, len(record.u))
    y = np.full((last - a, record.y.shape[1] + nx), np.nan)
    y[: b - a, : record.y.shape[1]] = record.y[a:b]
    y[-1, record.y.shape[1] :] = 0.0
    return replace(record, u=record.u[a:last], y=y, h=record.h[a : last - 1], row=record.row[a : last - 1])


def measure_state_ranges(nodes: Sequence[np.ndarray]) -> np.ndarray:
    """Range of each state over all nodes, one where it never moves."""
    together = np.concatenate(nodes)
    spread = np.ptp(together, axis=0)
    size = np.abs(together).max(axis=0)
    return np.where(spread > 1e-12 * size, spread, np.where(size > 0, size, 1.0))
