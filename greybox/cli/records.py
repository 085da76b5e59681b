"""What a command says about the records it was given."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

from greybox.cli.guard import note

if TYPE_CHECKING:
    from greybox.experiment import Experiment
    from greybox.result import Fit


def tell_notes(*groups: Iterable[Experiment]) -> None:
    """The notes of records as lines on stderr; records that share a note share its line."""
    found: dict[str, list[str]] = {}
    for record in (r for group in groups for r in group):
        for text in record.notes:
            found.setdefault(text, []).append(record.source or record.name)
    for text, names in found.items():
        note(f"note: {', '.join(dict.fromkeys(names))}: {text}")


def by_record(fit: Fit, skip: int) -> list[str]:
    """Lines of a table with the misfit of each record, where there are several; ``skip`` rows of those for validation."""
    from greybox.figures import misfits_of
    from greybox.result.summary import MISFIT_HEADS, misfit_cells, table

    lines: list[str] = []
    for title, traces, left_out in (
        ("fitted record", fit.traces, 0),
        ("validation record", fit.validation_traces, skip),
    ):
        rows: list[Sequence[str]] = [
            [trace.name, output, *misfit_cells(m)]
            for trace in traces
            for output, m in misfits_of(fit, trace, left_out).items()
        ]
        if len(traces) > 1:
            lines += ["", *table([title, "output", *MISFIT_HEADS], rows)]
    return lines
