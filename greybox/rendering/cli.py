"""What the commands print: findings about a study, and the answers of `fit`, `simulate`, `export`, `models` and `demo`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from greybox.rendering.registry import register, renders
from greybox.rendering.result import MISFIT_HEADS, to_misfit_cells
from greybox.rendering.tables import format_table

if TYPE_CHECKING:
    from greybox.cli.answers import CodeAnswer, FitAnswer, LinearAnswer, SimulationAnswer
    from greybox.findings import Finding


def _record_split(finding: Finding) -> str:
    pieces = finding.values["pieces"]
    return f"{finding.subject} is split into {pieces} record{'s' * (pieces != 1)} at the gaps in time"


# The codes are those of greybox.cli.findings, a later package.
register(
    {
        "split_without_effect": "--split-holes has no effect: time has no gap and does not restart in any record",
        "record_split": _record_split,
        "pieces_at_rest": "with --at-rest each piece starts at rest; omit --at-rest if the plant still moves after a gap",
        "substeps_without_effect": (
            "--substeps {substeps} has no effect on a linear model, which is integrated exactly; use --method rk4 for substeps"
        ),
        "file_overwritten": "{subject} existed and was overwritten",
        "study_fields_unused": lambda f: f"{f.subject}: a check does not use {', '.join(f.values['places'])}",
        "unused_parameter": "parameter {subject!r} is in no equation: a term is missing, or the parameter is not needed",
    }
)


@renders("FitAnswer")
def fit_answer(answer: FitAnswer) -> str:
    """Equations, parameters, remedies, further intervals, predictions, residual tests, the misfit of each record."""
    lines = [answer.fit.provenance.equations, "", str(answer.fit)]
    lines += [f"{'remedy' if k == 0 else 'or'}: {text}" for k, text in enumerate(answer.remedies)]
    if answer.profiles or answer.zero_noise:
        zeros = [f"{name}: zero; its limit is listed with the parameters" for name in answer.zero_noise]
        lines += ["", "profile likelihood", *_indented("\n".join([*map(str, answer.profiles), *zeros]))]
    if answer.bootstrap is not None:
        bootstrap = answer.bootstrap
        lines += ["", f"block bootstrap, {len(bootstrap.samples)} replicates in blocks of {bootstrap.block} rows"]
        for name in bootstrap.names:
            low, high = bootstrap.interval[name]
            lines.append(f"  {name}: standard deviation {bootstrap.std[name]:.3g}, 95 % [{low:.5g}, {high:.5g}]")
    if answer.refusal:
        lines += ["", answer.refusal]
    for title, scores in (("", answer.scores), (", validation records", answer.validation_scores)):
        if scores is not None:
            lines += ["", f"free run and prediction{title}", *_indented(str(scores))]
    if answer.tests is not None:
        lines += ["", "residual tests (p below 0.01 is an alarm; each test has a false-alarm rate of 1 %)"]
        lines.append(str(answer.tests))
    for title, misfits in (("estimation record", answer.misfits), ("validation record", answer.validation_misfits)):
        if misfits:
            rows = [[record, output, *to_misfit_cells(misfit)] for record, output, misfit in misfits]
            lines += ["", *format_table([title, "output", *MISFIT_HEADS], rows)]
    return "\n".join(lines)


@renders("SimulationAnswer")
def simulation_answer(answer: SimulationAnswer) -> str:
    """Which file was written, its rows and columns, and how the model was integrated."""
    run = answer.run
    names = ", ".join([*run.inputs, *run.outputs])
    return f"{answer.file}: {len(run.time)} rows, {names}; integrated by {run.discretisation}"


@renders("LinearAnswer")
def linear_answer(answer: LinearAnswer) -> str:
    """The linear model, its family of samples, and the file."""
    family = ["", str(answer.family)] if answer.family is not None else []
    return "\n".join([str(answer.linear), *family, "", written(answer.files)])


@renders("CodeAnswer")
def code_answer(answer: CodeAnswer) -> str:
    """What the model was written as, its step, and the files."""
    step = "" if answer.step is None else f", {answer.step_name} {answer.step:g} s"
    return f"{answer.title} as {answer.kind}{step}\n{written(answer.files)}"


def written(files: Sequence[Path]) -> str:
    """The line with the files that a command has written."""
    return f"written: {', '.join(map(str, files))}"


def report_line(path: Path) -> str:
    """The last line of a command that has written a report."""
    return f"report: {path} (open it in a browser; it needs no network)"


def study_line(path: Path, command: str) -> str:
    """The line of a command that has written a study file."""
    return f"written: {path}; run it with: greybox {command} {path}"


def _indented(text: str) -> list[str]:
    return [f"  {line}" for line in text.splitlines()]
