"""What a command says about the records it was given."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Annotated

import typer

from greybox.cli.exits import print_note

if TYPE_CHECKING:
    from greybox.experiment import Experiment
    from greybox.result import Fit

SplitHoles = Annotated[
    bool,
    typer.Option(
        "--split-holes",
        help="Cut records where their time has a gap or starts anew (the logger dropped out, two runs in one file).",
    ),
]


def print_record_notes(*groups: Iterable[Experiment]) -> None:
    """The findings of records as lines on stderr; records that share a finding share its line."""
    from greybox.experiment import collect_record_findings

    for finding in collect_record_findings(record for group in groups for record in group):
        print_note(f"note: {finding}")


def split_records(at_rest: bool, *groups: Sequence[Experiment], runs: int = 0) -> list[tuple[Experiment, ...]]:
    """Each group with its records cut at the gaps in their time, and a word on what was done; ``runs``: cuts made before."""
    parts = [[record.split_at_time_gaps() for record in group] for group in groups]
    pairs = [
        (record.source or record.name, len(cut))
        for group, cuts in zip(groups, parts, strict=True)
        for record, cut in zip(group, cuts, strict=True)
        if cut != (record,)
    ]
    if not pairs and not runs:
        print_note("note: --split-holes has no effect: no record has a gap in its time, and none starts anew")
    for name, number in pairs:
        print_note(
            f"note: {name} was cut at the gaps in its time: {number} piece{'s' * (number != 1)}, each a record of its own"
        )
    if pairs and at_rest:
        print_note(
            "note: --at-rest: each piece is taken to begin at rest; leave it out if the plant still moved after a gap"
        )
    return [tuple(part for cut in cuts for part in cut) for cuts in parts]


def misfit_by_record(fit: Fit, skip: int) -> list[str]:
    """Lines of a table with the misfit of each record, where there are several; ``skip`` rows of those for validation."""
    from greybox.plots import record_misfits
    from greybox.result.summary import MISFIT_HEADS, format_table, to_misfit_cells

    lines: list[str] = []
    for title, traces, left_out in (
        ("fitted record", fit.traces, 0),
        ("validation record", fit.validation.traces, skip),
    ):
        rows: list[Sequence[str]] = [
            [trace.name, output, *to_misfit_cells(m)]
            for trace in traces
            for output, m in record_misfits(fit, trace, left_out).items()
        ]
        if len(traces) > 1:
            lines += ["", *format_table([title, "output", *MISFIT_HEADS], rows)]
    return lines
