"""The page of a simulation: what the model did, and what it was driven by."""

from __future__ import annotations

import numpy as np

from greybox.errors import ModelError
from greybox.estimation.versions import read_versions
from greybox.model import Model
from greybox.plots.figure import Role
from greybox.plots.records import plot_signals
from greybox.plots.scaling import scale_to_prefix
from greybox.plots.style import PAGE
from greybox.rendering.plots import FigureText, phrase
from greybox.reports.equations import typeset_equations
from greybox.reports.page import Block, FigureBlock, Page, Section, Table, Text
from greybox.reports.provenance import command_block, name_value_table
from greybox.reports.records import format_sampling_time, signal_units
from greybox.reports.typography import count_noun, format_number, format_range, join_names, typeset_number, typeset_unit
from greybox.simulation import Simulation


def report_of_simulation(run: Simulation, *, model: Model | None = None, command: str = "", noise: str = "") -> Page:
    """The page of a run of ``model``; ``noise`` says what was added to its outputs. Raises ModelError without the model."""
    if model is None:
        raise ModelError("report of a simulation: which model ran? give model=")
    units = signal_units(model) | {s.name: s.unit for s in model.all_states}
    stretches = PAGE.stretches(len(run.inputs) + len(run.outputs) + len(run.states))
    curves = (
        ("outputs", run.outputs, FigureText.SIMULATED_OUTPUTS, Role.OUTPUT),
        ("inputs", run.inputs, FigureText.SIMULATED_INPUTS, Role.INPUT),
        ("states", run.states, FigureText.SIMULATED_STATES, Role.STATE),
    )
    shown: list[Block] = [
        FigureBlock(plot_signals(name, run.time, signals, units, role, phrase(caption)), stretches, group="run")
        for name, signals, caption, role in curves
        if signals
    ]
    sections = [
        Section("run", "The run", [*shown, _reach(run, units)]),
        Section("model", "The model", [_constants(model), typeset_equations(model)]),
        Section("repeat", "How to repeat it", [*command_block(command), name_value_table("Versions", read_versions())]),
    ]
    question = f"What does {model.title} do when {join_names(list(run.inputs)) or 'nothing'} drives it?"
    return Page(f"Simulation of {model.title}", question, _verdict(run, noise), sections, "simulation")


def _verdict(run: Simulation, noise: str) -> Text:
    if run.overflow is not None:
        return Text([f"The run overflows {run.overflow:.4g} s after its start: what follows is not there."], "bad")
    said = (
        f"A free run over {count_noun(len(run.time), 'row')}, {run.time[-1] - run.time[0]:.4g}"
        f" s, one every {format_sampling_time(run.time)};"
        f" integrated by {run.discretisation}."
    )
    return Text(
        [said, *([f"White noise was added to what was written: {typeset_number(noise)}."] if noise else [])], "good"
    )


def _reach(run: Simulation, units: dict[str, str]) -> Table:
    rows = []
    for use, group in (("input", run.inputs), ("output", run.outputs), ("state", run.states)):
        for name, values in group.items():
            factor, text = scale_to_prefix(units[name], np.asarray(values))
            rows.append([name, use, f"{format_range(factor * np.asarray(values))} {text}"])
    return Table("How far each signal goes", ["signal", "what", "from … to"], rows)


def _constants(model: Model) -> Table:
    rows = [[q.name, typeset_number(format_number(q.value, 7)), typeset_unit(q.unit)] for q in model.all_parameters]
    return Table("Constants of this run", ["constant", "value", "unit"], rows)
