"""What the commands print: findings about a study, lines on written files, and what `models`, `extensions` and `demo` say."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from greybox.base.document import Block, Paragraphs, TableBlock
from greybox.base.texts import to_word
from greybox.show.printers.text import table_lines
from greybox.show.sentences import register, renders
from greybox.show.sentences.wording import count_noun

if TYPE_CHECKING:
    from greybox.base.extensions import Extension
    from greybox.shell.project import ModelListing


# The codes are those of greybox.shell.terminal, a later package.
register(
    {
        "record_split": "{subject} is split into {pieces:noun record} at the gaps in time",
        "files_replaced": "{files:list} held something else and {files:was|were} overwritten",
        "split_without_effect": "--split-holes has no effect: time has no gap and does not restart in any record",
        "pieces_at_rest": "with --at-rest each piece starts at rest; omit --at-rest if the plant still moves after a gap",
        "substeps_without_effect": "--substeps {substeps} has no effect on a linear model, which is integrated exactly; use --method rk4"
        " for substeps",
        "other_model_in_study": lambda f: (
            f"{f.subject}: written for another model: {'; '.join(f.values['lines'][:3])}"
            + f"; and {len(f.values['lines']) - 3} lines more" * (len(f.values["lines"]) > 3)
        ),
        "study_fields_unused": "{subject}: a check does not use {places:list}",
        "starts_as_declared": "the run begins at the initial state of the model, {states}, and not where a record may begin; begin it"
        " elsewhere with --initial {subject}=VALUE, or at rest under its first inputs with --settled",
        "unused_parameter": "parameter {subject!r} is in no equation: a term is missing, or the parameter is not needed",
    }
)


def study_line(path: Path, command: str) -> str:
    """What a command says that has written a study file."""
    return f"The study was written to {path}; nothing was run.\n\nnext: greybox {command} {to_word(str(path))}"


# The list of models.


# Letters of what a model is, in the list of all.
MODEL_WIDTH = 30


@renders("ModelListing")
def model_listing(listing: ModelListing) -> list[Block]:
    """How many models there are; name and signals of each."""
    rows = []
    for entry in listing.models:
        model = entry.model
        inputs, outputs = (", ".join(s.name for s in group) or "none" for group in (model.inputs, model.outputs))
        rows.append(
            [entry.name, f"{inputs} -> {outputs}", textwrap.shorten(model.description, MODEL_WIDTH, placeholder=" ...")]
        )
    table = TableBlock("Models", ["model", "signals", "what it is"], rows)
    return [Paragraphs([f"{count_noun(len(rows), 'model')} can be named here."]), table]


def extensions_text(entries: Sequence[Extension]) -> str:
    """What `greybox extensions` prints: the names of each kind and their origin; those that failed with their reason."""
    groups: dict[tuple[str, str], list[str]] = {}
    for e in entries:
        if not e.failure:
            groups.setdefault((e.kind, f"{e.distribution} {e.version}".strip()), []).append(e.name)
    failed = [f"{e.kind} {e.name} of {e.distribution}: not loaded ({e.failure})" for e in entries if e.failure]
    packages = count_noun(len({e.distribution for e in entries}), "package")
    answer = f"{count_noun(len(entries) - len(failed), 'extension')} of {packages} add to the core."
    rows = [[kind, ", ".join(names), origin] for (kind, origin), names in groups.items()]
    return "\n".join([answer, "", *failed, *table_lines(["kind", "names", "from"], rows)])
