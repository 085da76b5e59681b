"""The page of a linear model for a controller design: matrices, poles, frequency response, and how sure they are."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from greybox.base.findings import Finding
from greybox.base.numerics import VANISHED_POLE
from greybox.estimation.linear.linearisation import Linearisation
from greybox.estimation.linear.model_family import ModelFamily
from greybox.estimation.linear.transfer_channel import extract_channel
from greybox.show.figures.figure import typeset_unit
from greybox.show.figures.linear import plot_bode, plot_poles
from greybox.show.pages.fit_page import statements
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
from greybox.show.sentences.pages import PageText
from greybox.show.sentences.wording import phrase


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
    return Page(
        phrase(PageText.LINEAR_TITLE, linear.name), linear_question(linear), linear_verdict(linear), sections, "export"
    )


def linear_question(linear: Linearisation) -> Finding:
    """What a linear model is for."""
    return phrase(PageText.LINEAR_QUESTION, inputs=list(linear.input_names), outputs=list(linear.output_names))


def linear_verdict(linear: Linearisation) -> Paragraphs:
    """Whether it is stable, where it holds, and what to know before using it."""
    size = np.abs(linear.poles) if linear.dt else linear.poles.real + 1
    stability = "stable" if (size < 1).all() else "marginally stable" if (size <= 1).all() else "unstable"
    items = [
        phrase(PageText.LINEAR_VERDICT, dt=linear.dt, method=linear.method, states=len(linear.A), stability=stability),
        phrase(PageText.LINEAR_POINT, point=_point(linear)),
    ]
    cautious = bool(linear.findings) or stability != "stable"
    return Paragraphs([*items, *statements(linear.findings)], Tone.CAUTION if cautious else Tone.GOOD)


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
        Section("behaviour", list(_behaviour(linear, family))),
        Section("matrices", list(_matrices(linear))),
        Section("point", list(_basis(linear))),
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
    yield CodeBlock("\n".join(lines), phrase(PageText.LINEAR_CHANNELS))
    if family is not None:
        yield Paragraphs([phrase(PageText.LINEAR_FAMILY, models=len(family.members), seed=family.seed)])
        if family.findings:
            yield BulletList(statements(family.findings))


def _poles(linear: Linearisation) -> PageTable:
    """Poles with natural frequency, damping and time constant."""
    rows = [list(map(typeset_number, _pole_cells(linear, pole))) for pole in linear.poles[linear.poles.imag >= 0]]
    head = ["pole" if linear.dt else "pole [1/s]", "natural frequency", "damping", "time constant"]
    return PageTable(phrase(PageText.LINEAR_POLES, sampled=bool(linear.dt)), head, rows)


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
    yield Details(phrase(PageText.LINEAR_DIGITS), [CodeBlock("\n".join(digits))])


def _matrix(name: str, matrix: np.ndarray, rows: Sequence[str], columns: Sequence[str]) -> PageTable:
    cells = [
        [row, *(typeset_number(f"{v:.6g}").replace("-", "−") for v in values)]
        for row, values in zip(rows, matrix, strict=True)
    ]
    return PageTable(phrase(PageText.LINEAR_MATRIX, name), [name, *columns], cells)


def _basis(linear: Linearisation) -> Iterator[Block]:
    names = (*linear.state_names, *linear.input_names, *linear.output_names)
    kinds = ["state"] * len(linear.x0) + ["input"] * len(linear.u0) + ["output"] * len(linear.y0)
    values = (*linear.x0, *linear.u0, *linear.y0)
    units = (*linear.state_units, *linear.input_units, *linear.output_units)
    rows = [
        [name, kind, typeset_number(f"{value:.6g}").replace("-", "−"), typeset_unit(unit) if unit else ""]
        for name, kind, value, unit in zip(names, kinds, values, units, strict=True)
    ]
    yield PageTable(phrase(PageText.LINEAR_OPERATING_POINT), ["signal", "kind", "value", "unit"], rows)
    delays = [[n, f"{s:.6g} s"] for n, s in zip(linear.input_names, linear.delay, strict=True) if s]
    if delays:
        yield PageTable(phrase(PageText.LINEAR_DELAYS), ["input", "delay"], delays)
    parameters = [[name, typeset_number(f"{value:.7g}")] for name, value in linear.parameters.items()]
    head = ["parameter", "value (in the model's unit)"]
    yield PageTable(phrase(PageText.LINEAR_PARAMETERS), head, parameters)
