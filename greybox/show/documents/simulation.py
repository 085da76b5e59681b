"""The page of a simulation: what the model did, and what it was driven by."""

from __future__ import annotations

import numpy as np

from greybox.base.errors import ModelError
from greybox.model.model import Model
from greybox.show.figures.figure import Role, scale_to_prefix, typeset_unit
from greybox.show.figures.records import plot_signals
from greybox.show.figures.sheet import PAGE
from greybox.show.pages.equations import typeset_equations
from greybox.show.pages.page import (
    Block,
    FigureBlock,
    Page,
    PageTable,
    Paragraphs,
    Section,
    Tone,
    format_range,
    typeset_number,
)
from greybox.show.pages.provenance import format_sampling_time, hidden_states, provenance_section, signal_units
from greybox.show.sentences.wording import count_noun, format_number, join_names
from greybox.simulation.simulate import Simulation


def build_simulation_page(run: Simulation, *, model: Model | None = None, command: str = "", noise: str = "") -> Page:
    """The page of a simulation.

    Parameters
    ----------
    run
        The result of `greybox.simulate`.
    model
        What ran.
    command
        What was typed, for repeating it.
    noise
        The standard deviations of the noise that was added to the outputs that were written.

    Raises
    ------
    ModelError
        Without the model.
    """
    if model is None:
        raise ModelError("report of a simulation: no model; give model=")
    units = signal_units(model) | {s.name: s.unit for s in model.all_states}
    stretches = PAGE.stretches(len(run.inputs) + len(run.outputs) + len(run.states))
    held = run.source.hold == "zero"
    groups = (
        ("outputs", run.outputs, "Simulated outputs, without sensor noise.", Role.OUTPUT),
        ("inputs", run.inputs, "Inputs.", Role.INPUT),
        ("states", hidden_states(run), "States.", Role.STATE),
    )
    figures: list[Block] = [
        FigureBlock(
            plot_signals(name, run.time, signals, units, role, caption, held=role is Role.INPUT and held),
            stretches,
            group="run",
        )
        for name, signals, caption, role in groups
        if signals
    ]
    sections = [
        Section("run", "The run", [*figures, _ranges(run, units)]),
        Section("model", "The model", [_parameters(model), typeset_equations(model)]),
        provenance_section(command),
    ]
    question = f"How does {model.title} respond to {join_names(list(run.inputs)) or 'no input'}?"
    title = f"Simulation of {model.title}"
    return Page(title, question, _verdict(run, noise), sections, "simulation")


def _verdict(run: Simulation, noise: str) -> Paragraphs:
    if run.overflow is not None:
        return Paragraphs([f"The run overflows {run.overflow:.4g} s after its start and ends there."], Tone.BAD)
    free_run = (
        f"Free run over {count_noun(len(run.time), 'row')}, {run.time[-1] - run.time[0]:.4g} s, sampled every"
        f" {format_sampling_time(run.time)}; integrated by {run.discretisation}."
    )
    return Paragraphs(
        [free_run, *([f"The written outputs contain added white noise: {noise}."] if noise else [])], Tone.GOOD
    )


def _ranges(run: Simulation, units: dict[str, str]) -> PageTable:
    rows = []
    for kind, group in (("input", run.inputs), ("output", run.outputs), ("state", run.states)):
        for name, values in group.items():
            factor, unit = scale_to_prefix(units[name], np.asarray(values))
            rows.append([name, kind, f"{format_range(factor * np.asarray(values))} {unit}"])
    return PageTable("Ranges of the signals", ["signal", "kind", "from … to"], rows)


def _parameters(model: Model) -> PageTable:
    rows = [[q.name, typeset_number(format_number(q.value, 7)), typeset_unit(q.unit)] for q in model.all_parameters]
    return PageTable("Parameters of this run", ["parameter", "value", "unit"], rows)
