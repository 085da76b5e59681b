"""An export: which files were written, what they hold, and the fit behind them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from greybox.base.document import Block, CodeBlock, Details, Document, Later, Section, TableBlock, Text, Tone
from greybox.estimation.linear.linearisation import Linearisation
from greybox.estimation.linear.model_family import ModelFamily
from greybox.estimation.result import Fit
from greybox.show.documents.linearisation import linear_evidence, linear_question, linear_sections, linear_summary
from greybox.show.documents.tables import parameters_table, provenance_section, typeset_equations
from greybox.show.sentences.wording import count_noun

READABLE = (".c", ".h", ".py", ".mo", ".json")


@dataclass(frozen=True)
class Export:
    """What `greybox export` has written: ``files`` of ``kind`` ("MATLAB", "C" ...) from a fit; the linear model, where it is one."""

    fit: Fit
    kind: str
    files: tuple[Path, ...]
    linear: Linearisation | None = None
    family: ModelFamily | None = None


def describe_export(export: Export, *, command: str = "") -> Document:
    """What is said of an export; ``command`` is what was typed."""
    fit, linear = export.fit, export.linear
    written = f"{count_noun(len(export.files), 'file')} written: {', '.join(f.name for f in export.files)}"
    tone, answer = Tone.GOOD, f"{fit.model.title} was written as {export.kind}."
    notes: list[Text] = [written]
    if linear is not None:
        summary = linear_summary(linear)
        tone, answer, notes = summary.tone, str(summary.answer), [*summary.notes, written]
    elif not fit.success:
        tone, notes = Tone.BAD, ["the fit did not succeed: do not use this export", written]
    return Document(
        f"{fit.model.title} as {export.kind}",
        answer,
        tone,
        notes=notes,
        question=f"The fitted model {fit.model.title}, for use outside this program."
        if linear is None
        else linear_question(linear),
        evidence=Later(linear_evidence, linear, export.family),
        sections=Later(_sections, export, command),
        kind="export",
    )


def _sections(export: Export, command: str) -> Iterator[Section]:
    fit = export.fit
    if export.linear is not None:
        yield from linear_sections(export.linear, export.family)
    yield Section("files", "Files", list(_files(export)))
    yield Section("fit", "The fit", [fit.describe().verdict, parameters_table(fit), typeset_equations(fit.model)])
    yield provenance_section(command, fit.provenance.versions)


# Letters of a file that an export's page shows.
REPORT_LISTING = 60000


def _files(export: Export) -> Iterator[Block]:
    rows = [[f.name, f"{f.stat().st_size:,} bytes".replace(",", " ")] for f in export.files]
    yield TableBlock("Files", ["file", "size"], rows)
    for file in export.files:
        if file.suffix in READABLE and file.stat().st_size <= REPORT_LISTING:
            yield Details(f"Content of {file.name}", [CodeBlock(file.read_text(encoding="utf-8"))])


DOCUMENTS = {"Export": describe_export}
"""Class of a result -> the function that describes it."""
