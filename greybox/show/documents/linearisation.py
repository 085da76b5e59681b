"""The page of a linear model for a controller design: matrices, poles, frequency response, and how sure they are."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from greybox.base.numerics import VANISHED_POLE
from greybox.estimation.linear.linearisation import Linearisation
from greybox.estimation.linear.model_family import ModelFamily
from greybox.estimation.linear.transfer_channel import extract_channel
from greybox.show.figures.figure import typeset_unit
from greybox.show.figures.linear import plot_bode, plot_poles
from greybox.show.pages.page import (
    Block,
    BulletList,
    CodeBlock,
    Details,
    FigureBlock,
    Page,
    PageTable,
    Paragraphs,
    Section,
    Tone,
    typeset_number,
)
from greybox.show.pages.provenance import provenance_section
from greybox.show.sentences.linear import channel_lines, complex_text
from greybox.show.sentences.wording import count_noun, join_names


def build_linearisation_page(linear: Linearisation, *, family: ModelFamily | None = None, command: str = "") -> Page:
    """The page of a linear model.

    Parameters
    ----------
    linear
        The result of `greybox.linearise`.
    family
        Models drawn from the covariance of its parameters, shown around it.
    command
        What was typed, for repeating it.
    """
    sections = [*linear_sections(linear, family), provenance_section(command)]
    return Page(f"{linear.name} as a linear model", linear_question(linear), linear_verdict(linear), sections, "export")


def linear_question(linear: Linearisation) -> str:
    """What a linear model is for."""
    inputs, outputs = (join_names(names) or "the states" for names in (linear.input_names, linear.output_names))
    return f"How do small deviations of {inputs} change {outputs}? This model is for controller design."


def linear_verdict(linear: Linearisation) -> Paragraphs:
    """Whether it is stable, where it holds, and what to know before using it."""
    size = np.abs(linear.poles) if linear.dt else linear.poles.real + 1
    stability = "stable" if (size < 1).all() else "marginally stable" if (size <= 1).all() else "unstable"
    states = count_noun(len(linear.A), "state")
    items = [
        f"A linear model with {states}, sampled every {linear.dt:g} s ({linear.method}); it is {stability}."
        if linear.dt
        else f"A continuous linear model with {states}; it is {stability}.",
        f"It holds for small deviations from {join_names(_point(linear))}.",
    ]
    cautious = bool(linear.findings) or stability != "stable"
    return Paragraphs([*items, *linear.findings], Tone.CAUTION if cautious else Tone.GOOD)


def _point(linear: Linearisation) -> list[str]:
    names = (*linear.state_names, *linear.input_names)
    values, units = (*linear.x0, *linear.u0), (*linear.state_units, *linear.input_units)
    return [
        f"{name} = {value:.4g} {typeset_unit(unit) if unit else ''}".rstrip()
        for name, value, unit in zip(names, values, units, strict=True)
    ]


def linear_sections(linear: Linearisation, family: ModelFamily | None) -> list[Section]:
    """Behaviour and matrices, with the family's spread where there is one."""
    return [
        Section("behaviour", "Behaviour", list(_behaviour(linear, family))),
        Section("matrices", "Matrices", list(_matrices(linear))),
        Section("point", "Operating point and parameters", list(_basis(linear))),
    ]


def _behaviour(linear: Linearisation, family: ModelFamily | None) -> Iterator[Block]:
    yield _poles(linear)
    yield from (FigureBlock(figure, group="bode", switch="bode") for figure in plot_bode(linear, family))
    poles = plot_poles(linear, family)
    if poles is not None:
        yield FigureBlock(poles)
    lines = [
        line.strip()
        for output in linear.output_names
        for name in linear.input_names
        for line in channel_lines(extract_channel(linear, output, name))
    ]
    yield CodeBlock("\n".join(lines), "Channels")
    if family is not None:
        models = f"{count_noun(len(family.members), 'model')} drawn from the covariance of the parameters (seed {family.seed})"
        yield Paragraphs([f"{models} show the uncertainty."])
        if family.findings:
            yield BulletList(family.findings)


def _poles(linear: Linearisation) -> PageTable:
    """Poles with natural frequency, damping and time constant."""
    rows = [list(map(typeset_number, _pole_cells(linear, pole))) for pole in linear.poles[linear.poles.imag >= 0]]
    head = ["pole" if linear.dt else "pole [1/s]", "natural frequency", "damping", "time constant"]
    return PageTable("Poles (z)" if linear.dt else "Poles", head, rows)


def _pole_cells(linear: Linearisation, pole: complex) -> list[str]:
    if linear.dt and abs(pole) < VANISHED_POLE:
        return [complex_text(pole), "zero after one sample", "", ""]
    s = np.log(pole) / linear.dt if linear.dt else pole
    speed = abs(s)
    return [
        _complex(pole),
        f"{speed:.5g} rad/s ({speed / (2 * np.pi):.5g} Hz)" if speed else "integrates",
        f"{-s.real / speed:.4g}" if speed else "",
        f"{-1 / s.real:.4g} s" if s.real < 0 else "grows" if s.real > 0 else "undamped",
    ]


def _complex(pole: complex) -> str:
    real = f"{pole.real:.6g}".replace("-", "−")
    return f"{real} ± {abs(pole.imag):.6g} j" if pole.imag else real


def _matrices(linear: Linearisation) -> Iterator[Block]:
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
            yield _matrix(name, matrix, rows, columns)
    digits = [
        f"{name} = {np.array2string(matrix, separator=', ', floatmode='unique')}"
        for name, (matrix, _, _) in named.items()
    ]
    yield Details("Matrices with all digits", [CodeBlock("\n".join(digits))])


def _matrix(name: str, matrix: np.ndarray, rows: Sequence[str], columns: Sequence[str]) -> PageTable:
    cells = [
        [row, *(typeset_number(f"{v:.6g}").replace("-", "−") for v in values)]
        for row, values in zip(rows, matrix, strict=True)
    ]
    return PageTable(f"Matrix {name}: effect of the columns on the rows", [name, *columns], cells)


def _basis(linear: Linearisation) -> Iterator[Block]:
    names = (*linear.state_names, *linear.input_names, *linear.output_names)
    kinds = ["state"] * len(linear.x0) + ["input"] * len(linear.u0) + ["output"] * len(linear.y0)
    values = (*linear.x0, *linear.u0, *linear.y0)
    units = (*linear.state_units, *linear.input_units, *linear.output_units)
    rows = [
        [name, kind, typeset_number(f"{value:.6g}").replace("-", "−"), typeset_unit(unit) if unit else ""]
        for name, kind, value, unit in zip(names, kinds, values, units, strict=True)
    ]
    yield PageTable("Operating point", ["signal", "kind", "value", "unit"], rows)
    delays = [[n, f"{s:.6g} s"] for n, s in zip(linear.input_names, linear.delay, strict=True) if s]
    if delays:
        yield PageTable("Delays that the matrices do not include", ["input", "delay"], delays)
    parameters = [[name, typeset_number(f"{value:.7g}")] for name, value in linear.parameters.items()]
    head = ["parameter", "value (in the model's unit)"]
    yield PageTable("Parameters of the model", head, parameters)
