"""The page of an export: which files were written, what they hold, and the fit behind them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from greybox.export import Linearisation, ModelFamily
from greybox.reports.equations import typeset_equations
from greybox.reports.fit_parts import constants_table
from greybox.reports.fit_parts import verdict as fit_verdict
from greybox.reports.of_linearisation import linear_sections
from greybox.reports.of_linearisation import question as linear_question
from greybox.reports.of_linearisation import verdict as linear_verdict
from greybox.reports.page import Block, Code, Folded, Page, Section, Table, Text
from greybox.reports.provenance import command_block, name_value_table
from greybox.reports.typography import count_noun
from greybox.result import Fit

LONGEST = 60_000  # letters of a listing
READABLE = (".c", ".h", ".py", ".mo", ".json")


@dataclass(frozen=True)
class Export:
    """What `greybox export` has written: ``files`` of ``kind`` ("MATLAB", "C" ...) from a fit; the linear model, where it is one."""

    fit: Fit
    kind: str
    files: tuple[Path, ...]
    linear: Linearisation | None = None
    family: ModelFamily | None = None


def report_of_export(export: Export, *, command: str = "") -> Page:
    """The page of an export."""
    fit, linear = export.fit, export.linear
    behaviour = linear_sections(linear, export.family) if linear is not None else []
    sections = [
        *behaviour,
        Section("files", "The files", list(_files(export))),
        Section("fit", "The fit behind it", [fit_verdict(fit), constants_table(fit), typeset_equations(fit.model)]),
        Section(
            "repeat",
            "How to repeat it",
            [*command_block(command), name_value_table("Versions", fit.provenance.versions)],
        ),
    ]
    asked = (
        linear_question(linear) if linear is not None else f"{fit.model.title}, fitted, to run outside this program."
    )
    return Page(f"{fit.model.title} as {export.kind}", asked, _verdict(export), sections, "export")


def _verdict(export: Export) -> Text:
    written = f"{count_noun(len(export.files), 'file')} written: {', '.join(f.name for f in export.files)}."
    if export.linear is not None:
        said = linear_verdict(export.linear)
        return Text([*said.paragraphs, written], said.tone)
    doubt = [] if export.fit.success else ["The fit behind it did not succeed: do not use it."]
    return Text(
        [f"The nonlinear model, with the fitted constants, as {export.kind}.", written, *doubt],
        "bad" if doubt else "good",
    )


def _files(export: Export) -> Iterator[Block]:
    rows = [[f.name, f"{f.stat().st_size:,} bytes".replace(",", " ")] for f in export.files]
    yield Table("Written", ["file", "size"], rows)
    for file in export.files:
        if file.suffix in READABLE and file.stat().st_size <= LONGEST:
            yield Folded(f"What is in {file.name}", [Code(file.read_text(encoding="utf-8"))])
