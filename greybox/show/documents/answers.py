"""What the commands `fit`, `simulate` and `export` print: a result, with what was asked for beside it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from greybox.base.document import Block, Details, Document, Facts, Later, Paragraphs, TableBlock
from greybox.show.documents.tables import MISFIT_HEADS, misfit_cells
from greybox.show.sentences.shell import written

if TYPE_CHECKING:
    from greybox.shell.answers import CodeAnswer, FitAnswer, LinearAnswer, SimulationAnswer


def describe_fit_answer(answer: FitAnswer) -> Document:
    """Equations, parameters, remedies, further intervals, predictions, residual tests, the misfit of each record."""
    return Document(answer.fit.model.title, Later(_fit_brief, answer))


def _fit_brief(answer: FitAnswer) -> Iterator[Block]:
    yield Paragraphs([answer.fit.provenance.equations])
    yield from answer.fit.describe().brief
    yield Facts([("or" if k else "remedy", text) for k, text in enumerate(answer.remedies)])
    yield from (Details(title, [block]) for title, block in further_intervals(answer))
    yield Paragraphs([answer.refusal] if answer.refusal else [])
    shown: list[Block] = []  # what corrects the predictions is often the same for both
    for title, scores in (("", answer.scores), (", validation records", answer.validation_scores)):
        if scores is not None:
            blocks = [block for block in scores.describe().brief if block not in shown]
            shown += blocks
            yield Details(f"free run and prediction{title}", blocks)
    if answer.tests is not None:
        title = "residual tests (p below 0.01 is an alarm; each test has a false-alarm rate of 1 %)"
        yield Details(title, answer.tests.describe().brief)
    for title, misfits in (("estimation record", answer.misfits), ("validation record", answer.validation_misfits)):
        if misfits:
            rows = [[m.record, m.output, *misfit_cells(m.misfit, answer.fit.noise.bound(m.output))] for m in misfits]
            yield TableBlock(f"Misfit of each {title}", [title, "output", *MISFIT_HEADS], rows)


def further_intervals(answer: FitAnswer) -> Iterator[tuple[str, Block]]:
    """The intervals that were asked for beside those of the covariance, each kind with its title."""
    if answer.profiles or answer.regions or answer.zero_noise:
        zeros = [f"{name}: zero; its limit is listed with the parameters" for name in answer.zero_noise]
        lines = "\n".join([*map(str, (*answer.profiles, *answer.regions)), *zeros]).splitlines()
        yield "profile likelihood", Paragraphs(lines)
    if answer.bootstrap is not None:
        b = answer.bootstrap
        ends = {name: "[{:.5g}, {:.5g}]".format(*b.interval[name]) for name in b.names}
        facts = [(name, f"standard deviation {b.std[name]:.3g}, 95 % {ends[name]}") for name in b.names]
        yield f"block bootstrap, {len(b.samples)} replicates in blocks of {b.block} rows", Facts(facts)


def describe_simulation_answer(answer: SimulationAnswer) -> Document:
    """Which file was written, its rows and columns, and how the model was integrated."""
    run = answer.run
    names = ", ".join([*run.inputs, *run.outputs])
    line = f"{answer.file}: {len(run.time)} rows, {names}; integrated by {run.discretisation}"
    return Document(str(answer.file), [Paragraphs([line])])


def describe_linear_answer(answer: LinearAnswer) -> Document:
    """The linear model, its family of samples, and the file."""
    family = answer.family.describe().brief if answer.family is not None else []
    return Document(answer.linear.name, [*answer.linear.describe().brief, *family, Paragraphs([written(answer.files)])])


def describe_code_answer(answer: CodeAnswer) -> Document:
    """What the model was written as, its step, and the files."""
    step = "" if answer.step is None else f", {answer.step_name} {answer.step:g} s"
    return Document(answer.title, [Paragraphs([f"{answer.title} as {answer.kind}{step}", written(answer.files)])])
