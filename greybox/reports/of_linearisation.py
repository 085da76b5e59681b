"""The page of a linear model for a controller design: matrices, poles, frequency response, and how sure they are."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from greybox.estimation.versions import read_versions
from greybox.export import Linearisation, ModelFamily
from greybox.export.summary import format_channel, format_complex
from greybox.plots.linear import plot_bode, plot_poles
from greybox.reports.page import Block, Code, FigureBlock, Folded, Listing, Page, Section, Table, Text
from greybox.reports.provenance import command_block, name_value_table
from greybox.reports.typography import as_sentence, count_noun, join_names, typeset_number, typeset_unit

GONE = 1e-12  # a pole of a sampled model at zero, as a delay has it


def report_of_linearisation(linear: Linearisation, *, family: ModelFamily | None = None, command: str = "") -> Page:
    """The page of a linear model; ``family``: models drawn from the covariance of its constants, shown around it."""
    sections = [*linear_sections(linear, family), Section("repeat", "How to repeat it", list(_repeat(linear, command)))]
    return Page(f"{linear.name} as a linear model", question(linear), verdict(linear), sections, "export")


def question(linear: Linearisation) -> str:
    """What a linear model is for."""
    inputs, outputs = join_names(list(linear.input_names)) or "nothing", join_names(list(linear.output_names))
    return f"How do small moves of {inputs} show in {outputs}, for the design of a controller?"


def verdict(linear: Linearisation) -> Text:
    """Whether it is stable, where it holds, and what to know before using it."""
    kind = f"sampled every {linear.dt:g} s ({linear.method})" if linear.dt else "continuous"
    size = np.abs(linear.poles) if linear.dt else linear.poles.real + 1
    stable = "stable" if (size < 1).all() else "at the border of stability" if (size <= 1).all() else "unstable"
    said = [
        f"A {kind} linear model with {count_noun(len(linear.A), 'state')}; it is {stable}.",
        f"It holds for small moves about {_point(linear)}.",
    ]
    return Text([*said, *map(as_sentence, linear.notes)], "caution" if linear.notes or stable != "stable" else "good")


def _point(linear: Linearisation) -> str:
    names = (*linear.state_names, *linear.input_names)
    values, units = (*linear.x0, *linear.u0), (*linear.state_units, *linear.input_units)
    return join_names([
        typeset_number(f"{n} = {v:.4g} {typeset_unit(u) if u else ''}".rstrip()) for n, v, u in zip(names, values, units, strict=True)
    ])  # fmt: skip


def linear_sections(linear: Linearisation, family: ModelFamily | None) -> list[Section]:
    """Behaviour and matrices, with the family's spread where there is one."""
    behaviour: list[Block] = [
        poles(linear),
        *(FigureBlock(f, group="bode", switch="bode") for f in plot_bode(linear, family)),
    ]
    picture = plot_poles(linear, family)
    behaviour += [FigureBlock(picture)] if picture is not None else []
    lines = [
        line.strip()
        for o in linear.output_names
        for i in linear.input_names
        for line in format_channel(linear.channel(o, i))
    ]
    behaviour.append(Code("\n".join(lines), "Channel by channel"))
    if family is not None:
        drawn = count_noun(len(family.members), "model")
        behaviour.append(
            Text([f"{drawn} drawn from the covariance of the constants (seed {family.seed}) show how sure this is."])
        )
        behaviour += [Listing([as_sentence(n) for n in family.notes])] if family.notes else []
    return [
        Section("behaviour", "How it behaves", behaviour),
        Section("matrices", "The matrices", list(matrices(linear))),
        Section("point", "The operating point and the constants", list(_basis(linear))),
    ]  # fmt: skip


def poles(linear: Linearisation) -> Table:
    """Poles with natural frequency, damping and time constant."""
    rows = []
    for pole in linear.poles[linear.poles.imag >= 0]:
        if linear.dt and abs(pole) < GONE:
            rows.append([format_complex(pole), "gone after one sample", "", ""])
            continue
        s = np.log(pole) / linear.dt if linear.dt else pole
        speed = abs(s)
        rows.append([
            _complex(pole), f"{speed:.5g} rad/s ({speed / (2 * np.pi):.5g} Hz)" if speed else "integrates",
            f"{-s.real / speed:.4g}" if speed else "", f"{-1 / s.real:.4g} s" if s.real < 0 else "grows" if s.real > 0 else "stays",
        ])  # fmt: skip
    rows = [[typeset_number(cell) for cell in row] for row in rows]
    head = ["pole" if linear.dt else "pole [1/s]", "natural frequency", "damping", "decays in"]
    return Table("Poles (z)" if linear.dt else "Poles", head, rows)


def _complex(pole: complex) -> str:
    real = f"{pole.real:.6g}".replace("-", "−")
    return f"{real} ± {abs(pole.imag):.6g} j" if pole.imag else real


def matrices(linear: Linearisation) -> Iterator[Block]:
    """A, B, C and D with the names of their rows and columns; every digit in text to copy."""
    rates = [f"{n}[k+1]" if linear.dt else f"d{n}/dt" for n in linear.state_names]
    for name, matrix, rows, columns in (
        ("A", linear.A, rates, linear.state_names), ("B", linear.B, rates, linear.input_names),
        ("C", linear.C, linear.output_names, linear.state_names), ("D", linear.D, linear.output_names, linear.input_names),
    ):  # fmt: skip
        if matrix.size:
            yield _matrix(name, matrix, rows, columns)
    text = "\n".join(
        f"{n} = {np.array2string(getattr(linear, n), separator=', ', floatmode='unique')}" for n in ("A", "B", "C", "D")
    )
    yield Folded("Every digit, to copy", [Code(text)])


def _matrix(name: str, matrix: np.ndarray, rows: Sequence[str], columns: Sequence[str]) -> Table:
    cells = [
        [row, *(typeset_number(f"{v:.6g}").replace("-", "−") for v in values)]
        for row, values in zip(rows, matrix, strict=True)
    ]
    return Table(f"{name}: what the columns do to the rows", [name, *columns], cells)


def _basis(linear: Linearisation) -> Iterator[Block]:
    names = (*linear.state_names, *linear.input_names, *linear.output_names)
    kinds = ["state"] * len(linear.x0) + ["input"] * len(linear.u0) + ["output"] * len(linear.y0)
    values, units = (
        (*linear.x0, *linear.u0, *linear.y0),
        (*linear.state_units, *linear.input_units, *linear.output_units),
    )
    rows = [
        [name, kind, typeset_number(f"{value:.6g}").replace("-", "−"), typeset_unit(unit) if unit else ""]
        for name, kind, value, unit in zip(names, kinds, values, units, strict=True)
    ]
    yield Table("The operating point", ["signal", "what", "value", "unit"], rows)
    late = [[n, f"{s:.6g} s"] for n, s in zip(linear.input_names, linear.delay, strict=True) if s]
    if late:
        yield Table("Delays that are not in the matrices", ["input", "delay"], late)
    constants = [[n, typeset_number(f"{v:.7g}")] for n, v in linear.parameters.items()]
    yield Table("The constants behind it", ["constant", "value (in the model's unit)"], constants)


def _repeat(linear: Linearisation, command: str) -> Iterator[Block]:
    yield from command_block(command)
    yield name_value_table("Versions", read_versions())
