"""A record as the filter reads it: the measurements stand beside the inputs."""

from __future__ import annotations

import numpy as np

from greybox.integrators import Step
from greybox.kernel import Record


def to_filter_record(record: Record, step: Step) -> Record:
    """``record`` for the filter of ``step``: columns of a row are what ``step`` sees as input, the measurements (0 in a gap), 1 where
    something was measured, 0 and 1 in turn, and whether the input is linear between rows.

    The filter's own outputs are compared with zero.
    """
    read = record.read_by(step)
    present = np.isfinite(record.y)
    rows = len(record.y)
    columns = [
        read.u,
        np.where(present, record.y, 0.0),
        present,
        (np.arange(rows) % 2)[:, None],
        np.full((rows, 1), float(read.first_order)),
    ]
    targets = np.zeros((rows, 2 * record.y.shape[1]))
    return Record(
        np.hstack(columns),
        targets,
        read.h,
        read.row,
        read.lengths,
        first_order=True,
        rows_per_sample=record.rows_per_sample,
    )


def remove_measurements(record: Record, outputs: int) -> Record:
    """The rows of `to_filter_record` with every measurement taken for a gap: the filter then runs freely."""
    u = record.u.copy()
    u[:, -2 - outputs : -2] = 0.0
    return Record(u, record.y, record.h, record.row, record.lengths, True, record.rows_per_sample)
