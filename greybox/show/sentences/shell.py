"""What the commands print: findings about a study, lines on written files, and what `models`, `extensions` and `demo` say."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from greybox.base.texts import to_word
from greybox.show.printers.text import table_lines
from greybox.show.sentences.registry import register, renders

if TYPE_CHECKING:
    from greybox.base import Finding
    from greybox.base.extensions import Extension
    from greybox.shell.demonstration import Demo
    from greybox.shell.project import ModelListing


def _record_split(finding: Finding) -> str:
    pieces = finding.values["pieces"]
    return f"{finding.subject} is split into {pieces} record{'s' * (pieces != 1)} at the gaps in time"


def _files_replaced(finding: Finding) -> str:
    files = finding.values["files"]
    return f"{', '.join(map(str, files))} held something else and {'was' if len(files) == 1 else 'were'} overwritten"


# The codes are those of greybox.shell.terminal, a later package.
register(
    {
        "split_without_effect": "--split-holes has no effect: time has no gap and does not restart in any record",
        "record_split": _record_split,
        "pieces_at_rest": "with --at-rest each piece starts at rest; omit --at-rest if the plant still moves after a gap",
        "substeps_without_effect": (
            "--substeps {substeps} has no effect on a linear model, which is integrated exactly; use --method rk4 for substeps"
        ),
        "files_replaced": _files_replaced,
        "study_fields_unused": lambda f: f"{f.subject}: a check does not use {', '.join(f.values['places'])}",
        "unused_parameter": "parameter {subject!r} is in no equation: a term is missing, or the parameter is not needed",
    }
)


def written(files: Sequence[Path]) -> str:
    """The line with the files that a command has written."""
    return f"written: {', '.join(map(str, files))}"


def report_line(path: Path) -> str:
    """The last line of a command that has written a report."""
    return f"report: {path} (open it in a browser; it needs no network)"


def study_line(path: Path, command: str) -> str:
    """The line of a command that has written a study file."""
    return f"written: {path}; run it with: greybox {command} {to_word(str(path))}"


# The list of models.


@renders("ModelListing")
def model_listing(listing: ModelListing) -> str:
    """Three lines a model: name and description, its signals, its file."""
    lines = []
    for entry in listing.models:
        model = entry.model
        states = ", ".join(s.name for s in model.all_states)
        inputs = ", ".join(i.name for i in model.inputs) or "none"
        outputs = ", ".join(y.name for y in model.outputs)
        lines += [
            f"{entry.name}: {model.description}" if model.description else entry.name,
            f"    states {states}; inputs {inputs}; outputs {outputs}",
            f"    {entry.where}",
        ]
    return "\n".join(lines)


def demo_answer(demo: Demo, folder: Path) -> str:
    """What `greybox demo` prints: the results, the files, and the commands that repeat it."""
    return "\n".join(
        [
            "",
            demo.fit.provenance.equations,
            "",
            str(demo),
            "",
            f"files in {folder} (computed in {demo.seconds:.1f} s):",
            *(f"  {path.name:20s} {what}" for path, what in demo.files.items()),
            "",
            "to repeat the demonstration step by step:",
            f"  greybox fit {demo.arguments}",
            f"  greybox discover {demo.arguments}",
            f"  greybox export {to_word(str(folder / 'fit.json'))} --to control",
        ]
    )


def extensions_text(entries: Sequence[Extension]) -> str:
    """What `greybox extensions` prints: kind, name, place and origin of each entry; those that failed follow with their reason."""
    rows = [[e.kind, e.name, e.place, f"{e.distribution} {e.version}".strip()] for e in entries if not e.failure]
    failed = [f"{e.kind} {e.name} of {e.distribution}: not loaded ({e.failure})" for e in entries if e.failure]
    return "\n".join([*table_lines(["kind", "name", "place", "from"], rows), *failed])
