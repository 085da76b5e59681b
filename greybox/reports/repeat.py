"""How to repeat what a page shows: the command, the options, the versions."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from greybox.reports.page import Block, Code, Folded, Section, Table
from greybox.reports.words import counted, listed
from greybox.result import Fit


def repeat_section(fit: Fit, command: str) -> Section:
    """What is needed to get the numbers of ``fit`` again."""
    return Section("repeat", "How to repeat it", list(_of_fit(fit, command)))


def shell(command: str) -> Iterator[Block]:
    """The command as it was typed, if it was."""
    if command:
        yield Code(command, "In the shell")


def _of_fit(fit: Fit, command: str) -> Iterator[Block]:
    yield from shell(command)
    error = listed([f"{e:.2g} of the noise in {o}" for o, e in fit.discretisation.error.items() if e])
    how = [
        ["integration", fit.discretisation.label],
        ["its error", error or "none"],
        ["search", str(fit.solver.statistics.get("strategy", ""))],
        [
            "ended",
            f"{fit.status.replace('_', ' ')} after {counted(int(fit.solver.statistics.get('iterations', 0)), 'iteration')}",
        ],
    ]
    yield Table("How it was computed", ["what", "how"], [row for row in how if row[1]])
    yield Folded(
        "Options and versions", [named("Options", fit.provenance.options), named("Versions", fit.provenance.versions)]
    )


def named(title: str, values: Mapping[str, Any]) -> Table:
    """Names and values as a table."""
    return Table(title, ["name", "value"], [[str(k), "" if v is None else str(v)] for k, v in values.items()])
