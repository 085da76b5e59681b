"""How to repeat what a page shows: the command, the options, the versions."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from greybox.reports.page import Block, Code, Folded, Section, Table
from greybox.reports.typography import count_noun, join_names
from greybox.result import Fit


def provenance_section(fit: Fit, command: str) -> Section:
    """What is needed to get the numbers of ``fit`` again."""
    return Section("repeat", "How to repeat it", list(_of_fit(fit, command)))


def command_block(command: str) -> Iterator[Block]:
    """The command as it was typed, if it was."""
    if command:
        yield Code(command, "In the shell")


def _of_fit(fit: Fit, command: str) -> Iterator[Block]:
    yield from command_block(command)
    error = join_names([f"{e:.2g} of the noise in {o}" for o, e in fit.discretisation.error.items() if e])
    how = [
        ["integration", fit.discretisation.label],
        ["its error", error or "none"],
        ["search", "" if fit.solver.strategy is None else str(fit.solver.strategy)],
        [
            "ended",
            f"{fit.status.replace('_', ' ')} after {count_noun(int(fit.solver.statistics.get('iterations', 0)), 'iteration')}",
        ],
    ]
    yield Table("How it was computed", ["what", "how"], [row for row in how if row[1]])
    yield Folded(
        "Options and versions",
        [name_value_table("Options", fit.provenance.options), name_value_table("Versions", fit.provenance.versions)],
    )


def name_value_table(title: str, values: Mapping[str, Any]) -> Table:
    """Names and values as a table."""
    return Table(title, ["name", "value"], [[str(k), "" if v is None else str(v)] for k, v in values.items()])
