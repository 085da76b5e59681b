"""What the commands `fit`, `simulate` and `export` print: a result, with what was asked for beside it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from greybox.base.document import Block, Details, Document, Facts, Later, Paragraphs, TableBlock
from greybox.show.documents.simulation import ranges_table
from greybox.show.documents.tables import MISFIT_HEADS, misfit_cells
from greybox.show.sentences.wording import count_noun, join_names

if TYPE_CHECKING:
    from greybox.shell.answers import CodeAnswer, FitAnswer, LinearAnswer, SimulationAnswer


def describe_fit_answer(answer: FitAnswer) -> Document:
    """The fit; what would determine more, and on request further intervals, predictions, residual tests, the misfit of each record."""
    fit = answer.fit.describe()
    remedies = [f"remedy: {text}" for text in answer.remedies]
    notes = [*([answer.refusal] if answer.refusal else []), *remedies[:1], *fit.notes, *remedies[1:]]
    table = [*fit.table, *(Details(title, [block]) for title, block in further_intervals(answer))]
    return replace(fit, table=table, notes=notes, details=Later(_fit_details, answer, fit.details))


def _fit_details(answer: FitAnswer, details: Sequence[Block]) -> Iterator[Block]:
    yield from details
    shown: list[Block] = []  # what corrects the predictions is often the same for both
    for title, scores in (("", answer.scores), (", validation records", answer.validation_scores)):
        if scores is not None:
            blocks = [block for block in scores.describe().details if block not in shown]
            shown += blocks
            yield Details(f"free run and prediction{title}", blocks)
    if answer.tests is not None:
        title = "residual tests (an alarm: p below 0.01, as in 1 % of correct fits)"
        yield Details(title, answer.tests.describe().details)
    for title, misfits in (("estimation record", answer.misfits), ("validation record", answer.validation_misfits)):
        if misfits:
            rows = [[m.record, m.output, *misfit_cells(m.misfit)] for m in misfits]
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
    """How long the run is, its columns and their ranges, and how the model was integrated."""
    run, model = answer.run, answer.model
    names = join_names([*run.inputs, *run.outputs])
    line = f"{model.title} was simulated: {count_noun(len(run.time), 'row')} of {names} over {run.time[-1] - run.time[0]:.4g} s."
    noise = [f"white noise was added: {answer.noise}"] if answer.noise else []
    return Document(line, line, table=[ranges_table(run, model)], notes=[*noise, f"integrated by {run.discretisation}"])


def describe_linear_answer(answer: LinearAnswer) -> Document:
    """The linear model and its family of samples."""
    linear = answer.linear.describe()
    family = answer.family.describe().details if answer.family is not None else []
    return replace(linear, details=[*linear.details, *family])


def describe_code_answer(answer: CodeAnswer) -> Document:
    """What the model was written as, and its step."""
    step = "" if answer.step is None else f", {answer.step_name} {answer.step:g} s"
    return Document(answer.title, f"{answer.title} was written as {answer.kind}{step}.")
