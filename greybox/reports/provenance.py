"""How to repeat what a page shows: the command, the options, the versions."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from greybox.estimation.options import FitOptions
from greybox.estimation.versions import read_versions
from greybox.rendering.english import count_noun, join_names, phrase
from greybox.rendering.reports import PageText
from greybox.reports.page import Block, CodeBlock, Details, PageTable, Section, Text
from greybox.result import Fit


def provenance_section(command: str, versions: Mapping[str, Any] | None = None) -> Section:
    """The command and the versions: those of now, or those that were noted."""
    table = name_value_table(phrase(PageText.VERSIONS), read_versions() if versions is None else versions)
    return Section("repeat", [*_command(command), table])


def fit_provenance_section(fit: Fit, command: str) -> Section:
    """What is needed to get the numbers of a fit again."""
    return Section("repeat", list(_of_fit(fit, command)))


def _command(command: str) -> Iterator[Block]:
    if command:
        yield CodeBlock(command, phrase(PageText.COMMAND))


def _of_fit(fit: Fit, command: str) -> Iterator[Block]:
    yield from _command(command)
    error = join_names([f"{e:.2g} of the noise in {output}" for output, e in fit.discretisation.error.items() if e])
    iterations = count_noun(int(fit.solver.statistics.get("iterations", 0)), "iteration")
    rows = [
        ["discretisation", fit.discretisation.label],
        ["its error", error or "none"],
        ["search", "" if fit.solver.strategy is None else str(fit.solver.strategy)],
        ["ended", f"{fit.status.replace('_', ' ')} after {iterations}"],
    ]
    yield PageTable(phrase(PageText.COMPUTATION), ["what", "how"], [row for row in rows if row[1]])
    tables = [
        _options(fit),
        name_value_table(phrase(PageText.VERSIONS), fit.provenance.versions),
    ]
    yield Details(phrase(PageText.OPTIONS_AND_VERSIONS), tables)


def name_value_table(title: Text, values: Mapping[str, Any]) -> PageTable:
    """Names and values as a table; a name within a group is ``group.name``."""
    return PageTable(title, ["name", "value"], [[name, value] for name, value in _flat(values)])


def _options(fit: Fit) -> PageTable:
    """The options; of the policy only what differs from the default, which the note says."""
    usual = dict(_flat(FitOptions().to_data()))
    rows = [
        [name, value]
        for name, value in _flat(fit.provenance.options)
        if not (name.startswith("policy.") and usual.get(name) == value)
    ]
    return PageTable(phrase(PageText.OPTIONS), ["name", "value"], rows, phrase(PageText.POLICY_NOTE))


def _flat(values: Mapping[str, Any], group: str = "") -> Iterator[tuple[str, str]]:
    for name, value in values.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{group}{name}.")
        else:
            yield f"{group}{name}", "" if value is None else str(value)
