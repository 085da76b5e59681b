"""What the commands print: findings about a study, and the answers of `fit`, `simulate`, `export`, `models` and `demo`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from greybox.base.units import format_unit
from greybox.show.sentences.discovery import conclusion_text
from greybox.show.sentences.estimation import MISFIT_HEADS, to_misfit_cells
from greybox.show.sentences.registry import register, renders
from greybox.show.sentences.wording import format_table, format_with_std

if TYPE_CHECKING:
    from greybox.base.extensions import Extension
    from greybox.base.findings import Finding
    from greybox.estimation.result_parts import Estimate
    from greybox.shell.answers import CodeAnswer, FitAnswer, LinearAnswer, SimulationAnswer
    from greybox.shell.demonstration import Demo
    from greybox.shell.project import ModelListing


def _record_split(finding: Finding) -> str:
    pieces = finding.values["pieces"]
    return f"{finding.subject} is split into {pieces} record{'s' * (pieces != 1)} at the gaps in time"


# The codes are those of greybox.shell.terminal, a later package.
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
            rows = [[m.record, m.output, *to_misfit_cells(m.misfit)] for m in misfits]
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


# The text of the demonstration.

HEAD = ("parameter", "true", "start", "plain model", "extended model", "deviation", "unit")


@renders("Demo")
def demo_text(demo: Demo) -> str:
    """Parameters and true values, the missing effect, the errors before and after, the best model, the state space."""
    gaps = [
        f"  {output}: rms error on the validation record {gap.before:.3g} -> {gap.after:.3g} {format_unit(gap.unit)}"
        + (f" (noise {gap.floor:.3g})" if gap.is_floor_known else "")
        for output, gap in demo.discovery.holdout.items()
    ]
    best = map(str, demo.comparison.verdict[:1])
    return "\n".join(
        [constants_table(demo), "", conclusion_text(demo.discovery), *gaps, "", *best, "", str(demo.plant)]
    )


def constants_table(demo: Demo) -> str:
    """Each parameter with its true value: of the plain model, and of the extended model."""
    rows = []
    for name, truth in demo.truth.items():
        estimate, before = demo.fit.parameters.get(name), demo.plain.parameters.get(name)
        rows.append(
            [
                name,
                f"{truth:.5g}",
                f"{demo.start[name]:.4g}" if name in demo.start else "",
                format_estimate(before),
                format_estimate(estimate),
                f"{abs(demo.deviations[name]):.1f} std" if estimate else "",
                format_unit(estimate.unit) if estimate else "",
            ]
        )
    return "\n".join(format_table(HEAD, rows))


def format_estimate(estimate: Estimate | None) -> str:
    """``value +- std``; empty where a model lacks the parameter."""
    return "" if estimate is None else format_with_std(estimate.value, estimate.std or 0.0)


def demo_answer(demo: Demo, folder: Path) -> str:
    """What `greybox demo` prints: the results, the files, and the commands that repeat it."""
    setup, (first, second) = demo.setup, demo.records
    known = " ".join(f"--fix {name}={demo.fit.parameters[name].value:g}" for name in setup.known)
    noise = " ".join(f"--noise {name}={std:g}" for name, std in setup.noise.items())
    arguments = f"{setup.model} {first} --validate {second} {known} {noise} --at-rest"
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
            f"  greybox fit {arguments}",
            f"  greybox discover {arguments}",
            f"  greybox export {folder / 'fit.json'} --to control",
        ]
    )


def extensions_text(entries: Sequence[Extension]) -> str:
    """What `greybox extensions` prints: kind, name, place and origin of each entry; those that failed follow with their reason."""
    rows = [[e.kind, e.name, e.place, f"{e.distribution} {e.version}".strip()] for e in entries if not e.failure]
    failed = [f"{e.kind} {e.name} of {e.distribution}: not loaded ({e.failure})" for e in entries if e.failure]
    return "\n".join([*format_table(["kind", "name", "place", "from"], rows), *failed])
