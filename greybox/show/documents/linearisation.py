"""A linear model for a controller design: matrices, poles, frequency response, and how sure they are."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from greybox.base import document as doc
from greybox.base import format_unit
from greybox.estimation.linear.exported_model import format_signals
from greybox.estimation.linear.linearisation import Linearisation
from greybox.estimation.linear.model_family import ModelFamily
from greybox.estimation.linear.transfer_channel import describe_behaviour
from greybox.show.documents.tables import provenance_section, worst_first
from greybox.show.figures.figure import typeset_unit
from greybox.show.figures.linear import plot_bode, plot_poles
from greybox.show.sentences.linear import channel_lines, poles_table
from greybox.show.sentences.wording import count_noun, join_names

if TYPE_CHECKING:
    from greybox.shell.answers import CodeAnswer, LinearAnswer


def describe_linearisation(
    linear: Linearisation, *, family: ModelFamily | None = None, command: str = ""
) -> doc.Document:
    """What is said of a linear model.

    Parameters
    ----------
    linear
        The result of `greybox.linearise`.
    family
        Models drawn from the covariance of its parameters, shown around it.
    command
        What was typed, for repeating it.
    """
    return replace(
        linear_summary(linear),
        evidence=doc.Later(linear_evidence, linear, family),
        sections=doc.Later(lambda: [*linear_sections(linear, family), provenance_section(command)]),
    )


def linear_summary(linear: Linearisation) -> doc.Document:
    """Whether it is stable, its poles, where it holds, and on request the matrices to the last digit and each channel."""
    size = np.abs(linear.poles) if linear.dt else linear.poles.real + 1
    stability = "stable" if (size < 1).all() else "marginally stable" if (size <= 1).all() else "unstable"
    timing = f"sampled every {linear.dt:g} s ({linear.method})" if linear.dt else "continuous"
    answer = f"{linear.name} as a linear model, {timing}, with {count_noun(len(linear.A), 'state')}: it is {stability}."
    cautious = bool(linear.findings) or stability != "stable"
    behaviour = describe_behaviour(linear).describe().details
    names = (*linear.state_names, *linear.input_names)
    values, units = (*linear.x0, *linear.u0), (*linear.state_units, *linear.input_units)
    point = [
        f"{name} = {value:.4g} {typeset_unit(unit) if unit else ''}".rstrip()
        for name, value, unit in zip(names, values, units, strict=True)
    ]
    deviations = "deviations of any size" if linear.is_exact else "small deviations"
    # The operating point, and what the matrices leave out.
    point_lines = [f"  at   {format_signals(linear.state_names, linear.x0, linear.state_units)}"]
    if linear.input_names:
        point_lines += [f"       {format_signals(linear.input_names, linear.u0, linear.input_units)}"]
    point_lines += [f"       outputs {format_signals(linear.output_names, linear.y0, linear.output_units)}"]
    point_lines += [
        f"  delay of {name} {seconds:.6g} s, not in the matrices"
        for name, seconds in zip(linear.input_names, linear.delay, strict=True)
        if seconds
    ]
    return doc.Document(
        f"{linear.name} as a linear model",
        answer,
        doc.Tone.CAUTION if cautious else doc.Tone.GOOD,
        behaviour[:1],
        [*worst_first(linear.findings), f"it holds for {deviations} from {join_names(point)}"],
        [doc.Paragraphs(point_lines), doc.CodeBlock("\n".join(_matrix_lines(linear))), *behaviour[1:]],
        linear_question(linear),
        kind="export",
    )


def linear_question(linear: Linearisation) -> str:
    """What a linear model is for."""
    inputs, outputs = (join_names(names) or "the states" for names in (linear.input_names, linear.output_names))
    return f"How do {'' if linear.is_exact else 'small '}deviations of {inputs} change {outputs}? This model is for controller design."


def linear_evidence(linear: Linearisation | None, family: ModelFamily | None) -> Iterator[doc.FigureBlock]:
    """The gain over frequency, with the family's band; nothing of a nonlinear model."""
    if linear is not None:
        yield from (doc.FigureBlock(figure, group="bode", switch="bode") for figure in plot_bode(linear, family)[:1])


def linear_sections(linear: Linearisation, family: ModelFamily | None) -> list[doc.Section]:
    """Behaviour and matrices, with the family's spread where there is one."""
    return [
        doc.Section("behaviour", "Behaviour", list(_behaviour(linear, family))),
        doc.Section("matrices", "Matrices", list(_matrices(linear))),
        doc.Section("point", "Operating point and parameters", list(_basis(linear))),
    ]


def _behaviour(linear: Linearisation, family: ModelFamily | None) -> Iterator[doc.Block]:
    yield poles_table(linear.poles, linear.dt)
    yield from (doc.FigureBlock(figure, group="bode", switch="bode") for figure in plot_bode(linear, family)[1:])
    poles = plot_poles(linear, family)
    if poles is not None:
        yield doc.FigureBlock(poles)
    channels = [map(str.strip, channel_lines(channel)) for channel in describe_behaviour(linear).channels]
    yield from (doc.Subheading("Channels"), doc.BulletList(list(map("; ".join, channels))))
    if family is not None:
        models = f"{count_noun(len(family.members), 'model')} drawn from the covariance of the parameters (seed {family.seed})"
        yield doc.Paragraphs([f"{models} show the uncertainty."])
        if family.findings:
            yield doc.BulletList(family.findings)


def _matrices(linear: Linearisation) -> Iterator[doc.Block]:
    """A, B, C and D with the names of their rows and columns; every digit in text to copy."""
    states, inputs, outputs = linear.state_names, linear.input_names, linear.output_names
    rates = [f"{name}[k+1]" if linear.dt else f"d{name}/dt" for name in states]
    named = {
        "A": (linear.A, rates, states),
        "B": (linear.B, rates, inputs),
        "C": (linear.C, outputs, states),
        "D": (linear.D, outputs, inputs),
    }
    for name, (matrix, rows, columns) in named.items():
        if matrix.size:
            cells = [[row, *(f"{v:.6g}" for v in values)] for row, values in zip(rows, matrix, strict=True)]
            yield doc.TableBlock(f"Matrix {name}: effect of the columns on the rows", [name, *columns], cells)
    yield doc.Details("Matrices with all digits", [doc.CodeBlock("\n".join(_matrix_lines(linear)))])


def _basis(linear: Linearisation) -> Iterator[doc.Block]:
    names = (*linear.state_names, *linear.input_names, *linear.output_names)
    kinds = ["state"] * len(linear.x0) + ["input"] * len(linear.u0) + ["output"] * len(linear.y0)
    values = (*linear.x0, *linear.u0, *linear.y0)
    units = (*linear.state_units, *linear.input_units, *linear.output_units)
    rows = [
        [name, kind, f"{value:.6g}", format_unit(unit) if unit else ""]
        for name, kind, value, unit in zip(names, kinds, values, units, strict=True)
    ]
    yield doc.TableBlock("Operating point", ["signal", "kind", "value", "unit"], rows)
    delays = [[n, f"{s:.6g} s"] for n, s in zip(linear.input_names, linear.delay, strict=True) if s]
    if delays:
        yield doc.TableBlock("Delays that the matrices do not include", ["input", "delay"], delays)
    parameters = [[name, f"{value:.7g}"] for name, value in linear.parameters.items()]
    yield doc.TableBlock("Parameters of the model", ["parameter", "value (in the model's unit)"], parameters)


def _matrix_lines(model: Linearisation) -> list[str]:
    """A, B, C and D to the last digit."""
    lines = []
    for name, matrix in (("A", model.A), ("B", model.B), ("C", model.C), ("D", model.D)):
        rows = [[repr(float(v)) for v in row] for row in matrix]
        widths = [max((len(row[k]) for row in rows), default=0) for k in range(matrix.shape[1])]
        for k, row in enumerate(rows):
            head = f"  {name} = " if k == 0 else "      "
            lines.append(head + "  ".join(cell.rjust(w) for cell, w in zip(row, widths, strict=True)))
    return lines


def describe_linear_answer(answer: LinearAnswer) -> doc.Document:
    """The linear model and its family of samples."""
    linear = answer.linear.describe()
    family = answer.family.describe().details if answer.family is not None else []
    return replace(linear, details=[*linear.details, *family])


def describe_code_answer(answer: CodeAnswer) -> doc.Document:
    """What the model was written as, and its step."""
    step = "" if answer.step is None else f", {answer.step_name} {answer.step:g} s"
    return doc.Document(answer.title, f"{answer.title} was written as {answer.kind}{step}.")
